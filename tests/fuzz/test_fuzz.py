"""A short run of the fuzzer, and what shows that it would notice."""

import json
import os
import random
from collections.abc import Mapping
from pathlib import Path

import pytest

from heliogauge.instruments import every_kind
from tests.fuzz import running
from tests.fuzz.command_tree import Command, commands
from tests.fuzz.damage import spoil
from tests.fuzz.headlines import silent_changes
from tests.fuzz.running import run_case, run_cases
from tests.fuzz.targets import KINDS, TARGETS, Target

forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="cases are copies of a process")

#: Those that are quick: folders are made in a few seconds, and most cases end within a fraction of one.
_QUICK = ("field", "grey", "normals", "nurbs", "opencsp", "stations")


def test_every_command_that_reads_is_tried() -> None:
    tried = [one.words for one in TARGETS if one.words]
    missing = [
        name
        for name, command in commands().items()
        if command.reads and not any(words[: len(command.words)] == command.words for words in tried)
    ]
    assert not missing, f"tests/fuzz/targets.py has no folder for {missing}"
    # Those that were not tried in earlier days, and what reads nothing.
    assert {"beam compare", "heliostat test drift", "heliostat sheet", "survey report"} <= set(commands())
    assert [
        name for name, one in commands().items() if not one.reads and name.split()[-1] not in {"init", "synth"}
    ] == [
        "demo",
        "deflectometry patterns",
        "photogrammetry sheets",
    ]


def test_every_kind_of_measurement_is_tried() -> None:
    assert set(KINDS) == set(every_kind())
    for kind, (seed, _, _) in KINDS.items():
        words = tuple(every_kind()[kind].command.split())
        assert any(one.seed == seed and one.words and one.words[: len(words)] == words for one in TARGETS), kind


def test_a_command_must_be_given_what_it_needs() -> None:
    options = (("--out", "-o"), ("--jobs",), ("--to",))
    copy = Command(("copy",), ("what", "where"), options, (options[0], options[2]))
    assert copy.call(("--to", "x")) == ("copy", "{in}", "{in}", "--to", "x", "--out", "{out}", "--jobs", "1")
    assert copy.call(("{in}", "-o", "{in}/y", "--to", "x")) == (
        *("copy", "{in}", "-o", "{in}/y", "--to", "x", "--jobs", "1"),
    )
    with pytest.raises(ValueError, match="copy: --to must be given"):
        copy.call(("{in}",))


def _summary(folder: Path, sdx: float | None, codes: tuple[str, ...] = (), name: str = "facet") -> Path:
    folder.mkdir(exist_ok=True)
    doubts = [{"code": code, "severity": "doubt"} for code in codes]
    numbers = {"sdx_rad": sdx, "sigma_sdx_rad": 3e-6, "area_m2": sdx}
    (folder / "summary.json").write_text(json.dumps({"name": name, "numbers": numbers, "doubts": doubts}))
    return folder


def test_numbers_that_change_without_a_word_are_noticed(tmp_path: Path) -> None:
    before = _summary(tmp_path / "before", 1e-3, ("rough",))
    changed = silent_changes(before, _summary(tmp_path / "a", 1.013e-3, ("rough",)))
    assert changed == ["sdx_rad 0.001 -> 0.001013 (sigma 4.2e-06)"]
    assert not silent_changes(before, _summary(tmp_path / "b", 1.012e-3, ("rough",)))
    assert not silent_changes(before, _summary(tmp_path / "c", 2e-3, ("rough", "rough")))
    assert not silent_changes(before, _summary(tmp_path / "d", 2e-3, ("rough",), "another"))
    assert not silent_changes(before, _summary(tmp_path / "e", None, ("rough",)))
    assert not silent_changes(before, tmp_path)


@forks
@pytest.mark.slow
def test_damaged_files_end_in_one_message(tmp_path: Path) -> None:
    targets = tuple(
        one
        for one in TARGETS
        if one.seeds() <= set(_QUICK) and (one.words is None or one.words[0] == "check" or "import" in one.words)
    )
    faults = [str(one) for one in run_cases(tmp_path, range(40), 20, targets) if one.fault]
    assert not faults, "\n".join(faults)


class _Wrong(Target):
    def run(self, folder: Path, out: Path, undamaged: Mapping[str, Path]) -> None:
        if self.weight == 1:
            raise KeyError("nobody foresaw it")
        if self.weight == 2:
            running.time.sleep(60)
        if self.weight == 3:
            raise SystemExit(1)
        if self.weight == 4:
            out.with_name(".left").mkdir()
        if self.weight == 5:
            os.kill(os.getpid(), 9)
        if self.weight == 8:
            _summary(out, 2e-3)
            raise SystemExit(0)
        if self.weight == 6:
            running.time.sleep(len(bytes(range(256)) * (10**7)) * 0)


@forks
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "says"),
    [
        (1, "KeyError: 'nobody foresaw it'"),
        (2, "hangs: more than 1 s"),
        (3, "exit code 1"),
        (4, "left behind: .left"),
        (5, "killed by signal 9"),
        (6, "took more than 2 GB"),
        (7, ""),
        (8, "silently different: sdx_rad 0.001 -> 0.002"),
    ],
)
def test_what_goes_wrong_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: int, says: str) -> None:
    """Negative controls."""
    monkeypatch.setattr(running, "HANG_S", 1.0 if kind == 2 else 30.0)
    (tmp_path / "seed").mkdir()
    (tmp_path / "seed" / "a.json").write_text('{"a": 1}')
    place = tmp_path / "place"
    place.mkdir()
    before = _summary(tmp_path / "before", 1e-3)
    outcome = run_case(place, 0, 0, {"seed": tmp_path / "seed"}, _Wrong("seed", (), kind), before)
    assert says in outcome.fault
    assert bool(outcome.fault) is bool(says)


def test_damage_is_the_same_for_the_same_seed(tmp_path: Path) -> None:
    contents = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "m.toml").write_text("a = 1\nb = [1, 2]\n")
        (folder / "t.csv").write_text("x,y\n1,2\n3,4\n")
        said = [spoil(folder, random.Random(number)) for number in (3, 5)]
        contents.append((said, [path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()]))
    assert contents[0] == contents[1]
