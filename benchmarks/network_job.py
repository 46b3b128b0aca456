"""An industrial job through the whole command: 100 photos, 90,000 image points, camera in millimetres, one scale bar.

Run: OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/network_job.py [PHOTOS TARGETS [SHARE]]
SHARE of the targets that a photo could show are seen in it (default 1).
The lens is AICON's (A1 to A3 with r0, B1, B2, C1, C2), all ten parameters free, from a start 2 % off; image points come
from the formulas of `heliogauge.camera.millimetres` on a numeric network. Prints what the command needs and how far the
coordinates are from the truth, beside their sigmas.
"""

import json
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bundle import HEIGHT, SIGMA_PX, WIDTH, look_at

from heliogauge.camera.millimetres import LensForm, Sensor, SensorParameters
from heliogauge.measurement.writer import dump_toml
from heliogauge.results.tables import read_table_csv, write_table_csv
from heliogauge.running.cli import main as command
from photogrammetry import ImagePoints

SENSOR = Sensor(WIDTH, HEIGHT, 0.006, LensForm.AICON, zero_radius_mm=14.0)
VALUES = np.array([33.7, 0.06, -0.05, -4e-5, 5e-8, -1e-11, 4e-6, -7e-6, 1e-4, -5e-5])
FREE = ["focal_px", "aspect", "center_x_px", "center_y_px", "skew", "k1", "k2", "k3", "p1", "p2"]


def write_folder(folder: Path, n_photos: int, n_targets: int, share: float = 1.0) -> np.ndarray:
    """Write image points with noise and measurement.toml; return the true coordinates."""
    rng = np.random.default_rng(0)
    targets = np.column_stack([rng.uniform(-4, 4, (n_targets, 2)), rng.uniform(-0.6, 0.6, n_targets)])
    camera = SensorParameters(SENSOR, VALUES).camera()
    photo, target, pixels = [], [], []
    for i, angle in enumerate(6 * np.pi * np.arange(n_photos) / n_photos):
        center = np.array([7 * np.cos(angle), 7 * np.sin(angle), 5 + 2 * (i % 3)])
        pose = look_at(center, rng.uniform(-0.5, 0.5, 3), (i % 4) * np.pi / 2)
        seen = camera.project(pose.apply(targets))
        inside = np.nonzero(((seen > 0) & (seen < [WIDTH - 1, HEIGHT - 1])).all(axis=1))[0]
        # The first targets are the scale bar's.
        inside = inside[(rng.uniform(size=inside.size) < share) | (inside < 2)] if share < 1 else inside
        photo.append(np.full(inside.size, i))
        target.append(inside)
        pixels.append(seen[inside] + rng.normal(0, SIGMA_PX, (inside.size, 2)))
    names = tuple(f"photo{i}" for i in range(n_photos)), tuple(str(i) for i in range(n_targets))
    covariance = np.broadcast_to(np.eye(2) * SIGMA_PX**2, (sum(map(len, target)), 2, 2))
    table = ImagePoints(*names, np.concatenate(photo), np.concatenate(target), np.concatenate(pixels), covariance)
    columns = {
        "image": [table.photos[i] for i in table.photo_index],
        "target": [table.targets[i] for i in table.target_index],
        "x_px": table.pixels_px[:, 0],
        "y_px": table.pixels_px[:, 1],
        "sigma_x_px": np.full(table.n, SIGMA_PX),
        "sigma_y_px": np.full(table.n, SIGMA_PX),
    }
    write_table_csv(folder / "image_points.csv", columns)
    length_m = float(np.linalg.norm(targets[0] - targets[1]))
    content = {
        "kind": "photogrammetry",
        "name": "job",
        "image_points": {},
        "camera": {
            "width_px": WIDTH,
            "height_px": HEIGHT,
            "free": FREE,
            "residuals": "corrected",
            "distortion_direction": "measured_to_ideal",
            "millimetres": {"form": "aicon", "pixel_mm": 0.006, "focal_mm": 33.0, "zero_radius_mm": 14.0},
        },
        "scale_bar": [{"a": "0", "b": "1", "length_m": length_m, "sigma_mm": 0.001}],
    }
    (folder / "measurement.toml").write_text(dump_toml(content), encoding="utf-8")
    return targets


def main() -> None:
    n_photos, n_targets = (int(one) for one in sys.argv[1:3]) if len(sys.argv) > 2 else (100, 1000)
    share = float(sys.argv[3]) if len(sys.argv) > 3 else 1.0
    with tempfile.TemporaryDirectory() as place:
        folder, out = Path(place) / "in", Path(place) / "out"
        folder.mkdir()
        truth = write_folder(folder, n_photos, n_targets, share)
        begin = time.process_time()
        try:
            command(["photogrammetry", "measure", str(folder), "-o", str(out), "--no-report"])
        except SystemExit:
            print(f"CPU {time.process_time() - begin:.1f} s without the report, ", end="")
        print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")
        print(json.loads((out / "summary.json").read_text(encoding="utf-8"))["durations_s"])
        table, lens = read_table_csv(out / "points.csv"), read_table_csv(out / "camera_millimetres.csv")
    # Targets that one photo shows have no coordinates.
    found = [place for place, cell in enumerate(table["x_m"]) if cell]
    own = np.array([[float(table[f"{axis}_m"][place]) for place in found] for axis in "xyz"]).T
    sigma = np.array([[float(table[f"sigma_{axis}_m"][place]) for place in found] for axis in "xyz"]).T
    far = truth[[int(table["id"][place]) for place in found]]
    own, far = own - own.mean(axis=0), far - far.mean(axis=0)
    left, _, right = np.linalg.svd(own.T @ far)
    errors = own - far @ (left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right).T
    rms = (1e6 * np.sqrt((errors**2).mean()), 1e6 * np.sqrt((sigma**2).mean()))
    print(f"coordinates: error {rms[0]:.2f} um RMS, sigma {rms[1]:.2f} um")
    for name, value, spread, true in zip(lens["name"], lens["value"], lens["sigma"], VALUES, strict=True):
        print(f"{name:15} {float(value): .6e}   error over sigma {(float(value) - true) / float(spread):5.2f}")


if __name__ == "__main__":
    main()
