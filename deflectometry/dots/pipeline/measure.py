"""A photo of dots seen in a mirror to results: the stages follow each other in `run`."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.dots.dot_source import DotSource
from deflectometry.dots.found_dots import FoundDots, find_dots
from deflectometry.dots.ground import POLARITIES, ground_of_dots, without_dots
from deflectometry.dots.keys import DotPatternSection, DotsMeasurement
from deflectometry.dots.origin import PlacedDots, Sight, find_light, place_dots
from deflectometry.frames.image_file_checks import check_compression, check_size
from deflectometry.pipeline.assess import SourceMeasurement, measure_source
from deflectometry.pipeline.choices import Options, build_choices
from deflectometry.pipeline.inputs import build_setup, describe_mirror
from deflectometry.pipeline.plausibility import refuse_impossible
from deflectometry.pipeline.result import Result
from deflectometry.pose.find_pose import find_pose
from deflectometry.pose.mirror_outline import mirror_masks
from deflectometry.setup.dot_screen import DotScreen
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import FailurePicture, InputError, showing
from heliogauge.images.photos import read_frames
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import BoolArray, Float32Array, IntArray

#: Share of the mirror with dots below which a part of it has none: around a mirror with 40 dots across, half a
#: dot's distance along the edges is 5 %, and as much may be lost to clips.
_DOTTED_SHARE = 0.9


def run(measurement: DotsMeasurement, options: Options | None = None, progress: Progress | None = None) -> Result:
    """Evaluate a photo of a field of dots seen in a mirror.

    Parameters
    ----------
    measurement : DotsMeasurement
        From `load_dots`.
    options : Options, optional
        Choices that override the file's.
    progress : Progress, optional
        Reports each stage.

    Returns
    -------
    Result
        Maps, dots, poses and doubts.

    Raises
    ------
    InputError
        A photo or table that cannot be used.
    EstimationError
        No mirror, too few dots, no lattice, or slopes that contradict themselves.
    """
    options, progress = options or Options(), progress or SilentProgress()
    setup = build_setup(measurement)
    screen = setup.screen
    if not isinstance(screen, DotScreen):
        raise InputError(
            f"{measurement.folder / MEASUREMENT_FILE}: [screen] must be a field of dots (shape dots, or measured by "
            f"its dots), not a {screen.describe()}"
        )
    frames = read_frames((measurement.path(measurement.model.photo),), jobs=options.jobs, progress=progress)
    photo = np.asarray(frames.images_dn[0])
    check_size(photo.shape[::-1], setup.camera, str(measurement.path(measurement.model.photo)))
    mirror = describe_mirror(measurement, setup)
    if mirror.known_pose is not None:
        refuse_impossible(setup, mirror.known_pose.cam_from_mirror)
    pattern = measurement.model.pattern
    polarity = POLARITIES[pattern.dots]
    with progress.stage("find dots"), showing(lambda: _pictures(photo)):
        everywhere = find_dots(photo, np.ones(photo.shape, dtype=np.bool_), polarity)
        ground = ground_of_dots(photo, everywhere, polarity)
        source = DotSource(without_dots(photo, ground, everywhere), None, screen)
    with progress.stage("place in the pattern"), showing(lambda: _pictures(photo)):
        located = find_pose(source, setup, mirror)
        masks = mirror_masks(setup.camera, located.outline_pose, located.facets, margin_px=located.margin_px)
        known = _known_dot(pattern, photo, ground, masks.facet_index >= 0)
        placed = place_dots(everywhere, Sight(setup, screen, located.pose, located.facets[0]), known)
    rows, columns = screen.shape
    setup = replace(setup, sigma_shift=placed.sigma_shift / (columns - 1, rows - 1))
    ready = SourceMeasurement(
        measurement,
        replace(source, dots=placed.dots),
        setup,
        mirror,
        build_choices(measurement, options),
        _words(placed, pattern, screen),
        lambda: _pictures(photo),
        measurement.input_files,
        gather_doubts(
            frames.doubts,
            check_compression([measurement.model.photo]),
            placed.doubt,
            _coarse(placed.dots),
            _missing(placed.dots, masks.facet_index >= 0),
        ),
    )
    return measure_source(ready, progress)


def _known_dot(
    pattern: DotPatternSection, photo: npt.NDArray[Any], ground: Float32Array, region: npt.NDArray[np.bool_]
) -> tuple[IntArray, npt.NDArray[np.float64]] | None:
    """Return the numbers of a dot in the table and its place in the photo, where the pattern says one."""
    if pattern.known_dot is not None:
        known = pattern.known_dot
        return np.array([known.column, known.row]), np.array(known.image_px)
    if pattern.origin == "light":
        return np.zeros(2, dtype=np.intp), find_light(photo, ground, region)
    return None


def _words(placed: PlacedDots, pattern: DotPatternSection, screen: DotScreen) -> str:
    by = "known dot" if pattern.known_dot is not None else "light at dot (0, 0)"
    if pattern.known_dot is None and pattern.origin != "light":
        by = f"likeliest place, probability {placed.probability:.3g}"
    return f"{len(placed.dots.number)} {pattern.dots} dots of a {screen.describe()}, placed by the {by}"


def _coarse(dots: FoundDots) -> Doubt | None:
    """Return a doubt where more than a tenth of the dots has the centre of an outline only."""
    share = dots.n_coarse / len(dots.number)
    if share <= 0.1:
        return None
    return Doubt(
        "dots_without_fitted_centre",
        f"{share:.0%} of the dots are no blurred discs: they have the centre of their outline, with a larger sigma; "
        "check focus and exposure, and that a dot covers 4 px and more",
        {"coarse_share": share},
    )


def _missing(dots: FoundDots, region: BoolArray) -> Doubt | None:
    """Return a doubt where a part of the mirror shows no dots.

    region (h, w): Pixels that see the mirror.
    """
    place = np.rint(dots.centers_px).astype(np.intp)
    on_mirror = region[np.clip(place[:, 1], 0, region.shape[0] - 1), np.clip(place[:, 0], 0, region.shape[1] - 1)]
    share = float(np.count_nonzero(on_mirror)) * dots.cell_px2 / max(float(np.count_nonzero(region)), 1.0)
    if share > _DOTTED_SHARE:
        return None
    return Doubt(
        "mirror_without_dots",
        f"dots are seen on {share:.0%} of the mirror only; the rest is not measured: check what covers the pattern or "
        "the mirror, the focus, and whether the mirror looks past the field of dots",
        {"dotted_share": share},
    )


def _pictures(photo: npt.NDArray[Any]) -> Iterator[FailurePicture]:
    yield FailurePicture("the photo", photo, "the mirror must show the dots, sharp, and its own edges")
