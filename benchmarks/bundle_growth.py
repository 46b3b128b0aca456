"""Time and memory of an adjustment with joint covariance against the numbers of photos and targets.

Run: OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/bundle_growth.py [--large] [--plot FILE.png]
Prints CPU seconds and the peak memory of a process of its own for each size; ``--large`` adds 500 and 1000 photos of
2000 targets (two minutes of CPU, 2.9 GB), ``--plot`` draws docs/images/bundle_growth_memory.png.
"""

import json
import resource
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

PHOTOS, LARGE_PHOTOS = (25, 50, 100, 200), (500, 1000)
TARGETS = (100, 250, 500, 1000, 2000, 4000)
#: Targets where the photos grow, photos where the targets grow.
FIXED_TARGETS, FIXED_PHOTOS = 2000, 100


def measure(n_photos: int, n_targets: int) -> dict[str, float]:
    """Adjust one network; CPU seconds and what the process held at most, with libraries and image points."""
    from benchmarks.bundle import network, own

    own(*network(6, 30)[1:])
    _, start, points = network(n_photos, n_targets)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    _, (adjustment, covariance, _) = own(start, points, redundancy=False)
    return {
        "photos": n_photos,
        "targets": n_targets,
        "points": points.n,
        "adjust_s": adjustment,
        "covariance_s": covariance,
        "before_gb": before / 1e6,
        "peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
    }


def in_own_process(n_photos: int, n_targets: int) -> dict[str, float]:
    command = [sys.executable, str(Path(__file__).resolve()), "--one", str(n_photos), str(n_targets)]
    found = subprocess.run(command, check=True, capture_output=True, text=True)
    one: dict[str, float] = json.loads(found.stdout)
    print(
        f"{n_photos:7}{n_targets:9}{one['points']:10}{one['adjust_s']:9.2f}{one['covariance_s']:9.2f}"
        f"{one['before_gb']:9.2f}{one['peak_gb']:9.2f}",
        flush=True,
    )
    return one


def plot(path: Path, by_photos: list[dict[str, float]], by_targets: list[dict[str, float]]) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 2, figsize=(8, 5.6), sharex="col", layout="constrained")
    columns = ((by_photos, "photos", f"{FIXED_TARGETS} targets"), (by_targets, "targets", f"{FIXED_PHOTOS} photos"))
    for column, (rows, name, title) in enumerate(columns):
        count = [one[name] for one in rows]
        for key, label in (("adjust_s", "adjustment"), ("covariance_s", "joint covariance")):
            axes[0, column].loglog(count, [one[key] for one in rows], "o-", label=label)
        axes[1, column].loglog(count, [one["peak_gb"] for one in rows], "s-", label="peak")
        axes[1, column].loglog(count, [one["before_gb"] for one in rows], "--", label="before: libraries, image points")
        axes[0, column].set_title(title)
        axes[1, column].set_xlabel(name)
        for row in range(2):
            axes[row, column].grid(which="both", alpha=0.3)
    axes[0, 0].set_ylabel("CPU time [s]")
    axes[1, 0].set_ylabel("memory [GB]")
    axes[0, 0].legend()
    axes[1, 0].legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    if "--one" in sys.argv:
        place = sys.argv.index("--one")
        print(json.dumps(measure(int(sys.argv[place + 1]), int(sys.argv[place + 2]))))
        return
    print("CPU seconds, memory of the process in GB before and at most")
    print(f"{'photos':>7}{'targets':>9}{'points':>10}{'adjust':>9}{'covar.':>9}{'before':>9}{'peak':>9}")
    photos = PHOTOS + LARGE_PHOTOS * ("--large" in sys.argv)
    by_photos = [in_own_process(count, FIXED_TARGETS) for count in photos]
    by_targets = [in_own_process(FIXED_PHOTOS, count) for count in TARGETS]
    if "--plot" in sys.argv:
        plot(Path(sys.argv[sys.argv.index("--plot") + 1]), by_photos, by_targets)


if __name__ == "__main__":
    main()
