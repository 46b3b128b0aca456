"""How much a result rests on what measurement.toml states: what each input changes, and what the images know of it."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf, isfinite, nan
from typing import Any

import numpy as np

from deflectometry.pipeline.evaluate import MODE_PIXELS, Evaluation
from deflectometry.pose.adjust_pose import MIN_PROBABILITY, MirrorPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.setup_steps import SetupStep, Warp, moved_setup
from deflectometry.shape.common_modes import MovedInput, modes_of_inputs, moved_input
from deflectometry.shape.facet_pixels import PixelSamples, spread_indices, thinned, usable_facets
from deflectometry.shape.smooth_shape import Align
from heliogauge.adjust.chi_square import chi_square_limit, chi_square_noncentrality
from heliogauge.camera.model import PARAMETER_NAMES
from heliogauge.doubts import Doubt, Severity
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.curl_moments import CurlMoments, curl_moments
from heliogauge.slopes.map import CommonModes, SlopeMap
from heliogauge.slopes.normal_angles import d_angles_d_slopes, normal_angles
from heliogauge.slopes.statistics import fit_quadratic
from heliogauge.validate import FloatArray

#: Probability of so much smooth curl below which the set-up is said to contradict the slopes, for all facets together.
CURL_PROBABILITY = 1e-4
#: An error that the tests miss once in ten times counts as one that goes unnoticed.
_MISSED = 0.1
#: A number that is off by more of its sigmas counts as wrong.
_WRONG_SIGMAS = 3.0
_MOST_NAMED = 3
#: An input that leaves so many sigmas, RMS, when it is off as the images have it is not the cause, or not alone.
NOT_THE_CAUSE = 3.0
#: Nodes on which changes are evaluated: they are smooth.
_NODES = 4000
#: Where the modes of inputs without a sigma come from.
UNSTATED = "unstated setup"
#: Table of the inputs.
INPUTS_FILE = "stated_inputs.csv"


@dataclass(frozen=True, slots=True, eq=False)
class StatedInput:
    """One input as stated, and how much the result rests on it.

    key: Its key in measurement.toml.
    words: What it is; error: what is wrong where it is, with "{}" for amount and sigma.
    unit: Of all amounts: "mm", "px" or "mrad".
    stated: Its value; NaN for the sag and for directions of the screen's pose.
    thousandth: A permille of it: of a length or focal length; for the principal point of the focal length, for the
        screen's sag of its size, for its place of the distance to the mirror; 1 mrad for a turn.
    sigma: As stated; 0 where it counts as exact.
    sigma_images: How well the images and the other inputs know it; infinite where they know nothing.
    off_by_images: By how much it is off according to them, all other inputs as stated; 0 where they know nothing.
    left_by_images: RMS of what both tests leave with it off by so much, in their sigmas: about 1 where it can be the
        cause, many where something else is wrong as well.
    unnoticed: Error up to which no test finds it nine times of ten; infinite where no test sees it.
    modes: What one unit does to the slopes of each facet.
    changes (3,): What one unit does to the curvatures along x and y and to the twist [1/m].
    sd (2, 3): Of SDx and SDy: mean over the mirror of the squared angle [rad^2], of the angle times its change for one
        unit, and of that change squared.
    sigma_changes (3,): Standard deviations of the curvatures and of the twist [1/m].
    moved: Camera, screen and the mirror's pose with it off by one unit.

    Reliability in the sense of Baarda (A testing procedure for use in geodetic networks, 1968): the error of one
    observation that the tests do not find, and what it does to the result.
    """

    key: str
    words: str
    error: str
    unit: str
    stated: float
    thousandth: float
    sigma: float
    sigma_images: float
    off_by_images: float
    left_by_images: float
    unnoticed: float
    modes: dict[str, CommonModes]
    changes: FloatArray
    sd: FloatArray
    sigma_changes: FloatArray
    moved: MovedInput

    def sd_changes_rad(self, amount: float) -> FloatArray:
        """Return how SDx and SDy change by an amount, shape (2,) [rad]."""
        square, cross, own = self.sd.T
        return np.asarray(np.sqrt(np.maximum(square + 2 * amount * cross + amount**2 * own, 0.0)) - np.sqrt(square))

    @property
    def sigma_with_misfit(self) -> float:
        """Sigma of the images for this input, larger where they do not fit to it: by the ratio of Birge (1932)."""
        return self.sigma_images * max(1.0, self.left_by_images)

    @property
    def unnoticed_sigmas(self) -> float:
        """How many of their sigmas an unnoticed error moves curvatures and twist, at most."""
        if not self.changes.any():
            return 0.0
        return self.unnoticed * float(np.max(np.abs(self.changes) / np.maximum(self.sigma_changes, 1e-300)))


def stated_inputs(setup: Setup, evaluation: Evaluation) -> tuple[StatedInput, ...]:
    """Return each input with what it does to the result, and what else is known of it.

    Every input is moved by one unit and the whole solution follows, as in `deflectometry.shape.common_modes`. What
    the images know comes from the two tests that hold inputs against each other: the measured distance against the
    one in the image, and the smooth curl of the slopes (of the largest facet, where there are several). The curl of
    slopes by a code is that of its cells, too, and tells nothing.
    """
    located, few = evaluation.located, samples_of_modes(evaluation)
    names = [one.facet.name for one in few]
    units: list[_Unit] = []

    def inputs(cam_from_mirror: RigidTransform) -> Iterator[MovedInput]:
        for one in _units(setup, evaluation, cam_from_mirror):
            units.append(one)
            yield one.moved

    modes = modes_of_inputs(setup, few, evaluation.solution, inputs, align=evaluation.choices.align is Align.NORMAL)
    largest = max(names, key=lambda name: np.count_nonzero(evaluation.fine_maps[name].valid))
    slope_map = evaluation.fine_maps[largest]
    moments = None if evaluation.screen_map.cells.any() else curl_moments(slope_map)
    tests, nodes = _Tests(moments, located.evidence), _Nodes.of(slope_map)
    found = []
    for number, one in enumerate(units):
        single = {
            name: CommonModes((one.words,), mode.coefficients[number : number + 1], mode.center_m, mode.scale_m)
            for name, mode in zip(names, modes, strict=True)
        }
        changes, sd = nodes.changes(single[largest])
        found.append(
            StatedInput(
                one.key,
                one.words,
                one.error,
                one.unit,
                one.stated,
                one.thousandth,
                one.sigma,
                *tests.known_by_images(one, single[largest]),
                tests.unnoticed(one, single[largest]),
                single,
                changes,
                sd,
                nodes.sigma_changes,
                one.moved,
            )
        )
    return tuple(found)


def samples_of_modes(evaluation: Evaluation) -> list[PixelSamples]:
    """Return some pixels of each measured facet, enough for what a wrong input does to it."""
    usable = usable_facets(evaluation.located.facets, evaluation.screen_map, evaluation.facet_index)
    return [thinned(sample, max(MODE_PIXELS // len(usable.samples), 60)) for sample in usable.samples]


def unconfirmed_note(inputs: Sequence[StatedInput]) -> Doubt | None:
    """Return which stated values the result rests on without anything that confirms them.

    A value whose error would move curvature or twist by more than three sigma before any test finds it.
    """
    resting = sorted(
        (one for one in inputs if one.unnoticed_sigmas > _WRONG_SIGMAS), key=lambda one: -one.unnoticed_sigmas
    )
    if not resting:
        return None
    named = "; ".join(map(_words, resting[:_MOST_NAMED]))
    more = f"; {len(resting) - _MOST_NAMED} more in {INPUTS_FILE}" if len(resting) > _MOST_NAMED else ""
    return Doubt(
        "inputs_unconfirmed",
        f"the result is as good as these values, which nothing else in the measurement confirms: {named}{more}. "
        "Measure them twice by independent means, or the mirror in several poses",
        {"inputs_count": len(resting)},
        Severity.NOTE,
    )


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.2g}"


def _words(one: StatedInput) -> str:
    """Say what an input is believed to, what the images know, and what an unnoticed error does."""
    stated = f"stated to {_short(one.sigma)} {one.unit}" if one.sigma > 0 else "taken as exact"
    alone = f"the images know it to {_short(one.sigma_with_misfit)} {one.unit}"
    if not isfinite(one.unnoticed):
        return f"{one.words} ({stated}; the images know nothing of it)"
    of = ("1/f in x", "1/f in y", "twist")[int(np.argmax(np.abs(one.changes) / np.maximum(one.sigma_changes, 1e-300)))]
    return (
        f"{one.words} ({stated}, {alone}: an error up to {_short(one.unnoticed)} {one.unit} goes unnoticed and "
        f"moves {of} by up to {_short(one.unnoticed_sigmas)} sigma)"
    )


def inputs_table(inputs: Sequence[StatedInput]) -> dict[str, list[Any]]:
    """Return a table of the inputs: sigmas, and what one sigma and one thousandth of each change."""
    thousandths = [one.thousandth for one in inputs]
    table: dict[str, list[Any]] = {
        "input": [one.words for one in inputs],
        "key": [one.key for one in inputs],
        "unit": [one.unit for one in inputs],
        "stated": [_or_empty(one.stated) for one in inputs],
        "permille": thousandths,
        "sigma": [one.sigma for one in inputs],
        "sigma_from_images": [_or_empty(one.sigma_images) for one in inputs],
        "off_by_images": [one.off_by_images for one in inputs],
        "left_by_images": [one.left_by_images for one in inputs],
        "unnoticed": [_or_empty(one.unnoticed) for one in inputs],
        "unnoticed_sigmas": [_or_empty(one.unnoticed_sigmas) for one in inputs],
    }
    for words, amounts in (("sigma", [one.sigma for one in inputs]), ("permille", thousandths)):
        pairs = list(zip(inputs, amounts, strict=True))
        for number, name in enumerate(("curvature_x", "curvature_y", "twist")):
            table[f"{name}_per_{words}_per_m"] = [amount * float(one.changes[number]) for one, amount in pairs]
        for number, name in enumerate(("sdx", "sdy")):
            table[f"{name}_per_{words}_rad"] = [float(one.sd_changes_rad(amount)[number]) for one, amount in pairs]
    return table


def _or_empty(value: float) -> float:
    return value if isfinite(value) else nan


def with_sigmas_of_images(
    evaluation: Evaluation, inputs: Sequence[StatedInput], unstated: Collection[str], *, contradicted: bool
) -> Evaluation:
    """Give inputs without a stated sigma the one with which the images know them.

    unstated: Their keys.
    contradicted: The slopes contradict the set-up (`deflectometry.pipeline.setup_test`): what each input would have to
        be off by to explain all of that alone says nothing of it.
    Returns: The evaluation with one more common mode for each of them.

    No sigma is no knowledge, not perfect knowledge: what is left to believe is what the measurement itself says, its
    estimate with the sigma of that. The value stays as stated, so that the square of its distance counts as well.
    """
    chosen = [one for one in inputs if one.key in unstated and isfinite(one.sigma_images)]
    if not chosen:
        return evaluation
    amounts = [hypot(one.sigma_images, 0.0 if contradicted else one.off_by_images) for one in chosen]
    maps = {
        name: with_modes(
            one, [(UNSTATED, item.modes[name], amount) for item, amount in zip(chosen, amounts, strict=True)]
        )
        for name, one in evaluation.maps.items()
    }
    return replace(evaluation, maps=maps)


def with_modes(slope_map: SlopeMap, more: Sequence[tuple[str, CommonModes, float]]) -> SlopeMap:
    """Return a map with further common modes: source, what units of it do, and the amount."""
    common = slope_map.common
    joined = CommonModes(
        (*common.sources, *(source for source, modes, _ in more for _ in modes.coefficients)),
        np.concatenate([common.coefficients, *(amount * mode.coefficients for _, mode, amount in more)]),
        common.center_m,
        common.scale_m,
    )
    return replace(slope_map, common=joined)


# --- one unit of each input -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Unit:
    """An input after one unit of error.

    misclosure_m: What the unit adds to the distance in the image minus the measured one [m].
    variance_m2: Variance of that difference without the input's own sigma [m^2].
    """

    key: str
    words: str
    error: str
    unit: str
    stated: float
    thousandth: float
    sigma: float
    moved: MovedInput
    misclosure_m: float
    variance_m2: float


def _units(setup: Setup, evaluation: Evaluation, cam_from_mirror: RigidTransform) -> Iterator[_Unit]:
    """Yield the inputs, each with one unit of error: mm, px, mrad."""
    located = evaluation.located
    distance = _DistanceInImage.of(located.evidence, setup)

    def unit(
        key: str, words: str, error: str, unit: str, sigma: float, step: SetupStep, size: float, stated: float = nan
    ) -> _Unit:
        moved = moved_input(setup, cam_from_mirror, located.pose, step)
        closes, variance = (0.0, inf) if distance is None else (distance.change_m(setup, step), distance.variance_m2)
        return _Unit(key, words, error, unit, stated, size, sigma, moved, closes, variance)

    if distance is not None:
        yield distance.as_unit(setup, located.pose.cam_from_mirror, cam_from_mirror)
    else:
        away = cam_from_mirror.translation_m / np.linalg.norm(cam_from_mirror.translation_m)
        along = np.concatenate([np.zeros(3), away])
        yield _Unit(
            "mirror.pose.translation_m",
            "the mirror's distance from the camera",
            "the mirror moved away from the camera {} mm",
            "mm",
            1e3 * float(np.linalg.norm(cam_from_mirror.translation_m)),
            float(np.linalg.norm(cam_from_mirror.translation_m)),
            1e3 * float(np.sqrt(along @ located.pose.covariance @ along)),
            MovedInput("mirror", setup, cam_from_mirror.moved(1e-3 * along)),
            0.0,
            inf,
        )
    for name, words in (
        ("focal_x_px", "the camera's focal length in x"),
        ("focal_y_px", "the camera's focal length in y"),
        ("center_x_px", "the camera's principal point in x"),
        ("center_y_px", "the camera's principal point in y"),
    ):
        number = PARAMETER_NAMES.index(name)
        thousandth = 1e-3 * float(setup.camera.parameters[PARAMETER_NAMES.index(f"focal_{name.split('_')[1]}_px")])
        sigma = float(np.sqrt(setup.camera.covariance[number, number]))
        step = SetupStep(words, camera=np.eye(len(PARAMETER_NAMES))[number])
        error = f"{words} off by {{}} px"
        if name.startswith("center"):
            error = f"the camera's principal point moved along {words[-1]} {{}} px"
        stated = float(setup.camera.parameters[number])
        yield unit(f"camera.{name}", words, error, "px", sigma, step, thousandth, stated)
    for axis, (side, order, sign) in enumerate((("width", (1, 0), 1.0), ("height", (0, 1), -1.0))):
        # As in `deflectometry.setup.setup_steps`: a width off by s is an RMS of s / sqrt(12).
        step = SetupStep(side, warp=Warp(axis, order, sign * 1e-3 / 12.0**0.5))
        words, sigma = f"the screen's {side}", 1e3 * float(setup.sigma_size_m[axis])
        error = f"{words} off by {{}} mm"
        size_m = float(setup.size_m[axis])
        yield unit(f"screen.{side}_m", words, error, "mm", sigma, step, size_m, 1e3 * size_m)
    for axis, (order, side) in enumerate((((2, 0), "width"), ((0, 2), "height"))):
        step = SetupStep("sag", warp=Warp(2, order, 1e-3 * 2.0 / (3.0 * 5.0**0.5)))
        words = f"the screen's sag over its {side}"
        thousandth, sigma = float(setup.size_m[axis]), 1e3 * setup.sigma_sag_m
        yield unit("screen.sag", words, f"{words} {{}} mm", "mm", sigma, step, thousandth)
    mirror_m = (setup.cam_from_screen.inverse() @ cam_from_mirror).translation_m
    for letter, direction in zip("xyz", setup.cam_from_screen.rotation.T, strict=True):
        for key, words, error, name, full in (
            ("rotation_vector_rad", "turn about", "turned about", "mrad", np.concatenate([direction, np.zeros(3)])),
            ("translation_m", "place along", "moved along", "mm", np.concatenate([np.zeros(3), direction])),
        ):
            sigma = 1e3 * float(np.sqrt(full @ setup.covariance_cam_from_screen @ full))
            words, error = (
                f"the screen's {words} its {letter} axis",
                f"the screen {error} its {letter} axis {{}} {name}",
            )
            thousandth = 1.0 if name == "mrad" else float(np.linalg.norm(mirror_m))
            step = SetupStep(words, cam_from_screen=1e-3 * full)
            yield unit(f"screen.{key}", words, error, name, sigma, step, thousandth)


@dataclass(frozen=True, slots=True, eq=False)
class _DistanceInImage:
    """The distance that the image alone gives, beside the measured one."""

    evidence: MirrorPose
    image_only: RigidTransform
    usual_m: float

    @classmethod
    def of(cls, evidence: MirrorPose | None, setup: Setup) -> "_DistanceInImage | None":
        if evidence is None or not evidence.observations.distances:
            return None
        image_only = evidence.observations.image_only().pose_with(setup, evidence.cam_from_mirror)
        return cls(evidence, image_only, evidence.observations.distances[0].predict(image_only)[0])

    @property
    def variance_m2(self) -> float:
        """Variance of the difference of both [m^2]."""
        return self._variance_image_m2 + self.evidence.observations.distances[0].sigma_m ** 2

    @property
    def _variance_image_m2(self) -> float:
        return self.evidence.distance_tests[0].sigma_image_only_m ** 2

    def change_m(self, setup: Setup, step: SetupStep) -> float:
        """Return what a step of camera or screen does to the difference [m]."""
        if not step.moves_pose:
            return 0.0
        moved = moved_setup(setup, (step,), np.ones(1))
        pose = self.image_only
        if step.camera.any():
            pose = self.evidence.observations.image_only().pose_with(moved, pose)
        seen = replace(self.evidence.observations.distances[0], cam_point_m=moved.cam_from_screen.translation_m)
        return seen.predict(pose)[0] - self.usual_m

    def as_unit(self, setup: Setup, located: RigidTransform, aligned: RigidTransform) -> _Unit:
        """Return the measured distance itself, 1 mm longer."""
        observations = self.evidence.observations
        first, *rest = observations.distances
        longer = replace(observations, distances=(replace(first, distance_m=first.distance_m + 1e-3), *rest))
        return _Unit(
            "mirror.distance.distance_m",
            "the distance from mirror to screen",
            "the distance from mirror to screen off by {} mm",
            "mm",
            1e3 * first.distance_m,
            first.distance_m,
            1e3 * first.sigma_m,
            MovedInput("distance", setup, longer.pose_with(setup, located) @ located.inverse() @ aligned),
            -1e-3,
            self._variance_image_m2,
        )


# --- what the measurement knows of it -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Tests:
    """What holds the inputs against each other: curl of the slopes, and distance against image."""

    moments: CurlMoments | None
    evidence: MirrorPose | None

    def known_by_images(self, one: _Unit, mode: CommonModes) -> tuple[float, float, float]:
        """Return how well an input is known without its own sigma, by how much it is off then, and what that leaves."""
        seen, along = self._information_of_curl(mode)
        # The input's own errors are part of the curl's covariance.
        share = 1.0 / max(1 - one.sigma**2 * seen, 1e-6)
        information, along, freedom = share * seen, share * along, 0
        chi_square = 0.0
        if self.moments is not None:
            chi_square = self.moments.chi_square + one.sigma**2 * along**2 / share
            freedom = len(self.moments.values_per_m)
        if self.evidence is not None and one.misclosure_m:
            test = self.evidence.distance_tests[0]
            off_m = test.image_only_m - test.measured_m
            information += one.misclosure_m**2 / one.variance_m2
            along += one.misclosure_m * off_m / one.variance_m2
            chi_square += off_m**2 / one.variance_m2
            freedom += 1
        if information <= 0:
            return inf, 0.0, nan
        left = max(chi_square - along**2 / information, 0.0)
        return float(information**-0.5), float(along / information), float((left / max(freedom - 1, 1)) ** 0.5)

    def unnoticed(self, one: _Unit, mode: CommonModes) -> float:
        """Return the error that each test finds nine times of ten, the smaller of both."""
        found = [inf]
        seen, _ = self._information_of_curl(mode)
        if seen > 0 and self.moments is not None:
            found.append((_found_beyond(CURL_PROBABILITY, len(self.moments.values_per_m)) / seen) ** 0.5)
        if one.misclosure_m and self.evidence is not None:
            distance = self.evidence.observations.distances[0]
            variance = self.evidence.distance_tests[0].sigma_image_only_m ** 2 + distance.sigma_m**2
            found.append((_found_beyond(MIN_PROBABILITY, 1) * variance) ** 0.5 / abs(one.misclosure_m))
        return min(found)

    def _information_of_curl(self, mode: CommonModes) -> tuple[float, float]:
        """Return the inverse variance of an input from the curl, and its estimate times that."""
        if self.moments is None:
            return 0.0, 0.0
        effect = self.moments.of_modes(mode)[:, 0]
        weights = np.linalg.solve(self.moments.covariance, effect)
        return float(weights @ effect), float(weights @ self.moments.values_per_m)


def _found_beyond(probability: float, freedom: int) -> float:
    """Return the noncentrality at which a chi-square exceeds its limit nine times of ten."""
    return chi_square_noncentrality(chi_square_limit(probability, freedom), freedom, _MISSED)


@dataclass(frozen=True, slots=True, eq=False)
class _Nodes:
    """Some nodes of a map, ready for changes of its slopes."""

    x_m: FloatArray
    y_m: FloatArray
    angles_rad: FloatArray
    turns: FloatArray
    solver: FloatArray
    sigma_changes: FloatArray

    @classmethod
    def of(cls, slope_map: SlopeMap) -> "_Nodes":
        row, column = np.nonzero(slope_map.valid)
        chosen = spread_indices(row.size, _NODES)
        row, column = row[chosen], column[chosen]
        x_m, y_m = slope_map.x_m[column], slope_map.y_m[row]
        slopes = [one[row, column] for one in (slope_map.slope_x, slope_map.slope_y)]
        design = [one[row, column] for one in (slope_map.design_slope_x, slope_map.design_slope_y)]
        x, y = x_m - x_m.mean(), y_m - y_m.mean()
        zero, unit = np.zeros_like(x), np.ones_like(x)
        columns = np.stack([[x, zero], [zero, y], [y, x], [unit, zero], [zero, unit]]).reshape(5, -1)
        sigma = np.sqrt(np.diag(fit_quadratic(slope_map).covariance))
        return cls(
            x_m,
            y_m,
            normal_angles(*slopes, *design),
            d_angles_d_slopes(*design),
            np.linalg.pinv(columns.T)[:3],
            np.array([2 * sigma[0], 2 * sigma[1], sigma[4]]),
        )

    def changes(self, mode: CommonModes) -> tuple[FloatArray, FloatArray]:
        """Return what a unit does to curvatures and twist, shape (3,), and the means for SDx and SDy, shape (2, 3)."""
        along = mode.evaluate(self.x_m, self.y_m)[0]
        turned = np.einsum("abn,bn->an", self.turns, along)
        means = [
            (one * two).mean(axis=1) for one, two in ((self.angles_rad,) * 2, (self.angles_rad, turned), (turned,) * 2)
        ]
        return np.asarray(self.solver @ along.reshape(-1)), np.stack(means, axis=1)
