"""A series of photos of dots to one result for each frame; the stages follow each other in `run`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from deflectometry.dots.ground import POLARITIES
from deflectometry.dots.pipeline.measure import build_marks, place_photo
from deflectometry.dots.series.first_shape import FirstShape
from deflectometry.dots.series.frame_slopes import FrameSlopes, KnownMirror
from deflectometry.dots.series.keys import DotSeriesMeasurement
from deflectometry.dots.series.motion import Motion
from deflectometry.dots.series.pipeline.result import FrameRow, SeriesResult
from deflectometry.frames.image_file_checks import check_size
from deflectometry.pipeline.assess import measure_source
from deflectometry.pipeline.choices import Options
from deflectometry.pipeline.result import Result
from deflectometry.shape.smooth_shape import Align
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.images.photos import read_image
from heliogauge.images.video import frames_per_second, list_frames
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.results.folder import hash_files
from heliogauge.results.tables import read_columns_csv
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import FloatArray

#: A place in the pattern with less probability is open.
_SURE = 0.99
#: Of the turn that moves the pattern by one dot: misses beyond leave it to chance which dot is the next one, where the
#: dots look alike.
_OPEN_SHARE = 0.25
#: Sigmas by which tracking and a photo measured by itself may differ: 1 of 400 does in one of two directions.
_APART = 3.2


def run(
    measurement: DotSeriesMeasurement, options: Options | None = None, progress: Progress | None = None
) -> SeriesResult:
    """Measure each frame of a mirror that moves before a field of dots.

    Parameters
    ----------
    measurement : DotSeriesMeasurement
        From `load_series`.
    options : Options, optional
        Choices that override the file's.
    progress : Progress, optional
        Reports each stage.

    Returns
    -------
    SeriesResult
        The first frame as a measurement of its own; normal, tilts and RMS of each frame.

    Raises
    ------
    InputError
        Frames, times or tables that cannot be used; fewer than two frames.
    EstimationError
        The first frame cannot be measured, or none of the others.
    """
    options, progress = options or Options(), progress or SilentProgress()
    if (options.align or Align(measurement.model.evaluation.align)) is not Align.NORMAL:
        file = measurement.folder / MEASUREMENT_FILE
        raise InputError(f'{file}: a series follows the mirror\'s own normal; evaluation.align must be "normal"')
    files, times_s, of_video = _frames(measurement)
    first = measurement.of_frame(files[0])
    photo = place_photo(first, options, progress)
    result = measure_source(photo.ready, progress)
    polarity, marks = POLARITIES[measurement.model.pattern.dots], build_marks(first)
    known = KnownMirror.of(photo, result, polarity, marks)
    motion = Motion(known.step_rad)
    start, shapes = None, dict[str, FirstShape]()
    rows: list[FrameRow] = []
    names = [facet.name for facet in photo.located.facets]
    with progress.stage("frames", len(files)) as stage:
        for file, time_s in zip(files, times_s.tolist(), strict=True):
            expected = known.slopes.solution.cam_from_mirror if start is None else motion.predicted(time_s)
            sigma = known.step_rad if start is None else motion.sigma_rad
            try:
                image = read_image(file)
                check_size(image.shape[::-1], photo.ready.setup.camera, file.name)
                frame = known.measure(image, expected, sigma)
                miss = motion.add(time_s, frame.pose)
                if start is None:
                    shapes, start = _shapes_of(frame), frame
                row = FrameRow.missing(file.name, time_s, "", names).measured(frame, start, shapes)
            except (EstimationError, InputError) as error:
                motion.lose()
                rows.append(FrameRow.missing(file.name, time_s, f"not measured: {error}", names))
            else:
                is_open = frame.probability < _SURE or (marks is None and miss > _OPEN_SHARE * known.step_rad)
                rows.append(replace(row, flag="place open") if is_open else row)
            stage.advance()
    if not any(row.count for row in rows):
        raise EstimationError(f"no frame could be measured as a part of the series; the first is {rows[0].flag}")
    doubts = gather_doubts(of_video, result.doubts, _doubts_of_rows(rows, known, is_marked=marks is not None))
    with progress.stage("farthest frame by itself"):
        doubts = gather_doubts(doubts, _checked(measurement, options, files, rows, result))
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    return SeriesResult(
        first=result,
        rows=tuple(rows),
        name=measurement.model.name,
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def _shapes_of(first: FrameSlopes) -> dict[str, FirstShape]:
    """Return the shapes of the facets that show enough dots in the first frame.

    EstimationError: None does.
    """
    shapes, reasons = dict[str, FirstShape](), list[str]()
    for name, motion in first.facets.items():
        try:
            shapes[name] = FirstShape.of(motion)
        except EstimationError as error:
            reasons.append(str(error))
    if not shapes:
        raise EstimationError("; ".join(reasons))
    return shapes


def _frames(measurement: DotSeriesMeasurement) -> tuple[tuple[Path, ...], FloatArray, tuple[Doubt, ...]]:
    """Return the files of the frames, their times [s], and what is wrong with a video.

    InputError: Fewer than two frames, times that do not ascend or of which one is missing.
    """
    section, file = measurement.model.frames, measurement.folder / MEASUREMENT_FILE
    files, doubts = measurement.photo_files, tuple[Doubt, ...]()
    rate_hz = section.frame_rate_hz
    numbers = np.arange(len(files), dtype=np.float64)
    if section.video is not None:
        video = measurement.path(section.video)
        listed = list_frames(video, every_nth=section.every_nth)
        files, doubts = listed.files, listed.doubts
        # Copies are left out: the name of a frame says which one it was.
        numbers = np.array([float(one.name.rpartition("#")[2]) for one in files])
        rate_hz = rate_hz or frames_per_second(video)
    if len(files) < 2:
        raise InputError(f'{file}: {len(files)} frame is no series; measure it with kind = "deflectometry-dots"')
    if section.times_file is None:
        return files, numbers / (rate_hz or 1.0), doubts
    table = measurement.path(section.times_file)
    texts, columns = read_columns_csv(table, ("image",), ("time_s",))
    times = dict(zip(texts["image"], columns["time_s"].tolist(), strict=True))
    missing = [one.name for one in files if one.name not in times]
    if missing:
        raise InputError(f"{table}: no time of {missing[0]!r}; a row for each photo is needed")
    found = np.array([times[one.name] for one in files])
    if not (np.diff(found) > 0).all():
        raise InputError(f"{table}: time_s must ascend in the order of the photos")
    return files, found, doubts


def _doubts_of_rows(rows: Sequence[FrameRow], known: KnownMirror, *, is_marked: bool) -> tuple[Doubt, ...]:
    doubts = []
    lost = [one for one in rows if one.flag.startswith("not measured")]
    if lost:
        text = (
            f"{len(lost)} of {len(rows)} frames are not measured; the first of them, {lost[0].frame}, is {lost[0].flag}"
        )
        doubts.append(Doubt("frames_not_measured", text, {"frames_count": len(lost)}))
    opened = [one for one in rows if one.flag == "place open"]
    if opened:
        doubts.append(
            Doubt(
                "dot_numbers_open",
                f"which dots are seen is not sure in {len(opened)} of {len(rows)} frames (first {opened[0].frame}): "
                f"their normal, and those that follow, may be off by whole steps of {1e3 * known.step_rad:.2g} mrad; "
                "use dots of two sizes (pattern.marks_file) or more frames in a second",
                {"frames_count": len(opened), "step_rad": known.step_rad},
            )
        )
    elif not is_marked:
        doubts.append(
            Doubt(
                "dots_numbered_from_frame_to_frame",
                "all dots look alike: their numbers follow from frame to frame, and a turn of more than "
                f"{0.5e3 * known.step_rad:.2g} mrad within one, beside the steady one, is taken for a smaller one; "
                "dots of two sizes (pattern.marks_file) tell",
                {"step_rad": known.step_rad},
                Severity.NOTE,
            )
        )
    return tuple(doubts)


def _checked(
    measurement: DotSeriesMeasurement,
    options: Options,
    files: Sequence[Path],
    rows: Sequence[FrameRow],
    first: Result,
) -> Doubt | None:
    """Measure the frame that is turned farthest by itself, outline and all, and compare."""
    measured = [(row, file) for row, file in zip(rows, files, strict=True) if row.count]
    tracked, file = max(measured, key=lambda each: float(np.linalg.norm(each[0].turn_rad)))
    try:
        alone = measure_source(
            place_photo(measurement.of_frame(file), options, SilentProgress()).ready, SilentProgress()
        )
    except EstimationError as error:
        return Doubt("farthest_frame_fails_alone", f"{file.name}, which is turned farthest, fails by itself: {error}")
    names = ("mean_normal_x_rad", "mean_normal_y_rad")
    normal, sigma = (np.array([float(alone.numbers[f"{k}{name}"] or 0.0) for name in names]) for k in ("", "sigma_"))
    before = np.array([float(first.numbers[f"sigma_{name}"] or 0.0) for name in names])
    off = np.abs(normal - tracked.normal_rad)
    if (off < _APART * np.hypot(sigma, before) + 1e-9).all():
        return None
    return Doubt(
        "mirror_left_its_place",
        f"{file.name}, which is turned farthest, measured by itself has its mean normal {1e3 * off[0]:.2g} and "
        f"{1e3 * off[1]:.2g} mrad elsewhere than in the series: the mirror does not turn about its middle, or its "
        "dots have other numbers; compare the outlines of both frames, and measure them one by one",
        {"off_x_rad": float(off[0]), "off_y_rad": float(off[1])},
    )
