"""Whatever ends a report ends the report alone: the results are in their place before it starts."""

import os
import signal

import pytest

from heliogauge.results.folder import read_summary


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_report_keeps_the_results(drawn, start, tmp_path, number, code):
    process = start("deflectometry", "measure", drawn, "-o", tmp_path / "result", "-v")
    for line in process.stderr:
        if line.startswith("report"):
            break
    os.killpg(process.pid, number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == code, said
    assert "Traceback" not in said
    if number == signal.SIGINT:
        assert f"heliogauge report {tmp_path / 'result'}" in said
    assert [path.name for path in tmp_path.iterdir()] == ["result"]
    names = {path.name for path in (tmp_path / "result").iterdir()}
    assert {"summary.json", "slope_map.nc"} <= names
    assert not {name for name in names if name.startswith((".", "report"))}
    assert read_summary(tmp_path / "result").kind == "deflectometry"
