"""Ctrl-C and termination while the report runs: one line, the right exit code, nothing left behind."""

import os
import signal
import time

import pytest


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupted_report_leaves_nothing(drawn, start, tmp_path, number, code):
    """nbclient's own handling of the signals ended in a traceback and exit 1."""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    process = start("deflectometry", drawn, "-o", tmp_path / "result", "-v", env_extra={"TMPDIR": str(scratch)})
    for line in process.stderr:
        if line.startswith("report"):
            break
    # The kernel writes its history of input once it runs: nbclient would have taken over the signals by then.
    while not list(scratch.glob("heliogauge-report-*/profile_default")):
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.02)
    os.killpg(process.pid, number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == code, said
    assert "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["scratch"]
    assert not list(scratch.glob("heliogauge-report-*"))
