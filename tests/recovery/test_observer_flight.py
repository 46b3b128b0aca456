"""One flight over two rows through the command line: each row as if it were alone, and one that is not there."""

import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.troughs.dataset import read_trough_truth
from heliogauge.results.folder import read_summary
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.results.tables import read_table_csv
from heliogauge.running.cli import app

#: A row that measurement.toml names, but beside which no target of the list stands.
_ABSENT = '\n[[module]]\nname = "absent"\nplace_m = [0.0, 20.0, 0.0]\n'


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flight")
    scene, results = folder / "scene", folder / "results"
    runner = CliRunner()
    drawn = runner.invoke(
        app, ["observer", "synth", str(scene), "--preset", "flight", "--shaped", "--scale", "0.8", "--quiet"]
    )
    assert drawn.exit_code == 0, drawn.output
    with (scene / "measurement.toml").open("a") as file:
        file.write(_ABSENT)
    done = runner.invoke(app, ["observer", "measure", str(scene), "-o", str(results), "--no-report", "--quiet"])
    assert done.exit_code == 0, done.output
    return scene, results


@pytest.mark.slow
def test_each_row_is_within_its_sigma(flown):
    scene, results = flown
    for name in ("row-1", "row-2"):
        truth = read_trough_truth(scene / "truth" / name)
        found = read_slope_map(results / name / "slope_map.nc")
        columns, rows = (
            np.abs(here[:, None] - there).argmin(axis=1)
            for here, there in ((found.x_m, truth.x_m), (found.y_m, truth.y_m))
        )
        error = found.slope_error_x - truth.slope_error_x[np.ix_(rows, columns)]
        known = found.valid & np.isfinite(error)
        assert known.mean() > 0.4
        assert error[known].std() < 0.5e-3
        absorber = read_summary(results / name).numbers
        off = float(absorber["absorber_mean_z_offset_m"] or 0.0) - (-4e-3 if name == "row-2" else 0.0)
        assert abs(off) < 4 * float(absorber["sigma_absorber_mean_z_offset_m"] or 0.0)


@pytest.mark.slow
def test_a_row_that_is_not_there_is_told_beside_the_others(flown):
    _, results = flown
    table = read_table_csv(results / "overview.csv")
    assert table["result"] == ["row-1", "row-2", "absent"]
    assert table["failed"][:2] == ["", ""]
    assert "0 targets of the list are beside it" in table["failed"][2]
    assert not (results / "absent").exists()
    assert any(one.text.startswith("absent: not measured") for one in read_summary(results).doubts)
