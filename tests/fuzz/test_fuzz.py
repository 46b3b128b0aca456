"""A short run of the fuzzer, and what shows that it would notice."""

import os
import random
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.fuzz import running
from tests.fuzz.damage import spoil
from tests.fuzz.running import run_case, run_cases
from tests.fuzz.targets import TARGETS, Target

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="cases are copies of a process")

#: Those that are quick: folders are made in a few seconds, and most cases end within a fraction of one.
_QUICK = ("field", "grey", "normals", "nurbs", "opencsp", "stations")


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
        if self.weight == 6:
            running.time.sleep(len(bytes(range(256)) * (10**7)) * 0)


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
    ],
)
def test_what_goes_wrong_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: int, says: str) -> None:
    """Negative controls."""
    monkeypatch.setattr(running, "HANG_S", 1.0 if kind == 2 else 30.0)
    (tmp_path / "seed").mkdir()
    (tmp_path / "seed" / "a.json").write_text('{"a": 1}')
    place = tmp_path / "place"
    place.mkdir()
    outcome = run_case(place, 0, 0, {"seed": tmp_path / "seed"}, _Wrong("seed", (), kind))
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
