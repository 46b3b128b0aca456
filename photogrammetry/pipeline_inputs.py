"""From what measurement.toml says to cameras, constraints and a search."""

from collections.abc import Sequence

import numpy as np

from heliogauge.camera import Camera
from heliogauge.distortion import BrownDistortion, DistortionDirection
from heliogauge.errors import InputError
from heliogauge.least_squares import Prior
from heliogauge.measurement import PhotogrammetryMeasurement
from heliogauge.measurement_photogrammetry import (
    ControlPointSection,
    CoordinateSection,
    DistanceSection,
    NetworkCameraSection,
    PhotogrammetryModel,
    TargetsSection,
)
from heliogauge.store import read_camera_json, read_cameras_json, read_points_csv
from heliogauge.validate import FloatArray
from photogrammetry.bundle import CameraModel, Datum, DatumKind, ResidualSpace
from photogrammetry.bundle_state import INTRINSIC_NAMES, camera_with_intrinsics, intrinsics_of
from photogrammetry.coded_targets import Polarity, ring_dictionary
from photogrammetry.constraints import CommonPlane, Constraint, ControlPoint, Coordinate, Distance, KnownPlane
from photogrammetry.detect import SearchLimits
from photogrammetry.network import StartValues, guessed_camera
from photogrammetry.photo_targets import TargetSearch

_RESIDUALS = {"measured": ResidualSpace.MEASURED, "corrected": ResidualSpace.CORRECTED}


def build_camera(measurement: PhotogrammetryMeasurement, size_px: tuple[int, int] | None) -> Camera:
    """Build the camera to start from.

    Parameters
    ----------
    measurement : PhotogrammetryMeasurement
        The checked measurement.
    size_px : (int, int) or None
        Size of the photos; None with image points [px].

    Returns
    -------
    Camera
        From its file, from measurement.toml, or guessed.

    Raises
    ------
    InputError
        A camera file that cannot be read, or photos of another size.
    """
    section = measurement.model.camera
    if section.file is not None:
        camera = read_camera_json(measurement.folder / section.file)
        stated: tuple[int, int] | None = (camera.width_px, camera.height_px)
    else:
        given = section.width_px is not None and section.height_px is not None
        stated = (int(section.width_px or 0), int(section.height_px or 0)) if given else None
        camera = _started(section, stated or size_px or (0, 0))
    if size_px is not None and stated is not None and size_px != stated:
        raise InputError(
            f"camera: the photos have {size_px[0]} x {size_px[1]} px, but the camera {stated[0]} x {stated[1]} px; "
            "were they scaled, turned or taken with another camera?"
        )
    return camera


def _started(section: NetworkCameraSection, size_px: tuple[int, int]) -> Camera:
    guess = guessed_camera(*size_px, focal_length_35mm=section.focal_length_35mm)
    lens = BrownDistortion(
        section.k1, section.k2, section.k3, section.p1, section.p2, DistortionDirection(section.distortion_direction)
    )
    centers = (
        guess.center_x_px if section.center_x_px is None else section.center_x_px,
        guess.center_y_px if section.center_y_px is None else section.center_y_px,
    )
    camera = Camera(*size_px, guess.focal_x_px, guess.focal_y_px, *centers, section.skew, lens)
    values = intrinsics_of(camera)
    values[:2] = (section.focal_px or guess.focal_y_px), section.aspect
    return camera_with_intrinsics(camera, values)


def build_model(section: NetworkCameraSection, camera: Camera) -> CameraModel:
    """Say what of the camera is estimated.

    Parameters
    ----------
    section : NetworkCameraSection
        What measurement.toml says.
    camera : Camera
        The start, whose values are the centres of priors.

    Returns
    -------
    CameraModel
        Free intrinsics and priors.
    """
    start = dict(zip(INTRINSIC_NAMES, intrinsics_of(camera).tolist(), strict=True))
    priors = tuple(Prior(name, start[name], sigma) for name, sigma in section.sigma.items())
    covariance = _intrinsic_covariance(camera) if section.prior else None
    return CameraModel(section.name, section.estimated, priors, covariance, _RESIDUALS[section.residuals])


def _intrinsic_covariance(camera: Camera) -> np.ndarray:
    """Turn the covariance of the camera's parameters into that of the intrinsics that an adjustment varies."""
    jacobian = np.eye(10)
    jacobian[0, :2] = 0.0, 1.0
    jacobian[1, :2] = -camera.focal_y_px / camera.focal_x_px**2, 1 / camera.focal_x_px
    return np.asarray(jacobian @ camera.covariance @ jacobian.T)


def build_search(section: TargetsSection) -> TargetSearch:
    """Say what ring-coded targets are searched for.

    Parameters
    ----------
    section : TargetsSection
        What measurement.toml says.

    Returns
    -------
    TargetSearch
        The search.

    Raises
    ------
    InputError
        No such dictionary, or impossible sizes.
    """
    polarities = tuple(Polarity) if section.polarity == "both" else (Polarity(section.polarity),)
    limits = SearchLimits(section.smallest_px, section.largest_px, polarities=polarities)
    return TargetSearch(dictionary=ring_dictionary(section.dictionary), limits=limits, with_uncoded=False)


def build_constraints(model: PhotogrammetryModel) -> tuple[Constraint, ...]:
    """Collect scale bars, distances, coordinates, planes and weighted control points.

    Parameters
    ----------
    model : PhotogrammetryModel
        What measurement.toml says.

    Returns
    -------
    tuple of Constraint
        In the order of the file; scale bars for checks only are left out.
    """
    found: list[Constraint] = [
        Distance(bar.a, bar.b, bar.length_m, 1e-3 * bar.sigma_mm) for bar in model.scale_bar if not bar.check_only
    ]
    for one in model.constraint:
        sigma_m = 1e-3 * one.sigma_mm
        if isinstance(one, CoordinateSection):
            found.append(Coordinate(one.target, one.axis, one.value_m, sigma_m))
        elif isinstance(one, DistanceSection):
            found.append(Distance(one.a, one.b, one.distance_m, sigma_m))
        elif one.normal is None:
            found.append(CommonPlane(one.targets, sigma_m))
        else:
            found.append(KnownPlane(one.targets, np.array(one.normal), one.offset_m, sigma_m))
    return (*found, *_weighted(model.control_point))


def _weighted(points: Sequence[ControlPointSection]) -> list[Constraint]:
    return [
        ControlPoint(one.target, np.array(one.xyz_m), np.diag(np.square(one.sigma_mm)) * 1e-6)
        for one in points
        if any(one.sigma_mm)
    ]


def build_start(measurement: PhotogrammetryMeasurement) -> StartValues:
    """Read start values, where measurement.toml names some.

    Parameters
    ----------
    measurement : PhotogrammetryMeasurement
        The checked measurement.

    Returns
    -------
    StartValues
        Poses and points; empty without ``[start]``.

    Raises
    ------
    InputError
        A file that cannot be read.
    """
    section = measurement.model.start
    if section is None:
        return StartValues()
    poses = {} if section.cameras is None else read_cameras_json(measurement.folder / section.cameras)[1]
    points: dict[str, FloatArray] = {}
    if section.points is not None:
        table = read_points_csv(measurement.folder / section.points)
        known = np.isfinite(table.xyz_m).all(axis=1)
        points = {table.ids[i]: table.xyz_m[i] for i in np.nonzero(known)[0].tolist()}
    return StartValues({name: one.cam_from_world for name, one in poses.items()}, points)


def build_datum(model: PhotogrammetryModel) -> Datum:
    """Return the datum.

    Parameters
    ----------
    model : PhotogrammetryModel
        What measurement.toml says.

    Returns
    -------
    Datum
        The datum.

    Raises
    ------
    InputError
        A minimal datum without three targets.
    """
    kind = DatumKind.INNER if model.datum.kind == "inner" else DatumKind.MINIMAL
    return Datum(kind, model.datum.targets)
