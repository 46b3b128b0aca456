"""Intercept factor of the SolTrace reference trough by three ways, and rays per second beside one call per ray.

Run with one thread: ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/intercept.py [rays]``.
"""

import sys
import time

import numpy as np
from scipy.special import ndtri

from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.sunlight.sun_shapes import BuieSun, GaussianSun
from observer.light import (
    Case,
    Sunlight,
    beam_profile,
    beam_spread,
    gaussian_short_form,
    measured_trough,
    optics_of,
    sun_profile,
    trace_intercept,
)
from observer.trough import AbsorberPath, Collector

TROUGH = Collector(5.774, 4.0, 1.71, 0.070)
SUN = GaussianSun(2.73e-3)
#: Slope error per axis [rad]; intercept factor by SolTrace's own core (1e5 hits); closed form.
REFERENCE = ((2e-3, 0.9979, 0.9980), (3e-3, 0.9828, 0.9827), (4e-3, 0.9443, 0.9442), (6e-3, 0.8228, 0.8225))
NODES = (1000, 300)


def trough_map(sigma_rad, rng):
    """Return a trough whose slope errors are exactly Gaussian in each column, across and along."""
    quantiles = sigma_rad * ndtri((np.arange(NODES[0]) + 0.5) / NODES[0])
    across, along = (rng.permuted(np.tile(quantiles[:, None], (1, NODES[1])), axis=0) for _ in range(2))
    x = ((np.arange(NODES[1]) + 0.5) / NODES[1] - 0.5) * TROUGH.aperture_width_m
    y = ((np.arange(NODES[0]) + 0.5) / NODES[0] - 0.5) * TROUGH.length_m
    zero = np.zeros(NODES)
    design = zero + x / (2 * TROUGH.focal_length_m)
    return SlopeMap(
        x_m=x,
        y_m=y,
        slope_x=np.tan(np.arctan(design) - across),
        slope_y=np.tan(along),
        design_slope_x=design,
        design_slope_y=zero,
        sigma_random_x=zero,
        sigma_random_y=zero,
        noise_correlation=1.0,
        common=no_common_modes(),
        height_m=zero + np.nan,
        flags=zero,
        aperture=zero == 0,
        design="trough",
        frame="trough",
        removed="nothing",
    )


def trace_one_by_one(mirror, rays, rng):
    """Count with small vectors, ray by ray: how it is usually first written."""
    sun = SUN.sample(rng, rays)
    met = 0
    for ray in range(rays):
        row, column = rng.integers(NODES[0]), rng.integers(NODES[1])
        x = mirror.x_m[column]
        point = np.array([x, mirror.y_m[row], x**2 / (4 * TROUGH.focal_length_m)])
        normal = np.array([-mirror.slope_x[row, column], -mirror.slope_y[row, column], 1.0])
        normal /= np.linalg.norm(normal)
        light = np.array([sun[ray, 0], sun[ray, 1], 1.0])
        light /= np.linalg.norm(light)
        beam = 2 * (normal @ light) * normal - light
        beside = -point[0] * beam[2] - (TROUGH.focal_length_m - point[2]) * beam[0]
        met += abs(beside) < TROUGH.absorber_diameter_m / 2 * np.hypot(beam[0], beam[2])
    return met / rays


def main():
    rays = int(float(sys.argv[1])) if len(sys.argv) > 1 else 4_000_000
    rng = np.random.Generator(np.random.SFC64(1))
    tube = AbsorberPath.straight(0.0, TROUGH.focal_length_m, TROUGH.length_m / 2)
    sun = sun_profile(SUN)
    print(f"trough of f = 1.71 m, aperture 5.774 m, tube 70 mm; Gaussian sun 2.73 mrad; {rays:.2g} rays")
    print(
        f"{'slope error':>12}{'SolTrace':>10}{'closed':>9}{'integral':>10}{'pooled':>9}{'short form':>12}"
        f"{'rays':>9}{'+-':>9}{'worst - ref':>13}"
    )
    for sigma, soltrace, closed in REFERENCE:
        mirror = trough_map(sigma, rng)
        optics = optics_of(measured_trough(mirror, tube, TROUGH), Case.AS_MEASURED, beam_profile(sun))
        short = gaussian_short_form(TROUGH, sun, sigma_r_rad=sigma)
        traced = trace_intercept(mirror, tube, 0.07, Sunlight(SUN), rays=rays, rng=rng)
        found = (optics.ratio(), beam_spread(optics).ratio, short, traced.ratio)
        worst = max(found, key=lambda one, closed=closed: abs(one - closed)) - closed
        print(
            f"{1e3 * sigma:9.0f} mrad{soltrace:10.4f}{closed:9.4f}{found[0]:10.5f}{found[1]:9.5f}{found[2]:12.5f}"
            f"{found[3]:9.5f}{traced.sampling_sigma:9.5f}{worst:13.5f}"
        )

    few = 20_000
    start = time.process_time()
    trace_one_by_one(mirror, few, rng)
    baseline = few / (time.process_time() - start)
    print(f"\n{'':44}{'million rays/s':>15}{'x per-ray loop':>16}")
    print(f"{'numpy, one call per ray':44}{baseline / 1e6:15.3f}{1:16.0f}")
    bent = AbsorberPath(
        np.array([-2.0, 0.0, 2.0]), np.array([0.0, 3e-3, 0.0]), 1.71 - np.array([0, 8e-3, 0]), 0 * np.eye(6)
    )
    cases = {
        "straight tube": (tube, Sunlight(SUN)),
        "sagging tube": (bent, Sunlight(SUN)),
        "sagging tube, Buie sun, scatter, tracking": (bent, Sunlight(BuieSun.of_share(0.05), 1e-3, 2e-3)),
    }
    for name, (path, light) in cases.items():
        start = time.process_time()
        trace_intercept(mirror, path, 0.07, light, rays=rays, rng=rng)
        rate = rays / (time.process_time() - start)
        print(f"{name:44}{rate / 1e6:15.1f}{rate / baseline:16.0f}")


if __name__ == "__main__":
    main()
