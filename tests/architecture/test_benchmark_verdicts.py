"""What a benchmark prints beside a number follows from the number and the bounds that it prints."""

import ast
import importlib
import re
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch) -> object:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    yield importlib.import_module("_heliostats")
    for name in ("_heliostats", "_measure"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(("measured", "verdict"), [(3.9, "DIFFERS"), (4.1, "holds"), (4.4, "holds"), (4.6, "DIFFERS")])
def test_a_number_outside_what_is_asked_differs(
    measured: float, verdict: str, lines: object, capsys: pytest.CaptureFixture[str]
) -> None:
    lines.within("a ratio", 4.1, 4.5, measured, " (median 3.5)")  # type: ignore[attr-defined]
    said = capsys.readouterr().out.split("  ")
    assert said[-1].strip() == verdict
    assert "4.1 to 4.5" in [one.strip() for one in said]
    lines.below("a ratio", 4.5, measured)  # type: ignore[attr-defined]
    assert capsys.readouterr().out.split()[-1] == ("holds" if measured < 4.5 else "DIFFERS")


def test_rows_of_published_ratios_and_beams_have_computed_verdicts() -> None:
    """No row of V-9 and V-11 is judged by a bound that is not printed."""
    tree = ast.parse((BENCHMARKS / "heliostat_published_beams.py").read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    by_hand = [ast.unparse(call) for call in calls if getattr(call.func, "id", "") == "line"]
    assert by_hand
    assert not [call for call in by_hand if re.search(r"V-(9|11) ", call)]
