"""What is made from results that are not to be used says so."""

from dataclasses import replace
from pathlib import Path

import pytest

from heliogauge.doubts import Doubt, Severity
from heliogauge.results.folder import Summary, write_summary
from heliogauge.results.used_results import doubted_results, serious_result, serious_results, shared_files


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


def test_lesser_doubts_are_handed_on_in_one_where_asked() -> None:
    used = {"spring": _summary(Severity.DOUBT, Severity.DOUBT, Severity.NOTE), "autumn": _summary(Severity.SERIOUS)}
    found = doubted_results(used)
    assert [one.code for one in found] == ["used_results_serious", "used_results_doubtful"]
    assert found[1].severity is Severity.DOUBT
    assert "spring: the camera is wrong (doubt) (and 1 more)" in found[1].text
    assert "autumn" not in found[1].text
    assert doubted_results({"spring": _summary(Severity.NOTE)}) == ()


def _read(**files: str) -> Summary:
    return replace(_summary(), input_sha256=files)


def test_results_that_share_files_say_which() -> None:
    first = _read(a="1", b="2", c="3", d="4", e="5")
    assert shared_files(first, _read(a="6")) is None
    same = shared_files(first, _read(b="1", c="2", d="3", e="4", f="5"))
    assert same is not None
    assert (same.code, same.severity) == ("same_measurement_twice", Severity.DOUBT)
    some = shared_files(first, _read(a="1", b="2", c="3", d="4", e="7"), "; do this")
    assert some is not None
    assert (some.code, some.severity, some.numbers) == ("inputs_shared", Severity.NOTE, {"files_count": 4})
    assert "both results read a, b, c and 1 more: " in some.text
    assert some.text.endswith("upper bounds; do this")
