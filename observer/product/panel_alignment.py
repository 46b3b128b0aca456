"""Aligning mirror panels to the absorber: where its image belongs, and by how much mounts are to be moved (TOP).

Theoretical overlay photography (Diver, Moss 2007; TOPCAT) compares where a camera sees the absorber's image in a panel
with where it would be in a well-aligned one, and shims the panel until both agree. The image's edges in the design's
parabola are the places whose reflected line of sight touches the tube. On the plane z = f through the focal line such
lines pass at ``-r / cos(phi + delta)`` and ``+r / cos(phi - delta)``, with ``phi`` the angle of the line from the
mirror point to the focus, R its length and ``delta = asin(r / R)`` (the published form has the first sign in both).

Here the tilt of a panel is the mean of the measured angles over all of it instead of the offset at one place.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from heliogauge.errors import InputError
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.mounts import LEAST_SHARE, moves_of_mounts
from heliogauge.validate import FloatArray, IntArray
from observer.photo_edges.reflection_edges import design_misfit
from observer.product.unmeasured_part import unmeasured_variances
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

#: Mounts whose places nobody states lie so far inside a panel's corners [m].
MOUNT_INSET_M = 0.1
#: Places across a panel between which an edge is looked for.
_PLACES = 257


@dataclass(frozen=True, slots=True, eq=False)
class PanelTilts:
    """Mean angles of all panels.

    centre_x_m, centre_y_m (k,): Middles of the panels; the number of a panel is that of `Collector.panel_index`
        [m].
    tilt_rad (k,): Mean angle, positive where the panel's normal is turned towards +x; NaN where too little is
        measured [rad].
    sigma_rad (k,): Its standard deviation [rad].
    measured_share (k,): How much of the panel has a value.
    sigma_unmeasured_rad (k,): What of the standard deviation is for the rest, which two measurements that cover the
        same nodes have in common; None where it is not known apart [rad].
    """

    centre_x_m: FloatArray
    centre_y_m: FloatArray
    tilt_rad: FloatArray
    sigma_rad: FloatArray
    measured_share: FloatArray
    sigma_unmeasured_rad: FloatArray | None = None


def target_plane_edges(across_m: FloatArray, focal_length_m: float, radius_m: float) -> tuple[FloatArray, FloatArray]:
    """Return where lines from a mirror point that touch the tube pass the plane z = f.

    Shapes: across_m (...).
    focal_length_m, radius_m: Focal length, and radius of the tube around the focal line [m].
    lower, upper (...): Positions across the trough [m].
    """
    angle = 2 * np.arctan(np.asarray(across_m) / (2 * focal_length_m))
    delta = np.arcsin(radius_m * (1 + np.cos(angle)) / (2 * focal_length_m))
    return np.asarray(-radius_m / np.cos(angle + delta)), np.asarray(radius_m / np.cos(angle - delta))


def image_edges(eye_m: FloatArray, y_m: FloatArray, collector: Collector, absorber: AbsorberPath) -> FloatArray:
    """Return where a camera sees the edges of the absorber's image in well-aligned panels.

    Shapes: eye_m (3,).
    y_m (r,): Rows along the trough [m].
    absorber: The tube's axis, as it is.
    Returns (r, p, 2): x of the edges in each of the p columns of panels, the one at the larger camera angle second;
        NaN where the camera sees no edge in that column [m].
    """
    edges = collector.panel_edges_x_m
    found = np.full((len(y_m), len(edges) - 1, 2), np.nan)
    for column, (low, high) in enumerate(pairwise(edges.tolist())):
        x, y = np.meshgrid(np.linspace(low, high, _PLACES), y_m)
        points = np.stack([x, y, x**2 / (4 * collector.focal_length_m)], axis=-1).reshape(-1, 3)
        eyes = np.broadcast_to(eye_m, points.shape)
        for place, side in enumerate((-1.0, 1.0)):
            angle = design_misfit(points, eyes, np.full(len(points), side), collector, absorber).angle_rad
            found[:, column, place] = _first_zero(x, angle.reshape(x.shape))
    return found


def _first_zero(x_m: FloatArray, values: FloatArray) -> FloatArray:
    """Return where each row changes its sign first, NaN where it does not."""
    change = values[:, :-1] * values[:, 1:] <= 0
    before = np.argmax(change, axis=1)
    row = np.arange(len(values))
    left, right = values[row, before], values[row, before + 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        zero = x_m[row, before] + (x_m[row, before + 1] - x_m[row, before]) * left / (left - right)
    return np.where(change.any(axis=1), zero, np.nan)


def panel_tilts(
    angle_rad: FloatArray, slope_map: SlopeMap, collector: Collector, sigma_rad: FloatArray | None = None
) -> PanelTilts:
    """Average an angle over each panel.

    angle_rad (ny, nx): theta_ra to align to the absorber as it is, theta_r to align to the design's focal line
        [rad].
    slope_map: The mirror; gives nodes and uncertainty.
    sigma_rad (k,): Standard deviation of each panel's mean as `panels.csv` has it; by default that of the map for
        theta_r [rad].
    Returns: Means with their sigma: noise of the nodes, what the map has in common, and what was not measured of the
        panel.
    """
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    panel = collector.panel_index(x, y)
    used = slope_map.valid & np.isfinite(angle_rad)
    # d angle / d slope = -1 / (1 + slope^2)
    turn = 1 / (1 + slope_map.design_slope_x**2)
    columns, rows = collector.panel_edges_x_m, collector.panel_edges_y_m
    count = (len(columns) - 1) * (len(rows) - 1)
    tilt, sigma, share = np.full(count, np.nan), np.full(count, np.nan), np.zeros(count)
    wanted, weights = np.zeros((2, *panel.shape))
    for number in range(count):
        own = (panel == number) & used
        share[number] = np.count_nonzero(own) / max(int(np.count_nonzero(panel == number)), 1)
        if share[number] < LEAST_SHARE:
            continue
        tilt[number] = angle_rad[own].mean()
        if sigma_rad is not None:
            sigma[number] = sigma_rad[number]
            continue
        noise = slope_map.noise_correlation * np.sum((turn * slope_map.sigma_random_x)[own] ** 2) / own.sum() ** 2
        together = np.sum(slope_map.common.of_sum(x[own], y[own], turn[own] / own.sum())[:, 0] ** 2)
        sigma[number] = np.sqrt(noise + together)
        wanted[panel == number] = 1 / np.count_nonzero(panel == number)
        weights[own] = 1 / np.count_nonzero(own)
    unmeasured = None
    if sigma_rad is None:
        unmeasured = np.sqrt(unmeasured_variances(angle_rad, panel, used, wanted, weights, count))
        sigma = np.hypot(sigma, unmeasured)
    centre_x, centre_y = np.meshgrid((columns[:-1] + columns[1:]) / 2, (rows[:-1] + rows[1:]) / 2)
    return PanelTilts(centre_x.ravel(), centre_y.ravel(), tilt, sigma, share, unmeasured)


class MountMoves(NamedTuple):
    """How far each mount is to be moved.

    panel (n,): The panel that it holds.
    move_m (n,): Movement along the mirror's normal, positive towards the absorber; the panel turns about its
        middle, so that moves at both sides are opposite. NaN where the panel has no tilt [m].
    sigma_m (n,): Its standard deviation [m].
    """

    panel: IntArray
    move_m: FloatArray
    sigma_m: FloatArray


def mount_moves(tilts: PanelTilts, mounts_m: FloatArray, collector: Collector) -> MountMoves:
    """Prescribe by how much each mount is to be moved so that its panel's mean angle becomes zero.

    mounts_m (n, 2): x and y of the mounts [m].
    InputError: A mount that is on no panel.
    """
    x, y = mounts_m.T
    # Mounts at a panel's very edge, or in a gap, belong to the panel whose middle is nearest.
    distance = np.hypot(x[:, None] - tilts.centre_x_m, y[:, None] - tilts.centre_y_m)
    panel = np.where(collector.panel_index(x, y) >= 0, collector.panel_index(x, y), distance.argmin(axis=1))
    half = np.array([collector.aperture_width_m, collector.length_m]) / 2
    outside = (np.abs(mounts_m) > half + 0.05).any(axis=1)
    if outside.any():
        first = mounts_m[np.argmax(outside)]
        raise InputError(
            f"mounts: x = {first[0]:g} m, y = {first[1]:g} m is beside the mirror of {2 * half[0]:g} m x "
            f"{2 * half[1]:g} m; are the coordinates in metres?"
        )
    lever = _arc_m(x, collector.focal_length_m) - _arc_m(tilts.centre_x_m, collector.focal_length_m)[panel]
    nothing = np.zeros_like(lever)
    levers, turns = np.stack([lever, nothing], axis=1), np.stack([-tilts.tilt_rad[panel], nothing], axis=1)
    covariance = np.zeros((lever.size, 2, 2))
    covariance[:, 0, 0] = tilts.sigma_rad[panel] ** 2
    moves = moves_of_mounts(levers, turns, covariance)
    return MountMoves(panel.astype(np.intp), moves.move_m, moves.sigma_m)


def move_of_outer_mount(tilts: PanelTilts, collector: Collector) -> MountMoves:
    """Prescribe the move of each panel's mount `MOUNT_INSET_M` inside its edge of larger x."""
    columns = collector.panel_edges_x_m
    inset = np.minimum(MOUNT_INSET_M, np.diff(columns) / 4)
    outer = np.tile(columns[1:] - inset, collector.panel_edges_y_m.size - 1)
    return mount_moves(tilts, np.stack([outer, tilts.centre_y_m], axis=1), collector)


def _arc_m(x_m: FloatArray, focal_length_m: float) -> FloatArray:
    """Return the length along the parabola from its vertex [m]."""
    slope = np.asarray(x_m) / (2 * focal_length_m)
    return np.asarray(focal_length_m * (slope * np.hypot(1, slope) + np.arcsinh(slope)))
