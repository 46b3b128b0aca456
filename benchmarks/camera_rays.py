"""Lines of sight of all pixels of a 1624 x 1232 camera: CPU time, memory and error, beside OpenCV in the same run.

Run with ``OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/camera_rays.py``.
"""

import time
import tracemalloc

import cv2
import numpy as np

from heliogauge.camera.formats import from_opencv

WIDTH_PX, HEIGHT_PX = 1624, 1232
LENSES = {
    "mild, radial": (1500.0, (-0.10, 0.02, 0, 0, 0)),
    "strong, tangential": (1500.0, (-0.25, 0.12, 1e-3, -5e-4, -0.02)),
    "wide angle": (1000.0, (-0.2646, 0.065, 0, 0, -0.006)),
}


def cpu_seconds(function, repeats=5):
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        function()
        times.append(time.process_time() - begin)
    return min(times)


def main():
    cv2.setNumThreads(1)
    pixels = np.stack(np.meshgrid(np.arange(float(WIDTH_PX)), np.arange(float(HEIGHT_PX))), axis=-1)
    print("| lens | cast_rays CPU s | error px | memory beyond result MiB | OpenCV default CPU s | error px |")
    print("|---|---|---|---|---|---|")
    for name, (focal, coefficients) in LENSES.items():
        matrix = np.array([[focal, 0, (WIDTH_PX - 1) / 2], [0, focal, (HEIGHT_PX - 1) / 2], [0, 0, 1]])
        distortion = np.array(coefficients, dtype=float)
        camera = from_opencv(matrix, distortion, (WIDTH_PX, HEIGHT_PX))
        flat = pixels.reshape(-1, 1, 2)
        own = cpu_seconds(lambda camera=camera: camera.cast_rays(pixels))
        peer = cpu_seconds(lambda flat=flat, k=matrix, d=distortion: cv2.undistortPoints(flat, k, d), 2)
        error = np.abs(camera.project(camera.cast_rays(pixels)) - pixels).max()
        ideal = cv2.undistortPoints(flat, matrix, distortion)[:, 0]
        reprojected = camera.project(np.concatenate((ideal, np.ones((ideal.shape[0], 1))), axis=1))
        peer_error = np.hypot(*(reprojected - pixels.reshape(-1, 2)).T).max()
        tracemalloc.start()
        rays = camera.cast_rays(pixels)
        memory = (tracemalloc.get_traced_memory()[1] - rays.nbytes) / 2**20
        tracemalloc.stop()
        print(f"| {name} | {own:.3f} | {error:.1e} | {memory:.1f} | {peer:.3f} | {peer_error:.1e} |")


if __name__ == "__main__":
    main()
