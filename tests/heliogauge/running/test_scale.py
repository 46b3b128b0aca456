"""Many independent tasks: what fails is an outcome, workers agree with this process, memory does not grow."""

import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from heliogauge.errors import EstimationError, InputError
from heliogauge.running import scale
from heliogauge.running.scale import Done, Failure, Workers, run_each, usable_processors


def halve(context: float, task: int) -> float:
    """Half of an even number; odd ones fail, seven by a bug, and minus one kills its process."""
    if task == -1:
        os._exit(9)
    if task == 7:
        return context / (task - 7)
    if task % 2:
        raise EstimationError(f"{task} is odd")
    return context * task


def outcomes(done: Iterator[Done[int, float]]) -> dict[int, float | Failure]:
    return {one.task: one.outcome for one in done}


@pytest.mark.parametrize("processes", [1, 2])
def test_failures_are_outcomes(processes: int) -> None:
    found = outcomes(run_each(halve, 0.5, range(12), workers=Workers(), processes=processes))
    assert [found[even] for even in range(0, 12, 2)] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert found[3] == Failure("3 is odd")
    bug = found[7]
    assert isinstance(bug, Failure)
    assert bug.reason.startswith("unexpected ZeroDivisionError")
    assert "halve" in bug.trace


class BreakingPool:
    """Works at once, and is broken when it is given something for the ninth time."""

    def __init__(self) -> None:
        self.given = 0

    def submit(self, _: Any, task: int) -> "Future[float]":
        self.given += 1
        if self.given == 9:
            raise BrokenProcessPool
        future: Future[float] = Future()
        future.set_result(halve(1.0, task))
        return future


def test_what_is_given_to_a_pool_while_it_breaks_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    pool = BreakingPool()
    monkeypatch.setattr(scale, "_pool", lambda *_: nullcontext(pool))
    done = list(run_each(halve, 1.0, range(0, 40, 2), workers=Workers(), processes=2))
    assert sorted(one.task for one in done) == list(range(0, 40, 2))


@pytest.mark.slow
def test_a_killed_process_costs_only_its_task() -> None:
    found = outcomes(run_each(halve, 1.0, [0, 2, -1, 4, 6, 8, 10, 12], workers=Workers(), processes=2))
    killed = found.pop(-1)
    assert isinstance(killed, Failure)
    assert "killed" in killed.reason
    assert found == {even: float(even) for even in range(0, 13, 2)}


@pytest.mark.parametrize("processes", [1, 2])
def test_tasks_are_taken_as_needed(processes: int) -> None:
    """With ten thousand heliostats only a handful may be in memory."""
    taken = 0

    def tasks() -> Iterator[int]:
        nonlocal taken
        for task in range(0, 400, 2):
            taken += 1
            yield task

    done = run_each(halve, 1.0, tasks(), workers=Workers(), processes=processes)
    next(done)
    assert taken <= 4 * processes + 2
    done.close()


@pytest.mark.slow
def test_threads_of_the_caller_are_left_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    list(run_each(halve, 1.0, [2, 4], workers=Workers(), processes=2))
    assert "OMP_NUM_THREADS" not in os.environ


SCRIPT = """
from heliogauge.running.scale import Workers, run_each
from tests.heliogauge.running.test_scale import halve

print("begin")
found = {one.task: one.outcome for one in run_each(halve, 0.5, range(0, 12, 2), workers=Workers(), processes=2)}
print(sorted(found.values()))
"""


@pytest.mark.slow
def test_a_script_without_a_guard_is_not_run_again(tmp_path: Path, repository: Path) -> None:
    """Spawned processes import the caller's script, unless they are kept from it."""
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(tmp_path / "script.py")],
        env=os.environ | {"PYTHONPATH": str(repository)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "begin\n[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]\n", done.stderr


def test_how_many_processes() -> None:
    assert Workers(jobs=3).processes(100, worth=8) == 3
    assert Workers(jobs=3).processes(20, worth=8) == 2
    assert Workers(jobs=3).processes(2, worth=8) == 1
    assert Workers().processes(10_000) == usable_processors()


class TestCluster:
    @pytest.fixture(scope="class")
    def address(self) -> Iterator[str]:
        distributed = pytest.importorskip("distributed")
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
        ) as cluster:
            yield cluster.scheduler_address

    @pytest.mark.slow
    def test_agrees_with_this_process(self, address: str) -> None:
        tasks = range(40)
        here = outcomes(run_each(halve, 0.5, tasks, workers=Workers()))
        there = outcomes(run_each(halve, 0.5, tasks, workers=Workers(scheduler=address)))
        bug = there.pop(7)
        assert isinstance(bug, Failure)
        assert "ZeroDivisionError" in bug.reason
        here.pop(7)
        assert there == here

    @pytest.mark.slow
    def test_other_versions_are_refused(self, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("heliogauge.running.scale.__version__", "0.0.0")
        # The workers are threads of this process, so that the version they tell must be another one than ours.
        monkeypatch.setattr("heliogauge.running.scale._version_there", lambda: "9.9.9")
        with pytest.raises(InputError, match=r"9\.9\.9, here is 0\.0\.0"):
            list(run_each(halve, 0.5, [2], workers=Workers(scheduler=address)))


_WITHOUT_PACKAGE = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "heliogauge":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
"""


@pytest.mark.slow
def test_workers_without_the_package_end_in_one_sentence(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    # What Python imports before anything else: in the worker the package is not there.
    (tmp_path / "sitecustomize.py").write_text(_WITHOUT_PACKAGE, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None, protocol="tcp") as cluster:
        command = [sys.executable, "-m", "distributed.cli.dask_worker", cluster.scheduler_address, "--no-dashboard"]
        worker = subprocess.Popen(
            [*command, "--nthreads", "1", "--no-nanny", "--local-directory", str(tmp_path)],
            env=environment, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            with pytest.raises(InputError, match=r"1 of 1 workers cannot import heliogauge .*; install heliogauge"):
                list(run_each(halve, 0.5, [2], workers=Workers(scheduler=cluster.scheduler_address)))
        finally:
            worker.kill()
            worker.wait()


@pytest.mark.slow
def test_no_scheduler_there(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("heliogauge.running.scale._CONNECT_S", 1)
    with pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:1: no scheduler answers"):
        list(run_each(halve, 0.5, [2], workers=Workers(scheduler="tcp://127.0.0.1:1")))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("address", "settings", "words"),
    [
        ("tls://127.0.0.1:1", {}, "ssl_context"),
        ("tcp://192.0.2.1:1", {"distributed.comm.require-encryption": True}, "encryption required"),
    ],
)
def test_what_the_settings_of_dask_forbid(address: str, settings: dict[str, bool], words: str) -> None:
    pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    with (
        dask.config.set(settings),
        pytest.raises(InputError, match=rf"does not connect \(.*{words}.*require-encryption"),
    ):
        list(run_each(halve, 0.5, [2], workers=Workers(scheduler=address)))
