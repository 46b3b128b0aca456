"""Calibration of a camera: residuals on real photos beside OpenCV in the same run, errors against sigma on drawn ones.

Run with ``OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/camera_calibration.py [seeds]``.
"""

import json
import os
import shutil
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from bundle import look_at

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from calibration.camera import BoardPoints, Chessboard, Options, find_chessboard, run
from data_synth.optics import Sheet, chessboard_print
from data_synth.targets import (
    PhotoOptions,
    board_scene,
    board_table,
    camera_content,
    render_photo,
    target_scene,
    write_target_dataset,
)
from heliogauge.camera.model import PARAMETER_NAMES
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.load import load

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
REAL = {
    "six photos, 18 x 23 corners": ("opencsp/camera_calibration", "*.png", 18, 23),
    "OpenCV's left01..14, 9 x 6 corners": ("photogrammetry/opencv_chessboard", "*.jpg", 9, 6),
}
FREE = [0, 1, 2, 3, 5, 6, 7, 8, 9]


def opencv(files: list[Path], columns: int, rows: int, window: int = 11) -> tuple[float, float, float]:
    """RMS, focal length and CPU time of OpenCV's usual recipe."""
    begin = time.process_time()
    corners = []
    for file in files:
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        found, points = cv2.findChessboardCorners(image, (columns, rows))
        if found:
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
            corners.append(cv2.cornerSubPix(image, points, (window, window), (-1, -1), stop))
    rms, focal = opencv_adjustment(corners, columns, rows, image.shape[::-1])
    return rms, focal, time.process_time() - begin


def opencv_adjustment(corners: list[np.ndarray], columns: int, rows: int, size: tuple[int, int]) -> tuple[float, float]:
    """RMS and focal length of OpenCV's adjustment, whose board is flat and square."""
    grid = np.zeros((columns * rows, 3), np.float32)
    grid[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2)
    rms, matrix, *_ = cv2.calibrateCamera([grid] * len(corners), corners, size, None, None)
    return rms, float(matrix[0, 0])


def corners_of(points: BoardPoints, board: Chessboard) -> np.ndarray | None:
    """Our corners as OpenCV wants them, None where one is missing."""
    if points.n != board.columns * board.rows:
        return None
    return points.pixels_px.astype(np.float32)[:, None]


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
        result = run(load(own), Options(jobs=1))
        own_s = time.process_time() - begin
        rms, focal, cv_s = opencv(files, columns, rows)
        board = Chessboard(columns, rows)
        images = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files]
        ours = [
            corners_of(find_chessboard(file.name, image, board), board)
            for file, image in zip(files, images, strict=True)
        ]
        whole = [one for one in ours if one is not None]
        own_rms, own_focal = opencv_adjustment(whole, columns, rows, images[0].shape[::-1])
        quality = result.quality
        print(f"{name}: {len(result.photos)} photos, {len(quality.rejected)} points rejected")
        print(f"  RMS, board estimated             {quality.rms_px:.4f} px")
        print(f"  RMS, board as drawn              {quality.rms_as_drawn_px:.4f} px")
        print(
            f"  focal length                     {result.camera.focal_x_px:.3f} px, sigma "
            f"{result.camera.sigma_parameters[0]:.3f}"
        )
        print(f"  OpenCV's corners and adjustment  {rms:.5f} px, focal length {focal:.3f} px")
        narrow = opencv(files, columns, rows, 5)
        print(f"  the same, windows of 5           {narrow[0]:.5f} px, focal length {narrow[1]:.3f} px")
        print(
            f"  our corners, OpenCV's adjustment {own_rms:.5f} px, focal length {own_focal:.3f} px "
            f"({len(whole)} photos without a missing corner)"
        )
        print(f"  photos kept apart, pose fitted   {result.kept_apart_px:.4f} px")
        print("    each " + " ".join(f"{photo.kept_apart_px:.4f}" for photo in result.photos))
        print(f"  CPU {own_s:.1f} s with the photos kept apart (OpenCV {cv_s:.1f} s)")


def drawn(folder: Path, seeds: int) -> None:
    for kind in ("chessboard", "charuco", "circles-asymmetric", "targets"):
        shares, rms = [], []
        for seed in range(seeds):
            own = folder / f"{kind}{seed}"
            scene = board_scene(kind, seed, n_photos=10)
            write_target_dataset(own, scene, camera_content(scene, board_table(kind)), PhotoOptions(seed))
            result = run(load(own), Options(leave_one_out=False))
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


def large(folder: Path) -> None:
    """CPU time for one photo of 24 megapixel beside decoding it."""
    single = target_scene("single")
    pose = look_at(np.array([0.15, 0.2, 0.75]), np.zeros(3), 0.1)
    view = replace(single.views[0], cam_from_world=pose)
    for columns, rows, side in ((9, 6, 0.06), (20, 19, 0.028)):
        sheet = Sheet("", chessboard_print(columns + 1, rows + 1, side), RigidTransform.identity())
        scene = replace(single, sheets=(sheet,), views=(view,)).with_sensor(blur_sigma_px=0.8)
        file = folder / f"large{columns}.jpg"
        cv2.imwrite(str(file), render_photo(scene, view, np.random.default_rng(0)), [cv2.IMWRITE_JPEG_QUALITY, 92])
        decode, find, ours = [], [], []
        for _ in range(3):
            begin = time.process_time()
            image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
            decode.append(time.process_time() - begin)
            begin = time.process_time()
            cv2.findChessboardCorners(image, (columns, rows))
            find.append(time.process_time() - begin)
            begin = time.process_time()
            find_chessboard(file.name, image, Chessboard(columns, rows))
            ours.append(time.process_time() - begin)
        print(
            f"{image.shape[1]} x {image.shape[0]} px, {columns} x {rows} corners: decode {min(decode):.2f} s, OpenCV "
            f"finds in {min(find):.2f} s, found and fitted in {min(ours):.2f} s = {min(ours) / min(decode):.1f} decodes"
        )


def main() -> None:
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":
        print("(OPENBLAS_NUM_THREADS=1 is not set: CPU times hold the waiting of idle threads)")
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        real(Path(folder))
        large(Path(folder))
        drawn(Path(folder), int(sys.argv[1]) if len(sys.argv) > 1 else 5)


if __name__ == "__main__":
    main()
