"""Pages print what the program says: their listings run in their order, and every line is what came out."""

from pathlib import Path

import pytest

from docs import page_listings

DATA = Path(__file__).parents[2] / "shared" / "data"


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
        assert page_listings.unfolded(listing.body) == page_listings.unfolded(now), f"{page}: {listing.body[:100]}"


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
