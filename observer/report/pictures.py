"""What the camera saw, in a trough's report: photos with what was found, slices of the mirror through all of them."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from heliogauge.images.thumbnails import decode_thumbnail
from heliogauge.reporting.html import Html, beside, join
from heliogauge.reporting.look import FAINT, INK, LINE_X
from heliogauge.results.folder import read_table_csv
from heliogauge.results.thumbnails import read_thumbnails
from heliogauge.validate import BoolArray, FloatArray
from heliogauge.view.charts import ChartImage, ChartSeries, ChartView, Mark
from heliogauge.view.contours import zero_lines
from heliogauge.view.photos import Photo, PhotoLines, PhotoMarks, PhotoView, refused_marks
from observer.files import NETWORK_FOLDER, OVERLAY, StoredOverlay, read_overlay
from observer.report.results import TroughResults, numbers
from observer.report.scene import mirror_lines
from observer.selection.edge_refusal import FATE_TEXTS, EdgeFate

_MRAD = 1e3
#: Colours that stay apart from grey brightness and from each other.
_DESIGN, _MEASURED = "#ffb000", "#00b7eb"
_LOWER, _UPPER, _REJECTED = "#00b7eb", "#ffb000", "#e4572e"
#: Edges shown in one photo; a flight of 500 photos has 100,000.
_MOST_EDGES = 600
#: Pixels of a slice in the page: as many as a chart has, and the grey of what a photo does not show.
_MOST_COLUMNS, _MOST_ROWS = 500, 400
_NOT_SEEN = 201


def photos(results: TroughResults) -> Html:
    """Return photos with the outline of the tube's reflection, edges, targets and what was refused and why.

    Returns: A view; a sentence where the folder holds no photo.
    """
    view = photo_view(results)
    if view is None:
        return Html("<p>The folder holds no photo.</p>")
    note = (
        "Dark or bright band: the absorber as the mirror shows it. Where the two outlines of the first photo part, "
        "mirror or absorber are not as designed; where the measured one leaves the band, the result would be wrong. "
        "Gaps in it: not measured. In the other photos: edges of the band that were found, and targets with "
        "what remains of their places."
    )
    return join(view, Html(f'<p class="caption">{note}</p>'))


def photo_view(results: TroughResults) -> PhotoView | None:
    """Return the photos as a view, the one with outlines first; None without any."""
    found = []
    if (results.base.folder / OVERLAY).is_file():
        found.append(_outlined(read_overlay(results.base.folder)))
    thumbnails = read_thumbnails(results.base.folder / NETWORK_FOLDER, results.photos)
    if thumbnails:
        outline = mirror_lines(results.collector)
        targets, refused = _target_marks(results), _refused_targets(results)
        for name, data in thumbnails.items():
            image = decode_thumbnail(data)
            if image is None:
                continue
            marks = (*_edge_marks(results, name), *targets.get(name, ()), *([refused[name]] if name in refused else []))
            found.append(_with_marks(results, name, image, marks, outline))
    if not found:
        return None
    view = PhotoView("Photos with what was found in them", tuple(found))
    # On paper: the outlines, and the edges and targets of one photo.
    return replace(view, stills=[view.photo_still(number) for number in range(min(2, len(found)))])


def _outlined(stored: StoredOverlay) -> Photo:
    """Return the photo that gave most edges with the outlines of the reflection, predicted and as measured."""
    rows, columns = stored.image.shape
    lines = []
    for kind, color, words in (
        ("design", _DESIGN, "mirror and absorber as designed"),
        ("measured", _MEASURED, "mirror and absorber as measured"),
    ):
        found = zero_lines(stored.nodes["x_px"], stored.nodes["y_px"], stored.nodes[f"beside_{kind}"])
        lines.append(PhotoLines(words, found, color))
    note = "part of the photo; lines: where the reflected line of sight touches the tube"
    return Photo(f"{stored.photo}, outlines", columns, rows, stored.image, lines=tuple(lines), note=note)


def _with_marks(
    results: TroughResults,
    name: str,
    image: npt.NDArray[np.uint8],
    marks: tuple[PhotoMarks, ...],
    outline: tuple[FloatArray, tuple[int, ...]],
) -> Photo:
    camera = results.base.cameras[results.poses[name].camera]
    vertices, lengths = outline
    places = _in_photo(results, name, vertices)
    pieces = [one for one in np.split(places, np.cumsum(lengths)[:-1]) if np.isfinite(one).all()]
    counts = ", ".join(f"{len(one.xy_px)} {one.name}" for one in marks)
    return Photo(
        name,
        camera.width_px,
        camera.height_px,
        image,
        marks,
        (PhotoLines("panels as designed", pieces, FAINT),),
        counts or "nothing was found",
        mark=f"photo-{name}",
    )


def _in_photo(results: TroughResults, name: str, points_m: FloatArray) -> FloatArray:
    """Return where points of the trough are in a photo, shape (n, 2) [px]."""
    pose = results.poses[name]
    return np.asarray(results.base.cameras[pose.camera].project(pose.cam_from_world.apply(points_m)))


def _edge_marks(results: TroughResults, name: str) -> tuple[PhotoMarks, ...]:
    """Return the edges of the reflection in a photo: both sides, and those that were not used."""
    edges = results.edges
    own = np.flatnonzero(edges.photo == results.photos.index(name))
    used, side = edges.used[own], edges.side[own]
    kinds = (
        ("lower edges", used & (side < 0), _LOWER, False),
        ("upper edges", used & (side > 0), _UPPER, False),
        ("edges not used", ~used, _REJECTED, True),
    )
    marks = []
    for words, chosen, color, refused in kinds:
        rows = own[chosen]
        rows = rows[:: max(1, -(-rows.size // _MOST_EDGES))]
        x, y = edges.x_m[rows], edges.y_m[rows]
        points = np.stack([x, y, results.collector.surface.height(x, y)], axis=1)
        residuals = _MRAD * edges.residual_rad[rows]
        labels = [
            FATE_TEXTS[EdgeFate[str(edges.fate[row]).upper()]]
            if refused
            else f"x {edges.x_m[row]:.2f} m, y {edges.y_m[row]:.2f} m: residual {residual:+.3f} mrad"
            for row, residual in zip(rows, residuals, strict=True)
        ]
        if rows.size:
            marks.append(PhotoMarks(words, _in_photo(results, name, points), color, labels, refused=refused))
    return tuple(marks)


def _target_marks(results: TroughResults) -> dict[str, list[PhotoMarks]]:
    """Return the targets of each photo with their residuals."""
    path = results.base.folder / NETWORK_FOLDER / "residuals.csv"
    if not path.is_file():
        return {}
    names = ("x_px", "y_px", "residual_x_px", "residual_y_px")
    table = read_table_csv(path, ("image", "target", *names))
    x, y, dx, dy = (numbers(table, name) for name in names)
    images, targets = np.array(table["image"]), np.array(table["target"])
    found = {}
    for image in dict.fromkeys(table["image"]):
        own = images == image
        # Stored is what the model adds to the measured place; arrows lead from the prediction to the measurement.
        residual = -np.stack([dx, dy], axis=1)[own]
        sizes = np.linalg.norm(residual, axis=1)
        labels = [f"{target}: {size:.4f} px" for target, size in zip(targets[own], sizes, strict=True)]
        found[image] = [PhotoMarks("targets", np.stack([x, y], axis=1)[own], LINE_X, labels, residual)]
    return found


def _refused_targets(results: TroughResults) -> dict[str, PhotoMarks]:
    """Return the targets that were refused, where their places are known."""
    path = results.base.folder / NETWORK_FOLDER / "rejected.csv"
    if not path.is_file():
        return {}
    table = read_table_csv(path, ("name", "reason", "image", "x_px", "y_px"))
    return refused_marks("targets not used", table, _REJECTED)


def slices(results: TroughResults) -> Html:
    """Return slices of the mirror through all photos, and what each edge says of the angle there.

    Returns: Two charts of each slice.
    """
    drawn = [
        beside(slice_view(results, number), angle_view(results, number)) for number in range(len(results.slices.y_m))
    ]
    note = (
        "Left: one row of the mirror in every photo, one photo above the other; the band is the absorber's reflection, "
        "which moves across the mirror as the camera moves. Right: every edge alone (dots) and the solution (line with "
        "a band of 1 sigma of its noise). Dots on one line, of both edges alike: the measurement agrees with itself."
    )
    return join(*drawn, Html(f'<p class="caption">{note}</p>'))


def slice_view(results: TroughResults, number: int) -> ChartView:
    """Return one row of the mirror in all photos with the edges that were found.

    Returns: Brightness over place across the mirror and place of the camera.
    """
    stored, edges = results.slices, results.edges
    order = np.argsort(stored.eyes_m[:, 0], kind="stable")
    camera = stored.eyes_m[order, 0]
    here = _in_row(results, float(stored.y_m[number]))
    place = results.eyes_m[edges.photo, 0]
    kinds = (
        ("lower edge", edges.used & (edges.side < 0), _LOWER),
        ("upper edge", edges.used & (edges.side > 0), _UPPER),
        ("not used", ~edges.used, _REJECTED),
    )
    series = []
    for words, chosen, color in kinds:
        own = here & chosen
        if own.any():
            labels = [_edge_label(results, row) for row in np.flatnonzero(own).tolist()]
            name = f"{words} ({int(own.sum())})"
            series.append(ChartSeries(name, edges.x_m[own], place[own], color, Mark.POINTS, labels=labels, size_px=2.5))
    return ChartView(
        f"The absorber's reflection at y = {stored.y_m[number]:.2f} m",
        "x on the mirror [m]",
        "camera, x [m]",
        tuple(series),
        f"{camera.size} photos; brightness, and edges that were found",
        background=_brightness(stored.brightness[number][order], stored.x_m, camera),
    )


def _edge_label(results: TroughResults, row: int) -> str:
    edges = results.edges
    photo = results.photos[edges.photo[row]]
    if not edges.used[row]:
        return f"{photo}: {FATE_TEXTS[EdgeFate[str(edges.fate[row]).upper()]]}"
    return f"{photo}: residual {_MRAD * edges.residual_rad[row]:+.3f} mrad"


def _brightness(rows: npt.NDArray[np.uint8], x_m: FloatArray, camera_m: FloatArray) -> ChartImage:
    """Return the rows of a slice, one above the other at the places of their cameras.

    rows (n, m): Brightness; zero where the photo does not show the mirror.
    camera_m (n,): Ascending.
    """
    across, along = _borders(x_m), _borders(camera_m)
    shown = rows[:, :: max(1, rows.shape[1] // _MOST_COLUMNS)]
    height = min(4 * camera_m.size, _MOST_ROWS)
    middles = along[0] + (np.arange(height) + 0.5) / height * (along[-1] - along[0])
    picture = shown[np.clip(np.searchsorted(along, middles, "right") - 1, 0, camera_m.size - 1)]
    seen = picture[picture > 0]
    high = float(np.percentile(seen, 99.5)) if seen.size else 255.0
    grey = np.clip(255 / max(high, 1.0) * picture.astype(np.float64), 0, 255)
    # From the top, where the camera is farthest along x.
    image = np.where(picture > 0, grey, _NOT_SEEN)[::-1].astype(np.uint8)
    return ChartImage(image, (float(across[0]), float(across[-1]), float(along[0]), float(along[-1])))


def angle_view(results: TroughResults, number: int) -> ChartView:
    """Return what each edge of one slice says of the reflector-absorber angle, and the solution [mrad]."""
    y = float(results.slices.y_m[number])
    slope_map, edges = results.base.slope_map, results.edges
    row = int(np.argmin(np.abs(slope_map.y_m - y)))
    theta = np.where(slope_map.valid[row], results.angles["theta_ra"][row], np.nan)
    band = np.where(np.isfinite(theta), slope_map.sigma_random_x[row], np.nan)
    here = edges.used & _in_row(results, y)
    alone = np.interp(edges.x_m, slope_map.x_m, theta) - 0.5 * edges.residual_rad
    rms = float(np.sqrt(np.mean(edges.residual_rad[here] ** 2))) if here.any() else float("nan")
    series = [
        ChartSeries("solution", slope_map.x_m, _MRAD * theta, INK, sigma=_MRAD * band),
        *(
            ChartSeries(label, edges.x_m[own], _MRAD * alone[own], color, Mark.POINTS, size_px=4.0)
            for label, color, own in (
                ("lower edge", _LOWER, here & (edges.side < 0)),
                ("upper edge", _UPPER, here & (edges.side > 0)),
            )
        ),
    ]
    return ChartView(
        f"Reflector-absorber angle at y = {y:.2f} m",
        "x on the mirror [m]",
        "theta_ra [mrad], + to +x",
        tuple(one for one in series if len(one.x)),
        f"dots: each edge alone, RMS {0.5 * _MRAD * rms:.3f} mrad about the line",
    )


def _in_row(results: TroughResults, y_m: float) -> BoolArray:
    """Return which edges belong to a row of the map; poses that were adjusted later move them a little."""
    rows = results.base.slope_map.y_m
    half = 0.5 * float(rows[1] - rows[0]) if rows.size > 1 else np.inf
    return np.asarray(np.abs(results.edges.y_m - y_m) < half)


def _borders(middles: FloatArray) -> FloatArray:
    """Return the borders of cells around their middles, shape (n + 1,); cells of no width stay invisible."""
    if middles.size < 2:
        return np.array([middles[0] - 0.5, middles[0] + 0.5])
    inner = 0.5 * (middles[1:] + middles[:-1])
    # A pass with a pause has a wide gap: cells reach no further than half the usual step beyond the last photo.
    return np.concatenate([[2 * middles[0] - inner[0]], inner, [2 * middles[-1] - inner[-1]]])
