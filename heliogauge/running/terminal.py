"""What the person at the terminal sees while work goes on: bars on a terminal, plain lines in a log."""

import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING, TextIO

from heliogauge.running.progress import RunningStage, SilentProgress

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID


class LineProgress(SilentProgress):
    """One plain line for each finished stage; right for logs, pipes and continuous integration.

    stream: Where the lines go.
    verbose: Also say when a stage starts.
    """

    def __init__(self, stream: TextIO, *, verbose: bool = False) -> None:
        super().__init__()
        self._stream = stream
        self._verbose = verbose

    def say(self, text: str) -> None:
        """Write the line."""
        print(text, file=self._stream, flush=True)

    def started(self, stage: RunningStage) -> None:
        """Say what begins, if asked to be talkative."""
        if self._verbose:
            steps = f" ({stage.steps} steps)" if stage.steps else ""
            self.say(f"{stage.name}{steps} ...")

    def finished(self, stage: RunningStage, duration_s: float) -> None:
        """Say how long it took."""
        self.say(f"{stage.name}: {duration_s:.2f} s")


class BarProgress(SilentProgress):
    """Bars that grow on a terminal, drawn by rich; each stage stays as a line when it is done."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self._stream = stream
        self._bars: RichProgress | None = None
        self._tasks: dict[int, TaskID] = {}
        self._display = ExitStack()

    def say(self, text: str) -> None:
        """Write the line above the bars."""
        if self._bars is None:
            print(text, file=self._stream, flush=True)
        else:
            self._bars.console.print(text, markup=False, highlight=False)

    def started(self, stage: RunningStage) -> None:
        """Add a bar; the first one opens the display."""
        if self._bars is None:
            self._bars = self._open()
        self._tasks[id(stage)] = self._bars.add_task(stage.name, total=stage.steps or None)

    def advanced(self, stage: RunningStage) -> None:
        """Let the bar grow."""
        if self._bars is not None:
            self._bars.update(self._tasks[id(stage)], completed=stage.done)

    def finished(self, stage: RunningStage, duration_s: float) -> None:
        """Fill the bar; the last one closes the display, so that an error message starts on a fresh line."""
        task = self._tasks.pop(id(stage))
        if self._bars is not None:
            total = max(stage.steps, 1)
            # A stage that failed half-way keeps its half bar: the reader sees where it stopped.
            done = total if sys.exc_info()[0] is None else stage.done
            self._bars.update(task, total=total, completed=done)
        if not self._tasks:
            self._display.close()
            self._bars = None

    def _open(self) -> "RichProgress":
        # rich.progress costs 0.1 s of import: only who looks at a terminal pays for it.
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description:<28}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        return self._display.enter_context(Progress(*columns, console=Console(file=self._stream)))


def terminal_progress(*, quiet: bool = False, verbose: bool = False) -> SilentProgress:
    """Choose how to show progress on standard error.

    verbose: Plain lines with the start of each stage, also on a terminal.
    Returns: Silent, bars on a terminal, plain lines otherwise.
    """
    if quiet:
        return SilentProgress()
    if sys.stderr.isatty() and not verbose:
        return BarProgress(sys.stderr)
    return LineProgress(sys.stderr, verbose=verbose)
