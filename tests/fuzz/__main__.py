"""``python -m tests.fuzz --cases 5000 --seed 1``: draw damaged files and print what went wrong."""

import argparse
import os
import tempfile
import time
from collections import Counter
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[variable] = "1"

from tests.fuzz.running import check_undamaged, run_cases  # noqa: E402
from tests.fuzz.targets import TARGETS  # noqa: E402

WORDS = {
    "hangs": "hangs",
    "killed": "crashes",
    "took": "over 2 GB",
    "left": "left behind",
    "exit": "other exit codes",
    "silently": "silently different",
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="targets whose words contain this")
    parser.add_argument("--undamaged", action="store_true", help="every target once, on its undamaged folder")
    parser.add_argument("--again", type=int, nargs="*", help="only these cases")
    parser.add_argument("--place", type=Path, help="folder for undamaged data, kept for the next run")
    chosen = parser.parse_args()
    targets = tuple(one for one in TARGETS if chosen.only in str(one))
    with tempfile.TemporaryDirectory(prefix="heliogauge-fuzz-") as temporary:
        place = chosen.place or Path(temporary)
        place.mkdir(exist_ok=True)
        begin, kinds, peak, slowest = time.monotonic(), Counter[str](), 0, 0.0
        if chosen.undamaged:
            check_undamaged(place, targets)
            return
        numbers = range(chosen.cases) if chosen.again is None else chosen.again
        for done, outcome in enumerate(run_cases(place, numbers, chosen.seed, targets), 1):
            peak, slowest = max(peak, outcome.peak_bytes), max(slowest, outcome.seconds)
            if outcome.fault:
                kinds[WORDS.get(outcome.fault.split()[0].strip(":"), "tracebacks")] += 1
                print(outcome, flush=True)
            if done % 100 == 0:
                print(f"-- {done} cases, {time.monotonic() - begin:.0f} s, {dict(kinds)}", flush=True)
    found = ", ".join(f"{kinds[kind]} {kind}" for kind in ("tracebacks", *WORDS.values()))
    seconds = time.monotonic() - begin
    print(f"{len(numbers)} cases in {seconds:.0f} s: {found}; peak {peak / 1e9:.2f} GB, slowest {slowest:.1f} s")


if __name__ == "__main__":
    main()
