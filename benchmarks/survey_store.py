"""A plant's year in a store: 1,000 heliostats with 300 photos each, added and queried; time and memory by their number.

``python benchmarks/survey_store.py [HELIOSTATS]`` draws results of `heliogauge beam measure` (summary.json and
beams.csv alone), adds them in a process of its own and queries the store.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from heliogauge.results.folder import Summary, write_summary, write_table_csv

_PHOTOS = 300
_ADD = """
import resource, sys, time
from pathlib import Path
from calibration.survey.pipeline.add import add
begin = time.process_time()
added = add([Path(sys.argv[1])], Path(sys.argv[2]))
print(added.rows, time.process_time() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
_REPORT = """
import sys, time
from pathlib import Path
from calibration.survey.pipeline.judge_store import run
from calibration.survey.files.parquet_store import query
import duckdb
begin = time.perf_counter()
with query(Path(sys.argv[1])) as connection:
    connection.execute(
        "SELECT subject, avg(value), stddev(value) FROM rows WHERE quantity = 'beams_x_m' GROUP BY subject "
        "ORDER BY 3 DESC"
    ).fetchall()
middle = time.perf_counter()
run(Path(sys.argv[1]))
print(middle - begin, time.perf_counter() - middle)
"""


def draw(folder: Path, heliostats: int, rng: np.random.Generator) -> None:
    """Write results of beams of a year."""
    begin = np.datetime64("2026-01-01T09:00", "s")
    for number in range(heliostats):
        out = folder / f"H{number:04d}"
        out.mkdir()
        times = begin + np.sort(rng.integers(0, 365 * 8640, _PHOTOS)) * np.timedelta64(10, "s")
        columns: dict[str, list[object]] = {"time_utc": [f"{one}Z" for one in times]}
        for name, size in (
            ("x_m", 0.3),
            ("y_m", 0.3),
            ("d90_m", 0.1),
            ("width_major_m", 0.05),
            ("width_minor_m", 0.05),
        ):
            columns[name] = (1.0 + rng.normal(0, size, _PHOTOS)).tolist()
            columns[f"sigma_{name}"] = [0.02] * _PHOTOS
        write_table_csv(out / "beams.csv", columns)
        numbers = {"median_d90_m": 1.0 + rng.normal(0, 0.1), "sigma_median_d90_m": 0.02, "beams_count": _PHOTOS}
        write_summary(out / "summary.json", Summary("beam", f"H{number:04d}", numbers, {"date": "2026-12-31"}))


def main() -> None:
    """Draw, add and query a quarter, a half and the whole."""
    most = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    print("heliostats     rows   add [s CPU]   peak [MB]   query [s]   report [s]   store [MB]")
    for heliostats in (most // 4, most // 2, most):
        with tempfile.TemporaryDirectory() as place:
            results, store = Path(place) / "results", Path(place) / "store"
            results.mkdir()
            draw(results, heliostats, np.random.default_rng(1))
            added, reported = (
                subprocess.run(
                    [sys.executable, "-c", *words], capture_output=True, text=True, check=True
                ).stdout.split()
                for words in ((_ADD, str(results), str(store)), (_REPORT, str(store)))
            )
            size = sum(file.stat().st_size for file in store.rglob("*.parquet")) / 1e6
            print(
                f"{heliostats:10d} {added[0]:>8s} {float(added[1]):13.1f} {float(added[2]):11.0f} "
                f"{float(reported[0]):11.2f} "
                f"{float(reported[1]):12.2f} {size:12.1f}"
            )


if __name__ == "__main__":
    main()
