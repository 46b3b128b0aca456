"""Canting from flux of many drawn mirrors: errors against their sigmas, each and jointly.

The drawing (`data_synth.heliostats`) asks from each point of the target how bright the sun is in each patch of the
mirror, photographs that with seams, panels and noise, and shares nothing with the fit, which spreads landing points.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from calibration.beam.keys import load_beams
from calibration.beam.pipeline import compare
from data_synth.heliostats import BenchOptions, write_beam_dataset

#: Mirrors, none of which was used to choose how the covariance is made.
SEEDS = range(100, 112)


@pytest.mark.slow
def test_errors_are_within_their_covariance(tmp_path: Path) -> None:
    each, jointly, squares = [], [], []
    for seed in SEEDS:
        folder = tmp_path / str(seed)
        write_beam_dataset(folder, BenchOptions(suns=3, seed=seed))
        truth = np.array(json.loads((folder / "truth.json").read_text())["canting_rad"])
        after = compare.run(load_beams(folder)).after
        assert after is not None
        if not after.is_canting_told:
            continue
        error = after.canting_rad - truth
        values, axes = np.linalg.eigh(after.covariance_canting)
        # Cantings add up to zero: two directions have no variance.
        assert (values[:2] < 1e-9 * values[-1]).all()
        assert (values[2:] > 1e-6 * values[-1]).all()
        jointly.append((axes[:, 2:].T @ error.ravel()) / np.sqrt(values[2:]))
        each.append(error / after.sigma_canting_rad)
        squares.append(error**2)
    assert len(each) >= 10
    assert np.sqrt(np.mean(squares)) < 1e-4
    scores = np.concatenate(jointly)
    low, high = chi2.ppf([1e-3, 1 - 1e-3], scores.size)
    assert low < float(scores @ scores) < high
    # Facets of one mirror are not independent: the mirrors are counted, six directions of each.
    assert 0.7 < np.sqrt(np.mean(np.square(each))) < 1.3
