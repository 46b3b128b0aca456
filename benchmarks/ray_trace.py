"""Rays per second of `heliogauge.sunlight.beam.trace` on one core, beside one Python call per ray in the same run.

Run with one thread: ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/ray_trace.py [rays]``.
"""

import sys
import time

import numpy as np

from heliogauge.geometry.surfaces import paraboloid
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.sunlight.beam import Illumination, facing_target, trace
from heliogauge.sunlight.sun_shapes import BuieSun, GaussianSun, PillboxSun

#: Rays per second known for the incumbent (OpenCSP) on one core; not measured here.
INCUMBENT_RAYS_PER_S = 31e3
FOCAL_LENGTH_M = 100.0
NODES = 400


def noisy_facet(rng):
    x = np.linspace(-0.6, 0.6, NODES)
    height, slope_x, slope_y = paraboloid(FOCAL_LENGTH_M).height_and_gradient(*np.meshgrid(x, x))
    error = rng.normal(0, 1e-3, (2, NODES, NODES))
    zero = np.zeros((NODES, NODES))
    return SlopeMap(
        x_m=x,
        y_m=x,
        slope_x=slope_x + error[0],
        slope_y=slope_y + error[1],
        design_slope_x=slope_x,
        design_slope_y=slope_y,
        sigma_random_x=zero,
        sigma_random_y=zero,
        noise_correlation=1.0,
        common=no_common_modes(),
        height_m=height,
        flags=zero,
        aperture=zero == 0,
        design="paraboloid of focal length 100 m",
        frame="facet",
        removed="nothing",
    )


def trace_one_by_one(slope_map, sun, rays, rng):
    """Trace with small numpy vectors, ray by ray: how it is usually first written, and an independent answer."""
    image = np.zeros((256, 256))
    offsets = sun.sample(rng, rays)
    hits = np.zeros((rays, 2))
    for ray in range(rays):
        row, column = rng.integers(NODES), rng.integers(NODES)
        point = np.array([slope_map.x_m[column], slope_map.y_m[row], slope_map.height_m[row, column]])
        normal = np.array([-slope_map.slope_x[row, column], -slope_map.slope_y[row, column], 1.0])
        normal /= np.linalg.norm(normal)
        light = np.array([offsets[ray, 0], offsets[ray, 1], 1.0])
        light /= np.linalg.norm(light)
        beam = 2 * (normal @ light) * normal - light
        hit = point + beam * (FOCAL_LENGTH_M - point[2]) / beam[2]
        hits[ray] = hit[:2]
        pixel = np.floor((hit[:2] + 1.5) / 3.0 * 256).astype(int)
        if (pixel >= 0).all() and (pixel < 256).all():
            image[pixel[1], pixel[0]] += 1
    return hits.std(axis=0)


def main():
    rays = int(float(sys.argv[1])) if len(sys.argv) > 1 else 10_000_000
    rng = np.random.Generator(np.random.SFC64(1))
    slope_map = noisy_facet(rng)
    target = facing_target(FOCAL_LENGTH_M, 3.0)

    few = 20_000
    start = time.process_time()
    spread = trace_one_by_one(slope_map, PillboxSun(), few, rng)
    baseline = few / (time.process_time() - start)

    lights = {
        "pillbox 4.65 mrad": Illumination(PillboxSun()),
        "Gaussian 2.73 mrad": Illumination(GaussianSun(2.73e-3)),
        "Buie CSR 5 %": Illumination(BuieSun.of_share(0.05)),
        "Buie CSR 5 %, specularity 1 mrad": Illumination(BuieSun.of_share(0.05), specularity_sigma_rad=1e-3),
    }
    print(f"{'':36}{'million rays/s':>15}{'x per-ray loop':>16}{'x incumbent':>13}{'spread x / m':>14}")
    print(f"{'incumbent (published figure)':36}{INCUMBENT_RAYS_PER_S / 1e6:15.3f}")
    print(f"{'numpy, one call per ray':36}{baseline / 1e6:15.3f}{1:16.0f}{'':13}{spread[0]:14.4f}")
    for name, light in lights.items():
        start = time.process_time()
        spot = trace(slope_map, slope_map.height_m, light, target=target, rays=rays, rng=rng)
        rate = rays / (time.process_time() - start)
        ratios = f"{rate / baseline:16.0f}{rate / INCUMBENT_RAYS_PER_S:13.0f}"
        print(f"{name:36}{rate / 1e6:15.1f}{ratios}{spot.sd_x_m:14.4f}")


if __name__ == "__main__":
    main()
