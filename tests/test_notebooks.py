"""The notebooks run from top to bottom, as a reader would run them."""

import pytest

from tests.kernel import read, run_in_jupyter


@pytest.mark.slow
@pytest.mark.parametrize("name", ["deflectometry_tour"])
def test_notebook_runs(repository, tmp_path, name):
    notebook = read(repository / "notebooks" / f"{name}.ipynb")
    assert not any(cell.get("outputs") for cell in notebook.cells), "commit notebooks without their outputs"
    executed = run_in_jupyter(notebook, tmp_path, repository)
    cells = [cell for cell in executed.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    complaints = [output.text for cell in cells for output in cell.outputs if output.get("name") == "stderr"]
    assert not complaints
    shown = "".join(output.get("data", {}).get("text/html", "") for cell in cells for output in cell.outputs)
    assert shown.count("<img") == 4  # the frames, slope error in x and y, the spot
