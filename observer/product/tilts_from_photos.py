"""How far each panel is turned, from a few photos of the absorber's reflection in it (TOPCAT).

A camera before each row of panels sees the tube's image in it (Diver, Moss 2007). Each edge of that image gives the
normal's angle where it lies, by the equation of the whole method; the panel's turn is their mean. What the panel's own
shape does to that, as edges lie at a few places only, is in the sigma: typical mirrors of 3 mrad RMS, or larger where
the differences between the edges ask for it.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.photo_edges.reflection_edges import ReflectionEdges, design_misfit
from observer.product.panel_alignment import PanelTilts
from observer.selection.edge_refusal import EdgeFate, first_fate, is_alone
from observer.selection.two_sided import agreed_by_both
from observer.slopes.pose_modes import Photos, pose_derivatives
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.observation_equation import Sights, change_across
from observer.trough.typical_mirror import TypicalMirror

#: Typical mirrors that are drawn for what a panel's shape does: a sigma to 5 %.
_DRAWN = 200
#: Places across and along a panel over which a typical mirror is averaged.
_PLACES = 12
#: RMS of the slopes of usual mirrors, as flights are planned for; these have no better ones to start from [rad].
_TYPICAL_RAD = 3e-3
#: Share of the typical covariance that is added to it: of 200 draws it is known to a tenth.
_RIDGE = 0.1
#: Fewest edges of each side that say something of a panel.
_LEAST_EDGES = 6


@dataclass(frozen=True, slots=True, eq=False)
class SeenPanels:
    """Turns of all panels by photos.

    to_absorber, to_design: Against the absorber as it is, and against the design's focal line.
    used (m,): Edges that count.
    shape_rad: RMS of the slopes of a typical mirror whose edges differ as much [rad].
    """

    to_absorber: PanelTilts
    to_design: PanelTilts
    used: BoolArray
    shape_rad: float


def tilts_from_photos(
    edges: ReflectionEdges, photos: Photos, collector: Collector, absorber: AbsorberPath, y_m: FloatArray
) -> SeenPanels:
    """Measure the turn of each panel.

    edges: Candidates of all photos.
    absorber: The tube's axis, as well as it is known.
    y_m (r,): Rows along the trough [m].
    Returns: NaN for panels in which not both edges of the image lie.
    """
    sights = Sights(edges.points_m, photos.eyes_of(edges.points_m, edges.photo), edges.side)
    found = design_misfit(edges.points_m, sights.eyes_m, edges.side, collector, absorber)
    slope = edges.points_m[:, 0] / (2 * collector.focal_length_m)
    # A turn of the normal towards +x lowers dz/dx by 1 + slope^2 times as much.
    by_turn = -found.d_angle_d_slope_x * (1 + slope**2)
    turn = -found.angle_rad / by_turn
    panel = collector.panel_index(edges.points_m[:, 0], edges.points_m[:, 1])
    used = _used(edges, panel, found.angle_rad, _half_rad(edges, collector, absorber), y_m)
    values = np.where(used & np.isfinite(turn), turn, 0.0)
    weights, shape, shape_rad = _panel_weights(edges, used, panel, values, collector)
    known = weights.any(axis=1)
    by_pose = pose_derivatives(sights, found, photos.poses, edges.photo, collector.focal_length_m)
    by_pose = -by_pose / by_turn[:, None]
    tilt = np.where(known, weights @ values, np.nan)
    variance = shape + _pose_share(weights, by_pose, edges.photo, photos.covariance)
    across = change_across(sights, found, collector.focal_length_m) * edges.sigma_x_m / by_turn
    variance = variance + weights**2 @ np.where(used, np.nan_to_num(across) ** 2, 0.0)
    place = np.where(used[:, None], -found.d_angle_d_absorber / by_turn[:, None], 0.0)
    sigma_x, sigma_z = absorber.sigma_at(collector_centres(collector)[1])
    through = np.stack([weights @ np.nan_to_num(place[:, k]) for k in (0, 1)])
    with_place = variance + (through[0] * sigma_x) ** 2 + (through[1] * sigma_z) ** 2
    aside = np.where(used, _aside_rad(edges.points_m, collector, absorber), 0.0)
    share = _shares(edges, panel, used, collector, y_m)
    centre_x, centre_y = collector_centres(collector)

    def as_tilts(values_rad: FloatArray, variance_rad2: FloatArray) -> PanelTilts:
        sigma = np.where(known, np.sqrt(variance_rad2), np.nan)
        return PanelTilts(centre_x, centre_y, values_rad, sigma, share)

    # Where the tube is aside, the mirror is that much more or less off the tube; that share it does not owe to place.
    return SeenPanels(as_tilts(tilt + weights @ aside, variance), as_tilts(tilt, with_place), used, shape_rad)


def collector_centres(collector: Collector) -> tuple[FloatArray, FloatArray]:
    """Return x and y of the middles of all panels, in the order of `Collector.panel_index`, shape (k,) each [m]."""
    columns, rows = collector.panel_edges_x_m, collector.panel_edges_y_m
    x, y = np.meshgrid((columns[:-1] + columns[1:]) / 2, (rows[:-1] + rows[1:]) / 2)
    return x.ravel(), y.ravel()


def _half_rad(edges: ReflectionEdges, collector: Collector, absorber: AbsorberPath) -> FloatArray:
    axis = np.stack(absorber.at(edges.points_m[:, 1]), axis=1)
    away = np.linalg.norm(axis - edges.points_m[:, [0, 2]], axis=1)
    return np.asarray(np.arcsin(np.clip(collector.absorber_diameter_m / 2 / away, 0, 1)))


def _used(
    edges: ReflectionEdges, panel: IntArray, shift_rad: FloatArray, half_rad: FloatArray, y_m: FloatArray
) -> BoolArray:
    """Return the edges that are the tube's: by brightness, by their course, and as both sides of a panel agree."""
    fate = first_fate(edges)
    fine = (fate == EdgeFate.USED) & np.isfinite(shift_rad) & (panel >= 0)
    fine &= ~is_alone(edges, fine, y_m)
    used = np.zeros(fine.shape, dtype=bool)
    used[fine] = agreed_by_both(panel[fine], edges.side[fine], shift_rad[fine], half_rad[fine])
    return used


def _panel_weights(
    edges: ReflectionEdges, used: BoolArray, panel: IntArray, turn_rad: FloatArray, collector: Collector
) -> tuple[FloatArray, FloatArray, float]:
    """Return the weights of edges in each panel's mean, the variance that its shape leaves, and the mirrors' RMS.

    Shapes: weights (k, m), variance (k,).

    Each edge of the image in each photo is a piece; all count alike. Weights that would do best on typical mirrors go
    beyond the pieces, to what these mirrors' waves are like there, and do no better on others.
    """
    count = len(collector_centres(collector)[0])
    pieces = [_pieces(edges, used & (panel == number)) for number in range(count)]
    off = _drawn_off(edges, pieces, collector)
    weights, variance, square, freedom = np.zeros((count, used.size)), np.full(count, np.nan), 0.0, 0
    for number, (own, drawn) in enumerate(zip(pieces, off, strict=True)):
        if not own:
            continue
        covariance = drawn.T @ drawn / _DRAWN
        inverse = np.linalg.inv(covariance + _RIDGE * np.trace(covariance) / len(own) * np.eye(len(own)))
        share = np.full(len(own), 1 / len(own))
        variance[number] = float(share @ covariance @ share)
        for which, weight in zip(own, share, strict=True):
            weights[number, which] = weight / which.size
        left = np.array([turn_rad[which].mean() for which in own])
        left = left - share @ left
        square, freedom = square + float(left @ inverse @ left), freedom + len(own) - 1
    # Waves that run along the trough are the same in all panels of a column: their edges differ less than they are off.
    scale = max(square / max(freedom, 1), _TYPICAL_RAD**2)
    return weights, variance * scale, float(np.sqrt(scale))


def _pieces(edges: ReflectionEdges, own: BoolArray) -> list[IntArray]:
    """Return the edges of each side of the image in each photo; none where only one side is seen."""
    pieces = []
    for photo in np.unique(edges.photo[own]):
        sides = [np.flatnonzero(own & (edges.photo == photo) & (edges.side == sign)) for sign in (-1.0, 1.0)]
        pieces += [one for one in sides if one.size >= _LEAST_EDGES]
    sides_seen = {float(edges.side[one[0]]) for one in pieces}
    return pieces if len(sides_seen) == len((-1.0, 1.0)) else []


def _drawn_off(edges: ReflectionEdges, pieces: list[list[IntArray]], collector: Collector) -> list[FloatArray]:
    """Return by how much typical mirrors of 1 rad RMS turn each piece more than its panel, shape (draws, pieces)."""
    count, rng = len(pieces), np.random.default_rng(0)
    focal = collector.focal_length_m
    # Angles of the normal are slopes over 1 + slope^2, and go the other way.
    square = 1 + (edges.points_m[:, 0] / (2 * focal)) ** 2
    share = (np.arange(_PLACES) + 0.5) / _PLACES
    x, y = (
        (one[:-1, None] + np.diff(one)[:, None] * share).ravel()
        for one in (collector.panel_edges_x_m, collector.panel_edges_y_m)
    )
    grid_x, grid_y = (one.ravel() for one in np.meshgrid(x, y))
    panel = collector.panel_index(grid_x, grid_y)
    inside = panel >= 0
    grid_square = 1 + (grid_x[inside] / (2 * focal)) ** 2
    per_panel = np.maximum(np.bincount(panel[inside], minlength=count), 1)
    # Waves that run straight along a panel are not averaged out by its rows: each panel is looked at in its middle row.
    centre_y = collector_centres(collector)[1]
    edge_y = centre_y[np.maximum(collector.panel_index(edges.points_m[:, 0], edges.points_m[:, 1]), 0)]
    grid_y = centre_y[np.maximum(panel, 0)]
    off = [np.zeros((_DRAWN, len(own))) for own in pieces]
    for k in range(_DRAWN):
        mirror = TypicalMirror.drawn(collector, rng, 1.0, 0.0)
        here = mirror.errors(edges.points_m[:, 0], edge_y)[0] / square
        there = mirror.errors(grid_x[inside], grid_y[inside])[0] / grid_square
        means = np.bincount(panel[inside], there, count) / per_panel
        for number, own in enumerate(pieces):
            off[number][k] = [here[which].mean() - means[number] for which in own]
    return off


def _pose_share(weights: FloatArray, by_pose: FloatArray, photo: IntArray, covariance: FloatArray) -> FloatArray:
    """Return the variance that uncertain poses make in each panel's mean, shape (k,)."""
    steps = np.zeros((len(weights), len(covariance)))
    for number in np.unique(photo):
        own = photo == number
        steps[:, 6 * number : 6 * number + 6] = weights[:, own] @ np.nan_to_num(by_pose[own])
    return np.asarray(np.einsum("ki,ij,kj->k", steps, covariance, steps))


def _aside_rad(points_m: FloatArray, collector: Collector, absorber: AbsorberPath) -> FloatArray:
    """Return by what angle the normal that lights the tube as it is differs from the one that lights the focal line."""
    x, z = points_m[:, 0], points_m[:, 2]
    tube_x, tube_z = absorber.at(points_m[:, 1])
    wanted = 0.5 * np.arctan2(tube_x - x, tube_z - z)
    return np.asarray(0.5 * np.arctan2(-x, collector.focal_length_m - z) - wanted)


def _shares(
    edges: ReflectionEdges, panel: IntArray, used: BoolArray, collector: Collector, y_m: FloatArray
) -> FloatArray:
    """Return in what share of each panel's rows both edges of the image are seen, shape (k,)."""
    centre_x, _ = collector_centres(collector)
    found = np.zeros(centre_x.size)
    for number in range(centre_x.size):
        rows = int(np.count_nonzero(collector.panel_index(np.full(y_m.shape, centre_x[number]), y_m) == number))
        first, second = (np.unique(edges.row[used & (panel == number) & (edges.side == sign)]) for sign in (-1.0, 1.0))
        found[number] = int(np.intersect1d(first, second).size) / max(rows, 1)
    return found
