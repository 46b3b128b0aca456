"""Measure a synthetic folder and hold the result against its truth."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_synth.fringes.dataset import DatasetOptions, read_truth, write_dataset
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.scene import FringeScene
from deflectometry import Options, Result, load_deflectometry, run
from heliogauge.slopes.map import monomials


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Differences of one facet's pixels from the truth: slope_x and slope_y, shape (2, n), and their sigmas."""

    difference_rad: np.ndarray
    sigma_random_rad: np.ndarray
    modes_rad: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray

    @property
    def bias_mrad(self) -> np.ndarray:
        return 1e3 * self.difference_rad.mean(axis=1)

    @property
    def rms_mrad(self) -> np.ndarray:
        return 1e3 * np.sqrt((self.difference_rad**2).mean(axis=1))

    def without_smooth(self) -> np.ndarray:
        """Take out what common errors do to a map (a cubic); the rest is random."""
        terms = monomials(self.x_m, self.y_m, 3).T
        fitted = np.linalg.lstsq(terms, self.difference_rad.T, rcond=None)[0]
        return self.difference_rad - (terms @ fitted).T

    @property
    def random_chi_square(self) -> np.ndarray:
        """Mean of (difference / sigma)^2 of the random share in x and y, for the degrees of freedom that are left."""
        n = self.x_m.size
        return ((self.without_smooth() / self.sigma_random_rad) ** 2).sum(axis=1) / (n - 10)


def measure(
    scene: FringeScene,
    folder: Path,
    *,
    seed: int = 0,
    knowledge: Knowledge | None = None,
    options: Options | None = None,
) -> Result:
    write_dataset(folder, scene, DatasetOptions(seed, knowledge or Knowledge(), force=True))
    return run(load_deflectometry(folder), options)


def agreement(result: Result, folder: Path, facet: int = 0) -> Agreement:
    """Compare the pixels of one facet with the true slopes of its surface at the places found for them."""
    truth = read_truth(folder)
    name = truth.facets[facet].name if len(truth.facets) > 1 else next(iter(result.evaluation.images))
    image = result.evaluation.images[name]
    good = np.isfinite(image.slope_x)
    x_m, y_m = image.x_m[good], image.y_m[good]
    true_x, true_y = truth.slopes(x_m, y_m, facet=facet)
    return Agreement(
        np.stack([image.slope_x[good] - true_x, image.slope_y[good] - true_y]),
        np.stack([image.sigma_x[good], image.sigma_y[good]]).astype(np.float64),
        result.evaluation.maps[name].common.evaluate(x_m, y_m),
        x_m,
        y_m,
    )
