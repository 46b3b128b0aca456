"""Charts and photos to look into, of a heliostat's calibration and of a field."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.heliostat.files.beam_files import BEAMS_FILE, PICTURE_COLUMNS, PICTURES_FILE
from calibration.heliostat.report import figures_residuals as figures
from calibration.heliostat.report.results import FieldReport, HeliostatReport, ResidualTable
from heliogauge.images.thumbnails import decode_thumbnail
from heliogauge.reporting.look import FAINT, INK, LINE_X, LINE_Y
from heliogauge.results.folder import read_table_csv
from heliogauge.results.thumbnails import read_thumbnails
from heliogauge.validate import BoolArray, FloatArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.maps import MapLayer, MapView
from heliogauge.view.photos import Photo, PhotoLines, PhotoMarks, PhotoView

_FRAME_REACH = 0.6
_SHAPE = ("width_major_m", "width_minor_m", "direction_deg")
_SPOT, _AIM = "#c8102e", "#0b6fb8"
#: Viridis from low to high: told apart by the colour-blind.
_CLASSES = ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")
#: Names on the map of a field, besides those of heliostats that need work.
_MOST_NAMES = 40
#: Words, column and colours of fitted and predicted residuals.
_DIRECTIONS = (
    ("to the right", "residual_right_mrad", (LINE_X, "#7fb2d9")),
    ("up", "residual_up_mrad", (LINE_Y, "#e3a083")),
)


def target_view(report: HeliostatReport, name: str) -> ChartView:
    """Return each beam's place on a target and, enlarged, by how much the model misses it."""
    rows, target = report.residuals, report.content["targets"][name]
    arrows = figures.target_arrows(report, name)
    x, y = rows.numbers["measured_x_m"], rows.numbers["measured_y_m"]
    labels = _labels(report)
    half_x, half_y = 0.5 * float(target["width_m"]), 0.5 * float(target["height_m"])
    frame = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * (half_x, half_y)
    # The edges of a target much larger than the spread of the beams would make these small.
    series = [ChartSeries("target", frame[:, 0], frame[:, 1], FAINT)] if arrows.reach > _FRAME_REACH else []
    for group, color, words in figures.groups(rows, arrows.here):
        ends = [start + arrows.factor * step for start, step in ((x, arrows.dx), (y, arrows.dy))]
        lines = [
            np.stack([start[group], end[group], np.full(int(group.sum()), np.nan)], axis=1).ravel()
            for start, end in zip((x, y), ends, strict=True)
        ]
        series.append(ChartSeries(f"to the predicted place, {words}", lines[0], lines[1], color, size_px=1.0))
        shown = [labels[row] for row in np.flatnonzero(group)]
        series.append(ChartSeries(words, x[group], y[group], color, Mark.POINTS, labels=shown, size_px=5.0))
    left_out = arrows.here & ~rows.used
    if left_out.any():
        shown = [labels[row] for row in np.flatnonzero(left_out)]
        series.append(ChartSeries("left out", x[left_out], y[left_out], FAINT, Mark.POINTS, labels=shown, size_px=6.0))
    return ChartView(
        f"Residuals on {name.replace('_', ' ')}",
        "x, to the right as seen from the field [m]",
        "y, up [m]",
        tuple(series),
        arrows.note,
        equal=True,
    )


def first_view(report: HeliostatReport) -> ChartView:
    """Return the residuals on the target that most beams hit; of other observations those in their order."""
    names = figures.targets_hit(report)
    if names:
        return target_view(report, max(names, key=report.residuals.target.count))
    return next(iter(series_views(report).values()))


def series_views(report: HeliostatReport) -> dict[str, ChartView]:
    """Return residuals to the right and up against time, the sun's azimuth and its elevation, as far as known."""
    rows, labels = report.residuals, _labels(report)
    views = {}
    for name, (words, axis, values) in figures.residual_axes(rows).items():
        if np.issubdtype(values.dtype, np.datetime64):
            values = 1e-3 * np.where(np.isnat(values), np.nan, values.astype("datetime64[ms]").astype(float))
        known = np.isfinite(values) & rows.used
        series = []
        for words_of, key, colors in _DIRECTIONS:
            for kind, group, color in zip(
                ("fitted", "predicted"), (known & ~rows.is_test, known & rows.is_test), colors, strict=True
            ):
                if group.any():
                    shown = [labels[row] for row in np.flatnonzero(group)]
                    y = rows.numbers[key][group]
                    series.append(
                        ChartSeries(
                            f"{words_of}, {kind}", values[group], y, color, Mark.POINTS, labels=shown, size_px=5.0
                        )
                    )
        views[name] = ChartView(
            f"Residuals of the beam against {words}",
            axis,
            "measured minus predicted [mrad]",
            tuple(series),
            "as seen from the mirror",
            x_time=name == "time",
        )
    return views


def sky_view(report: HeliostatReport) -> MapView:
    """Return the predicted uncertainty of the beam for each place where the sun can stand."""
    sky = figures.sky_of(report)
    half_a, half_e = sky.halves_deg
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    at = np.argwhere(sky.extrapolated & np.isfinite(sky.sigma_mrad))
    beyond = [corners * (half_a, half_e) + (sky.azimuth_deg[column], sky.elevation_deg[row]) for row, column in at]
    arms = np.array([[-1.0, 0.0], [1.0, 0.0]]), np.array([[0.0, -1.0], [0.0, 1.0]])
    suns = [arm + sun for sun in sky.suns_deg[np.isfinite(sky.suns_deg).all(axis=1)] for arm in arms]
    inside = np.where(sky.extrapolated, np.nan, sky.sigma_mrad)
    layers = tuple(
        MapLayer(key, name, "mrad", values, diverging=False, limit=sky.high_mrad, low=0.0)
        for key, name, values in (
            ("sigma_beam", "Sigma of the beam", sky.sigma_mrad),
            ("sigma_beam_inside", "Sigma of the beam where nothing is extrapolated", inside),
        )
    )
    shape = sky.sigma_mrad.shape
    words = "Azimuth from north, clockwise. Crosses: suns of the observations; boxes: the model is extrapolated."
    note = f"{sky.note}. {words}"
    return MapView(
        "Predicted uncertainty over the sky",
        sky.azimuth_deg,
        sky.elevation_deg,
        layers,
        np.zeros(shape, np.uint32),
        np.ones(shape, np.bool_),
        note=note,
        axis_unit="deg",
        axis_names=("azimuth of the sun", "elevation"),
        lines=(*beyond, *suns),
        stills=[figures.sky_sheet(report).html(f"Predicted uncertainty over the sky. {note}")],
    )


def _labels(report: HeliostatReport) -> list[str]:
    rows = report.residuals
    beam = rows.numbers["residual_beam_mrad"]
    return [
        " ".join(
            filter(
                None,
                (
                    rows.observation[i],
                    "" if np.isnat(rows.time[i]) else f"{str(rows.time[i])[:16]}Z",
                    f"{beam[i]:.2f} mrad" if np.isfinite(beam[i]) else "",
                    rows.reason[i],
                ),
            )
        )
        for i in range(len(rows))
    ]


def pictured(folder: Path) -> dict[str, str]:
    """Return the places in the page of the photos that are shown, by observation."""
    if not (folder / PICTURES_FILE).is_file():
        return {}
    table = read_table_csv(folder / PICTURES_FILE, PICTURE_COLUMNS)
    return {name: f"photo-{name}" for name in table["observation"]}


def beam_view(report: HeliostatReport) -> PhotoView | None:
    """Return the most informative photos with the beam's place, its shape and its predicted place; None without any."""
    marks = pictured(report.folder)
    if not marks:
        return None
    table = read_table_csv(report.folder / PICTURES_FILE, PICTURE_COLUMNS)
    thumbnails = read_thumbnails(report.folder, table["picture"])
    beams = read_table_csv(report.folder / BEAMS_FILE, ("image", *_SHAPE))
    shapes = {name: tuple(_number(beams[key][k]) for key in _SHAPE) for k, name in enumerate(beams["image"])}
    rows = report.residuals
    photos = []
    for k, observation in enumerate(table["observation"]):
        if observation not in rows.observation:
            continue
        row = rows.observation.index(observation)
        plane = _Plane(*(_number(table[name][k]) for name in PICTURE_COLUMNS[4:]))
        data = thumbnails.get(table["picture"][k])
        photos.append(
            Photo(
                f"{observation}: {table['image'][k]}",
                plane.width_px,
                plane.height_px,
                None if data is None else decode_thumbnail(data),
                _beam_marks(rows, row, plane),
                _beam_shape(rows, row, plane, shapes.get(table["image"][k])),
                "; ".join(filter(None, (table["why"][k], rows.reason[row]))),
                marks[observation],
            )
        )
    return PhotoView("Beams in the photos", tuple(photos)) if photos else None


class _Plane(NamedTuple):
    """Edges of a picture on its target [m], and its size [px]."""

    left_m: float
    right_m: float
    low_m: float
    high_m: float
    width_px: float
    height_px: float

    def pixels(self, points_m: FloatArray) -> FloatArray:
        """Return where points of the target are in the picture, shape (n, 2)."""
        across = (points_m[:, 0] - self.left_m) / (self.right_m - self.left_m) * self.width_px
        down = (self.high_m - points_m[:, 1]) / (self.high_m - self.low_m) * self.height_px
        return np.stack([across, down], axis=1) - 0.5


def _place_m(rows: ResidualTable, row: int, kind: str) -> FloatArray:
    return np.array([[rows.numbers[f"{kind}_{axis}_m"][row] for axis in "xy"]])


def _beam_marks(rows: ResidualTable, row: int, plane: _Plane) -> tuple[PhotoMarks, ...]:
    """Return the measured and the predicted place of a beam."""
    residual, refused = rows.numbers["residual_beam_mrad"][row], bool(rows.flag[row])
    words = f"{residual:.2f} mrad from the predicted place" if np.isfinite(residual) else "no residual"
    kinds = (
        ("measured", "left out" if refused else "beam", _SPOT, rows.reason[row] or words, refused),
        ("predicted", "predicted place", _AIM, words, False),
    )
    return tuple(
        PhotoMarks(name, plane.pixels(place), color, [label], refused=crossed)
        for kind, name, color, label, crossed in kinds
        if np.isfinite(place := _place_m(rows, row, kind)).all()
    )


def _beam_shape(
    rows: ResidualTable, row: int, plane: _Plane, shape: tuple[float, ...] | None
) -> tuple[PhotoLines, ...]:
    """Return the ellipse of twice the widths about a beam's place, where both are known."""
    center = _place_m(rows, row, "measured")
    if shape is None or not (np.isfinite(shape).all() and np.isfinite(center).all()):
        return ()
    return (PhotoLines("ellipse of D4-sigma", [plane.pixels(_ellipse(center, *shape))], _SPOT),)


def _number(cell: str) -> float:
    return float(cell) if cell else float("nan")


def _ellipse(center_m: FloatArray, major_m: float, minor_m: float, direction_deg: float) -> FloatArray:
    """Return the ellipse of twice the widths (sigma) about a beam's place, shape (n, 2) [m]."""
    turn, angle = np.radians(direction_deg), np.linspace(0, 2 * np.pi, 61)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return np.asarray(center_m + np.stack([2 * major_m * np.cos(angle), 2 * minor_m * np.sin(angle)], axis=1) @ axes)


# --- the field --------------------------------------------------------------------------------------------------------


def field_view(report: FieldReport) -> ChartView:
    """Return the field from above with names, each heliostat in the colour of its expected error over the sky."""
    rows, (east, north) = report.rows, (report.numbers(name) for name in ("e_m", "n_m"))
    sky, found, expected = (
        report.numbers(name) for name in ("predicted_sky_beam_mrad", "beam_test_rms_mrad", "predicted_sigma_beam_mrad")
    )
    error = np.where(np.isfinite(sky), sky, found)
    known = np.isfinite(error)
    labels = [
        f"{name}: "
        + (f"{error[k]:.2f} mrad expected over the sky" if known[k] else "no model")
        + (f", {found[k]:.2f} found" if np.isfinite(found[k]) else "")
        + (f" where {expected[k]:.2f} were expected" if np.isfinite(expected[k]) else "")
        + (f" ({rows['status'][k]})" if rows["status"][k] not in ("", "ok") else "")
        + (f". {rows['work'][k]}" if rows["work"][k] else "")
        for k, name in enumerate(rows["heliostat"])
    ]
    # Of a large field those that need work and the worst, which come first; there is no room for more.
    named = np.array([bool(text) for text in rows["work"]]) | (np.arange(error.size) < _MOST_NAMES)
    steps = np.linspace(0.0, figures.robust_end(error[known]), len(_CLASSES) + 1)
    place = np.clip(np.searchsorted(steps, error, "right") - 1, 0, len(_CLASSES) - 1)
    size = float(np.clip(60 / np.sqrt(max(error.size, 1)), 4, 12))

    def series(name: str, chosen: BoolArray, color: str) -> ChartSeries:
        at = np.flatnonzero(chosen)
        shown = [labels[k] for k in at]
        names = [rows["heliostat"][k] if named[k] else "" for k in at]
        return ChartSeries(
            name, east[chosen], north[chosen], color, Mark.POINTS, labels=shown, size_px=size, names=names
        )

    drawn = [ChartSeries("origin", np.zeros(1), np.zeros(1), INK, Mark.POINTS, labels=["origin"], size_px=10.0)]
    for k, color in enumerate(_CLASSES):
        last = k + 1 == len(_CLASSES)
        chosen = known & (place == k)
        if chosen.any():
            words = f"above {steps[k]:.3g} mrad" if last else f"{steps[k]:.3g} to {steps[k + 1]:.3g} mrad"
            drawn.append(series(words, chosen, color))
    placed = ~known & np.isfinite(east) & np.isfinite(north)
    if placed.any():
        drawn.append(series("no model", placed, LINE_Y))
    return ChartView(
        "Expected error of each heliostat",
        "east [m]",
        "north [m]",
        tuple(drawn),
        "of the beam, RMS over the sky",
        equal=True,
    )


def distribution_view(report: FieldReport) -> ChartView:
    """Return how many heliostats have which error."""
    beam, normal = report.numbers("beam_test_rms_mrad"), report.numbers("normal_test_rms_mrad")
    end = figures.robust_end(np.concatenate([one[np.isfinite(one)] for one in (beam, normal)]))
    series = []
    for values, color, name in ((beam, LINE_X, "beam"), (normal, LINE_Y, "normal")):
        known = np.sort(values[np.isfinite(values) & (values <= end)])
        if known.size:
            share = 100 * np.arange(1, known.size + 1) / max(int(np.isfinite(values).sum()), 1)
            series.append(ChartSeries(name, known, share, color, Mark.STEPS))
    words = "on positions that were not fitted"
    return ChartView("Errors of the field", "RMS error [mrad]", "share of heliostats [%]", tuple(series), words)
