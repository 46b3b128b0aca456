"""What killed runs leave beside results: only their own is swept, and it is said."""

import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from heliogauge.errors import SweptWarning
from heliogauge.results import left_over
from heliogauge.results.folder import ResultFolder

_KILLED = """
import os, signal, sys
from pathlib import Path
from heliogauge.results.folder import ResultFolder
with ResultFolder(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("x")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def write(out: Path, *, force: bool = False) -> None:
    with ResultFolder(out, force=force) as folder:
        (folder / "summary.json").write_text("{}")


def gone() -> int:
    """Return the number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def hidden(out: Path, process: int, ending: str, host: str | None = None) -> Path:
    path = out.parent / f".{out.name}.{left_over._host() if host is None else host}.{process}.0123abcd.{ending}"
    path.mkdir()
    (path / "summary.json").write_text("earlier")
    return path


@pytest.mark.skipif(os.name == "nt", reason="a process is looked for by signals of POSIX")
class TestSweep:
    def test_next_run_sweeps_what_a_killed_one_left(self, tmp_path: Path, repository: Path) -> None:
        environment = {**os.environ, "PYTHONPATH": str(repository)}
        command = [sys.executable, "-c", _KILLED, str(tmp_path / "out")]
        assert subprocess.run(command, env=environment, check=False).returncode == -signal.SIGKILL
        (left,) = tmp_path.iterdir()
        assert left.name.startswith(".out.")
        with pytest.warns(SweptWarning, match=r"partial: a killed run had left it; it was removed"):
            write(tmp_path / "out")
        assert [path.name for path in tmp_path.iterdir()] == ["out"]

    def test_earlier_results_come_back(self, tmp_path: Path) -> None:
        out = tmp_path / "out"
        hidden(out, gone(), "earlier")
        with pytest.warns(SweptWarning, match=r"earlier results .* are back"):
            left_over.sweep(out)
        assert (out / "summary.json").read_text() == "earlier"

    def test_earlier_results_that_were_replaced_go(self, tmp_path: Path) -> None:
        out = tmp_path / "out"
        write(out)
        hidden(out, gone(), "earlier")
        with pytest.warns(SweptWarning):
            left_over.sweep(out)
        assert (out / "summary.json").read_text() == "{}"
        assert len(list(tmp_path.iterdir())) == 1

    def test_what_belongs_to_others_stays(self, tmp_path: Path) -> None:
        out = tmp_path / "out[1]"
        kept = [
            hidden(out, os.getpid(), "partial"),
            hidden(out, gone(), "partial", host="another"),
            hidden(tmp_path / "out1", gone(), "partial"),
            hidden(tmp_path / "out[1].2", gone(), "partial"),
        ]
        (tmp_path / ".out[1].partial").mkdir()
        link = tmp_path / f".out[1].{left_over._host()}.{gone()}.01234567.partial"
        link.symlink_to(kept[0])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            left_over.sweep(out)
        assert len(list(tmp_path.iterdir())) == len(kept) + 2
