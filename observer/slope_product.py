"""The common slope map of a trough, and the angles in which its instrument thinks.

The mirror's slope dz/dx turns the normal towards -x as it grows: ``theta_r = atan(design slope) - atan(slope)``,
positive when the normal is turned towards +x. The displaced absorber looks like ``theta_a = (beta_0 - beta) / 2``;
what the camera sees is their sum ``theta_ra``.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.flags import SampleFlag
from heliogauge.slope_map import SlopeMap, no_common_modes
from heliogauge.validate import FloatArray
from observer.absorber_path import AbsorberPath
from observer.design import Collector
from observer.reflector import Reflector

#: A node whose slope is less sure than this says nothing of a collector [rad].
_LARGEST_SIGMA_RAD = 1.5e-3
#: Below this longitudinal information the slope along the trough is the prior's, not a measurement.
_LEAST_GAIN = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class AngleMaps:
    """Angles at the nodes of the slope map.

    Parameters
    ----------
    theta_r_rad : ndarray, shape (ny, nx)
        Slope error across the trough, positive where the normal is turned towards +x [rad].
    theta_a_rad : ndarray, shape (ny, nx)
        What the displaced absorber looks like [rad].
    sigma_theta_a_rad : ndarray, shape (ny, nx)
        Its standard deviation [rad].
    """

    theta_r_rad: FloatArray
    theta_a_rad: FloatArray
    sigma_theta_a_rad: FloatArray

    @property
    def theta_ra_rad(self) -> FloatArray:
        """Reflector-absorber angle, shape (ny, nx) [rad]."""
        return self.theta_r_rad + self.theta_a_rad


def slope_map_of(reflector: Reflector, collector: Collector, prior_along_rad: float) -> SlopeMap:
    """Return the mirror's slopes in the common form.

    Parameters
    ----------
    reflector : Reflector
        The solution.
    collector : Collector
        The design.
    prior_along_rad : float
        Standard deviation of the prior of the slope along the trough [rad].

    Returns
    -------
    SlopeMap
        Slopes in the trough's frame.
    """
    grid, y = reflector.grid, reflector.y_m
    x_nodes, y_nodes = np.meshgrid(grid.x_m, y)
    design_x = x_nodes / (2 * collector.focal_length_m)
    design_y = np.zeros_like(design_x)
    sigma = np.sqrt(
        np.stack([reflector.errors.random[..., i, i] for i in (0, 1)]) + np.moveaxis(reflector.errors.shared, 2, 0)
    )
    aperture = collector.panel_index(x_nodes, y_nodes) >= 0
    flags = np.zeros(x_nodes.shape, dtype=np.uint32)
    flags[~aperture] |= np.uint32(SampleFlag.OUTSIDE_MIRROR)
    lost = aperture & (~reflector.measured | ~(sigma[0] < _LARGEST_SIGMA_RAD))
    flags[lost] |= np.uint32(SampleFlag.NOT_SEEN)
    valid = aperture & ~lost
    has_along = valid & (sigma[1] < _LEAST_GAIN * prior_along_rad)
    error_x, error_y = reflector.errors.slopes[..., 0], reflector.errors.slopes[..., 1]
    return SlopeMap(
        grid.x_m, y,
        np.where(valid, design_x + error_x, np.nan), np.where(has_along, design_y + error_y, np.nan),
        design_x, design_y,
        np.where(valid, sigma[0], np.nan), np.where(has_along, sigma[1], np.nan),
        1.0, no_common_modes(), np.full(x_nodes.shape, np.nan), flags, aperture,
        design=collector.describe(),
        frame="trough: origin at the vertex in the middle, x across, y along, z to the absorber",
        removed="nothing",
    )  # fmt: skip


def angle_maps(slope_map: SlopeMap, absorber: AbsorberPath, collector: Collector) -> AngleMaps:
    """Return reflector and absorber angles at the nodes of a slope map.

    Parameters
    ----------
    slope_map : SlopeMap
        The mirror.
    absorber : AbsorberPath
        The tube's axis.
    collector : Collector
        The design.

    Returns
    -------
    AngleMaps
        Angles; NaN where the mirror was not measured.
    """
    focal = collector.focal_length_m
    theta_r = np.arctan(slope_map.design_slope_x) - np.arctan(slope_map.slope_x)
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    z = x**2 / (4 * focal)
    axis_x, axis_z = absorber.at(y)
    theta_a = 0.5 * (np.arctan2(-x, focal - z) - np.arctan2(axis_x - x, axis_z - z))
    square = (axis_x - x) ** 2 + (axis_z - z) ** 2
    sigma_x, sigma_z = absorber.sigma_at(slope_map.y_m)
    sigma = 0.5 * np.hypot((axis_z - z) / square * sigma_x[:, None], (axis_x - x) / square * sigma_z[:, None])
    return AngleMaps(theta_r, theta_a, sigma)
