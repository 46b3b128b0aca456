"""Results that contradict themselves are not written: the exchange that explains it is named where there is one."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.fringes.observation import Observation
from deflectometry.fringes.phase import TURN_RAD
from deflectometry.pipeline.choices import Choices
from deflectometry.pipeline.evaluate import Evaluation, evaluate_frames
from deflectometry.pipeline.headline import facet_numbers
from deflectometry.pipeline.plausibility import implausible, refuse_impossible, turn_in_sigmas
from deflectometry.pose.find_pose import MirrorInput
from deflectometry.setup.camera_and_screen import RectangularScreen, Setup
from deflectometry.setup.patterns import Axis, FringePattern, FringeSet
from deflectometry.shape.assemble import assemble_maps
from heliogauge.camera.distortion import DistortionDirection
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError
from heliogauge.running.progress import SilentProgress
from heliogauge.slopes.removal import Removal

#: Doubts that a mirrored image, exchanged axes or a wrong set-up make.
_CONTRADICTIONS = (
    "reflection_contradicts_outline",
    "slopes_of_no_surface",
    "slopes_too_far_off_design",
    "distance_contradicts_image",
    "lens_contradicts_outline",
)
#: Whatever the distribution of errors, 20 sigma are exceeded at most once in 400 times (Chebyshev's inequality).
_IMPOSSIBLE_SIGMAS = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class _Exchange:
    """Something that may have been exchanged, and what is evaluated when it is put back."""

    words: str
    observation: Observation
    setup: Setup


def refuse_contradictions(
    observation: Observation, setup: Setup, mirror: MirrorInput, evaluation: Evaluation, doubts: Mapping[str, Doubt]
) -> None:
    """Refuse a result that contradicts itself.

    doubts: What makes the result doubtful, by code.
    EstimationError: With one exchange put back nothing contradicts any more, or the reflection is more than 20 sigma
        off the outline, or contradicts an outline that is partly the display's, or the slopes have 20 times the curl
        that noise makes.

    Images mirrored by a program and a mirrored or exchanged pattern leave frames and outline as good as ever. Each is
    tried, with everything that follows from it.
    """
    seen = [doubts[code] for code in _CONTRADICTIONS if code in doubts]
    if not seen:
        return
    explained = [one.words for one in _exchanges(observation, setup) if _agrees(one, mirror, evaluation.choices)]
    if explained:
        raise EstimationError(
            f"{seen[0].text.split(';')[0]}. Nothing contradicts once {' or '.join(explained)}: put that right and "
            "measure again"
        )
    past = doubts.get("mirror_sees_past_display")
    if past is not None and "reflection_contradicts_outline" in doubts:
        # What was taken for the mirror's outline is that of the display.
        raise EstimationError(f"{past.text}. ({doubts['reflection_contradicts_outline'].text.split(';')[0]})")
    turn = turn_in_sigmas(evaluation)
    curl = doubts.get("slopes_of_no_surface")
    ratio = 0.0 if curl is None else curl.numbers["curl_rms_per_m"] / curl.numbers["curl_expected_rms_per_m"]
    if turn > _IMPOSSIBLE_SIGMAS:
        raise EstimationError(f"{turn:.0f} sigma: {doubts['reflection_contradicts_outline'].text}")
    if curl is not None and ratio > _IMPOSSIBLE_SIGMAS:
        raise EstimationError(curl.text)


def _agrees(one: _Exchange, mirror: MirrorInput, choices: Choices) -> bool:
    """Return whether nothing contradicts with an exchange put back."""
    try:
        evaluation = evaluate_frames(one.observation, one.setup, mirror, choices, SilentProgress())
        refuse_impossible(one.setup, evaluation.solution.cam_from_mirror)
        assembled = assemble_maps(evaluation.located.facets, evaluation.maps, choices.align, Removal.NOTHING)
        numbers = facet_numbers(assembled, assembled)
        maps = evaluation.maps
        by_facet = {name: facet_numbers(one, one) for name, one in maps.items()} if len(maps) > 1 else {}
        found = implausible(numbers, by_facet, evaluation)
        return not {doubt.code for doubt in (*found, *evaluation.doubts)}.intersection(_CONTRADICTIONS)
    except (EstimationError, InputError):
        return False


def _exchanges(observation: Observation, setup: Setup) -> Iterator[_Exchange]:
    """Yield what programs and people exchange."""
    both = (
        ("left and right of the images are exchanged", (slice(None), slice(None, None, -1))),
        ("top and bottom of the images are exchanged", (slice(None, None, -1), slice(None))),
        ("the images are turned by 180 deg", (slice(None, None, -1), slice(None, None, -1))),
    )
    known, size_px = observation.known_point, np.array(observation.frames.shape[:0:-1])
    for words, (rows, columns) in both:
        frames = np.ascontiguousarray(observation.frames[:, rows, columns])
        lit = None if observation.lit is None else np.ascontiguousarray(observation.lit[rows, columns])
        point = None if known is None else known.in_image(np.array([columns.step or 1, rows.step or 1]), size_px)
        yield _Exchange(words, replace(observation, frames=frames, lit=lit, known_point=point), setup)
    for words, axes in (
        ("left and right of the displayed pattern are exchanged", (Axis.X,)),
        ("top and bottom of the displayed pattern are exchanged", (Axis.Y,)),
        ("the displayed pattern is turned by 180 deg", (Axis.X, Axis.Y)),
    ):
        sets = tuple(_mirrored(one) if one.axis in axes else one for one in observation.pattern.sets)
        point = None if known is None else known.mirrored(axes)
        yield _Exchange(words, replace(observation, pattern=FringePattern(sets), known_point=point), setup)
    other = {Axis.X: Axis.Y, Axis.Y: Axis.X}
    exchanged = FringePattern(tuple(replace(one, axis=other[one.axis]) for one in observation.pattern.sets))
    words = 'axis = "x" and axis = "y" of [[pattern.set]] are exchanged'
    point = None if known is None else replace(known, display=known.display[::-1])
    yield _Exchange(words, replace(observation, pattern=exchanged, known_point=point), setup)
    screen = setup.screen
    if isinstance(screen, RectangularScreen):
        turned = replace(setup, screen=RectangularScreen(screen.height_m, screen.width_m))
        yield _Exchange("width_m and height_m of [screen] are exchanged", observation, turned)
    lens = setup.camera.distortion
    if not lens.is_zero:
        direction = next(one for one in DistortionDirection if one != lens.direction)
        camera = replace(setup.camera, distortion=replace(lens, direction=direction))
        words = f"distortion_direction of [camera] is {str(direction)!r}"
        yield _Exchange(words, observation, replace(setup, camera=camera))


def _mirrored(one: FringeSet) -> FringeSet:
    """Return a set shown the wrong way round: cos(2 pi P (1 - w) - s) is cos(2 pi P w - (2 pi P - s))."""
    return replace(one, steps_rad=TURN_RAD * one.periods - one.steps_rad)
