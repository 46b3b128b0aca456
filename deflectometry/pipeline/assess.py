"""From images in memory to a judged result: the stages that all sources share follow each other in `measure_source`."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from deflectometry.keys import BenchMeasurement
from deflectometry.pipeline.choices import Choices
from deflectometry.pipeline.contradictions import OTHER_CURVATURE, judge_contradictions, name_exchange
from deflectometry.pipeline.curl_test import with_curl_contained
from deflectometry.pipeline.evaluate import evaluate_source
from deflectometry.pipeline.headline import (
    canting_numbers,
    curl_numbers,
    facet_numbers,
    joined_curl,
    numbers_of_maps,
    pose_numbers,
)
from deflectometry.pipeline.inputs import (
    build_mounts,
    build_place,
    check_missing_sigmas,
    check_screen,
    describe_mirror,
    inputs_without_sigma,
)
from deflectometry.pipeline.mean_normal import mean_normal, turns_by_inputs, words_of_normal
from deflectometry.pipeline.plausibility import implausible, refuse_impossible, size_doubt
from deflectometry.pipeline.result import Result
from deflectometry.pipeline.setup_test import contradiction_of_setup, with_camera_contained
from deflectometry.pipeline.stated_inputs import stated_inputs, unconfirmed_note, with_sigmas_of_images
from deflectometry.pose.find_pose import MirrorInput, find_pose
from deflectometry.pose.surveyed_place import setup_with_place
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.screen_table import check_beyond_table
from deflectometry.shape.assemble import assemble_maps
from deflectometry.shape.facet_canting import canting_of_facets, doubt_of_canting
from deflectometry.sources.source import Source
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import FailurePicture, InputError, showing
from heliogauge.results.folder import hash_files
from heliogauge.running.progress import Progress
from heliogauge.short_repr import ShortRepr
from heliogauge.slopes.removal import Removal, remove


@dataclass(frozen=True, slots=True, eq=False)
class SourceMeasurement(ShortRepr):
    """What a source gives to be evaluated.

    measurement: What the file states.
    source: Images that show known points in the mirror.
    setup: Camera and screen, with what the source adds to their sigmas.
    mirror: What is known of the mirror.
    choices: How the slopes are reported.
    pattern: What was shown, in words.
    pictures: Shows the images where the evaluation fails.
    input_files: Every file that was read.
    doubts: What was found doubtful in the images.
    is_adjusted: Whether camera and screen come from an adjustment of several poses.
    """

    measurement: BenchMeasurement
    source: Source
    setup: Setup
    mirror: MirrorInput
    choices: Choices
    pattern: str
    pictures: Callable[[], Iterable[FailurePicture]]
    input_files: tuple[Path, ...]
    doubts: tuple[Doubt, ...] = ()
    is_adjusted: bool = False


def _with_place(ready: SourceMeasurement, progress: Progress) -> tuple[Setup, MirrorInput, Doubt | None]:
    """Return camera, screen and mirror after the surveyed place of the mirror was heard, where there is one.

    InputError: Several poses, which find camera and screen by themselves.
    """
    place = build_place(ready.measurement.model.mirror)
    if place is None:
        return ready.setup, ready.mirror, None
    if ready.is_adjusted:
        raise InputError("mirror.place: several poses find camera and screen by themselves; leave it out there")
    with progress.stage("surveyed place"):
        located = find_pose(ready.source, ready.setup, ready.mirror)
        placed = setup_with_place(ready.setup, located.pose, place)
    return placed.setup, describe_mirror(ready.measurement, placed.setup), placed.doubt


def measure_source(ready: SourceMeasurement, progress: Progress) -> Result:
    """Evaluate the images of one source and judge the result.

    Returns: Maps, samples, poses and doubts.
    EstimationError: No mirror, no slopes, or a result that contradicts itself.
    """
    measurement, choices = ready.measurement, ready.choices
    with showing(ready.pictures):
        setup, mirror, of_place = _with_place(ready, progress)
        evaluation = evaluate_source(ready.source, setup, mirror, choices, progress)
    refuse_impossible(setup, evaluation.solution.cam_from_mirror)
    with progress.stage("stated inputs"):
        # Curl is held against what was stated: sigmas enlarged for it would explain it away.
        curls = {name: curl_numbers(one) for name, one in evaluation.fine_maps.items()}
        evaluation = with_curl_contained(evaluation, curls)
        inputs, unstated = stated_inputs(setup, evaluation), inputs_without_sigma(measurement, setup)
        contradiction = contradiction_of_setup(evaluation, inputs)
        # Of several poses of one mirror the adjustment finds what the inputs are.
        if not ready.is_adjusted:
            evaluation = with_sigmas_of_images(evaluation, inputs, unstated, contradicted=contradiction is not None)
            evaluation = evaluation if contradiction is None else contradiction.contained(evaluation)
            evaluation = with_camera_contained(setup, evaluation)
    facets, align = evaluation.located.facets, choices.align
    as_measured = assemble_maps(facets, evaluation.maps, align, Removal.NOTHING)
    maps = {name: remove(one, choices.removal) for name, one in evaluation.maps.items()}
    assembled = assemble_maps(facets, maps, align, choices.removal)
    with progress.stage("statistics"):
        mounts_m = build_mounts(measurement.model.mirror)
        cantings = canting_of_facets(facets, evaluation.maps, mounts_m) if len(facets) > 1 else ()
        numbers = facet_numbers(assembled, as_measured) | pose_numbers(evaluation.located, evaluation)
        numbers |= canting_numbers(cantings)
        numbers_by_facet = numbers_of_maps(maps, evaluation.maps, cantings)
        numbers |= joined_curl(evaluation.fine_maps, curls)
        numbers_by_facet = {name: one | curls[name] for name, one in numbers_by_facet.items()}
        normal = mean_normal(setup, evaluation)
        texts = {}
        if normal is not None:
            numbers |= normal.numbers()
            turns = turns_by_inputs(setup, evaluation, inputs)
            texts["mean normal"] = words_of_normal(
                normal, turns, unstated, setup, has_place=measurement.model.mirror.place is not None
            )
    doubts = gather_doubts(
        check_screen(measurement, setup.screen),
        ready.doubts,
        of_place,
        check_missing_sigmas(unstated),
        size_doubt(inputs, unstated),
        evaluation.doubts,
        check_beyond_table(setup.screen, *evaluation.screen_map.points_seen()),
        doubt_of_canting(cantings),
        implausible(numbers, numbers_by_facet, evaluation, ready.source.remedies),
    )
    if contradiction is not None and not any(doubt.code == "slopes_of_no_surface" for doubt in doubts):
        doubts = gather_doubts(doubts, contradiction.doubt)
    doubts = gather_doubts(doubts, unconfirmed_note([one for one in inputs if one.key not in unstated]))
    with progress.stage("check result"):
        refuse = measurement.model.evaluation.contradictions == "refuse"
        doubts = judge_contradictions(ready.source, setup, mirror, evaluation, doubts, curls, refuse=refuse)
        by_code = {doubt.code: doubt for doubt in doubts}
        if OTHER_CURVATURE in by_code:
            curved = by_code[OTHER_CURVATURE]
            named = name_exchange(ready.source, setup, mirror, evaluation, curved)
            doubts = tuple(named if one is curved else one for one in doubts)
    with progress.stage("hash inputs"):
        hashes = hash_files(ready.input_files, measurement.folder)
    return Result(
        setup,
        ready.pattern,
        evaluation,
        maps,
        assembled,
        as_measured,
        numbers,
        numbers_by_facet,
        cantings,
        inputs,
        texts,
        name=measurement.model.name,
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )
