"""One map of a whole ensemble from the maps of its facets."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deflectometry.shape.facet_pixels import spread_indices
from deflectometry.shape.gridding import default_step_m, grid_axis
from deflectometry.shape.smooth_shape import Align, alignment_words
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.slopes.interpolation import read_map
from heliogauge.slopes.map import VALUE_FIELDS, CommonModes, SlopeMap, monomials
from heliogauge.slopes.removal import Removal
from heliogauge.validate import BoolArray, FlagArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The common modes of one facet, its place, and the nodes (2, n) that it covers, in its own frame."""

    common: CommonModes
    ensemble_from_facet: RigidTransform
    nodes: FloatArray


def assemble_maps(mirror: Sequence[Facet], maps: Mapping[str, SlopeMap], align: Align, removal: Removal) -> SlopeMap:
    """Put the maps of all facets into one map in the frame of the ensemble.

    mirror: All facets, measured or not.
    maps: The map of each measured facet by its name.
    align, removal: Orientation of these maps, and what was taken out of each.
    Returns: The map of the only facet, or the map of the ensemble: slopes, design slopes and heights in its frame,
        nodes between facets and facets that were not measured flagged.

    Each node is taken into the facet that covers it, the facet's map is interpolated there, and measured and design
    normal are turned into the ensemble's frame: canting shows as a step between facets.
    """
    facets = {facet.name: facet for facet in mirror}
    if len(facets) == 1:
        return next(iter(maps.values()))
    first = next(iter(maps.values()))
    corners = np.concatenate([facet.ensemble_from_facet.apply(facet.corners_m) for facet in facets.values()])
    low, high = corners.min(axis=0), corners.max(axis=0)
    step = max(float(first.x_m[1] - first.x_m[0]), default_step_m(0.0, float(np.prod((high - low)[:2]))))
    x_m, y_m = grid_axis(low[0], high[0], step), grid_axis(low[1], high[1], step)
    grid = np.meshgrid(x_m, y_m)
    fields = np.full((len(VALUE_FIELDS), *grid[0].shape), np.nan)
    flags = np.full(grid[0].shape, np.uint32(SampleFlag.OUTSIDE_MIRROR))
    aperture = np.zeros(grid[0].shape, dtype=bool)
    parts, variance_of_means, variance_of_nodes = [], 0.0, 0.0
    for name, facet in facets.items():
        own, nodes = _nodes_of(facet, grid)
        aperture |= own
        flags[own] = np.uint32(SampleFlag.NOT_SEEN)
        if name in maps:
            fields[:, own], flags[own] = _read_facet(maps[name], nodes, facet.ensemble_from_facet)
            parts.append(_Part(maps[name].common, facet.ensemble_from_facet, nodes))
            variance_of_means += maps[name].noise_correlation * _mean_variance(maps[name].sigma_random_x)
            variance_of_nodes += _mean_variance(fields[VALUE_FIELDS.index("sigma_random_x"), own])
    return SlopeMap(
        x_m=x_m,
        y_m=y_m,
        **dict(zip(VALUE_FIELDS, fields, strict=True)),
        # Set-up and blur are those of all facets.
        fine_share=np.max([one.fine_share for one in maps.values()], axis=0),
        noise_correlation=max(1.0, variance_of_means / variance_of_nodes) if variance_of_nodes > 0 else 1.0,
        common=_joint_modes(parts, 0.5 * (low + high)[:2], 0.5 * float((high - low)[:2].max())),
        flags=flags,
        aperture=aperture,
        design=f"ensemble of {len(facets)} facets: {first.design}",
        frame="ensemble frame: x across, y up, seen from the front, z out of the mirror [m]",
        removed=_removed_words(align, removal, len(facets)),
    )


def _removed_words(align: Align, removal: Removal, n_facets: int) -> str:
    """Say what was taken out; the numbers differ from facet to facet and stand in the facets' own maps."""
    aligned = alignment_words(align, n_facets)
    if removal is Removal.NOTHING:
        return aligned
    return f"{aligned}; then {removal} of each facet on its own, so that its canting is no longer in the map"


def _nodes_of(facet: Facet, grid: tuple[FloatArray, FloatArray]) -> tuple[BoolArray, FloatArray]:
    """Return which nodes of the ensemble's grid a facet covers, and where these are in its own frame, shape (2, n)."""
    facet_from_ensemble = facet.ensemble_from_facet.inverse()
    points = np.stack([grid[0], grid[1], np.full(grid[0].shape, facet.ensemble_from_facet.translation_m[2])], axis=-1)
    for _ in range(3):
        # The node is given in x and y of the ensemble; its height there is that of the facet.
        local = facet_from_ensemble.apply(points)
        local[..., 2] = facet.design.height(local[..., 0], local[..., 1])
        points[..., 2] = facet.ensemble_from_facet.apply(local)[..., 2]
    local = facet_from_ensemble.apply(points)
    own = facet.contains(local[..., 0], local[..., 1])
    return own, np.stack([local[own][:, 0], local[own][:, 1]])


def _read_facet(
    slope_map: SlopeMap, nodes: FloatArray, ensemble_from_facet: RigidTransform
) -> tuple[FloatArray, FlagArray]:
    """Interpolate a facet's map at points of its frame; the fields of `VALUE_FIELDS` in the ensemble's frame, flags."""
    read = read_map(slope_map, *nodes)
    rotation = ensemble_from_facet.rotation
    slopes = _turned(read.slope_x, read.slope_y, rotation)
    design = _turned(read.design_slope_x, read.design_slope_y, rotation)
    # Facets are turned against the ensemble by little but for a turn about z: the sigmas turn as vectors.
    sigma = np.sqrt(rotation[:2, :2] ** 2 @ np.stack([read.sigma_random_x, read.sigma_random_y]) ** 2)
    height = ensemble_from_facet.apply(np.stack([*nodes, read.height_m], axis=-1))[:, 2]
    return np.stack([*slopes, *design, *sigma, height]), read.flags


def _mean_variance(sigma: FloatArray) -> float:
    """Return the variance of the mean over nodes, were they independent."""
    finite = sigma[np.isfinite(sigma)]
    return float(np.mean(finite**2)) / finite.size if finite.size else 0.0


def _turned(slope_x: FloatArray, slope_y: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn slopes into another frame by way of the normal."""
    normal = rotation @ np.stack([-slope_x, -slope_y, np.ones_like(slope_x)])
    return -normal[0] / normal[2], -normal[1] / normal[2]


def _joint_modes(parts: Sequence[_Part], center_m: FloatArray, scale_m: float) -> CommonModes:
    """Fit one set of polynomials to the modes of all facets; a source moves them together."""
    sources = parts[0].common.sources
    values, positions = [], []
    for part in parts:
        if part.common.sources != sources:
            continue
        thinned = part.nodes[:, spread_indices(part.nodes.shape[1], 200)]
        modes = part.common.evaluate(thinned[0], thinned[1])
        values.append(np.einsum("ab,kbn->kan", part.ensemble_from_facet.rotation[:2, :2], modes))
        ensemble = part.ensemble_from_facet.apply(
            np.stack([thinned[0], thinned[1], np.zeros(thinned.shape[1])], axis=-1)
        )
        positions.append(ensemble[:, :2].T)
    at = (np.concatenate(positions, axis=1) - center_m[:, None]) / scale_m
    terms = monomials(at[0], at[1], 3)
    stacked = np.concatenate(values, axis=2).reshape(-1, at.shape[1])
    coefficients = np.linalg.lstsq(terms.T, stacked.T, rcond=None)[0].T
    return CommonModes(sources, coefficients.reshape(len(sources), 2, terms.shape[0]), center_m, scale_m)
