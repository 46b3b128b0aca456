"""Report of a large network as a whole command: 90,561 points in 60 photos, or 90,561 image points of 1,000 targets.

Run: OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/network_report.py [marks|targets] [--keep FOLDER]
The results are drawn, not adjusted: poses all round a dish, image points with noise, sigmas of the size that such a
network has. Prints what ``heliogauge report`` needs and how large its files are, beside what is asked.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bundle import look_at

from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.results.folder import (
    PhotoPose,
    PointTable,
    Summary,
    write_cameras_json,
    write_points_csv,
    write_summary,
    write_table_csv,
)
from heliogauge.results.thumbnails import write_thumbnails

ROOT = Path(__file__).resolve().parents[1]
COUNT = 90_561
ASKED_S, ASKED_MB = 10.0, 6.0
SIGMA_PX, REDUNDANCY = 0.05, 0.6
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


class Drawn(NamedTuple):
    """A network: image points by photo and target."""

    camera: Camera
    poses: list
    points_m: np.ndarray
    photo: np.ndarray
    target: np.ndarray
    pixels_px: np.ndarray


def draw_network(n_points: int, n_photos: int, n_image_points: int) -> Drawn:
    """Draw cameras round a dish of 8 m and the places of its targets in their images."""
    rng = np.random.default_rng(4)
    side = int(np.ceil(np.sqrt(n_points)))
    x, y = (axis.ravel()[:n_points] for axis in np.meshgrid(*2 * (np.linspace(-4, 4, side),)))
    points = np.stack([x, y, (x**2 + y**2) / 16], axis=1)
    camera = Camera(
        6000,
        4000,
        4600.0,
        4603.0,
        3010.0,
        1990.0,
        distortion=BrownDistortion(k1=-0.1, k2=0.05, p1=3e-4),
        covariance=np.diag([0.02, 0.02, 0.03, 0.03, 0, 1e-5, 1e-4, 1e-6, 1e-6, 1e-4]) ** 2,
    )
    poses, photo, target, pixels = [], [], [], []
    for i, angle in enumerate(6 * np.pi * np.arange(n_photos) / n_photos):
        center = np.array([8 * np.cos(angle), 8 * np.sin(angle), 7 + 2 * (i % 3)])
        poses.append(look_at(center, rng.uniform(-0.5, 0.5, 3), (i % 4) * np.pi / 2))
        seen = camera.project(poses[-1].apply(points))
        inside = np.nonzero(((seen > 0) & (seen < [5999, 3999])).all(axis=1))[0]
        photo.append(np.full(inside.size, i))
        target.append(inside)
        pixels.append(seen[inside])
    photo, target, pixels = (np.concatenate(part) for part in (photo, target, pixels))
    kept = np.sort(rng.permutation(photo.size)[:n_image_points])
    return Drawn(camera, poses, points, photo[kept], target[kept], pixels[kept])


def write_results(folder: Path, drawn: Drawn) -> None:
    """Write the drawn network as the pipeline writes an adjusted one."""
    rng = np.random.default_rng(5)
    n, count = len(drawn.points_m), len(drawn.photo)
    names = [str(i + 1) for i in range(n)]
    photos = [f"photo_{i + 1:03d}.jpg" for i in range(len(drawn.poses))]
    rays = np.bincount(drawn.target, minlength=n)
    sigma = 4e-5 * rng.uniform(0.8, 1.2, (n, 3)) / np.sqrt(np.maximum(rays, 1))[:, None]
    flags = np.zeros(n, dtype=np.uint32)
    write_points_csv(folder / "points.csv", PointTable(names, drawn.points_m, sigma, rays, flags))
    covariance = {f"{axis * 2}_m2": sigma[:, i] ** 2 for i, axis in enumerate("xyz")}
    covariance |= {f"{pair}_m2": np.zeros(n) for pair in ("xy", "xz", "yz")}
    write_table_csv(folder / "points_covariance.csv", {"id": names, **covariance})
    residuals = SIGMA_PX * np.sqrt(REDUNDANCY) * rng.normal(size=(count, 2))
    rms = np.sqrt(np.bincount(drawn.photo, (residuals**2).sum(axis=1)) / np.bincount(drawn.photo))
    spread = np.diag([1e-5] * 3 + [5e-5] * 3) ** 2
    poses = {
        name: PhotoPose("camera", pose, spread, float(size))
        for name, pose, size in zip(photos, drawn.poses, rms, strict=True)
    }
    write_cameras_json(folder / "cameras.json", {"camera": drawn.camera}, poses)
    write_table_csv(
        folder / "residuals.csv",
        {
            "image": [photos[i] for i in drawn.photo],
            "target": [names[i] for i in drawn.target],
            "x_px": drawn.pixels_px[:, 0],
            "y_px": drawn.pixels_px[:, 1],
            "sigma_x_px": np.full(count, SIGMA_PX),
            "sigma_y_px": np.full(count, SIGMA_PX),
            "residual_x_px": residuals[:, 0],
            "residual_y_px": residuals[:, 1],
            "redundancy_x": np.full(count, REDUNDANCY),
            "redundancy_y": np.full(count, REDUNDANCY),
            "test": np.linalg.norm(residuals, axis=1) / (SIGMA_PX * np.sqrt(REDUNDANCY)),
        },
    )
    refused = rng.permutation(count)[: count // 100]
    write_table_csv(
        folder / "rejected.csv",
        {
            "name": [f"target {names[drawn.target[i]]} in {photos[drawn.photo[i]]}" for i in refused],
            "reason": [f"contradicts the other image points, residual {0.3 + 0.01 * (i % 50):.2f} px" for i in refused],
            "is_outlier": np.ones(refused.size, dtype=int),
            "image": [photos[drawn.photo[i]] for i in refused],
            "x_px": drawn.pixels_px[refused, 0],
            "y_px": drawn.pixels_px[refused, 1],
        },
    )
    bar = {"known_m": 7.9, "sigma_known_m": 1e-5, "measured_m": 7.90001, "sigma_measured_m": 1.2e-5, "error_m": 1e-5}
    bars = {
        name: [value + (1e-3 * i if name in ("known_m", "measured_m") else 0) for i in range(8)]
        for name, value in bar.items()
    }
    ends = {"target_a": names[:8], "target_b": names[8:16]}
    bar_names = [f"distance {i + 1} - {i + 9}" for i in range(8)]
    write_table_csv(folder / "constraints.csv", {"name": bar_names, **ends, "used": [1] * 8, **bars})
    more = {"sigma_error_m": [1.6e-5] * 8, "permissible_m": [np.nan] * 8, "verdict": [""] * 8}
    role = {"name": bar_names, "role": ["left out"] * 8, "line": [str(i + 1) for i in range(8)]}
    write_table_csv(folder / "lengths.csv", {**role, **bars, **more})
    free = ("focal_px", "center_x_px", "center_y_px", "k1", "k2", "k3", "p1", "p2")
    place = {"focal_px": 0, "center_x_px": 2, "center_y_px": 3} | {
        name: PARAMETER_NAMES.index(name) for name in free[3:]
    }
    write_table_csv(
        folder / "intrinsics.csv",
        {
            "camera": ["camera"] * len(free),
            "name": list(free),
            "value": [float(drawn.camera.parameters[place[name]]) for name in free],
            "sigma": [float(drawn.camera.sigma_parameters[place[name]]) for name in free],
            "significance": [np.nan] * 3 + [0.999] * 5,
            "rival": list(free[::-1]),
            "correlation": [0.3] * len(free),
        },
    )
    picture = cv2.GaussianBlur(rng.integers(20, 220, (640, 960)).astype(np.uint8), (0, 0), 1.5)
    write_thumbnails(folder, dict.fromkeys(photos, make_thumbnail(picture)))
    spreads = np.sqrt((sigma**2).mean(axis=0))
    extent = float(np.linalg.norm(np.ptp(drawn.points_m, axis=0)))
    numbers = {
        "points_count": n,
        "photos_count": len(photos),
        "image_points_count": count,
        "image_residual_rms_px": float(np.sqrt((residuals**2).sum(axis=1).mean())),
        "sigma0_ratio": 1.0,
        **{f"point_sigma_{axis}_rms_m": float(spreads[i]) for i, axis in enumerate("xyz")},
        "extent_m": extent,
        "relative_precision_ratio": extent / float(np.sqrt((sigma**2).mean())),
        "rejected_image_points_count": int(refused.size),
    }
    texts = {"datum": "inner constraints over all targets", "rejected": f"{refused.size} items, see rejected.csv"}
    write_summary(folder / "summary.json", Summary("photogrammetry", "large network", numbers, texts))


def report(folder: Path) -> None:
    """Time the command and print its files beside what is asked."""
    environment = {**os.environ, **THREADS, "PYTHONPATH": str(ROOT)}
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, "-m", "heliogauge", "report", str(folder)], check=True, env=environment)
    after, wall_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - start
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    peak_gb = after.ru_maxrss / 1e6
    print(f"heliogauge report: {wall_s:.1f} s, CPU {cpu_s:.1f} s (asked: {ASKED_S:.0f} s), peak {peak_gb:.2f} GB")
    for name in ("report.html", "report.ipynb"):
        print(f"{name}: {(folder / name).stat().st_size / 1e6:.2f} MB (asked: {ASKED_MB:.0f} MB)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("which", nargs="?", choices=("marks", "targets"), default="marks")
    parser.add_argument("--keep", type=Path, help="folder that keeps the results")
    chosen = parser.parse_args()
    sizes = (COUNT, 60, 5 * COUNT) if chosen.which == "marks" else (1000, 100, COUNT)
    with tempfile.TemporaryDirectory() as scratch:
        folder = chosen.keep or Path(scratch)
        folder.mkdir(exist_ok=True)
        drawn = draw_network(*sizes)
        write_results(folder, drawn)
        print(f"{len(drawn.points_m):,} points, {len(drawn.poses)} photos, {len(drawn.photo):,} image points")
        report(folder)


if __name__ == "__main__":
    main()
