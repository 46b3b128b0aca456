"""A measurement folder to results: the stages follow each other in `run`."""

from collections.abc import Callable
from dataclasses import replace

from deflectometry.frames.image_file_checks import check_compression, check_size
from deflectometry.fringes.known_point import has_open_orders
from deflectometry.fringes.point_by_pose import point_by_pose
from deflectometry.keys import DeflectometryMeasurement
from deflectometry.pipeline.assess import SourceMeasurement, measure_source
from deflectometry.pipeline.choices import Options, build_choices
from deflectometry.pipeline.images import image_files, mend_frames, observe, pictures_of_frames
from deflectometry.pipeline.inputs import (
    build_pattern,
    build_setup,
    describe_mirror,
    pattern_words,
)
from deflectometry.pipeline.plausibility import refuse_impossible
from deflectometry.pipeline.result import Result
from deflectometry.pose.find_pose import find_pose
from deflectometry.setup.camera_and_screen import Setup
from heliogauge.doubts import gather_doubts
from heliogauge.errors import showing
from heliogauge.images.photos import read_frames
from heliogauge.running.progress import Progress, SilentProgress


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
    mirror = describe_mirror(measurement, setup)
    if mirror.known_pose is not None:
        refuse_impossible(setup, mirror.known_pose.cam_from_mirror)
    if observation.known_point is None and has_open_orders(observation.pattern):
        with progress.stage("place fringes"), showing(lambda: pictures_of_frames(observation)):
            point = point_by_pose(setup, find_pose(observation, setup, mirror))
        observation = replace(observation, known_point=point)
    known = observation.known_point
    if known is not None:
        setup = replace(setup, sigma_shift=known.sigma_shift(observation.pattern))
    ready = SourceMeasurement(
        measurement,
        observation,
        setup,
        mirror,
        build_choices(measurement, options),
        pattern_words(observation.pattern),
        lambda: pictures_of_frames(observation),
        measurement.input_files,
        gather_doubts(
            frames.doubts,
            check_compression([file.name for file in measurement.fringe_files]),
            usable.doubts,
            None if known is None else known.doubt(observation.pattern),
        ),
        is_adjusted=adjusted is not None,
    )
    return measure_source(ready, progress)
