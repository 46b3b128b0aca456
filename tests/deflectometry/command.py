"""Measurement folders through the command line: what a user sees of it."""

from pathlib import Path

import pytest

from heliogauge.running import cli


def refusal(folder: Path, capsys: pytest.CaptureFixture[str], *options: str) -> str:
    """Return the message with which ``deflectometry measure`` refuses a folder, and check that it leaves nothing."""
    out = folder.parent / f"{folder.name}-result"
    with pytest.raises(SystemExit) as ended:
        cli.main(["deflectometry", "measure", str(folder), "-o", str(out), "--no-report", "-q", *options])
    assert ended.value.code == 2
    assert not out.exists()
    return " ".join(capsys.readouterr().err.split())
