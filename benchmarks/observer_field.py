"""A field through ``heliogauge measure``: processor time of each module, and memory, as the field grows.

Run with one thread: ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/observer_field.py 5 10 20 50 100``:
one flight over so many modules, ``--photos`` of each (50), so that the last has 5,000 photos. ``--jobs`` is the
command's; ``--no-report`` leaves the reports out. What is counted is the whole command: start, reading, all modules,
writing.

Drawing a field would take hours. One piece of an LS-2 (the preset ``small``: 480 x 640 px) is ray-traced once for all
photos of a pass. Each module of the field is that mirror with targets of its own: their codes (16 bits), places, turns
and tilts are drawn anew into the light of the pass, with the lens's blur, and each photo has noise of its own. So every
photo is another file, every target another one, and all are in one list in the frame of the field; the mirrors are
alike and stand so far apart that no photo shows two.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cv2
import numpy as np
from _measure import row, title

from data_synth.troughs.dataset import observer_content
from data_synth.troughs.field import NeighbourScene, field_of
from data_synth.troughs.photo import Photographer
from data_synth.troughs.presets import TroughChoice, rim_targets, trough_scene
from heliogauge.measurement.writer import dump_toml

ASKED_MIB = 1536
#: 1,861 codes: enough for 155 modules of twelve targets.
DICTIONARY = "aicon-16"
#: Distances between rows and between modules of one row, and modules in a row [m].
ROW_STEP_M, MODULE_STEP_M, IN_ROW = 17.0, 25.0, 10


class PassOver(Photographer):
    """A pass over one module, whose light is traced once; further modules have targets of their own in it."""

    def __init__(self, scene):
        super().__init__(scene)
        traced = super().light
        self._traced = {view.name: traced(view, np.random.default_rng(k)) for k, view in enumerate(scene.views)}

    def light(self, view, rng):
        """Return the light that was traced."""
        return self._traced[view.name].copy()

    def over(self, scene):
        """Return the same pass over a module with other targets."""
        other = copy(self)
        other._scene = scene
        return other


@dataclass(frozen=True)
class Cost:
    """What a command took: processor time [s], largest memory [MiB], wall time [s]."""

    cpu_s: float
    mib: float
    wall_s: float


def draw_field(folder: Path, modules: int, photos: int) -> None:
    """Write one flight over a field."""
    scene = trough_scene("small", TroughChoice(n_photos=photos, dictionary=DICTIONARY))
    above = PassOver(scene)
    rows = []
    for number in range(modules):
        rng = np.random.default_rng([number, 11])
        own = rim_targets(scene.collector, DICTIONARY, scene.target_diameter_m, rng, first=12 * number)
        module = replace(scene, sheets=own[0], targets=own[1])
        camera = above.over(module)
        for view in scene.views:
            image = camera.take(view, rng)
            file = folder / f"photo_{number:03}_{view.name.removeprefix('photo_')}.jpg"
            cv2.imwrite(str(file), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
        place = np.array([ROW_STEP_M * (number // IN_ROW), MODULE_STEP_M * (number % IN_ROW), 0.0])
        rows.append(NeighbourScene(f"module-{number:03}", place, module))
    whole = field_of("a field", rows, scene.views)
    content = observer_content(whole, ".jpg")
    for number, one in enumerate(content["module"]):
        one["loop"] = f"loop-{number // IN_ROW}"
    (folder / "measurement.toml").write_text(dump_toml(content), encoding="utf-8")
    lines = ["target,x_m,y_m,z_m,sigma_x_mm,sigma_y_mm,sigma_z_mm"]
    for one in whole.targets:
        place, sigma = (f"{value:.6f}" for value in one.stated_m), (f"{1e3 * value:g}" for value in one.sigma_m)
        lines += [",".join([one.name, *place, *sigma])]
    (folder / content["targets"]["file"]).write_text("\n".join(lines) + "\n", encoding="utf-8")


def measured(folder: Path, out: Path, jobs: int, report: bool) -> Cost:
    """Run the command; processor time and memory are the system's, of this process alone."""
    command = [sys.executable, "-m", "heliogauge", "measure", str(folder), "-o", str(out), "--jobs", str(jobs), "-q"]
    begin = time.perf_counter()
    process = subprocess.Popen(command + ([] if report else ["--no-report"]), stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status):
        raise SystemExit(f"{' '.join(command)}: status {os.waitstatus_to_exitcode(status)}")
    return Cost(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, time.perf_counter() - begin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", type=int, nargs="*", default=[5, 10])
    parser.add_argument("--photos", type=int, default=50)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--no-report", action="store_true")
    parser.add_argument("--scratch", type=Path, help="where to draw; default: the system's folder for such files")
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    title(f"A field through heliogauge measure, {chosen.photos} photos of each module, {chosen.jobs} job(s)")
    last = None
    for modules in sorted(chosen.modules):
        with tempfile.TemporaryDirectory(dir=chosen.scratch) as scratch:
            folder, out = Path(scratch) / "field", Path(scratch) / "results"
            folder.mkdir()
            draw_field(folder, modules, chosen.photos)
            cost = measured(folder, out, chosen.jobs, not chosen.no_report)
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


if __name__ == "__main__":
    main()
