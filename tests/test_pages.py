"""Pages print what the program says: their listings run in their order, and every line is what came out."""

import re
from itertools import zip_longest
from pathlib import Path

import pytest

from docs import page_listings

DATA = Path(__file__).parents[2] / "shared" / "data"


NUMBER = re.compile(r"\d+(?:\.\d+)?")


def differences(printed: str, now: str) -> list[str]:
    """Return the lines that differ: in words, or in a number by more than one of its last printed digit."""
    found = []
    for before, after in zip_longest(page_listings.unfolded(printed), page_listings.unfolded(now), fillvalue=""):
        same = NUMBER.sub("", before) == NUMBER.sub("", after)
        for one, other in zip(NUMBER.findall(before), NUMBER.findall(after), strict=False):
            last = 10.0 ** -max(len(text.partition(".")[2]) for text in (one, other))
            same = same and (one == other or ("." in one and abs(float(one) - float(other)) < 1.5 * last))
        if not same:
            found.append(f"printed: {before}\nnow:     {after}")
    return found


def test_digits_and_words_that_differ_are_found() -> None:
    assert not differences("SDx 0.474 ± 0.017 mrad, 34 images", "SDx 0.475 ± 0.017 mrad, 34 images")
    assert differences("SDx 0.474 ± 0.017 mrad", "SDx 0.476 ± 0.017 mrad")
    assert differences("34 images", "35 images")
    assert differences("34 images", "34 images\nwarning: x")
    assert differences("one word", "another word")


@pytest.mark.slow
@pytest.mark.parametrize("page", list(page_listings.PUBLIC))
def test_a_page_prints_what_the_program_says(page: str, tmp_path: Path) -> None:
    if page_listings.PUBLIC[page] and not DATA.is_dir():
        pytest.skip("real measurements (../shared/data beside the source tree) are not on this machine")
    text = (page_listings.DOCS.parent / page).read_text(encoding="utf-8")
    page_listings.prepare(page, DATA, tmp_path)
    shown = list(page_listings.printed(page, text, tmp_path))
    assert shown
    for listing, now in shown:
        assert not differences(listing.body, now), f"{page}: python docs/page_listings.py {page} --data DATA"


def test_every_tutorial_is_run() -> None:
    tutorials = {f"docs/tutorials/{file.name}" for file in (page_listings.DOCS / "tutorials").glob("*.md")}
    assert tutorials - {"docs/tutorials/index.md"} <= set(page_listings.PUBLIC)


def test_blocks_of_a_page_are_found_with_what_stands_before_them() -> None:
    text = (
        "Words.\n\n<!-- file: a/measurement.toml -->\n```toml\nname = 1\n```\n\n"
        "```console\n$ one \\\n    --two\nsaid\n```\n\n"
        "1. A step:\n\n   ```console\n   $ three\n   ```\n\n<!-- not run -->\n```sh\nfour\n```\n"
    )
    toml, console, indented, left = page_listings.listings(text)
    assert (toml.kind, toml.file, toml.body) == ("toml", "a/measurement.toml", "name = 1\n")
    assert page_listings.commands(console) == ["one \\\n    --two"]
    assert page_listings.commands(indented) == ["three"]
    assert not left.runs


def test_a_folded_line_is_the_line_again() -> None:
    line = "  files            .png files are linear (265 : 1, from 36 sizes of targets and 0 edges in 3 photos)"
    assert max(map(len, page_listings.folded(line, 50).splitlines())) <= 50
    assert page_listings.unfolded(page_listings.folded(line, 50)) == page_listings.unfolded(line)
