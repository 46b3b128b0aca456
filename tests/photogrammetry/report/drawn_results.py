"""A small folder of a network's results, written directly: what a report must say is then known beforehand."""

from pathlib import Path

import cv2
import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.flags import SampleFlag
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
from tests.photogrammetry.bundle_networks import camera_of, look_at

NASTY = "a$\\bad{$b <script>alert(1)</script>"
PHOTOS = ("one.png", "two.png", "three.png")
LEFT_OUT = "dark.png"
DOUBT = Doubt("photo_not_in_network", f"photo {LEFT_OUT} is left out: shows 2 targets, 4 are needed")


def write_network(folder: Path, *, doubts: tuple[Doubt, ...] = (DOUBT,), seed: int = 1) -> Summary:
    """Write 12 points in 3 photos, one more target without coordinates, and a photo that is left out."""
    rng = np.random.default_rng(seed)
    names = [f"t{i}" for i in range(11)] + [NASTY]
    points = rng.uniform(-0.5, 0.5, (12, 3))
    sigma = rng.uniform(1e-5, 3e-5, (12, 3))
    nowhere = np.full((1, 3), np.nan)
    flags = [0] * 12 + [int(SampleFlag.NOT_SEEN)]
    table = PointTable(
        [*names, "lost"], np.vstack([points, nowhere]), np.vstack([sigma, nowhere]), [3] * 12 + [0], flags
    )
    write_points_csv(folder / "points.csv", table)
    covariance = {f"{axis * 2}_m2": sigma[:, i] ** 2 for i, axis in enumerate("xyz")}
    covariance |= {f"{pair}_m2": np.zeros(12) for pair in ("xy", "xz", "yz")}
    write_table_csv(folder / "points_covariance.csv", {"id": names, **covariance})
    camera = camera_of()
    poses = [look_at(np.array([3 * np.cos(a), 3 * np.sin(a), 2.0]), np.zeros(3), a) for a in (0.0, 2.0, 4.0)]
    pixels = np.concatenate([camera.project(pose.apply(points)) for pose in poses])
    residuals = rng.normal(0, 0.05, pixels.shape)
    rms = np.sqrt((residuals.reshape(3, -1, 2) ** 2).sum(axis=2).mean(axis=1))
    write_cameras_json(
        folder / "cameras.json",
        {"camera": camera},
        {
            name: PhotoPose("camera", pose, np.eye(6) * 1e-10, float(size))
            for name, pose, size in zip(PHOTOS, poses, rms, strict=True)
        },
    )
    count = len(pixels)
    same = {
        f"{name}_{axis}{unit}": np.full(count, value)
        for name, unit, value in (("sigma", "_px", 0.05), ("redundancy", "", 0.6))
        for axis in "xy"
    }
    write_table_csv(
        folder / "residuals.csv",
        {
            "image": np.repeat(PHOTOS, 12).tolist(),
            "target": names * 3,
            "x_px": pixels[:, 0],
            "y_px": pixels[:, 1],
            "residual_x_px": residuals[:, 0],
            "residual_y_px": residuals[:, 1],
            **same,
        },
    )
    write_table_csv(
        folder / "rejected.csv",
        {
            "name": [f"target {NASTY} in {PHOTOS[0]}", LEFT_OUT],
            "reason": ["contradicts the others, residual 4.20 px", "shows 2 targets, 4 are needed"],
            "is_outlier": [1, 0],
            "image": [PHOTOS[0], ""],
            "x_px": [100.0, np.nan],
            "y_px": [200.0, np.nan],
        },
    )
    bar = {"known_m": [0.5], "sigma_known_m": [1e-5], "measured_m": [0.50001], "sigma_measured_m": [2e-5]}
    ends = {"name": ["distance t0 - t1"], "target_a": ["t0"], "target_b": ["t1"], "used": [1]}
    write_table_csv(folder / "constraints.csv", {**ends, **bar, "error_m": [1e-5]})
    error = {"error_m": [1e-5], "sigma_error_m": [2e-5], "permissible_m": [np.nan], "verdict": [""]}
    write_table_csv(
        folder / "lengths.csv", {"name": ["distance t0 - t1"], "role": ["left out"], "line": ["1"], **bar, **error}
    )
    write_table_csv(
        folder / "intrinsics.csv",
        {
            "camera": ["camera"],
            "name": ["focal_px"],
            "value": [6100.0],
            "sigma": [0.5],
            "significance": [np.nan],
            "rival": ["k1"],
            "correlation": [-0.7],
        },
    )
    picture = cv2.GaussianBlur(rng.integers(0, 255, (200, 300)).astype(np.uint8), (0, 0), 2)
    write_thumbnails(folder, dict.fromkeys((*PHOTOS, LEFT_OUT), make_thumbnail(picture)))
    rms_m = np.sqrt((sigma**2).mean(axis=0))
    numbers = {
        "points_count": 12,
        "photos_count": 3,
        "image_points_count": count,
        "image_residual_rms_px": float(np.sqrt((residuals**2).sum(axis=1).mean())),
        "sigma0_ratio": 1.02,
        **{f"point_sigma_{axis}_rms_m": float(rms_m[i]) for i, axis in enumerate("xyz")},
        "length_error_left_out_rms_m": 1e-5,
        "length_error_left_out_sigma_ratio": 0.5,
        "left_out_photos_count": 1,
        "left_out_points_count": 1,
    }
    summary = Summary("photogrammetry", NASTY, numbers, {"datum": "inner constraints"}, doubts)
    write_summary(folder / "summary.json", summary)
    return summary
