"""DESCRIPTION of ring-coded targets: which codes a dictionary holds, how they are numbered, where their ink is."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import freeze
from photogrammetry.targets.ring_codes import (
    FEWEST_BITS,
    MOST_BITS,
    VENDOR_RADII,
    CodeArray,
    RingCode,
    RingRadii,
    Sense,
    all_rotations,
    turned_words,
)


@dataclass(frozen=True, slots=True)
class CodeReading:
    """What a dictionary makes of a cyclic word that was read off an image.

    code: The code if the target is seen as printed.
    mirrored: The code if the image (or the print) is mirrored. Both are there for most words: the vendors' rules do
        not distinguish a code from its mirror image, so whether a whole photo is mirrored is decided by all its targets
        together.
    turn_sectors: How many sectors clockwise the print's first sector lies from the first sector read, if seen as
        printed.
    """

    code: RingCode | None
    mirrored: RingCode | None
    turn_sectors: int


@dataclass(frozen=True, slots=True, eq=False)
class RingDictionary(ShortRepr):
    """The codes that may occur, with a fast look-up of words read in any rotation and sense.

    name: Name of the dictionary: ``aicon-12``, ``metashape-14`` or a user's.
    n_bits: Number of sectors, 8 to 20.
    words: The words; any rotation is taken for the smallest one.
    sense: Sense in which the bits follow each other on the target, highest bit first.
    radii: Where the code rings lie.
    InputError: A number of bits that no target has, no or repeated words or names, or a word too long.

    With 12 bit, Schneider's rule (patent DE 197 33 466 A1; AICON, Scanreference) admits 147 codes, with 14 bit 516.
    The vendor numbers them 1, 2, 3... by increasing word, the highest bit first and clockwise, ink being 1.
    Metashape's (161, 561, 2001 and 26,013 with 12, 14, 16 and 20 bit) are numbered likewise. Of the 12-bit codes 146
    are common, and only one of them has the same number in both: the dictionary must be given. Programs that count
    the *lowest* bit first, clockwise, name a target by the word of its mirror image: `Sense.COUNTERCLOCKWISE` here.
    """

    name: str
    n_bits: int
    words: tuple[int, ...]
    names: tuple[str, ...]
    sense: Sense = Sense.CLOCKWISE
    radii: RingRadii = VENDOR_RADII
    _index: CodeArray = field(init=False, repr=False)
    _by_name: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not FEWEST_BITS <= self.n_bits <= MOST_BITS:
            raise InputError(f"ring codes: {FEWEST_BITS} to {MOST_BITS} bit are needed, not {self.n_bits}")
        given = np.array(self.words, dtype=np.int64)
        if given.size == 0 or len(self.names) != given.size:
            raise InputError(f"dictionary {self.name}: as many names as words are needed, at least one")
        if given.min() <= 0 or given.max() >= 1 << self.n_bits:
            raise InputError(f"dictionary {self.name}: words of {self.n_bits} bit are 1 to {(1 << self.n_bits) - 1}")
        rotations = all_rotations(given.astype(np.int32), self.n_bits)
        smallest = rotations.min(axis=0)
        _refuse_repeated(f"dictionary {self.name}: word", smallest.tolist())
        _refuse_repeated(f"dictionary {self.name}: name", list(self.names))
        index = np.full(1 << self.n_bits, -1, dtype=np.int32)
        index[rotations] = np.arange(given.size, dtype=np.int32)
        object.__setattr__(self, "words", tuple(smallest.tolist()))
        object.__setattr__(self, "names", tuple(str(name) for name in self.names))
        object.__setattr__(self, "sense", Sense(self.sense))
        object.__setattr__(self, "_index", freeze(index))
        object.__setattr__(self, "_by_name", {name: k for k, name in enumerate(self.names)})

    def __len__(self) -> int:
        return len(self.words)

    @property
    def codes(self) -> tuple[RingCode, ...]:
        """All codes in the order of their numbers."""
        return tuple(map(self._code, range(len(self))))

    def code(self, name: str | int) -> RingCode:
        """Return a code by its name.

        name: The vendor's number or the user's name.
        InputError: The dictionary has no such code.
        """
        try:
            return self._code(self._by_name[str(name)])
        except KeyError as error:
            raise InputError(
                f"dictionary {self.name} holds no code {name!r}; it has {self.names[0]} to {self.names[-1]}"
            ) from error

    def subset(self, names: Iterable[str | int]) -> "RingDictionary":
        """Return the dictionary of the codes that were really used; fewer codes admit fewer false ones.

        InputError: The dictionary has no such code, or none is named.
        """
        chosen = [self.code(name) for name in names]
        words, texts = tuple(code.word for code in chosen), tuple(code.name for code in chosen)
        return RingDictionary(self.name, self.n_bits, words, texts, self.sense, self.radii)

    def as_printed(self, sense: Sense | None = None, radii: RingRadii | None = None) -> "RingDictionary":
        """Return the dictionary of prints that count the bits in another sense or have other radii.

        sense: Sense in which the bits follow each other; the dictionary's own if absent.
        radii: Where the code rings lie; the dictionary's own if absent.
        Returns: The same words under the same names.
        """
        kept = self.sense if sense is None else sense
        return RingDictionary(self.name, self.n_bits, self.words, self.names, kept, radii or self.radii)

    @property
    def has_full_ring(self) -> bool:
        """Whether one of the codes is a ring without a gap."""
        return bool(self._index[-1] >= 0)

    def lookup(self, words: npt.ArrayLike) -> CodeArray:
        """Look up many words at once.

        words (...): Words read in the dictionary's own sense, highest bit first, in any rotation.
        Returns (...): Index into `codes`, -1 for a word that is none.
        """
        return np.asarray(self._index[np.asarray(words, dtype=np.int64)])

    def read(self, sectors: Sequence[bool]) -> CodeReading:
        """Read the sectors of a target.

        sectors length n_bits: Ink of the sectors, clockwise in the image, from anywhere.
        Returns: The code, and the code of the mirror image.
        InputError: Another number of sectors.

        >>> reading = aicon_dictionary(12).read([b == "1" for b in "110100100000"])
        >>> reading.code.word, reading.mirrored.word
        (105, 75)
        """
        if len(sectors) != self.n_bits:
            raise InputError(f"dictionary {self.name}: {self.n_bits} sectors are needed, not {len(sectors)}")
        clockwise = int("".join("1" if bit else "0" for bit in sectors), 2)
        backwards = int("".join("1" if bit else "0" for bit in reversed(sectors)), 2)
        if self.sense is Sense.COUNTERCLOCKWISE:
            clockwise, backwards = backwards, clockwise
        found, mirrored = (self._found(word) for word in (clockwise, backwards))
        if found is None:
            return CodeReading(None, mirrored, 0)
        printed = found.sectors
        read = [bool(bit) for bit in sectors]
        turn = next(k for k in range(self.n_bits) if (*read[k:], *read[:k]) == printed)
        return CodeReading(found, mirrored, turn)

    def _code(self, index: int) -> RingCode:
        return RingCode(self.names[index], self.words[index], self.n_bits, self.sense, self.radii)

    def _found(self, word: int) -> RingCode | None:
        index = int(self._index[word])
        return None if index < 0 else self._code(index)


def _refuse_repeated(what: str, values: Sequence[int | str]) -> None:
    seen: set[int | str] = set()
    for value in values:
        if value in seen:
            raise InputError(f"{what} {value!r} occurs twice (words count as equal in every rotation)")
        seen.add(value)


@lru_cache(maxsize=16)
def aicon_dictionary(n_bits: int) -> RingDictionary:
    """Return Schneider's codes as AICON and Scanreference number them.

    n_bits: Number of sectors: even, 8 to 20.
    Returns: Names "1", "2"... by increasing word.
    InputError: Another number of sectors.

    An even number of bits is 1, at least one pair of opposite bits is 1, not all are 1 (C.-T. Schneider 1991; patent
    DE 197 33 466 A1, expired).

    >>> codes = aicon_dictionary(12)
    >>> len(codes), codes.words[:4]
    (147, (65, 71, 75, 77))
    """
    words = _even_necklaces(n_bits)
    half = n_bits // 2
    has_opposite_pair = (words & (words >> half) & ((1 << half) - 1)) > 0
    return _numbered(f"aicon-{n_bits}", n_bits, words[has_opposite_pair])


@lru_cache(maxsize=16)
def metashape_dictionary(n_bits: int) -> RingDictionary:
    """Return Metashape's codes as it numbers them ("target 1"...).

    n_bits: Number of sectors: even, 8 to 20.
    Returns: Names "1", "2"... by increasing word.
    InputError: Another number of sectors.

    An even number of bits is 1, fewer than half of the sectors in a row are 0, and neither the word with two opposite
    bits nor the one with all bits belongs to it.

    >>> codes = metashape_dictionary(14)
    >>> len(codes), metashape_dictionary(12).words[:4]
    (561, (71, 75, 77, 83))
    """
    words = _even_necklaces(n_bits)
    # The smallest rotation has its longest run of zeros in front: half or more zeros leave only the lower half.
    half = n_bits // 2
    allowed = (words >= 1 << half) & (words != (1 << half) + 1)
    return _numbered(f"metashape-{n_bits}", n_bits, words[allowed])


def ring_dictionary(name: str) -> RingDictionary:
    """Return a vendor's dictionary by its name.

    name: ``aicon-N``, ``schneider-N`` (the same) or ``metashape-N``, N the number of bits: even, 8 to 20.
    InputError: No such dictionary.
    """
    makers = {"aicon": aicon_dictionary, "schneider": aicon_dictionary, "metashape": metashape_dictionary}
    vendor, _, bits = name.lower().partition("-")
    if vendor not in makers or not bits.isdecimal():
        raise InputError(f"target dictionary {name!r}: aicon-N or metashape-N is needed (N bits), e.g. aicon-12")
    return makers[vendor](int(bits))


def user_dictionary(name: str, n_bits: int, words: Sequence[int], names: Sequence[str] | None = None) -> RingDictionary:
    """Make a dictionary of a user's own words.

    n_bits: Number of sectors, 8 to 20.
    words: The words, highest bit first, clockwise, in any rotation.
    names: The codes' names; the words as they are given, if absent.
    InputError: Words that are equal but for rotation, too long, or none.
    """
    given = tuple(int(word) for word in words)
    return RingDictionary(name, n_bits, given, tuple(names) if names is not None else tuple(map(str, given)))


def _even_necklaces(n_bits: int) -> CodeArray:
    """Return the words with an even number of ones, not all ones, smallest of their rotations, in increasing order."""
    if n_bits % 2 or not FEWEST_BITS <= n_bits <= MOST_BITS:
        raise InputError(
            f"ring codes: an even number of {FEWEST_BITS} to {MOST_BITS} bit is needed, not {n_bits}; "
            "the vendors' rules speak of opposite sectors"
        )
    words = np.arange(1, (1 << n_bits) - 1, dtype=np.int32)
    words = words[np.bitwise_count(words) % 2 == 0]
    smallest = words.copy()
    for rotation in range(1, n_bits):
        np.minimum(smallest, turned_words(words, rotation, n_bits), out=smallest)
    return np.asarray(words[words == smallest], dtype=np.int32)


def _numbered(name: str, n_bits: int, words: CodeArray) -> RingDictionary:
    return RingDictionary(
        name, n_bits, tuple(words.tolist()), tuple(str(number) for number in range(1, words.size + 1))
    )
