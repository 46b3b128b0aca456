"""Views of a calibration: maps over the image, photos with their residuals, the radial profile, the network."""

from dataclasses import replace

import numpy as np

from calibration.camera.files.findings import PhotoResult
from calibration.camera.files.result import Result
from calibration.camera.report import stills
from heliogauge.images.thumbnails import decode_thumbnail
from heliogauge.reporting.look import FAINT, LINE_X, LINE_Y
from heliogauge.results.thumbnails import MOST_THUMBNAILS
from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView
from heliogauge.view.image_maps import residual_layers
from heliogauge.view.maps import MapLayer, MapView
from heliogauge.view.photos import Photo, PhotoMarks, PhotoView
from heliogauge.view.scenes import SceneGroup, SceneView

#: Pyramids of the cameras are so large a share of the board's distance.
_CAMERA_SHARE = 0.12


def lens_map(result: Result) -> MapView:
    """Return where the board was, what is left there, how sure lines of sight are, and what the lens does."""
    sigma = result.sigma
    pixels = np.concatenate([photo.pixels_px[photo.used] for photo in result.photos])
    residuals = np.concatenate([photo.residuals_px[photo.used] for photo in result.photos])
    left = residual_layers(pixels, residuals, sigma.x_px, sigma.y_px)
    layers = (
        MapLayer("sigma_ray", "Sigma of lines of sight", "mrad", sigma.sigma_free_rad, 1e3, diverging=False, low=0.0),
        *left,
        MapLayer("projection", "Sigma of projection", "px", sigma.sigma_projection_px, diverging=False, low=0.0),
        *_distortion_layers(result),
    )
    note = (
        f"Sigma of lines of sight: best common rotation taken out. Points in {result.coverage.share:.0%} of the "
        f"image's cells, out to {result.coverage.radius_share:.0%} of the way to its corners; beyond, the lens is "
        "extrapolated."
    )
    view = _image_map("Over the image", sigma.x_px, sigma.y_px, layers, note)
    return replace(view, stills=[stills.residuals(result), view.layer_still("sigma_ray")])


def _distortion_layers(result: Result) -> tuple[MapLayer, ...]:
    """Return how far distortion and skew move the image of each line of sight from an ideal camera's."""
    camera, sigma = result.camera, result.sigma
    x, y = np.meshgrid(sigma.x_px, sigma.y_px)
    rays = camera.cast_rays(np.stack([x, y], axis=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        ideal_x = camera.center_x_px + camera.focal_x_px * rays[..., 0] / rays[..., 2]
        ideal_y = camera.center_y_px + camera.focal_y_px * rays[..., 1] / rays[..., 2]
    return (
        MapLayer("distortion_x", "Distortion in x", "px", x - ideal_x),
        MapLayer("distortion_y", "Distortion in y", "px", y - ideal_y),
        MapLayer("distortion", "Distortion", "px", np.hypot(x - ideal_x, y - ideal_y), diverging=False, low=0.0),
    )


def _image_map(name: str, x_px: FloatArray, y_px: FloatArray, layers: tuple[MapLayer, ...], note: str) -> MapView:
    shape = y_px.size, x_px.size
    flags, aperture = np.zeros(shape, dtype=np.uint32), np.ones(shape, dtype=bool)
    return MapView(name, x_px, y_px, layers, flags, aperture, note=note, axis_unit="px", y_down=True)


def comparison_map(result: Result) -> MapView | None:
    """Return the angles between the lines of sight of both calibrations; None where there is no other."""
    one = result.comparison
    if one is None:
        return None
    layers = [
        MapLayer("angle", "Angle", "mrad", one.angle_rad, 1e3, one.sigma_rad, diverging=False, low=0.0),
        MapLayer("with_rotation", "Angle with rotation", "mrad", one.raw_angle_rad, 1e3, diverging=False, low=0.0),
    ]
    if np.any(one.sigma_rad):
        ratio = one.angle_rad / np.where(one.sigma_rad > 0, one.sigma_rad, np.nan)
        layers.insert(1, MapLayer("over_sigma", "Angle over its sigma", "", ratio, diverging=False, low=0.0))
    note = (
        f"Best rotation taken out: RMS {1e3 * one.rms_rad:.2g} mrad, expected {1e3 * one.expected_rad:.2g} mrad. Over "
        "its sigma, 1 to 2 is chance."
    )
    return _image_map("Difference from the other calibration", one.x_px, one.y_px, tuple(layers), note)


def photo_marks(result: Result) -> dict[str, str]:
    """Return the place in the page of each photo that is shown: the largest residuals first, then those left out."""
    worst = sorted(result.photos, key=lambda photo: -photo.rms_px)
    names = [*(photo.name for photo in worst), *result.left_out][:MOST_THUMBNAILS]
    return {name: f"photo-{number}" for number, name in enumerate(names, start=1)}


def photo_view(result: Result) -> PhotoView:
    """Return the photos with the points of the board that were used, refused, and those where no board was found."""
    own = {photo.name: photo for photo in result.photos}
    shown = []
    for name, mark in photo_marks(result).items():
        photo = own.get(name)
        data = result.thumbnails.get(name)
        image = None if data is None else decode_thumbnail(data)
        shown.append(
            Photo(
                name,
                result.camera.width_px,
                result.camera.height_px,
                image,
                () if photo is None else _marks(result, photo),
                note=f"left out: {result.left_out.get(name, '')}" if photo is None else _note(photo),
                mark=mark,
            )
        )
    return PhotoView("Photos with the board's points", tuple(shown))


def _note(photo: PhotoResult) -> str:
    apart = "" if not np.isfinite(photo.kept_apart_px) else f", kept apart {photo.kept_apart_px:.4f} px"
    return f"{int(photo.used.sum())} points, RMS residual {photo.rms_px:.4f} px{apart}"


def _marks(result: Result, photo: PhotoResult) -> tuple[PhotoMarks, ...]:
    names, used = result.shape.board.names, photo.used
    # Arrows point from the prediction to the measurement.
    residuals = -photo.residuals_px[used]
    labels = [
        f"{names[i]}: {size:.4f} px"
        for i, size in zip(photo.index[used], np.linalg.norm(residuals, axis=1), strict=True)
    ]
    refused = [f"{names[i]}: contradicts the other points" for i in photo.index[~used]]
    return (
        PhotoMarks("used", photo.pixels_px[used], LINE_X, labels, residuals),
        PhotoMarks("refused", photo.pixels_px[~used], LINE_Y, refused, refused=True),
    )


def profile_chart(result: Result) -> ChartView:
    """Return the radial distortion with its band, and how far out points were measured."""
    profile = result.profile
    seen = float(np.interp(profile.seen_px, profile.radius_px, profile.sigma_px))
    ends = np.array([float(np.min(profile.shift_px)), float(np.max(profile.shift_px))])
    return ChartView(
        "Radial distortion",
        "distance from the principal point [px]",
        "shift outwards [px]",
        (
            ChartSeries("shift", profile.radius_px, profile.shift_px, LINE_X, sigma=2 * profile.sigma_px),
            ChartSeries("farthest measured point", np.full(2, profile.seen_px), ends, FAINT, dashed=True),
        ),
        f"band: 2 sigma, {2 * seen:.2g} px at the farthest measured point",
    )


def network_view(result: Result) -> SceneView:
    """Return the board and the cameras around it, with the board's departure enlarged."""
    shape = result.shape
    drawn = shape.board.points_m[shape.seen]
    size = max(float(np.linalg.norm(np.ptp(shape.points_m, axis=0))), 1e-12)
    groups = [SceneGroup("points of the board", shape.points_m, [LINE_X], labels=_point_labels(result))]
    departure = shape.departure_m
    largest = float(np.linalg.norm(departure, axis=1).max(initial=0.0))
    if shape.has_drawing and largest > 0:
        factor = float(f"{0.1 * size / largest:.1g}")
        ends = np.stack([drawn, drawn + factor * departure], axis=1).reshape(-1, 3)
        name = f"departure from the drawing, {factor:g} times"
        groups.append(SceneGroup(name, ends, [LINE_Y], lengths=(2,) * len(drawn), size_px=1.5))
    vertices, centers, labels = [], [], []
    for photo in result.photos:
        lines = _pyramid(result, photo)
        vertices.append(lines)
        centers.append(lines[5])
        labels.append(f"{photo.name}: {_note(photo)}")
    lengths = (9, 3) * len(result.photos)
    groups.append(SceneGroup("cameras", np.concatenate(vertices), ["#7d8894"], lengths=lengths, size_px=1.0))
    groups.append(SceneGroup("projection centres", np.array(centers), ["#7d8894"], labels=labels))
    note = "A camera's roof is over the top edge of its image: turned cameras separate the principal point from poses."
    pictures = [stills.board(result), *([stills.board_sigma(result)] if shape.sigma_m.any() else [])]
    return SceneView("Board and cameras", tuple(groups), note, height_px=440, stills=pictures)


def _point_labels(result: Result) -> list[str]:
    shape = result.shape
    factor, unit = (1e3, "mm") if shape.board.is_metric else (1.0, "pitches")
    sigma = factor * np.sqrt((shape.sigma_m**2).sum(axis=1))
    return [
        f"{shape.board.names[i]}: sigma {s:.2g} {unit}, {n} photos"
        for i, s, n in zip(shape.seen, sigma, shape.n_rays, strict=True)
    ]


def _pyramid(result: Result, photo: PhotoResult) -> FloatArray:
    """Return a camera as lines over its image, with a roof over the image's top edge, shape (12, 3)."""
    camera = result.camera
    depth = _CAMERA_SHARE * float(np.linalg.norm(photo.cam_from_board.translation_m))
    x, y = depth * camera.width_px / camera.focal_x_px / 2, depth * camera.height_px / camera.focal_y_px / 2
    corners = np.array([[-x, -y, depth], [x, -y, depth], [x, y, depth], [-x, y, depth]])
    zero, roof = np.zeros(3), np.array([0.0, -1.5 * y, depth])
    outline = [*corners, corners[0], zero, corners[1], roof, corners[0], corners[2], zero, corners[3]]
    return photo.cam_from_board.inverse().apply(np.array(outline))
