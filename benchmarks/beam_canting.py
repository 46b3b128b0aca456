"""Canting from flux on drawn beams: error over sigma, which suns tell it, and what a plan promises of it.

    beam_canting.py [few] [many] [plan] [bound]

Mirrors are those of `heliogauge beam synth`: 4 facets of 1.6 m x 1.3 m or 25 of 0.6 m x 0.5 m, 66 m from the target,
canting and slope errors of 0.8 mrad, photos of 300 pixels across the target with noise, panels that differ by 1 %, dark
seams.
"""

import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from _measure import row, title

import heliogauge as hg
from calibration.beam.exchange.surfaces import design_mirror
from calibration.beam.keys import BeamFacetSection
from calibration.beam.mirror.expected_flux import FluxGrid, whole_flux
from calibration.beam.mirror.facets import canted
from calibration.beam.mirror.flux_fit import FluxPhoto, MirrorStand, flux_information
from calibration.beam.pipeline import compare
from calibration.beam.planning import BeamPlanOptions, plan
from data_synth.heliostats import BenchOptions, write_beam_dataset
from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.geometry.target_planes import PlaneTarget
from heliogauge.sunlight.sun_shapes import BuieSun

SEEDS = 24


def fitted(scratch, seed, **options):
    """Return the comparison of a drawn mirror, its error and sigma [mrad], and processor time [s]."""
    folder = Path(scratch) / f"{seed}-{options}"
    write_beam_dataset(folder, BenchOptions(seed=seed, **options))
    began = time.process_time()
    result = compare.run(hg.load(folder))
    spent = time.process_time() - began
    truth = np.array(json.loads((folder / "truth.json").read_text())["canting_rad"])
    after = result.after
    return folder, after, 1e3 * (after.canting_rad - truth), 1e3 * after.sigma_canting_rad, spent


def joint(after, error):
    """Return errors along the axes of their covariance, over their sigmas."""
    values, axes = np.linalg.eigh(1e6 * after.covariance_canting)
    kept = values > 1e-9 * values[-1]
    return (axes[:, kept].T @ error.ravel()) / np.sqrt(values[kept])


def few():
    title("Canting of 4 facets (asked: 0.1 mrad, error/sigma 0.8 to 1.25)", ("RMS error", "error/sigma", "CPU each"))
    for suns in (3, 6):
        with tempfile.TemporaryDirectory() as scratch:
            found = [fitted(scratch, seed, suns=suns) for seed in range(SEEDS)]
        told = [one for one in found if one[1].is_canting_told]
        errors, sigmas = (np.array([one[k] for one in told]) for k in (2, 3))
        row(
            f"{suns} suns, {len(told)} of {SEEDS} mirrors told",
            f"{np.sqrt(np.mean(errors**2)):.3f} mrad",
            f"{np.sqrt(np.mean((errors / sigmas) ** 2)):.2f}",
            f"{np.mean([one[4] for one in found]):.0f} s",
        )
        row(
            "  largest error of a told one",
            f"{np.abs(errors).max():.2f} mrad",
            f"{np.abs(errors / sigmas).max():.1f}",
            "",
        )
        scores = np.concatenate([joint(one[1], one[2]) for one in told])
        row("  all facets of a mirror jointly", "", f"{np.sqrt(np.mean(scores**2)):.2f}", "")


def many():
    title("Canting of 25 facets, 3 suns (asked: 0.1 mrad)", ("RMS error", "RMS sigma", "told"))
    with tempfile.TemporaryDirectory() as scratch:
        for seed in range(2):
            _, after, error, sigma, _ = fitted(scratch, seed, suns=3, facets=(5, 5))
            told = "yes" if after.is_canting_told else "no"
            row(f"mirror {seed}", f"{np.sqrt(np.mean(error**2)):.2f} mrad", f"{np.sqrt(np.mean(sigma**2)):.2f}", told)


def promised():
    title("What `beam plan` promises from 3 suns, against 6 suns taken", ("planned", "error", "ratio"))
    ratios = []
    with tempfile.TemporaryDirectory() as scratch:
        for seed in range(SEEDS):
            folder, *_ = fitted(scratch, seed, suns=3)
            _, after, error, _, _ = fitted(scratch, seed, suns=6)
            later = json.loads((Path(scratch) / f"{seed}-{ {'suns': 6} }" / "truth.json").read_text())
            suns = np.array([one["to_sun"] for one in later["photos"]])
            sigma = 1e3 * plan.promised_rad(plan.run(hg.load(folder), BeamPlanOptions(most=1)), suns)
            if after.is_canting_told:
                ratios.append((sigma, float(np.sqrt(np.mean(error**2)))))
    planned, errors = np.array(ratios).T
    row(
        f"{len(ratios)} mirrors, RMS",
        f"{np.sqrt(np.mean(planned**2)):.3f} mrad",
        f"{np.sqrt(np.mean(errors**2)):.3f} mrad",
        f"{np.sqrt(np.mean((errors / planned) ** 2)):.2f}",
    )


#: Facets along width and height, the mirror's size and its distance [m].
_MIRRORS = (
    ((2, 2), (3.2, 2.6), 66.0),
    ((5, 5), (3.2, 2.6), 66.0),
    ((5, 5), (8.0, 8.0), 66.0),
    ((5, 5), (8.0, 8.0), 150.0),
    ((5, 5), (8.0, 8.0), 400.0),
    ((7, 5), (12.8, 9.5), 400.0),
)
#: Noise of a photo's pixel over the beam's peak (1.5 DN of 170, two thirds of 8 bits), and pixels across the target.
_NOISE_SHARE, _PIXELS = 1.5 / 170, 245


def least_sigma_mrad(facets, size_m, distance_m, suns, frames=1, prior_rad=None):
    """Return the Cramer-Rao bound of a facet's canting, RMS, from the pixels' noise alone [mrad].

    No estimator without knowledge beforehand does better; with a prior it is the bound of a Bayesian one. Curvature,
    scatter, aim, brightness and level of each photo are estimated beside it.
    """
    rng = np.random.default_rng(0)
    width, height = size_m[0] / facets[0], size_m[1] / facets[1]
    k = facets[0] * facets[1]
    x = (np.arange(facets[0]) - 0.5 * (facets[0] - 1)) * width
    y = (np.arange(facets[1]) - 0.5 * (facets[1] - 1)) * height
    centers = np.stack([*(one.ravel() for one in np.meshgrid(x, y)), np.zeros(k)], axis=1)
    turns = 0.8e-3 * rng.standard_normal((k, 2))
    mirror = design_mirror(
        tuple(
            BeamFacetSection(
                center_m=tuple(one.tolist()),
                width_m=0.98 * width,
                height_m=0.98 * height,
                focal_length_m=distance_m,
                canting_mrad=tuple((-1e3 * one[:2] / (2 * distance_m)).tolist()),
            )
            for one in centers
        )
    )
    up = min(38.0, 0.5 * distance_m)
    stand = MirrorStand(np.array([0.14 * distance_m, np.sqrt(0.98 * distance_m**2 - up**2), 2.0]), "azimuth-elevation")
    half = 5e-3 * distance_m + 1.2 * float(np.hypot(*size_m))
    target = PlaneTarget.facing("white", np.array([0.0, 0.0, 2.0 + up]), 0.0, 2 * half, 2 * half)
    step = 4.65e-3 * distance_m / 5
    axis = np.arange(-half, half, step)
    grid = FluxGrid(axis, axis)
    fit = SimpleNamespace(canting_rad=turns - turns.mean(axis=0), curvature_1pm=0.0, scatter_rad=1.6e-3)
    total = 0.0
    for sun in suns:
        photo = FluxPhoto("drawn", target, sun, grid, np.zeros(grid.shape), np.zeros(2), BuieSun(0.02))
        light = whole_flux(photo.scene(stand, np.zeros(2), 1.6e-3), canted(mirror, fit.canting_rad), grid)
        photo = replace(photo, flux_dn=100 * light / light.max())
        # Residuals are shares of the RMS flux over the root of the pixels' number; a pixel of the grid joins some of
        # the photo's.
        share = _NOISE_SHARE * light.max() / np.sqrt(np.mean(light**2)) * (2 * half / _PIXELS) / step / np.sqrt(frames)
        total = total + flux_information(photo, mirror, stand, fit) * grid.x_m.size**2 / share**2
    count = 2 * (k - 1)
    if prior_rad is not None:
        total = total + np.diag([prior_rad**-2] * count + [0.0, 0.0])
    values = np.linalg.eigvalsh(total)
    covariance = np.linalg.pinv(total, hermitian=True, rcond=1e-14)[:count, :count]
    exact = values[0] > 1e-12 * values[-1]
    return 1e3 * float(np.sqrt(np.trace(covariance) / (2 * k))) if exact else float("inf")


def bound():
    title("Least sigma that the pixels' noise leaves of the canting", ("3 suns", "3, prior", "9 suns", "3, 100 fr."))
    site = Site(37.094, -2.358, 500.0)
    days = [f"2025-{day}T{hour:02d}:30" for day in ("03-20", "06-21", "12-21") for hour in (9, 12, 15)]
    suns = sun_directions(np.array(days, dtype="datetime64[ms]"), site)
    for facets, size, distance in _MIRRORS:
        row(
            f"{facets[0]} x {facets[1]} facets, {size[0]:g} m x {size[1]:g} m at {distance:g} m",
            f"{least_sigma_mrad(facets, size, distance, suns[:3]):.3f}",
            f"{least_sigma_mrad(facets, size, distance, suns[:3], prior_rad=0.8e-3):.3f}",
            f"{least_sigma_mrad(facets, size, distance, suns):.3f}",
            f"{least_sigma_mrad(facets, size, distance, suns[:3], 100):.3f}",
        )


if __name__ == "__main__":
    studies = {"few": few, "many": many, "plan": promised, "bound": bound}
    for name in sys.argv[1:] or studies:
        studies[name]()
