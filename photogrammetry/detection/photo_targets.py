"""All circular targets of one photo: found, read, centred."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FlagArray, FloatArray, freeze
from photogrammetry.centers.edge_noise import variance_factor
from photogrammetry.centers.ellipse import Ellipse, NamedEllipses
from photogrammetry.centers.measured_centers import centers_near, measure_center, measure_centers
from photogrammetry.centers.pyramid import make_pyramid
from photogrammetry.centers.ring_light import InkedRing, ring_disturbs, without_rings
from photogrammetry.centers.target_center import REACH, TargetCenter
from photogrammetry.detection.decode import (
    MEMBERS,
    RingLimits,
    RingReading,
    RingReadings,
    read_rings,
    ring_outline,
)
from photogrammetry.detection.detect import Candidate, SearchLimits, find_in_pyramid
from photogrammetry.detection.detections import Detections
from photogrammetry.detection.repeated_codes import implausible_repeats
from photogrammetry.targets.coded_targets import RingDictionary
from photogrammetry.targets.ring_codes import VENDOR_RADII, RingRadii

#: Level of dot or ground, as a share of the largest number of the file, from which some of its pixels are cut off.
_CLIPPED_SHARE = 0.99
#: Passes in which the rings' light is taken away: the dot's blur and size are truer each time.
_RING_PASSES = 3
#: Least sigma of the centre of an outline: that of a dot of 6 px with a sharp edge, which the steps of its pixels
#: move [px].
_LEAST_COARSE_PX = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class TargetSearch(ShortRepr):
    """What is searched for in photos, and how it is measured.

    dictionary: The ring codes that may occur; None for targets without code only.
    limits: Sizes, contrast, tilt, polarity.
    ring_limits: How good a code ring must be.
    with_uncoded: Also return dots without a code ring.
    most_misfit: Residual of a dot without code as a share of its contrast, above which it is none.
    radii: Where the code rings lie; found from each photo's own rings if absent.
    other_radii: Where they lie in other photos of the sheet; for photos whose own rings do not say it.
    """

    dictionary: RingDictionary | None = None
    limits: SearchLimits = field(default_factory=SearchLimits)
    ring_limits: RingLimits = field(default_factory=RingLimits)
    with_uncoded: bool = True
    most_misfit: float = 0.08
    radii: RingRadii | None = None
    other_radii: tuple[RingRadii, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class UnusedTarget:
    """A target that is there but has no centre, or not one of its own.

    name: The name of the code that it reads like; empty for a dot that may belong to a code cut off.
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
    unused: Targets that are partly covered, cut by the border, too small, or no codes by their rings.
    radii: Where the photo's code rings lie, those of most rings first; empty without rings.
    fitting_bits: Number of sectors into which the rings divide, where it is another than the dictionary's: none of them
        is a detection then.
    elsewhere: Rings that read like codes at other radii than the photo's others.
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
    radii: tuple[RingRadii, ...] = ()
    fitting_bits: int | None = None
    elsewhere: int = 0


def measure_targets(image_dn: npt.NDArray[np.generic], photo: str, search: TargetSearch) -> PhotoTargets:
    """Find, read and centre all circular targets of a photo.

    image_dn (h, w): Grey values: uint8, uint16 or float32 [DN].
    Returns: Detections with covariances, and what was noticed. No target is no error.
    """
    pyramid = make_pyramid(image_dn)
    candidates = find_in_pyramid(pyramid, search.limits)
    dots = [candidate.ellipse for candidate in candidates]
    rings = RingReadings((None,) * len(dots), {}, (), None)
    if search.dictionary is not None:
        rings = read_rings(pyramid, dots, search.dictionary, search.ring_limits, search.radii, search.other_radii)
    unused = [_no_code(dots[k], why) for k, why in rings.refused.items()]
    ringed = _confirmed([(k, one) for k, one in enumerate(rings.rings) if one is not None], candidates)
    taken = [dots[k] for k, _ in ringed]
    if rings.fitting_bits is not None:
        why = f"the photo's code rings divide into {rings.fitting_bits} sectors, the dictionary's into "
        why += f"{0 if search.dictionary is None else search.dictionary.n_bits}"
        unused += [_no_code(dots[k], why) for k, _ in ringed]
        ringed = []
    coded: list[tuple[TargetCenter, RingReading]] = []
    radii = rings.radii[0] if rings.radii else _usual_radii(search)
    measured = _measure_coded(image_dn, [dots[k] for k, _ in ringed], [one for _, one in ringed], radii)
    for (k, reading), center in zip(ringed, measured, strict=True):
        # A code that was read is never lost to its centre.
        coded.append((center if isinstance(center, TargetCenter) else _coarse_center(candidates[k]), reading))
    coded = _without_implausible(coded, search.ring_limits, unused)
    uncoded: list[TargetCenter] = []
    if search.with_uncoded:
        rest = [
            one.ellipse
            for k, one in enumerate(candidates)
            if one.is_clear and rings.rings[k] is None and k not in rings.refused
        ]
        uncoded, cut = _measure_uncoded(image_dn, rest, taken, radii, search)
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
        rings.radii,
        rings.fitting_bits,
        len(rings.refused),
    )


def _confirmed(ringed: list[tuple[int, RingReading]], candidates: Sequence[Candidate]) -> list[tuple[int, RingReading]]:
    """Leave out rings round doubtful dots unless several of them have codes: what spoils one dot spoils others."""
    codes = {one.code.name for k, one in ringed if one.code is not None and not candidates[k].is_clear}
    return [(k, one) for k, one in ringed if candidates[k].is_clear or len(codes) >= MEMBERS]


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
    reach = _template_reach(_usual_radii(search))
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
        # Neighbouring pixels err alike here as in a photo that is searched.
        alike = variance_factor(stack.edge_powers[rows])
        detections = Detections(
            name,
            tuple(names[row] for row in rows),
            stack.centers_px[rows],
            alike * stack.covariance_px2[rows],
            np.linalg.det(outlines) ** 0.25,
            _flag_clipped(image, stack.inside_dn[rows], stack.contrast_dn[rows]),
        )
        found.append((detections, outlines))
    return found


def _usual_radii(search: TargetSearch) -> RingRadii | None:
    """Return where code rings lie as far as is known before a photo is seen; None where there are none."""
    return None if search.dictionary is None else search.radii or search.dictionary.radii


def _template_reach(radii: RingRadii | None) -> float:
    """Return how far from a dot's centre pixels may be used, in its radii: a code ring begins beyond."""
    gap = 1.0 if radii is None else radii.inner - 1
    return min(REACH, 1 + (REACH - 1) * gap)


def _measure_coded(
    image_dn: npt.NDArray[np.generic],
    dots: Sequence[Ellipse],
    readings: Sequence[RingReading],
    radii: RingRadii | None,
) -> list[TargetCenter | EstimationError]:
    """Measure dots of which the code rings are known, those into whose gap the rings bleed without the rings' light."""
    reach = _template_reach(radii)
    found = list(measure_centers(image_dn, dots, reach))
    usual = radii or VENDOR_RADII
    rings = [InkedRing(usual.inner, usual.outer, one.sectors, one.turn_rad) for one in readings]
    for _ in range(_RING_PASSES):
        disturbed = [
            (k, one)
            for k, one in enumerate(found)
            if isinstance(one, TargetCenter) and ring_disturbs(one, rings[k], reach)
        ]
        if not disturbed:
            break
        places, centers = [k for k, _ in disturbed], [one for _, one in disturbed]
        clean = without_rings(image_dn, centers, [rings[k] for k in places], reach)
        starts = [one.ellipse.moved(-origin) for one, origin in zip(centers, clean.origins_px, strict=True)]
        again = measure_centers(clean.image_dn, starts, reach)
        for k, one, origin in zip(places, again, clean.origins_px, strict=True):
            if isinstance(one, TargetCenter):
                found[k] = replace(one, ellipse=one.ellipse.moved(origin))
    return found


def _without_implausible(
    coded: list[tuple[TargetCenter, RingReading]], limits: RingLimits, unused: list[UnusedTarget]
) -> list[tuple[TargetCenter, RingReading]]:
    """Leave out targets that only read like a code that is there as well, and name them."""
    named = [one for one in coded if one[1].code is not None]
    names = [reading.code.name for _, reading in named if reading.code is not None]
    refused = implausible_repeats(
        names, [center.ellipse for center, _ in named], [reading for _, reading in named], limits
    )
    for k, reason in refused.items():
        unused.append(UnusedTarget(names[k], named[k][0].center_px, SampleFlag.OUTLIER, reason))
    out = {id(named[k][0]) for k in refused}
    return [one for one in coded if id(one[0]) not in out]


def _no_code(dot: Ellipse, reason: str) -> UnusedTarget:
    return UnusedTarget("", dot.center_px, SampleFlag.OUTLIER, reason)


def _coarse_center(spot: Candidate) -> TargetCenter:
    """Return the centre of a spot's outline, with a sigma from how far its edges lie from that.

    The outline has five parameters from two dozen edges; what they have in common is not seen in their scatter, so it
    is taken as large as that.
    """
    sigma = max(spot.edge_rms_px, _LEAST_COARSE_PX)
    return TargetCenter(
        spot.ellipse,
        freeze(sigma**2 * np.eye(2)),
        spot.inside_dn - spot.outside_dn,
        spot.inside_dn,
        float("nan"),
        float("nan"),
        0,
    )


def _measure_uncoded(
    image_dn: npt.NDArray[np.generic],
    dots: Sequence[Ellipse],
    coded: Sequence[Ellipse],
    known_radii: RingRadii | None,
    search: TargetSearch,
) -> tuple[list[TargetCenter], list[UnusedTarget]]:
    """Measure the dots without a code that lie in no coded target, and name those that may be a coded one cut off."""
    radii = known_radii or VENDOR_RADII
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
    found = measure_centers(image_dn, free, _template_reach(known_radii))
    return [one for one in found if isinstance(one, TargetCenter) and one.misfit < search.most_misfit], cut


def _whole(outline: Ellipse, shape: tuple[int, ...]) -> bool:
    half = np.sqrt(np.diag(outline.shape_px2))
    low, high = outline.center_px - half, outline.center_px + half
    return bool((low > 0).all() and high[0] < shape[1] - 1 and high[1] < shape[0] - 1)


def _detections(
    image_dn: npt.NDArray[np.generic], photo: str, names: Sequence[str], centers: Sequence[TargetCenter]
) -> Detections:
    n = len(centers)
    # Neighbouring pixels may err alike (moire, JPEG, demosaicing): by how much is the same all over a photo.
    alike = variance_factor(np.array([center.edge_powers for center in centers if not center.is_coarse]))
    inside = np.array([center.inside_dn for center in centers])
    contrast = np.array([center.contrast_dn for center in centers])
    coarse = np.array([SampleFlag.COARSE_CENTER * center.is_coarse for center in centers], dtype=np.uint32)
    return Detections(
        photo,
        tuple(names),
        np.array([center.center_px for center in centers]).reshape(n, 2),
        np.array([center.covariance_px2 * (1.0 if center.is_coarse else alike) for center in centers]).reshape(n, 2, 2),
        np.array([center.ellipse.radius_px for center in centers]).reshape(n),
        _flag_clipped(image_dn, inside, contrast) | coarse,
    )


def _flag_clipped(image_dn: npt.NDArray[np.generic], inside_dn: FloatArray, contrast_dn: FloatArray) -> FlagArray:
    """Flag targets of which a side is at the largest number of the file."""
    flags = np.zeros(inside_dn.size, dtype=np.uint32)
    # Luminance of colours, or light of encoded numbers, is float32 in the file's depth.
    is_deep = image_dn.dtype == np.uint16 or (image_dn.dtype != np.uint8 and float(image_dn.max(initial=0)) > 255)
    highest = 65535.0 if is_deep else 255.0
    flags[np.maximum(inside_dn, inside_dn - contrast_dn) > _CLIPPED_SHARE * highest] = SampleFlag.CLIPPED
    return flags
