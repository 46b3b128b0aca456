"""Progress keeps the time of each stage, whoever listens."""

import io
import sys

import pytest

from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.running.terminal import BarProgress, LineProgress, terminal_progress


def work(progress: Progress) -> None:
    with progress.stage("outer"):
        for _ in range(2):
            with progress.stage("inner", steps=3) as stage:
                stage.advance()
                stage.advance(2)
        progress.say("a remark")


def displays() -> list[SilentProgress]:
    return [SilentProgress(), LineProgress(io.StringIO(), verbose=True), BarProgress(io.StringIO())]


@pytest.mark.parametrize("progress", displays(), ids=lambda progress: type(progress).__name__)
def test_durations_are_summed_in_order_of_first_start(progress: SilentProgress) -> None:
    work(progress)
    assert list(progress.durations_s) == ["outer", "inner"]
    assert 0 < progress.durations_s["inner"] < progress.durations_s["outer"]


@pytest.mark.parametrize("progress", displays(), ids=lambda progress: type(progress).__name__)
def test_a_failing_stage_is_closed_and_timed(progress: SilentProgress) -> None:
    with pytest.raises(ZeroDivisionError), progress.stage("fails", steps=2) as stage:
        stage.advance()
        raise ZeroDivisionError
    assert progress.durations_s["fails"] > 0
    work(progress)
    assert list(progress.durations_s) == ["fails", "outer", "inner"]


def test_lines_say_what_and_how_long() -> None:
    stream = io.StringIO()
    work(LineProgress(stream))
    lines = stream.getvalue().splitlines()
    assert [line.partition(":")[0] for line in lines] == ["inner", "inner", "a remark", "outer"]
    assert lines[0].endswith(" s")


def test_talkative_lines_say_when_a_stage_starts() -> None:
    stream = io.StringIO()
    work(LineProgress(stream, verbose=True))
    assert stream.getvalue().splitlines()[:2] == ["outer ...", "inner (3 steps) ..."]


def test_bars_show_the_stages_and_the_remark() -> None:
    stream = io.StringIO()
    work(BarProgress(stream))
    text = stream.getvalue()
    assert all(word in text for word in ("outer", "inner", "3/3", "a remark"))


def test_choice_of_display(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    assert type(terminal_progress()) is BarProgress
    assert type(terminal_progress(verbose=True)) is LineProgress
    assert type(terminal_progress(quiet=True)) is SilentProgress
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    assert type(terminal_progress()) is LineProgress
