"""Report of a screen's geometry: from the files of its results."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deflectometry.screen_geometry.measured_screen import MeasuredScreen
from deflectometry.screen_geometry.pipeline.geometry import POINTS_FILE
from deflectometry.screen_geometry.pipeline.screen_file import read_screen
from heliogauge.errors import InputError
from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join, table
from heliogauge.reporting.look import FAINT, LINE_X, LINE_Y
from heliogauge.reporting.verdict import Verdict, verdict_of
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.scenes import ColorScale, SceneGroup, SceneView

#: A camera's axis is drawn so long, as a share of its distance.
_AXIS_SHARE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class ScreenReport:
    """What a folder of results holds.

    summary: Headline numbers, doubts, texts.
    measured: The screen.
    xyz_m, sigma_m (n, 3): Its points and their sigmas [m].
    labels: What each point is.
    """

    summary: Summary
    measured: MeasuredScreen
    xyz_m: FloatArray
    sigma_m: FloatArray
    labels: tuple[str, ...]

    @property
    def departure_m(self) -> FloatArray:
        """How far the points are off the plane through them, towards the viewer, shape (n,) [m]."""
        terms = np.column_stack([np.ones(len(self.xyz_m)), self.xyz_m[:, :2]])
        plane = np.linalg.lstsq(terms, self.xyz_m[:, 2], rcond=None)[0]
        return np.asarray(self.xyz_m[:, 2] - terms @ plane)


def open_screen(folder: str | Path = ".") -> ScreenReport:
    """Read a folder of results.

    folder: The folder; the working directory without it.
    InputError: Files that are not those of a screen.
    """
    folder = Path(folder)
    columns = read_table_csv(folder / POINTS_FILE)
    names = [name for name in columns if not name.endswith("_m")]
    try:
        xyz, sigma = (
            np.array([[float(cell) for cell in columns[f"{by}{axis}_m"]] for axis in "xyz"]).T for by in ("", "sigma_")
        )
    except (KeyError, ValueError) as error:
        raise InputError(f"{folder / POINTS_FILE}: not the points of a screen ({error!r})") from None
    labels = tuple(
        ", ".join(f"{name} {cell}" for name, cell in zip(names, row, strict=True))
        for row in zip(*(columns[name] for name in names), strict=True)
    )
    return ScreenReport(read_summary(folder / "summary.json"), read_screen(folder), xyz, sigma, labels)


def first_screen(report: ScreenReport) -> Html:
    """Return name, verdict, headline numbers and how the screen is bent."""
    numbers = report.summary.numbers

    def said(key: str, factor: float, unit: str, digits: int) -> str:
        value, sigma = numbers.get(key), numbers.get(f"sigma_{key}")
        if value is None:
            return "not determined"
        more = "" if sigma is None else f" \u00b1 {factor * float(sigma):.2g}"
        return f"{factor * float(value):.{digits}f}{more} {unit}"

    by_axis = " / ".join(f"{1e3 * float(numbers[f'sigma_{axis}_m'] or 0.0):.2g}" for axis in "xyz")
    rows = [
        ("Width", said("width_m", 1e3, "mm", 2), "through the middle"),
        ("Height", said("height_m", 1e3, "mm", 2), "through the middle"),
        (
            "Out of plane",
            said("out_of_plane_rms_m", 1e3, "mm RMS", 2),
            said("out_of_plane_range_m", 1e3, "mm in all", 1),
        ),
        ("Sigma of a point", f"{by_axis} mm", "x, y, z"),
        ("Photos", f"{numbers['photos_count']}", f"{numbers['image_points_count']} image points"),
    ]
    if numbers.get("camera_distance_m") is not None:
        turn, place = (float(numbers[key] or 0.0) for key in ("sigma_camera_rotation_rad", "sigma_camera_place_m"))
        rows.append(
            (
                "Measuring camera",
                f"{float(numbers['camera_distance_m'] or 0.0):.4f} m",
                f"sigma {1e3 * turn:.2g} mrad, {1e3 * place:.2g} mm",
            )
        )
    line = f"{report.summary.texts.get('screen', 'screen')}; heliogauge {report.summary.version}"
    return page.first_screen(report.summary.name, line, verdict(report), rows, bend_chart(report))


def verdict(report: ScreenReport) -> Verdict:
    """Return what was checked and found right, and what is doubtful."""
    codes = {one.code for one in report.summary.doubts}
    passed = ["the photos agree with one network"] if "many_image_points_left_out" not in codes else []
    if "screen_points_off_surface" not in codes:
        passed.append("the points are on the surface stated")
    return verdict_of(report.summary, (), passed)


def bend_chart(report: ScreenReport) -> ChartView:
    """Return how far the points stand out of their mean plane, across and up."""
    away = 1e3 * report.departure_m
    series = [
        ChartSeries(f"over {axis}", report.xyz_m[:, k], away, color, Mark.POINTS, size_px=3)
        for k, (axis, color) in enumerate((("x", LINE_X), ("y", LINE_Y)))
    ]
    return ChartView("Out of the mean plane", "x or y on the screen [m]", "towards the viewer [mm]", tuple(series))


def scene(report: ScreenReport) -> SceneView:
    """Return the points of the screen and the measuring camera."""
    away = 1e3 * report.departure_m
    reach = max(float(np.abs(away).max()), 1e-9)
    scale = ColorScale(-reach, reach, "mm out of plane", diverging=True)
    labels = [
        f"{name}: {value:+.2f} mm, sigma {1e3 * spread[0]:.2f} / {1e3 * spread[1]:.2f} / {1e3 * spread[2]:.2f} mm"
        for name, value, spread in zip(report.labels, away.tolist(), report.sigma_m.tolist(), strict=True)
    ]
    groups = [SceneGroup("points of the screen", report.xyz_m, scale.colors(away), labels=labels, scale=scale)]
    pose = report.measured.cam_from_screen
    if pose is not None:
        place = pose.inverse().translation_m
        axis = place + _AXIS_SHARE * float(np.linalg.norm(place)) * pose.rotation[2]
        groups.append(SceneGroup("measuring camera and its axis", np.stack([place, axis]), [FAINT], lengths=[2]))
    return SceneView("The screen", tuple(groups), "x to the right, y up, z towards the viewer")


#: Errors of which the largest together make this share of the variance of all are shown; the others are folded away.
_SHOWN_SHARE = 0.9


def error_table(report: ScreenReport) -> Html:
    """Return the errors that points and camera share, the largest first; those that hardly matter folded away."""
    u, v = (one.ravel() for one in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)))
    rows = []
    for one in report.measured.shared:
        moved = one.warp.shifts_m(u, v)
        turn, shift = (float(np.linalg.norm(part)) for part in (one.cam_from_screen[:3], one.cam_from_screen[3:]))
        rows.append((*(1e3 * np.sqrt((moved**2).mean(axis=0))).tolist(), 1e3 * turn, 1e3 * shift))
    rows.sort(key=lambda row: -(row[0] ** 2 + row[1] ** 2 + row[2] ** 2))
    heads = ("x [mm RMS]", "y [mm RMS]", "z [mm RMS]", "camera turned [mrad]", "camera moved [mm]")
    if not rows:
        return Html("")
    size = np.array([row[0] ** 2 + row[1] ** 2 + row[2] ** 2 for row in rows])
    shown = int(np.searchsorted(np.cumsum(size) / max(float(size.sum()), 1e-300), _SHOWN_SHARE)) + 1

    def part(first: int, last: int) -> Html:
        texts = [(str(k + 1), *(f"{one:.3g}" for one in rows[k])) for k in range(first, last)]
        return table(("error", *heads), texts, numbers=range(1, 1 + len(heads)))

    largest, count = part(0, shown), len(rows) - shown
    if count <= 0:
        return largest
    words = f"{count} smaller error{'s' if count > 1 else ''}, together {1 - size[:shown].sum() / size.sum():.0%}"
    rest = f"<details><summary>{words} of the variance of all points</summary>{part(shown, len(rows)).text}</details>"
    return join(largest, Html(rest))


def making(report: ScreenReport) -> Html:
    """Return what is said beside the numbers, times and input files."""
    rows = [(name.replace("_", " "), text) for name, text in report.summary.texts.items()]
    return join(page.table(("", ""), rows), page.duration_table(report), page.input_table(report))
