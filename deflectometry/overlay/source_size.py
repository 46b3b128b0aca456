"""Whether the source is as large as stated: the size that its images in the facets have."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.overlay.source_image import Source
from deflectometry.overlay.turn_fit import ViewTurn, residual_of_view
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import FloatArray

#: With fewer the scatter over facets says nothing of the mean.
FEWEST_FACETS = 4
#: An image that tells its size worse, as one that is cut off by the facet, is not asked.
_WORST_SIGMA = 0.2
#: Logarithm of a size beyond which a fit has gone astray.
_LARGEST = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class SourceSizes:
    """Sizes of the source by its images over the stated ones, mean of the facets; as logarithms.

    mean (2,): Across its x and y; NaN where fewer than four facets tell.
    sigma (2,): By the scatter over the facets, whose shape is in it.
    chance (2,): Probability that chance makes the means as far from 0 (Student's t).
    """

    mean: FloatArray
    sigma: FloatArray
    chance: FloatArray


def source_sizes(facets: Sequence[Facet], fitted: Mapping[str, Sequence[ViewTurn]], source: Source) -> SourceSizes:
    """Estimate how large the source is by its images in the facets.

    fitted: Turns in each photo by the name of the facet.
    """
    from scipy.stats import t as student

    own = [[_size_in_view(facet, one, source) for one in fitted.get(facet.name, ())] for facet in facets]
    # A facet's focal length makes its images in all photos larger alike.
    of_facets = np.array([[_mean_of_known(column) for column in np.reshape(some, (-1, 2)).T] for some in own])
    mean, sigma, chance = np.full(2, np.nan), np.full(2, np.nan), np.ones(2)
    for axis, values in enumerate(of_facets.T):
        known = values[np.isfinite(values)]
        if known.size < FEWEST_FACETS:
            continue
        mean[axis], sigma[axis] = known.mean(), known.std(ddof=1) / np.sqrt(known.size)
        chance[axis] = 2 * student.sf(abs(mean[axis]) / sigma[axis], known.size - 1)
    return SourceSizes(mean, sigma, chance)


def _mean_of_known(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan


def _size_in_view(facet: Facet, one: ViewTurn, source: Source) -> FloatArray:
    """Return the logarithm of the size by one image over the stated one, shape (2,); NaN where it does not tell."""
    from scipy.optimize import least_squares

    axes = 1 if source.is_disc else 2
    residual = residual_of_view(facet, one, source)

    def of_size(unknown: FloatArray) -> FloatArray:
        half = np.array(source.half_m) * np.exp(np.clip(np.resize(unknown[5:], 2), -_LARGEST, _LARGEST))
        return residual(unknown[:5], replace(source, half_m=(float(half[0]), float(half[1]))))

    found = least_squares(of_size, np.concatenate([one.state, np.zeros(axes)]), x_scale="jac", max_nfev=30)
    products = found.jac.T @ found.jac
    size = np.full(2, np.nan)
    if np.linalg.cond(products / np.sqrt(np.outer(np.diag(products), np.diag(products)) + 1e-300)) > 1e12:
        return size
    scatter = 2 * found.cost / max(len(found.fun) - len(found.x), 1)
    sigma = np.sqrt(np.maximum(scatter, 1.0) * np.diag(np.linalg.inv(products)))[5:]
    size[:axes] = np.where(sigma < _WORST_SIGMA, found.x[5:], np.nan)
    return size
