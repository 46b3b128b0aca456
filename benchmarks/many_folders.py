"""A thousand measurement folders: in one process, and on a cluster that loses a worker and its scheduler.

python benchmarks/many_folders.py [FOLDERS]

The cluster is a scheduler and two workers of one thread on this machine. After a third of the measurements a worker is
killed, after two thirds the scheduler, with both workers; each is started anew. Every number of every result must be
the same, to the last bit, as that of one process; memory of the process that waits must not grow.
"""

import json
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import heliogauge as hg
from heliogauge.batch.measure import measure_batch
from heliogauge.running.progress import SilentProgress
from heliogauge.running.scale import Workers

FOLDERS = 1000
#: Observations of the one heliostat of each folder, chosen by chance from 60.
OBSERVATIONS = 40


class Cluster:
    """A scheduler and two workers in processes of their own."""

    def __init__(self, place: Path) -> None:
        self._place = place
        self._file = place / "scheduler.json"
        self.processes: list[subprocess.Popen[bytes]] = []
        self.start(0)

    @property
    def address(self) -> str:
        """Where the scheduler listens."""
        return str(json.loads(self._file.read_text(encoding="utf-8"))["address"])

    def start(self, port: int) -> None:
        """Start the scheduler at a port, and two workers."""
        self._file.unlink(missing_ok=True)
        self._begin(
            "scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            f"{port}",
            "--no-dashboard",
            "--scheduler-file",
            str(self._file),
        )
        while not self._file.exists():
            time.sleep(0.1)
        self.start_worker()
        self.start_worker()

    def start_worker(self) -> None:
        """Start a worker of one thread."""
        self._begin(
            "worker",
            self.address,
            "--nthreads",
            "1",
            "--no-dashboard",
            "--no-nanny",
            "--local-directory",
            str(self._place),
        )

    def kill(self, *processes: int) -> None:
        """Kill processes, counted in the order in which they began."""
        for number in processes:
            self.processes[number].kill()
            self.processes[number].wait()

    def _begin(self, kind: str, *options: str) -> None:
        with (self._place / f"{kind}.log").open("ab") as log:
            command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *options]
            self.processes.append(subprocess.Popen(command, stdout=log, stderr=log))


class Watching(SilentProgress):
    """Counts what is done, notes memory, and does something at some of the counts."""

    def __init__(self, events: dict[int, Callable[[], None]]) -> None:
        super().__init__()
        self._events = events
        self.memory_mib: list[float] = []

    def say(self, text: str) -> None:
        """Print failures."""
        print(f"  {text}", flush=True)

    def advanced(self, stage: Any) -> None:
        """Note memory, and do what is due at this count."""
        if stage.name == "measure folders":
            if stage.done % 10 == 0:
                self.memory_mib.append(_memory_mib())
            if event := self._events.pop(stage.done, None):
                event()


def _memory_mib() -> float:
    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text().split()[1]) * resource.getpagesize() / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10


def write_folders(place: Path, count: int) -> None:
    """Write folders of one heliostat each, with observations of its own."""
    field = hg.synth("heliostat", place / "field", seed=1)
    rows = (field / "observations.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    places = (field / "heliostats.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    rng = random.Random(1)
    for number in range(count):
        name = f"H0{1 + number % 4}"
        folder = place / "in" / f"heliostat_{number:04d}"
        folder.mkdir(parents=True)
        shutil.copy(field / "measurement.toml", folder)
        seen = [row for row in rows if row.startswith(f"{name},")]
        chosen = sorted(rng.sample(range(len(seen)), min(OBSERVATIONS, len(seen))))
        (folder / "observations.csv").write_text(rows[0] + "".join(seen[one] for one in chosen), encoding="utf-8")
        (folder / "heliostats.csv").write_text(
            places[0] + "".join(row for row in places if row.startswith(f"{name},")), encoding="utf-8"
        )


def numbers(out: Path) -> dict[str, Any]:
    """Return all numbers of all results."""
    return {
        file.parent.name: json.loads(file.read_text(encoding="utf-8"))["numbers"]
        for file in sorted(out.glob("*/summary.json"))
    }


def run(place: Path, out: Path, workers: Workers, events: dict[int, Callable[[], None]]) -> dict[str, Any]:
    """Measure all folders and say how long it took and what memory did."""
    progress, start = Watching(events), time.perf_counter()
    result = measure_batch([place / "in"], out, workers, progress, {"thorough": False}, report=False)
    seconds, memory = time.perf_counter() - start, progress.memory_mib
    print(f"{out.name}: {result.headline()}; {seconds:.0f} s wall, {1e3 * seconds / len(result.rows):.0f} ms each")
    print(f"  memory of the process that waits: {memory[0]:.0f} MiB after 10, {memory[-1]:.0f} MiB at the end")
    return numbers(out)


def main() -> None:
    """Compare one process with a cluster that is broken twice."""
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    count = int(sys.argv[1]) if len(sys.argv) > 1 else FOLDERS
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        write_folders(place, count)
        cluster = Cluster(place)
        port = int(cluster.address.rsplit(":", maxsplit=1)[1])

        def lose_a_worker() -> None:
            print("  a worker is killed")
            cluster.kill(1)
            cluster.start_worker()

        def lose_the_scheduler() -> None:
            print("  scheduler and workers are killed and started anew")
            cluster.kill(0, 2, 3)
            cluster.start(port)

        try:
            events = {count // 3: lose_a_worker, 2 * count // 3: lose_the_scheduler}
            there = run(place, place / "cluster", Workers(scheduler=cluster.address), events)
        finally:
            for one in cluster.processes:
                one.kill()
        here = run(place, place / "one process", Workers(jobs=1), {})
        differing = [name for name in here if here[name] != there.get(name)]
        values = sum(map(len, here.values()))
        print(f"{values} numbers of {len(here)} results compared: {len(differing)} results differ")
        if differing or len(here) != count:
            sys.exit(f"not the same: {', '.join(differing[:5])}")


if __name__ == "__main__":
    main()
