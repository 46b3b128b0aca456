"""Panels and cameras by the panels' own edges, beside the marked targets that gave the poses.

A gap between two panels, or a rim, that runs along the trough is seen from all places of a pass across it. Its place
across the trough and its height follow from that as those of a target do, to 0.1 or 0.2 mm from some twenty photos:
where cameras and tube are over the mirror, which a list of targets tells to the millimetre it is good for, and how high
each panel is mounted.

All is linear and Gaussian. Edges are beside where poses and drawing predict them by ``J s + K e + noise``, with the
steps s of the poses, which the targets know with their covariance, and the places e of the edges' ends. These are made
by the panels (moved along the mirror, higher, higher towards one end of the trough), by the shape of each panel, which
its slopes say, and by what each edge is off besides. How much that is in height the edges themselves say.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.corners.lattice import PanelLattice
from observer.corners.list_beside import ListBeside, list_beside, list_steps
from observer.corners.panel_lines import FoundLine, normals_at
from observer.photo_edges.views import View
from observer.slopes.panel_places import PanelPlaces
from observer.slopes.pose_modes import Photos
from observer.trough.collector import Collector

#: Places of a line whose offsets are independent of each other where its pieces count alike.
END_SHARES = (0.5 - 12**-0.5, 0.5 + 12**-0.5)
#: What each edge may be off in height besides its panel [m]: bends along the trough, its own rim. Weighted by how
#: probable each makes what is seen.
_OWN_M = (0.05e-3, 0.1e-3, 0.2e-3, 0.4e-3, 0.8e-3, 1.6e-3)
#: Times the standard deviation beyond which a photo does not show an edge; rounds of that.
_REJECT_TIMES, _ROUNDS = 4.0, 4
#: Photos next to each other err alike: the background of a rim moves slowly. Means of so many tell by how much.
_ALIKE_PHOTOS = 4
#: A share of the covariance of poses that keeps it positive definite.
_TINY = 1e-9


class EdgeSights(NamedTuple):
    """Ends of edges in photos, arrays of m rows.

    photo, end (m,): Numbers of the photo and of the end.
    offset_px, sigma_px (m,): How far the edge is beside where the pose predicts it, along its normal [px].
    by_pose (m, 6): What a step of the pose adds to the prediction [px/rad, px/m].
    by_place (m, 2): What a movement of the end across the trough adds, and a higher end [px/m].
    """

    photo: IntArray
    end: IntArray
    offset_px: FloatArray
    sigma_px: FloatArray
    by_pose: FloatArray
    by_place: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class EdgeEnds:
    """Two places on each edge of a panel that runs along the trough.

    points_m (e, 3): By the drawing [m].
    panel (e, 2): Numbers of the panels at smaller and larger x, -1 beyond the rims (`Collector.panel_index`).
    """

    points_m: FloatArray
    panel: IntArray

    @classmethod
    def of(cls, lattice: PanelLattice) -> "EdgeEnds":
        """Return the ends of all lines of constant x, in their order."""
        points, panels, columns = [], [], len(lattice.edges_m[0]) - 1
        for line in lattice.along_trough:
            points.append(lattice.along(line, np.array(END_SHARES)))
            beside = [line.cell * columns + k if 0 <= k < columns else -1 for k in (line.number - 1, line.number)]
            panels += [beside, beside]
        return cls(np.concatenate(points), np.array(panels, dtype=np.intp))

    @property
    def sides(self) -> IntArray:
        """Number of panels at each end, shape (e,)."""
        return np.asarray((self.panel >= 0).sum(axis=1))


def edge_sights(number: int, view: View, lattice: PanelLattice, found: tuple[FoundLine | None, ...]) -> EdgeSights:
    """Return what one photo shows of the ends of the lines along the trough.

    number: Of the photo.
    view: Camera and pose by which the lines were looked for.
    found: Lines of constant x as found, in their order; None where one is not seen.
    """
    share, numbers = np.array(END_SHARES), [k for k, one in enumerate(found) if one is not None]
    lines = [one for one in found if one is not None]
    if not lines:
        none, empty = np.zeros(0, dtype=np.intp), np.zeros(0)
        return EdgeSights(none, none, empty, empty, np.zeros((0, 6)), np.zeros((0, 2)))
    # All lines in one call each: sixty photos of twenty lines take a tenth of the time.
    which, shares = np.arange(len(lines))[:, None], np.broadcast_to(share, (len(lines), share.size))
    own = [one.line for one in lines]
    _, normals = normals_at(view, lattice, own, which, shares)
    points = lattice.on_lines(own, which, shares)
    seen = view.camera.project_posed(points, view.cam_from_frame)
    place = np.einsum("kei,keij->kej", normals, seen.d_pixel_d_point)
    pose = np.einsum("kei,keij->kej", normals, seen.d_pixel_d_pose)
    found_at = np.array([[one.at(end) for end in END_SHARES] for one in lines]).reshape(-1, 2)
    end = (2 * np.array(numbers, dtype=np.intp)[:, None] + np.arange(share.size)).ravel()
    return EdgeSights(
        np.full(end.size, number, dtype=np.intp),
        end,
        found_at[:, 0],
        np.sqrt(found_at[:, 1]),
        pose.reshape(-1, 6),
        place.reshape(-1, 3)[:, [0, 2]],
    )


def joined_sights(parts: list[EdgeSights]) -> EdgeSights:
    """Return the rows of several photos."""
    return EdgeSights(*(np.concatenate(some) for some in zip(*parts, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class PlacedByEdges:
    """Poses and panels by the panels' edges.

    photos: Poses with their covariance, and the panels.
    used (m,): Which rows agree with the others.
    ends_m (e, 2): How far each end is beside the drawing, across the trough and in height [m].
    over_sigma (e,): The first of these over what is expected of it before the photos are seen.
    listed: How the list of targets stands beside the mirror.
    """

    photos: Photos
    used: BoolArray
    ends_m: FloatArray
    over_sigma: FloatArray
    listed: ListBeside


def place_by_edges(
    sights: EdgeSights,
    ends: EdgeEnds,
    shape_m: FloatArray,
    photos: Photos,
    lattice: PanelLattice,
    lean_sigma: float,
) -> PlacedByEdges:
    """Adjust poses and panels to the panels' edges.

    shape_m (e,): How much higher each end is by the shape that the slopes of its panels say, mean zero over the row of
        a panel; zero where the mirror does not have that shape [m].
    photos: Poses by the targets.
    lean_sigma: Standard deviation of a panel's slope along the trough.
    """
    steady = _Steady.of(sights, ends, photos, _Panels.of(ends, lattice, lean_sigma))
    solved = steady.solve(shape_m)
    gain = _gain(photos, steady)
    moved, places = _moved(photos, steady, solved, gain), _places(photos, steady, solved, gain)
    across, up = np.split(solved.ends, 2)
    over = np.abs(across) / np.sqrt(np.diag(solved.prior_ends)[: across.size])
    beside = np.stack([across, up + shape_m], axis=1)
    listed = steady.list_beside(shape_m, ends, photos, solved.prior_ends, lattice.collector)
    return PlacedByEdges(replace(moved, panels=places), steady.used, beside, over, listed)


class _Steady(NamedTuple):
    """What stays the same whatever shape the panels have.

    sights: With sigmas as they scatter.
    rank (m,): Number of the photo of each row among those that show any, ascending.
    used (m,): Rows that agree with the others.
    steps (6 k,): Which steps of poses move the rows.
    root (6 k, 6 k): Lower root of their covariance.
    """

    sights: EdgeSights
    rank: IntArray
    used: BoolArray
    steps: IntArray
    root: FloatArray
    panels: "_Panels"

    @classmethod
    def of(cls, sights: EdgeSights, ends: EdgeEnds, photos: Photos, panels: "_Panels") -> "_Steady":
        seen = np.unique(sights.photo)
        steps = (6 * seen[:, None] + np.arange(6)).ravel()
        known = photos.covariance[np.ix_(steps, steps)]
        root = np.linalg.cholesky(known + _TINY * np.diag(np.diag(known)))
        rank, used = np.searchsorted(seen, sights.photo), np.ones(sights.photo.size, dtype=bool)
        found = cls(sights, rank, used, steps, root, panels)
        for _ in range(_ROUNDS):
            # No shape: what each end is off by itself takes it.
            solved = found.solve(np.zeros(len(ends.panel)))
            miss = sights.offset_px - solved.predicted(found)
            scaled = sights.sigma_px * _noise_ratio(miss / sights.sigma_px, sights, found.used, ends)
            used = np.abs(miss) < _REJECT_TIMES * scaled
            is_settled = bool((used == found.used).all()) and np.allclose(scaled, found.sights.sigma_px, rtol=0.02)
            found = found._replace(sights=sights._replace(sigma_px=scaled), used=used)
            if is_settled:
                break
        return found

    def _rows(self, shape_m: FloatArray) -> "_Rows":
        sights, m, count = self.sights, np.flatnonzero(self.used), len(shape_m)
        weight = 1 / sights.sigma_px[m]
        by_end = np.zeros((m.size, 2 * count))
        by_place = weight[:, None] * sights.by_place[m]
        np.put_along_axis(by_end, sights.end[m, None] + np.array([0, count]), by_place, axis=1)
        offset = weight * (sights.offset_px - sights.by_place[:, 1] * shape_m[sights.end])[m]
        return _Rows(weight[:, None] * sights.by_pose[m], by_end, offset, self.rank[m])

    def list_beside(
        self, shape_m: FloatArray, ends: EdgeEnds, photos: Photos, prior_ends: FloatArray, collector: Collector
    ) -> ListBeside:
        """Estimate how the list of targets stands beside the mirror.

        shape_m (e,): As for `solve`; prior_ends (2 e, 2 e): covariance of the ends' places as it had it.
        photos: Poses by the targets.
        """
        rows, size = self._rows(shape_m), len(self.root)
        steps = list_steps([photos.poses[k] for k in np.unique(self.sights.photo)], collector.rim_height_m)
        by_steps, by_list = np.zeros((rows.offset.size, size)), np.zeros((rows.offset.size, steps.shape[2]))
        for k, (first, last) in enumerate(pairwise(np.searchsorted(rows.rank, np.arange(size // 6 + 1)))):
            by_steps[first:last] = rows.by_pose[first:last] @ self.root[6 * k : 6 * k + 6]
            by_list[first:last] = rows.by_pose[first:last] @ steps[k]
        height = ends.points_m[:, 0] ** 2 / (4 * collector.focal_length_m)
        by_unknown = np.hstack([by_steps, rows.by_end @ np.linalg.cholesky(prior_ends)])
        return list_beside(rows.offset, by_unknown, by_list, rows.by_end[:, len(height) :] @ height)

    def solve(self, shape_m: FloatArray) -> "_Solved":
        """Solve for steps and ends; how far each end is off by itself is what makes the sights probable.

        shape_m (e,): How much higher the ends are by the shape of the panels [m].
        """
        by_pose, by_end, offset, rank = self._rows(shape_m)
        size = len(self.root)
        # A photo's rows move with its own six steps alone: sums over them come before the root that ties all.
        blocks, both, of_steps = np.zeros((size // 6, 6, 6)), np.zeros((size // 6, 6, by_end.shape[1])), np.zeros(size)
        for k, (first, last) in enumerate(pairwise(np.searchsorted(rank, np.arange(size // 6 + 1)))):
            own = by_pose[first:last]
            blocks[k], both[k] = own.T @ own, own.T @ by_end[first:last]
            of_steps[6 * k : 6 * k + 6] = own.T @ offset[first:last]
        normal = self.root.T @ (blocks @ self.root.reshape(-1, 6, size)).reshape(size, size)
        both, of_steps = self.root.T @ both.reshape(size, -1), self.root.T @ of_steps
        alone = np.linalg.inv(normal + np.eye(size))
        carried = alone @ both
        normal, right = by_end.T @ by_end - both.T @ carried, by_end.T @ offset - carried.T @ of_steps
        # The mean of the variance, by how probable each is: the most probable one may by chance be far too small.
        tried = np.array([_OfEnds.of(self.panels.covariance_m2(own_m), normal, right).evidence for own_m in _OWN_M])
        own_m = float(np.sqrt(np.average(np.square(_OWN_M), weights=np.exp(tried - tried.max()))))
        prior_ends = self.panels.covariance_m2(own_m)
        of_ends = _OfEnds.of(prior_ends, normal, right)
        ends = of_ends.covariance @ right
        with_ends = -carried @ of_ends.covariance
        known = alone - with_ends @ carried.T
        return _Solved(
            alone @ (of_steps - both @ ends),
            0.5 * (known + known.T),
            ends,
            of_ends.covariance,
            with_ends,
            prior_ends,
        )


class _Rows(NamedTuple):
    """Used sights over their sigmas: what steps of the photos and places of the ends add, offsets, ranks of photos."""

    by_pose: FloatArray
    by_end: FloatArray
    offset: FloatArray
    rank: IntArray


class _OfEnds(NamedTuple):
    """Covariance of the ends' places with some prior, and the logarithm of how probable it makes the sights."""

    covariance: FloatArray
    evidence: float

    @classmethod
    def of(cls, prior: FloatArray, normal: FloatArray, right: FloatArray) -> "_OfEnds":
        factor = np.linalg.cholesky(prior)
        inner = np.eye(len(prior)) + factor.T @ normal @ factor
        covariance = factor @ np.linalg.solve(inner, factor.T)
        covariance = 0.5 * (covariance + covariance.T)
        return cls(covariance, 0.5 * float(right @ covariance @ right - np.linalg.slogdet(inner)[1]))


def _noise_ratio(miss: FloatArray, sights: EdgeSights, used: BoolArray, ends: EdgeEnds) -> FloatArray:
    """Return by what the sigmas are too small, for gaps and rims apart, shape (m,); 1 at least.

    miss (m,): Residuals over sigma.
    """
    ratio = np.ones(miss.size)
    is_rim = ends.sides[sights.end] == 1
    order = np.lexsort((sights.photo, sights.end))
    for kind in (True, False):
        own = order[(is_rim[order] == kind) & used[order]]
        if own.size < 2 * _ALIKE_PHOTOS:
            continue
        square = max(1.0, robust_scale(miss[own])) ** 2
        whole = own[: own.size // _ALIKE_PHOTOS * _ALIKE_PHOTOS].reshape(-1, _ALIKE_PHOTOS)
        same = sights.end[whole[:, 0]] == sights.end[whole[:, -1]]
        if same.any():
            means = miss[whole[same]].mean(axis=1)
            square = max(square, _ALIKE_PHOTOS * robust_scale(means) ** 2)
        ratio[is_rim == kind] = np.sqrt(square)
    return ratio


class _Panels(NamedTuple):
    """What makes the places of the ends: x of all, then height of all.

    by_unknown (2 e, 3 p): Of the panels' height, lean along the trough, and place along the mirror.
    variance (3 p,): Of these.
    own_x_m2 (e,): Variance that each end has in x by itself [m^2].
    sides (e,): Number of panels at each end.
    lean_sigma: Standard deviation of the leans.
    """

    by_unknown: FloatArray
    variance: FloatArray
    own_x_m2: FloatArray
    sides: IntArray
    lean_sigma: float

    @classmethod
    def of(cls, ends: EdgeEnds, lattice: PanelLattice, lean_sigma: float) -> "_Panels":
        collector, count = lattice.collector, len(ends.panel)
        n, columns = collector.n_panels, len(lattice.edges_m[0]) - 1
        middle_y = 0.5 * (lattice.edges_m[1][1:] + lattice.edges_m[1][:-1])
        by_unknown = np.zeros((2 * count, 3 * n))
        sides = ends.sides
        slope = ends.points_m[:, 0] / (2 * collector.focal_length_m)
        for side in (0, 1):
            rows = np.flatnonzero(ends.panel[:, side] >= 0)
            own, share = ends.panel[rows, side], 1 / sides[rows]
            by_unknown[count + rows, own] = share
            by_unknown[count + rows, n + own] = share * (ends.points_m[rows, 1] - middle_y[own // columns])
            along = share / np.hypot(1, slope[rows])
            by_unknown[rows, 2 * n + own] = along
            by_unknown[count + rows, 2 * n + own] = slope[rows] * along
        is_held = collector.panel_height_sigma_m == 0
        sigmas = [collector.panel_height_sigma_m, 0.0 if is_held else lean_sigma, lattice.mounting_sigma_m]
        variance = np.repeat(np.square(sigmas), n)
        return cls(by_unknown, variance, lattice.corner_sigma_m**2 / sides, sides, lean_sigma)

    def covariance_m2(self, own_m: float) -> FloatArray:
        """Return the covariance of the ends' places."""
        own = np.concatenate([self.own_x_m2, own_m**2 / self.sides])
        return np.asarray((self.by_unknown * self.variance) @ self.by_unknown.T + np.diag(own))


class _Solved(NamedTuple):
    """Steps of poses, in units of their root, and places of the ends, with their joint covariance."""

    steps: FloatArray
    covariance_steps: FloatArray
    ends: FloatArray
    covariance_ends: FloatArray
    steps_with_ends: FloatArray
    prior_ends: FloatArray

    def predicted(self, steady: _Steady) -> FloatArray:
        """Return where the rows should be, shape (m,) [px]."""
        sights, step, place = steady.sights, (steady.root @ self.steps).reshape(-1, 6), self.ends.reshape(2, -1).T
        moved = np.einsum("mi,mi->m", sights.by_pose, step[steady.rank])
        return np.asarray(moved + np.einsum("mi,mi->m", sights.by_place, place[sights.end]))


def _moved(photos: Photos, steady: _Steady, solved: _Solved, gain: FloatArray) -> Photos:
    """Return all poses with what the edges say; those whose edges were not looked at follow the others."""
    moves = (gain @ solved.steps).reshape(-1, 6)
    taken, ways = np.linalg.eigh(np.eye(len(steady.root)) - solved.covariance_steps)
    # The product of a matrix and its own transpose takes half the time of any other.
    root = gain @ (ways * np.sqrt(np.maximum(taken, 0.0)))
    poses = tuple(pose.moved(move) for pose, move in zip(photos.poses, moves, strict=True))
    return Photos(poses, photos.covariance - root @ root.T)


def _gain(photos: Photos, steady: _Steady) -> FloatArray:
    """Return what one unit of each combination of the looked-at steps does to all steps, shape (6 n, k)."""
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(steady.root, photos.covariance[steady.steps], lower=True).T)


def _places(photos: Photos, steady: _Steady, solved: _Solved, gain_of_steps: FloatArray) -> PanelPlaces | None:
    """Return heights and leans of the panels; None where they are held."""
    panels = steady.panels
    n = panels.variance.size // 3
    if panels.variance[0] == 0:
        return None
    by_unknown, variance = panels.by_unknown[:, : 2 * n], panels.variance[: 2 * n]
    gain = np.linalg.solve(solved.prior_ends, by_unknown * variance).T
    covariance = np.diag(variance) - gain @ (solved.prior_ends - solved.covariance_ends) @ gain.T
    with_steps = gain @ solved.steps_with_ends.T
    by_poses = np.zeros((2 * n, len(photos.covariance)))
    carried = np.linalg.solve(solved.covariance_steps, with_steps.T)
    by_poses[:, steady.steps] = np.linalg.solve(steady.root.T, carried).T
    return PanelPlaces(
        gain @ solved.ends,
        0.5 * (covariance + covariance.T),
        with_steps @ gain_of_steps.T,
        by_poses,
        panels.lean_sigma,
    )
