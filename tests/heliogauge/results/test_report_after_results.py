"""Results are in place before their report is made: whatever happens to the report costs the report alone."""

from pathlib import Path

import pytest

import heliogauge.reporting.build
from heliogauge.errors import EstimationError, InputError, ReportWarning
from heliogauge.results.folder import Summary, read_summary
from heliogauge.results.frame import InstrumentResult, into_folder
from heliogauge.running.progress import SilentProgress


class Weighed(InstrumentResult):
    """The smallest result."""

    kind = "scales"

    def summarise(self) -> Summary:
        return self._summary({"mass_count": 3}, {})

    def write_files(self, folder: Path) -> None:
        (folder / "weights.csv").write_text("id\n1\n")

    def headline(self) -> str:
        return "3"


def weigh(out: Path, *, force: bool = False) -> None:
    into_folder(out, lambda: Weighed(name="stone"), SilentProgress(), force=force, report=True)


@pytest.mark.parametrize(
    ("error", "reason"),
    [(InputError("pixels.nc: damaged"), "pixels.nc: damaged"), (ZeroDivisionError("by 0"), "ZeroDivisionError: by 0")],
)
def test_a_report_that_fails_costs_the_report_alone(tmp_path, monkeypatch, error, reason):
    out = tmp_path / "out"
    found: list[bool] = []

    def fail(folder: Path) -> None:
        found.append(folder == out and read_summary(folder).name == "stone")
        raise error

    monkeypatch.setattr(heliogauge.reporting.build, "build_report", fail)
    with pytest.warns(ReportWarning, match="heliogauge report") as said:
        weigh(out)
    assert reason in str(said[0].message)
    assert found == [True]
    assert sorted(path.name for path in out.iterdir()) == ["summary.json", "weights.csv"]


def test_ctrl_c_during_the_report_says_what_is_kept(tmp_path, monkeypatch):
    def stop(folder: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(heliogauge.reporting.build, "build_report", stop)
    with pytest.raises(KeyboardInterrupt, match="complete in"):
        weigh(tmp_path / "out")
    assert read_summary(tmp_path / "out").name == "stone"


def test_work_that_fails_starts_no_report(tmp_path, monkeypatch):
    monkeypatch.setattr(heliogauge.reporting.build, "build_report", lambda folder: pytest.fail("a report of nothing"))

    def fail() -> Weighed:
        raise EstimationError("not determined")

    with pytest.raises(EstimationError):
        into_folder(tmp_path / "out", fail, SilentProgress(), force=False, report=True)
    assert not list(tmp_path.iterdir())


def test_the_command_line_says_it_and_ends_well(tmp_path):
    """Results without a report of their kind: the smallest failure of a report."""
    import subprocess
    import sys

    program = (
        "import sys; from heliogauge.running import cli; from pathlib import Path\n"
        "from tests.heliogauge.results.test_report_after_results import weigh\n"
        "from heliogauge.running.cli import app\n"
        "app.command('weigh')(lambda: weigh(Path(sys.argv[1])))\n"
        "cli.main(['weigh'])"
    )
    command = [sys.executable, "-c", program, tmp_path / "out"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("warning: no report: ")
    assert "'scales'" in lines[0]
    assert f"heliogauge report {tmp_path / 'out'}" in lines[0]
