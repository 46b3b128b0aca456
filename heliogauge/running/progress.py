"""How far long work has come: a protocol, so that no numeric code knows of a terminal."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from time import perf_counter
from typing import Protocol


class Stage(Protocol):
    """One named stretch of work that is going on."""

    def advance(self, steps: int = 1) -> None:
        """Say that some more steps are done."""


class Progress(Protocol):
    """Listener of a pipeline: which stage runs, how far it is, how long each one took.

    Examples
    --------
    >>> progress: Progress = SilentProgress()
    >>> with progress.stage("read frames", steps=2) as stage:
    ...     for _ in range(2):
    ...         stage.advance()
    >>> list(progress.durations_s)
    ['read frames']
    """

    @property
    def durations_s(self) -> dict[str, float]:
        """Wall time of each finished stage, in the order in which they first started [s]."""

    def stage(self, name: str, steps: int = 0) -> AbstractContextManager[Stage]:
        """Open a stage; leaving the ``with`` block ends it, also after an error."""

    def say(self, text: str) -> None:
        """Pass on one line for the person who waits."""


class RunningStage:
    """A stage that counts its steps and reports each to its listener.

    listener: Shows the progress.
    name: What is being done.
    steps: Number of steps; 0 where nobody knows.
    """

    __slots__ = ("_listener", "done", "name", "steps")

    def __init__(self, listener: "SilentProgress", name: str, steps: int) -> None:
        self._listener = listener
        self.name = name
        self.steps = steps
        self.done = 0

    def advance(self, steps: int = 1) -> None:
        """Say that some more steps are done."""
        self.done += steps
        self._listener.advanced(self)


class SilentProgress:
    """Progress that shows nothing and only keeps the time; displays override `started`, `advanced` and `finished`.

    A stage that runs several times (once for each facet, say) is one entry with the sum. Stages may nest; the time of
    an inner stage is then part of the outer one's.
    """

    def __init__(self) -> None:
        self._durations_s: dict[str, float] = {}

    @property
    def durations_s(self) -> dict[str, float]:
        """Wall time of each finished stage, in the order in which they first started [s]."""
        return dict(self._durations_s)

    @contextmanager
    def stage(self, name: str, steps: int = 0) -> Iterator[Stage]:
        """Open a stage; leaving the ``with`` block ends it, also after an error."""
        running = RunningStage(self, name, steps)
        self._durations_s.setdefault(name, 0.0)
        start = perf_counter()
        self.started(running)
        try:
            yield running
        finally:
            duration_s = perf_counter() - start
            self._durations_s[name] += duration_s
            self.finished(running, duration_s)

    def say(self, text: str) -> None:
        """Pass on one line for the person who waits."""

    def started(self, stage: RunningStage) -> None:
        """Take note that a stage begins."""

    def advanced(self, stage: RunningStage) -> None:
        """Take note that a stage has come further."""

    def finished(self, stage: RunningStage, duration_s: float) -> None:
        """Take note that a stage ended after some seconds."""
