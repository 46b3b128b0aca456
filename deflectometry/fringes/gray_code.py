"""Gray codes: stripes that halve from image to image say in which cell of the display a pixel looks."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.phase import QUANTISATION_VARIANCE_DN2
from deflectometry.fringes.screen_map import ScreenMapLimits
from deflectometry.setup.patterns import Axis, GrayCode
from deflectometry.sources.display_edge import DisplayEdge, flag_display_edge
from deflectometry.sources.noise_model import NoiseModel
from deflectometry.sources.screen_map import ScreenMap
from deflectometry.sources.source import Exchange, Remedies
from heliogauge.adjust.chi_square import chi_square_limit
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array, FloatArray, freeze

#: Pixels from which the noise is estimated (harmless: 20 pairs of frames give it to 0.3 %).
_NOISE_PIXELS = 8000
#: Share of SD^2 above which it is mostly that of cells: half.
_MOSTLY = 0.5
#: Mean difference of the pairs of one bit, as a share of the largest, below which its stripes are too fine: where what
#: a pixel sees is f wide and a stripe w, pixels on edges leave 1 - f / (2 w), and two edges in one pixel turn its sign
#: from f = w on. This is f = w / 2.
_LEAST_CONTRAST = 0.75


def decode(
    frames: npt.NDArray[Any], code: GrayCode, axis: Axis, region: BoolArray, noise: NoiseModel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Decode one axis.

    frames (n, h, w): All frames, in the order of the code [DN].
    region (h, w): Pixels to decode.
    Returns (pixels,): Fraction of the displayed image, its standard deviation, largest difference of a pair [DN].

    A pixel's position x in the cells of one bit is ``y / 2`` where that bit is 0 and ``1 - y / 2`` where it is 1; y is
    the position in those of the next finer one (the code reflects). Below the finest bit y is uniform, 1 / sqrt(12). A
    bit is 1 with the probability that noise leaves to the difference of its pair; mean and variance of the mixture
    follow. At an edge of a coarse stripe the finer ones say that it is near, so that the doubt costs nothing. Stripes
    too fine for camera and lens are left out.
    """
    from scipy.special import ndtr

    pairs, bits = frames[code.frames_of(axis)], range(code.bits(axis))

    def difference(bit: int) -> FloatArray:
        return np.asarray(pairs[2 * bit][region].astype(np.float64) - pairs[2 * bit + 1][region])

    sigma_dn, largest = math.sqrt(2.0) * noise.sigma_read_dn, np.zeros(int(np.count_nonzero(region)))
    for bit in bits:
        np.maximum(largest, np.abs(difference(bit)), out=largest)
    usual_dn = float(largest.mean())
    mean, variance = np.full(largest.size, 0.5), np.full(largest.size, 1.0 / 12.0)
    for bit in reversed(bits):
        differs = difference(bit)
        if np.abs(differs).mean() < _LEAST_CONTRAST * usual_dn:
            continue
        is_one = ndtr(differs / sigma_dn)
        variance = 0.25 * variance + is_one * (1.0 - is_one) * (1.0 - mean) ** 2
        mean = is_one * (1.0 - 0.5 * mean) + (1.0 - is_one) * 0.5 * mean
    # The code counts to a power of two; the display has fewer columns.
    scale = 2 ** code.bits(axis) / code.cells(axis)
    return scale * mean, scale * np.sqrt(variance), largest


def estimate_noise(frames: npt.NDArray[Any], code: GrayCode, region: BoolArray) -> NoiseModel:
    """Estimate the noise of a reading: a frame and its inverse add up to the same for all bits.

    EstimationError: No pixel.
    """
    chosen = np.flatnonzero(region.ravel())
    if not chosen.size:
        raise EstimationError("region: it has no pixel; is the mirror in view?")
    chosen = chosen[:: max(1, chosen.size // _NOISE_PIXELS)]
    readings = frames.reshape(len(frames), -1)[:, chosen].astype(np.float64)
    sums = readings[0::2] + readings[1::2]
    pairs = len(sums)
    left = (sums - sums.mean(axis=0)) * math.sqrt(0.5 * pairs / max(pairs - 1, 1))
    floor = math.sqrt(QUANTISATION_VARIANCE_DN2)
    return NoiseModel(max(float(robust_scale(left.ravel())), floor))


def doubt_of_cells(numbers: Mapping[str, float | int | None]) -> Doubt | None:
    """Return a doubt where the cells of the code, not the mirror, are most of SDx^2 or SDy^2.

    numbers: Headline numbers of a mirror.
    """
    random, whole = (
        np.array([numbers.get(key.format(axis)) or math.nan for axis in "xy"], dtype=np.float64)
        for key in ("sigma_random_{}_rms_rad", "sd{}_tilt_removed_rad")
    )
    if not (random**2 > _MOSTLY * whole**2).any():
        return None
    return Doubt(
        "gray_code_cells",
        f"the cells of the Gray code that camera and lens resolve determine a slope to {1e3 * random[0]:.2g} (x) and "
        f"{1e3 * random[1]:.2g} mrad (y) only, which is most of SDx = {1e3 * whole[0]:.2g} or SDy = "
        f"{1e3 * whole[1]:.2g} mrad: the mirror is better than these; focus and canting are means of many cells. "
        "Show fringes, whose phase is finer than a cell",
        {"cells_x_rad": float(random[0]), "cells_y_rad": float(random[1])},
    )


GRAY_CODE_REMEDIES = Remedies("show fringes, whose phase is finer than a cell", "pattern.gray_code and its frames")


@dataclass(frozen=True, slots=True, eq=False)
class GrayCodeObservation(ShortRepr):
    """The images of a Gray code.

    frames (n, h, w): Frames in the order of the code [DN].
    code: What was shown.
    lit (h, w): Bright minus dark frame [DN].
    noise: Noise of a reading; estimated without it.
    limits: Error probabilities.
    reversed_axes: Axes of the display that were shown the wrong way round.
    axes: Which axis of the display the columns and the rows of the code are.
    """

    frames: npt.NDArray[Any]
    code: GrayCode
    lit: Float32Array | None = None
    noise: NoiseModel | None = None
    limits: ScreenMapLimits = field(default_factory=ScreenMapLimits)
    reversed_axes: frozenset[Axis] = frozenset()
    axes: tuple[Axis, Axis] = (Axis.X, Axis.Y)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images [px]."""
        return int(self.frames.shape[2]), int(self.frames.shape[1])

    @property
    def remedies(self) -> Remedies:
        """What to do about slopes that contradict themselves."""
        return GRAY_CODE_REMEDIES

    @property
    def mixes_edges(self) -> bool:
        """Whether a sample near an edge shows what is beside the mirror: a pixel does."""
        return True

    def mirror_image(self) -> Float32Array:
        """Return an image in which the mirror is bright: bright minus dark frame, else the pairs' contrast [DN]."""
        if self.lit is not None:
            return self.lit
        contrast = np.zeros(self.frames.shape[1:], dtype=np.float32)
        for first, second in zip(self.frames[0::2], self.frames[1::2], strict=True):
            contrast += np.abs(first.astype(np.float32) - second)
        return np.asarray(contrast / np.float32(len(self.frames) // 2), dtype=np.float32)

    def clutter(self) -> None:
        """Return nothing: stripes are averaged out."""

    def screen_map(self, region: BoolArray) -> ScreenMap:
        """Measure the display point that each pixel of a region sees."""
        noise = estimate_noise(self.frames, self.code, region) if self.noise is None else self.noise
        # A difference that noise alone hardly reaches in any pair.
        least_dn = math.sqrt(2.0 * chi_square_limit(self.limits.no_fringe_probability, 1)) * noise.sigma_read_dn
        beyond = math.sqrt(chi_square_limit(self.limits.wrong_order_probability, 1))
        shape = region.shape
        flags = np.full(shape, SampleFlag.OUTSIDE_MIRROR, dtype=np.uint32)
        inside = np.zeros(np.count_nonzero(region), dtype=np.uint32)
        places, sigmas, contrast = {}, {}, np.zeros(inside.size)
        for of_code, axis in zip(Axis, self.axes, strict=True):
            place, sigma, largest = decode(self.frames, self.code, of_code, region, noise)
            contrast += 0.25 * largest
            inside[largest < least_dn] |= np.uint32(SampleFlag.LOW_MODULATION)
            inside[place - 1.0 > beyond * sigma] |= np.uint32(SampleFlag.OFF_SCREEN)
            places[axis], sigmas[axis] = 1.0 - place if axis in self.reversed_axes else place, sigma
        flags[region] = inside

        def image(values: FloatArray, keep: BoolArray | None = None) -> Float32Array:
            whole = np.full(shape, np.nan, dtype=np.float32)
            whole[region] = values if keep is None else np.where(keep, values, np.nan)
            return freeze(whole)

        good = inside == 0
        u, v, sigma_u, sigma_v = (image(one[axis], good) for one in (places, sigmas) for axis in Axis)
        # Most pixels are sure of every bit that is used: their sigma is that of a whole cell.
        cells = np.array([math.sqrt(12.0) * float(np.median(sigmas[axis])) for axis in Axis])
        return ScreenMap(u, v, sigma_u, sigma_v, image(contrast), freeze(flags), noise, cells=freeze(cells))

    def display_edge(self, screen_map: ScreenMap, region: BoolArray, margin_px: float) -> DisplayEdge:
        """Flag pixels that see the edge of the display."""
        return flag_display_edge(screen_map, region, margin_px)

    def exchanges(self, seen: ScreenMap) -> Iterator[Exchange]:
        """Yield what programs and people exchange: sides of the images, sides and axes of the pattern.

        seen: Not needed: reading the code again takes little.
        """
        both = (
            ("left and right of the images are exchanged", (slice(None), slice(None, None, -1))),
            ("top and bottom of the images are exchanged", (slice(None, None, -1), slice(None))),
            ("the images are turned by 180 deg", (slice(None, None, -1), slice(None, None, -1))),
        )
        for words, (rows, columns) in both:
            lit = None if self.lit is None else np.ascontiguousarray(self.lit[rows, columns])
            turned = replace(self, frames=np.ascontiguousarray(self.frames[:, rows, columns]), lit=lit)
            yield Exchange(words, turned, moves_outline=True)
        for words, axes in (
            ("left and right of the displayed pattern are exchanged", {Axis.X}),
            ("top and bottom of the displayed pattern are exchanged", {Axis.Y}),
            ("the displayed pattern is turned by 180 deg", {Axis.X, Axis.Y}),
        ):
            yield Exchange(words, replace(self, reversed_axes=frozenset(axes)), moves_outline=False)
        words = "frames of columns and of rows of the Gray code are exchanged"
        yield Exchange(words, replace(self, axes=(Axis.Y, Axis.X)), moves_outline=False)
