"""Whether the slopes can be those of a surface with camera, screen and mirror where they are said to stand."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.pipeline.evaluate import Evaluation
from deflectometry.pipeline.stated_inputs import (
    CURL_PROBABILITY,
    NOT_THE_CAUSE,
    StatedInput,
    samples_of_modes,
    with_modes,
)
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.setup_steps import SetupStep
from deflectometry.shape.common_modes import modes_of_inputs, moved_input
from deflectometry.shape.smooth_shape import Align
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.doubts import Doubt
from heliogauge.slopes.curl_moments import CurlMoments, curl_moments
from heliogauge.validate import FloatArray

#: Explanations that leave so little more chi-square than the best one are named beside it: three sigma.
_AS_GOOD = 9.0
_MOST_NAMED = 3
#: And only where it takes most of the chi-square away, as the doubt says.
_MOST = 0.5
#: Where the modes come from that contain what was found.
CONTRADICTION = "setup in contradiction"


@dataclass(frozen=True, slots=True, eq=False)
class SetupContradiction:
    """Slopes that no surface has with the set-up as stated.

    doubt: Which errors would make them.
    inputs: What may be off.
    amounts (m, n): Independent combinations of errors of these inputs that the sigmas have to contain, in their units.
    """

    doubt: Doubt
    inputs: tuple[StatedInput, ...]
    amounts: FloatArray

    def contained(self, evaluation: Evaluation) -> Evaluation:
        """Return the evaluation with sigmas that contain the errors found."""
        maps = {}
        for name, slope_map in evaluation.maps.items():
            single = [one.modes[name] for one in self.inputs]
            together = np.tensordot(self.amounts, np.concatenate([one.coefficients for one in single]), axes=1)
            modes = replace(single[0], sources=(CONTRADICTION,) * len(together), coefficients=together)
            maps[name] = with_modes(slope_map, [(CONTRADICTION, modes, 1.0)])
        return replace(evaluation, maps=maps)


@dataclass(frozen=True, slots=True, eq=False)
class _Explanation:
    """An error of one input that would make the curl that was found.

    amount, sigma: How much of it, in the input's unit.
    chi_square: What it leaves unexplained.
    """

    input: StatedInput
    amount: float
    sigma: float
    chi_square: float

    def __str__(self) -> str:
        return self.input.error.format(f"{self.amount:+.3g} +- {self.sigma:.2g}")


def _camera_steps(camera: Camera, doubts: Sequence[Doubt]) -> Iterator[FloatArray]:
    """Yield the changes of the camera's parameters that the outline in the image asks for, each with its sigma.

    Sides that bend say by how many pixels the lens is off, not by which of its terms: each term is taken to be off by
    as much at the point of the outline that is farthest from the principal point.
    """

    def found(doubt: Doubt, *names: str) -> float:
        return float(np.linalg.norm([doubt.numbers[name] or 0 for name in names]))

    focal_px = camera.focal_x_px
    changes: dict[str, float] = {}
    for doubt in doubts:
        if doubt.code == "lens_contradicts_outline":
            radius, angle = (
                float(doubt.numbers["farthest_px"] or 0) / focal_px,
                found(doubt, "distortion_missing_px", "sigma_distortion_px") / focal_px,
            )
            changes |= {"k1": angle / radius**3, "k2": angle / radius**5}
            # A tangential term moves a point on its axis by 3 p r^2.
            changes |= dict.fromkeys(("p1", "p2"), angle / (3 * radius**2))
        elif doubt.code == "aspect_contradicts_outline":
            changes["focal_x_px"] = found(doubt, "stretch_share", "sigma_stretch_share") * focal_px
    for name, change in changes.items():
        yield change * np.eye(len(PARAMETER_NAMES))[PARAMETER_NAMES.index(name)]


def with_camera_contained(setup: Setup, evaluation: Evaluation) -> Evaluation:
    """Return the evaluation with sigmas that contain the camera which the outline in the image asks for.

    The camera stays as stated: the mirror's sides may be bent themselves. Pose and slopes follow the change, as in
    `deflectometry.shape.common_modes`.
    """
    steps = [SetupStep(CONTRADICTION, camera=one) for one in _camera_steps(setup.camera, evaluation.doubts)]
    if not steps:
        return evaluation
    few = samples_of_modes(evaluation)
    modes = modes_of_inputs(
        setup,
        few,
        evaluation.solution,
        lambda cam_from_mirror: (moved_input(setup, cam_from_mirror, evaluation.located.pose, one) for one in steps),
        align=evaluation.choices.align is Align.NORMAL,
    )
    maps = {
        one.facet.name: with_modes(evaluation.maps[one.facet.name], [(CONTRADICTION, mode, 1.0)])
        for one, mode in zip(few, modes, strict=True)
    }
    return replace(evaluation, maps=maps)


def contradiction_of_setup(evaluation: Evaluation, inputs: Sequence[StatedInput]) -> SetupContradiction | None:
    """Return what is wrong where the smooth curl of the slopes is more than noise and the stated sigmas make.

    The curl of a surface's slopes is zero whatever its shape; slopes computed with a screen that stands elsewhere have
    a smooth one. Its means over the mirror (`heliogauge.slopes.curl_moments`) are hundreds of times more certain than
    the curl at single nodes. Which error explains them is found by moving each input; those that one pose cannot tell
    apart are named together. Where none does alone, all inputs are adjusted to the curl together. Cells of a code make
    a smooth curl of their own, where they beat with the pixels: then nothing is said.
    """
    if evaluation.screen_map.cells.any():
        return None
    found = {name: curl_moments(one) for name, one in evaluation.fine_maps.items()}
    tested = {name: one for name, one in found.items() if one is not None}
    if not tested:
        return None
    least = CURL_PROBABILITY / len(tested)
    # What errors do to waviness only widens the covariance: asked where the smooth part alone does not explain it.
    suspect = {
        name: one.with_waviness(evaluation.fine_responses[name]) for name, one in tested.items() if _chance(one) < least
    }
    if not suspect:
        return None
    name, moments = max(suspect.items(), key=lambda pair: pair[1].chi_square)
    chi_square = moments.chi_square
    if _chance(moments) >= least:
        return None
    explained = sorted((_explain(moments, one, name) for one in inputs), key=lambda one: one.chi_square)
    best = explained[0]
    where = f" (facet {name}, one of {len(found)})" if len(found) > 1 else ""
    ratio, left = (float(np.sqrt(one / len(moments.values_per_m))) for one in (chi_square, best.chi_square))
    text = (
        f"the slopes have {ratio:.1f} times the smooth curl that noise and the stated sigmas make{where}, which no "
        "surface has. "
    )
    numbers = {"curl_ratio": ratio, "unexplained_ratio": left}
    alone = left < NOT_THE_CAUSE and best.chi_square < (1.0 - _MOST) * chi_square
    if alone:
        # What not even the best one explains is no measure of the others.
        as_good = _AS_GOOD * max(1.0, best.chi_square / (len(moments.values_per_m) - 1))
        limit = min(best.chi_square + as_good, (1.0 - _MOST) * chi_square)
        named = [one for one in explained if one.chi_square <= limit][:_MOST_NAMED]
        changes = np.abs([one.amount * one.input.changes for one in named]).max(axis=0)
        numbers |= {"curvature_x_per_m": changes[0], "curvature_y_per_m": changes[1], "twist_per_m": changes[2]}
        concerned = [one.input for one in named]
        # What is left after the best one is more than noise: its amount is less sure by as much.
        amounts = np.diag([float(np.hypot(one.amount, max(left, 1.0) * one.sigma)) for one in named])
        text += (
            f"Most of it would go with {', or '.join(map(str, named))}: by that much 1/f is off by up to "
            f"{2 * changes[0]:.2g} (x) and {2 * changes[1]:.2g} 1/m (y), twist by {changes[2]:.2g} 1/m; the sigmas "
            "were enlarged to contain it. "
        )
    else:
        concerned, (amounts, permille) = list(inputs), _joint(moments, inputs, name)
        numbers["inputs_off_permille"] = permille
        text += (
            "Neither screen, mirror nor camera out of place explains it alone: several are, or the lens or the shape "
            f"of the screen is not as stated; the sigmas were enlarged as if all of them were off by {permille:.2g} "
            "permille (turns by as many mrad), as the curl has it. "
        )
    text += (
        "Measure that again, or state how well it is known ([screen] sigma_rotation_mrad, sigma_translation_mm, "
        "sigma_width_mm, sigma_height_mm; [camera] sigma_focal_px, sigma_center_px; [mirror.distance] sigma_mm)"
    )
    return SetupContradiction(Doubt("setup_contradicts_slopes", text, numbers), tuple(concerned), amounts)


def _chance(moments: CurlMoments) -> float:
    """Return how often errors within the sigmas make so large means."""
    return 1.0 - chi_square_cdf(moments.chi_square, len(moments.values_per_m))


def _explain(moments: CurlMoments, one: StatedInput, facet: str) -> _Explanation:
    """Fit the amount of one error to the curl."""
    effect = moments.of_modes(one.modes[facet])[:, 0]
    weighted = np.linalg.solve(moments.covariance, effect)
    information = max(float(weighted @ effect), 1e-300)
    amount = float(weighted @ moments.values_per_m) / information
    return _Explanation(one, amount, information**-0.5, moments.chi_square - amount**2 * information)


def _joint(moments: CurlMoments, inputs: Sequence[StatedInput], facet: str) -> tuple[FloatArray, float]:
    """Return what errors of all inputs together may be after the curl was seen, and how many permille each is off.

    Returns: Combinations (1 + n, n) of errors whose squares add up to the second moments: what fits best, then the
    principal directions of what the curl leaves open; and the standard deviation of each input [permille].

    Empirical Bayes: errors of all inputs have one standard deviation in permille, the one with which the curl is as
    large as expected (chi-square equals its freedom). Where one input is off by so much others may be, too, also those
    that the curl does not see.
    """
    scale = np.array([one.thousandth for one in inputs])
    effects = np.stack([moments.of_modes(one.modes[facet])[:, 0] for one in inputs], axis=1) * scale
    values, freedom = moments.values_per_m, len(moments.values_per_m)

    def whitened(permille: float) -> FloatArray:
        return np.linalg.solve(
            permille**2 * effects @ effects.T + moments.covariance, np.column_stack([values, effects])
        )

    low, high = 1e-6, 1e6
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if values @ whitened(middle)[:, 0] > freedom else (low, middle)
    solved = high**2 * effects.T @ whitened(high)
    left = high**2 * (np.eye(len(inputs)) - solved[:, 1:])
    size, directions = np.linalg.eigh(0.5 * (left + left.T))
    open_to = directions * np.sqrt(np.maximum(size, 0.0))
    return np.vstack([solved[:, 0], open_to.T]) * scale, high
