"""One table for several modules."""

import pytest

from heliogauge.errors import InputError
from heliogauge.store import Summary, write_summary
from heliogauge.store_tables import read_table_csv
from observer.pipeline_overview import headline_text, run, write


def result_of(folder, kind="observer", warnings=(), **numbers):
    folder.mkdir()
    write_summary(folder / "summary.json", Summary(
        kind=kind, name=folder.name.upper(), numbers=numbers, texts={}, warnings=warnings, durations_s={},
        input_sha256={}, not_determined={key: "unseen" for key, value in numbers.items() if value is None},
    ))  # fmt: skip
    return folder


def test_a_row_for_each_module(tmp_path):
    first = result_of(tmp_path / "a1", sdx_tilt_removed_rad=3e-3, rms_theta_ra_rad=2.5e-3)
    second = result_of(tmp_path / "a2", warnings=("a doubt",), sdx_tilt_removed_rad=None, edges_used_count=12)
    result = run([first, second])
    (tmp_path / "out").mkdir()
    write(result, tmp_path / "out")
    table = read_table_csv(tmp_path / "out" / "overview.csv", ("result", "name"))
    assert table["name"] == ["A1", "A2"]
    assert [float(table["sdx_tilt_removed_rad"][0]), table["sdx_tilt_removed_rad"][1]] == [3e-3, ""]
    assert table["edges_used_count"] == ["", "12"]
    assert table["warnings"] == ["0", "1"]
    assert "a2: 1 warnings, the first: a doubt" in result.warnings[0]
    assert "SDx 3.00 mrad, theta_ra 2.50 mrad RMS" in headline_text(result)
    assert len(result.input_sha256) == 2


def test_other_results_and_doubled_ones_are_refused(tmp_path):
    first, other = result_of(tmp_path / "a"), result_of(tmp_path / "b", kind="deflectometry")
    with pytest.raises(InputError, match='kind "deflectometry"'):
        run([first, other])
    with pytest.raises(InputError, match="given twice"):
        run([first, tmp_path / "b" / ".." / "a"])
