"""Ring codes: published counts and numbers, reading in any rotation, and which way round."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliogauge.errors import InputError
from photogrammetry.targets.coded_targets import (
    RingDictionary,
    aicon_dictionary,
    metashape_dictionary,
    ring_dictionary,
    user_dictionary,
)
from photogrammetry.targets.ring_codes import (
    CODE_INNER_RADIUS,
    CODE_OUTER_RADIUS,
    RingCode,
    Sense,
    ink_at,
    mirrored_word,
)

#: 1001011 is the mirror image of 1101001: the smallest words that are not their own mirror image.
CHIRAL, ITS_MIRROR = 0b1001011, 0b1101001


def sector_centers_rad(n_bits: int) -> np.ndarray:
    return (np.arange(n_bits) + 0.5) * 2 * np.pi / n_bits


def bits(text: str) -> list[bool]:
    return [letter == "1" for letter in text]


@pytest.mark.parametrize(("n_bits", "count"), [(12, 147), (14, 516)])
def test_published_counts_of_schneiders_rule(n_bits: int, count: int) -> None:
    assert len(aicon_dictionary(n_bits)) == count


@pytest.mark.parametrize(("n_bits", "count"), [(12, 161), (14, 561), (16, 2001), (20, 26013)])
def test_published_counts_of_metashape(n_bits: int, count: int) -> None:
    assert len(metashape_dictionary(n_bits)) == count


def test_published_first_numbers() -> None:
    assert aicon_dictionary(12).words[:4] == (65, 71, 75, 77)
    assert metashape_dictionary(12).words[:4] == (71, 75, 77, 83)
    assert aicon_dictionary(12).code(1) == RingCode("1", 65, 12)
    assert metashape_dictionary(12).code("1") == RingCode("1", 71, 12)


def test_the_two_dictionaries_share_codes_under_other_numbers() -> None:
    aicon, metashape = aicon_dictionary(12), metashape_dictionary(12)
    common = set(aicon.words) & set(metashape.words)
    assert len(common) == 146
    assert [w for w in common if aicon.words.index(w) == metashape.words.index(w)] == [147]


@pytest.mark.parametrize("n_bits", [8, 10, 12])
def test_rules_word_by_word(n_bits: int) -> None:
    """The same rules on strings of letters, by trying every word."""
    aicon, metashape = [], []
    for word in range(1, 2**n_bits):
        text = format(word, f"0{n_bits}b")
        if any(text[k:] + text[:k] < text for k in range(n_bits)) or text.count("1") % 2 or "0" not in text:
            continue
        if any(text[k] == text[k - n_bits // 2] == "1" for k in range(n_bits)):
            aicon.append(word)
        if "0" * (n_bits // 2) not in text + text and text.count("1") != 2:
            metashape.append(word)
    assert aicon_dictionary(n_bits).words == tuple(aicon)
    assert metashape_dictionary(n_bits).words == tuple(metashape)


@given(st.integers(0, 146), st.integers(0, 11))
def test_every_rotation_reads_the_same_code(index: int, turn: int) -> None:
    dictionary = aicon_dictionary(12)
    code = dictionary.codes[index]
    read = code.sectors[turn:] + code.sectors[:turn]
    reading = dictionary.read(read)
    assert reading.code == code
    shifted = read[reading.turn_sectors :] + read[: reading.turn_sectors]
    assert shifted == code.sectors
    word = int("".join("01"[bit] for bit in read), 2)
    assert dictionary.lookup([word, 0]).tolist() == [index, -1]


def test_reading_sense_matters() -> None:
    dictionary = aicon_dictionary(12)
    clockwise = bits("000001001011")
    assert dictionary.read(clockwise).code.word == CHIRAL
    assert dictionary.read(clockwise).mirrored.word == ITS_MIRROR
    assert dictionary.read(clockwise[::-1]).code.word == ITS_MIRROR
    assert dictionary.code("1").is_symmetric
    assert not dictionary.read(clockwise).code.is_symmetric
    assert mirrored_word(CHIRAL, 12) == ITS_MIRROR


def test_a_mirror_image_is_told_where_the_dictionary_can() -> None:
    dictionary = aicon_dictionary(12)
    number = dictionary.words.index(CHIRAL) + 1
    only_one = dictionary.subset([number])
    straight, seen_from_behind = only_one.read(bits("001011000001")), only_one.read(bits("110100100000"))
    assert (straight.code.name, straight.mirrored) == (str(number), None)
    assert (seen_from_behind.code, seen_from_behind.mirrored.name) == (None, str(number))


def test_words_counted_from_the_lowest_bit_are_the_mirror_images() -> None:
    """Programs that count the lowest bit first, clockwise: the other sense of the same word."""
    other = RingDictionary("lowest-first", 12, (CHIRAL,), ("75",), Sense.COUNTERCLOCKWISE)
    lowest_first = [bool(CHIRAL >> k & 1) for k in range(12)]
    assert other.read(lowest_first).code.name == "75"
    assert other.read(lowest_first[::-1]).code is None
    turn = other.read(lowest_first).turn_sectors
    assert tuple(lowest_first[turn:] + lowest_first[:turn]) == other.codes[0].sectors


def test_ink_runs_clockwise_from_three_o_clock() -> None:
    """Highest bit first: of 1101 00000000 the sectors 0, 1 and 3 are inked, below the x axis as seen from the front."""
    code = RingCode("a", 0b110100000000, 12)
    angle = sector_centers_rad(12)
    # Clockwise as seen: y up becomes negative.
    inked = ink_at(code, 2.5 * np.cos(angle), -2.5 * np.sin(angle))
    assert inked.tolist() == [True, True, False, True] + [False] * 8
    assert ink_at(code, 2.5, -0.1)
    assert not ink_at(code, 2.5, 0.1)


def test_radii() -> None:
    code = RingCode("all", 0xFFF, 12)
    radius = np.array([0.0, 0.99, 1.01, CODE_INNER_RADIUS - 0.01, 2.01, 2.99, CODE_OUTER_RADIUS + 0.01])
    assert ink_at(code, radius, 0.0).tolist() == [True, True, False, False, True, True, False]


@given(st.integers(1, 4095))
def test_arcs_are_the_inked_sectors(word: int) -> None:
    code = RingCode("x", word, 12)
    middle = sector_centers_rad(12)
    arcs = code.arcs_rad()
    covered = [any(a <= m < b or a <= m + 2 * np.pi < b for a, b in arcs) for m in middle]
    assert tuple(covered) == code.sectors
    ink = np.array(code.sectors)
    assert len(arcs) == max(1, np.count_nonzero(ink & ~np.roll(ink, 1)))


def test_users_list() -> None:
    mine = user_dictionary("panel", 10, [0b1000110000, 7], ["left", "right"])
    assert mine.words == (35, 7)
    assert mine.read(bits("0000100011")).code.name == "left"
    assert user_dictionary("numbers", 8, [17, 23]).names == ("17", "23")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: aicon_dictionary(13), "even number of 8 to 20 bit"),
        (lambda: metashape_dictionary(22), "not 22"),
        (lambda: ring_dictionary("acme-12"), "aicon-N or metashape-N"),
        (lambda: ring_dictionary("aicon"), "aicon-N or metashape-N"),
        (lambda: user_dictionary("a", 12, [3, 6]), "word 3 occurs twice"),
        (lambda: user_dictionary("a", 12, [3, 5], ["x", "x"]), "name 'x' occurs twice"),
        (lambda: user_dictionary("a", 8, [256]), "1 to 255"),
        (lambda: user_dictionary("a", 8, []), "at least one"),
        (lambda: user_dictionary("a", 7, [3]), "8 to 20 bit"),
        (lambda: aicon_dictionary(12).code(148), "holds no code 148; it has 1 to 147"),
        (lambda: aicon_dictionary(12).read([True] * 14), "12 sectors are needed, not 14"),
    ],
)
def test_impossible_dictionaries(make, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


def test_names_of_vendors() -> None:
    assert ring_dictionary("Schneider-12") is aicon_dictionary(12)
    assert ring_dictionary("metashape-16") is metashape_dictionary(16)
