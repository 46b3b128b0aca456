r"""Intercept factor of a trough: the share of the reflected light that meets the absorber tube.

At a mirror point the tube is hit by light that arrives, across the trough, under angles between the two at which a
camera sees the tube's edges there: ``2 theta_ra -+ w``, ``w = asin(a / R)`` (Owkes 2012, eq. 5.4). These two angles
are what `observer.trough.observation_equation.misfit` gives for a line of sight to the sun's centre with the tube's
edges at side -1 and +1. With the share F of the light below an angle (sun shape, specularity, tracking error) the
point's intercept factor is ``F(upper - t) - F(lower - t)`` for a sun that stands t towards +x of the optical axis.
The trough's is the mean over the light that falls on the mirror (eqs 5.13 to 5.15, kept point by point).

Not counted, as usual: reflectance, absorptance, the tube's shadow, the glass (its refraction leaves the distance at
which a ray passes the axis of a concentric tube unchanged), and what leaves the trough beyond the tube's ends.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray, IntArray
from observer.light.beam import BeamProfile
from observer.trough.absorber_path import AbsorberPath
from observer.trough.observation_equation import Sights, misfit

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, slots=True, eq=False)
class MirrorNodes:
    """The measured nodes of a slope map, and how much light each stands for.

    shape: Rows and columns of the map.
    node (m,): Row-major number of each node in the map.
    points_m (m, 3): Where they are [m].
    slope_x, slope_y (m,): Slopes dz/dx and dz/dy; where the one along the trough was not measured, the design's.
    design_slope_x (m,): The design's slope across, for the light that a node catches.
    share (m,): Share of the aperture each stands for, with its part of what was not measured; the sum is 1.
    measured_share: Share of the aperture that was measured.
    """

    shape: tuple[int, int]
    node: IntArray
    points_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    design_slope_x: FloatArray
    share: FloatArray
    measured_share: float

    def as_map(self, values: FloatArray) -> FloatArray:
        """Return values at the nodes, shape (..., m), as maps with zeros elsewhere, shape (..., ny, nx)."""
        maps = np.zeros((*values.shape[:-1], self.shape[0] * self.shape[1]))
        maps[..., self.node] = values
        return maps.reshape(*values.shape[:-1], *self.shape)


def mirror_nodes(slope_map: SlopeMap, focal_length_m: float) -> MirrorNodes:
    """Take the measured nodes out of a slope map.

    slope_map: The mirror; its heights are used where it has any, elsewhere the design's.
    EstimationError: No node was measured.

    A node that was not measured is taken to be as the measured ones at the same distance from the vertex (the same
    column of the map), a column without any as the nearest column that has some.
    """
    valid = slope_map.valid
    if not valid.any():
        raise EstimationError("slope map: no node was measured, so there is no intercept factor")
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    height = np.where(np.isfinite(slope_map.height_m), slope_map.height_m, x**2 / (4 * focal_length_m))
    node = np.flatnonzero(valid)
    per_node = column_shares(slope_map) / np.maximum(np.count_nonzero(valid, axis=0), 1)
    return MirrorNodes(
        slope_map.shape,
        node,
        np.stack([part[valid] for part in (x, y, height)], axis=1),
        slope_map.slope_x[valid],
        slope_map.with_both_slopes().slope_y[valid],
        slope_map.design_slope_x[valid],
        per_node[node % slope_map.shape[1]],
        slope_map.measured_share,
    )


def column_shares(slope_map: SlopeMap) -> FloatArray:
    """Return the share of the aperture that the measured nodes of each column stand for.

    Returns (nx,): Sum 1; zero for columns without a measured node, whose share goes to the nearest column that has
        some.
    """
    area = np.count_nonzero(slope_map.aperture, axis=0).astype(np.float64)
    known = np.flatnonzero(slope_map.valid.any(axis=0))
    nearest = known[np.abs(slope_map.x_m[:, None] - slope_map.x_m[known]).argmin(axis=1)]
    return np.asarray(np.bincount(nearest, area, area.size) / area.sum())


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Between which angles across the trough light must arrive at each node to meet the tube.

    lower_rad, upper_rad (m,): The two angles, positive towards +x [rad].
    d_slope_x (m,): Derivative of both with respect to the mirror's slope across [rad].
    d_lower_d_absorber, d_upper_d_absorber (m, 2): Derivatives with respect to X_a and Z_a of the tube where the
        light passes it [rad/m].
    passing_y_m (m,): Where that is [m].
    """

    lower_rad: FloatArray
    upper_rad: FloatArray
    d_slope_x: FloatArray
    d_lower_d_absorber: FloatArray
    d_upper_d_absorber: FloatArray
    passing_y_m: FloatArray

    @property
    def d_middle_d_absorber(self) -> FloatArray:
        """Derivatives of the middle between both, shape (m, 2) [rad/m]."""
        return 0.5 * (self.d_lower_d_absorber + self.d_upper_d_absorber)

    def moved(self, lower_rad: FloatArray, upper_rad: FloatArray) -> "Windows":
        """Return the windows with both angles moved by steps [rad]."""
        return replace(self, lower_rad=self.lower_rad + lower_rad, upper_rad=self.upper_rad + upper_rad)


def acceptance_windows(
    nodes: MirrorNodes, absorber: AbsorberPath, radius_m: float, incidence_rad: float = 0.0
) -> Windows:
    """Find between which angles light must arrive at the nodes to meet the tube.

    absorber: The tube's axis.
    incidence_rad: Angle between the sun and the plane across the trough, positive towards +y [rad].
    Returns: Empty ones (both angles zero) where the reflected light goes away from the tube.
    """
    sun = np.array([0.0, np.sin(incidence_rad), np.cos(incidence_rad)])
    upper = misfit(
        Sights(nodes.points_m, nodes.points_m + sun, np.ones(nodes.node.size)),
        (nodes.slope_x, nodes.slope_y),
        absorber,
        radius_m,
    )
    # d asin(a / R) / da = 1 / sqrt(R^2 - a^2): tan(w) without a second evaluation at the other edge.
    tangent = radius_m * upper.d_angle_d_radius
    half = np.arctan(tangent)
    axis_x, axis_z = absorber.at(upper.passing_y_m)
    towards = np.stack([axis_x - nodes.points_m[:, 0], axis_z - nodes.points_m[:, 2]], axis=1)
    d_half = -(tangent / np.einsum("mi,mi->m", towards, towards))[:, None] * towards
    meets = np.isfinite(upper.angle_rad)

    def kept(values: FloatArray) -> FloatArray:
        return np.asarray(np.where(meets.reshape(-1, *[1] * (values.ndim - 1)), values, 0.0))

    return Windows(
        kept(upper.angle_rad - 2 * half),
        kept(upper.angle_rad),
        kept(upper.d_angle_d_slope_x),
        kept(upper.d_angle_d_absorber - 2 * d_half),
        kept(upper.d_angle_d_absorber),
        np.where(meets, upper.passing_y_m, nodes.points_m[:, 1]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class TroughOptics:
    """A mirror before a tube in light.

    windows: What of the light meets the tube.
    profile: The light's angles across the trough.
    stations (m, n): By how much the tube follows its stations where each node's light passes it (`station_shares`).
    """

    nodes: MirrorNodes
    windows: Windows
    profile: BeamProfile
    stations: "csr_array"

    @classmethod
    def of(
        cls,
        nodes: MirrorNodes,
        absorber: AbsorberPath,
        radius_m: float,
        profile: BeamProfile,
        incidence_rad: float = 0.0,
    ) -> "TroughOptics":
        """Put mirror, tube and light together.

        absorber: The tube's axis.
        profile: The light, for the same incidence.
        incidence_rad: Angle between the sun and the plane across the trough, positive towards +y [rad].
        """
        windows = acceptance_windows(nodes, absorber, radius_m, incidence_rad)
        return cls(nodes, windows, profile, station_shares(absorber, windows.passing_y_m))

    def light(self, offset_rad: float) -> FloatArray:
        """Return the share of the light that falls on each node with the sun beside the axis, shape (m,)."""
        # A cell of the map has the same area across z; across the sun it has (1 - p tan t) of it.
        caught = self.nodes.share * np.maximum(1.0 - self.nodes.design_slope_x * np.tan(offset_rad), 0.0)
        return np.asarray(caught / caught.sum())

    def of_nodes(self, offset_rad: float = 0.0) -> FloatArray:
        """Return the intercept factor of each node, shape (m,)."""
        windows, profile = self.windows, self.profile
        return profile.below(windows.upper_rad - offset_rad) - profile.below(windows.lower_rad - offset_rad)

    def ratio(self, offset_rad: float = 0.0) -> float:
        """Return the intercept factor.

        offset_rad: Angle by which the sun stands towards +x of the optical axis [rad].
        Returns: Share of the reflected light that meets the tube.
        """
        return float(self.light(offset_rad) @ self.of_nodes(offset_rad))

    def gradients(self, offset_rad: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Differentiate the intercept factor.

        offset_rad: Angle by which the sun stands towards +x of the optical axis [rad].
        d_slope_x (m,): With respect to the slope across of each node.
        d_absorber (m, 2): With respect to X_a and Z_a where the light of each node passes the tube [1/m].
        """
        light, windows = self.light(offset_rad), self.windows
        at_upper = light * self.profile.density_at(windows.upper_rad - offset_rad)
        at_lower = light * self.profile.density_at(windows.lower_rad - offset_rad)
        d_absorber = at_upper[:, None] * windows.d_upper_d_absorber - at_lower[:, None] * windows.d_lower_d_absorber
        return (at_upper - at_lower) * windows.d_slope_x, d_absorber

    def scattered_ratio(self, sigma_slope: FloatArray, offset_rad: float = 0.0) -> float:
        """Return the mean of the intercept factors with all slopes one sigma higher and lower, each on its own.

        sigma_slope (m,): Standard deviation of each slope across.
        offset_rad: Angle by which the sun stands towards +x of the optical axis [rad].
        Returns: What slopes that scatter so collect on average, to second order, also where the sun has an edge.
        """
        step = np.abs(self.windows.d_slope_x) * sigma_slope
        sides = [replace(self, windows=self.windows.moved(turn, turn)).of_nodes(offset_rad) for turn in (step, -step)]
        return float(self.light(offset_rad) @ (sides[0] + sides[1]) / 2)


def station_shares(absorber: AbsorberPath, passing_y_m: FloatArray) -> "csr_array":
    """Return by how much places along the tube follow each of its stations.

    Shapes: passing_y_m (m,).
    absorber: The tube's axis.
    Returns (m, n): Shares; two in each row.
    """
    from scipy.sparse import csr_array

    before, share = absorber.shares(passing_y_m)
    after = np.minimum(before + 1, absorber.n - 1)
    table = (
        np.stack([1 - share, share], axis=1).ravel(),
        np.stack([before, after], axis=1).ravel(),
        2 * np.arange(before.size + 1),
    )
    return csr_array(table, shape=(before.size, absorber.n))


def along_path(shares: "csr_array", d_absorber: FloatArray) -> FloatArray:
    """Gather derivatives with respect to places of the tube into those with respect to its stations.

    Shapes: shares (m, n).
    d_absorber (m, 2): Derivatives with respect to X_a and Z_a at the places.
    Returns (2 n,): Derivatives with respect to (x_1 .. x_n, z_1 .. z_n).
    """
    return np.concatenate([shares.T @ np.ascontiguousarray(one) for one in d_absorber.T])
