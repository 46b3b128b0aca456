"""Whether the slopes can be those of a surface with camera, screen and mirror where they are said to stand."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from deflectometry.pipeline.evaluate import MODE_PIXELS, Evaluation
from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.setup_steps import SetupStep
from deflectometry.shape.common_modes import MovedInput, modes_of_inputs, moved_input
from deflectometry.shape.facet_pixels import thinned, usable_facets
from deflectometry.shape.smooth_shape import Align
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.camera.model import PARAMETER_NAMES
from heliogauge.doubts import Doubt
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.curl_moments import CurlMoments, curl_moments
from heliogauge.slopes.map import CommonModes
from heliogauge.validate import FloatArray

#: Below this probability of so much smooth curl the set-up is said to contradict the slopes, for all facets together.
_MIN_PROBABILITY = 1e-4
#: Explanations that leave so little more chi-square than the best one are named beside it: three sigma.
_AS_GOOD = 9.0
_MOST_NAMED = 3
#: An input is named only where it leaves the means within so many of their sigmas, RMS; else none explains the curl.
_EXPLAINED = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class _Explanation:
    """An error of one input that would make the curl that was found.

    words: What is wrong, with "{}" for amount and sigma.
    amount, sigma: How much of it [mrad, mm or px].
    chi_square: What it leaves unexplained.
    """

    words: str
    amount: float
    sigma: float
    chi_square: float
    mode: CommonModes

    def __str__(self) -> str:
        return self.words.format(f"{self.amount:+.3g} +- {self.sigma:.2g}")


def setup_doubt(setup: Setup, evaluation: Evaluation) -> Doubt | None:
    """Return a doubt where the smooth curl of the slopes is more than noise and the stated sigmas make.

    The curl of a surface's slopes is zero whatever its shape; slopes computed with a screen that stands elsewhere have
    a smooth one. Its means over the mirror (`heliogauge.slopes.curl_moments`) are hundreds of times more certain than
    the curl at single nodes. Which error explains them is found by moving each input; those that one pose cannot tell
    apart are named together.
    """
    found = {name: curl_moments(one) for name, one in evaluation.maps.items()}
    tested = {name: one for name, one in found.items() if one is not None}
    if not tested:
        return None
    name, moments = max(tested.items(), key=lambda pair: pair[1].chi_square)
    chi_square = moments.chi_square
    if 1.0 - chi_square_cdf(chi_square, len(moments.values_per_m)) >= _MIN_PROBABILITY / len(tested):
        return None
    explained = sorted(
        (_explain(moments, *pair) for pair in _candidates(setup, evaluation, name).items()),
        key=lambda one: one.chi_square,
    )
    best = explained[0]
    where = f" (facet {name}, one of {len(found)})" if len(found) > 1 else ""
    ratio, left = (float(np.sqrt(one / len(moments.values_per_m))) for one in (chi_square, best.chi_square))
    text = (
        f"the slopes have {ratio:.1f} times the smooth curl that noise and the stated sigmas make{where}, which no "
        "surface has. "
    )
    numbers = {"curl_ratio": ratio, "unexplained_ratio": left}
    if left < _EXPLAINED:
        # What not even the best one explains is no measure of the others.
        as_good = _AS_GOOD * max(1.0, best.chi_square / (len(moments.values_per_m) - 1))
        named = [one for one in explained if one.chi_square < best.chi_square + as_good][:_MOST_NAMED]
        changes = np.abs([_change_of_quadratic(one, moments) for one in named]).max(axis=0)
        numbers |= {
            "curvature_x_per_m": 2 * changes[0],
            "curvature_y_per_m": 2 * changes[1],
            "twist_per_m": changes[2],
        }
        text += (
            f"Most of it would go with {', or '.join(map(str, named))}: by that much 1/f is off by up to "
            f"{2 * changes[0]:.2g} (x) and {2 * changes[1]:.2g} 1/m (y), twist by {changes[2]:.2g} 1/m, which their "
            "sigmas do not contain. "
        )
    else:
        text += (
            "Neither screen, mirror nor principal point out of place explains it alone: several are, or the lens or "
            "the shape of the screen is not as stated. "
        )
    text += (
        "Measure that again, or state how well it is known ([screen] sigma_rotation_mrad, sigma_translation_mm; "
        "[camera] sigma_center_px; [mirror.distance] sigma_mm)"
    )
    return Doubt("setup_contradicts_slopes", text, numbers)


def _explain(moments: CurlMoments, words: str, mode: CommonModes) -> _Explanation:
    """Fit the amount of one error to the curl."""
    effect = moments.of_modes(mode)[:, 0]
    weighted = np.linalg.solve(moments.covariance, effect)
    information = max(float(weighted @ effect), 1e-300)
    amount = float(weighted @ moments.values_per_m) / information
    left = moments.chi_square - amount**2 * information
    return _Explanation(words, amount, information**-0.5, left, mode)


def _change_of_quadratic(one: _Explanation, moments: CurlMoments) -> FloatArray:
    """Return the changes of A, B and E of the best-fit quadratic [1/m]."""
    row, column = np.nonzero(moments.slope_map.valid)
    x_m, y_m = moments.slope_map.x_m[column], moments.slope_map.y_m[row]
    x, y = x_m - x_m.mean(), y_m - y_m.mean()
    along_x, along_y = one.amount * one.mode.evaluate(x_m, y_m)[0]
    zero, unit = np.zeros_like(x), np.ones_like(x)
    columns = np.stack([[2 * x, zero], [zero, 2 * y], [y, x], [unit, zero], [zero, unit]]).reshape(5, -1)
    solved = np.linalg.lstsq(columns.T, np.concatenate([along_x, along_y]), rcond=None)[0]
    return np.asarray(solved[:3])


def _candidates(setup: Setup, evaluation: Evaluation, facet: str) -> dict[str, CommonModes]:
    """Return what a unit of each possible error does to the slopes of a facet, by the words for it."""
    located = evaluation.located
    usable = usable_facets(located.facets, evaluation.screen_map, evaluation.facet_index)
    few = [thinned(sample, max(MODE_PIXELS // len(usable.samples), 60)) for sample in usable.samples]
    number = [sample.facet.name for sample in few].index(facet)
    words: list[str] = []

    def inputs(cam_from_mirror: RigidTransform) -> Iterator[MovedInput]:
        for one in _moved_inputs(setup, cam_from_mirror, located.pose):
            words.append(one.source)
            yield one

    align = evaluation.choices.align is Align.NORMAL
    modes = modes_of_inputs(setup, few, evaluation.solution, inputs, align=align)[number]
    return {
        one: CommonModes((one,), modes.coefficients[k : k + 1], modes.center_m, modes.scale_m)
        for k, one in enumerate(words)
    }


def _moved_inputs(setup: Setup, cam_from_mirror: RigidTransform, located: UncertainPose) -> Iterator[MovedInput]:
    """Yield inputs with one unit of error each: mrad, mm, px."""
    for axis, direction in zip("xyz", setup.cam_from_screen.rotation.T, strict=True):
        for words, step in (
            (f"the screen turned about its {axis} axis {{}} mrad", np.concatenate([direction, np.zeros(3)])),
            (f"the screen moved along its {axis} axis {{}} mm", np.concatenate([np.zeros(3), direction])),
        ):
            yield moved_input(setup, cam_from_mirror, located, SetupStep(words, cam_from_screen=1e-3 * step))
    away = cam_from_mirror.translation_m / np.linalg.norm(cam_from_mirror.translation_m)
    farther = cam_from_mirror.moved(np.concatenate([np.zeros(3), 1e-3 * away]))
    yield MovedInput("the mirror moved away from the camera {} mm", setup, farther)
    for name, axis in (("center_x_px", "x"), ("center_y_px", "y")):
        step = np.eye(len(PARAMETER_NAMES))[PARAMETER_NAMES.index(name)]
        words = f"the camera's principal point moved along {axis} {{}} px"
        yield moved_input(setup, cam_from_mirror, located, SetupStep(words, camera=step))
