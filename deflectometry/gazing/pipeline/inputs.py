"""From measurement.toml and its images to cameras, light and the sun."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deflectometry.field.keys import FieldCameraSection, HeliostatSection
from deflectometry.field.placement import OrientedCamera, field_from_mirror, normal_between, orient_camera
from deflectometry.frames.image_file_checks import check_size
from deflectometry.gazing.facet_maps import GazingSigmas
from deflectometry.gazing.keys import GazingCameraSection, GazingMeasurement, SunCameraSection
from deflectometry.gazing.photometry import Exposure, Light, flat_response, light_of, mean_dark
from deflectometry.gazing.sun_profile import SunImage, measure_sun
from deflectometry.pipeline.inputs import build_camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.sun import direction_from_angles
from heliogauge.images.photos import read_frames
from heliogauge.validate import FloatArray

#: A camera and its own image of the sun have the same middle of the disc to this share, or one shows a cloud.
_SAME_PROFILE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class GazingCamera:
    """What one camera gives.

    oriented: The camera before the mirror.
    light: Of the mirror.
    sun: The sun through the same filter; its level in DN/ms.
    has_flat: Whether its pixels' response is known.
    """

    name: str
    oriented: OrientedCamera
    light: Light
    sun: SunImage
    has_flat: bool


def mirror_frame(section: HeliostatSection, sun: FloatArray) -> RigidTransform:
    """Return where the mirror's frame stands in the field.

    sun (3,): Direction to the sun in the field's frame.
    """
    place = np.asarray(section.place_m)
    if section.aim_m is not None:
        normal = normal_between(place, np.asarray(section.aim_m), sun)
    else:
        normal = np.asarray(section.normal)
        normal = normal / np.linalg.norm(normal)
    return field_from_mirror(place, normal)


def oriented(
    section: FieldCameraSection,
    folder: Path,
    mirror_from_field: RigidTransform,
    *,
    moved_px: FloatArray | float = 0.0,
    is_trial: bool = False,
) -> OrientedCamera:
    """Return a camera turned to its points of the mirror.

    moved_px: By how much more than its sigma each point may be elsewhere, one standard deviation.
    is_trial: The camera is put where it does not stand: its points need not fit.
    """
    return orient_camera(
        section.name,
        build_camera(section.camera, folder),
        mirror_from_field.apply(np.asarray(section.place_m)),
        np.array([one.point_m for one in section.point]),
        np.array([one.image_px for one in section.point]),
        np.hypot([one.sigma_px for one in section.point], moved_px),
        **({"most_sigmas": float("inf")} if is_trial else {}),
    )


def sun_direction(section: SunCameraSection) -> FloatArray:
    """Return the direction to the sun in the field's frame, shape (3,)."""
    return direction_from_angles(np.radians(section.azimuth_deg), np.radians(section.elevation_deg))


def read_sun(measurement: GazingMeasurement) -> SunImage:
    """Measure the sun's profile from the camera on the sun."""
    section = measurement.model.sun
    exposure = _exposure(
        measurement, "sun", section, ("frames", "dark"), section.exposure_ms, _flat_of(measurement, "sun", section)
    )
    return measure_sun(light_of(exposure, "sun.frames").unsaturated, section.focal_px, "sun.frames")


def read_camera(
    measurement: GazingMeasurement, section: GazingCameraSection, mirror_from_field: RigidTransform
) -> GazingCamera:
    """Read one camera's images of mirror and sun."""
    key = f"camera.{section.name}"
    place = oriented(section, measurement.folder, mirror_from_field)
    flat = _flat_of(measurement, key, section)
    exposure = _exposure(measurement, key, section, ("frames", "dark"), section.exposure_ms, flat)
    check_size(exposure.images_dn.shape[:0:-1], place.camera, f"{key}.frames")
    dark = "sun_dark" if section.sun_dark is not None else "dark"
    of_sun = _exposure(measurement, key, section, ("sun", dark), section.sun_exposure_ms, flat)
    sun = measure_sun(light_of(of_sun, f"{key}.sun").unsaturated, place.camera.focal_x_px, f"{key}.sun")
    light = light_of(exposure, f"{key}.frames")
    return GazingCamera(section.name, place, light, sun, flat is not None)


def _read(measurement: GazingMeasurement, key: str, named: str | tuple[str, ...]) -> tuple[FloatArray, float]:
    frames = read_frames(measurement.files(key, named))
    return np.asarray(frames.images_dn, dtype=np.float64), float(frames.full_scale_dn)


def _flat_of(
    measurement: GazingMeasurement, key: str, section: SunCameraSection | GazingCameraSection
) -> FloatArray | None:
    if section.flat is None:
        return None
    images, _ = _read(measurement, f"{key}.flat", section.flat)
    dark_key = "dark" if section.flat_dark is None else "flat_dark"
    darks, _ = _read(measurement, f"{key}.{dark_key}", getattr(section, dark_key))
    _same_size(measurement, key, "flat", images, darks)
    return flat_response(images, mean_dark(darks), f"{key}.flat")


def _exposure(
    measurement: GazingMeasurement,
    key: str,
    section: SunCameraSection | GazingCameraSection,
    names: tuple[str, str],
    exposure_ms: float,
    flat: FloatArray | None,
) -> Exposure:
    images, full_scale = _read(measurement, f"{key}.{names[0]}", getattr(section, names[0]))
    darks, _ = _read(measurement, f"{key}.{names[1]}", getattr(section, names[1]))
    _same_size(measurement, key, names[0], images, darks)
    if flat is not None and flat.shape != images.shape[1:]:
        raise InputError(f"{key}.flat: its frames are {_size(flat)}, those of {names[0]} {_size(images)}")
    saturation = full_scale if section.saturation_dn is None else section.saturation_dn
    return Exposure(images, mean_dark(darks), np.ones(()) if flat is None else flat, exposure_ms, saturation)


def _same_size(measurement: GazingMeasurement, key: str, name: str, images: FloatArray, darks: FloatArray) -> None:
    if images.shape[1:] != darks.shape[1:]:
        raise InputError(
            f"{measurement.folder}: {key}.{name} has images of {_size(images)}, its dark frames {_size(darks)}"
        )


def _size(images: FloatArray) -> str:
    return f"{images.shape[-1]} x {images.shape[-2]} px"


def level_covariance(measurement: GazingMeasurement, cameras: list[GazingCamera], of_sun: SunImage) -> FloatArray:
    """Return the covariance of the logarithms of all levels: each camera's own, and what all share.

    Shared are the reflectance and the level to which the sun's profile refers.
    """
    section = measurement.model.photometry
    without_flat = 1e-2 * section.sigma_missing_flat_percent
    own = [
        (1e-2 * section.sigma_level_percent) ** 2
        + (one.sun.sigma_level / one.sun.level) ** 2
        + (0.0 if one.has_flat else without_flat**2)
        for one in cameras
    ]
    reflectance = 1e-2 * section.sigma_reflectance_percent / section.reflectance
    return np.asarray(np.diag(own) + reflectance**2 + (of_sun.sigma_level / of_sun.level) ** 2)


def gazing_sigmas(measurement: GazingMeasurement, chosen: list[int]) -> GazingSigmas:
    """Return what is known of places and directions, of some cameras.

    A frame that aims the stated sun from the stated place turns with errors of both as the measured normal does: slopes
    against it do not feel them. How far the mirror stands from the cameras they feel: it is the angle between these.
    """
    model = measurement.model
    fixed = model.mirror.aim_m is None
    return GazingSigmas(
        1e-3 * np.array([model.camera[number].sigma_place_mm for number in chosen]),
        1e-3 * model.mirror.sigma_place_mm if fixed else 0.0,
        1e-3 * model.mirror.sigma_place_mm,
        1e-3 * model.sun.sigma_direction_mrad if fixed else 0.0,
        1e-3 * model.sun.sigma_focal_permille,
    )
