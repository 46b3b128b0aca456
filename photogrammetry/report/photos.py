"""Photos in a network's report: what was found in each, how far off it is, what was refused and why."""

import numpy as np

from heliogauge.images.thumbnails import decode_thumbnail
from heliogauge.reporting.look import LINE_X, LINE_Y
from heliogauge.results.folder import read_table_csv
from heliogauge.results.thumbnails import read_thumbnails
from heliogauge.validate import FloatArray, IntArray
from heliogauge.view.photos import Photo, PhotoMarks, PhotoView, refused_marks
from photogrammetry.report.network import NetworkResults

#: Image points in a page, in all photos together, and at least in each: 30,000 take 0.6 MB.
_MOST_MARKS, _LEAST_MARKS = 30_000, 200
_LOOSE = "#8a6d3b"


def photo_view(results: NetworkResults) -> PhotoView | None:
    """Return the photos, the largest residuals first, then those that are not in the network; None without any."""
    names = results.shown_photos
    if not names:
        return None
    thumbnails = read_thumbnails(results.folder, names)
    refused = refused_marks("refused", results.tables["rejected"], LINE_Y)
    loose = _loose_marks(results)
    own = _rows_of_photos(results)
    most = max(_LEAST_MARKS, _MOST_MARKS // len(names))
    photos = []
    for name in names:
        pose = results.poses.get(name)
        camera = results.cameras[pose.camera] if pose is not None else results.camera
        marks = [*loose.get(name, ()), *([refused[name]] if name in refused else [])]
        note = "not in the network"
        if pose is not None:
            rows = own[name]
            used, thinning = _used_marks(results, rows, most)
            marks.insert(0, used)
            note = f"{len(rows)} image points, RMS residual {pose.residual_rms_px or 0.0:.4f} px{thinning}"
        image = decode_thumbnail(thumbnails[name]) if name in thumbnails else None
        photos.append(
            Photo(
                name,
                camera.width_px,
                camera.height_px,
                image,
                tuple(marks),
                note=note,
                mark=results.photo_marks[name],
            )
        )
    return PhotoView("Photos with what was found in them", tuple(photos))


def _rows_of_photos(results: NetworkResults) -> dict[str, IntArray]:
    order = np.argsort(results.used.photo, kind="stable")
    parts = np.split(order, np.cumsum(results.counts)[:-1])
    return dict(zip(results.poses, parts, strict=True))


def _used_marks(results: NetworkResults, rows: IntArray, most: int) -> tuple[PhotoMarks, str]:
    """Return the image points of a photo, of many the largest residuals and every n-th of the others."""
    used, thinning = results.used, ""
    sizes = np.linalg.norm(used.residuals_px[rows], axis=1)
    if len(rows) > most:
        order = np.argsort(-sizes, kind="stable")
        few = most // 4
        rest = order[few:]
        kept = np.sort(np.concatenate([order[:few], rest[:: -(-len(rest) // (most - few))]]))
        rows, sizes = rows[kept], sizes[kept]
        thinning = f"; {len(rows)} of them are shown, the largest residuals among them"
    labels = [f"{used.targets[i]}: {size:.4f} px" for i, size in zip(rows, sizes, strict=True)]
    # Arrows point from the prediction to the measurement.
    return PhotoMarks("used", used.pixels_px[rows], LINE_X, labels, -used.residuals_px[rows]), thinning


def _loose_marks(results: NetworkResults) -> dict[str, list[PhotoMarks]]:
    path = results.folder / "unmatched_dots.csv"
    if not path.is_file():
        return {}
    table = read_table_csv(path, ("image", "x_px", "y_px"))
    places, images = _places(table), np.array(table["image"])
    return {
        str(image): [PhotoMarks("without a partner in other photos", places[images == image], _LOOSE, refused=True)]
        for image in np.unique(images)
    }


def _places(table: dict[str, list[str]] | object) -> FloatArray:
    columns = [table[f"{axis}_px"] for axis in "xy"] if isinstance(table, dict) and "x_px" in table else [[], []]
    return np.array([[float(cell) if cell else np.nan for cell in column] for column in columns]).T.reshape(-1, 2)
