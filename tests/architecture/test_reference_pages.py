"""The pages that the code writes can be had without building the documentation, and the repository says how."""

from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.slow
def test_pages_are_written_and_the_repository_says_how(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    import reference_pages

    pages = reference_pages.write_reference_pages(tmp_path)
    words = {"keys.md": "sigma_direction_mrad", "commands.md": "--no-report", "doubts.md": "sun_contradicts_points"}
    assert {page.name for page in pages} == set(words)
    for page in pages:
        assert words[page.name] in page.read_text(encoding="utf-8")
        stub = (DOCS / "reference" / page.name).read_text(encoding="utf-8")
        assert "python docs/reference_pages.py" in stub
        assert f"../_build/{page.name}" in stub
