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
from heliogauge.errors import EstimationError, InputError
from heliogauge.instruments import Instrument, Kind, every_kind, instruments
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
    """An instrument that is mounted as ``probe`` with two verbs."""
    app = commands.make_app("A probe.")

    @app.command("measure")
    def measure(folder: commands.MeasurementFolder, out: commands.OutFolder, jobs: commands.Jobs = 1) -> None:
        """Measure with the probe, and say it in a sentence that is much longer than a terminal is wide: to the end."""
        if folder.name == "undetermined":
            raise EstimationError("3 targets seen, 4 needed")
        if folder.name == "used":
            raise InputError("used: holds files already; choose another folder or give force=True to replace results")
        if folder.name == "interrupted":
            raise KeyboardInterrupt
        if folder.name == "bug":
            raise ZeroDivisionError
        print(f"{folder} -> {out} with {jobs}")

    @commands.add_formats(app, "import").command("other")
    def import_other(files: list[Path], out: commands.OutMeasurement) -> None:
        print(f"{[str(file) for file in files]} -> {out}")

    module = ModuleType("probe_cli")
    module.app = app  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "probe_cli", module)
    probe = Instrument("probe", "A probe.", "probe_cli:app")
    monkeypatch.setattr(cli, "instruments", lambda: (*instruments(), probe))
    return app


def test_version_and_help() -> None:
    assert run("--version").stdout == f"heliogauge {__version__}\n"
    answer = run("--help")
    assert answer.returncode == 0
    for name in (*(one.name for one in instruments()), "measure", "report", "demo"):
        assert f"\n  {name} " in answer.stdout
    assert run("-h").stdout == answer.stdout


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


@pytest.mark.parametrize("kind", every_kind().values(), ids=every_kind())
def test_init_writes_the_template_of_every_kind(kind: Kind, tmp_path: Path) -> None:
    assert leave(*kind.init_command(str(tmp_path / "m")).split()) == 0
    assert f'kind = "{kind.name}"' in (tmp_path / "m" / "measurement.toml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_init_refuses_to_overwrite(tmp_path: Path) -> None:
    folder = tmp_path / "a b"
    assert run("deflectometry", "init", str(folder)).stdout.strip() == str(folder / "measurement.toml")
    again = run("deflectometry", "init", str(folder))
    assert again.returncode == 2
    assert again.stderr.count("\n") == 1
    assert again.stderr.startswith("heliogauge: ")
    assert "--force" in again.stderr
    assert run("deflectometry", "init", str(folder), "--force").returncode == 0


@pytest.mark.usefixtures("instrument")
class TestMounted:
    def test_verb(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "measure", "FOLDER", "-o", "OUT") == 0
        assert capsys.readouterr().out == "FOLDER -> OUT with 1\n"

    def test_options_may_come_first(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "measure", "--jobs", "2", "-o", "OUT", "FOLDER") == 0
        assert capsys.readouterr().out == "FOLDER -> OUT with 2\n"

    def test_format(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "import", "other", "a.h5", "b.json", "-o", "FOLDER") == 0
        assert capsys.readouterr().out == "['a.h5', 'b.json'] -> FOLDER\n"

    def test_a_folder_without_a_verb_is_a_usage_error(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "FOLDER", "-o", "OUT") == 2
        assert "FOLDER" in capsys.readouterr().err

    @pytest.mark.parametrize("option", ["-h", "--help"])
    def test_help_of_the_group_lists_the_verbs(self, capsys: pytest.CaptureFixture[str], option: str) -> None:
        assert leave("probe", option) == 0
        text = " ".join(capsys.readouterr().out.split())
        assert "much longer than a terminal is wide: to the end." in text
        assert text.index(" measure Measure with the probe") < text.index(" import Files of another program")

    def test_missing_out_is_a_usage_error(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "measure", "FOLDER") == 2
        assert "--out" in capsys.readouterr().err

    def test_metrology_error_is_one_message_and_exit_2(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "measure", "undetermined", "-o", "OUT") == 2
        assert capsys.readouterr().err == "heliogauge: 3 targets seen, 4 needed\n"

    def test_arguments_in_messages_are_named_as_options(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "measure", "used", "-o", "OUT") == 2
        assert "choose another folder or give --force to replace results\n" in capsys.readouterr().err

    def test_interrupt_is_130(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert leave("probe", "measure", "interrupted", "-o", "OUT") == 130
        assert "interrupted" in capsys.readouterr().err

    def test_a_bug_is_not_hidden(self) -> None:
        with pytest.raises(ZeroDivisionError):
            cli.main(["probe", "measure", "bug", "-o", "OUT"])


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_unwind_the_stack(number: int) -> None:
    """What stands in a ``finally`` runs: that is what removes a half-written result."""
    program = f"""
import os, signal, sys, time
from types import ModuleType
import typer
# A test run started in the background hands down an ignored SIGINT.
signal.signal(signal.SIGINT, signal.default_int_handler)
from heliogauge.instruments import Instrument
from heliogauge.running import cli, commands
app = commands.make_app("A probe.")
@app.command("measure")
def measure(folder: str) -> None:
    try:
        os.kill(os.getpid(), {int(number)})
        time.sleep(10)
    finally:
        print("cleaned up", flush=True)
module = ModuleType("probe_cli")
module.app = app
sys.modules["probe_cli"] = module
cli.instruments = lambda: (Instrument("probe", "A probe.", "probe_cli:app"),)
cli.main(["probe", "measure", "x"])
"""
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=30)
    assert answer.stdout == "cleaned up\n"
    assert answer.returncode == 128 + number
    assert "Traceback" not in answer.stderr


def test_a_console_that_cannot_show_a_sign_gets_a_stand_in(tmp_path: Path) -> None:
    folder = tmp_path / "50 µrad → facet"
    done = subprocess.run(
        [sys.executable, "-m", "heliogauge", "deflectometry", "init", str(folder)],
        env=os.environ | {"PYTHONIOENCODING": "ascii:strict"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "50 \\xb5rad \\u2192 facet" in done.stdout
