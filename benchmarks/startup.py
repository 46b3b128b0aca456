"""How long the command line takes to answer, beside Python's own start.

Run: python benchmarks/startup.py
Asked: --version and --help well under half a second; reading measurement.toml about as long as importing pydantic.
"""

import subprocess
import sys
import time

RUNS = 5
PROGRAMS = {
    "python alone": ["-c", "pass"],
    "heliogauge --version": ["-m", "heliogauge", "--version"],
    "heliogauge --help": ["-m", "heliogauge", "--help"],
    "import pydantic": ["-c", "import pydantic; from pydantic import BaseModel"],
    "import heliogauge.measurement.load": ["-c", "import heliogauge.measurement.load"],
}


def seconds(arguments: list[str]) -> float:
    """Return the best of some runs: what else the machine does can only make one slower."""
    best = float("inf")
    for _ in range(RUNS):
        start = time.perf_counter()
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
        best = min(best, time.perf_counter() - start)
    return best


if __name__ == "__main__":
    alone = seconds(PROGRAMS["python alone"])
    for name, arguments in PROGRAMS.items():
        took = seconds(arguments)
        print(f"{name:32} {took:6.3f} s {took / alone:6.1f} times python alone")
