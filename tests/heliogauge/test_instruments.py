"""The registry: every instrument is found, what it names exists, and a new one changes no file of the kernel."""

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from heliogauge.errors import InputError
from heliogauge.instruments import Kind, every_kind, instrument_named, instruments, near_match, read_resource, resolve
from heliogauge.measurement.templates import write_template

KINDS = every_kind()


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_what_a_kind_names_exists(kind: Kind) -> None:
    assert f'kind = "{kind.name}"' in read_resource(kind.template)
    texts = {field.name: getattr(kind, field.name) for field in fields(kind)}
    for name in ("model", "load", "run", "options", "run_into", "recognises", "check"):
        if texts[name]:
            assert callable(resolve(texts[name])), f"{name} of {kind.name}"
    assert bool(kind.run) != bool(kind.run_into)


def test_what_an_instrument_names_exists() -> None:
    for one in instruments():
        for file in one.reports.values():
            assert read_resource(file)
        assert bool(one.synth) == bool(one.synth_command)
        for name in filter(None, (one.synth, one.synth_command)):
            assert callable(resolve(name))


def test_unknown_instrument_suggests_the_near_one() -> None:
    with pytest.raises(InputError, match=r"'observr' is not known; did you mean observer\?"):
        instrument_named("observr")


def test_an_incomplete_installation_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without its entry points (a copy of the sources that was never installed) nothing can be measured."""
    monkeypatch.setattr("heliogauge.instruments.instruments", lambda: ())
    with pytest.raises(InputError, match=r"'observer' is not known; .*not installed whole"):
        write_template("observer", tmp_path)


def run_python(program: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program in a folder that comes first on its path, as that of a notebook or script does."""
    (folder / "program.py").write_text(program, encoding="utf-8")
    return subprocess.run(
        [sys.executable, str(folder / "program.py")], capture_output=True, text=True, check=False, cwd=folder
    )


def test_a_new_instrument_needs_no_change_here(tmp_path: Path) -> None:
    """A distribution of someone else's registers an instrument with a kind of its own."""
    folder = tmp_path / "gloss"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "instrument.py").write_text(
        "from heliogauge.instruments import Instrument, Kind\n"
        "KIND = Kind('gloss', 'gloss.keys:Model', 'gloss.keys:load', 'gloss:template.toml', 'gloss measure')\n"
        "GLOSS = Instrument('gloss', 'Gloss of a mirror.', 'gloss.cli:app', (KIND,))\n"
    )
    (folder / "template.toml").write_text('kind = "gloss"\nname = "a"\nangle_deg = 60.0\n')
    (folder / "keys.py").write_text(
        "from typing import Literal\n"
        "from heliogauge.measurement.load import read_measurement\n"
        "from heliogauge.measurement.models import MeasurementModel\n"
        "class Model(MeasurementModel):\n"
        "    kind: Literal['gloss']\n"
        "    angle_deg: float\n"
        "def load(folder):\n"
        "    return read_measurement(folder, Model)[1]\n"
    )
    info = tmp_path / "gloss-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: gloss\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[heliogauge.instruments]\ngloss = gloss.instrument:GLOSS\n")
    program = """
import sys
from heliogauge.measurement.load import load
from heliogauge.measurement.templates import write_template
from heliogauge.running.cli import main
from pathlib import Path
write_template("gloss", Path("m"))
print(load("m").angle_deg)
main(["--help"])
"""
    answer = run_python(program, tmp_path)
    assert answer.stdout.startswith("60.0\n"), answer.stderr
    assert "Gloss of a mirror." in answer.stdout


OWN_FILES = ["observer.py", "calibration.py", "photogrammetry/__init__.py"]
BORDERS = [
    "from heliogauge.measurement.load import load; load('m')",
    "from heliogauge.running.cli import main; main(['observer', 'init', 'm'])",
    "import data_synth.fringes",
    "from heliogauge.instruments import read_resource; read_resource('observer.report:report.ipynb')",
]


@pytest.mark.parametrize("own", OWN_FILES)
@pytest.mark.parametrize("use", BORDERS)
def test_a_file_of_the_users_with_our_name_is_named_and_never_executed(tmp_path: Path, own: str, use: str) -> None:
    file = tmp_path / own
    file.parent.mkdir(exist_ok=True)
    file.write_text("print('executed')\n", encoding="utf-8")
    answer = run_python(use, tmp_path)
    assert answer.returncode
    assert "executed" not in answer.stdout
    last = answer.stderr.strip().splitlines()[-1]
    assert f"{file} has the name of a package of heliogauge" in last
    assert last.endswith("rename it")


def test_a_module_of_the_users_that_is_loaded_already_is_named(tmp_path: Path) -> None:
    (tmp_path / "observer.py").write_text("ANGLE = 3\n", encoding="utf-8")
    answer = run_python("import observer; from heliogauge.measurement.load import load; load('m')", tmp_path)
    assert answer.stderr.strip().endswith("rename it and start Python anew")


def test_a_script_with_our_name_is_named(tmp_path: Path) -> None:
    script = tmp_path / "data_synth.py"
    script.write_text("print('once')\nfrom heliogauge.instruments import resolve\nresolve('data_synth.cli:observer')\n")
    answer = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert answer.stdout == "once\n"
    assert "data_synth.py has the name of a package of heliogauge" in answer.stderr


def test_other_files_of_the_users_do_no_harm(tmp_path: Path) -> None:
    """Negative control: the same program with files of other names, and our names elsewhere than on the path."""
    (tmp_path / "camera.py").write_text("print('executed')\n", encoding="utf-8")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "observer.py").write_text("print('executed')\n", encoding="utf-8")
    answer = run_python("from heliogauge.instruments import instruments; print(len(instruments()))", tmp_path)
    assert answer.stdout == f"{len(instruments())}\n", answer.stderr


def test_a_folder_of_data_with_a_name_of_ours_does_no_harm(tmp_path: Path) -> None:
    for name in ("observer", "calibration"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "photo.txt").write_text("data", encoding="utf-8")
    program = "from heliogauge.instruments import instruments; n = len(instruments()); import observer"
    answer = run_python(program + "; print(n, observer.run)", tmp_path)
    assert answer.stdout.startswith(f"{len(instruments())} <function"), answer.stderr


def test_long_lists_of_names_end_with_their_number() -> None:
    said = near_match("zebra", [f"quantity_{number}" for number in range(230)])
    assert said.endswith("quantity_39 and 190 more")
