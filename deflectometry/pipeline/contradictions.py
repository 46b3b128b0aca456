"""Results that contradict themselves are not written: the exchange that explains it is named where there is one."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from deflectometry.pipeline.choices import Choices
from deflectometry.pipeline.evaluate import Evaluation, map_slopes, solve_reflection
from deflectometry.pipeline.headline import curl_numbers, facet_numbers
from deflectometry.pipeline.plausibility import contradicts_outline, implausible, refuse_impossible, turn_in_sigmas
from deflectometry.pose.find_pose import MirrorInput
from deflectometry.setup.camera_and_screen import RectangularScreen, Setup
from deflectometry.shape.assemble import assemble_maps
from deflectometry.sources.source import Source
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
    source: Source
    setup: Setup


def refuse_contradictions(
    source: Source, setup: Setup, mirror: MirrorInput, evaluation: Evaluation, doubts: Mapping[str, Doubt]
) -> None:
    """Refuse a result that contradicts itself.

    doubts: What makes the result doubtful, by code.
    EstimationError: With one exchange put back nothing contradicts any more, or the reflection is more than 20 sigma
        off the outline, or contradicts an outline that may be that of the display or of some facets only, or the
        slopes have 20 times the curl that noise makes.

    Images mirrored by a program and a mirrored or exchanged pattern leave frames and outline as good as ever. Each is
    tried, with everything that follows from it.
    """
    seen = [doubts[code] for code in _CONTRADICTIONS if code in doubts]
    if not seen:
        return
    explained = [one.words for one in _exchanges(source, setup) if _agrees(one, mirror, evaluation.choices)]
    if explained:
        raise EstimationError(
            f"{seen[0].text.split(';')[0]}. Nothing contradicts once {' or '.join(explained)}: put that right and "
            "measure again"
        )
    past = doubts.get("mirror_sees_past_display")
    if past is not None and "reflection_contradicts_outline" in doubts:
        # What was taken for the mirror's outline is that of the display, or of the facets that are lit.
        words = f"{_dark_facets(evaluation)}{past.text}"
        raise EstimationError(f"{words}. ({doubts['reflection_contradicts_outline'].text.split(';')[0]})")
    turn = turn_in_sigmas(evaluation)
    curl = doubts.get("slopes_of_no_surface")
    ratio = 0.0 if curl is None else curl.numbers["curl_rms_per_m"] / curl.numbers["curl_expected_rms_per_m"]
    if turn > _IMPOSSIBLE_SIGMAS:
        raise EstimationError(f"{turn:.0f} sigma: {doubts['reflection_contradicts_outline'].text}")
    if curl is not None and ratio > _IMPOSSIBLE_SIGMAS:
        raise EstimationError(curl.text)


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


def _agrees(one: _Exchange, mirror: MirrorInput, choices: Choices) -> bool:
    """Return whether nothing contradicts with an exchange put back."""
    try:
        reflection = solve_reflection(one.source, one.setup, mirror, choices, SilentProgress())
        refuse_impossible(one.setup, reflection.solution.cam_from_mirror)
        # Before the maps, which take most of the time.
        if contradicts_outline(reflection):
            return False
        evaluation = map_slopes(reflection, one.setup, SilentProgress())
        assembled = assemble_maps(evaluation.located.facets, evaluation.maps, choices.align, Removal.NOTHING)
        curls = {name: curl_numbers(one) for name, one in evaluation.fine_maps.items()}
        found = implausible(facet_numbers(assembled, assembled), curls, evaluation)
        return not {doubt.code for doubt in (*found, *evaluation.doubts)}.intersection(_CONTRADICTIONS)
    except (EstimationError, InputError):
        return False


def _exchanges(source: Source, setup: Setup) -> Iterator[_Exchange]:
    """Yield what programs and people exchange."""
    for words, other in source.exchanges():
        yield _Exchange(words, other, setup)
    screen = setup.screen
    if isinstance(screen, RectangularScreen):
        turned = replace(setup, screen=RectangularScreen(screen.height_m, screen.width_m))
        yield _Exchange("width_m and height_m of [screen] are exchanged", source, turned)
    lens = setup.camera.distortion
    if not lens.is_zero:
        direction = next(one for one in DistortionDirection if one != lens.direction)
        camera = replace(setup.camera, distortion=replace(lens, direction=direction))
        words = f"distortion_direction of [camera] is {str(direction)!r}"
        yield _Exchange(words, source, replace(setup, camera=camera))
