"""The surface in a network's report: deviations, slope maps, canting, displacements; empty where none was asked for."""

import html

import numpy as np

from heliogauge.reporting.html import Html, join, table_under_name
from heliogauge.reporting.look import FAINT, LINE_Y, nice_ceiling
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import facet_names, read_slope_map, read_table_csv
from heliogauge.validate import FloatArray
from heliogauge.view.scenes import ColorScale, SceneGroup, SceneView
from heliogauge.view.stills import fitted_sheet, side_by_side
from heliogauge.view.tables import TableColumn, TableView
from photogrammetry.report.network import NetworkResults
from photogrammetry.report.tables import MOST_ROWS, digits_for, number_column

#: The longest arrow is drawn as this share of the picture.
_ARROW_SHARE = 0.12

Columns = dict[str, list[str]]


def surface(results: NetworkResults) -> Html:
    """Return the section of the surface with its heading; nothing without one."""
    pieces = [section(results) for section in (_deviations, _slopes, _canting, _comparison)]
    found = [one for one in pieces if one.text]
    return join(Html("<h2>Surface</h2>"), *found) if found else Html("")


def surface_points(results: NetworkResults) -> Html:
    """Return the deviation of each point, the largest first; nothing without a surface."""
    columns = _columns(results, "surface.csv")
    if columns is None:
        return Html("")
    deviation, sigma = 1e3 * _numbers(columns, "deviation_m", "sigma_deviation_m").T
    order = np.argsort(-np.nan_to_num(np.abs(deviation)), kind="stable")[:MOST_ROWS]
    digits = digits_for(sigma)
    chosen = [[columns[name][i] for i in order] for name in ("id", "facet", "reason")]
    listed = TableView(
        "Deviations from the surface, the largest first",
        (
            TableColumn("point", chosen[0]),
            TableColumn("facet", chosen[1]),
            number_column("deviation [mm]", deviation[order], digits),
            number_column("sigma [mm]", sigma[order], digits),
            number_column("deviation / sigma", deviation[order] / sigma[order], 1),
            TableColumn("not used, why", chosen[2]),
        ),
        most_rows=15,
    )
    return table_under_name(listed)


def _columns(results: NetworkResults, name: str) -> Columns | None:
    path = results.folder / name
    return read_table_csv(path) if path.is_file() else None


def _numbers(columns: Columns, *names: str) -> FloatArray:
    """Return columns as numbers, shape (n, k)."""
    return np.array([[float(cell) if cell else np.nan for cell in columns[name]] for name in names]).T


def _text(value: float, sigma: float) -> str:
    return number_text(float(value), float(sigma), "")


def _deviations(results: NetworkResults) -> Html:
    columns = _columns(results, "surface.csv")
    if columns is None:
        return Html("")
    places, deviation = _numbers(columns, "x_m", "y_m", "z_m"), _numbers(columns, "deviation_m")[:, 0]
    used = _numbers(columns, "used")[:, 0] > 0
    limit = max(float(np.abs(deviation[used]).max(initial=0.0)), 1e-12)
    extent = float(np.linalg.norm(np.ptp(places, axis=0)))
    factor = nice_ceiling(0.08 * extent / limit)
    # Seen from the front the normal is near z; that is enough for a picture of what is enlarged so much.
    moved = places + np.stack([0 * deviation, 0 * deviation, factor * deviation], axis=1)
    labels = [f"{name}: {1e3 * value:+.4f} mm" for name, value in zip(columns["id"], deviation, strict=True)]
    scale = ColorScale(-1e3 * limit, 1e3 * limit, "mm", diverging=True)
    groups = [
        SceneGroup(
            f"deviation, {factor:g} times",
            np.stack([places, moved], axis=1).reshape(-1, 3),
            [FAINT],
            lengths=(2,) * len(places),
            size_px=1.0,
        ),
        SceneGroup(
            "points, coloured by deviation",
            moved[used],
            scale.colors(1e3 * deviation[used]),
            labels=[labels[i] for i in np.nonzero(used)[0]],
            size_px=7,
            scale=scale,
        ),
        SceneGroup(
            "points not used", moved[~used], [LINE_Y], labels=[labels[i] for i in np.nonzero(~used)[0]], size_px=9
        ),
    ]
    sigma = 1e3 * float(np.median(_numbers(columns, "sigma_deviation_m")))
    note = (
        f"Along the normal, red towards the viewer, up to {1e3 * limit:.3g} mm; RMS "
        f"{1e3 * np.sqrt(np.mean(deviation[used] ** 2)):.4f} mm, median sigma {sigma:.4f} mm."
    )
    shown = tuple(group for group in groups if len(group.xyz_m))
    return join(SceneView("Deviation from the surface", shown, note, height_px=420))


def _slopes(results: NetworkResults) -> Html:
    path = results.folder / "slope_map.nc"
    if not path.is_file():
        return Html("")
    from heliogauge.view.maps import slope_map_view

    whole = read_slope_map(path)
    names = facet_names(path)
    words = f"<p>Taken out: {html.escape(whole.removed)}.</p>"
    words += f"<p>Maps of {len(names)} facets in one.</p>" if names else ""
    return join(Html("<h3>Slope error</h3>" + words), slope_map_view(whole, results.summary.name))


def _canting(results: NetworkResults) -> Html:
    columns = _columns(results, "canting.csv")
    if columns is None:
        return Html("")

    def column(name: str, key: str, factor: float) -> TableColumn:
        values, sigmas = factor * _numbers(columns, f"{key}", f"sigma_{key}").T
        texts = [_text(v, s) if np.isfinite(v) else "" for v, s in zip(values, sigmas, strict=True)]
        return TableColumn(name, texts, values.tolist())

    listed = TableView(
        "Canting",
        (
            TableColumn("facet", columns["facet"]),
            number_column("points", _numbers(columns, "n_points")[:, 0], 0),
            column("canting x [mrad]", "canting_x_rad", 1e3),
            column("canting y [mrad]", "canting_y_rad", 1e3),
            column("piston [mm]", "piston_m", 1e3),
            column("focal length or radius [m]", "length_m", 1.0),
        ),
        most_rows=15,
    )
    words = "<h3>Canting</h3><p>Of the normal: slope of the facet beyond the design's, in x and y.</p>"
    points = _columns(results, "surface.csv")
    drawn = Html("") if points is None else canting_still(columns, points)
    return join(Html(words), drawn, listed)


def canting_still(columns: Columns, points: Columns) -> Html:
    """Draw the canting of each facet as an arrow where the facet is.

    columns, points: ``canting.csv`` and ``surface.csv``.
    Returns: The picture; an arrow to the right is a surface that rises to the right.
    """
    xy, owner = _numbers(points, "x_m", "y_m"), np.array(points["facet"])
    centers = np.array([xy[owner == name].mean(axis=0) for name in columns["facet"]])
    turns = 1e3 * _numbers(columns, "canting_x_rad", "canting_y_rad")
    longest = nice_ceiling(max(float(np.nanmax(np.linalg.norm(turns, axis=1), initial=0.0)), 1e-6))
    width = float(np.ptp(xy, axis=0).max())
    scale = _ARROW_SHARE * width / longest
    note = f"arrows point where a facet rises more than its design; {longest:g} mrad is {_ARROW_SHARE:.0%} of the width"
    room = 0.5 * _ARROW_SHARE * width
    limits = [(float(one.min()) - room, float(one.max()) + room) for one in xy.T]
    sheet = fitted_sheet(limits[0], limits[1], bar=False)
    sheet.title("Canting of the facets", note)
    sheet.axes("x [m], seen from the front", "y [m]", grid=True)
    sheet.dots(xy[:, 0], xy[:, 1], [FAINT], size_px=2.5)
    sheet.arrows(centers[:, 0], centers[:, 1], scale * turns[:, 0], scale * turns[:, 1], LINE_Y, width=2.0)
    for name, center in zip(columns["facet"], centers, strict=True):
        x, y = float(sheet.place_x(center[0])), float(sheet.place_y(center[1]))
        sheet.write(x, y + 13, name, text_anchor="middle", font_size=10)
    return side_by_side([sheet.html(f"Canting of the facets. {note}")])


def _comparison(results: NetworkResults) -> Html:
    columns = _columns(results, "comparison.csv")
    if columns is None:
        return Html("")
    values = 1e3 * _numbers(columns, "dx_m", "dy_m", "dz_m", "sigma_dx_m", "sigma_dy_m", "sigma_dz_m")
    moved = _numbers(columns, "moved")[:, 0] > 0
    place = {name: i for i, name in enumerate(results.points.ids)}
    ends = results.points.xyz_m[[place[name] for name in columns["id"]]]
    steps = 1e-3 * values[:, :3]
    longest = max(float(np.linalg.norm(steps, axis=1).max(initial=0.0)), 1e-12)
    factor = nice_ceiling(_ARROW_SHARE * float(np.ptp(ends, axis=0).max()) / longest)
    sizes = np.linalg.norm(values[:, :3], axis=1)
    labels = [f"{name}: {size:.4f} mm" for name, size in zip(columns["id"], sizes, strict=True)]
    groups = []
    for which, name, color in ((~moved, "within chance", FAINT), (moved, "moved", LINE_Y)):
        own = np.nonzero(which)[0]
        if own.size:
            lines = np.stack([ends[own] - factor * steps[own], ends[own]], axis=1).reshape(-1, 3)
            title = f"{name}, {factor:g} times"
            groups.append(SceneGroup(title, lines, [color], lengths=(2,) * own.size, size_px=2.0))
            groups.append(SceneGroup(name, ends[own], [color], labels=[labels[i] for i in own]))
    order = [int(i) for i in np.argsort(-sizes, kind="stable") if moved[i]]
    listed = TableView(
        "Targets that moved",
        (
            TableColumn("moved", [columns["id"][i] for i in order]),
            *(
                TableColumn(
                    f"d{'xyz'[k]} [mm]",
                    [_text(values[i, k], values[i, 3 + k]) for i in order],
                    [float(values[i, k]) for i in order],
                )
                for k in range(3)
            ),
            number_column("by chance", _numbers(columns, "probability")[order, 0], 4),
        ),
        most_rows=15,
    )
    note = f"Now minus before; {int(moved.sum())} of {moved.size} moved significantly."
    view = SceneView("Displacements since the other date", tuple(groups), note, height_px=420)
    found = listed if order else Html("<p>No target moved significantly.</p>")
    return join(Html("<h3>Since the other date</h3>"), view, found)
