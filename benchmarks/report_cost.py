"""What the report of a facet costs beside measuring it: processor time of whole commands, with and without report.

Asked: at most 0.7 of the time of measuring; three runs of each, the middle one counts.
"""

import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ASKED = 0.7
RUNS = 3


def cpu_s(*arguments: str) -> float:
    """Run a command and return its user and system time [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "heliogauge", *arguments, "-q"], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        folder, out = f"{scratch}/facet", f"{scratch}/result"
        cpu_s("deflectometry", "synth", folder)
        command = ("deflectometry", "measure", folder, "-o", out, "--force")
        pairs = [(cpu_s(*command, "--no-report"), cpu_s(*command)) for _ in range(RUNS)]
        bare, whole = (statistics.median(column) for column in zip(*pairs, strict=True))
        sizes = {name: (Path(out) / name).stat().st_size / 1e6 for name in ("report.html", "report.ipynb")}
    print(f"measuring {bare:.2f} s, with report {whole:.2f} s CPU (median of {RUNS})")
    print(f"report / measuring: {(whole - bare) / bare:.2f} (asked: <= {ASKED})")
    print(", ".join(f"{name} {size:.1f} MB" for name, size in sizes.items()))


if __name__ == "__main__":
    main()
