"""Faults put into drawn flights over a trough: what the command line says of each, and whether that names the fault.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/observer_faults.py FOLDER [SEED ..] [--preset NAME]
[--photos N] [--only REGEX]``; the seeds are 1 to 4 without any. FOLDER keeps the photos for the next run. A fault is
named when a warning that the flight without it does not have names it: the key, both targets, where photos are missing,
the encoding. Where two encodings are mixed, what is said of how files are encoded counts as well, and all photos of the
wrong kind must be named by it.
"""

import argparse
import csv
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

PHOTO = "photo_*.png"
Fault = Callable[[Path, np.random.Generator], tuple[str, ...]]


def focal_length(share: float) -> Fault:
    """State the collector's focal length wrong."""

    def change(folder: Path, _: np.random.Generator) -> tuple[str, ...]:
        toml = folder / "measurement.toml"
        said = re.sub(
            r"(?m)^focal_length_m = (.*)$",
            lambda found: f"focal_length_m = {float(found[1]) * (1 + share):.6f}",
            toml.read_text(),
        )
        toml.write_text(said)
        return ("collector.focal_length_m",)

    return change


def read_list(folder: Path) -> list[dict[str, str]]:
    """Return the rows of the list of targets."""
    with (folder / "targets.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def write_list(folder: Path, rows: list[dict[str, str]]) -> None:
    """Write the list of targets anew."""
    with (folder / "targets.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def list_aside(axis: str, by_m: float) -> Fault:
    """Give all targets of the list too large a coordinate."""

    def change(folder: Path, _: np.random.Generator) -> tuple[str, ...]:
        rows = read_list(folder)
        for row in rows:
            row[axis] = f"{float(row[axis]) + by_m:.6f}"
        write_list(folder, rows)
        said = {"x_m": r"too far towards [+-]x", "z_m": "too high" if by_m > 0 else "too low"}[axis]
        open_which = "|serious: .*x_m of all targets in the list is not" if axis == "x_m" else ""
        return (rf"serious: targets\.file.*whole list lies .*{said}{open_which}",)

    return change


def principal_point(by_px: float) -> Fault:
    """State the principal point aside."""

    def change(folder: Path, _: np.random.Generator) -> tuple[str, ...]:
        toml = folder / "measurement.toml"
        said, count = re.subn(
            r"(?m)^center_x_px = (.*)$",
            lambda found: f"center_x_px = {float(found[1]) + by_px:.6f}",
            toml.read_text(),
        )
        if count != 1:
            raise ValueError(f"{toml}: states center_x_px {count} times")
        toml.write_text(said)
        return (r"serious: camera.*center_x_px = .* (does not fit|instead of)",)

    return change


def exchanged(folder: Path, rng: np.random.Generator) -> tuple[str, ...]:
    """Exchange the coordinates of two targets of the list."""
    rows = read_list(folder)
    a, b = rng.choice(len(rows), 2, replace=False).tolist()
    for axis in ("x_m", "y_m", "z_m"):
        rows[a][axis], rows[b][axis] = rows[b][axis], rows[a][axis]
    write_list(folder, rows)
    one, other = rows[a]["target"], rows[b]["target"]
    return (f"exchanged in the list: ({one} and {other}|{other} and {one})",)


def missing(which: str) -> Fault:
    """Take half of the photos away: every second, a random half, or the second half of the pass."""

    def change(folder: Path, rng: np.random.Generator) -> tuple[str, ...]:
        files = sorted(folder.glob(PHOTO))
        half = {
            "every second": files[1::2],
            "random half": [files[k] for k in rng.choice(len(files), len(files) // 2, replace=False)],
            "second half": files[len(files) // 2 :],
        }[which]
        for file in half:
            file.unlink()
        return (r"numbers of photos are missing|m apart: an edge|fly from x",)

    return change


def encode(file: Path, rng: np.random.Generator) -> None:
    """Encode a linear photo for the eye."""
    stored = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    light = (stored + rng.uniform(-0.5, 0.5, stored.shape)) / 255
    eye = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0) ** (1 / 2.4) - 0.055)
    cv2.imwrite(str(file), np.rint(255 * eye).clip(0, 255).astype(np.uint8))


def for_the_eye(which: Callable[[list[Path]], list[Path]], words: str) -> Fault:
    """Encode some of the linear photos for the eye."""

    def change(folder: Path, rng: np.random.Generator) -> tuple[str, ...]:
        for file in which(sorted(folder.glob(PHOTO))):
            encode(file, rng)
        return (words,)

    return change


MIXED = "each photo is taken as it looks|targets look"
FAULTS: dict[str, Fault] = {
    "focal length +1 %": focal_length(0.01),
    "focal length -1 %": focal_length(-0.01),
    "two targets exchanged": exchanged,
    "list 20 mm too high": list_aside("z_m", 0.02),
    "list 20 mm too low": list_aside("z_m", -0.02),
    "list 20 mm aside": list_aside("x_m", 0.02),
    "principal point 20 px aside": principal_point(20.0),
    "every second photo missing": missing("every second"),
    "random half missing": missing("random half"),
    "second half missing": missing("second half"),
    "all files linear": lambda *_: ("files are linear",),
    "all files sRGB": for_the_eye(lambda files: files, "files are srgb"),
    "every second file sRGB": for_the_eye(lambda files: files[::2], MIXED),
    "last quarter sRGB": for_the_eye(lambda files: files[-len(files) // 4 :], MIXED),
    "two files sRGB": for_the_eye(lambda files: files[7:9], MIXED),
}


def measure(folder: Path) -> tuple[list[str], str]:
    """Return the warnings, and all that the run said."""
    out = folder.with_name(folder.name + "_result")
    shutil.rmtree(out, ignore_errors=True)
    command = [
        sys.executable,
        "-m",
        "heliogauge",
        "observer",
        "measure",
        str(folder),
        "-o",
        str(out),
        "--jobs",
        "1",
        "-v",
    ]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    said = done.stdout + done.stderr
    warnings = [line for line in said.splitlines() if "warning" in line or "error" in line or "serious" in line]
    return warnings, said


def main() -> None:
    """Put in each fault, and print what is said."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("seeds", type=int, nargs="*", default=[1, 2, 3, 4])
    parser.add_argument("--preset", default="small")
    parser.add_argument("--photos")
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    for seed in args.seeds or [1, 2, 3, 4]:
        good = args.folder / f"{args.preset}_{args.photos or 'all'}_{seed}"
        if not good.exists():
            command = ["observer", "synth", str(good), "--preset", args.preset, "--shaped", "--seed", str(seed), "-q"]
            command += ["--photos", args.photos] if args.photos else []
            subprocess.run([sys.executable, "-m", "heliogauge", *command], check=True)
        before, _ = measure(good)
        print(f"seed {seed}, no fault:", *before, sep="\n    ", flush=True)
        for number, (name, fault) in enumerate(FAULTS.items()):
            if not re.search(args.only, name):
                continue
            bad = args.folder / "bad"
            shutil.rmtree(bad, ignore_errors=True)
            shutil.copytree(good, bad)
            words = fault(bad, np.random.default_rng([seed, number]))
            warnings, said = measure(bad)
            named = all(re.search(word, said) for word in words)
            print(f"  {'named   ' if named else 'NOT NAMED'} {name}")
            for one in warnings:
                if one not in before:
                    print("      ", one[:400], flush=True)


if __name__ == "__main__":
    main()
