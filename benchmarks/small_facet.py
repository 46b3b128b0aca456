"""CPU time of the whole command on a small facet (203 x 154 px, 32 frames), imports included, without the report.

Run ``python benchmarks/small_facet.py``. The real facet is used where ../shared/data/opencsp is there, else a synthetic
one of the same size. User and system time of the child process, one thread.
"""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from _measure import ONE_THREAD, OPENCSP, ROOT, import_real_facet, row, title

from data_synth.fringes import preset_scene, write_dataset

ASKED_CPU_S, INCUMBENT_CPU_S = 1.0, 1.3
RUNS = 7


def child_cpu_s(environment, *arguments):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, *arguments], check=True, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(environment, commands):
    """Return the CPU seconds of each command, run in turn so that other work on the machine meets all alike."""
    for command in commands:
        child_cpu_s(environment, *command)  # compiles the modules, as installing does, and is not counted
    return np.array([[child_cpu_s(environment, *command) for command in commands] for _ in range(RUNS)]).T


def main():
    with tempfile.TemporaryDirectory() as scratch:
        folder, out = Path(scratch) / "measurement", Path(scratch) / "result"
        if OPENCSP.is_dir():
            import_real_facet(folder, with_pose=False)
            name = "real facet, pose from the outline"
        else:
            write_dataset(folder, preset_scene("small"))
            name = "synthetic facet (the real one is not on this machine)"
        title(
            f"Whole process, {name}, 203 x 154 px x 32 frames: CPU s, median of {RUNS}",
            ("measured", "asked", "incumbent", "spread"),
        )
        environment = {
            **os.environ,
            **ONE_THREAD,
            "PYTHONPATH": str(ROOT),
            "PYTHONPYCACHEPREFIX": f"{scratch}/bytecode",
        }
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        run = ("-m", "heliogauge", "deflectometry", "measure", str(folder), "-o", str(out), "--no-report", "--force")
        libraries = "import numpy, cv2, h5netcdf, pydantic, typer"
        rows = {
            "heliogauge deflectometry measure MEAS -o OUT --no-report": (f"<= {ASKED_CPU_S}", f"{INCUMBENT_CPU_S}"),
            "heliogauge --version": ("< 0.5", ""),
            "heliogauge --help": ("< 0.5", ""),
            f"beside it: {libraries}": ("", ""),
        }
        version, usage = ("-m", "heliogauge", "--version"), ("-m", "heliogauge", "--help")
        times = measure(environment, [run, version, usage, ("-c", libraries)])
        for (what, asked), seconds in zip(rows.items(), times, strict=True):
            row(what, f"{np.median(seconds):.2f}", *asked, f"{seconds.min():.2f} to {seconds.max():.2f}")
        row("the whole command over that import alone", f"{np.median(times[0] / times[3]):.1f} x")


if __name__ == "__main__":
    main()
