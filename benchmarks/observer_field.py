"""A field through ``heliogauge measure``: processor time of each module, and memory, as the field grows.

Run with one thread: ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/observer_field.py 5 10 20 50 100``:
one flight over so many modules, ``--photos`` of each (50), so that the last has 5,000 photos. ``--jobs`` is the
command's; ``--no-report`` leaves the reports out. What is counted is the whole command: start, reading, all modules,
writing.

Drawing a field would take hours. One piece of an LS-2 (the preset ``small``: 480 x 640 px) is ray-traced once for all
photos of a pass. Each module of the field is that mirror with targets of its own: their codes (16 bits), places, turns
and tilts are drawn anew into the light of the pass, with the lens's blur, and each photo has noise of its own. So every
photo is another file, every target another one, and all are in one list in the frame of the field; the mirrors are
alike and stand so far apart that no photo shows two. Targets are drawn less finely than in other photos, which no pixel
shows by more than 1 DN. Smaller fields are the first modules of the largest one. With ``--scratch`` the photos stay
for the next run.
"""

import argparse
import multiprocessing
import os
import shutil
import sys
import tempfile
import tomllib
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cv2
import numpy as np
from _measure import command_cost, row, title

from data_synth.troughs import write_wide_field
from heliogauge.measurement.writer import dump_toml

ASKED_MIB = 1536


def first_modules(field: Path, folder: Path, modules: int) -> None:
    """Write the field of the first modules of a larger one: its photos are linked, no other is drawn."""
    folder.mkdir()
    content = tomllib.loads((field / "measurement.toml").read_text(encoding="utf-8"))
    content["module"] = content["module"][:modules]
    (folder / "measurement.toml").write_text(dump_toml(content), encoding="utf-8")
    header, *targets = (field / "targets.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    of_each = len(targets) // len(tomllib.loads((field / "measurement.toml").read_text(encoding="utf-8"))["module"])
    (folder / "targets.csv").write_text("".join([header, *targets[: of_each * modules]]), encoding="utf-8")
    for number in range(modules):
        for photo in field.glob(f"photo_{number:03}_*.jpg"):
            os.link(photo, folder / photo.name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", type=int, nargs="*", default=[5, 10])
    parser.add_argument("--photos", type=int, default=50)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--no-report", action="store_true")
    parser.add_argument("--scratch", type=Path, help="keeps the photos for the next run; default: a folder that goes")
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    title(f"A field through heliogauge measure, {chosen.photos} photos of each module, {chosen.jobs} job(s)")
    last, without = None, ["--no-report"] if chosen.no_report else []
    with tempfile.TemporaryDirectory(dir=chosen.scratch) as scratch:
        field = (chosen.scratch or Path(scratch)) / f"field-{max(chosen.modules)}-{chosen.photos}"
        if not field.exists():
            # In a process of its own: what a process has taken is counted for those that it starts.
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as drawing:
                drawing.submit(write_wide_field, field, max(chosen.modules), chosen.photos).result()
        for modules in sorted(chosen.modules):
            folder, out = Path(scratch) / f"first-{modules}", Path(scratch) / f"results-{modules}"
            first_modules(field, folder, modules)
            cost = command_cost("measure", str(folder), "-o", str(out), "--jobs", str(chosen.jobs), "-q", *without)
            solved = sum((out / f"module-{k:03}" / "slope_map.nc").exists() for k in range(modules))
            row(f"{modules} modules, {modules * chosen.photos} photos: measured", f"{solved}", f"{modules}", "")
            row("  CPU", f"{cost.cpu_s:.1f} s", "", "")
            row("  CPU of a module", f"{cost.cpu_s / modules:.2f} s", "flat", "")
            if last is not None:
                # 1: linear; what the command takes to start makes it smaller.
                before, few = last
                grows = np.log(cost.cpu_s / before.cpu_s) / np.log(modules / few)
                row("  CPU grows with modules to the power", f"{grows:.2f}", "1", "")
            row("  largest memory", f"{cost.mib:.0f} MiB", f"{ASKED_MIB} MiB", "")
            last = cost, modules
            shutil.rmtree(out)


if __name__ == "__main__":
    main()
