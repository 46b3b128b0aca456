"""The notebooks and the pages of Python run from top to bottom as a reader would run them, and give what they show."""

import re
from pathlib import Path

import pytest

from heliogauge.instruments import instruments
from tests.kernel import read, run_in_jupyter

NOTEBOOKS = ("beam", "camera", "deflectometry", "heliostat", "observer", "photogrammetry", "screen", "survey")
NUMBER = re.compile(r"[-+]?\d+\.\d+(?:e[-+]?\d+)?")


def printed(cell):
    return "".join(output.get("text", "") for output in cell.outputs if output.get("name") == "stdout")


def kinds(cell):
    """Return what a cell shows: words, tables, pictures."""
    return [sorted(output.get("data", {"text/plain": ""})) for output in cell.outputs]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebook_is_kept_with_its_outputs(repository, name):
    file = repository / "notebooks" / f"{name}.ipynb"
    cells = [cell for cell in read(file).cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    shown = "".join(str(output.get("data", {})) for cell in cells for output in cell.outputs)
    assert "image/png" in shown or "<img" in shown
    assert "Error" not in "".join(output.output_type for cell in cells for output in cell.outputs)
    assert file.stat().st_size < 800_000


def test_there_is_one_notebook_for_each_instrument(repository):
    assert sorted(file.stem for file in (repository / "notebooks").glob("*.ipynb")) == list(NOTEBOOKS)
    assert [one.name for one in instruments()] == list(NOTEBOOKS)


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebook_gives_what_it_shows(repository, tmp_path, name):
    kept = read(repository / "notebooks" / f"{name}.ipynb")
    executed = run_in_jupyter(read(repository / "notebooks" / f"{name}.ipynb"), tmp_path, repository)
    for before, now in zip(kept.cells, executed.cells, strict=True):
        if now.cell_type != "code":
            continue
        assert not [output for output in now.outputs if output.get("name") == "stderr"]
        assert kinds(now) == kinds(before)
        assert NUMBER.sub("", printed(now)) == NUMBER.sub("", printed(before))
        numbers = [[float(number) for number in NUMBER.findall(printed(cell))] for cell in (now, before)]
        assert numbers[0] == pytest.approx(numbers[1], rel=0.02, abs=0.02)


def five_lines():
    text = (Path(__file__).parents[1] / "docs" / "python" / "index.md").read_text(encoding="utf-8")
    part = text[text.index("## Each instrument in five lines") : text.index("## Values of an instrument")]
    return re.findall(r"^\*\*(\w+)\*\*.*?```python\n(.*?)```", part, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize(("instrument", "code"), five_lines())
def test_each_instrument_takes_five_lines(instrument, code):
    """The test of pages runs them."""
    assert len([line for line in code.splitlines() if line and not line.startswith("import")]) <= 5


def test_five_lines_are_there_for_every_instrument_that_draws():
    assert [name for name, _ in five_lines()] == ["Camera", "Photogrammetry", "Deflectometry", "Observer", "Heliostats"]
