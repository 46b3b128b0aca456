"""A surveyed place of the mirror: what it says of the camera's sight, together with the image."""

from dataclasses import dataclass, replace

import numpy as np

from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.setup_steps import SetupStep, moved_setup, principal_steps, setup_steps
from deflectometry.setup.smooth_screen import SharedStep, SmoothWarp
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.doubts import Doubt
from heliogauge.geometry.rigid import skew
from heliogauge.validate import FloatArray

#: A place and an image that lie so far apart by chance once in a thousand times are said to contradict each other.
_LEAST_PROBABILITY = 1e-3
#: Linear steps: a turn of 1 mrad at 200 m bends the way by 0.1 mm, which the second has already.
_ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedPlace:
    """Where a point of the mirror is, as a survey has it.

    place_m (3,): Of the point, in the screen's frame [m].
    sigma_m (3,): Standard deviation of each coordinate [m].
    mirror_point_m (3,): The point, in the mirror's frame [m].
    """

    place_m: FloatArray
    sigma_m: FloatArray
    mirror_point_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PlacedSetup:
    """Camera and screen after the surveyed place was heard.

    setup: With the values and the joint errors that image and place leave.
    apart_m (3,): Place by the image, with what was stated, minus the surveyed one, in the screen's frame [m].
    probability: Of being so far apart.
    doubt: Where both contradict each other, or nothing can give way to the place.
    """

    setup: Setup
    apart_m: FloatArray
    probability: float
    doubt: Doubt | None


def setup_with_place(setup: Setup, located: UncertainPose, place: SurveyedPlace) -> PlacedSetup:
    """Adjust camera and screen's pose to the surveyed place of a mirror that was located in the image.

    located: The mirror's pose by the image; it follows camera and screen.
    Returns: Camera and screen after one linear adjustment of all their independent errors.

    The image says where the mirror is in the camera's frame, as well as the principal point is known. The camera's turn
    to the screen says where that is in the screen's. Both give way to the place by their sigmas: with amounts a of all
    independent errors (prior 0 +- 1) the place by the image is ``p + J a``, and ``a = J^T (J J^T + S)^-1 (place - p)``
    with S the covariance of the place and of the pose found with everything else held. What is left of the errors hangs
    together, and is kept as steps that move camera and screen at once.
    """
    steps = [one for one in setup_steps(setup) if one.moves_pose]
    here = _place(setup, located, place)
    if not steps:
        return PlacedSetup(setup, here - place.place_m, 1.0, _not_used(here - place.place_m))
    design = np.stack([_place(moved_setup(setup, (one,), np.ones(1)), located, place) - here for one in steps], axis=1)
    turned = located.cam_from_mirror.rotate(place.mirror_point_m)
    by_pose = setup.cam_from_screen.rotation.T @ np.hstack([-skew(turned), np.eye(3)])
    noise = by_pose @ located.covariance @ by_pose.T + np.diag(place.sigma_m**2)
    together = design @ design.T + noise
    gain = np.linalg.solve(together, design).T
    amounts = np.zeros(len(steps))
    for _ in range(_ROUNDS):
        reached = _place(moved_setup(setup, steps, amounts), located, place)
        amounts = gain @ (place.place_m - reached + design @ amounts)
    left = np.eye(len(steps)) - gain @ design
    apart = here - place.place_m
    square = float(apart @ np.linalg.solve(together, apart))
    probability = 1.0 - chi_square_cdf(square, 3.0)
    adjusted = _with_errors(moved_setup(setup, steps, amounts), steps, 0.5 * (left + left.T))
    return PlacedSetup(adjusted, apart, probability, _doubt(apart, together, probability))


def _place(setup: Setup, located: UncertainPose, place: SurveyedPlace) -> FloatArray:
    """Return where the image puts the mirror's point in the screen's frame, camera and screen as in a set-up."""
    pose = located.following(setup, located.cam_from_mirror)
    return setup.cam_from_screen.inverse().apply(pose.apply(place.mirror_point_m))


def _with_errors(setup: Setup, steps: list[SetupStep], covariance: FloatArray) -> Setup:
    """Return a set-up whose camera and screen have errors that hang together.

    covariance (k, k): Of the amounts of the steps.
    """
    pose = np.array([one.cam_from_screen for one in steps])
    camera = np.array([one.camera for one in steps])
    joint = tuple(
        SharedStep(amounts @ pose, _joint_warp(steps, amounts), amounts @ camera)
        for amounts in principal_steps(covariance)
    )
    return replace(
        setup,
        camera=replace(setup.camera, covariance=camera.T @ covariance @ camera),
        covariance_cam_from_screen=pose.T @ covariance @ pose,
        shared_errors=(*(one for one in setup.shared_errors if not one.moves_pose), *joint),
        are_errors_joint=True,
    )


def _joint_warp(steps: list[SetupStep], amounts: FloatArray) -> SmoothWarp:
    found = np.zeros((1, 3))
    for amount, one in zip(amounts, steps, strict=True):
        if isinstance(one.warp, SmoothWarp):
            found = float(amount) * one.warp.coefficients + found
    return SmoothWarp(found)


def _not_used(apart_m: FloatArray) -> Doubt:
    far = float(np.linalg.norm(apart_m))
    return Doubt(
        "place_not_used",
        f"the surveyed place of the mirror was not used, and the image puts the mirror {1e3 * far:.2g} mm beside it: "
        "neither the camera nor the pose of the screen has a sigma, so that nothing can give way to it; state [screen] "
        "sigma_rotation_mrad and sigma_translation_mm, and [camera] sigma_focal_px and sigma_center_px",
        {"apart_m": far},
    )


def _doubt(apart_m: FloatArray, covariance: FloatArray, probability: float) -> Doubt | None:
    if probability >= _LEAST_PROBABILITY:
        return None
    sigma = np.sqrt(np.diag(covariance))
    said = ", ".join(
        f"{axis} {1e3 * one:+.0f} mm (1 sigma {1e3 * other:.0f} mm)"
        for axis, one, other in zip("xyz", apart_m, sigma, strict=True)
    )
    return Doubt(
        "place_contradicts_image",
        f"the image puts the mirror beside its surveyed place, in the screen's frame: {said}; probability "
        f"{probability:.2g}. Camera and screen were adjusted to both; check [mirror.place] (frame, point_m), the pose "
        "of the screen, and the camera's principal point and focal length",
        {"apart_m": float(np.linalg.norm(apart_m)), "agreement_probability": probability},
    )
