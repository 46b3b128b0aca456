"""From measurement.toml to what the numeric modules work on: camera, screen, pattern, mirror."""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from deflectometry.keys import (
    BenchMeasurement,
    CameraParameters,
    CameraSection,
    DeflectometryMeasurement,
    DotScreenSection,
    FacetSection,
    MeasuredScreenSection,
    MirrorSection,
    PoseSection,
    RectangularScreenSection,
    TabulatedScreenSection,
)
from deflectometry.pose.find_pose import MirrorInput
from deflectometry.pose.pose_observations import DistanceObservation, Knowledge, KnownPoints, UncertainPose
from deflectometry.pose.surveyed_place import SurveyedPlace
from deflectometry.screen_geometry import read_screen
from deflectometry.setup.camera_and_screen import RectangularScreen, Screen, Setup, TabulatedScreen
from deflectometry.setup.dot_screen import DotScreen
from deflectometry.setup.patterns import Axis, FringePattern, FringeSet
from deflectometry.setup.screen_table import check_screen_points, refuse_other_units
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, Quadric
from heliogauge.measurement.designs import build_design
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.measurement.models import Section
from heliogauge.results.tables import read_camera_json, read_number_columns
from heliogauge.validate import FloatArray

#: A full turn; no rotation needs more.
TURN_RAD = 2 * np.pi
#: Steps over less than this leave the phase to noise.
LEAST_SPAN_DEG = 30.0


def build_setup(measurement: BenchMeasurement) -> Setup:
    """Build camera and screen of a measurement.

    Returns: Camera, screen, their relative pose and its covariance.
    InputError: A camera file or screen table that cannot be read, or a rotation of more than a turn.
    """
    section = measurement.model.screen
    if isinstance(section, MeasuredScreenSection):
        return _with_measured_screen(measurement, section)
    known = _known_pose(section)
    return Setup(
        camera=build_camera(measurement.model.camera, measurement.folder),
        screen=_build_screen(measurement, section),
        cam_from_screen=known.cam_from_mirror,
        covariance_cam_from_screen=known.covariance,
        sigma_screen_points_m=section.sigma_points_mm * 1e-3,
        sigma_size_m=1e-3 * np.array([section.sigma_width_mm, section.sigma_height_mm]),
        sigma_sag_m=section.sigma_sag_mm * 1e-3,
    )


def build_camera(section: CameraSection, folder: Path) -> Camera:
    """Build a camera from its parameters or its file.

    folder: Of the measurement; a file's name is relative to it.
    InputError: A camera file that cannot be read.
    """
    if not isinstance(section, CameraParameters):
        return read_camera_json(folder / section.file)
    distortion = BrownDistortion(
        k1=section.k1,
        k2=section.k2,
        k3=section.k3,
        p1=section.p1,
        p2=section.p2,
        direction=DistortionDirection(section.distortion_direction),
    )
    sigma = [
        section.sigma_focal_px,
        section.sigma_focal_px,
        section.sigma_center_px,
        section.sigma_center_px,
        section.sigma_skew,
        section.sigma_k1,
        section.sigma_k2,
        section.sigma_p1,
        section.sigma_p2,
        section.sigma_k3,
    ]
    return Camera(
        width_px=section.width_px,
        height_px=section.height_px,
        focal_x_px=section.focal_x_px,
        focal_y_px=section.focal_y_px,
        center_x_px=section.center_x_px,
        center_y_px=section.center_y_px,
        skew=section.skew,
        distortion=distortion,
        covariance=np.diag(np.square(sigma)),
    )


def _with_measured_screen(measurement: BenchMeasurement, section: MeasuredScreenSection) -> Setup:
    """Build camera and screen where the screen was measured, with all that its points and its pose share.

    InputError: Neither the file nor the section has a pose.
    """
    file = measurement.path(section.file)
    measured = read_screen(file)
    shared, pose, covariance = measured.shared, measured.cam_from_screen, np.zeros((6, 6))
    if section.rotation_vector_rad is not None and section.translation_m is not None:
        stated = _known_pose(PoseSection.model_validate(section.model_dump(include=set(PoseSection.model_fields))))
        # The points keep their errors; those of the file's pose are not those of this one.
        shared = tuple(replace(one, cam_from_screen=np.zeros(6)) for one in shared)
        pose, covariance = stated.cam_from_mirror, stated.covariance
    if pose is None:
        raise InputError(
            f"{file}: no photo of the measuring camera was among the screen's photos; give its pose in [screen] "
            "(rotation_vector_rad, translation_m and their sigmas), or measure the screen again with measuring_photo"
        )
    return Setup(
        camera=build_camera(measurement.model.camera, measurement.folder),
        screen=measured.screen,
        cam_from_screen=pose,
        covariance_cam_from_screen=covariance,
        sigma_screen_points_m=measured.sigma_surface_m,
        shared_errors=shared,
    )


def _build_screen(
    measurement: BenchMeasurement,
    section: RectangularScreenSection | TabulatedScreenSection | DotScreenSection,
) -> Screen:
    if isinstance(section, RectangularScreenSection):
        return RectangularScreen(section.width_m, section.height_m)
    if isinstance(section, DotScreenSection):
        return _build_dots(measurement.path(section.file))
    names = ("u", "v", "x_m", "y_m", "z_m")
    file = measurement.path(section.file)
    columns = read_number_columns(file, names)
    refuse_other_units(columns, str(file))
    try:
        return TabulatedScreen(columns[0], columns[1], columns[2:].T)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def _build_dots(file: Path) -> DotScreen:
    column, row, *places = read_number_columns(file, ("column", "row", "x_m", "y_m", "z_m"))
    try:
        return DotScreen.from_table(column, row, np.stack(places, axis=1))
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def pattern_words(pattern: FringePattern) -> str:
    """Say what fringes were shown."""
    listed = ", ".join(f"{one.axis} {one.periods:g} periods x {one.n_frames} steps" for one in pattern.sets)
    return f"{pattern.n_frames} frames: {listed}"


def build_pattern(measurement: DeflectometryMeasurement) -> FringePattern:
    """Build the fringe pattern of a measurement."""
    for number, one in enumerate(measurement.model.pattern.set, start=1):
        span = max(one.steps_deg) - min(one.steps_deg)
        if 0 < span < LEAST_SPAN_DEG:
            raise InputError(
                f"{measurement.folder / MEASUREMENT_FILE}: pattern.set[{number}].steps_deg span only {span:.3g} "
                "deg; are they in radians? Give degrees, such as [0, 90, 180, 270]"
            )
    return FringePattern(
        tuple(
            FringeSet(Axis(one.axis), one.periods, np.deg2rad(one.steps_deg)) for one in measurement.model.pattern.set
        )
    )


def _known_pose(section: PoseSection) -> UncertainPose:
    turn_rad = float(np.linalg.norm(section.rotation_vector_rad))
    if turn_rad > TURN_RAD:
        raise InputError(
            f"rotation_vector_rad = {list(section.rotation_vector_rad)}: {turn_rad:.4g} rad are more than one turn; "
            "is it in degrees? Give axis times angle in radians"
        )
    pose = RigidTransform.from_rotation_vector(section.rotation_vector_rad, section.translation_m)
    sigma = 1e-3 * np.array([*section.sigma_rotation_mrad, *section.sigma_translation_mm])
    return UncertainPose(pose, np.diag(sigma**2))


def build_facets(section: MirrorSection, name: str) -> tuple[Facet, ...]:
    """Build the facets of a mirror.

    Returns: One facet, or those of the ensemble; empty where no outline is given. A facet of an ensemble without a
        design of its own is cut from the ensemble's surface.
    """
    if section.facet:
        return tuple(_ensemble_facet(one, section) for one in section.facet)
    if section.outline_m is None:
        return ()
    return (_facet(name, build_design(section), section.outline_m, section.reference_point_m),)


def _ensemble_facet(one: FacetSection, section: MirrorSection) -> Facet:
    place = RigidTransform.from_rotation_vector(one.rotation_vector_rad, one.position_m)
    design = build_design(one) if one.design else build_design(section).transformed(place.inverse())
    return _facet(one.name, design, one.outline_m, one.reference_point_m, place)


def _facet(
    name: str,
    design: Quadric,
    outline_m: tuple[tuple[float, float], ...],
    reference_point_m: tuple[float, float] | None,
    place: RigidTransform | None = None,
) -> Facet:
    reference = np.full(2, np.nan) if reference_point_m is None else np.asarray(reference_point_m)
    return Facet(name, np.asarray(outline_m), design, place or RigidTransform.identity(), reference)


def build_mounts(section: MirrorSection) -> dict[str, FloatArray]:
    """Return the places (n, 2) of the mounts of each facet that has some, in its frame [m]."""
    mounts = {one.name: one.mounts_m or section.mounts_m for one in section.facet}
    return {name: np.array(places) for name, places in mounts.items() if places}


def build_knowledge(section: MirrorSection, setup: Setup) -> Knowledge:
    """Build what helps to find the pose: measured distance, known points, trust in the outline, expected roll.

    setup: Gives the screen's origin in the camera frame.
    Returns: Distances and points with their sigmas, how well the outline is known, and the expected roll.
    """
    distances: tuple[DistanceObservation, ...] = ()
    if section.distance is not None:
        measured = section.distance
        distances = (
            DistanceObservation(
                measured.distance_m,
                measured.sigma_mm * 1e-3,
                np.asarray(measured.point_m),
                setup.cam_from_screen.translation_m,
            ),
        )
    points = section.known_point
    known = KnownPoints(
        np.array([one.point_m for one in points]).reshape(-1, 3),
        np.array([one.image_px for one in points]).reshape(-1, 2),
        np.array([one.sigma_px for one in points]),
    )
    return Knowledge(
        distances=distances,
        points=known,
        roll_rad=float(np.deg2rad(section.roll_deg)),
        sigma_outline_m=section.outline_sigma_mm * 1e-3,
        sigma_places_m=tuple(_sigma_place(one, section) for one in section.facet),
    )


def build_place(section: MirrorSection) -> SurveyedPlace | None:
    """Build what a survey says of the mirror's place; None where it says nothing."""
    place = section.place
    if place is None:
        return None
    return SurveyedPlace(np.array(place.place_m), 1e-3 * np.array(place.sigma_mm), np.array(place.point_m))


def describe_mirror(measurement: BenchMeasurement, setup: Setup) -> MirrorInput:
    """Put together what the file states of the mirror."""
    section = measurement.model.mirror
    return MirrorInput(
        name=measurement.model.name,
        facets=build_facets(section, measurement.model.name),
        design=build_design(section),
        known_pose=None if section.pose is None else _known_pose(section.pose),
        knowledge=build_knowledge(section, setup),
    )


def _sigma_place(facet: FacetSection, section: MirrorSection) -> FloatArray | None:
    sigma_mm = section.sigma_facet_position_mm if facet.sigma_position_mm is None else facet.sigma_position_mm
    return None if sigma_mm is None else 1e-3 * np.array(sigma_mm)


def inputs_without_sigma(measurement: BenchMeasurement, setup: Setup) -> frozenset[str]:
    """Return the keys of inputs for which no sigma is given; a sigma of 0.0 is a statement.

    Camera and pose of the screen count where none of their sigmas is given, each size of the screen by itself.
    """
    model, keys = measurement.model, set[str]()
    # A measured screen comes with its errors, and mostly with its pose.
    measured = model.screen if isinstance(model.screen, MeasuredScreenSection) else None
    if not setup.camera.covariance.any() and not _states_sigma(model.camera, ("sigma",)):
        keys |= {f"camera.{name}" for name in ("focal_x_px", "focal_y_px", "center_x_px", "center_y_px")}
    has_pose = measured is not None and measured.translation_m is None
    stated = has_pose or _states_sigma(model.screen, ("sigma_rotation", "sigma_translation"))
    if not setup.covariance_cam_from_screen.any() and not stated:
        keys |= {"screen.rotation_vector_rad", "screen.translation_m"}
    if measured is None and "sigma_points_mm" not in model.screen.model_fields_set:
        sizes = {"width": "screen.width_m", "height": "screen.height_m", "sag": "screen.sag"}
        keys |= {key for name, key in sizes.items() if f"sigma_{name}_mm" not in model.screen.model_fields_set}
    return frozenset(keys)


def check_missing_sigmas(unstated: Collection[str]) -> Doubt | None:
    """Return which inputs of camera and screen's pose have no sigma.

    unstated: Keys, from `inputs_without_sigma`.
    """
    missing = []
    if "camera.focal_x_px" in unstated:
        missing.append("the camera ([camera] sigma_focal_px ...)")
    if "screen.translation_m" in unstated:
        missing.append("the pose of the screen ([screen] sigma_rotation_mrad, sigma_translation_mm)")
    if not missing:
        return None
    return Doubt(
        "sigma_of_setup_missing",
        f"no sigma is given for {' nor for '.join(missing)}: counted as known no better than the images know them "
        "(sigma_unstated_setup), so focus, astigmatism and twist are less sure than they could be; state their sigmas",
        {"inputs_count": len(missing)},
    )


def _states_sigma(section: Section, beginnings: tuple[str, ...]) -> bool:
    return any(key.startswith(beginnings) for key in section.model_fields_set)


def check_screen(measurement: BenchMeasurement, screen: Screen) -> Doubt | None:
    """Return a doubt where points of the screen's table stand out of the others."""
    section = measurement.model.screen
    if not isinstance(section, TabulatedScreenSection) or not isinstance(screen, TabulatedScreen):
        return None
    return check_screen_points(screen, str(measurement.path(section.file)))
