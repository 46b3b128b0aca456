"""A measurement folder to results: the stages follow each other in `run`."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

from deflectometry.frames.image_file_checks import check_compression, check_size
from deflectometry.fringes.gray_code import doubt_of_cells
from deflectometry.fringes.known_point import has_open_orders
from deflectometry.fringes.point_by_pose import point_by_pose
from deflectometry.keys import DeflectometryMeasurement
from deflectometry.pipeline.assess import SourceMeasurement, measure_source
from deflectometry.pipeline.choices import Options, build_choices
from deflectometry.pipeline.images import image_files, mend_frames, observe, observe_gray_code, pictures_of_frames
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
from deflectometry.sources.source import Source
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import FailurePicture, showing
from heliogauge.images.photos import Frames, read_frames
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
    setup = build_setup(measurement)
    if adjusted is not None:
        setup = adjusted(setup)
    frames = read_frames(image_files(measurement), jobs=options.jobs, progress=progress)
    check_size(frames.images_dn.shape[:0:-1], setup.camera, str(measurement.folder))
    section = measurement.model.pattern.gray_code
    if section is None:
        used = _fringes(measurement, setup, frames, options, progress)
    else:
        source = observe_gray_code(measurement, section.code, frames)
        used = _Used(source, setup, section.code.describe(), lambda: pictures_of_frames(source))
    mirror = describe_mirror(measurement, used.setup)
    if mirror.known_pose is not None:
        refuse_impossible(used.setup, mirror.known_pose.cam_from_mirror)
    ready = SourceMeasurement(
        measurement,
        used.source,
        used.setup,
        mirror,
        build_choices(measurement, options),
        used.pattern,
        used.pictures,
        measurement.input_files,
        gather_doubts(
            frames.doubts,
            check_compression([file.name for file in measurement.fringe_files]),
            used.doubts,
        ),
        is_adjusted=adjusted is not None,
    )
    result = measure_source(ready, progress)
    return (
        result
        if section is None
        else replace(result, doubts=gather_doubts(result.doubts, doubt_of_cells(result.numbers)))
    )


class _Used(NamedTuple):
    """What the images of a measurement show: source, camera and screen with what it adds to their sigmas, in words."""

    source: Source
    setup: Setup
    pattern: str
    pictures: Callable[[], Iterable[FailurePicture]]
    doubts: tuple[Doubt, ...] = ()


def _fringes(
    measurement: DeflectometryMeasurement, setup: Setup, frames: Frames, options: Options, progress: Progress
) -> _Used:
    """Use fringes as far as they go, and find from where their orders are counted, if they have none of their own."""
    observation = observe(measurement, build_pattern(measurement), frames)
    with progress.stage("check frames"), showing(lambda: pictures_of_frames(observation)):
        usable = mend_frames(observation, strict=options.strict)
    observation = usable.observation
    setup = replace(setup, sigma_periods=usable.sigma_periods)
    if observation.known_point is None and has_open_orders(observation.pattern):
        with progress.stage("place fringes"), showing(lambda: pictures_of_frames(observation)):
            mirror = describe_mirror(measurement, setup)
            if mirror.known_pose is not None:
                refuse_impossible(setup, mirror.known_pose.cam_from_mirror)
            point = point_by_pose(setup, find_pose(observation, setup, mirror))
        observation = replace(observation, known_point=point)
    known, doubts = observation.known_point, usable.doubts
    if known is not None:
        setup = replace(setup, sigma_shift=known.sigma_shift(observation.pattern))
        doubts = gather_doubts(doubts, known.doubt(observation.pattern))
    return _Used(
        observation, setup, pattern_words(observation.pattern), lambda: pictures_of_frames(observation), doubts
    )
