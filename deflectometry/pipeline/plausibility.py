"""Whether a result can be true: what a wrong setup does to it although every step went well.

Mirrored images, exchanged axes or a screen of the wrong size leave frames and outline as good as ever. They show in the
geometry, in slopes that no surface can have, and in a mirror that is far from its design.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from math import isfinite

import numpy as np

from deflectometry.pipeline.curl_test import CurlRemedies, curl_doubt
from deflectometry.pipeline.design_check import off_design
from deflectometry.pipeline.evaluate import Evaluation, Reflection
from deflectometry.pipeline.headline import flag_words
from deflectometry.pipeline.stated_inputs import StatedInput
from deflectometry.pose.facet_places import MOUNTING_RAD
from deflectometry.pose.find_pose import LocatedMirror
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.smooth_shape import Align
from deflectometry.sources.source import Remedies
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray

Numbers = Mapping[str, float | int | None]

#: Pixels inside the outline that good measurements lose: dust, a few at the noise's limits.
_REJECTED_SHARE = 0.05
#: How many sigma the normal may be off that of the outline, beyond what mounts allow, before that is a doubt.
_TURN_SIGMAS = 5.0


def refuse_impossible(setup: Setup, cam_from_mirror: RigidTransform) -> None:
    """Refuse a setup in which the mirror can see neither camera nor screen.

    EstimationError: The mirror is behind the screen, or its back is turned to the camera.
    """
    camera_m = cam_from_mirror.inverse().translation_m
    if not camera_m[2] > 0:
        raise EstimationError(
            f"the camera is {-camera_m[2]:.3g} m behind the mirror; check [mirror.pose]: it must transform the "
            "mirror's frame (z out of the mirror) into the camera's (z forward)"
        )
    mirror_m = (setup.cam_from_screen.inverse() @ cam_from_mirror).translation_m
    if not mirror_m[2] > 0:
        raise EstimationError(
            f"the mirror is {-mirror_m[2]:.3g} m behind the screen; check rotation_vector_rad and translation_m of "
            "[screen]: they must transform the screen's frame (x right, y up, z towards the viewer) into the camera's, "
            "in radians and metres"
        )


def implausible(
    numbers: Numbers, facets: Mapping[str, Numbers], evaluation: Evaluation, remedies: Remedies
) -> Iterator[Doubt]:
    """Yield what makes a result doubtful as a whole.

    numbers: Headline numbers of the mirror.
    facets: Headline numbers of each facet; empty for a single one.
    remedies: Those of the source.
    """
    yield from _rejection_doubt(evaluation)
    yield from _turn_doubt(evaluation)
    yield from curl_doubt(facets or {"": numbers}, CurlRemedies.of_source(remedies))
    yield from off_design(
        numbers,
        f"size and pose of the screen, {remedies.pattern}, and that no program has mirrored or turned the images",
    )


def size_doubt(inputs: Sequence[StatedInput], unstated: Collection[str]) -> Doubt | None:
    """Say what a screen of another size would do, where nobody says how well its size is known.

    One pose can hardly tell it from the curvature of the mirror.
    """
    sizes = {one.key: one for one in inputs if one.key in ("screen.width_m", "screen.height_m")}
    if not {*sizes, "screen.sag"}.intersection(unstated):
        return None
    width, height = sizes["screen.width_m"], sizes["screen.height_m"]
    per_mm = [2 * abs(float(one.changes[axis])) for axis, one in enumerate((width, height))]
    known = [isfinite(one.sigma_images) for one in (width, height)]
    words = [
        f"{one.sigma_images:.2g} mm" if is_known else "exact, of which the images know nothing"
        for one, is_known in zip((width, height), known, strict=True)
    ]
    counted = "counted as known no better than the images know them" if all(known) else "counted as"
    return Doubt(
        "screen_size_exact",
        "no sigma is given for width, height or sag of the screen ([screen] sigma_width_mm, sigma_height_mm, "
        f"sigma_sag_mm): {counted} ({' and '.join(words)}); 1 mm changes 1/f by {per_mm[0]:.2g} (width, x) and "
        f"{per_mm[1]:.2g} (height, y) per metre, at f = 100 m the focal length by {1e4 * per_mm[0]:.2g} and "
        f"{1e4 * per_mm[1]:.2g} m",
        {"curvature_x_per_mm_per_m": 0.5 * per_mm[0], "curvature_y_per_mm_per_m": 0.5 * per_mm[1]},
    )


def _rejection_doubt(evaluation: Evaluation) -> Iterator[Doubt]:
    """Yield how much of the mirror is missing, and why."""
    on_mirror = evaluation.facet_index >= 0
    rejected = on_mirror & (evaluation.screen_map.flags != 0)
    share = float(np.count_nonzero(rejected)) / max(int(np.count_nonzero(on_mirror)), 1)
    if share > _REJECTED_SHARE:
        yield Doubt(
            "pixels_rejected",
            f"{share:.0%} of the pixels on the mirror were rejected ({flag_words(evaluation)}); all numbers are of the "
            "rest: check the mirror's pose or outline, and what covers or dims it",
            {"rejected_share": share},
        )


def contradicts_outline(reflection: Evaluation | Reflection) -> bool:
    """Return whether the reflection gives another orientation than the outline."""
    return turn_in_sigmas(reflection) > _TURN_SIGMAS


def turn_in_sigmas(evaluation: Evaluation | Reflection) -> float:
    """Return how far the orientation from the reflection is off the one from the outline; 0 without an outline.

    Where two tilts fit the outline alike, so do those between them if the mirror faces the camera: foreshortening goes
    with the square of the tilt, and its sigma to first order says nothing. Half the way to the other tilt counts.
    """
    located = evaluation.located
    if evaluation.choices.align is not Align.NORMAL or located.evidence is None:
        return 0.0
    before, after = located.pose.cam_from_mirror, evaluation.solution.cam_from_mirror
    turn = RigidTransform(after.rotation @ before.rotation.T, np.zeros(3)).rotation_vector_rad
    covariance = _covariance_of_turn(located) + (MOUNTING_RAD**2 + evaluation.sigma_turn_rad**2) * np.eye(3)
    other = located.evidence.other_tilt_rad
    covariance = covariance + 0.25 * np.outer(other, other)
    return float(np.sqrt(turn @ np.linalg.solve(covariance, turn)))


def _covariance_of_turn(located: LocatedMirror) -> FloatArray:
    """Return the covariance (3, 3) of the turn by the outline, with what follows from facets beside their places."""
    covariance = located.pose.covariance[:3, :3]
    for one in located.places:
        by_place = one.pose_by_place[:3]
        covariance = covariance + by_place @ one.covariance_m2 @ by_place.T
    return covariance


def _turn_doubt(evaluation: Evaluation) -> Iterator[Doubt]:
    """Compare the orientation from the reflection with the one from the outline."""
    if not contradicts_outline(evaluation):
        return
    located = evaluation.located
    before, after = located.pose.cam_from_mirror, evaluation.solution.cam_from_mirror
    turn = RigidTransform(after.rotation @ before.rotation.T, np.zeros(3)).rotation_vector_rad
    sigma = float(np.sqrt(np.trace(_covariance_of_turn(located))))
    yield Doubt(
        "reflection_contradicts_outline",
        f"the reflection gives another orientation of the mirror than its outline: "
        f"{1e3 * np.linalg.norm(turn):.1f} mrad apart, where the outline is sure to {1e3 * sigma:.1f} mrad; check "
        "camera (distortion and its direction), pose and size of the screen, outline_m, and that no program has "
        "mirrored or turned the images",
        {"apart_rad": float(np.linalg.norm(turn)), "sigma_outline_rad": sigma},
    )
