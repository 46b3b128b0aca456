"""Results that contradict themselves are refused or doubted; the exchange that explains it is named."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.pipeline.choices import Choices
from deflectometry.pipeline.evaluate import Evaluation, Reflection, map_slopes, reflect
from deflectometry.pipeline.few_slopes import contradicted_by_few
from deflectometry.pipeline.headline import Numbers, curl_numbers, facet_numbers
from deflectometry.pipeline.plausibility import contradicts_outline, implausible, refuse_impossible, turn_in_sigmas
from deflectometry.pose.find_pose import LocatedMirror, MirrorInput, find_pose
from deflectometry.setup.camera_and_screen import RectangularScreen, Setup
from deflectometry.shape.assemble import assemble_maps
from deflectometry.shape.smooth_shape import ShapeSolution
from deflectometry.sources.source import Source
from heliogauge.camera.distortion import DistortionDirection
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.running.progress import SilentProgress
from heliogauge.slopes.removal import Removal
from heliogauge.validate import FloatArray

#: Doubts that a mirrored image, exchanged axes or a wrong set-up make.
_CONTRADICTIONS = (
    "reflection_contradicts_outline",
    "slopes_of_no_surface",
    "slopes_too_far_off_design",
    "distance_contradicts_image",
    "lens_contradicts_outline",
)
#: Far from the mirror the only doubt that they make.
OTHER_CURVATURE = "design_curvature_is_not_the_mirrors"
#: Whatever the distribution of errors, 20 sigma are exceeded at most once in 400 times (Chebyshev's inequality).
_IMPOSSIBLE_SIGMAS = 20.0
#: Share of a curvature's error that is left where an exchange explains it: that of the curvature itself where the
#: design is doubted for it.
_EXPLAINED_SHARE = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class _Exchange:
    """Something that may have been exchanged, and what is evaluated when it is put back.

    is_of_lens: Whether it is the direction of the lens, which changes little.
    located: Where the mirror then is, where that is known already.
    """

    words: str
    source: Source
    setup: Setup
    is_of_lens: bool = False
    located: LocatedMirror | None = None

    def locate(self, mirror: MirrorInput) -> LocatedMirror | None:
        """Return where the mirror is; None where it is not found."""
        if self.located is not None:
            return self.located
        try:
            return find_pose(self.source, self.setup, mirror)
        except (EstimationError, InputError):
            return None


def judge_contradictions(
    source: Source,
    setup: Setup,
    mirror: MirrorInput,
    evaluation: Evaluation,
    doubts: tuple[Doubt, ...],
    curls: Mapping[str, Numbers],
    *,
    refuse: bool,
) -> tuple[Doubt, ...]:
    """Refuse a result that contradicts itself; where the cause is not proven, or refusals are not wanted, doubt it.

    doubts: What makes the result doubtful.
    curls: Curl of each facet and its expectation by the sigmas as stated.
    refuse: ``[evaluation] contradictions = "refuse"``.
    Returns: The doubts, the first contradiction a serious one with its explanation.
    EstimationError: With one exchange put back nothing contradicts any more, or the reflection is more than 20 sigma
        off the outline, or contradicts an outline that may be that of the display or of some facets only, or the
        slopes have 20 times the curl that noise makes.

    Images mirrored by a program and a mirrored or exchanged pattern leave frames and outline as good as ever. Each is
    tried, with everything that follows from it: first what the outline says, then some pixels, then all. The other
    direction of the lens moves the image by pixels only, as facets that are off their stated places do: it is believed
    where the sides in the image are bent as by another lens.
    """
    by_code = {doubt.code: doubt for doubt in doubts}
    seen = [by_code[code] for code in _CONTRADICTIONS if code in by_code]
    if not seen:
        return doubts
    exchanges = _exchanges(source, setup, mirror, evaluation)
    explained = [one for one in exchanges if _agrees(one, mirror, evaluation.choices, curls)]
    found = _proven(explained, seen[0], by_code, evaluation)
    if found is not None and refuse:
        raise EstimationError(f'{found}. ([evaluation] contradictions = "report" has the result all the same)')
    if found is None:
        if not explained:
            return doubts
        found = (
            f"{seen[0].text.split(';')[0]}; nothing contradicts once {_either(explained)}, but places of facets, "
            "outline or screen that are a little off may do the same: check the camera's calibration, then these"
        )
    return tuple(replace(one, text=found, severity=Severity.SERIOUS) if one is seen[0] else one for one in doubts)


def _proven(
    explained: Sequence[_Exchange], first: Doubt, doubts: Mapping[str, Doubt], evaluation: Evaluation
) -> str | None:
    """Say what is wrong for certain; None where that is open.

    explained: Exchanges with which nothing contradicts.
    first: The first contradiction.
    """
    sides = doubts.get("lens_contradicts_outline")
    believed = [one for one in explained if not one.is_of_lens or _is_bent_so(sides, one.setup)]
    if believed:
        return (
            f"{first.text.split(';')[0]}. Nothing contradicts once {_either(believed)}: put that right and measure "
            "again"
        )
    past = doubts.get("mirror_sees_past_display")
    if past is not None and "reflection_contradicts_outline" in doubts:
        # What was taken for the mirror's outline is that of the display, or of the facets that are lit.
        words = f"{_dark_facets(evaluation)}{past.text}"
        return f"{words}. ({doubts['reflection_contradicts_outline'].text.split(';')[0]})"
    turn = turn_in_sigmas(evaluation)
    curl = doubts.get("slopes_of_no_surface")
    ratio = 0.0 if curl is None else curl.numbers["curl_rms_per_m"] / curl.numbers["curl_expected_rms_per_m"]
    if turn > _IMPOSSIBLE_SIGMAS:
        return f"{turn:.0f} sigma: {doubts['reflection_contradicts_outline'].text}"
    if curl is not None and ratio > _IMPOSSIBLE_SIGMAS:
        return curl.text
    return None


def _is_bent_so(sides: Doubt | None, setup: Setup) -> bool:
    """Return whether the sides in the image are bent as the other direction of the lens would bend them, to 3 sigma.

    sides: What they say against the lens.
    """
    if sides is None:
        return False
    numbers, camera = sides.numbers, setup.camera
    farthest_px = numbers["farthest_px"]
    # To first order the other direction is the other sign of k1.
    reversed_px = -2 * camera.distortion.k1 * farthest_px * (farthest_px / camera.focal_x_px) ** 2
    return abs(numbers["distortion_missing_px"] - reversed_px) < 3 * numbers["sigma_distortion_px"]


def _either(exchanges: Sequence[_Exchange]) -> str:
    return " or ".join(one.words for one in exchanges)


def _dark_facets(evaluation: Evaluation) -> str:
    """Say that dark facets may be why the outline is another one; nothing where the image has a part for each."""
    evidence, count = evaluation.located.evidence, len(evaluation.located.facets)
    parts = None if evidence is None else evidence.bright_parts
    if parts is None or parts >= count:
        return ""
    return (
        f"the image shows {parts} bright part{'s' * (parts > 1)} for {count} facets: the outline of those that are lit"
        " may have been taken for that of all (light all, or describe those that are lit in [[mirror.facet]]); or "
    )


def name_exchange(source: Source, setup: Setup, mirror: MirrorInput, evaluation: Evaluation, doubt: Doubt) -> Doubt:
    """Name the exchanges that explain why the curvature is not the design's.

    doubt: That of the curvature.
    Returns: The doubt, a serious one where an exchange explains it.

    From far away images or a pattern that are turned or mirrored contradict nothing else. The result is not refused: a
    mirror that is bent the other way looks the same. No maps are made, which take most of the time.
    """
    facets = {one.name: one for one in evaluation.located.facets}
    found = _linear_slopes([facets[name] for name in evaluation.images], evaluation.solution)
    if not _may_be_exchanged(found, setup, evaluation.solution.cam_from_mirror):
        return doubt
    explained = []
    for one in _of_source(source, setup, mirror, evaluation):
        located = one.locate(mirror)
        reflection = None if located is None else _reflection(one, mirror, located, evaluation.choices)
        if reflection is not None:
            measured = [sample.facet for sample in reflection.usable.samples]
            there = _linear_slopes(measured, reflection.solution)
            if there.off_design < _EXPLAINED_SHARE * found.off_design:
                explained.append(one.words)
    if not explained:
        return doubt
    text = (
        f"{doubt.text.split(';')[0]}; it is once {' or '.join(explained)}: put that right and measure again, unless "
        "the mirror is bent so, or its design has the wrong sign"
    )
    return replace(doubt, text=text, severity=Severity.SERIOUS)


@dataclass(frozen=True, slots=True, eq=False)
class _LinearSlopes:
    """Changes of both slopes along x and y over the whole mirror, each of shape (2, 2) [1/m]."""

    measured: FloatArray
    design: FloatArray

    @property
    def off_design(self) -> float:
        """How far both are apart [1/m]."""
        return float(np.linalg.norm(self.measured - self.design))


def _linear_slopes(facets: Sequence[Facet], solution: ShapeSolution) -> _LinearSlopes:
    """Fit planes to the slopes of smooth shapes and designs at the corners of the measured facets."""
    points, slopes = [], []
    for facet, surface in zip(facets, solution.surfaces, strict=True):
        x, y = facet.outline_m.T
        place = facet.ensemble_from_facet
        points.append(place.apply(np.column_stack([x, y, np.zeros(x.size)])))
        both = []
        for one in (surface, facet.design):
            slope_x, slope_y = one.gradient(x, y)
            normals = place.rotate(np.column_stack([-slope_x, -slope_y, np.ones(x.size)]))
            both.append(-normals[:, :2] / normals[:, 2:])
        slopes.append(np.hstack(both))
    every = np.concatenate(points)
    every[:, 2] = 1.0
    fitted = np.asarray(np.linalg.lstsq(every, np.concatenate(slopes), rcond=None)[0][:2].T, np.float64)
    return _LinearSlopes(fitted[:2], fitted[2:])


def _may_be_exchanged(found: _LinearSlopes, setup: Setup, cam_from_mirror: RigidTransform) -> bool:
    """Return whether turning or mirroring what is seen may explain the curvature.

    A mirror whose slopes are c times the place, with c the mean of 1 / distance to camera and screen, shows one point
    of the screen all over. What others show goes with their curvature beside c. Images or a pattern that are turned or
    mirrored multiply that by orthogonal matrices, so that its singular values stay.
    """
    in_screen = setup.cam_from_screen.inverse() @ cam_from_mirror
    distances_m = [float(np.linalg.norm(one.translation_m)) for one in (cam_from_mirror, in_screen)]
    focus = 0.5 * sum(1.0 / one for one in distances_m) * np.eye(2)
    own, other = (np.linalg.svd(one - focus, compute_uv=False) for one in (found.measured, found.design))
    return bool(np.linalg.norm(own - other) < _EXPLAINED_SHARE * found.off_design)


def _agrees(one: _Exchange, mirror: MirrorInput, choices: Choices, curls: Mapping[str, Numbers]) -> bool:
    """Return whether nothing contradicts with an exchange put back."""
    located = one.locate(mirror)
    if located is None or _contradict(located.doubts):
        return False
    reflection = _reflection(one, mirror, located, choices)
    # Before all pixels and the maps, which take most of the time.
    if reflection is None or _contradict(contradicted_by_few(reflection, one.setup, one.source.remedies, curls)):
        return False
    try:
        evaluation = map_slopes(reflection, one.setup, SilentProgress())
        assembled = assemble_maps(evaluation.located.facets, evaluation.maps, choices.align, Removal.NOTHING)
        own = {name: curl_numbers(one) for name, one in evaluation.fine_maps.items()}
        found = implausible(facet_numbers(assembled, assembled), own, evaluation, one.source.remedies)
        return not _contradict((*found, *evaluation.doubts))
    except (EstimationError, InputError):
        return False


def _contradict(doubts: Iterable[Doubt]) -> bool:
    """Return whether doubts are those of a mirrored image, exchanged axes or a wrong set-up."""
    return not {doubt.code for doubt in doubts}.isdisjoint(_CONTRADICTIONS)


def _reflection(one: _Exchange, mirror: MirrorInput, located: LocatedMirror, choices: Choices) -> Reflection | None:
    """Return pose and smooth shape with an exchange put back; None where there are none or the outline contradicts."""
    try:
        reflection = reflect(one.source, one.setup, mirror, located, choices, SilentProgress())
        refuse_impossible(one.setup, reflection.solution.cam_from_mirror)
    except (EstimationError, InputError):
        return None
    return None if contradicts_outline(reflection) else reflection


def _exchanges(source: Source, setup: Setup, mirror: MirrorInput, evaluation: Evaluation) -> Iterator[_Exchange]:
    """Yield what programs and people exchange."""
    yield from _of_source(source, setup, mirror, evaluation)
    screen = setup.screen
    if isinstance(screen, RectangularScreen):
        turned = replace(setup, screen=RectangularScreen(screen.height_m, screen.width_m))
        located = evaluation.located if mirror.facets else None
        yield _Exchange("width_m and height_m of [screen] are exchanged", source, turned, located=located)
    lens = setup.camera.distortion
    if not lens.is_zero:
        direction = next(one for one in DistortionDirection if one != lens.direction)
        camera = replace(setup.camera, distortion=replace(lens, direction=direction))
        words = f"distortion_direction of [camera] is {str(direction)!r}"
        yield _Exchange(words, source, replace(setup, camera=camera), is_of_lens=True)


def _of_source(source: Source, setup: Setup, mirror: MirrorInput, evaluation: Evaluation) -> Iterator[_Exchange]:
    """Yield what may be exchanged in images and pattern."""
    for one in source.exchanges(evaluation.screen_map):
        # Without an outline the reflection itself says where the mirror is.
        stays = bool(mirror.facets) and not one.moves_outline
        yield _Exchange(one.words, one.source, setup, located=evaluation.located if stays else None)
