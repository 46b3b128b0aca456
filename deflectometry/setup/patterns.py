"""Description of the displayed fringes: which frames were shown, in which order, with which steps."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array, positive

#: Smallest singular value of (1, cos s, sin s) / sqrt(n) that still counts as rank 3. Steps typed in degrees with
#: three decimals that coincide are 1e-5 apart at most; the closest steps anyone uses (three within 20 deg) give 4e-3.
_SMALLEST_SINGULAR_VALUE = 1e-4


class Axis(StrEnum):
    """Direction in which the fringes vary: X along u (left to right), Y along v (top to bottom)."""

    X = "x"
    Y = "y"


def design_matrix(steps_rad: npt.ArrayLike) -> FloatArray:
    """Return the linear model of one set of frames: columns 1, cos(step), sin(step).

    Shapes: steps_rad (n,).
    Returns (n, 3): ``I = M @ (a, b cos(phi), b sin(phi))``.
    """
    steps = float_array("steps_rad", steps_rad, (None,))
    return np.stack([np.ones_like(steps), np.cos(steps), np.sin(steps)], axis=1)


def determines_phase(steps_rad: npt.ArrayLike) -> bool:
    """Return whether frames with these steps determine offset, modulation and phase.

    Shapes: steps_rad (n,).
    Returns: True when at least three of the steps differ modulo 2 pi.

    >>> determines_phase([0, 2.0, 4.0]), determines_phase([0, np.pi, 0, np.pi])
    (True, False)
    """
    matrix = design_matrix(steps_rad)
    if len(matrix) < 3:
        return False
    return bool(np.linalg.svd(matrix, compute_uv=False)[2] > _SMALLEST_SINGULAR_VALUE * np.sqrt(len(matrix)))


@dataclass(frozen=True, slots=True, eq=False)
class FringeSet(ShortRepr):
    """Frames of one fringe period in one direction: ``I_k = a + b cos(2 pi periods w - steps_k)``, w = u or v.

    axis: Direction in which the fringes vary.
    periods: Number of periods over the whole displayed image; need not be whole, may be below 1.
    steps_rad (n,): Phase steps in the order of the frames, any values that determine the phase [rad].
    InputError: Periods not positive, or steps that do not determine the phase.
    """

    axis: Axis
    periods: float
    steps_rad: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", Axis(self.axis))
        object.__setattr__(self, "periods", positive("periods", self.periods, "fringe periods"))
        object.__setattr__(self, "steps_rad", float_array("steps_rad", self.steps_rad, (None,)))
        if not determines_phase(self.steps_rad):
            degrees = ", ".join(f"{step:.6g}" for step in np.degrees(self.steps_rad))
            raise InputError(
                f"fringe set {self.axis}, {self.periods:g} periods: the steps {degrees} deg do not determine the "
                "phase; at least three steps that differ modulo 360 deg are needed"
            )

    @property
    def n_frames(self) -> int:
        """Number of frames of the set."""
        return int(self.steps_rad.size)


@dataclass(frozen=True, slots=True, eq=False)
class FringePattern(ShortRepr):
    """All frames of a measurement, in the order in which they were taken.

    sets: The sets in the order of their frames; both axes occur, in any order.
    InputError: No set for one of the axes.
    """

    sets: tuple[FringeSet, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "sets", tuple(self.sets))
        for axis in Axis:
            if not any(fringes.axis is axis for fringes in self.sets):
                raise InputError(f"pattern: no fringe set with axis = {axis.value!r}; both axes are needed")

    @property
    def n_frames(self) -> int:
        """Number of frames of all sets."""
        return sum(fringes.n_frames for fringes in self.sets)

    @property
    def frame_slices(self) -> tuple[slice, ...]:
        """Position of each set among the frames."""
        ends = list(accumulate(fringes.n_frames for fringes in self.sets))
        return tuple(slice(end - fringes.n_frames, end) for end, fringes in zip(ends, self.sets, strict=True))

    def sets_of(self, axis: Axis) -> tuple[tuple[FringeSet, slice], ...]:
        """Return the sets of one axis with the position of their frames."""
        pairs = zip(self.sets, self.frame_slices, strict=True)
        return tuple((fringes, position) for fringes, position in pairs if fringes.axis is axis)

    def describe_frame(self, index: int) -> str:
        """Say in words what a frame shows.

        index: Position of the frame, from 0.
        Returns: Such as "frame 5 (y fringes, 3.9 periods, step 90 deg)".
        InputError: The pattern has no such frame.
        """
        for fringes, position in zip(self.sets, self.frame_slices, strict=True):
            if position.start <= index < position.stop:
                step = np.degrees(fringes.steps_rad[index - position.start])
                return f"frame {index} ({fringes.axis} fringes, {fringes.periods:g} periods, step {step:.4g} deg)"
        raise InputError(f"frame {index}: the pattern has frames 0 to {self.n_frames - 1}")


@dataclass(frozen=True, slots=True)
class GrayCode:
    """Stripes of a display: for each bit of the column a frame and its inverse, coarsest first, then those of the row.

    width_px, height_px: Size of the displayed image [px].
    """

    width_px: int
    height_px: int

    def bits(self, axis: Axis) -> int:
        """Return the number of bits of columns (x) or rows (y)."""
        return max((self.cells(axis) - 1).bit_length(), 1)

    def cells(self, axis: Axis) -> int:
        """Return the number of columns (x) or rows (y)."""
        return self.width_px if axis is Axis.X else self.height_px

    @property
    def n_frames(self) -> int:
        """Number of frames, inverse ones included."""
        return 2 * (self.bits(Axis.X) + self.bits(Axis.Y))

    def frames_of(self, axis: Axis) -> slice:
        """Return where the frames of an axis stand."""
        first = 0 if axis is Axis.X else 2 * self.bits(Axis.X)
        return slice(first, first + 2 * self.bits(axis))

    def describe(self) -> str:
        """Say what was shown."""
        size = f"{self.width_px} x {self.height_px} px"
        return f"{self.n_frames} frames: Gray code of {size}, {self.bits(Axis.X)} and {self.bits(Axis.Y)} bits"


def equal_steps(n: int) -> FloatArray:
    """Return n steps of 2 pi / n, from 0.

    Shapes: result (n,).
    n: Number of frames, at least 3.
    InputError: Fewer than 3.

    >>> np.degrees(equal_steps(4))
    array([  0.,  90., 180., 270.])
    """
    if n < 3:
        raise InputError(f"steps: at least 3 frames determine a phase, not {n}")
    return np.asarray(np.arange(n) * (2 * np.pi / n), dtype=np.float64)


def make_pattern(
    periods_x: Sequence[float], periods_y: Sequence[float], steps: int = 4, first: Axis = Axis.Y
) -> FringePattern:
    """Make a pattern with equal steps of 2 pi / n for every period.

    periods_x, periods_y: Periods over the width and over the height of the displayed image.
    steps: Frames of each set, at least 3.
    Returns: All sets of the first axis, then all of the other.
    InputError: An axis without periods, periods not positive, fewer than 3 steps.

    >>> make_pattern([0.9, 3.9], [0.9, 3.9]).n_frames
    16
    """
    steps_rad = equal_steps(steps)
    order = (Axis.Y, Axis.X) if first is Axis.Y else (Axis.X, Axis.Y)
    wanted = {Axis.X: periods_x, Axis.Y: periods_y}
    return FringePattern(tuple(FringeSet(axis, periods, steps_rad) for axis in order for periods in wanted[axis]))


@dataclass(frozen=True, slots=True, eq=False)
class DisplayLevels:
    """Levels a display may use, and the level it needs for a wanted light.

    minimum, maximum: Levels of the dark and the bright fringe as fractions of the display's range.
    bits: Bit depth of the frames, 8 to 16; above 8 the frames are uint16.
    level_from_light (n,): Level fraction for equally spaced fractions 0..1 of the light (the inverse of the
        display's response), ascending from 0 to 1; without it the display is taken as linear.
    InputError: Levels outside 0..1 or not ascending, an odd bit depth, a table that does not ascend from 0 to 1.
    """

    minimum: float = 0.0
    maximum: float = 1.0
    bits: int = 8
    level_from_light: FloatArray = field(default_factory=lambda: np.array([0.0, 1.0]))

    def __post_init__(self) -> None:
        if not 0 <= self.minimum < self.maximum <= 1:
            raise InputError(
                f"display levels: 0 <= minimum < maximum <= 1 is needed, not {self.minimum}, {self.maximum}"
            )
        if not 8 <= self.bits <= 16:
            raise InputError(f"display levels: a bit depth of 8 to 16 is needed, not {self.bits}")
        table = float_array("level_from_light", self.level_from_light, (None,))
        if table.size < 2 or np.any(np.diff(table) <= 0) or abs(table[0]) > 1e-9 or abs(table[-1] - 1) > 1e-9:
            raise InputError("level_from_light: at least two values ascending from 0 to 1 are needed")
        object.__setattr__(self, "level_from_light", table)


def response_table(camera_dn: npt.ArrayLike, display_level: npt.ArrayLike, n: int = 4097) -> FloatArray:
    """Return the levels that make the camera see a display as linear, from a measured response.

    camera_dn (m,): Readings of the camera, strictly ascending [DN].
    display_level (m,): Levels that gave them, as shares of the display's range, strictly ascending within 0..1.
    n: Number of nodes of the table.
    Returns (n,): Level fraction for equally spaced fractions of the light, for `DisplayLevels.level_from_light`.
    InputError: Fewer than two nodes, values not ascending, or levels outside 0..1.

    Linear between the nodes, as the evaluation takes it: with 33 nodes of a display with exponent 2.2 the light is
    right within 3e-4 of its range. Beyond the first and the last node the outermost segments go on; the caller keeps
    to the levels in between (`DisplayLevels.minimum`, `maximum`).
    """
    reading = float_array("response camera_dn", camera_dn, (None,))
    level = float_array("response display_level", display_level, (reading.size,))
    if reading.size < 2 or np.any(np.diff(reading) <= 0) or np.any(np.diff(level) <= 0):
        raise InputError("response: at least two nodes with camera_dn and display_level strictly ascending are needed")
    if level[0] < -1e-9 or level[-1] > 1 + 1e-9:
        raise InputError(
            f"response: display_level must be a share of the display's range, 0 to 1, not {level[0]:g} to {level[-1]:g}"
        )
    gain = np.diff(reading) / np.diff(level)
    if level[0] > 0:
        reading, level = np.insert(reading, 0, reading[0] - gain[0] * level[0]), np.insert(level, 0, 0.0)
    if level[-1] < 1:
        reading, level = np.append(reading, reading[-1] + gain[-1] * (1 - level[-1])), np.append(level, 1.0)
    table = np.interp(np.linspace(reading[0], reading[-1], n), reading, level)
    table[0], table[-1] = 0.0, 1.0
    return np.asarray(table, dtype=np.float64)


def render_frames(
    pattern: FringePattern, width_px: int, height_px: int, levels: DisplayLevels | None = None
) -> Iterator[npt.NDArray[np.uint8] | npt.NDArray[np.uint16]]:
    """Yield the frames to display, in order.

    width_px, height_px: Size of the displayed image [px].
    levels: Range, bit depth and compensation of the display; full range, 8 bit, linear without it.
    Returns (height_px, width_px): Read-only frames (one line repeated; copy before changing).
    InputError: Size not positive.

    Column c shows u = (c + 0.5) / width and row r shows v = (r + 0.5) / height: the level of a display pixel is the
    sinusoid at its centre. The light the pixel's area sends is then a staircase whose fundamental has that phase
    exactly and a modulation smaller by sinc(periods / width), 0.2 % at 64 periods on 1920 px.
    """
    size = {Axis.X: int(positive("width_px", width_px, "px")), Axis.Y: int(positive("height_px", height_px, "px"))}
    chosen = levels if levels is not None else DisplayLevels()
    light_nodes = np.linspace(0.0, 1.0, chosen.level_from_light.size)
    # minimum and maximum are levels; the sinusoid lives in light, between what those two levels give.
    dark, bright = np.interp([chosen.minimum, chosen.maximum], chosen.level_from_light, light_nodes)
    dtype = np.uint8 if chosen.bits == 8 else np.uint16
    for fringes in pattern.sets:
        position = (np.arange(size[fringes.axis]) + 0.5) / size[fringes.axis]
        for step in fringes.steps_rad:
            wave = 0.5 + 0.5 * np.cos(2 * np.pi * fringes.periods * position - step)
            level = np.interp(dark + (bright - dark) * wave, light_nodes, chosen.level_from_light)
            line = np.rint(level * (2**chosen.bits - 1)).astype(dtype)
            line = line[None, :] if fringes.axis is Axis.X else line[:, None]
            yield np.broadcast_to(line, (size[Axis.Y], size[Axis.X]))
