"""Calibration of a camera: residuals on real photos beside OpenCV in the same run, errors against sigma on drawn ones.

Run with ``OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/camera_calibration.py [seeds]``.
"""

import json
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from calibration.camera.pipeline import Options, run
from data_synth.board_scene import board_scene, board_table
from data_synth.target_dataset import PhotoOptions, camera_content, write_target_dataset
from heliogauge.camera import PARAMETER_NAMES
from heliogauge.measurement import load_camera_calibration

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
REAL = {
    "six photos, 18 x 23 corners": ("opencsp/camera_calibration", "*.png", 18, 23),
    "OpenCV's left01..14, 9 x 6 corners": ("photogrammetry/opencv_chessboard", "*.jpg", 9, 6),
}
FREE = [0, 1, 2, 3, 5, 6, 7, 8, 9]


def opencv(files: list[Path], columns: int, rows: int) -> tuple[float, float]:
    """RMS and CPU time of OpenCV's usual recipe."""
    begin = time.process_time()
    grid = np.zeros((columns * rows, 3), np.float32)
    grid[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2)
    corners = []
    for file in files:
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        found, points = cv2.findChessboardCorners(image, (columns, rows))
        if found:
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
            corners.append(cv2.cornerSubPix(image, points, (11, 11), (-1, -1), stop))
    rms = cv2.calibrateCamera([grid] * len(corners), corners, image.shape[::-1], None, None)[0]
    return rms, time.process_time() - begin


def real(folder: Path) -> None:
    for name, (place, pattern, columns, rows) in REAL.items():
        files = sorted((SHARED / place).glob(pattern))
        if not files:
            print(f"{name}: not here, skipped")
            continue
        own = folder / place
        own.mkdir(parents=True)
        for file in files:
            shutil.copy(file, own)
        (own / "measurement.toml").write_text(
            f'kind = "camera"\nname = "{name}"\n[board]\ntype = "chessboard"\ncolumns = {columns}\nrows = {rows}\n'
            f'[images]\nphotos = "{pattern}"\n'
        )
        begin = time.process_time()
        result = run(load_camera_calibration(own), Options(jobs=1))
        own_s = time.process_time() - begin
        rms, cv_s = opencv(files, columns, rows)
        quality = result.quality
        print(f"{name}: {len(result.photos)} photos, {len(quality.rejected)} points rejected")
        print(f"  RMS, board estimated             {quality.rms_px:.4f} px")
        print(f"  RMS, board as drawn              {quality.rms_as_drawn_px:.4f} px (OpenCV {rms:.4f})")
        print(f"  photos kept apart, pose fitted   {result.kept_apart_px:.4f} px")
        print("    each " + " ".join(f"{photo.kept_apart_px:.4f}" for photo in result.photos))
        print(f"  CPU {own_s:.1f} s with the photos kept apart (OpenCV {cv_s:.1f} s)")


def drawn(folder: Path, seeds: int) -> None:
    for kind in ("chessboard", "charuco", "circles-asymmetric"):
        shares, rms = [], []
        for seed in range(seeds):
            own = folder / f"{kind}{seed}"
            scene = board_scene(kind, seed, n_photos=10)
            write_target_dataset(own, scene, camera_content(scene, board_table(kind)), PhotoOptions(seed))
            result = run(load_camera_calibration(own), Options(leave_one_out=False))
            truth = json.loads((own / "truth.json").read_text())["camera"]
            error = (result.camera.parameters - [truth.get(name, 0.0) for name in PARAMETER_NAMES])[FREE]
            covariance = result.camera.covariance[np.ix_(FREE, FREE)]
            shares.append(error @ np.linalg.solve(covariance, error) / len(FREE))
            rms.append(result.quality.rms_px)
            shutil.rmtree(own)
        spread = np.sqrt(2 / (len(FREE) * seeds))
        print(
            f"{kind}: RMS {np.mean(rms):.4f} px; chi-square of the nine intrinsics' errors over its expectation "
            f"{np.mean(shares):.2f} (1 +- {spread:.2f}), {seeds} scenes of 10 photos"
        )


def main() -> None:
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":
        print("(OPENBLAS_NUM_THREADS=1 is not set: CPU times hold the waiting of idle threads)")
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        real(Path(folder))
        drawn(Path(folder), int(sys.argv[1]) if len(sys.argv) > 1 else 5)


if __name__ == "__main__":
    main()
