"""All circular targets of one photo: found, read, centred."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FlagArray, FloatArray
from photogrammetry.centers.ellipse import Ellipse, NamedEllipses
from photogrammetry.centers.measured_centers import centers_near, measure_center, measure_centers
from photogrammetry.centers.pyramid import make_pyramid
from photogrammetry.centers.target_center import REACH, TargetCenter, UnmeasuredTargetError
from photogrammetry.detection.decode import RingLimits, RingReading, read_rings, ring_outline
from photogrammetry.detection.detect import SearchLimits, find_in_pyramid
from photogrammetry.detection.detections import Detections
from photogrammetry.targets.coded_targets import RingDictionary
from photogrammetry.targets.ring_codes import VENDOR_RADII

#: Level of dot or ground, as a share of the largest number of the file, from which some of its pixels are cut off.
_CLIPPED_SHARE = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class TargetSearch(ShortRepr):
    """What is searched for in photos, and how it is measured.

    dictionary: The ring codes that may occur; None for targets without code only.
    limits: Sizes, contrast, tilt, polarity.
    ring_limits: How good a code ring must be.
    with_uncoded: Also return dots without a code ring.
    most_misfit: Residual of a dot without code as a share of its contrast, above which it is none.
    """

    dictionary: RingDictionary | None = None
    limits: SearchLimits = field(default_factory=SearchLimits)
    ring_limits: RingLimits = field(default_factory=RingLimits)
    with_uncoded: bool = True
    most_misfit: float = 0.08


@dataclass(frozen=True, slots=True, eq=False)
class UnusedTarget:
    """A target that is there but has no centre, or not one of its own.

    name: Its code's name; empty for a dot that may belong to a code cut off.
    center_px (2,): Where it is, to a pixel or so [px].
    flag: Why.
    reason: Why, with numbers.
    """

    name: str
    center_px: FloatArray
    flag: SampleFlag
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class PhotoTargets:
    """The targets of one photo and what was noticed about them.

    detections: Coded targets by their names, then dots without a code as "u0", "u1"...
    centers: All that is known of each detection.
    readings: The readings of the coded targets, first in the detections.
    mirrored: Names of codes that are in the dictionary only as mirror images (print or photo is mirrored); not
        detections.
    mirrored_px (k, 2): Where they are [px].
    unknown_words: Sectors ("110100...") of good rings whose word is not in the dictionary.
    unknown_px (j, 2): Where they are [px].
    duplicated: Names that occur more than once; all of them are among the detections.
    unused: Targets that are partly covered, cut by the border, too small.
    """

    detections: Detections
    centers: tuple[TargetCenter, ...]
    readings: tuple[RingReading, ...]
    mirrored: tuple[str, ...]
    mirrored_px: FloatArray
    unknown_words: tuple[str, ...]
    unknown_px: FloatArray
    duplicated: tuple[str, ...]
    unused: tuple[UnusedTarget, ...]


def measure_targets(image_dn: npt.NDArray[np.generic], photo: str, search: TargetSearch) -> PhotoTargets:
    """Find, read and centre all circular targets of a photo.

    image_dn (h, w): Grey values: uint8, uint16 or float32 [DN].
    Returns: Detections with covariances, and what was noticed. No target is no error.
    """
    pyramid = make_pyramid(image_dn)
    dictionary = search.dictionary
    limits = search.limits if dictionary is None else replace(search.limits, gap_radius=dictionary.radii.inner)
    candidates = find_in_pyramid(pyramid, limits)
    dots = [candidate.ellipse for candidate in candidates]
    readings = [None] * len(dots) if dictionary is None else read_rings(pyramid, dots, dictionary, search.ring_limits)
    ringed = [(k, reading) for k, reading in enumerate(readings) if reading is not None]
    coded: list[tuple[TargetCenter, RingReading]] = []
    unused: list[UnusedTarget] = []
    covered = [dots[k] for k, _ in ringed]
    measured = measure_centers(image_dn, covered, _template_reach(search))
    for (_, reading), dot, center in zip(ringed, covered, measured, strict=True):
        if isinstance(center, TargetCenter):
            coded.append((center, reading))
        elif reading.code is not None:
            unused.append(_describe_unused(reading.code.name, dot, center))
    uncoded: list[TargetCenter] = []
    if search.with_uncoded:
        rest = [dot for dot, reading in zip(dots, readings, strict=True) if reading is None]
        uncoded, cut = _measure_uncoded(image_dn, rest, covered, search)
        unused += cut
    named = [(center, reading) for center, reading in coded if reading.code is not None]
    names = [reading.code.name for _, reading in named if reading.code is not None]
    centers = [center for center, _ in named] + uncoded
    detections = _detections(image_dn, photo, names + [f"u{k}" for k in range(len(uncoded))], centers)
    others = [(center.center_px, reading) for center, reading in coded if reading.code is None]
    mirrored = [(place, reading.mirrored.name) for place, reading in others if reading.mirrored is not None]
    unknown = [(place, reading.sectors) for place, reading in others if reading.mirrored is None]
    return PhotoTargets(
        detections,
        tuple(centers),
        tuple(reading for _, reading in named),
        tuple(name for _, name in mirrored),
        np.array([place for place, _ in mirrored]).reshape(-1, 2),
        tuple("".join("01"[bit] for bit in sectors) for _, sectors in unknown),
        np.array([place for place, _ in unknown]).reshape(-1, 2),
        detections.duplicated,
        tuple(unused),
    )


def measure_at(
    images_dn: Sequence[npt.NDArray[np.generic]],
    photos: Sequence[str],
    starts: Sequence[NamedEllipses],
    search: TargetSearch,
) -> list[tuple[Detections, FloatArray]]:
    """Centre targets whose places are known to half a pixel or so, without a search, in several photos at once.

    images_dn (h, w): Grey values: uint8, uint16 or float32 [DN].
    Returns (n, 2, 2): Targets of each photo that are there, measured as after a search, and their ellipses [px^2].
    """
    reach = _template_reach(search)
    photo = np.repeat(np.arange(len(photos)), [len(one) for one in starts])
    places = np.concatenate([one.centers_px for one in starts] or [np.zeros((0, 2))])
    shapes = np.concatenate([one.shapes_px2 for one in starts] or [np.zeros((0, 2, 2))])
    stack = centers_near(images_dn, photo, places, shapes, reach)
    for row in np.flatnonzero(~stack.settled).tolist():
        try:
            center = measure_center(images_dn[int(photo[row])], Ellipse(places[row], shapes[row]), reach)
        except EstimationError:
            continue
        stack.put(row, center)
    fine = stack.settled & (stack.residual_dn < search.most_misfit * np.abs(stack.contrast_dn))
    names = [name for one in starts for name in one.names]
    found = []
    for k, (image, name) in enumerate(zip(images_dn, photos, strict=True)):
        rows = np.flatnonzero((photo == k) & fine)
        outlines = stack.shapes_px2[rows]
        detections = Detections(
            name,
            tuple(names[row] for row in rows),
            stack.centers_px[rows],
            stack.covariance_px2[rows],
            np.linalg.det(outlines) ** 0.25,
            _flag_clipped(image, stack.inside_dn[rows], stack.contrast_dn[rows]),
        )
        found.append((detections, outlines))
    return found


def _template_reach(search: TargetSearch) -> float:
    """Return how far from a dot's centre pixels may be used, in its radii: a code ring begins beyond."""
    gap = 1.0 if search.dictionary is None else search.dictionary.radii.inner - 1
    return min(REACH, 1 + (REACH - 1) * gap)


def _describe_unused(name: str, dot: Ellipse, why: EstimationError) -> UnusedTarget:
    flag = why.flag if isinstance(why, UnmeasuredTargetError) else SampleFlag.PARTLY_COVERED
    return UnusedTarget(name, dot.center_px, flag, str(why))


def _measure_uncoded(
    image_dn: npt.NDArray[np.generic], dots: Sequence[Ellipse], coded: Sequence[Ellipse], search: TargetSearch
) -> tuple[list[TargetCenter], list[UnusedTarget]]:
    """Measure the dots without a code that lie in no coded target, and name those that may be a coded one cut off."""
    radii = VENDOR_RADII if search.dictionary is None else search.dictionary.radii
    rings = [ring_outline(dot, radii) for dot in coded]
    middles = np.array([ring.center_px for ring in rings]).reshape(-1, 2)
    conics = np.array([np.linalg.inv(ring.shape_px2) for ring in rings]).reshape(-1, 2, 2)
    off = np.array([dot.center_px for dot in dots]).reshape(-1, 1, 2) - middles
    within = (np.einsum("mni,nij,mnj->mn", off, conics, off) < 1).any(axis=1)
    free, cut = [], []
    for dot, in_ring in zip(dots, within.tolist(), strict=True):
        if in_ring:
            continue
        if search.dictionary is not None and not _whole(ring_outline(dot, radii), image_dn.shape):
            why = "its code ring, if it has one, reaches beyond the border of the photo"
            cut.append(UnusedTarget("", dot.center_px, SampleFlag.CUT_BY_BORDER, why))
        else:
            free.append(dot)
    found = measure_centers(image_dn, free, _template_reach(search))
    return [one for one in found if isinstance(one, TargetCenter) and one.misfit < search.most_misfit], cut


def _whole(outline: Ellipse, shape: tuple[int, ...]) -> bool:
    half = np.sqrt(np.diag(outline.shape_px2))
    low, high = outline.center_px - half, outline.center_px + half
    return bool((low > 0).all() and high[0] < shape[1] - 1 and high[1] < shape[0] - 1)


def _detections(
    image_dn: npt.NDArray[np.generic], photo: str, names: Sequence[str], centers: Sequence[TargetCenter]
) -> Detections:
    n = len(centers)
    inside = np.array([center.inside_dn for center in centers])
    contrast = np.array([center.contrast_dn for center in centers])
    return Detections(
        photo,
        tuple(names),
        np.array([center.center_px for center in centers]).reshape(n, 2),
        np.array([center.covariance_px2 for center in centers]).reshape(n, 2, 2),
        np.array([center.ellipse.radius_px for center in centers]).reshape(n),
        _flag_clipped(image_dn, inside, contrast),
    )


def _flag_clipped(image_dn: npt.NDArray[np.generic], inside_dn: FloatArray, contrast_dn: FloatArray) -> FlagArray:
    """Flag targets of which a side is at the largest number of the file."""
    flags = np.zeros(inside_dn.size, dtype=np.uint32)
    # Luminance of colours, or light of encoded numbers, is float32 in the file's depth.
    is_deep = image_dn.dtype == np.uint16 or float(image_dn.max(initial=0)) > 255
    highest = 65535.0 if is_deep else 255.0
    flags[np.maximum(inside_dn, inside_dn - contrast_dn) > _CLIPPED_SHARE * highest] = SampleFlag.CLIPPED
    return flags
