"""The front door: what it answers, how quickly, and how it ends."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import typer

from heliogauge import __version__
from heliogauge.errors import EstimationError
from heliogauge.instruments import Commands, Instrument, every_kind, instruments
from heliogauge.running import cli, commands


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "heliogauge", *arguments], capture_output=True, text=True, check=False, timeout=60
    )


def leave(*arguments: str) -> int:
    """Run the front door in this process; return its exit code."""
    with pytest.raises(SystemExit) as caught:
        cli.main(arguments)
    return int(caught.value.code or 0)


@pytest.fixture(autouse=True)
def _keep_signal_and_environment(monkeypatch: pytest.MonkeyPatch):
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setenv("OPENCV_LOG_LEVEL", os.environ.get("OPENCV_LOG_LEVEL", "SILENT"))
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.fixture
def instrument(monkeypatch: pytest.MonkeyPatch) -> typer.Typer:
    """A package that is mounted as ``probe`` and has the default command and a named one."""
    app = commands.make_app("A probe.")

    @app.command("run")
    def measure(folder: commands.MeasurementFolder, out: commands.OutFolder, jobs: commands.Jobs = 1) -> None:
        if folder.name == "undetermined":
            raise EstimationError("3 targets seen, 4 needed")
        if folder.name == "interrupted":
            raise KeyboardInterrupt
        if folder.name == "bug":
            raise ZeroDivisionError
        print(f"{folder} -> {out} with {jobs}")

    @app.command("import-other")
    def import_other(files: list[Path], folder: Path) -> None:
        print(f"{[str(file) for file in files]} -> {folder}")

    module = ModuleType("probe_cli")
    module.app = app  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "probe_cli", module)
    probe = Instrument("probe", "A probe.", Commands("probe", "probe_cli:app", "A probe."))
    monkeypatch.setattr(cli, "instruments", lambda: (*instruments(), probe))
    return app


def test_version_and_help() -> None:
    assert run("--version").stdout == f"heliogauge {__version__}\n"
    answer = run("--help")
    assert answer.returncode == 0
    for name in (*cli.FIRST, *cli.mounted(), *cli.LAST):
        assert f"\n  {name} " in answer.stdout


@pytest.mark.parametrize("option", ["--version", "--help"])
def test_the_quick_answers_import_next_to_nothing(option: str) -> None:
    """Their time is the time of their imports: 0.1 s with typer alone, above 0.5 s with any of these."""
    program = f"""
import sys
from heliogauge.running import cli
try:
    cli.main([{option!r}])
except SystemExit:
    heavy = {{"numpy", "cv2", "scipy", "pydantic", "rich", "h5py", "xarray", "matplotlib"}} & sys.modules.keys()
    sys.exit(f"imported: {{sorted(heavy)}}" if heavy else 0)
"""
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


def test_unknown_command_suggests_the_near_one() -> None:
    answer = run("deflectomtry")
    assert answer.returncode == 2
    assert "Did you mean 'deflectometry'?" in answer.stderr


def test_init_names_every_kind() -> None:
    text = run("init", "--help").stdout
    assert [kind for kind in every_kind() if kind not in text] == []


def test_init_writes_a_template_and_refuses_to_overwrite(tmp_path: Path) -> None:
    folder = tmp_path / "a b"
    assert run("init", "deflectometry", str(folder)).stdout.strip() == str(folder / "measurement.toml")
    again = run("init", "deflectometry", str(folder))
    assert again.returncode == 2
    assert again.stderr.count("\n") == 1
    assert again.stderr.startswith("heliogauge: ")
    assert "--force" in again.stderr
    assert run("init", "deflectometry", str(folder), "--force").returncode == 0


@pytest.mark.usefixtures("instrument")
class TestMounted:
    def test_default_command_needs_no_name(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "FOLDER", "-o", "OUT") == 0
        assert capsys.readouterr().out == "FOLDER -> OUT with 1\n"

    def test_options_may_come_first(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "--jobs", "2", "-o", "OUT", "FOLDER") == 0
        assert capsys.readouterr().out == "FOLDER -> OUT with 2\n"

    def test_named_command(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "import-other", "a.h5", "b.json", "FOLDER") == 0
        assert capsys.readouterr().out == "['a.h5', 'b.json'] -> FOLDER\n"

    def test_help_of_the_group_lists_both(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "--help") == 0
        text = capsys.readouterr().out
        assert "run" in text
        assert "import-other" in text

    def test_help_of_the_default_command(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "FOLDER", "--help") == 0
        assert "--jobs" in capsys.readouterr().out

    def test_missing_out_is_a_usage_error(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "FOLDER") == 2
        assert "--out" in capsys.readouterr().err

    def test_metrology_error_is_one_message_and_exit_2(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "undetermined", "-o", "OUT") == 2
        assert capsys.readouterr().err == "heliogauge: 3 targets seen, 4 needed\n"

    def test_interrupt_is_130(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "interrupted", "-o", "OUT") == 130
        assert "interrupted" in capsys.readouterr().err

    def test_a_bug_is_not_hidden(self) -> None:
        with pytest.raises(ZeroDivisionError):
            cli.main(["probe", "bug", "-o", "OUT"])


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_unwind_the_stack(number: int) -> None:
    """What stands in a ``finally`` runs: that is what removes a half-written result."""
    program = f"""
import os, signal, sys, time
from types import ModuleType
import typer
# A test run started in the background hands down an ignored SIGINT.
signal.signal(signal.SIGINT, signal.default_int_handler)
from heliogauge.running import cli, commands
app = commands.make_app("A probe.")
@app.command("run")
def measure(folder: str) -> None:
    try:
        os.kill(os.getpid(), {int(number)})
        time.sleep(10)
    finally:
        print("cleaned up", flush=True)
module = ModuleType("probe_cli")
module.app = app
sys.modules["probe_cli"] = module
cli.SYNTH = cli.Commands("synth", "probe_cli:app", "")
cli.main(["synth", "x"])
"""
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=30)
    assert answer.stdout == "cleaned up\n"
    assert answer.returncode == 128 + number
    assert "Traceback" not in answer.stderr
