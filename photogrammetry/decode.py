"""Read ring codes, and refuse what only happens to read like one.

A dictionary by itself admits false codes: a third of all 12-bit words are in it. A ring is therefore read only if it is
one: an even gap, a code ring whose inked sectors begin at 2 and end at 3 radii, as black as the dot and as white as the
gap, with all borders where sectors have them.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.coded_targets import CODE_INNER_RADIUS, CODE_OUTER_RADIUS, RingCode, RingDictionary
from photogrammetry.ellipse import Ellipse

__all__ = ["RingLimits", "RingReading", "read_ring"]

#: Samples: angles for each sector, and radii in units of the dot's radius, the first one for the dot's own level.
_ANGLES_PER_SECTOR = 12
_RADII = np.concatenate([[0.4], np.arange(1.3, 3.51, 0.1)])
_GAP = (_RADII > 1.35) & (_RADII < 1.65)
_CODE = (_RADII > 2.25) & (_RADII < 2.75)
_BEYOND = _RADII > 3.25


@dataclass(frozen=True, slots=True)
class RingLimits:
    """How good a ring must be to be read.

    Parameters
    ----------
    least_contrast : float, optional
        Darkest blank against lightest inked sector, as a share of the dot's contrast.
    most_gap_unevenness : float, optional
        Rms of the gap's grey values about a plane, as a share of the dot's contrast.
    most_border_error : float, optional
        Rms distance of the borders between sectors from an even division, in sectors.
    most_radial_error : float, optional
        Distance of the ring's inner and outer border from 2 and 3, in radii of the dot.
    most_misfit : float, optional
        Rms of ink away from all borders against the code read, as a share of the dot's contrast.

    Notes
    -----
    Measured on busy ground: docs/targets.md.
    """

    least_contrast: float = 0.3
    most_gap_unevenness: float = 0.12
    most_border_error: float = 0.13
    most_radial_error: float = 0.3
    most_misfit: float = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class RingReading:
    """What was read round one dot.

    Parameters
    ----------
    code : RingCode or None
        The code if the target is seen as printed; None if the word is in no dictionary.
    mirrored : RingCode or None
        The code of the mirror image.
    sectors : tuple of bool
        Ink of the sectors, clockwise in the image.
    contrast : float
        Lightest inked against darkest blank sector, as a share of the dot's contrast.
    gap_unevenness : float
        Rms of the gap about a plane, as a share of the dot's contrast.
    border_error : float
        Rms distance of the borders between sectors from an even division [sectors].
    radial_error : float
        Larger distance of the ring's inner and outer border from 2 and 3 [radii].
    misfit : float
        Rms of ink away from all borders against the code, as a share of the dot's contrast.
    """

    code: RingCode | None
    mirrored: RingCode | None
    sectors: tuple[bool, ...]
    contrast: float
    gap_unevenness: float
    border_error: float
    radial_error: float
    misfit: float

    @property
    def is_mirror_image(self) -> bool:
        """Whether only the mirror image is in the dictionary: a mirrored print or photo."""
        return self.code is None and self.mirrored is not None

    def within(self, limits: RingLimits) -> bool:
        """Tell whether this is a ring.

        Parameters
        ----------
        limits : RingLimits
            How good it must be.

        Returns
        -------
        bool
            All measures keep their limits.
        """
        return (
            self.contrast >= limits.least_contrast
            and self.gap_unevenness <= limits.most_gap_unevenness
            and self.border_error <= limits.most_border_error
            and self.radial_error <= limits.most_radial_error
            and self.misfit <= limits.most_misfit
        )


def read_ring(
    image_dn: npt.NDArray[np.generic],
    dot: Ellipse,
    dictionary: RingDictionary,
    limits: RingLimits | None = None,
) -> RingReading | None:
    """Read the code ring round a dot.

    Parameters
    ----------
    image_dn : ndarray, shape (h, w)
        The photo's grey values [DN].
    dot : Ellipse
        The dot's outline in the photo's pixels.
    dictionary : RingDictionary
        The codes that may occur.
    limits : RingLimits, optional
        How good a ring must be.

    Returns
    -------
    RingReading or None
        None if there is no ring, or not all of it in the photo; a reading without a code if there is a ring whose
        word no dictionary holds.
    """
    sampled = _ink(image_dn, dot, dictionary.n_bits * _ANGLES_PER_SECTOR)
    if sampled is None:
        return None
    ink, unevenness = sampled
    allowed = limits or RingLimits()
    if unevenness > allowed.most_gap_unevenness:
        return None
    profile = ink[_CODE].mean(axis=0)
    borders = _crossings(profile) / _ANGLES_PER_SECTOR
    if len(borders) < 2:
        return None
    turn = np.exp(2j * np.pi * borders).mean()
    phase = float(np.angle(turn)) / (2 * np.pi)
    off = (borders - phase + 0.5) % 1.0 - 0.5
    # From here on the first sample lies on a border between sectors.
    position = (np.arange(len(profile)) / _ANGLES_PER_SECTOR - phase) % dictionary.n_bits
    sector = np.minimum(position.astype(np.intp), dictionary.n_bits - 1)
    from_border = np.abs(position - sector - 0.5)
    levels = np.array([profile[(sector == k) & (from_border < 0.3)].mean() for k in range(dictionary.n_bits)])
    bits = levels > 0.5
    if np.count_nonzero(bits != np.roll(bits, 1)) != len(borders):
        return None
    found = dictionary.read([bool(bit) for bit in bits])
    reading = RingReading(
        found.code,
        found.mirrored,
        tuple(bool(bit) for bit in bits),
        float(levels[bits].min() - levels[~bits].max()),
        unevenness,
        float(np.sqrt(np.mean(off**2))),
        _radial_error(ink[1:, bits[sector] & (from_border < 0.3)]),
        _misfit(ink, bits[sector], from_border),
    )
    return reading if reading.within(allowed) else None


def _ink(image_dn: npt.NDArray[np.generic], dot: Ellipse, n_angles: int) -> tuple[FloatArray, float] | None:
    """Share of ink on rings round a dot, shape (radii, angles), and how uneven its gap is; None beyond the border."""
    angles = np.arange(n_angles) * (2 * np.pi / n_angles)
    points = dot.points_px(angles[None, :], _RADII[:, None])
    low = np.floor(points.min(axis=(0, 1))).astype(int) - 1
    high = np.ceil(points.max(axis=(0, 1))).astype(int) + 3
    if (low < 0).any() or high[0] > image_dn.shape[1] or high[1] > image_dn.shape[0]:
        return None
    window = np.ascontiguousarray(image_dn[low[1] : high[1], low[0] : high[0]], dtype=np.float32)
    at = (points - low).astype(np.float32)
    values = np.asarray(cv2.remap(window, at[..., 0], at[..., 1], cv2.INTER_LINEAR), dtype=np.float64)
    gap = values[_GAP].mean(axis=0)
    # The gap's level as a plane: its first harmonic round the dot. Levels of the ring follow the plane outwards.
    plane = np.stack([np.ones(n_angles), np.cos(angles), np.sin(angles)], axis=1)
    solution = plane.T @ gap / (n_angles * np.array([1.0, 0.5, 0.5]))
    inside = float(values[0].mean())
    if inside == solution[0]:
        return None
    unevenness = float(np.sqrt(np.mean((gap - plane @ solution) ** 2)) / abs(inside - solution[0]))
    slope = (plane[:, 1:] @ solution[1:])[None, :] * (_RADII[:, None] / 1.5)
    blank = solution[0] + slope
    return (values - blank) / (inside - solution[0]), unevenness


def _crossings(profile: FloatArray) -> FloatArray:
    """Return where a cyclic profile crosses one half, in samples."""
    above = profile - 0.5
    following = np.roll(above, -1)
    at = np.flatnonzero((above > 0) != (following > 0))
    return np.asarray(at + above[at] / (above[at] - following[at]))


def _radial_error(ink: FloatArray) -> float:
    """Distance of the ring's borders from where they belong, in radii; infinite without borders."""
    if ink.shape[1] == 0:
        return float("inf")
    profile = ink.mean(axis=1) - 0.5
    inside = np.flatnonzero(profile > 0)
    if len(inside) == 0 or inside[0] == 0 or inside[-1] == len(profile) - 1 or len(inside) != np.ptp(inside) + 1:
        return float("inf")
    radii = _RADII[1:]
    step = float(radii[1] - radii[0])
    first, last = inside[0], inside[-1]
    begin = radii[first] - step * profile[first] / (profile[first] - profile[first - 1])
    end = radii[last] + step * profile[last] / (profile[last] - profile[last + 1])
    return float(max(abs(begin - CODE_INNER_RADIUS), abs(end - CODE_OUTER_RADIUS)))


def _misfit(ink: FloatArray, inked: BoolArray, from_border: FloatArray) -> float:
    """Rms of ink against what the sectors say, away from all borders; the quiet zone beyond the ring is blank."""
    middle = from_border < 0.3
    in_ring = ink[_CODE][:, middle] - inked[middle]
    beyond = ink[_BEYOND][:, middle]
    return float(np.sqrt(0.5 * (np.mean(in_ring**2) + np.mean(np.minimum(np.abs(beyond), 1.0) ** 2))))


def ring_outline(dot: Ellipse) -> Ellipse:
    """Return the outer outline of a target's code ring.

    Parameters
    ----------
    dot : Ellipse
        The dot.

    Returns
    -------
    Ellipse
        Its ellipse, three times as large.
    """
    return Ellipse(dot.center_px, dot.shape_px2 * CODE_OUTER_RADIUS**2)
