"""Parts of a calibration's report, from the files of its results."""

import html
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.camera.files.result import Result
from calibration.camera.files.result_folder import open_calibration
from calibration.camera.files.summary import comparison_lines, verdict_text
from calibration.camera.report import figures
from calibration.camera.start_values.intrinsics import tilt_and_roll
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join, show, table
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import Summary, read_summary, read_table_csv

#: Photos whose residuals are drawn one by one, the worst first.
_MOST_PHOTOS = 24
_MOST_LINES = 100
_CERTAIN = 0.9999
_UNITS = {"focal_px": "px", "center_x_px": "px", "center_y_px": "px", "skew": "px"}


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationReport:
    """What a folder of a calibration's results holds.

    summary: Headline numbers, warnings, texts.
    result: Camera, photos, board, maps.
    """

    folder: Path
    summary: Summary
    result: Result


def open_report(folder: str | Path = ".") -> CalibrationReport:
    """Read a folder of results.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    return CalibrationReport(folder, read_summary(folder / "summary.json"), open_calibration(folder))


def title(report: CalibrationReport) -> Html:
    """Return the head of the report: name, size of the image, number of photos, version."""
    camera, summary = report.result.camera, report.summary
    line = (
        f"calibration of a camera; {camera.width_px} x {camera.height_px} px, {len(report.result.photos)} photos; "
        f"{summary.texts.get('board', '').split(';')[0]}; heliogauge {summary.version}"
    )
    return page.name_and_line(summary.name, line)


def headline(report: CalibrationReport) -> Html:
    """Return the numbers that show how good the calibration is."""
    result = report.result
    camera, quality, sigma = result.camera, result.quality, result.sigma
    s = camera.sigma_parameters
    rows = [
        ("Focal length in x, y", _pair((camera.focal_x_px, s[0]), (camera.focal_y_px, s[1]))),
        ("Principal point x, y", _pair((camera.center_x_px, s[2]), (camera.center_y_px, s[3]))),
        ("RMS residual, board's shape estimated", f"{quality.rms_px:.4f} px"),
        ("RMS residual, board as drawn", _pixels(quality.rms_as_drawn_px, "nothing was drawn")),
        ("RMS of photos kept apart, only their pose fitted", _pixels(result.kept_apart_px, "not asked")),
        ("RMS of photos held out, only their pose fitted", _pixels(result.held_out_px, "none held out")),
        ("Line of sight, 1 sigma, RMS over the image, best rotation taken out", f"{1e6 * sigma.rms_free_rad:.2g} µrad"),
        ("Projection, 1 sigma, largest in the image", f"{sigma.worst_projection_px:.2g} px"),
        (
            "Image covered",
            f"{result.coverage.share:.0%} of its cells, out to {result.coverage.radius_share:.0%} of "
            "the way to its corners",
        ),
        ("Residuals over what the pixels' noise lets expect", f"{quality.sigma_factor_ratio:.2f}"),
        ("Image points used, rejected", f"{sum(int(p.used.sum()) for p in result.photos)}, {len(quality.rejected)}"),
    ]
    return Html(f'<div class="headline">{table(("", ""), rows, numbers=(1,)).text}</div>')


def _pair(*values: tuple[float, float]) -> str:
    return ", ".join(number_text(value, float(sigma), "px") for value, sigma in values)


def _pixels(value: float, otherwise: str) -> str:
    return f"{value:.4f} px" if np.isfinite(value) else otherwise


def intrinsics_table(report: CalibrationReport) -> Html:
    """Return the estimated intrinsics with sigma, significance and strongest correlation."""
    rows = []
    for one in report.result.intrinsics:
        unit = _UNITS.get(one.name, "")
        against = "" if not np.isfinite(one.significance) else f"{100 * one.significance:.2f} %"
        if one.significance > _CERTAIN:
            against = "> 99.99 %"
        if against and one.significance < 0.95:
            against += " (not significant)"
        rows.append(
            (
                one.name.removesuffix("_px").replace("_", " "),
                number_text(one.value, one.sigma, unit),
                against,
                one.rival.removesuffix("_px").replace("_", " "),
                f"{one.correlation:+.3f}",
            )
        )
    note = (
        "Brown's model on normalised coordinates; pixel (0, 0) is the centre of the top-left pixel. aspect: focal y / "
        "focal x - 1. Significance: probability that the value is not zero. The same camera for OpenCV is in "
        "camera_opencv.yaml, for COLMAP in cameras_colmap.txt."
    )
    head = ("intrinsic", "value \u00b1 1 sigma", "significance", "correlated most with", "correlation")
    return join(table(head, rows, numbers=(1, 2, 4)), Html(f'<p class="caption">{note}</p>'))


def lens_figures(report: CalibrationReport) -> Html:
    """Return radial profile and correlations."""
    return show(figures.profile_figure(report.result), figures.correlation_figure(report.result))


def uncertainty_figures(report: CalibrationReport) -> Html:
    """Return the maps of uncertainty over the image."""
    result = report.result
    return show(
        figures.sigma_figure(result),
        figures.projection_figure(result),
        caption="Lines of sight: what is left when a pose is estimated with this camera. Projection: pose held.",
    )


def image_figures(report: CalibrationReport) -> Html:
    """Return coverage and residuals of all photos."""
    return show(figures.coverage_figure(report.result), figures.residual_figure(report.result))


def photo_figures(report: CalibrationReport) -> Html:
    """Return the residuals photo by photo, the worst first."""
    photos = sorted(report.result.photos, key=lambda photo: -photo.rms_px)
    rest = len(photos) - _MOST_PHOTOS
    caption = "The worst first, all enlarged alike; crosses: rejected points."
    if rest > 0:
        caption += f" {rest} better photos are not shown; image_points.csv has them."
    return show(*(figures.residual_figure(report.result, photo) for photo in photos[:_MOST_PHOTOS]), caption=caption)


def photo_table(report: CalibrationReport) -> Html:
    """Return a line for each photo, the worst first, then those held out."""
    rows = []
    for photo in sorted(report.result.photos, key=lambda one: -one.rms_px):
        tilt, roll = np.degrees(tilt_and_roll(photo.cam_from_board)).tolist()
        sigma = np.sqrt(np.diag(photo.covariance))
        rows.append(
            (
                photo.name,
                f"{int(photo.used.sum())}",
                f"{int((~photo.used).sum())}",
                f"{photo.rms_px:.4f}",
                _pixels(photo.kept_apart_px, "-").removesuffix(" px"),
                f"{tilt:.0f}",
                f"{roll:.0f}",
                f"{np.linalg.norm(photo.cam_from_board.translation_m):.3f}",
                f"{1e3 * float(np.linalg.norm(sigma[:3])):.3g}",
                f"{1e3 * float(np.linalg.norm(sigma[3:])):.3g}",
            )
        )
    long, short = ("m", "mm") if report.result.shape.board.is_metric else ("pitches", "\u2030 pitch")
    head = (
        "photo",
        "points",
        "rej.",
        "RMS [px]",
        "kept apart [px]",
        "tilt [deg]",
        "roll [deg]",
        f"distance [{long}]",
        "\u03c3 rot. [mrad]",
        f"\u03c3 place [{short}]",
    )
    return table(head, rows, numbers=range(1, len(head)))


def held_out_table(report: CalibrationReport) -> Html:
    """Return the photos held out; a sentence where there is none."""
    checks = report.result.held_out
    if not checks:
        return Html("<p>No photo was held out (<code>--hold-out 'check_*'</code>).</p>")
    rows = [(one.name, f"{one.count}", f"{one.rms_px:.4f}") for one in checks]
    return table(("photo held out", "points", "RMS, only its pose fitted [px]"), rows, numbers=(1, 2))


def board_section(report: CalibrationReport) -> Html:
    """Return the board's departure from flat and square, with its sigma."""
    shape = report.result.shape
    unit, factor = ("mm", 1e3) if shape.board.is_metric else ("1/1000 pitch", 1e3)
    rows = []
    for axis, (name, departure, sigma) in enumerate(zip("xyz", shape.departure_m.T, shape.sigma_m.T, strict=True)):
        said = ("along the rows", "along the columns", "across the board")[axis]
        rows.append(
            (
                f"{name}, {said}",
                f"{factor * float(np.sqrt((departure**2).mean())):.4f}",
                f"{factor * float(np.abs(departure).max()):.4f}",
                f"{factor * float(np.sqrt((sigma**2).mean())):.4f}",
            )
        )
    stretch = _stretch(report.result)
    lines = [(name, number_text(value, None, "")) for name, value in stretch]
    head = (f"departure [{unit}]", "RMS", "largest", "sigma, RMS")
    tables = (table(head, rows, numbers=(1, 2, 3)), table(("straight part of it", "1/1000"), lines, numbers=(1,)))
    return join(
        *(tables if shape.has_drawing else (Html("<p>Nothing was known of the targets' places.</p>"),)),
        show(
            figures.board_figure(report.result),
            figures.board_sigma_figure(report.result) if shape.sigma_m.any() else None,
            caption="points.csv and board.csv hold every point with its sigma.",
        ),
    )


def _stretch(result: Result) -> list[tuple[str, float]]:
    """Return how the print is stretched and sheared, the best affine fit, in thousandths."""
    drawn = result.shape.board.points_m[result.shape.seen][:, :2]
    drawn = drawn - drawn.mean(axis=0)
    placed = result.shape.points_m[:, :2] - result.shape.points_m[:, :2].mean(axis=0)
    matrix = np.linalg.lstsq(drawn, placed, rcond=None)[0].T
    return [
        ("y stretched more than x (the scale itself is not seen)", 1e3 * float(matrix[1, 1] - matrix[0, 0])),
        ("out of square", 1e3 * float(matrix[0, 1] + matrix[1, 0])),
    ]


def comparison_section(report: CalibrationReport) -> Html:
    """Return the comparison with another calibration; a sentence where there is none."""
    result = report.result
    if result.comparison is None:
        return Html("<p>No other calibration was given (<code>--compare cameras.json</code>).</p>")
    lines = html.escape("\n".join(comparison_lines(result.comparison)))
    return join(
        Html(f"<p>{html.escape(verdict_text(result.comparison))}</p><pre>{lines}</pre>"),
        show(
            figures.comparison_figure(result),
            figures.difference_sigma_figure(result),
            figures.comparison_figure(result, with_rotation=True),
        ),
    )


def unused_section(report: CalibrationReport) -> Html:
    """Return photos left out and points rejected, with the reason."""
    result = report.result
    rows = [("photo", name, reason) for name, reason in result.left_out.items()]
    points = list(read_table_csv(report.folder / "rejected.csv", ("image_point",))["image_point"])
    rows += [("point", text.rsplit(":", 1)[0], "residual" + text.rsplit(":", 1)[-1]) for text in points[:_MOST_LINES]]
    if len(points) > _MOST_LINES:
        rows.append(("point", f"and {len(points) - _MOST_LINES} more", "rejected.csv"))
    return table(("", "not used", "why"), rows) if rows else Html("<p>Everything was used.</p>")


def text_table(report: CalibrationReport) -> Html:
    """Return what must be known beside the numbers: board, datum, units, meaning of sigma."""
    rows = [(name.replace("_", " "), text) for name, text in report.summary.texts.items()]
    return table(("", ""), rows)
