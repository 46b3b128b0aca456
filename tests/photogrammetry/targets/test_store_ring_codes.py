"""A user's own ring codes: both formats, sense and radii, and each fault with one clear message."""

from pathlib import Path

import pytest

from heliogauge.errors import InputError
from photogrammetry.targets.ring_codes import RingRadii, Sense
from photogrammetry.targets.store_ring_codes import CodePrint, load_dictionary, read_ring_codes

CSV = """# bits = 12
# sense = counterclockwise
# outer_radius = 2.8
name,word
left,65
right,000001000111
"""
TOML = """
name = "mine"
bits = 12
sense = "counterclockwise"
outer_radius = 2.8
[codes]
left = 65
right = "0b1000111"
"""


def written(folder: Path, text: str, name: str = "codes.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_both_formats_say_the_same(tmp_path: Path) -> None:
    table = read_ring_codes(written(tmp_path, CSV))
    tree = read_ring_codes(written(tmp_path, TOML, "codes.toml"))
    for found in (table, tree):
        assert found.words == (65, 71)
        assert found.names == ("left", "right")
        assert found.sense is Sense.COUNTERCLOCKWISE
        assert found.radii == RingRadii(2.0, 2.8)
    assert (table.name, tree.name) == ("codes", "mine")


def test_words_are_names_if_there_are_none(tmp_path: Path) -> None:
    assert read_ring_codes(written(tmp_path, "# bits = 12\nword\n65\n71\n")).names == ("65", "71")
    assert read_ring_codes(written(tmp_path, "bits = 12\nwords = [65, 71]\n", "a.toml")).names == ("65", "71")


def test_what_is_known_of_the_print_comes_last(tmp_path: Path) -> None:
    written(tmp_path, CSV)
    found = load_dictionary("codes.csv", tmp_path, CodePrint(Sense.CLOCKWISE, inner_radius=1.8))
    assert found.sense is Sense.CLOCKWISE
    assert found.radii == RingRadii(1.8, 2.8)
    assert load_dictionary("aicon-12", tmp_path).sense is Sense.CLOCKWISE


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("word\n65\n", "bits is missing"),
        ("# bits = many\nword\n65\n", "bits = 'many': a number"),
        ("# bits = 12\n# sence = clockwise\nword\n65\n", "unknown key 'sence'; sense is meant"),
        ("# bits = 12\n# sense = left\nword\n65\n", "clockwise or counterclockwise is needed"),
        ("# bits = 12\nnumber\n65\n", "a column word is needed"),
        ("# bits = 12\nword,size\n65,1\n", "unknown column 'size'"),
        ("# bits = 12\nname,word\na\n", "has 1 cells, 2 are needed"),
        ("# bits = 12\nname,word\na,sixty\n", "word 'sixty' of target 'a'"),
        ("# bits = 12\nword\n4096\n", "words of 12 bit are 1 to 4095"),
        ("# bits = 12\nword\n65\n130\n", "word 65 occurs twice"),
        ("# bits = 12\n# inner_radius = 3\nword\n65\n", "radii of the code ring"),
    ],
)
def test_faults_are_named_with_the_file(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=r"codes\.csv") as caught:
        read_ring_codes(path)
    assert message in str(caught.value)


def test_files_that_are_not_there_and_toml_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_dictionary("codes.csv", tmp_path)
    with pytest.raises(InputError, match="not valid TOML"):
        read_ring_codes(written(tmp_path, "bits 12", "a.toml"))
    with pytest.raises(InputError, match="one of both"):
        read_ring_codes(written(tmp_path, "bits = 12\n", "a.toml"))
