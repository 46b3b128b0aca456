"""From photos of a trough to the finished maps: processor time over that of merely decoding the photos, and memory.

Run with one thread: ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/observer_speed.py FOLDER``; FOLDER
is a measurement such as ``heliogauge observer synth FOLDER --preset ls2`` draws; without it a small one is drawn, whose
photos are too small for the ratio to mean much. The photos are written as JPEG (quality 95), in colour with
``--colour``, as often as are needed for 400 (``--photos``): passes over the same places, one after the other. Decoding
is OpenCV's, of the same files in the same run, with all that is in them: a colour photo becomes three colours, as in
any program that opens it (the evaluation itself decodes its luma only). Last comes the whole command as a process of
its own: start, the same again, files, report. ``--profile`` lists where the time goes.
"""

import argparse
import cProfile
import pstats
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cv2
import numpy as np
from _measure import StageClock, command_cost, row, title

from heliogauge.measurement.load import load
from observer import Options, run

ASKED_RATIO, ASKED_MIB = 2.5, 1536


def repeated(folder: Path, copy: Path, wanted: int, colour: bool) -> None:
    """Write a measurement with as many photos as are wanted."""
    for file in folder.iterdir():
        if file.suffix in {".csv", ".json"} and file.name != "truth.json":
            shutil.copy(file, copy)
    text = (folder / "measurement.toml").read_text(encoding="utf-8")
    (copy / "measurement.toml").write_text(text.replace("*.png", "*.jpg"), encoding="utf-8")
    files = sorted(folder.glob("photo_*.png"))
    for k in range(wanted):
        source = files[k % len(files)]
        image = cv2.imread(str(source), cv2.IMREAD_UNCHANGED)
        if k >= len(files):
            # A copy of a photo is refused: every pass has noise of its own.
            noise = np.random.default_rng(k).integers(-1, 2, image.shape, dtype=np.int8)
            image = cv2.add(image, noise, dtype=cv2.CV_8U)
        if colour:
            image = cv2.merge([cv2.multiply(image, share) for share in (0.92, 0.97, 1.0)])
        target = copy / f"photo_{k // len(files)}_{source.stem}.jpg"
        cv2.imwrite(str(target), image, [cv2.IMWRITE_JPEG_QUALITY, 95])


def decoding_s(files: list[Path]) -> float:
    begin = time.process_time()
    for file in files:
        cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    return time.process_time() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--photos", type=int, default=400)
    parser.add_argument("--colour", action="store_true")
    parser.add_argument("--profile", action="store_true")
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as scratch:
        copy, folder = Path(scratch) / "repeated", chosen.folder or Path(scratch) / "drawn"
        copy.mkdir()
        if chosen.folder is None:
            drawing = [sys.executable, "-m", "heliogauge", "observer", "synth", str(folder), "--preset", "small"]
            subprocess.run(drawing, check=True, stdout=subprocess.DEVNULL)
        repeated(folder, copy, chosen.photos, chosen.colour)
        measurement = load(copy)
        # Before and after: what else the machine does changes the clock within the run.
        first = decoding_s(list(measurement.photo_files))
        clock, profile = StageClock(), cProfile.Profile()
        begin = time.process_time()
        if chosen.profile:
            profile.enable()
        result = run(measurement, Options(jobs=1), clock)
        profile.disable()
        whole = time.process_time() - begin
        second = decoding_s(list(measurement.photo_files))
        command = command_cost("measure", str(copy), "-o", str(Path(scratch) / "results"), "--jobs", "1", "-q")
        decoding = (first + second + decoding_s(list(measurement.photo_files))) / 3
    count = len(result.network.solved.bundle.problem.observations.photos)
    title(f"{count} photos of {chosen.photos}, {'colour' if chosen.colour else 'grey'} JPEG")
    row("decoding alone, CPU", f"{decoding:.2f} s", "", "")
    for name, seconds in clock.cpu_s.items():
        row(f"  {name}", f"{seconds:.2f} s", "", "")
    row("photos to maps, CPU", f"{whole:.2f} s", "", "")
    row("over decoding", f"{whole / decoding:.2f}", f"{ASKED_RATIO}", "")
    row(
        "largest memory", f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB", f"{ASKED_MIB} MiB", ""
    )
    row("the whole command with its report, CPU", f"{command.cpu_s:.2f} s", "", "")
    row("over decoding", f"{command.cpu_s / decoding:.2f}", "", "")
    if chosen.profile:
        pstats.Stats(profile).sort_stats("tottime").print_stats(50)


if __name__ == "__main__":
    main()
