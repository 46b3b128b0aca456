"""The grammar of the command line: every command is there, has its options, and shows its whole help at every width."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import typer

import heliogauge as hg
from data_synth import cli as synth
from data_synth.fringes.presets import PRESETS as FRINGE_PRESETS
from data_synth.heliostats.presets import PRESETS as HELIOSTAT_PRESETS
from data_synth.targets import boards
from data_synth.targets import presets as targets
from data_synth.troughs.presets import TROUGH_PRESETS
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.instruments import instruments
from heliogauge.results.tables import write_camera_json
from heliogauge.running.cli import app, main
from tests.conftest import REPOSITORY

FOR_ALL = ["measure", "check", "report", "demo", "view"]
COMMANDS = FOR_ALL + [
    "camera init",
    "camera synth",
    "camera measure",
    "camera plan",
    "camera import opencv",
    "camera export opencv",
    "camera export colmap",
    "camera compare",
    "screen init",
    "screen measure",
    "photogrammetry init",
    "photogrammetry synth",
    "photogrammetry measure",
    "photogrammetry plan",
    "photogrammetry targets",
    "photogrammetry import colmap",
    "photogrammetry export colmap",
    "photogrammetry export soltrace",
    "photogrammetry export ply",
    "photogrammetry export csv",
    "photogrammetry sheets",
    "deflectometry init",
    "deflectometry synth",
    "deflectometry measure",
    "deflectometry plan",
    "deflectometry compare",
    "deflectometry screen geometry",
    "deflectometry import opencsp",
    "deflectometry import soltrace",
    "deflectometry import slopes",
    "deflectometry import surface",
    "deflectometry export soltrace",
    "deflectometry export ply",
    "deflectometry export csv",
    "deflectometry patterns",
    "observer init",
    "observer synth",
    "observer measure",
    "observer plan",
    "observer export soltrace",
    "observer export ply",
    "observer export csv",
    "observer align",
    "observer compare",
    "observer overview",
    "observer absorber",
    "beam init",
    "beam synth",
    "beam measure",
    "beam compare",
    "beam plan",
    "heliostat init",
    "heliostat synth",
    "heliostat measure",
    "heliostat plan",
    "heliostat aim",
    "heliostat curves",
    "heliostat export controllers",
    "heliostat export artist",
    "heliostat export table",
    "heliostat test all",
    "heliostat test day",
    "heliostat test drift",
    "heliostat test backlash",
    "heliostat test repeat",
    "heliostat test wind",
    "heliostat test sun-camera",
    "heliostat test reflectance",
    "heliostat test quality",
    "heliostat test control",
    "heliostat test power",
    "heliostat test given",
    "heliostat test year",
    "heliostat sheet",
    "survey add",
    "survey event",
    "survey report",
    "survey check",
    "survey remove",
]


def command(words: str) -> tuple[Any, Any]:
    """Return a command and the context in which it runs."""
    one: Any = typer.main.get_command(app)
    context = one.make_context("heliogauge", ["measure"], resilient_parsing=True)
    for word in words.split():
        one = one.get_command(context, word)
        assert one is not None, f"heliogauge {words}: there is no {word}"
        context = one.make_context(word, [], parent=context, resilient_parsing=True)
    return one, context


def options(words: str) -> dict[str, Any]:
    """Return the parameters of a command by each of their spellings."""
    return {spelling: one for one in command(words)[0].params for spelling in one.opts}


def leaves(one: Any, words: str = "") -> list[str]:
    if not hasattr(one, "list_commands"):
        return [words]
    context = one.make_context("heliogauge", ["x"], resilient_parsing=True)
    names = one.list_commands(context)
    return [leaf for name in names for leaf in leaves(one.get_command(context, name), f"{words} {name}".strip())]


def test_these_are_all_commands() -> None:
    assert sorted(leaves(typer.main.get_command(app))) == sorted(COMMANDS)


def widths() -> list[int]:
    return [60, 80, 120, 200]


@pytest.mark.parametrize("words", ["", *[one.name for one in instruments()], *COMMANDS])
def test_help_is_whole_at_every_width(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    texts = []
    for width in widths():
        monkeypatch.setenv("COLUMNS", str(width))
        one, context = command(words)
        text = one.get_help(context)
        assert max(len(line) for line in text.splitlines()) <= width
        assert "..." not in re.sub(r"\S+\.\.\.", "", text)
        assert "\u2026" not in text
        assert "-h, --help" in text
        # Folded lines apart, every width says the same.
        texts.append(re.sub(r"\s", "", text))
    assert len(set(texts)) == 1


def test_help_uses_the_width_of_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    one, context = command("deflectometry import opencsp")
    assert 170 < max(len(line) for line in one.get_help(context).splitlines()) <= 200


@pytest.mark.parametrize("words", [words for words in COMMANDS if words not in ("check", "view", "survey check")])
def test_what_writes_has_the_options_of_all_that_write(words: str) -> None:
    known = options(words)
    verb = words.split()[-1] if words in FOR_ALL else words.split()[1]
    # A note is one line; there is no more to say of it.
    wanted = {"--quiet", "-q"} if words == "survey event" else {"--quiet", "-q", "--verbose", "-v"}
    # What is done to a store that is there replaces no folder.
    if words not in ("report", "survey event", "survey remove"):
        wanted |= {"--force"}
        wanted |= {"-o", "--out"} if verb not in ("init", "synth") else {"folder"}
    if verb == "measure":
        wanted |= {"--no-report", "--jobs", "--json"}
    assert wanted <= known.keys()


#: Why the last words of a command have no numbers to print: what they write is a file for people or programs.
WITHOUT_NUMBERS = {
    "init": "a template",
    "synth": "a measurement, whose truth is truth.json",
    "import": "a measurement",
    "export": "files of another program",
    "patterns": "frames to display",
    "sheets": "pages to print",
    "report": "a page of results that are there",
    "view": "a page of results that are there",
    "demo": "several results, each with its own summary.json",
}


@pytest.mark.parametrize("words", COMMANDS)
def test_what_has_numbers_prints_them_as_json(words: str) -> None:
    """Every leaf of the tree of commands: with a result it has --json, and without one a reason."""
    verb = words if words in FOR_ALL else words.split()[1]
    has_reason = verb in WITHOUT_NUMBERS and not words.startswith("survey ")
    assert ("--json" in options(words)) != has_reason


@pytest.mark.parametrize("instrument", [one.name for one in instruments()])
def test_commands_for_all_instruments_are_named_where_one_has_none(
    instrument: str, capsys: pytest.CaptureFixture[str]
) -> None:
    own = {words.split()[1] for words in COMMANDS if words.startswith(f"{instrument} ")}
    for name in {"check", "report", "view"} - own:
        with pytest.raises(SystemExit) as ended:
            main([instrument, name, "FOLDER"])
        assert ended.value.code == 2
        assert f"heliogauge {name} FOLDER" in capsys.readouterr().err


def test_report_of_a_measurement_says_what_open_says(tmp_path: Path) -> None:
    for content, said in (("", "a measurement, not results"), (None, "no results, for there is no summary.json")):
        folder = tmp_path / said[:5].strip()
        folder.mkdir()
        if content is not None:
            (folder / "measurement.toml").write_text(content)
        for look in (hg.open, hg.report):
            with pytest.raises(InputError, match=said):
                look(folder)


def test_found_things_are_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def found(*words: str) -> dict[str, Any]:
        with pytest.raises(SystemExit):
            main(list(words))
        content: dict[str, Any] = json.loads(capsys.readouterr().out)
        return content

    (tmp_path / "measurement.toml").write_text('kind = "beam"\nname = "one"\n')
    checked = found("check", str(tmp_path), "--json", "-q")
    assert checked["kind"] == "beam"
    assert checked["faults"]
    lens = BrownDistortion(direction=DistortionDirection.IDEAL_TO_MEASURED)
    for name, focal_px in (("a.json", 2000.0), ("b.json", 2001.0)):
        camera = Camera(1600, 1200, focal_px, focal_px, 799.5, 599.5, 0.0, lens, np.zeros((10, 10)))
        write_camera_json(tmp_path / name, camera)
    both = (str(tmp_path / "a.json"), str(tmp_path / "b.json"))
    compared = found("camera", "compare", *both, "-o", str(tmp_path / "out"), "--json")
    assert compared["numbers"] == json.loads((tmp_path / "out" / "summary.json").read_text())["numbers"]
    # 1 px in 2000 px at the corner, (800, 600) px from the middle: 1000 / 2000 / (1 + 1/4) / 2000 rad at most.
    largest = compared["numbers"]["compared_angle_with_rotation_largest_rad"]
    assert largest == pytest.approx(0.5 / 1.25 / 2000, rel=0.02)
    assert compared["not_determined"]["compared_chance_share"] == "neither calibration has a covariance"
    assert found("camera", "compare", *both, "--json")["numbers"] == compared["numbers"]


@pytest.mark.parametrize(
    ("words", "option", "choices"),
    [
        ("deflectometry synth", "--preset", FRINGE_PRESETS),
        ("photogrammetry synth", "--preset", targets._PRESETS),
        ("camera synth", "--preset", boards._BOARDS),
        ("observer synth", "--preset", TROUGH_PRESETS),
        ("heliostat synth", "--preset", HELIOSTAT_PRESETS),
        ("heliostat measure", "--split", ["random", "chronological", "azimuth-reversed", "high-variance", "column"]),
        ("heliostat measure", "--label", ["UTIS", "HeliOS"]),
        ("deflectometry measure", "--remove", ["nothing", "tilt", "focus", "quadratic"]),
        ("photogrammetry sheets", "--paper", ["A4", "A3", "letter"]),
    ],
)
def test_closed_sets_are_choices_in_the_help(words: str, option: str, choices: Any) -> None:
    one, context = command(words)
    text = "".join(one.get_help(context).split())
    (known,) = re.findall(rf"{option}<?\[?([\w|-]*)", text)
    assert set(choices) <= set(known.split("|"))


def test_presets_that_are_choices_are_all_that_there_are() -> None:
    assert get_args(synth.FringePreset) == (
        *FRINGE_PRESETS,
        "tower",
        "laser-scan",
        "line-sweep",
        "gazing",
        "gazing-close",
        "stars",
        "overlay",
        "screen-dots",
        "screen-rims",
        "surface-scan",
    )
    assert get_args(synth.TargetPreset) == tuple(targets._PRESETS)
    assert get_args(synth.BoardPreset) == boards._BOARDS
    assert get_args(synth.TroughPreset) == tuple(TROUGH_PRESETS)
    assert get_args(synth.HeliostatPreset) == (*HELIOSTAT_PRESETS, "tests")


def completed(*words: str, program: str = "heliogauge") -> list[str]:
    """Ask the shell's completion what could follow."""
    line = " ".join([program, *words])
    answer = subprocess.run(
        [sys.executable, "-m", "heliogauge"],
        env=os.environ
        | {
            "_HELIOGAUGE_COMPLETE": "complete_bash",
            "COMP_WORDS": line,
            "COMP_CWORD": str(len(words)),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    return answer.stdout.split()


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["defl"], ["deflectometry"]),
        (["observer", "al"], ["align"]),
        (["photogrammetry", "import", "c"], ["colmap"]),
        (["deflectometry", "synth", "--preset", "off"], ["off-axis", "off-axis-20"]),
    ],
)
def test_the_shell_completes(words: list[str], wanted: list[str]) -> None:
    assert completed(*words) == wanted


def documented() -> list[tuple[str, str]]:
    """Return the command lines in README, docs and notebooks, each with its file."""
    found = []
    for file in [REPOSITORY / "README.md", *REPOSITORY.glob("docs/*/*.md"), *REPOSITORY.glob("docs/*.md")]:
        text = file.read_text(encoding="utf-8")
        name = str(file.relative_to(REPOSITORY))
        for block in re.findall(r"^ *```(?:text|console|bash|sh|shell)?\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL):
            whole = re.sub(r"\\\n\s*", " ", block)
            found += [(name, line) for line in re.findall(r"^ *(?:\$ )?(heliogauge .*)$", whole, re.MULTILINE)]
        found += [(name, line) for line in re.findall(r"`(heliogauge [^`]*)`", " ".join(text.split()))]
    return sorted(set(found))


@pytest.mark.parametrize(("file", "line"), documented(), ids=lambda text: text if "heliogauge " in text else "")
def test_every_documented_command_line_parses(file: str, line: str) -> None:
    # What stands far right of a command in a listing says what it makes.
    words = shlex.split(re.split(r"\s{3,}|\s+#", line)[0].replace("...", " "), comments=True)[1:]
    one: Any = typer.main.get_command(app)
    context = one.make_context("heliogauge", words[:1] or ["-h"], resilient_parsing=True)
    while words and hasattr(one, "get_command"):
        if words[0] in ("INSTRUMENT", "VERB") or words[0].startswith("-"):
            return
        name = words.pop(0)
        one = one.get_command(context, name)
        assert one is not None, f"{file}: {line}: there is no {name}"
        context = one.make_context(name, [], parent=context, resilient_parsing=True)
    known = {spelling for parameter in one.params for spelling in [*parameter.opts, *parameter.secondary_opts]}
    given = [word for word in words if re.fullmatch(r"-[a-zA-Z]|--[a-z-]+", word)]
    assert set(given) <= known | {"-h", "--help"}, f"{file}: {line}"


def test_documented_command_lines_are_found() -> None:
    assert len(documented()) > 50


def test_json_is_the_summary_and_nothing_else(tmp_path: Path) -> None:
    folder, out = str(tmp_path / "plant"), str(tmp_path / "out")
    words = [sys.executable, "-m", "heliogauge"]
    subprocess.run([*words, "heliostat", "synth", folder, "-q"], check=True)
    answer = subprocess.run(
        [*words, "measure", folder, "-o", out, "--json", "--no-report", "--jobs", "1"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(answer.stdout) == json.loads(Path(out, "summary.json").read_text(encoding="utf-8"))
