"""Each panel for itself: its mean angle, and the focal length of the parabola that its slopes follow."""

from dataclasses import dataclass

import numpy as np

from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.mounts import LEAST_SHARE
from heliogauge.validate import FloatArray
from observer.product.unmeasured_part import unmeasured_variances
from observer.trough.collector import Collector


@dataclass(frozen=True, slots=True, eq=False)
class PanelShapes:
    """Parabolas that fit the panels' slopes best.

    focal_length_m (p,): Focal length of each panel, in the order of `Collector.panel_index`; NaN where too little
        was measured [m].
    sigma_focal_length_m (p,): Its standard deviation [m].
    rest_rad (p,): RMS of what of the slope dz/dx the parabola leaves [rad].
    """

    focal_length_m: FloatArray
    sigma_focal_length_m: FloatArray
    rest_rad: FloatArray


def panel_shapes(slope_map: SlopeMap, collector: Collector) -> PanelShapes:
    """Fit ``dz/dx = x / (2 f) + c`` to each panel.

    Returns: Focal lengths with sigma: noise of the nodes, what the map has in common, and what was not measured of
        the panel.

    The quadratic fit of Owkes (2012, appendix B.1) for one panel alone. Equal weights: the curvature is that of the
    panel's area and not of its best measured part.
    """
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    panel = collector.panel_index(x, y)
    count = (len(collector.panel_edges_x_m) - 1) * (len(collector.panel_edges_y_m) - 1)
    focal, sigma, rest = (np.full(count, np.nan) for _ in range(3))
    wanted, used = np.zeros((2, *panel.shape))
    for number in range(count):
        own = (panel == number) & slope_map.valid
        if int(own.sum()) < LEAST_SHARE * max(int((panel == number).sum()), 1):
            continue
        beside = x[own] - x[own].mean()
        if not np.ptp(beside) > 0:
            continue
        # The curvature is this weighted sum of slopes.
        weights = beside / (beside @ beside)
        curvature = float(weights @ slope_map.slope_x[own])
        noise = slope_map.noise_correlation * float(weights**2 @ slope_map.sigma_random_x[own] ** 2)
        together = float(np.sum(slope_map.common.of_sum(x[own], y[own], weights)[:, 0] ** 2))
        focal[number] = 1 / (2 * curvature)
        sigma[number] = np.sqrt(noise + together)
        used[own] = weights
        whole = x[panel == number] - x[panel == number].mean()
        wanted[panel == number] = whole / (whole @ whole)
        left = slope_map.slope_x[own] - slope_map.slope_x[own].mean() - curvature * beside
        rest[number] = np.sqrt(np.mean(left**2))
    # The design has one curvature everywhere.
    error = slope_map.slope_x - slope_map.design_slope_x
    sigma = np.sqrt(sigma**2 + unmeasured_variances(error, panel, slope_map.valid, wanted, used, count))
    # The curvature is 1 / (2 f).
    sigma *= 2 * focal**2
    return PanelShapes(focal, sigma, rest)
