"""Parts of a calibration's report, from the files of its results."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.camera.files.result import Result, open_calibration
from calibration.camera.files.summary import verdict_text
from calibration.camera.report import stills, views
from calibration.camera.start_values.intrinsics import tilt_and_roll
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, Shown, beside, join, table, table_under_name
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.verdict import Verdict, verdict_of
from heliogauge.results.folder import Summary, read_summary
from heliogauge.view.tables import TableColumn, TableView

_MOST_LINES = 1000
#: Photos whose points were not used to find the camera fit a little worse than the others.
_AGREES = 1.5
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


def first_screen(report: CalibrationReport) -> Html:
    """Return name, verdict, headline numbers and the map over the image."""
    result, summary = report.result, report.summary
    camera = result.camera
    line = (
        f"calibration of a camera; {camera.width_px} x {camera.height_px} px, {len(result.photos)} photos; "
        f"{summary.texts.get('board', '').split(';')[0]}; heliogauge {summary.version}"
    )
    return page.first_screen(summary.name, line, verdict(report), _headline(result), views.lens_map(result))


def verdict(report: CalibrationReport) -> Verdict:
    """Return what was checked and found right, what is doubtful, and what is missing."""
    result, codes = report.result, {one.code for one in report.summary.doubts}
    missing = []
    if result.left_out:
        count = len(result.left_out)
        missing.append(f"{count} of {count + len(result.photos) + len(result.held_out)} photos left out")
    passed = []
    if "coverage_poor" not in codes:
        passed.append(f"points in {result.coverage.share:.0%} of the image's cells")
    if np.isfinite(result.kept_apart_px) and result.kept_apart_px < _AGREES * result.quality.rms_px:
        passed.append(
            f"photos kept apart fit as well: {result.kept_apart_px:.3g} px against {result.quality.rms_px:.3g} px"
        )
    if not codes & {"camera_never_turned", "network_without_roll", "board_never_tilted", "network_without_depth"}:
        passed.append("the camera was turned, the board tilted, at several distances")
    return verdict_of(report.summary, missing, passed)


def _headline(result: Result) -> list[tuple[str, ...]]:
    camera, quality, sigma = result.camera, result.quality, result.sigma
    own, apart = (camera.sigma_parameters[i] for i in range(4)), result.kept_apart_px
    values = (camera.focal_x_px, camera.focal_y_px, camera.center_x_px, camera.center_y_px)
    names = ("Focal length in x", "Focal length in y", "Principal point x", "Principal point y")
    rows: list[tuple[str, ...]] = [
        (name, number_text(value, float(one), "px")) for name, value, one in zip(names, values, own, strict=True)
    ]
    rows.append(
        (
            "Sigma of lines of sight",
            f"{1e6 * sigma.rms_free_rad:.2g} \u00b5rad",
            "RMS over the image, best rotation taken out",
        )
    )
    rows.append(
        (
            "RMS residual",
            f"{quality.rms_px:.3g} px",
            "board's shape estimated" if quality.rms_px != quality.rms_as_drawn_px else "",
        )
    )
    if np.isfinite(apart):
        rows.append(("RMS of photos kept apart", f"{apart:.3g} px", "only their pose fitted"))
    if np.isfinite(result.held_out_px):
        rows.append(("RMS of photos held out", f"{result.held_out_px:.3g} px", "only their pose fitted"))
    if result.comparison is not None:
        one = result.comparison
        rows.append(("Difference from the other calibration", f"{1e3 * one.rms_rad:.2g} mrad", verdict_text(one)))
    return rows


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
        ("Line of sight, 1 sigma, RMS over the image, best rotation taken out", f"{1e3 * sigma.rms_free_rad:.2g} mrad"),
        ("Projection, 1 sigma, largest in the image", f"{sigma.worst_projection_px:.2g} px"),
        (
            "Image covered",
            f"{result.coverage.share:.0%} of its cells, out to {result.coverage.radius_share:.0%} of "
            "the way to its corners",
        ),
        ("Residuals over what the pixels' noise lets expect", f"{quality.sigma_factor_ratio:.2f}"),
        ("Image points used, rejected", f"{sum(int(p.used.sum()) for p in result.photos)}, {len(quality.rejected)}"),
    ]
    return page.headline_numbers(rows)


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


def lens(report: CalibrationReport) -> Html:
    """Return radial profile and correlations."""
    return beside(views.profile_chart(report.result), stills.correlations(report.result))


def photos(report: CalibrationReport) -> Shown:
    """Return the photos with the board's points, and those where no board was found."""
    return views.photo_view(report.result)


def photo_table(report: CalibrationReport) -> Html:
    """Return a line for each photo, the worst first, with a link to its picture."""
    result, marks = report.result, views.photo_marks(report.result)
    chosen = sorted(result.photos, key=lambda one: -one.rms_px)
    names = [photo.name for photo in chosen]
    turns = np.degrees([tilt_and_roll(photo.cam_from_board) for photo in chosen]).reshape(-1, 2)
    sigma = 1e3 * np.sqrt([np.diag(photo.covariance) for photo in chosen]).reshape(-1, 6)
    rotation, place = np.linalg.norm(sigma[:, :3], axis=1), np.linalg.norm(sigma[:, 3:], axis=1)
    long, short = ("m", "mm") if result.shape.board.is_metric else ("pitches", "\u2030 pitch")
    columns = (
        TableColumn("photo", names, links=[f"#{marks[name]}" if name in marks else "" for name in names]),
        _column("points", [float(photo.used.sum()) for photo in chosen], ".0f"),
        _column("refused", [float((~photo.used).sum()) for photo in chosen], ".0f"),
        _column("RMS [px]", [photo.rms_px for photo in chosen], ".4f"),
        _column("kept apart [px]", [photo.kept_apart_px for photo in chosen], ".4f"),
        _column("tilt [deg]", turns[:, 0].tolist(), ".0f"),
        _column("roll [deg]", turns[:, 1].tolist(), ".0f"),
        _column(f"distance [{long}]", [float(np.linalg.norm(p.cam_from_board.translation_m)) for p in chosen], ".3f"),
        _column("\u03c3 rot. [mrad]", rotation.tolist(), ".2g"),
        _column(f"\u03c3 place [{short}]", place.tolist(), ".2g"),
    )
    return table_under_name(TableView("Photos, the largest residuals first", columns, most_rows=15))


def _column(name: str, values: list[float], form: str) -> TableColumn:
    return TableColumn(name, [format(value, form) if np.isfinite(value) else "" for value in values], values)


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
    parts = tables if shape.has_drawing else (Html("<p>Nothing was known of the targets' places.</p>"),)
    return join(views.network_view(report.result), *parts)


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
    drawn = views.comparison_map(report.result)
    if drawn is None or report.result.comparison is None:
        return Html("<p>No other calibration was given (<code>--compare cameras.json</code>).</p>")
    one = report.result.comparison
    rows = [
        (name, *(f"{1e3 * value:.2g}" for value in values))
        for name, values in (
            ("best rotation taken out", (one.rms_rad, one.largest_rad, one.expected_rad)),
            ("with the rotation", (one.raw_rms_rad, one.raw_largest_rad, one.raw_expected_rad)),
        )
    ]
    head = ("angle between lines of sight [mrad]", "RMS", "largest", "RMS expected from both sigmas")
    said = f"The difference is {verdict_text(one)}"
    if np.isfinite(one.chance):
        said += f": chi-square {one.chi_square:.3g} for {one.freedom} degrees of freedom, probability {one.chance:.2g}"
    else:
        said = verdict_text(one).capitalize()
    return join(Html(f"<p>{said}.</p>"), table(head, rows, numbers=(1, 2, 3)), drawn)


def unused_section(report: CalibrationReport) -> Html:
    """Return photos left out and points rejected, with the reason and a link to the photo."""
    result, marks = report.result, views.photo_marks(report.result)
    points = list(result.quality.rejected)[:_MOST_LINES]
    what = [*result.left_out, *(text.rsplit(":", 1)[0] for text in points)]
    why = [*result.left_out.values(), *("residual" + text.rsplit(":", 1)[-1] for text in points)]
    if not what:
        return Html("<p>Everything was used.</p>")
    rest = len(result.quality.rejected) - len(points)
    more = f"; {rest} more points are in rejected.csv" if rest else ""
    links = [f"#{marks[name]}" if name in marks else "" for name in what]
    listed = TableView(f"What was not used{more}", (TableColumn("what", what, links=links), TableColumn("why", why)))
    return table_under_name(listed)


def text_table(report: CalibrationReport) -> Html:
    """Return what must be known beside the numbers: board, datum, units, meaning of sigma."""
    rows = [(name.replace("_", " "), text) for name, text in report.summary.texts.items()]
    return table(("", ""), rows)
