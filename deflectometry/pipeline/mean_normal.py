"""Where the mirror as a whole points, in the screen's frame, and what that rests on."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from deflectometry.pipeline.evaluate import Evaluation
from deflectometry.pipeline.headline import Numbers
from deflectometry.pipeline.stated_inputs import StatedInput
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.common_modes import MovedInput, moved_inputs
from deflectometry.shape.smooth_shape import Align
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray

#: Parts of the variance below this are not worth a word.
_LEAST_SHARE = 0.05
_MOST_NAMED = 3


@dataclass(frozen=True, slots=True, eq=False)
class MeanNormal:
    """The mirror's mean normal in the screen's frame, which hangs on the wall where the camera may be moved.

    angles_rad (2,): From straight into the screen (its -z) towards its x and its y axis [rad].
    shares_rad (n, 2): What one sigma of each independent error does to them.
    sources (n,): Which uncertainty each belongs to.
    """

    angles_rad: FloatArray
    shares_rad: FloatArray
    sources: tuple[str, ...]

    @property
    def sigma_rad(self) -> FloatArray:
        """Standard deviations, shape (2,)."""
        return np.asarray(np.linalg.norm(self.shares_rad, axis=0))

    def numbers(self) -> Numbers:
        """Return the angles and their sigmas for the summary."""
        return {
            "mean_normal_x_rad": float(self.angles_rad[0]),
            "sigma_mean_normal_x_rad": float(self.sigma_rad[0]),
            "mean_normal_y_rad": float(self.angles_rad[1]),
            "sigma_mean_normal_y_rad": float(self.sigma_rad[1]),
        }


def mean_normal(setup: Setup, evaluation: Evaluation) -> MeanNormal | None:
    """Return the mirror's mean normal and what it rests on; None where slopes refer to the outline's pose.

    The normal in the middle of a mirror halves the angle between camera and the point of the screen that is seen there.
    An error of camera, screen or pose turns it as it turns that bisector; the shape has no part in it. Of 10^6 pixels
    the noise is nothing beside that.
    """
    if evaluation.choices.align is not Align.NORMAL:
        return None
    middle = _Middle.of(evaluation)
    here = middle.angles(MovedInput("", setup, evaluation.solution.cam_from_mirror))
    moved = tuple(moved_inputs(setup, evaluation.solution.cam_from_mirror, evaluation.located.pose))
    shares = np.array([middle.share(one) * (middle.angles(one) - here) for one in moved]).reshape(-1, 2)
    screen_from_mirror = setup.cam_from_screen.inverse() @ evaluation.solution.cam_from_mirror
    return MeanNormal(normal_angles_of(screen_from_mirror), shares, tuple(one.source for one in moved))


def normal_angles_of(screen_from_mirror: RigidTransform) -> FloatArray:
    """Return the angles of a mirror's normal as in `MeanNormal`, shape (2,) [rad]."""
    return _angles(screen_from_mirror.rotation[:, 2])


def turns_by_inputs(setup: Setup, evaluation: Evaluation, inputs: Iterable[StatedInput]) -> dict[str, FloatArray]:
    """Return how one sigma of each stated input turns the mean normal, (2,) [rad], by the words for it."""
    middle = _Middle.of(evaluation)
    here = middle.angles(MovedInput("", setup, evaluation.solution.cam_from_mirror))
    return {one.words: one.sigma * (middle.angles(one.moved) - here) for one in inputs}


def words_as_exact(unstated: Collection[str]) -> str:
    """Say what counts as exact in the mean normal because nobody states its sigma; empty where that is nothing.

    unstated: Keys, from `deflectometry.pipeline.inputs.inputs_without_sigma`.
    """
    parts = {"camera.focal_x_px": "the camera", "screen.translation_m": "the pose of the screen"}
    return " and ".join(words for key, words in parts.items() if key in unstated)


def words_of_normal(
    found: MeanNormal, turns: Mapping[str, FloatArray], unstated: Collection[str], setup: Setup, *, has_place: bool
) -> str:
    """Say how well the mean normal is known, what rules that, and what would better it.

    turns: Of `turns_by_inputs`, from sigmas that hang together where the place was surveyed.
    unstated: As for `words_as_exact`.
    setup: Camera and screen, after the mirror's surveyed place was heard.
    has_place: Whether there is one.
    """
    sigma = 1e3 * found.sigma_rad
    said = (
        f"{1e3 * found.angles_rad[0]:.3f} and {1e3 * found.angles_rad[1]:.3f} mrad from straight into the screen (its "
        f"-z) towards its x and y, 1 sigma {sigma[0]:.2g} and {sigma[1]:.2g} mrad"
    )
    if exact := words_as_exact(unstated):
        said = f"{said}, with {exact} as exact, of which no sigma is given"
    if setup.are_errors_joint:
        said = f"{said}; from the surveyed place of the mirror"
        if not setup.covariance_cam_from_screen[:3, :3].any():
            return f"{said}, to which the camera gave way and the turn of the screen did not"
        return f"{said}, which tells the turn of camera against screen, too"
    total = float((found.sigma_rad**2).sum())
    by_size = sorted(turns.items(), key=lambda one: -float((one[1] ** 2).sum()))
    named = [
        f"{words} ({_pair(1e3 * turn)})"
        for words, turn in by_size[:_MOST_NAMED]
        if float((turn**2).sum()) > _LEAST_SHARE * total
    ]
    ruled = f"; of it {', '.join(named)}" if named else ""
    if has_place:
        return f"{said}{ruled}; the surveyed place of the mirror was not used, for want of sigmas of camera and screen"
    return (
        f"{said}{ruled}. It is as good as the line from the mirror to the middle between camera and screen: the "
        "surveyed place of a point of the mirror in the screen's frame, [mirror.place], gives it without camera and "
        "turn of the screen"
    )


def _pair(values: FloatArray) -> str:
    """Write two numbers to two digits of the larger: what is only noise of rounding is 0."""
    digits = max(1 - int(np.floor(np.log10(np.abs(values).max()))), 0)
    return ", ".join(f"{one:+.{digits}f}" for one in (np.round(values, digits) + 0.0).tolist())


@dataclass(frozen=True, slots=True, eq=False)
class _Middle:
    """The middle of the mirror, in its frame, what it sees of the display on average, and its measured facets."""

    point_m: FloatArray
    u: float
    v: float
    facets: frozenset[str]

    @classmethod
    def of(cls, evaluation: Evaluation) -> "_Middle":
        names = frozenset(evaluation.images)
        facets = [one for one in evaluation.located.facets if one.name in names]
        corners = np.concatenate([one.ensemble_from_facet.apply(one.corners_m) for one in facets])
        seen = evaluation.facet_index >= 0
        u, v = (float(np.nanmean(one[seen])) for one in (evaluation.screen_map.u, evaluation.screen_map.v))
        return cls(corners.mean(axis=0), u, v, names)

    def share(self, moved: MovedInput) -> float:
        """Return the share of the mirror that an input concerns: the mean of all facets turns by so much of theirs."""
        return 1.0 if moved.facets is None else len(moved.facets & self.facets) / len(self.facets)

    def angles(self, moved: MovedInput) -> FloatArray:
        """Return the angles of the bisector with inputs as moved."""
        screen_from_cam = moved.setup.cam_from_screen.inverse()
        point = screen_from_cam.apply(moved.cam_from_mirror.apply(self.point_m))
        seen = moved.setup.screen.points_m(np.array(self.u), np.array(self.v))
        ways = np.stack([screen_from_cam.translation_m - point, seen - point])
        return _angles((ways / np.linalg.norm(ways, axis=1, keepdims=True)).sum(axis=0))


def _angles(normal: FloatArray) -> FloatArray:
    # A mirror that faces the screen has its normal against the screen's z axis, which points to the viewer.
    return np.asarray(np.arctan2(normal[:2], -normal[2]))
