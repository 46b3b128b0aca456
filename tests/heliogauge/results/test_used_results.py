"""What is made from results that are not to be used says so."""

from pathlib import Path

import pytest

from heliogauge.doubts import Doubt, Severity
from heliogauge.results.folder import Summary, write_summary
from heliogauge.results.used_results import serious_result, serious_results


def _summary(*severities: Severity) -> Summary:
    doubts = tuple(Doubt("a_doubt", f"the camera is wrong ({one})", severity=one) for one in severities)
    return Summary("observer", "trough", {}, {}, doubts, {}, {})


def test_serious_doubts_are_handed_on_with_their_words() -> None:
    found = serious_results({"spring": _summary(Severity.DOUBT), "autumn": _summary(Severity.NOTE, Severity.SERIOUS)})
    assert found is not None
    assert found.severity is Severity.SERIOUS
    assert "so neither is this: autumn: the camera is wrong (serious)" in found.text
    assert found.numbers == {"results_count": 1}
    assert "spring" not in found.text


@pytest.mark.parametrize("severities", [(), (Severity.DOUBT, Severity.NOTE)])
def test_lesser_doubts_are_not(severities: tuple[Severity, ...], tmp_path: Path) -> None:
    assert serious_results({"spring": _summary(*severities)}) is None
    write_summary(tmp_path / "summary.json", _summary(*severities))
    assert serious_result(tmp_path) is None
    assert serious_result(tmp_path / "elsewhere") is None


def test_one_folder(tmp_path: Path) -> None:
    write_summary(tmp_path / "summary.json", _summary(Severity.SERIOUS))
    found = serious_result(tmp_path)
    assert found is not None
    assert f"{tmp_path}: the camera is wrong" in found.text
