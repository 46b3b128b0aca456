"""A photo of dots seen in a mirror to results: the stages follow each other in `run`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.dots.dot_source import DotSource
from deflectometry.dots.facet_lattices import FacetLattice, lattices_of_facets
from deflectometry.dots.found_dots import FoundDots, find_dots, find_lattices
from deflectometry.dots.ground import POLARITIES, ground_of_dots, without_dots
from deflectometry.dots.keys import DotPatternSection, DotsMeasurement
from deflectometry.dots.mark_evidence import MarkEvidence
from deflectometry.dots.origin import KnownDot, PlacedDots, Sight, doubt_of_places, find_lights, place_dots
from deflectometry.dots.rim_dots import edges_without_dots, find_rim, with_rim_dots
from deflectometry.frames.image_file_checks import check_compression, check_size
from deflectometry.pipeline.assess import SourceMeasurement, measure_source
from deflectometry.pipeline.choices import Options, build_choices
from deflectometry.pipeline.inputs import build_setup, describe_mirror
from deflectometry.pipeline.plausibility import refuse_impossible
from deflectometry.pipeline.result import Result
from deflectometry.pose.find_pose import LocatedMirror, find_pose
from deflectometry.pose.mirror_outline import mirror_masks
from deflectometry.setup.camera_and_screen import FacetShift
from deflectometry.setup.dot_marks import DotMarks
from deflectometry.setup.dot_screen import DotScreen
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import FailurePicture, InputError, showing
from heliogauge.images.photos import read_frames
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.results.tables import read_number_columns
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array
from photogrammetry.targets import Polarity

#: Share of the mirror with dots below which a part of it has none: around a mirror with 40 dots across, half a
#: dot's distance along the edges is 5 %, and as much may be lost to clips.
_DOTTED_SHARE = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPhoto(ShortRepr):
    """A photo whose dots have their places in the pattern.

    ready: What is evaluated.
    source: Its dots.
    located: Where the mirror is.
    lattices, placed: The lattice of each surface, and the places of its dots.
    """

    ready: SourceMeasurement
    source: DotSource
    located: LocatedMirror
    lattices: tuple[FacetLattice, ...]
    placed: tuple[PlacedDots, ...]


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
    return measure_source(place_photo(measurement, options, progress).ready, progress)


def place_photo(measurement: DotsMeasurement, options: Options, progress: Progress) -> PlacedPhoto:
    """Find the dots of a photo, the mirror in it, and the places of the dots in the pattern.

    InputError, EstimationError: As for `run`.
    """
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
        whole = np.ones(photo.shape, dtype=np.bool_)
        several = len(mirror.facets) > 1
        found = find_lattices(photo, whole, polarity) if several else (find_dots(photo, whole, polarity),)
        ground = ground_of_dots(photo, found[0], polarity)
        image = photo
        for one in found:
            image = without_dots(image, ground, one)
        source = DotSource(np.asarray(image, dtype=np.float32), None, screen)
    with progress.stage("place in the pattern"), showing(lambda: _pictures(photo)):
        located = find_pose(source, setup, mirror)
        rim = find_rim(
            photo,
            found,
            setup.camera,
            located.outline_pose,
            located.facets,
            located.edge_width_px,
            located.sigma_outline_px,
        )
        found = tuple(with_rim_dots(one, rim) for one in found)
        sign = -1.0 if polarity is Polarity.BLACK_ON_WHITE else 1.0
        edges, hidden = edges_without_dots(photo, source.image, found, rim, sign)
        source = replace(source, image=edges, near_dots=hidden)
        masks = mirror_masks(setup.camera, located.outline_pose, located.facets, margin_px=located.margin_px)
        lattices: tuple[FacetLattice, ...]
        if several:
            lattices = lattices_of_facets(found, masks.facet_index, located.margin_px)
        else:
            lattices = (FacetLattice(found[0], (0,), np.ones(len(found[0].number), dtype=np.bool_)),)
        marks = build_marks(measurement)
        known = _known_dots(pattern, photo, ground, lattices, masks.facet_index)
        sights = [
            Sight(
                one.dots,
                setup,
                screen,
                located.pose,
                located.facets[one.facets[0]],
                dot,
                one.on_first,
                ", ".join(f"facet {located.facets[k].name}" for k in one.facets) if several else "",
                None if marks is None else MarkEvidence.of(one.dots, marks),
            )
            for one, dot in zip(lattices, known, strict=True)
        ]
        placed = place_dots(sights)
    rows, columns = screen.shape
    # All lattices are as open as the one that was placed first; what each is beyond that turns its own facets.
    scale = np.array([columns - 1, rows - 1])
    shared = np.max([np.sqrt(np.maximum(one.sigma_shift**2 - one.own_shift**2, 0.0)) for one in placed], axis=0)
    setup = replace(
        setup,
        sigma_shift=shared / scale,
        facet_shifts=tuple(
            FacetShift(frozenset(located.facets[k].name for k in lattice.facets), one.own_shift / scale)
            for lattice, one in zip(lattices, placed, strict=True)
            if one.own_shift.any()
        ),
    )
    dots = tuple(one.dots for one in placed)
    source = replace(source, dots=dots)
    ready = SourceMeasurement(
        measurement,
        source,
        setup,
        mirror,
        build_choices(measurement, options),
        _words(placed, pattern, screen),
        lambda: _pictures(photo),
        measurement.input_files,
        gather_doubts(
            frames.doubts,
            check_compression([measurement.model.photo]),
            doubt_of_places(placed, sights),
            _coarse(dots),
            _missing(dots, masks.facet_index >= 0),
        ),
    )
    return PlacedPhoto(ready, source, located, lattices, placed)


def build_marks(measurement: DotsMeasurement) -> DotMarks | None:
    """Return the sizes of the pattern's dots, where they are marks.

    InputError: A table without them.
    """
    name = measurement.model.pattern.marks_file
    if name is None:
        return None
    file = measurement.path(name)
    try:
        return DotMarks.from_table(*read_number_columns(file, ("column", "row", "radius_m")))
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def _known_dots(
    pattern: DotPatternSection,
    photo: npt.NDArray[Any],
    ground: Float32Array,
    lattices: Sequence[FacetLattice],
    facet_index: npt.NDArray[np.int16],
) -> list[KnownDot | None]:
    """Return for each lattice the numbers of a dot in the table and its place in the photo, where the pattern says one.

    InputError: A dot that is said to be where no facet shows dots.
    EstimationError: The light at dot (0, 0) is not seen, or not for certain.
    """
    if pattern.known_dot:
        known: list[KnownDot | None] = [None] * len(lattices)
        for dot in pattern.known_dot:
            place = np.array(dot.image_px)
            shown = [k for k, one in enumerate(lattices) if len(lattices) == 1 or one.shows(place)]
            if not shown:
                raise InputError(
                    f"[pattern.known_dot] image_px = ({place[0]:g}, {place[1]:g}): no facet shows dots around there"
                )
            known[shown[0]] = (np.array([dot.column, dot.row]), place)
        return known
    if pattern.origin != "light":
        return [None] * len(lattices)
    origin = np.zeros(2, dtype=np.intp)
    regions = [np.isin(facet_index, one.facets) for one in lattices] if len(lattices) > 1 else [facet_index >= 0]
    return [None if place is None else (origin, place) for place in find_lights(photo, ground, regions)]


def _words(placed: Sequence[PlacedDots], pattern: DotPatternSection, screen: DotScreen) -> str:
    by = "known dot" if pattern.known_dot else "light at dot (0, 0)"
    probability = min(one.probability for one in placed)
    if not pattern.known_dot and pattern.origin != "light":
        by = "slopes and the sizes of the dots" if pattern.marks_file else "slopes"
        by = f"likeliest place by {by}, probability {probability:.3g}"
    elif probability < 1.0:
        by += f" and, where a facet shows none, by the likeliest place, probability {probability:.3g}"
    several = "" if len(placed) == 1 else f" in {len(placed)} lattices"
    count = sum(len(one.dots.number) for one in placed)
    return f"{count} {pattern.dots} dots of a {screen.describe()}{several}, placed by the {by}"


def _coarse(dots: Sequence[FoundDots]) -> Doubt | None:
    """Return a doubt where more than a tenth of the dots has the centre of an outline only."""
    share = sum(one.n_coarse for one in dots) / sum(len(one.number) for one in dots)
    if share <= 0.1:
        return None
    return Doubt(
        "dots_without_fitted_centre",
        f"{share:.0%} of the dots are no blurred discs: they have the centre of their outline, with a larger sigma; "
        "check focus and exposure, and that a dot covers 4 px and more",
        {"coarse_share": share},
    )


def _missing(dots: Sequence[FoundDots], region: BoolArray) -> Doubt | None:
    """Return a doubt where a part of the mirror shows no dots.

    region (h, w): Pixels that see the mirror.
    """
    covered = 0.0
    for one in dots:
        place = np.rint(one.centers_px).astype(np.intp)
        on_mirror = region[np.clip(place[:, 1], 0, region.shape[0] - 1), np.clip(place[:, 0], 0, region.shape[1] - 1)]
        covered += float(np.count_nonzero(on_mirror)) * one.cell_px2
    share = covered / max(float(np.count_nonzero(region)), 1.0)
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
