"""Read ring codes, and refuse what only happens to read like one.

A dictionary by itself admits false codes: a third of all 12-bit words are in it. A ring is therefore read only if it is
one: an even gap, a code ring whose inked sectors begin and end at the radii of the print, as black as the dot and as
white as the gap, with all borders where sectors have them. All rings of a photo are sampled and judged at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray
from photogrammetry.centers.ellipse import Ellipse
from photogrammetry.centers.pyramid import Pyramid
from photogrammetry.targets.coded_targets import RingDictionary
from photogrammetry.targets.ring_codes import VENDOR_RADII, RingCode, RingRadii

#: Samples for each sector, and in this share of a sector about its middle its level is taken.
_ANGLES_PER_SECTOR, _MIDDLE = 12, 0.6
#: Radius of the ring on which the dot's own level is taken, and distance of the samples along the radius [radii].
_DOT_RADIUS, _RADIAL_STEP = 0.4, 0.1
#: Parts of gap and ring in which the level is taken, and how far the quiet zone beyond the ring is looked at.
_GAP_PART, _RING_PART, _BEYOND_RADII = (0.35, 0.65), (0.25, 0.75), (0.25, 0.5)


@dataclass(frozen=True, slots=True)
class RingLimits:
    """How good a ring must be to be read.

    least_contrast: Darkest blank against lightest inked sector, as a share of the dot's contrast.
    most_gap_unevenness: Rms of the gap's grey values about a plane, as a share of the dot's contrast.
    most_border_error: Rms distance of the borders between sectors from an even division, in sectors.
    most_radial_error: Distance of the ring's inner and outer border from where the print has them, in radii of the
        dot.
    most_misfit: Rms of ink away from all borders against the code read, as a share of the dot's contrast.

    Measured on busy ground: docs/explanation/target_detection.md.
    """

    least_contrast: float = 0.3
    most_gap_unevenness: float = 0.12
    most_border_error: float = 0.13
    most_radial_error: float = 0.3
    most_misfit: float = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class RingReading:
    """What was read round one dot.

    code: The code if the target is seen as printed; None if the word is in no dictionary.
    mirrored: The code of the mirror image.
    sectors: Ink of the sectors, clockwise in the image.
    contrast: Lightest inked against darkest blank sector, as a share of the dot's contrast.
    gap_unevenness: Rms of the gap about a plane, as a share of the dot's contrast.
    border_error: Rms distance of the borders between sectors from an even division [sectors].
    radial_error: Larger distance of the ring's inner and outer border from where the print has them [radii].
    misfit: Rms of ink away from all borders against the code, as a share of the dot's contrast.
    """

    code: RingCode | None
    mirrored: RingCode | None
    sectors: tuple[bool, ...]
    contrast: float
    gap_unevenness: float
    border_error: float
    radial_error: float
    misfit: float

    def within(self, limits: RingLimits) -> bool:
        """Return whether this is a ring.

        limits: How good it must be.
        Returns: All measures keep their limits.
        """
        return (
            self.contrast >= limits.least_contrast
            and self.gap_unevenness <= limits.most_gap_unevenness
            and self.border_error <= limits.most_border_error
            and self.radial_error <= limits.most_radial_error
            and self.misfit <= limits.most_misfit
        )


def read_rings(
    pyramid: Pyramid, dots: Sequence[Ellipse], dictionary: RingDictionary, limits: RingLimits | None = None
) -> tuple[RingReading | None, ...]:
    """Read the code rings round all dots of a photo.

    dots: Outlines of the dots in the photo's pixels.
    dictionary: The codes that may occur, and the radii of their rings.
    limits: How good a ring must be.
    Returns: One for each dot; None if there is no ring, or not all of it in the photo; a reading without a code if
        there is a ring whose word no dictionary holds.
    """
    found: list[RingReading | None] = [None] * len(dots)
    if not dots:
        return ()
    allowed = limits or RingLimits()
    shapes, centers = np.array([dot.shape_px2 for dot in dots]), np.array([dot.center_px for dot in dots])
    radii = _Radii.of(dictionary.radii)
    half = (radii.all[-1]) * np.sqrt(np.diagonal(shapes, axis1=1, axis2=2))
    inside = ((centers - half > 0) & (centers + half < np.array(pyramid.size_px) - 1)).all(axis=1)
    at = np.flatnonzero(inside)
    ink, unevenness = _ink(pyramid, shapes[at], centers[at], dictionary.n_bits * _ANGLES_PER_SECTOR, radii)
    even = unevenness <= allowed.most_gap_unevenness
    at, ink, unevenness = at[even], ink[even], unevenness[even]
    profile = ink[:, radii.code].mean(axis=1)
    phase, border_error, crossings = _find_borders(profile)
    position = (np.arange(profile.shape[1]) / _ANGLES_PER_SECTOR - phase[:, None]) % dictionary.n_bits
    sector = np.minimum(position.astype(np.intp), dictionary.n_bits - 1)
    middle = np.abs(position - sector - 0.5) < 0.5 * _MIDDLE
    levels = _sector_levels(profile, sector, middle, dictionary.n_bits)
    bits = levels > 0.5
    inked = np.take_along_axis(bits, sector, axis=1)
    contrast = np.where(bits, levels, np.inf).min(axis=1) - np.where(bits, -np.inf, levels).max(axis=1, initial=0.0)
    radial_error = _radial_error(ink, inked & middle, radii)
    misfit = _misfit(ink, inked, middle, radii)
    whole = bits.all(axis=1) & dictionary.has_full_ring
    settled = (np.count_nonzero(bits != np.roll(bits, 1, axis=1), axis=1) == crossings) & ((crossings >= 2) | whole)
    for k in np.flatnonzero(settled).tolist():
        word = tuple(bits[k].tolist())
        measures = (contrast[k], unevenness[k], border_error[k], radial_error[k], misfit[k])
        reading = RingReading(None, None, word, *map(float, measures))
        if reading.within(allowed):
            known = dictionary.read(word)
            found[at[k]] = replace(reading, code=known.code, mirrored=known.mirrored)
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Radii:
    """Radii at which rings are sampled, the first one in the dot, and which of them are where."""

    print: RingRadii
    all: FloatArray
    gap: BoolArray
    code: BoolArray
    beyond: BoolArray

    @classmethod
    def of(cls, radii: RingRadii) -> "_Radii":
        gap, width = radii.inner - 1, radii.outer - radii.inner
        every = np.arange(1 + 0.3 * gap, radii.outer + _BEYOND_RADII[1] + 0.01, _RADIAL_STEP)
        every = np.concatenate([[_DOT_RADIUS], every])
        return cls(
            radii,
            every,
            (every > 1 + _GAP_PART[0] * gap) & (every < 1 + _GAP_PART[1] * gap),
            (every > radii.inner + _RING_PART[0] * width) & (every < radii.inner + _RING_PART[1] * width),
            every > radii.outer + _BEYOND_RADII[0],
        )


def _ink(
    pyramid: Pyramid, shapes: FloatArray, centers: FloatArray, n_angles: int, radii: _Radii
) -> tuple[Float32Array, FloatArray]:
    """Share of ink on rings round dots, shape (n, radii, angles), and how uneven their gaps are."""
    angles = np.arange(n_angles) * (2 * np.pi / n_angles)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    unit = (circle[:, None, :] * radii.all[:, None]).reshape(2, -1)
    values = pyramid.around(centers, shapes, unit).reshape(len(shapes), len(radii.all), n_angles)
    gap = values[:, radii.gap].mean(axis=1, dtype=np.float64)
    # The gap's level as a plane: its first harmonic round the dot. Levels of the ring follow the plane outwards.
    plane = np.stack([np.ones(n_angles), *circle], axis=1)
    solution = gap @ plane / (n_angles * np.array([1.0, 0.5, 0.5]))
    step = values[:, 0].mean(axis=1, dtype=np.float64) - solution[:, 0]
    step = np.where(np.abs(step) > 1e-3, step, np.nan)
    unevenness = np.sqrt(np.mean((gap - solution @ plane.T) ** 2, axis=1)) / np.abs(step)
    slope = (solution[:, 1:] @ circle)[:, None, :] * (radii.all / (0.5 + 0.5 * radii.print.inner))[:, None]
    blank = (solution[:, :1, None] + slope).astype(np.float32)
    return (values - blank) / step.astype(np.float32)[:, None, None], np.nan_to_num(unevenness, nan=np.inf)


class _Borders(NamedTuple):
    """Where profiles cross one half: phase and rms departure from even sectors [sectors], number of crossings."""

    phase: FloatArray
    error: FloatArray
    crossings: IntArray


def _find_borders(profile: Float32Array) -> _Borders:
    above = profile - np.float32(0.5)
    following = np.roll(above, -1, axis=1)
    crosses = (above > 0) != (following > 0)
    step = np.where(crosses, above - following, 1.0)
    place = (np.arange(profile.shape[1]) + above / step) / _ANGLES_PER_SECTOR
    turn = np.sum(np.exp(2j * np.pi * place) * crosses, axis=1)
    phase = np.angle(turn) / (2 * np.pi)
    off = ((place - phase[:, None] + 0.5) % 1.0 - 0.5) * crosses
    count = np.count_nonzero(crosses, axis=1)
    return _Borders(phase, np.sqrt(np.sum(off**2, axis=1) / np.maximum(count, 1)), count)


def _sector_levels(profile: Float32Array, sector: IntArray, middle: BoolArray, n_bits: int) -> FloatArray:
    """Mean ink of the middle of each sector, shape (n, n_bits)."""
    slot = (sector + n_bits * np.arange(len(profile))[:, None])[middle]
    size = len(profile) * n_bits
    sums = np.bincount(slot, profile[middle], size) / np.maximum(np.bincount(slot, minlength=size), 1)
    return np.asarray(sums.reshape(len(profile), n_bits))


def _radial_error(ink: Float32Array, chosen: BoolArray, radii: _Radii) -> FloatArray:
    """Distance of the rings' borders from where they belong, in radii; infinite without borders."""
    count = np.maximum(np.count_nonzero(chosen, axis=1), 1)
    profile = np.einsum("nra,na->nr", ink[:, 1:], chosen) / count[:, None] - 0.5
    places, inside = radii.all[1:], profile > 0
    last_place = len(places) - 1
    first, last = inside.argmax(axis=1), last_place - inside[:, ::-1].argmax(axis=1)
    one_ring = (first > 0) & (last < last_place) & (np.count_nonzero(inside, axis=1) == last - first + 1)
    before, after = np.maximum(first - 1, 0), np.minimum(last + 1, last_place)

    def border(within: IntArray, beyond: IntArray) -> FloatArray:
        high, low = (np.take_along_axis(profile, at[:, None], axis=1)[:, 0] for at in (within, beyond))
        share = high / np.where(high == low, 1.0, high - low)
        return np.asarray(places[within] + share * (places[beyond] - places[within]))

    begin, end = border(first, before), border(last, after)
    error = np.maximum(np.abs(begin - radii.print.inner), np.abs(end - radii.print.outer))
    return np.where(one_ring, error, np.inf)


def _misfit(ink: Float32Array, inked: BoolArray, middle: BoolArray, radii: _Radii) -> FloatArray:
    """Rms of ink against what the sectors say, away from all borders; the quiet zone beyond the ring is blank."""
    count = np.maximum(np.count_nonzero(middle, axis=1), 1)
    in_ring = np.mean((ink[:, radii.code] - inked[:, None, :]) ** 2, axis=1)
    beyond = np.mean(np.minimum(np.abs(ink[:, radii.beyond]), 1.0) ** 2, axis=1)
    return np.asarray(np.sqrt(0.5 * np.sum((in_ring + beyond) * middle, axis=1) / count))


def ring_outline(dot: Ellipse, radii: RingRadii = VENDOR_RADII) -> Ellipse:
    """Return the outer outline of a target's code ring.

    Returns: The dot's ellipse, enlarged to the ring's outer radius.
    """
    return Ellipse(dot.center_px, dot.shape_px2 * radii.outer**2)
