"""The canting of single facets in two results of one mirror: differences against the mean of all, and their sigmas."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.mounts import LEAST_SHARE
from heliogauge.slopes.statistics import canting
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CantingDifference:
    """Canting of facets, first minus second, without the mean of all facets: that is the frames' own.

    names: Of the facets that both have measured.
    first_rad, second_rad, difference_rad (f, 2): Canting in x and y, each without the mean of these facets.
    sigma_rad (f, 2): Standard deviation of the differences.
    probability: How often errors within the sigmas make so large differences; NaN without sigmas.
    """

    names: tuple[str, ...]
    first_rad: FloatArray
    second_rad: FloatArray
    difference_rad: FloatArray
    sigma_rad: FloatArray
    probability: float


def canting_difference(first: Mapping[str, SlopeMap], second: Mapping[str, SlopeMap]) -> CantingDifference | None:
    """Compare the canting of facets that two results have measured, by name.

    first, second: The map of each facet, in the facet's own frame.
    Returns: None where fewer than two facets of the same name and design are measured in both on half of their area.

    An error that all facets share, of the pose or of a camera, moves them alike and mostly cancels: the covariance is
    that of all facets together, random parts by themselves and each common mode through all of them.
    """
    names = tuple(
        name
        for name, one in first.items()
        if name in second
        and one.design == second[name].design
        and min(one.measured_share, second[name].measured_share) >= LEAST_SHARE
    )
    if len(names) < 2:
        return None
    sides = [_cantings([maps[name] for name in names]) for maps in (first, second)]
    count = len(names)
    centred = np.kron(np.eye(count) - 1.0 / count, np.eye(2))
    covariance = centred @ (sides[0][1] + sides[1][1]) @ centred
    own = [(centred @ values.ravel()).reshape(-1, 2) for values, _ in sides]
    difference = own[0] - own[1]
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, 2)
    probability = float("nan")
    if (sigma > 0).all():
        size, axes = np.linalg.eigh(covariance)
        # Without the mean of all facets two combinations are none.
        kept = size > 1e-9 * size[-1]
        parts = axes[:, kept].T @ difference.ravel()
        probability = 1.0 - chi_square_cdf(float((parts**2 / size[kept]).sum()), int(kept.sum()))
    return CantingDifference(names, own[0], own[1], difference, sigma, probability)


def _cantings(maps: list[SlopeMap]) -> tuple[FloatArray, FloatArray]:
    """Return the canting of facets (f, 2) and the covariance of all of it (2 f, 2 f)."""
    found = [canting(one) for one in maps]
    modes = []
    for one in maps:
        x, y = (grid[one.valid] for grid in np.meshgrid(one.x_m, one.y_m))
        modes.append(one.common.evaluate(x, y).mean(axis=2))
    size = 2 * len(maps)
    covariance = np.zeros((size, size))
    same = len({one.common.sources for one in maps}) == 1
    for number, (canted, mode) in enumerate(zip(found, modes, strict=True)):
        block = slice(2 * number, 2 * number + 2)
        own = canted.covariance_components_rad2
        # Modes of all facets belong together one by one.
        covariance[block, block] = own - mode.T @ mode if same else own
    if same:
        together = np.concatenate(modes, axis=1)
        covariance += together.T @ together
    return np.array([one.components_rad for one in found]), covariance
