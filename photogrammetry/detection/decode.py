"""Read ring codes, and refuse what only happens to read like one.

A dictionary by itself admits false codes: a third of all 12-bit words are in it. A ring is therefore read only if it is
one: an even gap of the ground's colour, sectors that divide the circle evenly, two levels and nothing between but
what blur makes of an edge, ground beyond, and radii like those of the other rings of the photo. Where a sheet has its
rings is not assumed: it is what its rings agree on.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import erf, log, pi, sqrt
from typing import NamedTuple

import numpy as np

from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.centers.ellipse import Ellipse
from photogrammetry.centers.pyramid import Pyramid
from photogrammetry.detection.ring_profiles import ANGLES_PER_SECTOR, RingProfiles, sample_rings
from photogrammetry.targets.coded_targets import RingDictionary
from photogrammetry.targets.ring_codes import (
    FEWEST_BITS,
    LEAST_INNER_RADIUS,
    LEAST_RING_WIDTH,
    MOST_BITS,
    VENDOR_RADII,
    RingCode,
    RingRadii,
    smallest_rotation,
)

#: Parts of gap and ring in which the level is taken, and how far the quiet zone beyond the ring is looked at [radii].
_GAP_PART, _RING_PART, _BEYOND_RADII = (0.35, 0.65), (0.25, 0.75), (0.25, 0.5)
#: Share of the circle that may be in glare or under a neighbour in gap and quiet zone.
_SPOILT_SHARE = 0.2
#: Blurs of the sectors' borders with which profiles are compared [sectors]. Wider ones fit anything.
_BLURS = (0.04, 0.15, 0.3, 0.45, 0.6)
#: Trials of the phase for each sample.
_PHASES_PER_SAMPLE = 2
#: Profiles that are compared at once: they stay in the processor's cache.
_PROFILES_AT_ONCE = 16
#: Spread of the radii of one sheet's rings: relative, and that of an edge of ring or dot [px]. On 420 drawn rings of
#: dots of 8 px and more, 98 % lie within 3 of these standard deviations.
_OWN_SPREAD, _EDGE_PX = 0.02, 0.4
#: Distance of a ring's radii from the sheet's, in standard deviations, from which it belongs to another.
_MOST_SIGMAS = 4.0
#: Blur of a dot's edge from which a narrow ring has no half height of its own: a gap of one radius is four sigmas
#: then, of which dot and ring fill two each.
_BLURRED_RADII = 0.25
#: Rings of different codes that make a family of radii beside the photo's first, and confirm doubtful dots.
MEMBERS = 3
#: Radius of the dot from which a single ring may have radii that no other ring of the photo has [px].
_ALONE_PX = 5.0
#: Rings divide otherwise than the dictionary says if the rms misfit is at least so many times smaller then; and of
#: several divisions the coarsest one counts whose misfit is within this factor of the least, because twice as many
#: always fit.
_CLEARLY_BETTER, _AS_GOOD = 2.0, 1.3
#: A measure of a ring at its limit is so many standard deviations from a perfect ring.
_LIMIT_SIGMAS = 3.0
#: Spread of the ratio of a ring's contrast to its dot's below 1 (its logarithm): both are one ink on one paper. Rms of
#: 0.01 to 0.02 on most kinds of drawn prints, 0.065 beside halos and moire, 0.095 at the strongest sharpening in use.
#: Blur only raises the ratio, as it fills the gap.
_CONTRAST_SPREAD = 0.1
#: Rings of clutter within all limits, for each code in a photo: 0.025, 0.1 and 0.4 in three drawn flights over uneven
#: ground. The least of them, because a code that is lost is worse than a false one, which few other photos confirm.
_CLUTTER_SHARE = 0.025
#: Rings of one word beyond this share of all are no codes: of those round the dots of a display's grid 0.90 to 0.98
#: read alike, of four codes on a sheet 0.25.
_MOST_ALIKE = 0.6


@dataclass(frozen=True, slots=True)
class RingLimits:
    """How good a ring must be to be read; all in shares of the contrast of ink and ground.

    least_contrast: Contrast of the ring's sectors, as a share of the dot's.
    most_misfit: Rms of the ring's ink round the circle against the code read, blurred as the dot's edge is.
    most_gap, most_beyond: Rms of the ink in gap and quiet zone that neither a plane nor bleeding sectors explain,
        on the best four fifths of the circle.
    most_level: Mean ink in gap and quiet zone.

    Measured on drawn prints and on photos without codes: docs/explanation/target_detection.md.
    """

    least_contrast: float = 0.4
    most_misfit: float = 0.2
    most_gap: float = 0.14
    most_beyond: float = 0.18
    most_level: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class RingReading:
    """What was read round one dot.

    code: The code if the target is seen as printed; None if the word is in no dictionary.
    mirrored: The code of the mirror image.
    sectors: Ink of the sectors, clockwise in the image.
    turn_rad: Where the first sector begins, clockwise from the x axis of the dot's frame [rad].
    inner, outer: Where the ring begins and ends, in radii of the dot; NaN where it is too blurred to be said.
    contrast, misfit, gap, beyond: As in `RingLimits`.
    """

    code: RingCode | None
    mirrored: RingCode | None
    sectors: tuple[bool, ...]
    turn_rad: float
    inner: float
    outer: float
    contrast: float
    misfit: float
    gap: float
    beyond: float

    def square(self, limits: RingLimits) -> float:
        """Return the sum of the squared deviations from a perfect ring, in standard deviations."""
        return float(_square(np.array([self.contrast, self.misfit, self.gap, self.beyond]), limits))


@dataclass(frozen=True, slots=True, eq=False)
class RingReadings(ShortRepr):
    """What was read round all dots of a photo.

    rings: One for each dot; None if there is no ring, or not all of it in the photo; a reading without a code if
    there is
        a ring whose word no dictionary holds.
    refused: Why a ring that reads like a code is none, by the number of its dot.
    radii: Where the photo's rings lie, those of most rings first; empty without rings.
    fitting_bits: Number of sectors into which the rings divide, where it is clearly another than the dictionary's.
    """

    rings: tuple[RingReading | None, ...]
    refused: dict[int, str]
    radii: tuple[RingRadii, ...]
    fitting_bits: int | None


def read_rings(
    pyramid: Pyramid,
    dots: Sequence[Ellipse],
    dictionary: RingDictionary,
    limits: RingLimits | None = None,
    radii: RingRadii | None = None,
    others: Sequence[RingRadii] = (),
) -> RingReadings:
    """Read the code rings round all dots of a photo.

    dots: Outlines of the dots in the photo's pixels.
    dictionary: The codes that may occur.
    limits: How good a ring must be.
    radii: Where the rings lie; found from the photo's own rings if absent.
    others: Where rings of the sheet lie in other photos: read there, too, after the photo's own.
    """
    if not dots:
        return RingReadings((), {}, (), None)
    allowed = limits or RingLimits()
    shapes, centers = np.array([dot.shape_px2 for dot in dots]), np.array([dot.center_px for dot in dots])
    sizes = np.sqrt(np.sqrt(np.maximum(np.linalg.det(shapes), 0.0)))
    n_bits = dictionary.n_bits
    profiles = sample_rings(pyramid, shapes, centers, n_bits * ANGLES_PER_SECTOR)
    own = _Rings.measured(profiles, profiles.inner, profiles.outer, n_bits, dictionary.has_full_ring)
    spread = np.hypot(_OWN_SPREAD, _EDGE_PX / (sizes * np.nan_to_num(profiles.inner, nan=VENDOR_RADII.inner)))
    families = (radii,) if radii is not None else _families(profiles, own, sizes, spread, dictionary, allowed)
    families = (*families, *others)
    found: list[RingReading | None] = [None] * len(dots)
    refused: dict[int, str] = {}
    good = own.within(allowed)
    near = np.zeros(len(dots), dtype=np.bool_)
    for family in families:
        off = _sigmas_off(profiles, family, spread)
        # A ring that is too blurred to have radii of its own is read where the family has them.
        blurred = np.isnan(off) & (profiles.edge > _BLURRED_RADII)
        asked = ~near & ((off < _MOST_SIGMAS) | blurred)
        inner, outer = (np.where(asked, radius, np.nan) for radius in (family.inner, family.outer))
        again = _Rings.measured(profiles, inner, outer, n_bits, dictionary.has_full_ring)
        fits = again.within(allowed)
        for k in np.flatnonzero(fits).tolist():
            found[k] = again.reading(k, dictionary, profiles)
        own_fits = good & ~near & ~fits & (off < _MOST_SIGMAS)
        for k in np.flatnonzero(own_fits).tolist():
            found[k] = own.reading(k, dictionary, profiles)
        near |= fits | own_fits
    for k in np.flatnonzero(good & ~near).tolist():
        reading = own.reading(k, dictionary, profiles)
        if reading.code is not None:
            place = f"its code ring lies at {reading.inner:.2f} to {reading.outer:.2f} radii of its dot"
            usual = f"those of the photo at {families[0].inner:.2f} to {families[0].outer:.2f}" if families else ""
            refused[k] = f"{place}, {usual or 'and no other ring of the photo confirms that'}"
    _leave_inside_out(found, refused, shapes, centers, families, allowed)
    bits = _fitting_bits(profiles, own, families, spread, dictionary, allowed)
    return RingReadings(tuple(found), refused, tuple(families), bits)


def _leave_inside_out(
    found: list[RingReading | None],
    refused: dict[int, str],
    shapes: FloatArray,
    centers: FloatArray,
    families: Sequence[RingRadii],
    limits: RingLimits,
) -> None:
    """Leave out what lies within the ring of a better target: pieces of ring and gap are spots, too.

    Of two targets of which each lies in the other's ring the one with the cleaner ring stays; no two prints overlap.
    """
    rows = [k for k, one in enumerate(found) if one is not None] + list(refused)
    costs = {k: one.square(limits) if (one := found[k]) is not None else np.inf for k in rows}
    inverse = np.linalg.inv(shapes[rows]) if rows else np.zeros((0, 2, 2))
    usual = families[0].outer if families else VENDOR_RADII.outer
    own = [found[k] for k in rows]
    radii = np.array([one.outer if one is not None and np.isfinite(one.outer) else usual for one in own])
    off = centers[rows][:, None] - centers[rows]
    within = np.einsum("mni,nij,mnj->mn", off, inverse, off) < radii**2
    kept = np.zeros(len(rows), dtype=np.bool_)
    for place in sorted(range(len(rows)), key=lambda place: costs[rows[place]]):
        kept[place] = not within[place, kept].any()
        if not kept[place]:
            found[rows[place]] = None
            refused.pop(rows[place], None)


@dataclass(frozen=True, slots=True, eq=False)
class _Rings:
    """Rings round n dots, read at given radii; misfit is infinite where there is none."""

    bits: BoolArray
    turn_rad: FloatArray
    contrast: FloatArray
    misfit: FloatArray
    gap: FloatArray
    beyond: FloatArray
    level: FloatArray

    @classmethod
    def measured(
        cls, profiles: RingProfiles, inner: FloatArray, outer: FloatArray, n_bits: int, whole: bool
    ) -> "_Rings":
        count = len(inner)
        found = cls(
            np.zeros((count, n_bits), dtype=np.bool_),
            np.zeros(count),
            np.zeros(count),
            *(np.full(count, np.inf) for _ in range(4)),
        )
        rows = np.flatnonzero(np.isfinite(inner) & (outer < profiles.reach) & np.isfinite(profiles.step_dn))
        if not rows.size:
            return found
        part, low, high = profiles.chosen(rows), inner[rows], outer[rows]
        width = high - low
        profile = part.band(low + _RING_PART[0] * width, low + _RING_PART[1] * width)
        blur = part.edge / (0.5 * (low + high)) * (n_bits / (2 * np.pi))
        sectors = _read_sectors(profile, blur, n_bits)
        found.bits[rows], found.contrast[rows], found.misfit[rows] = sectors.bits, sectors.contrast, sectors.misfit
        found.turn_rad[rows] = sectors.turn_rad
        model = sectors.model
        if whole:
            even = (profile.min(axis=1) > 0.5) & (profile.std(axis=1) < 0.1)
            full = rows[even]
            found.bits[full], found.contrast[full] = True, profile.mean(axis=1)[even]
            found.misfit[full] = np.abs(profile - 1).mean(axis=1)[even]
            model[even] = 1.0
        gap = part.band(1 + _GAP_PART[0] * (low - 1), 1 + _GAP_PART[1] * (low - 1))
        beyond = part.band(high + _BEYOND_RADII[0], high + _BEYOND_RADII[1])
        levels = []
        for values, name in ((gap, "gap"), (beyond, "beyond")):
            rms, level = _unexplained(values, model)
            getattr(found, name)[rows] = rms
            levels.append(level)
        found.level[rows] = np.maximum(*levels)
        return found

    def within(self, limits: RingLimits) -> BoolArray:
        """Return which are rings."""
        return np.asarray(
            (self.contrast >= limits.least_contrast)
            & (self.misfit <= limits.most_misfit)
            & (self.gap <= limits.most_gap)
            & (self.beyond <= limits.most_beyond)
            & (self.level <= limits.most_level)
            & (_square(np.stack([self.contrast, self.misfit, self.gap, self.beyond]), limits) <= _MOST_SQUARE)
        )

    def reading(self, k: int, dictionary: RingDictionary, profiles: RingProfiles) -> RingReading:
        word = tuple(self.bits[k].tolist())
        known = dictionary.read(word)
        measures = (self.contrast[k], self.misfit[k], self.gap[k], self.beyond[k])
        radii = (profiles.inner[k], profiles.outer[k])
        return RingReading(known.code, known.mirrored, word, *map(float, (self.turn_rad[k], *radii, *measures)))


def _square(measures: FloatArray, limits: RingLimits) -> FloatArray:
    """Return the sum of the squared deviations of rings from a perfect one, in standard deviations.

    measures (4, ...): Contrast, misfit, gap and quiet zone, as in `RingLimits`.
    """
    contrast, misfit, gap, beyond = measures
    shares = np.stack([misfit / limits.most_misfit, gap / limits.most_gap, beyond / limits.most_beyond])
    pale = np.log(np.clip(contrast, 1e-3, 1.0)) / _CONTRAST_SPREAD
    return np.asarray(_LIMIT_SIGMAS**2 * (shares**2).sum(axis=0) + pale**2)


def _most_square() -> float:
    """Return the square up to which a ring is more likely a target's than clutter.

    Of clutter, the measures lie anywhere within their limits, and the contrasts of spot and surroundings are
    independent: the logarithm of the ratio of two half-normal ones has the density 1 / pi at 1, and less elsewhere.
    A target's measures are half-normal, and so is the ratio below 1, which half of the targets have.
    """
    measure = log(2 * _LIMIT_SIGMAS / sqrt(2 * pi))
    contrast = log(pi / (_CONTRAST_SPREAD * sqrt(2 * pi)))
    return 2 * (3 * measure + contrast - log(_CLUTTER_SHARE))


#: Square beyond which odds are against a ring.
_MOST_SQUARE = _most_square()


# --- sectors --------------------------------------------------------------------------------------------------------


class _Sectors(NamedTuple):
    """Sectors of m profiles: bits, turn, contrast, rms misfit over that, blurred ink of the bits (m, angles)."""

    bits: BoolArray
    turn_rad: FloatArray
    contrast: FloatArray
    misfit: FloatArray
    model: FloatArray


@lru_cache(maxsize=64)
def _blurred_sectors(n_bits: int, blur: float) -> tuple[FloatArray, FloatArray]:
    """Return the ink of each sector round the circle, blurred, shape (angles, n_bits), and its pseudo-inverse."""
    angle = np.arange(n_bits * ANGLES_PER_SECTOR) / ANGLES_PER_SECTOR
    off = (angle - 0.5 + n_bits / 2) % n_bits - n_bits / 2
    cumulated = np.vectorize(lambda value: 0.5 * (1 + erf(value / (blur * sqrt(2)))))
    first = cumulated(off + 0.5) - cumulated(off - 0.5)
    # The others are the first one, turned.
    columns = np.stack([np.roll(first, sector * ANGLES_PER_SECTOR) for sector in range(n_bits)], axis=1)
    return columns, np.linalg.pinv(columns)


def _read_sectors(profile: FloatArray, blur: FloatArray, n_bits: int) -> _Sectors:
    """Find the sectors, in two levels, that reproduce profiles best, for every phase and the blurs near their own."""
    count = len(profile)
    best = _Sectors(
        np.zeros((count, n_bits), dtype=np.bool_),
        np.zeros(count),
        np.zeros(count),
        np.full(count, np.inf),
        np.zeros_like(profile),
    )
    nearest = np.abs(blur[:, None] - np.array(_BLURS)).argmin(axis=1)
    n_angles = profile.shape[1]
    # All phases of a profile: every sample as the first one, and every middle between two.
    first = np.arange(ANGLES_PER_SECTOR * _PHASES_PER_SAMPLE)
    places = (np.arange(n_angles) + (first // _PHASES_PER_SAMPLE)[:, None]) % n_angles
    places += n_angles * (first % _PHASES_PER_SAMPLE)[:, None]
    fine = np.concatenate([profile, 0.5 * (profile + np.roll(profile, -1, axis=1))], axis=1)
    for place, one in enumerate(_BLURS):
        columns, inverse = _blurred_sectors(n_bits, one)
        chosen = np.flatnonzero((nearest == place) | (nearest + 1 == place))
        for start in range(0, len(chosen), _PROFILES_AT_ONCE):
            rows = chosen[start : start + _PROFILES_AT_ONCE]
            turned = fine[rows][:, places]
            ink = turned @ inverse.T
            # Two levels: the threshold lies in the widest gap between the sectors' inks.
            order = np.sort(ink, axis=2)
            gap_at = np.diff(order, axis=2).argmax(axis=2)[..., None]
            threshold = 0.5 * (
                np.take_along_axis(order, gap_at, axis=2) + np.take_along_axis(order, gap_at + 1, axis=2)
            )
            bits = ink > threshold
            model = bits @ columns.T
            middle, mean = model.mean(axis=2, keepdims=True), turned.mean(axis=2, keepdims=True)
            ideal, seen = model - middle, turned - mean
            square = np.maximum(np.einsum("rpa,rpa->rp", ideal, ideal), 1e-9)
            contrast = np.einsum("rpa,rpa->rp", seen, ideal) / square
            left = np.einsum("rpa,rpa->rp", seen, seen) - contrast**2 * square
            blank = mean[..., 0] - contrast * middle[..., 0]
            misfit = np.sqrt(np.maximum(left, 0.0) / n_angles) / np.maximum(contrast, 1e-3)
            # Blank sectors are as bright as the ground, inked ones not darker than the dot: else it is no print.
            misfit = np.where((np.abs(blank) < 0.35) & (contrast < 1.6), misfit, np.inf)
            phase, every = misfit.argmin(axis=1), np.arange(len(rows))
            better = misfit[every, phase] < best.misfit[rows]
            own, every, phase = rows[better], every[better], phase[better]
            best.bits[own], best.contrast[own] = bits[every, phase], contrast[every, phase]
            best.misfit[own] = misfit[every, phase]
            best.turn_rad[own] = phase * (2 * np.pi / (_PHASES_PER_SAMPLE * n_angles))
            back = (np.arange(n_angles) - (phase // _PHASES_PER_SAMPLE)[:, None]) % n_angles
            best.model[own] = model[every[:, None], phase[:, None], back]
    return best


def _unexplained(values: FloatArray, model: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what neither a plane nor bleeding sectors explain of values round circles, rms, and their mean level."""
    count, n_angles = values.shape
    angles = np.arange(n_angles) * (2 * np.pi / n_angles)
    common = np.stack([np.ones(n_angles), np.cos(angles), np.sin(angles)])
    columns = np.concatenate([np.broadcast_to(common, (count, 3, n_angles)), model[:, None]], axis=1)
    normal = columns @ np.swapaxes(columns, 1, 2) + 1e-6 * np.eye(4)
    solution = np.linalg.solve(normal, columns @ values[:, :, None])
    left = np.sort(np.abs(values - (np.swapaxes(solution, 1, 2) @ columns)[:, 0]), axis=1)
    kept = left[:, : int((1 - _SPOILT_SHARE) * n_angles)]
    return np.sqrt(np.mean(kept**2, axis=1)), np.abs(np.median(values, axis=1))


# --- radii of a sheet -----------------------------------------------------------------------------------------------


def _sigmas_off(profiles: RingProfiles, family: RingRadii, spread: FloatArray) -> FloatArray:
    """Return how far rings are from a family's radii, in standard deviations; NaN for those without radii."""
    off = np.stack([np.log(profiles.inner / family.inner), np.log(profiles.outer / family.outer)])
    return np.asarray(np.abs(off).max(axis=0) / spread)


def _families(
    profiles: RingProfiles,
    own: _Rings,
    sizes_px: FloatArray,
    spread: FloatArray,
    dictionary: RingDictionary,
    limits: RingLimits,
) -> tuple[RingRadii, ...]:
    """Find the radii on which rings agree: the densest place of their logarithms, then others with codes enough."""
    left = own.within(limits) & np.isfinite(profiles.inner)
    found: list[RingRadii] = []
    while left.any():
        family, members = _densest(profiles, left, spread)
        words = {bytes(own.bits[k]) for k in members.tolist()}
        if not found:
            usual = _sigmas_off(profiles, dictionary.radii, spread)[members].min() < _MOST_SIGMAS
            believed = usual or len(words) > 1 or bool(sizes_px[members].max() >= _ALONE_PX)
        else:
            codes = (dictionary.read(tuple(own.bits[k].tolist())).code for k in members.tolist())
            believed = len({code.name for code in codes if code is not None}) >= MEMBERS
        if not believed:
            break
        found.append(family)
        left[members] = False
    return tuple(found)


def _densest(profiles: RingProfiles, among: BoolArray, spread: FloatArray) -> tuple[RingRadii, IntArray]:
    """Return the radii about which most of some rings lie, and the numbers of these."""
    rows = np.flatnonzero(among)
    logs = np.log(np.stack([profiles.inner[rows], profiles.outer[rows]], axis=1))
    variance = spread[rows] ** 2
    square = ((logs[:, None] - logs[None]) ** 2).sum(axis=2) / (variance[:, None] + variance[None])
    density = np.exp(-0.5 * square).sum(axis=1)
    middle = logs[np.argmax(density)]
    for _ in range(3):
        near = np.abs(logs - middle).max(axis=1) < _MOST_SIGMAS * spread[rows]
        if not near.any():
            break
        middle = np.average(logs[near], axis=0, weights=1 / variance[near])
    near = np.abs(logs - middle).max(axis=1) < _MOST_SIGMAS * spread[rows]
    near[np.argmax(density)] = True
    inner, outer = np.exp(middle).tolist()
    return RingRadii(max(inner, LEAST_INNER_RADIUS), max(outer, inner + LEAST_RING_WIDTH)), rows[near]


def _fitting_bits(
    profiles: RingProfiles,
    own: _Rings,
    families: Sequence[RingRadii],
    spread: FloatArray,
    dictionary: RingDictionary,
    limits: RingLimits,
) -> int | None:
    """Return into how many sectors the photo's rings divide, where it is clearly another number than the given one."""
    n_bits = dictionary.n_bits
    rings = (
        np.isfinite(own.misfit)
        & (own.gap <= limits.most_gap)
        & (own.beyond <= limits.most_beyond)
        & (own.level <= limits.most_level)
        & (own.contrast >= limits.least_contrast)
    )
    if families:
        rings &= _sigmas_off(profiles, families[0], spread) < _MOST_SIGMAS
        rows = np.flatnonzero(rings)
    elif rings.any():
        rows = _densest(profiles, rings, spread)[1]
    else:
        return None
    if rows.size < MEMBERS:
        return None
    read = own.bits[rows]
    if np.sqrt(np.mean(own.misfit[rows] ** 2)) >= 0.5 * limits.most_misfit:
        other = _read_otherwise(profiles.chosen(rows), n_bits)
        if other is None:
            return None
        read = other
    read = _coarsest(read)
    fitting = read.shape[1]
    if fitting == n_bits or fitting == _coarsest(np.array([one.sectors for one in dictionary.codes])).shape[1]:
        return None
    # Dots of a grid have rings of neighbours, all alike; codes of a sheet differ.
    words = read @ (1 << np.arange(fitting)[::-1])
    alike = Counter(smallest_rotation(word, fitting) for word in words.tolist()).most_common(1)[0][1]
    return None if alike > _MOST_ALIKE * rows.size else fitting


def _read_otherwise(part: RingProfiles, n_bits: int) -> BoolArray | None:
    """Read rings as of the number of sectors that fits best; None where it is not clearly better than the given one."""
    width = part.outer - part.inner
    profile = part.band(part.inner + _RING_PART[0] * width, part.inner + _RING_PART[1] * width)
    closed = np.concatenate([profile, profile[:, :1]], axis=1)
    misfits, words = {}, {}
    for bits in range(FEWEST_BITS, MOST_BITS + 1):
        n_angles = bits * ANGLES_PER_SECTOR
        place = np.arange(n_angles) * (profile.shape[1] / n_angles)
        before = place.astype(np.intp)
        share = place - before
        resampled = closed[:, before] * (1 - share) + closed[:, before + 1] * share
        blur = part.edge / (0.5 * (part.inner + part.outer)) * (bits / (2 * np.pi))
        sectors = _read_sectors(resampled, blur, bits)
        misfit, words[bits] = np.minimum(sectors.misfit, 1.0), sectors.bits
        misfits[bits] = float(np.sqrt(np.mean(misfit**2)))
    least = min(misfits.values())
    fitting = min(bits for bits, misfit in misfits.items() if misfit <= _AS_GOOD * least)
    clear = misfits[n_bits] >= _CLEARLY_BETTER * misfits[fitting]
    return words[fitting] if fitting != n_bits and clear else None


def _coarsest(words: BoolArray) -> BoolArray:
    """Return what was read in the fewest sectors that hold it: where all are equal in twos, each pair is one sector.

    words (n, bits): The rings' sectors. Rings of 8 sectors read as 16 are codes of a dictionary of 16, but of other
    names: of 16 sectors drawn at random 1 in 128 rings consists of pairs, and here all do.
    """
    bits = words.shape[1]
    for fewer in (fewer for fewer in range(FEWEST_BITS, bits) if bits % fewer == 0):
        parts = bits // fewer
        # Each ring is read from wherever its first edge lies.
        turned = np.stack([np.roll(words, turn, axis=1).reshape(len(words), fewer, parts) for turn in range(parts)])
        alike = (turned == turned[..., :1]).all(axis=(2, 3))
        if alike.any(axis=0).all():
            return turned[alike.argmax(axis=0), np.arange(len(words)), :, 0]
    return words


def ring_outline(dot: Ellipse, radii: RingRadii = VENDOR_RADII) -> Ellipse:
    """Return the outer outline of a target's code ring.

    Returns: The dot's ellipse, enlarged to the ring's outer radius.
    """
    return Ellipse(dot.center_px, dot.shape_px2 * radii.outer**2)
