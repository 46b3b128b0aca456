"""DESCRIPTION of one ring-coded target: word, sectors, radii, where its ink is."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr

#: Radii in units of the dot's radius, as the vendors draw them: gap from the dot to here, code ring from here to the
#: outer radius. Sheets that people print have others: 2.25 to 3.48, 1.9 to 3.1, 2.6 to 4.4 are in use.
CODE_INNER_RADIUS = 2.0
CODE_OUTER_RADIUS = 3.0
#: Limits within which rings are known from the dot and from what is beside them, in radii of the dot.
LEAST_INNER_RADIUS, LARGEST_OUTER_RADIUS, LEAST_RING_WIDTH = 1.4, 6.0, 0.4

FEWEST_BITS = 8
MOST_BITS = 20

CodeArray = npt.NDArray[np.int32]


class Polarity(StrEnum):
    """Which of ink and ground is bright: bits that are 1 and the dot have the ink's brightness."""

    BLACK_ON_WHITE = "black-on-white"
    WHITE_ON_BLACK = "white-on-black"


class Sense(StrEnum):
    """Sense in which a word's bits follow each other on the target as seen from the front, highest bit first."""

    CLOCKWISE = "clockwise"
    COUNTERCLOCKWISE = "counterclockwise"


@dataclass(frozen=True, slots=True)
class RingRadii:
    """Where the code ring lies, in radii of the dot.

    inner: Radius at which the gap ends and the ring begins.
    outer: Radius at which the ring ends.
    InputError: The gap or the ring is too narrow to be seen, or the ring lies far out.
    """

    inner: float = CODE_INNER_RADIUS
    outer: float = CODE_OUTER_RADIUS

    def __post_init__(self) -> None:
        width = self.outer - self.inner
        if self.inner < LEAST_INNER_RADIUS or self.outer > LARGEST_OUTER_RADIUS or width < LEAST_RING_WIDTH - 1e-9:
            raise InputError(
                f"radii of the code ring, in radii of the dot: inner of at least {LEAST_INNER_RADIUS:g}, outer of at "
                f"least inner + {LEAST_RING_WIDTH:g}, at most {LARGEST_OUTER_RADIUS:g}, are needed, "
                f"not {self.inner:g} and {self.outer:g}"
            )

    @property
    def quiet(self) -> float:
        """Radius of the quiet zone of the ground's colour, one radius of the dot wide."""
        return self.outer + 1


#: As the vendors draw them.
VENDOR_RADII = RingRadii()


def turned_words(words: CodeArray, rotation: int, n_bits: int) -> CodeArray:
    """Return words rotated to the left, highest bit first."""
    return np.asarray(((words << rotation) & ((1 << n_bits) - 1)) | (words >> (n_bits - rotation)), dtype=np.int32)


def all_rotations(words: CodeArray, n_bits: int) -> CodeArray:
    """Return all rotations to the left, shape (n_bits, n)."""
    return np.stack([turned_words(words, rotation, n_bits) for rotation in range(n_bits)])


def smallest_rotation(word: int, n_bits: int) -> int:
    """Return the smallest number among the rotations of a cyclic word of `n_bits` bits: it names the word.

    Examples
    --------
    >>> smallest_rotation(0b100001000000, 12)
    33
    """
    return int(all_rotations(np.array([word], dtype=np.int32), n_bits).min())


def mirrored_word(word: int, n_bits: int) -> int:
    """Return what the mirror image of a target reads; the word itself if the target is its own mirror image.

    Examples
    --------
    >>> mirrored_word(0b1001011, 12), mirrored_word(0b1000001, 12)
    (105, 65)
    """
    return smallest_rotation(int(format(word, f"0{n_bits}b")[::-1], 2), n_bits)


@dataclass(frozen=True, slots=True)
class RingCode(ShortRepr):
    """One ring code.

    name: What is printed beside the target and names the point: the vendor's number, or a user's own text.
    word: The bits as a number, smallest of all rotations.
    n_bits: Number of sectors.
    sense: Sense in which the bits follow each other on the target.
    radii: Where the ring lies.
    """

    name: str
    word: int
    n_bits: int
    sense: Sense = Sense.CLOCKWISE
    radii: RingRadii = VENDOR_RADII

    @property
    def sectors(self) -> tuple[bool, ...]:
        """Ink of the sectors, clockwise as seen from the front, the first one from 3 o'clock to 3 + 12/n o'clock."""
        bits = tuple(bool(self.word >> (self.n_bits - 1 - k) & 1) for k in range(self.n_bits))
        return bits if self.sense is Sense.CLOCKWISE else bits[::-1]

    @property
    def is_symmetric(self) -> bool:
        """Whether the target is its own mirror image: its print does not show from which side it is seen."""
        return mirrored_word(self.word, self.n_bits) == self.word

    def arcs_rad(self) -> tuple[tuple[float, float], ...]:
        """Return start and end of each inked arc of the code ring, neighbouring sectors joined.

        Returns: Angles clockwise from 3 o'clock as seen from the front; the end is larger than the start and may
            exceed 2 pi; one full turn if all sectors are inked [rad].
        """
        ink, n = self.sectors, self.n_bits
        step = 2 * np.pi / n
        if all(ink):
            return ((0.0, 2 * np.pi),)
        arcs = []
        for start in (k for k in range(n) if ink[k] and not ink[k - 1]):
            length = next(m for m in range(1, n) if not ink[(start + m) % n])
            arcs.append((start * step, (start + length) * step))
        return tuple(arcs)


def ink_at(code: RingCode, x: npt.ArrayLike, y: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Return where a target is inked.

    x, y (...): Points of the target's plane as seen from the front, x right and y up, in units of the dot's radius.
    Returns (...): True in the dot and in the inked sectors.
    """
    across, up = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    radius = np.hypot(across, up)
    clockwise = np.arctan2(-up, across) % (2 * np.pi)
    sector = np.minimum((clockwise * (code.n_bits / (2 * np.pi))).astype(np.int64), code.n_bits - 1)
    in_ring = (radius >= code.radii.inner) & (radius <= code.radii.outer)
    return np.asarray((radius <= 1) | (in_ring & np.array(code.sectors)[sector]))
