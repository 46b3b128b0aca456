"""Measurement folders of image points of networks with known truth, for the whole way from files to results."""

import json
from pathlib import Path

import numpy as np

from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.writer import dump_toml
from heliogauge.results.tables import read_table_csv
from heliogauge.running.cli import main
from photogrammetry.bundle.state import BundleState
from photogrammetry.exchange.image_point_files import write_image_points_csv
from tests.photogrammetry.bundle_networks import look_at


def write_job(folder: Path, points, **content) -> Path:
    """Write image points and measurement.toml."""
    folder.mkdir(parents=True, exist_ok=True)
    write_image_points_csv(folder / "image_points.csv", points)
    base = {"kind": "photogrammetry", "name": "job", "image_points": {}}
    (folder / "measurement.toml").write_text(dump_toml({**base, **content}))
    return folder


def command(folder: Path, out: Path) -> int:
    """Run the command; return its exit code."""
    try:
        main(["photogrammetry", "measure", str(folder), "-o", str(out), "--no-report", "--quiet"])
    except SystemExit as left:
        return int(left.code or 0)
    return 0


def summary_of(out: Path) -> dict:
    """Read summary.json."""
    return json.loads((out / "summary.json").read_text())


def points_of(out: Path) -> dict[str, np.ndarray]:
    """Read coordinates by name."""
    table = read_table_csv(out / "points.csv")
    values = np.array([[float(cell or "nan") for cell in table[f"{axis}_m"]] for axis in "xyz"]).T
    return dict(zip(table["id"], values, strict=True))


def sigmas_of(out: Path) -> dict[str, np.ndarray]:
    """Read sigmas by name."""
    table = read_table_csv(out / "points.csv")
    values = np.array([[float(cell or "nan") for cell in table[f"sigma_{axis}_m"]] for axis in "xyz"]).T
    return dict(zip(table["id"], values, strict=True))


def length(truth, a: int, b: int) -> float:
    return float(np.linalg.norm(truth.points_m[a] - truth.points_m[b]))


def views(rng, centers, points_m, cameras) -> BundleState:
    """Photos from given places, each with its own roll, towards the middle."""
    poses = [
        look_at(np.array(center), rng.uniform(-0.3, 0.3, 3), (i % 4) * np.pi / 2) for i, center in enumerate(centers)
    ]
    rotations, shifts = np.stack([p.rotation for p in poses]), np.stack([p.translation_m for p in poses])
    return BundleState(tuple(cameras), rotations, shifts, points_m)


def fitted(found: dict[str, np.ndarray], truth: np.ndarray) -> np.ndarray:
    """Differences from the truth after the best rigid motion; targets are called t0, t1, ..."""
    names = sorted(found, key=lambda name: int(name[1:]))
    own, far = np.array([found[name] for name in names]), truth[[int(name[1:]) for name in names]]
    left, _, right = np.linalg.svd((own - own.mean(axis=0)).T @ (far - far.mean(axis=0)))
    turn = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
    return (own - own.mean(axis=0)) - (far - far.mean(axis=0)) @ turn.T


def identity() -> RigidTransform:
    return RigidTransform.identity()
