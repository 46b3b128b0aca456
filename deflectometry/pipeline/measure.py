"""A measurement folder to results: the stages follow each other in `run`."""

from collections.abc import Callable
from dataclasses import replace

from deflectometry.frames.image_file_checks import check_compression, check_size
from deflectometry.keys import DeflectometryMeasurement
from deflectometry.pipeline.choices import Options, build_choices
from deflectometry.pipeline.contradictions import refuse_contradictions
from deflectometry.pipeline.curl_test import with_curl_contained
from deflectometry.pipeline.evaluate import evaluate_frames
from deflectometry.pipeline.headline import canting_numbers, curl_numbers, facet_numbers, numbers_of_maps, pose_numbers
from deflectometry.pipeline.images import image_files, mend_frames, observe, pictures_of_frames
from deflectometry.pipeline.inputs import (
    build_mounts,
    build_pattern,
    build_setup,
    check_missing_sigmas,
    check_screen,
    describe_mirror,
    inputs_without_sigma,
)
from deflectometry.pipeline.plausibility import implausible, refuse_impossible, size_doubt
from deflectometry.pipeline.result import Result
from deflectometry.pipeline.setup_test import contradiction_of_setup, with_camera_contained
from deflectometry.pipeline.stated_inputs import stated_inputs, unconfirmed_note, with_sigmas_of_images
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.screen_table import check_beyond_table
from deflectometry.shape.assemble import assemble_maps
from deflectometry.shape.facet_canting import canting_of_facets, doubt_of_canting
from heliogauge.doubts import gather_doubts
from heliogauge.errors import showing
from heliogauge.images.photos import read_frames
from heliogauge.results.folder import hash_files
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.removal import Removal, remove


def run(
    measurement: DeflectometryMeasurement,
    options: Options | None = None,
    progress: Progress | None = None,
    *,
    adjusted: Callable[[Setup], Setup] | None = None,
) -> Result:
    """Evaluate a measurement.

    Parameters
    ----------
    measurement : DeflectometryMeasurement
        From `load_deflectometry`.
    options : Options, optional
        Choices that override the file's.
    progress : Progress, optional
        Reports each stage.
    adjusted : callable, optional
        Changes camera and screen from what the file states to what is known better.

    Returns
    -------
    Result
        Maps, pixels, poses and doubts.

    Raises
    ------
    InputError
        Images or tables that cannot be used.
    EstimationError
        Frames that contradict the pattern, no mirror, or no slopes.
    """
    options, progress = options or Options(), progress or SilentProgress()
    setup, pattern = build_setup(measurement), build_pattern(measurement)
    if adjusted is not None:
        setup = adjusted(setup)
    frames = read_frames(image_files(measurement), jobs=options.jobs, progress=progress)
    observation = observe(measurement, pattern, frames)
    check_size(observation.frames.shape[:0:-1], setup.camera, str(measurement.folder))
    with progress.stage("check frames"), showing(lambda: pictures_of_frames(observation)):
        usable = mend_frames(observation, strict=options.strict)
    observation = usable.observation
    setup = replace(setup, sigma_periods=usable.sigma_periods)
    known = observation.known_point
    if known is not None:
        setup = replace(setup, sigma_shift=known.sigma_shift(observation.pattern))
    mirror = describe_mirror(measurement, setup)
    if mirror.known_pose is not None:
        refuse_impossible(setup, mirror.known_pose.cam_from_mirror)
    choices = build_choices(measurement, options)
    with showing(lambda: pictures_of_frames(observation)):
        evaluation = evaluate_frames(observation, setup, mirror, choices, progress)
    refuse_impossible(setup, evaluation.solution.cam_from_mirror)
    with progress.stage("stated inputs"):
        # Curl is held against what was stated: sigmas enlarged for it would explain it away.
        curls = {name: curl_numbers(one) for name, one in evaluation.maps.items()}
        evaluation = with_curl_contained(evaluation, curls)
        inputs, unstated = stated_inputs(setup, evaluation), inputs_without_sigma(measurement, setup)
        contradiction = contradiction_of_setup(evaluation, inputs)
        # Of several poses of one mirror the adjustment finds what the inputs are.
        if adjusted is None:
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
        numbers |= next(iter(curls.values())) if len(facets) == 1 else {}
        numbers_by_facet = {name: one | curls[name] for name, one in numbers_by_facet.items()}
    doubts = gather_doubts(
        check_screen(measurement, setup.screen),
        frames.doubts,
        check_compression([file.name for file in measurement.fringe_files]),
        usable.doubts,
        None if known is None else known.doubt(observation.pattern),
        check_missing_sigmas(unstated),
        size_doubt(inputs, unstated),
        evaluation.doubts,
        check_beyond_table(setup.screen, *evaluation.screen_map.points_seen()),
        doubt_of_canting(cantings),
        implausible(numbers, numbers_by_facet, evaluation),
    )
    if contradiction is not None and not any(doubt.code == "slopes_of_no_surface" for doubt in doubts):
        doubts = gather_doubts(doubts, contradiction.doubt)
    doubts = gather_doubts(doubts, unconfirmed_note([one for one in inputs if one.key not in unstated]))
    with progress.stage("check result"):
        by_code = {doubt.code: doubt for doubt in doubts}
        refuse_contradictions(observation, setup, mirror, evaluation, by_code)
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    return Result(
        setup,
        observation.pattern,
        evaluation,
        maps,
        assembled,
        as_measured,
        numbers,
        numbers_by_facet,
        cantings,
        inputs,
        name=measurement.model.name,
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )
