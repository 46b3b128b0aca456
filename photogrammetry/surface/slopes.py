"""Deviations at scattered points to a SlopeMap: local quadratics, with the sigma of points, gaps and their own scatter.

The design has the curvature; what is smoothed is the deviation from it. At every node a quadratic is fitted to
the deviations of the nearest points, weighted by distance: a linear estimator, so the covariance of the points goes
through it exactly.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.surfaces import Facet
from heliogauge.slopes.map import CommonModes, SlopeMap, monomials
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.surface.fitted import SurfaceFit

#: Points in a local quadratic: twice its six coefficients. With fewer the noise grows fast, with more the detail goes.
_NEIGHBOURS = 12
#: A node further than this many point spacings from the nearest point is not measured.
_REACH = 1.2
#: Weight of an interpolated height, as variance over that of one point: above 1 the node is extrapolated.
_LEVERAGE = 1.0
_SAMPLED_NODES = 400


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A mirror without steps: its outline and design in the frame of the fit, and the points on it.

    facet: Outline and design; ``ensemble_from_facet`` is not used, both are in the frame of the fit.
    members (n,): Its points.
    """

    facet: Facet
    members: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSlopes:
    """Slope maps of a measured surface.

    whole: All patches in one map.
    patches: Each patch on the same nodes, in the same frame.
    spacing_m: Mean distance of neighbouring points [m].
    scatter_m: RMS of deviations at scales that the points do not resolve, from the residuals of the local fits
        beyond errors of measurement [m].
    bending_rad: RMS error of slope_x and slope_y from what a local quadratic cannot follow; part of the random
        sigmas [rad].
    """

    whole: SlopeMap
    patches: dict[str, SlopeMap]
    spacing_m: float
    scatter_m: float
    bending_rad: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Smoother:
    """Rows that turn deviations at the points into height, slope x and slope y at places, each (k, n)."""

    height: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    measured: BoolArray


def surface_slopes(fit: SurfaceFit, patches: Sequence[Patch], step_m: float | None = None) -> SurfaceSlopes:
    """Make slope maps of a fitted surface.

    fit: Points in the design's frame; outliers are not used.
    patches: Mirrors; slopes are never smoothed from one to another.
    step_m: Distance of the nodes; half the spacing of the points if not given [m].
    Returns: Maps; nodes too far from points, or beyond them, are flagged as not measured.
    EstimationError: Too few points.

    Local regression (Cleveland 1979) of second order with the tricube kernel, its width the distance to the 12th
    neighbour. With the rows H of this estimator at the points and the joint covariance C of the deviations, the
    residuals ``r = (I - H) e`` of the fits have the expectation ``tr((I - H)(C + s^2 I)(I - H)^T)``: from it comes
    s, the scatter of the surface between points, which enters every sigma like a further error of each point.
    A quadratic's slope errs by ``h^2 f'''`` over its width h: fits of twice as many neighbours err twice as much, so
    their difference from those used is the error of these; its RMS beyond noise is added to the random sigmas.
    The smooth part of the covariance (second order over the map, alignment included) is kept as common modes.
    """
    used = ~fit.outliers
    xy = fit.points.points_m[:, :2]
    spacing = _spacing(xy, patches, used)
    x_m, y_m = _axes(patches, step_m or 0.5 * spacing)
    grid_x, grid_y = np.meshgrid(x_m, y_m)
    fields = _Fields(*(np.full(grid_x.shape, np.nan) for _ in range(7)))
    flags = np.full(grid_x.shape, np.uint32(SampleFlag.OUTSIDE_MIRROR))
    owner = np.full(grid_x.shape, -1)
    pieces = []
    for place, patch in enumerate(patches):
        inside = patch.facet.contains(grid_x, grid_y) & (owner < 0)
        owner[inside] = place
        nodes = np.column_stack([grid_x[inside], grid_y[inside]])
        piece = _piece(fit, patch, nodes, spacing)
        fields.fill(inside, nodes, piece, patch.facet)
        flags[inside] = np.where(piece.fine.measured, np.uint32(0), np.uint32(SampleFlag.FAR_FROM_POINTS))
        pieces.append(piece)
    scatter = _scatter(pieces, fit.covariance_deviation_z_m2)
    covariance = fit.covariance_deviation_z_m2 + scatter**2 * np.eye(len(xy))
    order = np.concatenate([np.flatnonzero(owner == place) for place in range(len(patches))])
    at = np.column_stack([grid_x.ravel()[order], grid_y.ravel()[order]])
    common, correlation = _uncertainty(fields, order, at, pieces, covariance)
    bend = _bending(pieces, covariance)
    for field, extra in zip((fields.sigma_x, fields.sigma_y), bend, strict=True):
        field[...] = np.hypot(field, extra)
    whole = SlopeMap(
        x_m=x_m,
        y_m=y_m,
        slope_x=fields.slope_x,
        slope_y=fields.slope_y,
        design_slope_x=fields.design_x,
        design_slope_y=fields.design_y,
        sigma_random_x=fields.sigma_x,
        sigma_random_y=fields.sigma_y,
        noise_correlation=correlation,
        common=common,
        height_m=fields.height,
        flags=flags,
        aperture=owner >= 0,
        design=fit.reference.describe(),
        frame="design frame: x across, y up, seen from the front, z out of the mirror [m]",
        removed=_removed(fit),
    )
    parts = {patch.facet.name: _part(whole, owner == place, patch) for place, patch in enumerate(patches)}
    return SurfaceSlopes(whole, parts, spacing, scatter, bend)


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """One patch: its points with their deviations along z, and the local fits at its nodes and at its points."""

    members: IntArray
    deviations: FloatArray
    fine: _Smoother
    coarse: _Smoother
    at_points: FloatArray


def _piece(fit: SurfaceFit, patch: Patch, nodes: FloatArray, spacing: float) -> _Piece:
    members = np.nonzero(patch.members & ~fit.outliers)[0]
    if members.size < 6:
        raise EstimationError(
            f"slope map of {patch.facet.name}: {members.size} points are not enough, 6 or more are needed; name more "
            "targets of it, or make no map (slope_map = false)"
        )
    points = fit.points.points_m[members]
    deviations = points[:, 2] - patch.facet.design.height(points[:, 0], points[:, 1])
    fine, coarse = (_smoother(nodes, points[:, :2], spacing, k * _NEIGHBOURS) for k in (1, 2))
    return _Piece(members, deviations, fine, coarse, _smoother(points[:, :2], points[:, :2], spacing).height)


def _scatter(pieces: Sequence[_Piece], covariance: FloatArray) -> float:
    """Return the RMS of deviations that neither the local fits nor errors of measurement explain [m]."""
    squares, noise, unit = 0.0, 0.0, 0.0
    for piece in pieces:
        remaining = np.eye(piece.members.size) - piece.at_points
        squares += float(((remaining @ piece.deviations) ** 2).sum())
        noise += float(np.trace(remaining @ covariance[np.ix_(piece.members, piece.members)] @ remaining.T))
        unit += float((remaining**2).sum())
    return float(np.sqrt(max(squares - noise, 0.0) / unit)) if unit > 1e-9 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Fields:
    """Fields of the map while they are filled, each of shape (ny, nx)."""

    slope_x: FloatArray
    slope_y: FloatArray
    design_x: FloatArray
    design_y: FloatArray
    sigma_x: FloatArray
    sigma_y: FloatArray
    height: FloatArray

    def fill(self, inside: BoolArray, nodes: FloatArray, piece: _Piece, facet: Facet) -> None:
        """Fill the nodes of one patch."""
        height, design_x, design_y = facet.design.height_and_gradient(nodes[:, 0], nodes[:, 1])
        rows, gap = piece.fine, np.where(piece.fine.measured, 0.0, np.nan)
        self.design_x[inside], self.design_y[inside] = design_x, design_y
        self.slope_x[inside] = design_x + rows.slope_x @ piece.deviations + gap
        self.slope_y[inside] = design_y + rows.slope_y @ piece.deviations + gap
        self.height[inside] = height + rows.height @ piece.deviations + gap


def _removed(fit: SurfaceFit) -> str:
    if not fit.parameters.covariance.any():
        return "nothing"
    lengths = "; ".join(
        f"{name.removesuffix('_m').replace('_', ' ')} {length:.6g} m"
        for name, (length, _, _) in fit.parameters.lengths().items()
    )
    return "position and rotation by the best fit of the points to the design" + (
        f", with {lengths}" if lengths else ""
    )


def _spacing(xy: FloatArray, patches: Sequence[Patch], used: BoolArray) -> float:
    """Return the distance of neighbouring points: the median of the distances to the fourth nearest of a patch."""
    reaches = []
    for patch in patches:
        own = xy[patch.members & used]
        squares = ((own[:, None] - own[None]) ** 2).sum(axis=2)
        reaches.append(np.sqrt(np.partition(squares, min(4, len(own) - 1), axis=1)[:, min(4, len(own) - 1)]))
    return float(np.median(np.concatenate(reaches)))


def _axes(patches: Sequence[Patch], step: float) -> tuple[FloatArray, FloatArray]:
    corners = np.concatenate([patch.facet.outline_m for patch in patches])
    low, high = np.ceil(corners.min(axis=0) / step - 1e-9), np.floor(corners.max(axis=0) / step + 1e-9)
    x_m, y_m = (step * np.arange(low[k], high[k] + 1) for k in range(2))
    if x_m.size * y_m.size > 250_000:
        raise EstimationError(
            f"slope map: {x_m.size} x {y_m.size} nodes are asked for; points show nothing at that scale, give a larger "
            "grid_step_mm"
        )
    return x_m, y_m


def _bending(pieces: Sequence[_Piece], covariance: FloatArray) -> tuple[float, float]:
    """Return the RMS slope error in x and y of local quadratics, from fits of twice the area."""
    squares, noise, count = np.zeros(2), np.zeros(2), 0
    for piece in pieces:
        if piece.members.size < 2 * _NEIGHBOURS:
            continue
        both = piece.fine.measured & piece.coarse.measured
        count += int(both.sum())
        own = covariance[np.ix_(piece.members, piece.members)]
        for axis, name in enumerate(("slope_x", "slope_y")):
            change = (getattr(piece.fine, name) - getattr(piece.coarse, name))[both]
            squares[axis] += float(((change @ piece.deviations) ** 2).sum())
            noise[axis] += float(np.einsum("ij,ij->", change @ own, change))
    along_x, along_y = np.sqrt(np.maximum(squares - noise, 0.0) / max(count, 1)).tolist()
    return along_x, along_y


def _smoother(places: FloatArray, points: FloatArray, spacing: float, neighbours: int = _NEIGHBOURS) -> _Smoother:
    """Build the local fits at places from points, both in x and y."""
    count = len(points)
    near = min(neighbours, count)
    terms = 6 if count >= 9 else 3
    rows = np.zeros((3, len(places), count))
    measured = np.zeros(len(places), dtype=np.bool_)
    for first in range(0, len(places), 4096):
        block = slice(first, first + 4096)
        offset = points[None] - places[block, None]
        squares = (offset**2).sum(axis=2)
        index = np.argpartition(squares, near - 1, axis=1)[:, :near]
        distance = np.sqrt(np.take_along_axis(squares, index, axis=1))
        # The farthest of the neighbours keeps a little weight, so that all of them count.
        reach = 1.1 * distance.max(axis=1)
        u, v = (np.take_along_axis(offset[..., k], index, axis=1) / reach[:, None] for k in range(2))
        basis = np.moveaxis(monomials(u, v, 2)[:terms], 0, 2)
        root = np.sqrt((1 - (distance / reach[:, None]) ** 3) ** 3)
        inverse = np.linalg.pinv(basis * root[..., None], rcond=1e-6) * root[:, None, :]
        # Where the neighbours do not determine the quadratic the rows do not reproduce it.
        reproduced = np.einsum("kin,knj->kij", inverse[:, :3], basis)
        whole = np.abs(reproduced - np.eye(3, terms)).max(axis=(1, 2)) < 1e-6
        near_enough = distance.min(axis=1) <= _REACH * spacing
        measured[block] = whole & near_enough & ((inverse[:, 0] ** 2).sum(axis=1) <= _LEVERAGE)
        at = np.arange(len(index))[:, None]
        for k, scale in enumerate((np.ones_like(reach), 1 / reach, 1 / reach)):
            rows[k, block][at, index] = inverse[:, k] * scale[:, None]
    return _Smoother(rows[0], rows[1], rows[2], measured)


def _uncertainty(
    fields: _Fields, order: IntArray, at: FloatArray, pieces: Sequence[_Piece], covariance: FloatArray
) -> tuple[CommonModes, float]:
    """Fill the sigmas; return the smooth modes and how many nodes share one independent value."""
    measured = np.concatenate([piece.fine.measured for piece in pieces])
    if not measured.any():
        raise EstimationError("slope map: no node is near enough to points; give another outline_m or grid_step_mm")
    # Rows times a root of the covariance: what each independent unit error does to every node.
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    errors = [
        np.concatenate([getattr(piece.fine, name) @ root[piece.members] for piece in pieces])[measured]
        for name in ("slope_x", "slope_y")
    ]
    at, order = at[measured], order[measured]
    center, scale = at.mean(axis=0), max(0.5 * float(np.ptp(at, axis=0).max()), 1e-9)
    degree = 2 if len(at) >= 12 else 0
    terms = monomials((at[:, 0] - center[0]) / scale, (at[:, 1] - center[1]) / scale, degree)
    onto = np.asarray(np.linalg.pinv(terms.T), dtype=np.float64)
    coefficients = np.concatenate([onto @ one for one in errors])
    left, singular, _ = np.linalg.svd(coefficients, full_matrices=False)
    kept = singular > 1e-3 * singular[0]
    modes = (left * singular)[:, kept].T.reshape(-1, 2, len(terms))
    common = CommonModes(("points and their alignment",) * len(modes), modes, center, scale)
    shared = np.einsum("kai,kai->ai", *[np.tensordot(modes, terms, axes=(2, 0))] * 2)
    for axis, field in enumerate((fields.sigma_x, fields.sigma_y)):
        variance = (errors[axis] ** 2).sum(axis=1)
        field.ravel()[order] = np.sqrt(np.maximum(variance - shared[axis], 0.0))
    return common, _correlation(errors, terms, onto)


def _correlation(errors: list[FloatArray], terms: FloatArray, onto: FloatArray) -> float:
    """Return the number of nodes that share one independent value: the sum of squared correlations, mean of nodes."""
    shares = []
    for one in errors:
        rest = one - terms.T @ (onto @ one)
        sample = rest[:: max(1, len(rest) // _SAMPLED_NODES)]
        sizes, own = np.linalg.norm(rest, axis=1), np.linalg.norm(sample, axis=1)
        ratio = (sample @ rest.T) / np.maximum(own[:, None] * sizes, 1e-300)
        shares.append(float((ratio**2).sum(axis=1).mean()))
    return max(1.0, float(np.mean(shares)))


def _part(whole: SlopeMap, own: BoolArray, patch: Patch) -> SlopeMap:
    """Cut the map of one patch out of the whole."""
    if not own.any():
        raise EstimationError(
            f"slope map of {patch.facet.name}: no node is inside its outline; give a smaller grid_step_mm"
        )
    rows, columns = (np.flatnonzero(own.any(axis=axis)) for axis in (1, 0))
    cut = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]

    def field(values: FloatArray) -> FloatArray:
        return np.where(own[cut], values[cut], np.nan)

    return SlopeMap(
        x_m=whole.x_m[cut[1]],
        y_m=whole.y_m[cut[0]],
        slope_x=field(whole.slope_x),
        slope_y=field(whole.slope_y),
        design_slope_x=field(whole.design_slope_x),
        design_slope_y=field(whole.design_slope_y),
        sigma_random_x=field(whole.sigma_random_x),
        sigma_random_y=field(whole.sigma_random_y),
        noise_correlation=whole.noise_correlation,
        common=whole.common,
        height_m=field(whole.height_m),
        flags=np.where(own[cut], whole.flags[cut], np.uint32(SampleFlag.OUTSIDE_MIRROR)),
        aperture=own[cut],
        design=patch.facet.design.describe(),
        frame=whole.frame,
        removed=whole.removed,
    )


def hull_outline(xy_m: FloatArray) -> FloatArray:
    """Return the convex hull of points, counter-clockwise, shape (m, 2) [m].

    Shapes: result (m, 2).
    xy_m (n, 2): Points, not all on one line [m].
    """
    from scipy.spatial import ConvexHull

    return np.asarray(xy_m[ConvexHull(xy_m).vertices])
