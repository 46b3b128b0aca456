"""CPU time of a whole report: 1.5 million rays and every figure, with the kernel's start and all imports.

Run ``python benchmarks/report.py [NODES]``; NODES is the number of grid nodes along the longer side (default 400).
"""

import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

# One thread, so that CPU time is work and not waiting of idle threads.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
ASKED_CPU_S = 8.0
INCUMBENT_CPU_S = 63.0
ROOT = Path(__file__).resolve().parents[1]


def write_results(folder: Path, nodes: int) -> None:
    import numpy as np

    from heliogauge.results.folder import Summary, write_pixels, write_slope_map, write_summary
    from heliogauge.slopes.map import CommonModes, SlopeMap
    from heliogauge.slopes.statistics import statistics

    rng = np.random.default_rng(1)
    x_m, y_m = np.linspace(-0.6, 0.6, nodes), np.linspace(-0.45, 0.45, nodes * 3 // 4)
    x, y = np.meshgrid(x_m, y_m)
    design, sigma = (x / 20, y / 20), np.full(x.shape, 2e-5)
    slopes = [slope + 4e-4 * np.sin(6 * slope * 20) + rng.normal(0, sigma) for slope in design]
    common = CommonModes(("mirror pose",) * 6 + ("screen pose",) * 6, rng.normal(0, 2e-5, (12, 2, 6)), np.zeros(2), 0.6)
    slope_map = SlopeMap(
        x_m,
        y_m,
        *slopes,
        *design,
        sigma,
        sigma,
        1.0,
        common,
        (x**2 + y**2) / 40,
        np.zeros(x.shape, np.uint32),
        np.hypot(x, y) < 0.7,
        "paraboloid, f = 10 m",
        "facet",
        "nothing",
    )
    write_slope_map(folder / "slope_map.nc", {"": slope_map})
    image = rng.normal(80, 2, (1232, 1624))
    write_pixels(folder / "pixels.nc", dict.fromkeys(("modulation_dn", "residual_dn", "u", "v"), image))
    result = statistics(slope_map)
    numbers = {"sdx_rad": result.sdx_rad, "sigma_sdx_rad": result.sigma_sdx_rad}
    write_summary(folder / "summary.json", Summary("deflectometry", "benchmark", numbers))


def main() -> None:
    nodes = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    sys.path.insert(0, str(ROOT))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_results(folder, nodes)
        program = (
            "from pathlib import Path; from heliogauge.reporting.build import build_report; "
            f"build_report(Path({str(folder)!r}))"
        )
        environment = {**os.environ, **THREADS, "PYTHONPATH": str(ROOT)}
        # The children's time counts once they and their own children have ended: the kernel is among them.
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run([sys.executable, "-c", program], check=True, env=environment, cwd=scratch)
        after, wall_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - start
        page = (folder / "report.html").read_text(encoding="utf-8")
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    rays = re.findall(r"(\d+) rays on a target", page)
    figures = page.count("data:image/png")
    print(f"map {nodes} x {nodes * 3 // 4} nodes, {figures} figures, {rays[0]} rays, {len(page) / 1e6:.1f} MB")
    print(f"CPU {cpu_s:.2f} s (asked: {ASKED_CPU_S} s; OpenCSP: {INCUMBENT_CPU_S} s), wall {wall_s:.2f} s")


if __name__ == "__main__":
    main()
