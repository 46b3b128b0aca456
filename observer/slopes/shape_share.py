"""Whether the mirror itself deviates as its slopes say, or only its normals are turned: estimated from the reflection.

A point of the mirror that is higher by h is passed by both edges of the tube under slightly other angles: one mirror
point is seen by two cameras 0.6 m apart, and a height of a millimetre makes 0.03 mrad of difference between them.
That is below the noise of an edge, but the heights of the whole mirror, integrated from its slopes, are one pattern
with one factor: 1 for real mirrors, 0 for pictures whose normals alone were turned.
"""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.doubts import Doubt, Severity
from heliogauge.validate import FloatArray
from observer.slopes.common_elimination import Reduction
from observer.slopes.joint_solution import common_rows
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, assemble

#: The factor before the measurement is anything within some of this.
_PRIOR = 3.0
#: An error of all edges towards the tube that is common to the photos, as a standard deviation [m]: a tenth of a pixel.
_EDGE_PRIOR_M = 1e-3
#: The factor comes out too large, the more so the further edges are apart: heights and what lies between edges come
#: from the same slopes, and what a spline leaves of waves between edges looks like heights. In drawn photos of both
#: kinds by 0.2 with edges of one side 6 cm apart, by 0.4 to 0.9 with 10 cm. So much is taken off, and half of it is
#: uncertain.
_EXCESS, _EXCESS_STEP_M, _EXCESS_POWER = 0.20, 0.06, 1.5
#: Between normals that are turned and a mirror that is shaped; what is nearer than so many sigmas is doubtful.
_BORDER, _DECIDED_TIMES = 0.5, 2.0
#: With a larger sigma the factor says nothing.
_MOST_SIGMA = 0.6
#: There are no other mirrors than 0 and 1: a factor that is further beside both shows what its sigma does not contain.
#: Where it was determined it was never further (-0.5 to 2.0); 24 photos of a mirror with its shape said -3.6 +- 0.6.
_BESIDE = 1.0
#: An effect on the slopes of less than this share of their sigma is not worth a word.
_WORTH_SIGMAS = 0.5


@dataclass(frozen=True, slots=True)
class ShapeShare:
    """What the reflection says of the mirror's shape.

    share, sigma: Factor of the heights that the slopes integrate to, and its standard deviation; infinite where
        they are too small to determine it.
    effect_rad: RMS by which the slopes across differ with those heights and without [rad].
    """

    share: float
    sigma: float
    effect_rad: float

    @property
    def is_decided(self) -> bool:
        """Whether the factor is clearly nearer to one of both."""
        return self.sigma < _MOST_SIGMA and abs(self.share - _BORDER) > _DECIDED_TIMES * self.sigma

    @property
    def has_shape(self) -> bool:
        """Whether the mirror deviates as its slopes say, as real ones do where the reflection is not clear.

        Taken for turned normals, two shaped mirrors in 40 photos (0.41 and 0.27 +- 0.41) had errors of 2.5 sigma.
        """
        return self.share > _BORDER or not self.is_decided


def find_shape_share(
    both: tuple[TouchingLines, TouchingLines],
    by_edge: FloatArray,
    grid: RowGrid,
    roughness: Roughness,
    covariance: FloatArray,
) -> ShapeShare:
    """Estimate by what factor the mirror has the heights that its slopes integrate to.

    both: The same edges as observations on the mirror with its heights, and without.
    by_edge (m,): By what their angle changes where all edges are too far towards the tube [rad/m].
    roughness: How slopes may vary.
    covariance (c, c): Prior covariance of the common unknowns.
    """
    rows = common_rows(both[0], grid, len(covariance))
    number = np.full(grid.n_rows, -1)
    number[rows] = np.arange(rows.size)
    chosen = number[both[0].row] >= 0
    shaped, flat = (replace(some, row=number[some.row]) for some in (one.chosen(chosen) for one in both))
    fewer = grid.chosen(rows)
    extra = np.stack([shaped.misfit_rad - flat.misfit_rad, _EDGE_PRIOR_M * by_edge[chosen]], axis=1)
    if not np.abs(extra[:, 0]).max(initial=0.0) > 0:
        return ShapeShare(1.0, np.inf, 0.0)
    reduction = Reduction(shaped, fewer, covariance)
    found = reduction.under(roughness, beside=(extra, np.array([_PRIOR, 1.0]))).beside
    rows_alone = assemble(shaped, fewer)
    slopes = rows_alone.under(roughness).factor.solve(rows_alone.right_sides(extra[:, 0] / shaped.sigma_rad))
    seen = np.zeros((fewer.n_rows, grid.x_m.size), dtype=bool)
    nearest = np.rint((shaped.x_m - grid.x_m[0]) / grid.step_m).astype(np.intp)
    seen[shaped.row, np.clip(nearest, 0, grid.x_m.size - 1)] = True
    excess = _EXCESS * (_edge_step_m(shaped) / _EXCESS_STEP_M) ** _EXCESS_POWER
    share = 1.0 + float(found.amount[0]) - excess
    beside = max(-share, share - 1.0, _BESIDE) - _BESIDE
    return ShapeShare(
        share,
        float(np.sqrt(found.covariance[0, 0] + (0.5 * excess) ** 2 + beside**2)),
        float(np.sqrt(np.mean(np.square(slopes[:, 0::2])[seen]))),
    )


def _edge_step_m(lines: TouchingLines) -> float:
    """Return the usual distance of edges of one side along a row [m]."""
    order = np.lexsort((lines.x_m, lines.row))
    same = np.diff(lines.row[order]) == 0
    # Edges of both sides alternate.
    return 2 * float(np.median(np.diff(lines.x_m[order])[same])) if same.any() else np.inf


def shape_doubt(found: ShapeShare, stated: bool | None, usual_sigma_rad: float) -> Doubt | None:
    """Say whether the stated kind of surface contradicts the reflection, or matters and is not decided by it.

    stated: ``shape_from_slopes``; None where it is estimated.
    usual_sigma_rad: Usual sigma of a slope; what matters less than half of it is not worth a word [rad].
    """
    if found.effect_rad < _WORTH_SIGMAS * usual_sigma_rad:
        return None
    numbers = {"shape_share": found.share, "sigma_shape_share": found.sigma, "effect_rad": found.effect_rad}
    measured = f"the reflection says {found.share:.2f} +- {found.sigma:.2f} of the heights that the slopes integrate to"
    matters = f"slopes would differ by {1e3 * found.effect_rad:.2f} mrad RMS"
    if stated is not None and found.is_decided and found.has_shape != stated:
        text = f"evaluation.shape_from_slopes = {str(stated).lower()} does not fit: {measured}; the other way {matters}"
        return Doubt("surface_shape_contradicts_reflection", text, numbers, Severity.SERIOUS)
    if stated is not None or found.is_decided:
        return None
    return Doubt(
        "surface_shape_undecided",
        f"{measured} (1 where the mirror has the surface of its slopes, 0 where normals are turned on the design's "
        f"surface), which does not decide between the two; the former was taken, as of real mirrors. With the other "
        f"{matters}. evaluation.shape_from_slopes = true says that the surface is that of the slopes",
        numbers,
    )
