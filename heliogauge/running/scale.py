"""The same work for many things, each independent: in this process, in several, or on an existing Dask cluster.

One thing that cannot be measured does not stop the others: its failure is an outcome like any other. Only a few tasks
are under way at a time, so memory does not grow with their number. Dask is imported only where a scheduler is named.
"""

import gc
import multiprocessing
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain, islice
from logging import CRITICAL, getLogger
from time import monotonic, sleep
from typing import Any, Generic, TypeVar

from heliogauge import __version__
from heliogauge.errors import FailurePicture, InputError, MetrologyError
from heliogauge.running.environment import environment
from heliogauge.working_folder import paths_without_working_folder

_ContextT = TypeVar("_ContextT")
_TaskT = TypeVar("_TaskT")
_ResultT = TypeVar("_ResultT")

#: Tasks under way for each worker: enough that none waits for the next one, few enough that memory stays flat.
_AHEAD = 4
#: Threads of a worker's own linear algebra would fight over the cores that other workers have.
_OF_WORKERS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# Python would look for modules in the working folder first, for its own ones, too.
_OF_WORKERS["PYTHONSAFEPATH"] = "1"
_CONNECT_S = 10
#: So long the first worker of a cluster that was just started may take to come [s].
_WORKERS_S = 30.0
#: So long a scheduler that went away may take to come back with workers, looked for so often.
_AWAY_S, _AGAIN_S = 300.0, 1.0
#: The same work may be lost so many times in a row before somebody must look why.
_MOST_LOSSES = 3


@dataclass(frozen=True, slots=True)
class Workers:
    """Who does the work.

    jobs: Processes on this machine; None for as many as it has processors, 1 for none but this one.
    scheduler: Address of a Dask scheduler, ``tcp://host:port``; then `jobs` does not count.
    """

    jobs: int | None = None
    scheduler: str | None = None

    def processes(self, n_tasks: int, *, worth: int = 1) -> int:
        """Return the number of local processes that some tasks are worth; each is started for ``worth`` of them."""
        return max(1, min(self.jobs or usable_processors(), n_tasks // worth))


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a task has no result.

    reason: What the person who reads it can do something about.
    trace: Where it happened, if it was not foreseen; empty for impossible data and for undetermined answers.
    kind: What the error itself calls its kind (its attribute ``kind``); empty where it does not.
    pictures: What shows why.
    """

    reason: str
    trace: str = ""
    kind: str = ""
    pictures: tuple[FailurePicture, ...] = ()


@dataclass(frozen=True, slots=True)
class Done(Generic[_TaskT, _ResultT]):
    """A task and what came of it.

    outcome: The result.
    """

    task: _TaskT
    outcome: _ResultT | Failure


def usable_processors() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_each(
    function: Callable[[_ContextT, _TaskT], _ResultT],
    context: _ContextT,
    tasks: Iterable[_TaskT],
    *,
    workers: Workers,
    processes: int = 1,
) -> Iterator[Done[_TaskT, _ResultT]]:
    """Run a function on each of many tasks, in any order.

    function: Takes the context and a task; a function of a module, since other processes must find it.
    context: What all tasks share; sent to each worker once.
    tasks: The tasks; taken only as they are needed.
    workers: Who works: a cluster if it names a scheduler.
    processes: Processes on this machine otherwise (`Workers.processes`); 1 works in this one.
    Returns: Each task with its result or its failure, as they come.
    InputError: No such scheduler, no workers there, workers with another version, or Dask is not installed.
    """
    if workers.scheduler is not None:
        yield from _on_cluster(function, context, tasks, workers.scheduler)
    elif processes > 1:
        yield from _in_processes(function, context, tasks, processes)
    else:
        for task in tasks:
            yield Done(task, _attempt(function, context, task))


def _attempt(function: Callable[[_ContextT, _TaskT], _ResultT], context: _ContextT, task: _TaskT) -> _ResultT | Failure:
    try:
        return function(context, task)
    except MetrologyError as error:
        return Failure(str(error), kind=str(getattr(error, "kind", "")), pictures=error.pictures)
    except Exception as error:  # a bug on one of ten thousand must not cost the others
        return Failure(f"unexpected {type(error).__name__}: {error}", traceback.format_exc())


# --- processes of this machine ----------------------------------------------------------------------------------------

_shared: dict[str, Any] = {}


def _begin_worker(function: Callable[..., Any], context: Any) -> None:
    # Ctrl-C reaches the whole group of processes; the parent alone decides what becomes of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _shared.update(function=function, context=context)
    # What was imported stays: looking for cycles among it is a twelfth of the work on a heliostat.
    gc.freeze()


def _work(task: Any) -> Any:
    return _attempt(_shared["function"], _shared["context"], task)


@contextmanager
def _main_unseen() -> Iterator[None]:
    """Start processes that run neither the caller's script again nor what lies in the working folder."""
    main = sys.modules["__main__"]
    names: tuple[str, ...] = ("__file__", "__spec__")
    hidden = {name: main.__dict__[name] for name in names if name in main.__dict__}
    main.__dict__.pop("__file__", None)
    main.__spec__ = None
    paths = list(sys.path)
    sys.path[:] = paths_without_working_folder()
    try:
        yield
    finally:
        sys.path[:] = paths
        main.__dict__.update(hidden)


@contextmanager
def _pool(function: Callable[..., Any], context: Any, processes: int) -> Iterator[ProcessPoolExecutor]:
    # Spawned, not forked: a fork copies whatever threads and locks the parent has.
    pool = ProcessPoolExecutor(
        processes, multiprocessing.get_context("spawn"), initializer=_begin_worker, initargs=(function, context)
    )
    finished = False
    try:
        yield pool
        finished = True
    finally:
        # After Ctrl-C what runs ends by itself within one task; nobody waits for what was not begun.
        pool.shutdown(wait=finished, cancel_futures=True)


def _in_processes(
    function: Callable[[_ContextT, _TaskT], _ResultT], context: _ContextT, tasks: Iterable[_TaskT], processes: int
) -> Iterator[Done[_TaskT, _ResultT]]:
    waiting = iter(tasks)
    with environment(_OF_WORKERS):
        while True:
            running: dict[Future[Any], Any] = {}
            # Taken, but not with a process yet: a pool that breaks at this moment does not take it.
            taken: list[_TaskT] = []
            try:
                with _pool(function, context, processes) as pool:
                    with _main_unseen():
                        for task in islice(waiting, _AHEAD * processes):
                            taken.append(task)
                            future = pool.submit(_work, task)
                            running[future] = taken.pop()
                    while running:
                        for ended in wait(running, return_when=FIRST_COMPLETED).done:
                            outcome = ended.result()
                            yield Done(running.pop(ended), outcome)
                            for task in islice(waiting, 1):
                                taken.append(task)
                                future = pool.submit(_work, task)
                                running[future] = taken.pop()
                return
            except BrokenProcessPool:
                waiting = chain(taken, waiting)
                # Killed from outside, most often for want of memory: find out by which task, one at a time.
                yield from _one_by_one(function, context, list(running.values()))


def _one_by_one(
    function: Callable[[_ContextT, _TaskT], _ResultT], context: _ContextT, suspects: list[_TaskT]
) -> Iterator[Done[_TaskT, _ResultT]]:
    for task in suspects:
        try:
            with _pool(function, context, 1) as pool:
                with _main_unseen():
                    future = pool.submit(_work, task)
                outcome = future.result()
        except BrokenProcessPool:
            outcome = Failure("the process that worked on it was killed twice; is there enough memory?")
        yield Done(task, outcome)


# --- a cluster --------------------------------------------------------------------------------------------------------


def _version_there() -> str:
    return __version__


def _client(address: str, patience_s: float = 0.0) -> Any:
    """Connect to a scheduler, and go on trying for a while if there is none."""
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(f"scheduler={address}: Dask is not installed; pip install 'heliogauge[cluster]'") from error
    end = monotonic() + patience_s
    while True:
        try:
            return Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            if monotonic() < end:
                sleep(_AGAIN_S)
                continue
            gone = f" for {patience_s:.0f} s" if patience_s else ""
            raise InputError(
                f"scheduler={address}: no scheduler answers there{gone} ({str(error)[:120]}); is the address as it "
                "printed it?"
            ) from error
        except (TypeError, RuntimeError) as error:
            raise InputError(
                f"scheduler={address}: Dask does not connect ({str(error)[:120]}); look at what its configuration says "
                "of distributed.comm.tls and require-encryption"
            ) from error


def _check_workers(client: Any, address: str, patience_s: float) -> int:
    """Return how many tasks the workers can do at a time; wait a while for the first of them."""
    end = monotonic() + patience_s
    while not (threads := dict(client.nthreads())):
        if monotonic() > end:
            raise InputError(f"scheduler={address}: the cluster has no workers; start some")
        sleep(_AGAIN_S)
    # As values: a cluster tells of a missing package in errors of several types.
    versions: Mapping[str, str | Exception] = client.run(_version_there, on_error="return")
    faults = [version for version in versions.values() if isinstance(version, Exception)]
    if (lost := next((fault for fault in faults if isinstance(fault, OSError)), None)) is not None:
        raise lost
    if faults:
        raise InputError(
            f"scheduler={address}: {len(faults)} of {len(versions)} workers cannot import heliogauge "
            f"({str(faults[0])[:120]}); install heliogauge {__version__} there"
        )
    others = {str(version) for version in versions.values()} - {__version__}
    if others:
        raise InputError(
            f"scheduler={address}: workers have heliogauge {', '.join(sorted(others))}, here is {__version__}; "
            "results of two versions must not be mixed"
        )
    return sum(threads.values())


class _LostError(Exception):
    """The scheduler went away, or was started anew and knows nothing of the tasks that it had."""


def _on_cluster(
    function: Callable[[_ContextT, _TaskT], _ResultT], context: _ContextT, tasks: Iterable[_TaskT], address: str
) -> Iterator[Done[_TaskT, _ResultT]]:
    """Work on a cluster; what was under way when the scheduler went away is sent again when it is back."""
    waiting, patience_s, losses = iter(tasks), 0.0, 0
    while True:
        under_way: dict[Any, _TaskT] = {}
        try:
            for done in _with_scheduler(function, context, waiting, address, patience_s, under_way):
                losses = 0
                yield done
            return
        except _LostError as error:
            losses += 1
            if losses > _MOST_LOSSES:
                raise InputError(
                    f"scheduler={address}: the cluster lost the same work {losses} times ({error}); look at its logs"
                ) from None
            waiting, patience_s = chain(list(under_way.values()), waiting), _AWAY_S


def _with_scheduler(
    function: Callable[[_ContextT, _TaskT], _ResultT],
    context: _ContextT,
    waiting: Iterator[_TaskT],
    address: str,
    patience_s: float,
    under_way: dict[Any, _TaskT],
) -> Iterator[Done[_TaskT, _ResultT]]:
    """Work as long as one scheduler lives.

    under_way: Receives the tasks that are sent, and loses those that are done.
    _LostError: The scheduler does not know them any more.
    """
    client = _client(address, patience_s)
    # It would write a traceback for a scheduler that goes away, which is waited for here.
    log = getLogger("distributed.client")
    level = log.level
    log.setLevel(CRITICAL)
    try:
        from distributed import as_completed

        with _lost_connection():
            threads = _check_workers(client, address, max(patience_s, _WORKERS_S))
            shared = client.scatter(context, broadcast=True)

        def submit(task: _TaskT) -> Any:
            with _lost_connection():
                future = client.submit(_attempt, function, shared, task, pure=False)
            under_way[future.key] = task
            return future

        first = [submit(task) for task in islice(waiting, _AHEAD * threads)]
        completed = as_completed(first, loop=client.loop)
        for future in completed:
            with _lost_connection():
                if future.cancelled() or future.status == "lost":
                    raise _LostError("it was started anew")
                error = future.exception()
                outcome = future.result() if error is None else Failure(f"the cluster gave it up: {error}")
            task = under_way.pop(future.key)
            # The result is here: the worker need not keep it.
            future.release()
            for following in islice(waiting, 1):
                completed.add(submit(following))
            yield Done(task, outcome)
    finally:
        with suppress(Exception):
            # A scheduler that is gone takes no leave.
            client.close(timeout=_CONNECT_S)
        log.setLevel(level)


@contextmanager
def _lost_connection() -> Iterator[None]:
    """Tell a scheduler that went away from all other errors."""
    from asyncio import CancelledError as StoppedError
    from concurrent.futures import CancelledError

    try:
        yield
    except (OSError, TimeoutError, CancelledError, StoppedError) as error:
        raise _LostError(str(error)[:120] or type(error).__name__) from error
