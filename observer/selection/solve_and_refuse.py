"""From edges in all photos to the mirror's slope errors: which edges are the tube's, and what they say together."""

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.photo_edges.reflection_edges import ReflectionEdges, design_misfit
from observer.selection.contradicted import contradicted_edges
from observer.selection.edge_refusal import EdgeFate, curves_of, first_fate, has_shadows, is_alone
from observer.selection.edge_scatter import scatter_along
from observer.selection.shadows import confirmed_edges, pulled_curves
from observer.selection.two_sided import agreed_by_both, cells_of
from observer.slopes.along_variance import PossibleRoughness, averaged, find_along
from observer.slopes.common_unknowns import (
    BesidePoses,
    CommonUnknowns,
    beside_poses,
    common_unknowns,
    glass_widening_rad,
)
from observer.slopes.edge_gaps import EdgeGaps, edge_gaps
from observer.slopes.edge_likeness import EdgeLikeness, edge_likeness
from observer.slopes.halves import PRIOR_RAD, Halves, halves_of, halves_patterns
from observer.slopes.joint_solution import (
    RoughnessEvidence,
    SlopeErrors,
    find_roughness,
    solve_common,
    solve_jointly,
)
from observer.slopes.mirror_surface import at_points, beside_chord, heights, on_surface
from observer.slopes.pose_modes import Photos, pose_derivatives, pose_scatter, reduce_to_modes
from observer.slopes.row_likeness import likeness_along, row_likeness
from observer.slopes.row_spline import Roughness, RowGrid, TouchingLines, nodes_of
from observer.slopes.shape_share import ShapeShare, find_shape_share
from observer.slopes.slope_sums import AveragedSums, SlopeSums
from observer.slopes.twist import slopes_by_twist
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.expectation import Expectation
from observer.trough.observation_equation import Sights, change_across, misfit_with_slopes

#: Extra scatter in the edge's angle that is allowed in each round [rad]: edges of clouds, seams and shadows fall out
#: step by step, while those of a mirror that is bent more than expected stay.
_ALLOWANCES_RAD = (4e-3, 1e-3, 2.5e-4, 0.0)
#: Times the standard deviation beyond which an edge is not the tube's.
_REJECT_TIMES = 4.0
#: What observations lack besides the noise of their edge, which counts where the reflection moves quickly [rad]: the
#: mirror between nodes, its height, slopes along the trough.
_MODEL_RAD = 6e-6
#: An edge that steps the other way because the mirror bends so much is the tube's where its angle is known that well
#: [rad].
_TURNED_KNOWN_RAD = 1e-3
#: From far away an edge that its neighbours do not confirm may be the rim of the glass, 9 mrad off at an LS-2's rim;
#: what waves make of a slope that is carried on to there is wrong by more than a sigma of a milliradian says [rad].
_EITHER_KNOWN_RAD = 0.5e-3
#: Slopes beyond belong to no mirror; they would only take lines of sight out of the tube's reach [rad].
_STEEPEST_RAD = 0.04
#: Where the slope along the trough is measured better than this, and better than this share of what it usually is, it
#: helps to integrate the surface [rad].
_ALONG_KNOWN_RAD, _ALONG_GAIN = 0.7e-3, 0.5
#: An edge says something of the mirror up to this distance along its row [m].
_REACH_M = 0.12
#: Edges tell the noise where they have less leverage than this. What those with more say of it hangs on their leverage:
#: it came out as a third of what it is, and 24 photos of a shaped mirror were wrong by 3 mrad with a sigma of 0.3.
_MOST_INFORMATIVE_LEVERAGE = 0.5
#: Where the others foretell fewer edges than this share as well as they are measured, how rows are alike matters: what
#: ties cameras to each other is then the smoothness of the mirror. Where more are, edges of many photos overlap and
#: tie them, and a field of all rows is several times the work for the same slopes.
_CHECKED_SHARE = 0.5
#: An edge that others say nothing of has all the leverage; its residual is taken to have this share of its noise.
_MOST_LEVERAGE = 0.98
#: No mirror bends more than this beside its design; what does is noise [1/m].
_MOST_BEND_PER_M = 0.05


@dataclass(frozen=True, eq=False)
class Reflector:
    """The mirror's slope errors.

    grid: Nodes across the trough.
    y_m (r,): Rows [m].
    errors: Slope errors and their covariance at all nodes.
    measured (r, nx): Nodes near enough to an edge.
    fate (m,): `EdgeFate` of each edge.
    residuals_rad (m,): What remains of each edge's angle [rad].
    models: How slopes along the rows may vary, the likeliest first; slopes and sums are means over these.
    apart_rad (k, r, nx): What the slopes across are under each model, less that mean [rad].
    noise_factor: By what the sigmas of the edges had to be multiplied.
    absorber: The tube's axis, to which the width of its reflection has added what it says of it.
    unknowns: What the lines have in common.
    lines: The edges that were used, as observations; what slopes across tell of those along is off their misfits.
    height_m (r, nx): Height of the mirror over its design, mean zero on each panel [m].
    last_change_m: RMS change of the height in the last round [m].
    has_shadows: Whether shadows as dark as the tube are in the reflection, and edges were checked against those of
        the other side: what few edges say is then not believed.
    shape: Whether the mirror deviates as its slopes say, estimated from the reflection.
    """

    grid: RowGrid
    y_m: FloatArray
    errors: SlopeErrors
    measured: BoolArray
    fate: IntArray
    residuals_rad: FloatArray
    models: tuple[PossibleRoughness, ...]
    apart_rad: FloatArray
    noise_factor: float
    absorber: AbsorberPath
    unknowns: CommonUnknowns
    lines: TouchingLines
    height_m: FloatArray
    last_change_m: float
    has_shadows: bool
    shape: ShapeShare

    @property
    def roughness(self) -> Roughness:
        """Of the slopes along the rows, as is most probable."""
        return self.models[0].roughness

    @cached_property
    def sums(self) -> AveragedSums:
        """How well weighted sums of the slopes across are known, the absorber held."""
        held, alike = ~self.unknowns.is_place, self.alike
        each = tuple(
            SlopeSums(
                self.lines,
                self.grid,
                one.roughness,
                self.errors.covariance_common,
                held,
                alike=alike,
                alike_along=likeness_along(self.y_m, one.roughness.along_length_m),
            )
            for one in self.models
        )
        return AveragedSums(each, np.array([one.probability for one in self.models]), self.apart_rad)

    @cached_property
    def gaps(self) -> EdgeGaps:
        """What lies between the edges of one row and panel, and how many edges the others foretell."""
        _, predicted = _residuals(self.lines, self.grid, self.errors)
        return edge_gaps(self.lines, self.grid, _confirmed(predicted, self.lines.sigma_rad))

    @property
    def halves(self) -> Halves | None:
        """What every second photo says beside the others; None where photos are too far apart to check each other."""
        own = np.sqrt(self.errors.random[..., 0, 0][self.measured])
        if self.errors.beside is None or self.gaps.leave_open(float(np.median(own)) if own.size else np.inf):
            return None
        return halves_of(self.errors.beside)

    @property
    def alike(self) -> FloatArray:
        """Correlation of the rows' slope errors, shape (r, r)."""
        return row_likeness(self.errors.slopes[..., 0], self.measured, self.grid, self.y_m)


def row_grid(collector: Collector, n_rows: int, step_m: float) -> RowGrid:
    """Lay nodes across the aperture.

    collector: Its width and panels.
    step_m: Wanted distance of the nodes [m].
    Returns: An even number of nodes in the middles of equal cells.
    """
    width = collector.aperture_width_m
    count = max(4, 2 * round(width / step_m / 2))
    x = np.asarray((np.arange(count) + 0.5) * (width / count) - width / 2, dtype=np.float64)
    inner = collector.panel_edges_x_m[1:-1]
    between = (x[:-1, None] < inner) & (inner <= x[1:, None])
    return RowGrid(x, np.asarray(~between.any(axis=1)), n_rows)


def solve_reflector(
    edges: ReflectionEdges,
    photos: Photos,
    expected: Expectation,
    step_m: float,
    prior: Roughness,
    *,
    shaped: bool | None = False,
    outward_rad: float = 0.0,
) -> Reflector:
    """Estimate the slope errors of the mirror.

    edges: Candidates of all photos.
    photos: Poses with their covariance.
    expected: Collector, absorber and rows.
    step_m: Wanted distance of the nodes across the trough [m].
    prior: What is known of the slope along the trough.
    shaped: Whether the slopes found are integrated to the shape of the mirror and the lines of sight meet that;
        None: estimated from the reflection (`observer.slopes.shape_share`).
    outward_rad: How far all edges may lie outward together beside what blur does, 1 sigma [rad].
    Returns: Slope errors with covariance, and what became of each edge.
    EstimationError: Too few edges.
    """
    grid = row_grid(expected.collector, expected.y_m.size, step_m)
    nominal = _Nominal(edges, photos, expected, outward_rad)
    fate = first_fate(edges, expected.goes_either_way(photos.eyes_m)[edges.photo])
    far = expected.goes_either_way(photos.eyes_m)[edges.photo] & (fate == EdgeFate.USED)
    if far.any():
        agreed_edges = nominal.agreed_by_both(far)
        fate[far & ~agreed_edges] = EdgeFate.EITHER
    else:
        # From far away one row of each panel stands for all others (`most_rows`); nearer they are as alike as they are.
        grid = replace(grid, y_m=expected.y_m)
    fate[is_alone(edges, fate == EdgeFate.USED, expected.y_m)] = EdgeFate.ALONE
    if np.count_nonzero(fate == EdgeFate.USED) < 2 * grid.n_rows:
        raise EstimationError(
            f"reflection: only {np.count_nonzero(fate == EdgeFate.USED)} edges of the absorber's reflection were found "
            f"in {len(photos.poses)} photos; does the camera cross the optical axis above the mirror, and are the "
            "collector's dimensions and the targets right?"
        )
    is_bold, wrong = fate == EdgeFate.USED, fate == EdgeFate.WRONG_STEP
    by_brightness, either = fate.copy(), fate == EdgeFate.EITHER
    none = np.zeros((grid.n_rows, grid.x_m.size, 2))
    present = whole = _Surface(none, none[..., 0])
    scatter = scatter_along(edges, is_bold, expected.y_m)
    noise, roughness = max(1.0, scatter), prior
    for allowance in _ALLOWANCES_RAD:
        if allowance == 0.0:
            # With the bends as found: where a panel bends by 0.02 / m beside the design, a camera that is 3 mm beside
            # its place moves an edge by 0.1 mrad more.
            nominal = nominal.bent(_bends(edges, present, grid))
        lines, covariance = _in_round(_lines(nominal, expected, present, grid), nominal, noise, allowance)
        keep = (fate == EdgeFate.USED) & np.isfinite(lines.misfit_rad)
        used = lines.chosen(keep)
        evidence = RoughnessEvidence(used, grid, covariance)
        roughness = find_roughness(evidence, roughness, any_order=allowance == 0.0)
        errors = solve_jointly(used, grid, roughness, covariance, with_shares=None)
        residuals, predicted = _residuals(lines, grid, errors)
        if allowance == 0.0 and _confirmed(predicted[keep], used.sigma_rad).mean() < _CHECKED_SHARE:
            roughness = find_roughness(evidence, roughness, any_order=True, maybe_alike=True)
            errors = solve_jointly(used, grid, roughness, covariance, with_shares=None)
            residuals, predicted = _residuals(lines, grid, errors)
        factor = 1.0
        if allowance == 0.0:
            factor = _noise_factor(residuals[keep] / used.sigma_rad, predicted[keep] / used.sigma_rad**2)
            # Edges scatter at least as much as beside their neighbours.
            factor = max(factor, scatter / noise)
            noise *= factor
        limit = _REJECT_TIMES * np.sqrt((factor * lines.sigma_rad) ** 2 + predicted)
        fits = np.abs(residuals) < limit
        fate[is_bold] = np.where(fits, int(EdgeFate.USED), int(EdgeFate.BESIDE))[is_bold]
        turned = wrong & nominal.turned & (predicted < _TURNED_KNOWN_RAD**2)
        fate[turned] = np.where(fits, int(EdgeFate.USED), int(EdgeFate.WRONG_STEP))[turned]
        told = either & (predicted < _EITHER_KNOWN_RAD**2)
        fate[either] = np.where(fits & told, int(EdgeFate.USED), int(EdgeFate.EITHER))[either]
        if allowance == 0.0:
            own = replace(_apart(lines, errors.common), sigma_rad=factor * lines.sigma_rad)
            fate = _refuse_contradicted(own, fate, by_brightness, grid, replace(roughness, alike=None))
        whole, change = _next_surface(present, errors, _near_edges(used, grid), roughness, expected, grid)
        present = replace(whole, height_m=none[..., 0]) if shaped is False else whole
    usable, unknowns = fate == EdgeFate.USED, nominal.unknowns
    flat = replace(whole, height_m=none[..., 0])
    both = tuple(_lines(nominal, expected, surface, grid) for surface in (whole, flat))
    share = _estimate_shape(nominal, both, usable, noise, grid, roughness)
    is_flat = shaped is False or (shaped is None and not share.has_shape)
    present, lines = (flat, both[1]) if is_flat else (whole, both[0])
    lines = _joint(replace(lines, sigma_rad=noise * lines.sigma_rad), nominal)
    keep = (fate == EdgeFate.USED) & np.isfinite(lines.misfit_rad)
    agreed = np.ones((grid.n_rows, grid.x_m.size), dtype=bool)
    # Where brightness does not say which edge of the tube one is, the rim of the glass looks like it, too.
    shadows = has_shadows(edges, fate, expected.y_m) or bool(expected.goes_either_way(photos.eyes_m).any())
    if shadows:
        fate, errors, roughness, agreed = _refuse_shadows(
            lines, edges, fate, errors, roughness, unknowns.covariance, grid
        )
        keep &= fate == EdgeFate.USED
    if not keep.any():
        raise EstimationError(
            f"reflection: none of {keep.size} edges in {len(photos.poses)} photos agrees with the others: photos at "
            "most 0.2 m apart across the trough confirm each other; are camera, targets and dimensions right?"
        )
    used = lines.chosen(keep)
    likeness = _likeness(used, edges.chosen(keep), errors, grid, expected.y_m)

    def enlarged(rows: IntArray) -> float:
        return likeness.counted(expected.y_m[rows])

    def halves(lines: TouchingLines, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        found = halves_patterns(lines, expected.y_m[rows][lines.row], expected.collector)
        return found, np.full(found.shape[1], PRIOR_RAD)

    # As far as slopes across tell them, slopes along are known; what is left of these has the prior.
    along = np.zeros(errors.slopes.shape[:2])
    if not is_flat:
        sigma, edges_y = np.sqrt(errors.random[..., 0, 0]), expected.collector.panel_edges_y_m
        near = _near_edges(used, grid) & agreed
        along = slopes_by_twist(errors.slopes[..., 0], sigma, near, grid, expected.y_m, edges_y)
        lines = replace(
            lines, misfit_rad=lines.misfit_rad + lines.d_slope_y * at_points(along, lines.row, lines.x_m, grid)
        )
        used = lines.chosen(keep)
    alone, common = replace(roughness, alike=None), errors.common
    if roughness.alike is not None:
        # Row by row, as they are looked at there: what cameras from all rows leave of each row looks like such slopes.
        common = solve_common(used, grid, alone, unknowns.covariance)
    models = tuple(
        one._replace(roughness=replace(one.roughness, alike=roughness.alike))
        for one in find_along(_apart(used, common), grid, alone)
    )
    # From far away nothing but the mirror's own shape says where the tube is, and that is one for a panel's rows.
    most_rows = len(expected.collector.panel_edges_y_m) - 1 if far.any() else None
    first = solve_jointly(
        used,
        grid,
        models[0].roughness,
        unknowns.covariance,
        with_shares=~unknowns.is_place,
        looks_like=lambda rows, columns: unknowns.place_as_slope(expected, expected.y_m[rows], grid.x_m[columns]),
        most_rows=most_rows,
        enlarged=enlarged,
        patterns=halves,
    )
    others = [
        solve_jointly(
            used, grid, one.roughness, unknowns.covariance, with_shares=None, most_rows=most_rows, enlarged=enlarged
        )
        for one in models[1:]
    ]
    errors = averaged(models, [first, *others])
    apart = np.stack([one.slopes[..., 0] - errors.slopes[..., 0] for one in (first, *others)])
    if unknowns.mean is not None:
        # From here on the unknowns count from zero.
        errors = replace(errors, common=errors.common + unknowns.mean)
        lines = replace(lines, misfit_rad=lines.misfit_rad - unknowns.expected_rad)
        used = lines.chosen(keep)
    residuals = _residuals(lines, grid, errors)[0]
    errors = replace(errors, slopes=errors.slopes + np.stack([np.zeros_like(along), along], axis=-1))
    absorber = unknowns.moved(expected.absorber, errors.common, errors.covariance_common)
    return Reflector(
        grid,
        expected.y_m,
        errors,
        _near_edges(used, grid) & agreed,
        fate,
        residuals,
        models,
        apart,
        noise,
        absorber,
        unknowns,
        used,
        present.height_m,
        change,
        shadows,
        share,
    )


def _refuse_contradicted(
    lines: TouchingLines, fate: IntArray, by_brightness: IntArray, grid: RowGrid, roughness: Roughness
) -> IntArray:
    """Return fates after edges were refused that the others of their row contradict, where the solution follows them.

    lines: Edges with their noise, what rows have in common taken off their misfits.
    by_brightness (m,): Fates before edges were compared; what was refused then is so for the same reason.
    """
    fate = fate.copy()
    some = np.flatnonzero((fate == EdgeFate.USED) & np.isfinite(lines.misfit_rad))
    found = contradicted_edges(lines.chosen(some), grid, roughness, _REJECT_TIMES)
    refused = some[found.refused]
    first = by_brightness[refused]
    fate[refused] = np.where(first == EdgeFate.USED, int(EdgeFate.BESIDE), first)
    fate[some[found.undecided]] = EdgeFate.UNDECIDED
    return fate


def _estimate_shape(
    nominal: "_Nominal",
    both: tuple[TouchingLines, ...],
    usable: BoolArray,
    noise: float,
    grid: RowGrid,
    roughness: Roughness,
) -> ShapeShare:
    """Compare the edges on the mirror with the heights of its slopes and without."""
    # Where all edges are a little too far to one side, the mirror point moves across.
    by_edge = nominal.edges.side * nominal.across_rad_per_m
    keep = usable & np.isfinite(by_edge) & np.isfinite(both[0].misfit_rad) & np.isfinite(both[1].misfit_rad)
    shaped, plain = (
        replace(one, sigma_rad=noise * one.sigma_rad).chosen(keep) for one in (_joint(both[0], nominal), both[1])
    )
    return find_shape_share((shaped, plain), by_edge[keep], grid, roughness, nominal.unknowns.covariance)


def _likeness(
    used: TouchingLines, edges: ReflectionEdges, errors: SlopeErrors, grid: RowGrid, y_m: FloatArray
) -> EdgeLikeness:
    """Estimate how far along the trough errors of edges are alike.

    edges: The same as the lines.
    """
    residuals, predicted = _residuals(used, grid, errors)
    # What is left of an edge that the others do not foretell is what the mirror does there, alike in the next rows.
    told = _confirmed(predicted, used.sigma_rad)
    curve, row = curves_of(edges, y_m), edges.row
    return edge_likeness((residuals / used.sigma_rad)[told], curve[told], row[told], y_m)


class _WithoutShadows(NamedTuple):
    """Fates, solution and roughness after edges of shadows were refused, and the nodes that both sides confirm."""

    fate: IntArray
    errors: SlopeErrors
    roughness: Roughness
    agreed: BoolArray


def _refuse_shadows(
    lines: TouchingLines,
    edges: ReflectionEdges,
    fate: IntArray,
    errors: SlopeErrors,
    roughness: Roughness,
    covariance: FloatArray,
    grid: RowGrid,
) -> _WithoutShadows:
    """Refuse edges that shadows may have made."""
    fate = fate.copy()
    some = (fate == EdgeFate.USED) & np.isfinite(lines.misfit_rad)
    borne, _ = confirmed_edges(_apart(lines.chosen(some), errors.common), edges.side[some], grid, roughness)
    keep = some.copy()
    keep[some] = borne
    if not borne.any():
        fate[some] = EdgeFate.ONE_SIDED
        return _WithoutShadows(fate, errors, roughness, np.zeros((grid.n_rows, grid.x_m.size), dtype=bool))
    # Edges of shadows made the mirror look rough; with its own roughness more of its edges confirm each other.
    roughness = find_roughness(RoughnessEvidence(lines.chosen(keep), grid, covariance), roughness)
    errors = solve_jointly(lines.chosen(keep), grid, roughness, covariance, with_shares=None)
    pulled = _is_pulled(lines, keep, edges, errors, grid)
    fate[pulled] = EdgeFate.BESIDE
    some &= ~pulled
    errors = solve_jointly(lines.chosen(keep & some), grid, roughness, covariance, with_shares=None)
    borne, agreed = confirmed_edges(_apart(lines.chosen(some), errors.common), edges.side[some], grid, roughness)
    fate[np.nonzero(some)[0][~borne]] = EdgeFate.ONE_SIDED
    return _WithoutShadows(fate, errors, roughness, agreed)


def _is_pulled(
    lines: TouchingLines, keep: BoolArray, edges: ReflectionEdges, errors: SlopeErrors, grid: RowGrid
) -> BoolArray:
    """Return which edges are off together with their curve, where the others alone would predict them."""
    residuals, predicted = _residuals(lines, grid, errors)
    leverage = np.clip(predicted / lines.sigma_rad**2, 0.0, _MOST_LEVERAGE)
    normalised = residuals / (lines.sigma_rad * np.sqrt(1 - leverage))
    curve = 2 * edges.photo + (edges.side > 0)
    pulled = np.zeros(keep.size, dtype=bool)
    pulled[keep] = pulled_curves(curve[keep], edges.row[keep], normalised[keep], grid.n_rows)
    return pulled


def _apart(lines: TouchingLines, common: FloatArray) -> TouchingLines:
    """Return lines from whose misfits the common unknowns, as found, are taken off."""
    return lines.alone(lines.misfit_rad + _moved(lines, common), lines.sigma_rad)


def _moved(lines: TouchingLines, common: FloatArray) -> FloatArray:
    """Return by how much the common unknowns, as found, move the lines."""
    return np.asarray(np.einsum("mc,mc->m", lines.d_common, common[lines.common_index]))


def _in_round(
    lines: TouchingLines, nominal: "_Nominal", noise: float, allowance_rad: float
) -> tuple[TouchingLines, FloatArray]:
    """Return lines with the sigma of a round, and the covariance of the common unknowns that it solves for.

    As long as more scatter is allowed than the common unknowns make, they are part of it.
    """
    square = (noise * lines.sigma_rad) ** 2 + allowance_rad**2
    if float(np.mean(nominal.scatter_square)) < allowance_rad**2:
        return replace(lines, sigma_rad=np.sqrt(square + nominal.scatter_square)), np.zeros((0, 0))
    return _joint(replace(lines, sigma_rad=np.sqrt(square)), nominal), nominal.unknowns.covariance


def _joint(lines: TouchingLines, nominal: "_Nominal") -> TouchingLines:
    """Return lines with what they have in common."""
    return replace(lines, common_index=nominal.unknowns.index, d_common=nominal.unknowns.derivative)


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """The mirror that observations are linearised at: slope errors, shape (r, nx, 2), and height over the design."""

    slopes: FloatArray
    height_m: FloatArray


class _Nominal:
    """Edges with what the design's surface suffices for: the noise of their angle and what they have in common."""

    def __init__(self, edges: ReflectionEdges, photos: Photos, expected: Expectation, outward_rad: float) -> None:
        self.edges, self._photos, self._expected, self._outward_rad = edges, photos, expected, outward_rad
        self.sights = Sights(edges.points_m, photos.eyes_of(edges.points_m, edges.photo), edges.side)
        self._found = design_misfit(
            edges.points_m, self.sights.eyes_m, edges.side, expected.collector, expected.absorber
        )
        self.glass_rad = glass_widening_rad(self._found, self.sights, expected)
        self._bend(0.0)

    def bent(self, bend_per_m: FloatArray) -> "_Nominal":
        """Return the same edges on a mirror that bends beside the design, by so much at each edge (m,) [1/m].

        Only what poses and places of edges do to angles hangs on that.
        """
        other = copy(self)
        # What was found without the bend.
        for name in ("known_rad", "unknowns", "scatter_square", "_beside_poses"):
            other.__dict__.pop(name, None)
        other._bend(bend_per_m)
        return other

    def _bend(self, bend_per_m: FloatArray | float) -> None:
        focal = self._expected.collector.focal_length_m
        self._bend_per_m = bend_per_m
        self.across_rad_per_m = change_across(self.sights, self._found, focal, bend_per_m)
        self.sigma_rad = np.hypot(self.across_rad_per_m * self.edges.sigma_x_m, _MODEL_RAD)
        self._by_pose = pose_derivatives(
            self.sights, self._found, self._photos.poses, self.edges.photo, focal, bend_per_m
        )

    @cached_property
    def known_rad(self) -> FloatArray:
        """By how much each edge is moved by what is known of glass and panels beside the design, shape (m,) [rad]."""
        return self.glass_rad + self.unknowns.expected_rad

    @property
    def turned(self) -> BoolArray:
        """Which edges lie where the mirror bends so much that the reflection moves the other way on it, shape (m,)."""
        return np.asarray(self.across_rad_per_m * np.median(self.across_rad_per_m) < 0)

    def agreed_by_both(self, which: BoolArray) -> BoolArray:
        """Return which edges both sides of the tube agree on, among those that are looked at.

        Shapes: which (m,), result (m,).
        """
        found, edges = self._found, self.edges
        which = which & np.isfinite(found.angle_rad)
        axis = np.stack(self._expected.absorber.at(np.nan_to_num(found.passing_y_m)), axis=1)
        away = np.linalg.norm(axis - edges.points_m[:, [0, 2]], axis=1)
        half = np.arcsin(np.clip(self._expected.collector.absorber_diameter_m / 2 / away, 0, 1))
        agreed = np.zeros(which.shape, dtype=bool)
        agreed[which] = agreed_by_both(
            cells_of(edges.points_m[which]), edges.side[which], found.angle_rad[which], half[which]
        )
        return agreed

    @cached_property
    def unknowns(self) -> CommonUnknowns:
        """What the edges have in common.

        Where the mirror bends beside the design other movements of a camera matter: its modes are those of the bends.
        """
        modes = reduce_to_modes(self._by_pose, self.edges.photo, self._photos.covariance)
        return common_unknowns(self._beside_poses, self.edges.photo, modes, self._photos.with_tube)

    @cached_property
    def _beside_poses(self) -> BesidePoses:
        return beside_poses(
            self.edges,
            self.sights,
            self._found,
            self._expected,
            bend_per_m=self._bend_per_m,
            outward_rad=self._outward_rad,
            panels=self._photos.panels,
        )

    @cached_property
    def scatter_square(self) -> FloatArray:
        """Variance that uncertain poses and the tube's place make in each edge's angle, shape (m,) [rad^2].

        The tube's other unknowns make as little as the noise of an edge.
        """
        poses = pose_scatter(self._by_pose, self.edges.photo, self._photos.covariance)
        sigmas = self._expected.absorber.sigma_at(np.nan_to_num(self._found.passing_y_m))
        place = np.square(self._found.d_angle_d_absorber * np.stack(sigmas, axis=1)).sum(axis=1)
        return np.asarray(np.nan_to_num(poses + place))


def _bends(edges: ReflectionEdges, present: _Surface, grid: RowGrid) -> FloatArray:
    """Return by how much the slope error across changes at each edge, within its panel [1/m]."""
    across = present.slopes[..., 0]
    change = np.where(grid.joined, np.diff(across, axis=1), 0.0) / grid.step_m
    sides = np.zeros(across.shape)
    count = np.zeros(grid.x_m.size)
    for part in (slice(None, -1), slice(1, None)):
        sides[:, part] += change
        count[part] += grid.joined
    bend = at_points(sides / np.maximum(count, 1.0), edges.row, edges.points_m[:, 0], grid)
    return np.asarray(np.clip(bend, -_MOST_BEND_PER_M, _MOST_BEND_PER_M))


def _lines(nominal: _Nominal, expected: Expectation, present: _Surface, grid: RowGrid) -> TouchingLines:
    """Turn edges into observations of the slopes, linearised at the present surface but counted from the design."""
    edges, collector = nominal.edges, expected.collector
    focal = collector.focal_length_m
    points, eyes = edges.points_m, nominal.sights.eyes_m
    if present.height_m.any():
        points = on_surface(points, eyes, edges.row, present.height_m, grid, focal)
    slopes = at_points(present.slopes, edges.row, points[:, 0], grid)
    sights = Sights(points, eyes, edges.side)
    # Observations are those of the nodes beside them; what the mirror departs from the chord is known by now.
    curved = slopes[:, 0] + beside_chord(present.slopes[..., 0], edges.row, points[:, 0], grid)
    found = misfit_with_slopes(
        sights,
        (points[:, 0] / (2 * focal) + curved, slopes[:, 1]),
        expected.absorber,
        collector.absorber_diameter_m / 2,
    )
    return TouchingLines(
        edges.row,
        points[:, 0],
        found.angle_rad + nominal.known_rad - found.d_slope_x * slopes[:, 0] - found.d_slope_y * slopes[:, 1],
        found.d_slope_x,
        found.d_slope_y,
        nominal.sigma_rad,
        np.zeros((edges.row.size, 0), dtype=np.intp),
        np.zeros((edges.row.size, 0)),
    )


def _next_surface(
    present: _Surface,
    errors: SlopeErrors,
    measured: BoolArray,
    roughness: Roughness,
    expected: Expectation,
    grid: RowGrid,
) -> tuple[_Surface, float]:
    """Return the surface found, and the RMS change of its height [m]."""
    slopes = np.where(measured[..., None], np.clip(errors.slopes, -_STEEPEST_RAD, _STEEPEST_RAD), 0.0)
    along = errors.random[..., 1, 1] < min(_ALONG_KNOWN_RAD, _ALONG_GAIN * roughness.along_rad) ** 2
    height = heights(slopes, measured, along & measured, expected.collector, grid, expected.y_m)
    return _Surface(slopes, height), float(np.sqrt(np.mean(np.square(height - present.height_m)[measured])))


def _residuals(lines: TouchingLines, grid: RowGrid, errors: SlopeErrors) -> tuple[FloatArray, FloatArray]:
    """Return what remains of all lines' misfits, and the variance that the solution itself has there."""
    before, share = nodes_of(grid, lines.x_m)
    nearest = before + (share > 0.5)
    slopes = at_points(errors.slopes, lines.row, lines.x_m, grid)
    residuals = lines.misfit_rad + lines.d_slope_x * slopes[:, 0] + lines.d_slope_y * slopes[:, 1]
    residuals += _moved(lines, errors.common)
    x_x, x_y, y_y = (errors.random[..., i, j][lines.row, nearest] for i, j in ((0, 0), (0, 1), (1, 1)))
    by_x, by_y = lines.d_slope_x, lines.d_slope_y
    return residuals, by_x * (by_x * x_x + 2 * by_y * x_y) + by_y**2 * y_y


def _confirmed(predicted: FloatArray, sigma_rad: FloatArray) -> BoolArray:
    """Return which edges the others foretell about as well as they are measured."""
    return np.asarray(predicted < _MOST_INFORMATIVE_LEVERAGE * sigma_rad**2)


def _noise_factor(normalised: FloatArray, leverage: FloatArray) -> float:
    """Return the robust scatter of residuals over what their sigmas and the fit's freedom let expect."""
    freedom = np.sqrt(np.clip(1 - leverage, 0.02, 1.0))
    informative = leverage < _MOST_INFORMATIVE_LEVERAGE
    if np.count_nonzero(informative) < 100:
        return 1.0
    return robust_scale(normalised[informative] / freedom[informative])


def _near_edges(used: TouchingLines, grid: RowGrid) -> BoolArray:
    """Return the nodes that have an edge of their own row and panel within reach."""
    hit = np.zeros((grid.n_rows, grid.x_m.size), dtype=bool)
    before, share = nodes_of(grid, used.x_m)
    hit[used.row, before + (share > 0.5)] = True
    reach = max(1, round(_REACH_M / grid.step_m))
    near = hit.copy()
    towards_right, towards_left = hit.copy(), hit.copy()
    for _ in range(reach):
        towards_right[:, 1:] |= towards_right[:, :-1] & grid.joined
        towards_left[:, :-1] |= towards_left[:, 1:] & grid.joined
    near |= towards_right | towards_left
    return near
