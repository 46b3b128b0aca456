"""The common slope map of a trough, and the angles in which its instrument thinks.

The mirror's slope dz/dx turns the normal towards -x as it grows: ``theta_r = atan(design slope) - atan(slope)``,
positive when the normal is turned towards +x. The displaced absorber looks like ``theta_a = (beta_0 - beta) / 2``;
what the camera sees is their sum ``theta_ra``.
"""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.flags import SampleFlag
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import BoolArray, FlagArray, FloatArray, IntArray
from observer.product.common_share import common_share
from observer.product.row_bridging import bridge_rows, lone_values
from observer.selection.solve_and_refuse import Reflector
from observer.slopes.slope_sums import noise_correlation
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.visibility import Visibility

#: A node is refused where noise and the distance to the next edge leave it less sure than this, and less sure than so
#: many times the usual: 0.5 mrad keeps 97 % of what can show the tube of an LS-2 in 100 photos.
_LARGEST_SIGMA_RAD = 0.5e-3
#: ... and than this, whatever is usual, where shadows are in the reflection: what two sides know no better may be one
#: edge that a shadow has pulled. Settled on three drawn troughs, confirmed on a fourth.
_LARGEST_IN_SHADOW_RAD = 0.2e-3
_LARGEST_TIMES_USUAL = 3.0
#: Values that others may rest on are surer than this, or than so many times the usual: inside an island that no edge
#: came near to all rows err together.
_FIRM_SIGMA_RAD = 0.2e-3
_FIRM_TIMES_USUAL = 1.5
#: Below this longitudinal information the slope along the trough is the prior's, not a measurement.
_LEAST_GAIN = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class AngleMaps:
    """Angles at the nodes of the slope map.

    theta_r_rad (ny, nx): Slope error across the trough, positive where the normal is turned towards +x [rad].
    theta_a_rad (ny, nx): What the displaced absorber looks like [rad].
    sigma_theta_a_rad (ny, nx): Its standard deviation [rad].
    to_tube: The mirror with what is uncertain about it seen from the tube as it is: noise and common modes of
        theta_ra.
    """

    theta_r_rad: FloatArray
    theta_a_rad: FloatArray
    sigma_theta_a_rad: FloatArray
    to_tube: SlopeMap

    @property
    def theta_ra_rad(self) -> FloatArray:
        """Reflector-absorber angle, shape (ny, nx) [rad]."""
        return self.theta_r_rad + self.theta_a_rad

    @property
    def sigma_theta_ra_rad(self) -> FloatArray:
        """Standard deviation of theta_ra, shape (ny, nx) [rad]."""
        return np.asarray(self.to_tube.sigma_slope()[0] / (1 + self.to_tube.slope_x**2))


def known_theta_r(reflector: Reflector, collector: Collector) -> FloatArray:
    """Return the slope error near edges of the reflection, before anything is refused.

    Returns (r, nx): Positive where the normal is turned towards +x; NaN far from edges [rad].
    """
    design = reflector.grid.x_m / (2 * collector.focal_length_m)
    turned = np.arctan(design) - np.arctan(design + reflector.errors.slopes[..., 0])
    return np.where(reflector.measured, turned, np.nan)


def slope_map_of(reflector: Reflector, collector: Collector, visible: Visibility) -> SlopeMap:
    """Return the mirror's slopes in the common form.

    visible: What the cameras can see of the tube by way of each node.
    """
    grid, y = reflector.grid, reflector.y_m
    x_nodes, y_nodes = np.meshgrid(grid.x_m, y)
    design_x = x_nodes / (2 * collector.focal_length_m)
    design_y = np.zeros_like(design_x)
    panel = collector.panel_index(x_nodes, y_nodes)
    nodes = _judged(reflector, panel, visible)
    common, rest = common_share(reflector.errors, (grid.x_m, y))
    sigma_x = np.sqrt(nodes.variance + rest)
    sigma_y = np.sqrt(reflector.errors.random[..., 1, 1] + reflector.errors.shared[..., 1])
    valid = np.isfinite(nodes.error)
    bridged = (nodes.flags & np.uint32(SampleFlag.SMOOTHED_GAP)) > 0
    has_along = valid & ~bridged & (sigma_y < _LEAST_GAIN * reflector.roughness.along_rad)
    error_y = reflector.errors.slopes[..., 1]
    slope_map = SlopeMap(
        grid.x_m,
        y,
        design_x + nodes.error,
        np.where(has_along, design_y + error_y, np.nan),
        design_x,
        design_y,
        np.where(valid, sigma_x, np.nan),
        np.where(has_along, sigma_y, np.nan),
        1.0,
        common,
        _height(reflector, collector, valid),
        nodes.flags,
        panel >= 0,
        design=collector.describe(),
        frame="trough: origin at the vertex in the middle, x across, y along, z to the absorber",
        removed="nothing",
    )
    # Cameras and absorber, which all have in common, are listed apart.
    return replace(slope_map, noise_correlation=noise_correlation(reflector.sums.without_common, slope_map, panel))


def _height(reflector: Reflector, collector: Collector, valid: BoolArray) -> FloatArray:
    """Return the height of the mirror; NaN everywhere unless its slopes were integrated."""
    height = reflector.grid.x_m**2 / (4 * collector.focal_length_m) + reflector.height_m
    return np.where(valid & bool(reflector.height_m.any()), height, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class _Nodes:
    """Slope errors across the trough with their own variance, NaN where refused, and why; all of shape (r, nx)."""

    error: FloatArray
    variance: FloatArray
    flags: FlagArray


def _judged(reflector: Reflector, panel: IntArray, visible: Visibility) -> _Nodes:
    """Refuse values that are uncertain or that their neighbours contradict, and bridge short gaps of the panel."""
    aperture = panel >= 0
    error, variance = reflector.errors.slopes[..., 0], reflector.errors.random[..., 0, 0]
    near = aperture & reflector.measured
    usual = float(np.median(variance[near])) if near.any() else 0.0
    limit = max(_LARGEST_SIGMA_RAD**2, _LARGEST_TIMES_USUAL**2 * usual)
    if reflector.has_shadows:
        limit = _LARGEST_IN_SHADOW_RAD**2
    step = float(reflector.y_m[1] - reflector.y_m[0]) if reflector.y_m.size > 1 else 1.0
    lone = lone_values(error, variance, near & (variance < limit), panel, step)
    firm = near & ~lone & (variance < max(_FIRM_SIGMA_RAD**2, _FIRM_TIMES_USUAL**2 * usual))
    beside = bridge_rows(error, variance, firm, panel, step)
    contradicted = lone | beside.contradicted
    own = near & (variance < limit) & ~contradicted
    filled = aperture & visible.seeable & (beside.variance < np.where(own, variance, limit))
    lost = aperture & ~own & ~filled
    flags = np.zeros(panel.shape, dtype=np.uint32)
    flags[~aperture] = np.uint32(SampleFlag.OUTSIDE_MIRROR)
    flags[filled & ~own] = np.uint32(SampleFlag.SMOOTHED_GAP)
    flags[lost] = visible.flags[lost]
    flags[lost & (visible.flags == 0)] = np.uint32(SampleFlag.UNCERTAIN)
    flags[lost & contradicted] = np.uint32(SampleFlag.OUTLIER)
    value = np.where(filled, beside.value, np.where(own, error, np.nan))
    return _Nodes(value, np.where(filled, beside.variance, variance), flags)


def slopes_to_tube(reflector: Reflector, slope_map: SlopeMap) -> SlopeMap:
    """Return the slope map with the noise and the common modes that theta_ra has instead of its own.

    The reflection shows where the mirror sends light beside the tube: an error of the tube's place is in theta_r and,
    the other way round, in theta_a. Sigmas of both parts, taken as independent, were 1.3 to 6 times the one here in
    simulated flights.

    Returns: The same slopes; ``sigma_slope()[0] / (1 + slope_x^2)`` is the sigma of theta_ra.
    """
    errors, nodes = reflector.errors, (slope_map.x_m, slope_map.y_m)
    rest_before = np.maximum(errors.shared[..., 0] - slope_map.common.variance_on_grid(*nodes)[0], 0.0)
    noise = np.maximum(slope_map.sigma_random_x**2 - rest_before, 0.0)
    common, rest = common_share(errors, nodes, to_tube=True)
    return replace(slope_map, sigma_random_x=np.sqrt(noise + rest), common=common)


def angle_maps(
    slope_map: SlopeMap, absorber: AbsorberPath, collector: Collector, to_tube: SlopeMap | None = None
) -> AngleMaps:
    """Return reflector and absorber angles at the nodes of a slope map.

    absorber: The tube's axis.
    to_tube: The map with what is uncertain of theta_ra (`slopes_to_tube`); by default the tube's place is held.
    Returns: Angles; NaN where the mirror was not measured.
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
    return AngleMaps(theta_r, theta_a, sigma, slope_map if to_tube is None else to_tube)
