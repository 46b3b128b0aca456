"""Cameras of a network from measurement.toml: start values, what is free, and which photo each took."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from heliogauge.adjust.least_squares import Prior
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.millimetres import LensForm, PrincipalOrigin, Sensor, SensorParameters
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.files.regular import open_regular
from heliogauge.images.exif import EXIF_BYTES, focal_length_35mm
from heliogauge.results.folder import read_camera_json
from heliogauge.validate import FloatArray
from photogrammetry.bundle.problem import CameraModel, ResidualSpace
from photogrammetry.bundle.state import INTRINSIC_NAMES, camera_with_intrinsics, intrinsics_of
from photogrammetry.keys.cameras import MillimetreSection, NetworkCameraSection, camera_of_photos
from photogrammetry.keys.load import PhotogrammetryMeasurement
from photogrammetry.networks.solve_network import NetworkCameras
from photogrammetry.start_values.network import guessed_camera

Sizes = Mapping[str, tuple[int, int]]

_RESIDUALS = {"measured": ResidualSpace.MEASURED, "corrected": ResidualSpace.CORRECTED}
#: Focal lengths in EXIF that differ by more say that the zoom was moved; they are rounded to 1 mm.
_ZOOMED = 0.06


def build_cameras(
    measurement: PhotogrammetryMeasurement, photos: Sequence[str], sizes_px: Sizes | None
) -> NetworkCameras:
    """Build the cameras to start from.

    sizes_px: Width and height of each photo; None with image points [px].
    Returns: Cameras from their files, from measurement.toml, from EXIF or guessed; those without photos are left
        out.
    InputError: A camera file that cannot be read, photos of another size than their camera or of no camera, or a
        camera named by patterns that fit no photo.
    """
    sections = measurement.model.camera
    index = _cameras_of(measurement, photos)
    own = [[name for name, place in zip(photos, index, strict=True) if place == k] for k in range(len(sections))]
    if not measurement.photo_files:
        _refuse_without_photos(sections, index)
    used = [k for k, names in enumerate(own) if names]
    cameras = [
        _build_camera(measurement, sections[k], _common_size(sections[k], own[k], sizes_px), own[k]) for k in used
    ]
    models = [build_model(sections[k], camera) for k, camera in zip(used, cameras, strict=True)]
    place = {k: i for i, k in enumerate(used)}
    return NetworkCameras(
        tuple(cameras), tuple(models), {name: place[k] for name, k in zip(photos, index, strict=True)}
    )


def refuse_camera_mismatches(measurement: PhotogrammetryMeasurement) -> None:
    """Check before anything is measured that each photo has one camera, and each camera's patterns fit a photo.

    InputError: A photo of no camera or of several, or patterns that fit no photo; the message names it.
    """
    index = _cameras_of(measurement, [file.name for file in measurement.photo_files])
    _refuse_without_photos(measurement.model.camera, index)


def _cameras_of(measurement: PhotogrammetryMeasurement, photos: Sequence[str]) -> tuple[int, ...]:
    places = {file.name: file.relative_to(measurement.folder).as_posix() for file in measurement.photo_files}
    try:
        return camera_of_photos(measurement.model.camera, [places.get(name, name) for name in photos])
    except ValueError as error:
        raise InputError(f"camera: {error}") from None


def _refuse_without_photos(sections: Sequence[NetworkCameraSection], index: Sequence[int]) -> None:
    for place, section in enumerate(sections):
        if section.photos is not None and place not in index:
            raise InputError(f"camera {section.name}: no photo fits photos = {', '.join(section.photos)}")


def sizes_of_cameras(measurement: PhotogrammetryMeasurement, photos: Sequence[str]) -> Sizes:
    """Return the size of each photo as its camera has it, for image points without photos.

    InputError: As `build_cameras`.
    """
    cameras = build_cameras(measurement, photos, None)
    sizes = [_size(one) for one in cameras.cameras]
    return {name: sizes[place] for name, place in cameras.camera_of.items()}


def _common_size(section: NetworkCameraSection, names: Sequence[str], sizes_px: Sizes | None) -> tuple[int, int] | None:
    """Return the one size of a camera's photos, or say which differ."""
    if sizes_px is None:
        return None
    counts = Counter(sizes_px[name] for name in names)
    usual = counts.most_common(1)[0][0]
    odd = [f"{name} ({sizes_px[name][0]} x {sizes_px[name][1]})" for name in names if sizes_px[name] != usual]
    if not odd:
        return usual
    turned = {sizes_px[name] for name in names} == {usual, usual[::-1]}
    remedy = (
        "were they turned by a program? give the files as the camera wrote them, EXIF orientation is no matter"
        if turned
        else "they are not of this camera: remove them, or describe several cameras with [[camera]] and photos"
    )
    listed = ", ".join(odd[:5]) + (f" and {len(odd) - 5} more" if len(odd) > 5 else "")
    raise InputError(
        f"images.photos: most of {section.name} have {usual[0]} x {usual[1]} px, but not {listed}; {remedy}"
    )


def _build_camera(
    measurement: PhotogrammetryMeasurement,
    section: NetworkCameraSection,
    size_px: tuple[int, int] | None,
    names: Sequence[str],
) -> Camera:
    if section.file is not None:
        camera = _from_file(measurement.folder / section.file, section.name)
        stated: tuple[int, int] | None = (camera.width_px, camera.height_px)
    else:
        given = section.width_px is not None and section.height_px is not None
        stated = (int(section.width_px or 0), int(section.height_px or 0)) if given else None
        film_mm = section.focal_length_35mm
        if not section.is_known and film_mm is None:
            film_mm = _film_focal_length(measurement, section.name, names)
        camera = _start_camera(section, stated or size_px or (0, 0), film_mm)
    if size_px is not None and stated is not None and size_px != stated:
        raise InputError(
            f"camera: the photos have {size_px[0]} x {size_px[1]} px, but the camera {stated[0]} x {stated[1]} px; "
            "were they scaled, turned or taken with another camera?"
        )
    return camera


def _from_file(path: Path, name: str) -> Camera:
    try:
        return read_camera_json(path)
    except InputError:
        # A file with several cameras: the section's name selects one.
        return read_camera_json(path, name)


def _film_focal_length(measurement: PhotogrammetryMeasurement, camera: str, names: Sequence[str]) -> float | None:
    """Return the focal length in EXIF for a film of 36 mm x 24 mm, if the photos agree."""
    files = {file.name: file for file in measurement.photo_files}
    found = {name: focal_length_35mm(_beginning(files[name])) for name in names if name in files}
    said = {name: value for name, value in found.items() if value is not None}
    if not said:
        return None
    low, high = min(said, key=lambda name: said[name]), max(said, key=lambda name: said[name])
    if said[high] > (1 + _ZOOMED) * said[low]:
        raise InputError(
            f"camera {camera}: EXIF says {said[low]:g} mm for {low} and {said[high]:g} mm for {high} (on a film of 36 "
            "mm x 24 mm); with a zoom that was moved give each position its own [[camera]] with photos = [...]"
        )
    return float(np.median(list(said.values())))


def _beginning(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            return file.read(EXIF_BYTES)
    except (OSError, InputError):
        return b""


def _start_camera(section: NetworkCameraSection, size_px: tuple[int, int], film_mm: float | None) -> Camera:
    direction = DistortionDirection(section.distortion_direction or DistortionDirection.IDEAL_TO_MEASURED)
    if section.millimetres is not None:
        return _from_millimetres(section.millimetres, size_px, direction)
    guess = guessed_camera(*size_px, focal_length_35mm=film_mm)
    lens = BrownDistortion(section.k1, section.k2, section.k3, section.p1, section.p2, direction)
    centers = (
        guess.center_x_px if section.center_x_px is None else section.center_x_px,
        guess.center_y_px if section.center_y_px is None else section.center_y_px,
    )
    camera = Camera(*size_px, guess.focal_x_px, guess.focal_y_px, *centers, section.skew, lens)
    values = intrinsics_of(camera)
    values[:2] = (section.focal_px or guess.focal_y_px), section.aspect
    return camera_with_intrinsics(camera, values)


def sensors_of(measurement: PhotogrammetryMeasurement, cameras: NetworkCameras) -> dict[str, Sensor]:
    """Return the sensors of the cameras that are given in millimetres, to give the results in the same form.

    cameras: The cameras that `build_cameras` made of it.
    InputError: Impossible sizes.
    """
    own = {model.name: camera for model, camera in zip(cameras.models, cameras.cameras, strict=True)}
    return {
        one.name: _sensor(one.millimetres, _size(own[one.name]), own[one.name].distortion.direction)
        for one in measurement.model.camera
        if one.millimetres is not None and one.name in own
    }


def _sensor(section: MillimetreSection, size_px: tuple[int, int], direction: DistortionDirection) -> Sensor:
    return Sensor(
        *size_px,
        section.pixel_mm,
        LensForm(section.form),
        section.zero_radius_mm,
        PrincipalOrigin(section.principal_origin),
        section.y_axis == "up",
        direction,
    )


def _size(camera: Camera) -> tuple[int, int]:
    return camera.width_px, camera.height_px


def _from_millimetres(section: MillimetreSection, size_px: tuple[int, int], direction: DistortionDirection) -> Camera:
    sensor = _sensor(section, size_px, direction)
    middle = np.zeros(2)
    if sensor.principal_origin is PrincipalOrigin.CORNER:
        middle = np.array(size_px) * (0.5 * section.pixel_mm)
    principal = middle if section.principal_mm is None else np.array(section.principal_mm)
    values = np.array([section.focal_mm, *principal, *section.radial, *section.tangential, *section.affine])
    return SensorParameters(sensor, values).camera()


def build_model(section: NetworkCameraSection, camera: Camera) -> CameraModel:
    """Say what of a camera is estimated.

    section: What measurement.toml says.
    camera: The start, whose values are the centres of priors.
    Returns: Free intrinsics and priors.
    InputError: A prior from a file that states no covariance.
    """
    if section.prior and not camera.covariance.any():
        raise InputError(
            f"camera {section.name}: prior = true, but {section.file} states no covariance; leave it out to hold the "
            "camera, or give [camera.sigma]"
        )
    start = dict(zip(INTRINSIC_NAMES, intrinsics_of(camera).tolist(), strict=True))
    priors = tuple(Prior(name, start[name], sigma) for name, sigma in section.sigma.items())
    covariance = _intrinsic_covariance(camera) if section.prior else None
    values = intrinsics_of(camera) if section.prior else None
    return CameraModel(section.name, section.estimated, priors, covariance, values, _RESIDUALS[section.residuals])


def _intrinsic_covariance(camera: Camera) -> FloatArray:
    """Turn the covariance of the camera's parameters into that of the intrinsics that an adjustment varies."""
    jacobian = np.eye(10)
    jacobian[0, :2] = 0.0, 1.0
    jacobian[1, :2] = -camera.focal_y_px / camera.focal_x_px**2, 1 / camera.focal_x_px
    carried = jacobian @ camera.covariance @ jacobian.T
    return np.asarray(0.5 * (carried + carried.T))
