"""Canting from flux on drawn beams: error over sigma, which suns tell it, and what a plan promises of it.

    beam_canting.py [few] [many] [plan]

Mirrors are those of `heliogauge beam synth`: 4 facets of 1.6 m x 1.3 m or 25 of 0.6 m x 0.5 m, 66 m from the target,
canting and slope errors of 0.8 mrad, photos of 300 pixels across the target with noise, panels that differ by 1 %, dark
seams.
"""

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from _measure import row, title

import heliogauge as hg
from calibration.beam.pipeline import compare
from calibration.beam.planning import BeamPlanOptions, plan
from data_synth.heliostats import BenchOptions, write_beam_dataset

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


if __name__ == "__main__":
    studies = {"few": few, "many": many, "plan": promised}
    for name in sys.argv[1:] or studies:
        studies[name]()
