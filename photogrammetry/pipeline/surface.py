"""From adjusted points to what ``[surface]`` asks for: fit, slope map, canting, comparison with another date."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path
from re import fullmatch
from typing import NamedTuple

import numpy as np

from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.measurement.designs import build_design_family
from heliogauge.measurement.models import DesignKeys
from heliogauge.results.folder import read_points_csv, read_table_csv
from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.bundle.adjustment import BundleResult
from photogrammetry.keys.surface import SurfaceFacetSection, SurfaceSection
from photogrammetry.surface.canting import FacetCanting, FacetPoints, facet_canting
from photogrammetry.surface.design import CompositeDesign, DesignSurface, Reference
from photogrammetry.surface.displacement import Displacements, displacements, rigid_fit
from photogrammetry.surface.fit import fit_surface, quick_fit
from photogrammetry.surface.fitted import FitChoices, SurfaceFit, SurfacePoints
from photogrammetry.surface.mesh import MeshSurface, mesh_start
from photogrammetry.surface.slopes import Patch, SurfaceSlopes, hull_outline, surface_slopes
from photogrammetry.surface.start import find_start
from photogrammetry.surface.store_mesh import read_mesh

#: The joint covariance of so many points takes 0.4 GB; beyond, points count as independent of each other.
_JOINT = 2400
#: Points further from several facets than this share of their extent are in another frame: no panel is bent by 2 %.
_NEAR = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceResult:
    """What was found of a surface; parts that were not asked for, or not possible, are None.

    fit: Points against the design or the mesh.
    how: Where the fit started, for the summary.
    facet_of: The facet of each point of the fit; empty for none.
    slopes: Slope maps.
    cantings: Each facet against its design.
    moved: Against the other date.
    compared_with: The other date's folder.
    mesh: The mesh that the points were compared with.
    ply: Whether PLY files are wanted.
    doubts: What makes the result doubtful.
    """

    fit: SurfaceFit | None
    how: str
    facet_of: tuple[str, ...]
    slopes: SurfaceSlopes | None
    cantings: tuple[FacetCanting, ...]
    moved: Displacements | None
    compared_with: str
    mesh: MeshSurface | None
    ply: bool
    doubts: tuple[Doubt, ...]


def measure_surface(section: SurfaceSection, folder: Path, bundle: BundleResult) -> SurfaceResult:
    """Do what ``[surface]`` asks for.

    folder: The measurement's folder, to which files are relative.
    bundle: The adjusted network.
    Returns: Fit, maps, canting, comparison.
    InputError: Targets that are not in the network, files that cannot be read, open3d missing for a mesh.
    EstimationError: Points that do not determine what is asked for.
    """
    points, doubts = surface_points(bundle)
    moved = None
    if section.compare_with is not None:
        stable = tuple(_expand_names(section.stable_targets or (), points.ids, "stable_targets"))
        moved = displacements(_other_date(folder / section.compare_with), points, stable=stable)
        doubts = gather_doubts(doubts, _comparison_doubts(moved))
    result = SurfaceResult(None, "", (), None, (), moved, section.compare_with or "", None, section.ply, ())
    if section.has_design or section.mesh is not None:
        cameras = np.mean([one.inverse().translation_m for one in bundle.cam_from_world], axis=0)
        result = _against_surface(section, folder, points, cameras, result)
    return replace(result, doubts=gather_doubts(doubts, result.doubts))


def _against_surface(
    section: SurfaceSection, folder: Path, points: SurfacePoints, viewer_m: FloatArray, so_far: SurfaceResult
) -> SurfaceResult:
    """Compare points with the design or the mesh."""
    own, mesh, parts = _choose_points(section, points), None, list[_Part]()
    reference: Reference
    if section.mesh is not None:
        mesh = reference = read_mesh(folder / section.mesh, 1e-3 if section.mesh_unit == "mm" else 1.0)
    else:
        own, parts, reference = _build_surface(section, own)
    fit, how, still_open = _fit(section, own, reference, viewer_m)
    facets = [_facet_points(part, fit, section) for part in parts]
    slopes, no_map = _slopes(section, fit, facets)
    return replace(
        so_far,
        fit=fit,
        how=how,
        facet_of=_facet_names(own.ids, parts),
        slopes=slopes,
        cantings=tuple(facet_canting(fit, one) for one in facets) if section.facet else (),
        mesh=mesh,
        doubts=gather_doubts(still_open, no_map, _fit_doubts(fit, placed=bool(section.reference))),
    )


def surface_points(bundle: BundleResult) -> tuple[SurfacePoints, tuple[Doubt, ...]]:
    """Return the determined points of a network with their joint covariance, and what is doubtful about it.

    points: Points that are seen and determined; targets held at given coordinates have no variance.
    """
    table = bundle.problem.observations
    points = bundle.points_m
    kept = np.nonzero((table.n_rays > 0) & np.isfinite(points).all(axis=1))[0]
    held = np.isin(kept, bundle.problem.target_indices(bundle.problem.fixed))
    covariance = np.zeros((3 * kept.size, 3 * kept.size))
    doubts: tuple[Doubt, ...] = ()
    free = np.nonzero(np.repeat(~held, 3))[0]
    if kept.size <= _JOINT:
        covariance[np.ix_(free, free)] = bundle.covariance.joint(targets=kept[~held])
    else:
        text = f"{kept.size} points: their covariances with each other are left out of the surface's sigmas"
        doubts = (Doubt("surface_covariances_left_out", text, {"points_count": kept.size}),)
        for place, target in enumerate(kept):
            covariance[3 * place : 3 * place + 3, 3 * place : 3 * place + 3] = bundle.covariance.points[target]
    names = tuple(table.targets[i] for i in kept)
    return SurfacePoints(names, points[kept], 0.5 * (covariance + covariance.T)), doubts


def _other_date(folder: Path) -> SurfacePoints:
    """Read points and their covariances from another folder of results."""
    if not (folder / "points.csv").is_file():
        raise InputError(f"{folder}: compare_with must be a folder of results with points.csv in it")
    table = read_points_csv(folder / "points.csv")
    known = np.isfinite(table.xyz_m + table.sigma_m).sum(axis=1) == 3
    names = [name for name, one in zip(table.ids, known.tolist(), strict=True) if one]
    blocks = {name: np.diag(sigma**2) for name, sigma in zip(table.ids, table.sigma_m, strict=True)}
    if (folder / "points_covariance.csv").is_file():
        keys = ("xx_m2", "xy_m2", "xz_m2", "xy_m2", "yy_m2", "yz_m2", "xz_m2", "yz_m2", "zz_m2")
        columns = read_table_csv(folder / "points_covariance.csv", ("id", *keys))
        for row, name in enumerate(columns["id"]):
            values = [columns[key][row] for key in keys]
            if all(values):
                blocks[name] = np.array(values, dtype=np.float64).reshape(3, 3)
    covariance = np.zeros((3 * len(names), 3 * len(names)))
    for place, name in enumerate(names):
        covariance[3 * place : 3 * place + 3, 3 * place : 3 * place + 3] = blocks[name]
    return SurfacePoints(tuple(names), table.xyz_m[known], covariance)


def _expand_names(patterns: Sequence[str], ids: Sequence[str], where: str) -> list[str]:
    """Return the names that patterns and ranges mean, each of which must mean one at least."""
    found: dict[str, None] = {}
    for pattern in patterns:
        span = fullmatch(r"(.*?)(\d+)\.\.(.*?)(\d+)", pattern)
        if span and span[1] == span[3]:
            inside = range(int(span[2]), int(span[4]) + 1)
            own = [
                name
                for name in ids
                if (one := fullmatch(r"(.*?)(\d+)", name)) and one[1] == span[1] and int(one[2]) in inside
            ]
        else:
            own = [name for name in ids if fnmatchcase(name, pattern)]
        if not own:
            near = ", ".join(get_close_matches(pattern, ids, 3)) or ", ".join(ids[:5])
            raise InputError(f"surface.{where}: {pattern!r} is no measured target (near: {near})")
        found |= dict.fromkeys(own)
    return list(found)


def _choose_points(section: SurfaceSection, points: SurfacePoints) -> SurfacePoints:
    if section.targets is None:
        return points
    names = set(_expand_names(section.targets, points.ids, "targets"))
    return points.chosen(np.array([name in names for name in points.ids]))


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A facet, or the whole surface where there are none: its section, design in the frame of the fit, its points."""

    section: SurfaceFacetSection | None
    name: str
    design: DesignSurface | None
    members: BoolArray


class _Surface(NamedTuple):
    """The points that belong to a surface, its facets, and what they are fitted to."""

    points: SurfacePoints
    parts: list[_Part]
    reference: Reference


def _build_surface(section: SurfaceSection, points: SurfacePoints) -> _Surface:
    whole = _design(section) if section.design else None
    if not section.facet:
        everything = np.ones(len(points.ids), dtype=np.bool_)
        return _Surface(points, [_Part(None, "surface", whole, everything)], _require_design(whole))
    owner = np.full(len(points.ids), -1)
    for place, facet in enumerate(section.facet):
        names = set(_expand_names(facet.targets, points.ids, f'facet "{facet.name}"'))
        own = np.array([name in names for name in points.ids])
        twice = np.nonzero(own & (owner >= 0))[0]
        if twice.size:
            other = section.facet[owner[twice[0]]].name
            raise InputError(f'surface.facet: target {points.ids[twice[0]]} is in "{other}" and in "{facet.name}"')
        owner[own] = place
    kept = owner >= 0
    points, owner = points.chosen(kept), owner[kept]
    parts = [
        _Part(one, one.name, _placed(one) if one.design else whole, owner == place)
        for place, one in enumerate(section.facet)
    ]
    if all(one.section is not None and one.section.design is None for one in parts):
        return _Surface(points, parts, _require_design(whole))
    return _Surface(points, parts, CompositeDesign(tuple(_require_design(one.design) for one in parts), owner))


def _require_design(design: DesignSurface | None) -> DesignSurface:
    if design is None:
        raise InputError("surface: a design is missing")
    return design


def _design(section: DesignKeys) -> DesignSurface:
    family = build_design_family(section)
    return DesignSurface(family.make, 1 / family.lengths_m, family.names, family.facet_from_optic)


def _placed(section: SurfaceFacetSection) -> DesignSurface:
    return _design(section).transformed(_place(section))


def _place(section: SurfaceFacetSection) -> RigidTransform:
    return RigidTransform.from_rotation_vector(section.rotation_vector_rad, section.position_m)


class _Fitted(NamedTuple):
    """The surface fitted or placed, how it started, and what stays open."""

    fit: SurfaceFit
    how: str
    still_open: Doubt | None = None


def _fit(section: SurfaceSection, points: SurfacePoints, reference: Reference, viewer_m: FloatArray) -> _Fitted:
    """Fit, or place, the surface."""
    choices = FitChoices(section.fit != "none", section.fit == "focal-length", section.robust)
    if section.reference:
        placed = _align(section, points)
        how = f"{len(section.reference)} targets of known place on the design"
        if choices.pose:
            return _Fitted(fit_surface(points, reference, placed.design_from_world, choices), how)
        held = fit_surface(placed.points, reference, RigidTransform.identity(), choices)
        return _Fitted(
            replace(held, design_from_world=placed.design_from_world), how + "; nothing is fitted beside them"
        )
    if not choices.pose:
        return _Fitted(fit_surface(points, reference, RigidTransform.identity(), choices), "the frame of the network")
    if isinstance(reference, MeshSurface):
        start, how = mesh_start(points.points_m, reference, viewer_m)
        return _Fitted(fit_surface(points, reference, start, choices), how)
    if isinstance(reference, CompositeDesign):
        trial = quick_fit(points.points_m, reference, RigidTransform.identity())
        if not trial.rms_m < _NEAR * float(np.ptp(points.points_m, axis=0).max()):
            raise InputError(
                f"surface: in the frame of the network the points are {trial.rms_m:.3g} m from their facets, which "
                "have designs of their own; name three or more [[surface.reference]] targets with their places"
            )
        return _Fitted(fit_surface(points, reference, trial.pose, choices), "the frame of the network")
    found = find_start(points.points_m, reference, viewer_m)
    still_open = Doubt("surface_start_ambiguous", found.open_words) if found.open_words else None
    return _Fitted(fit_surface(points, reference, found.design_from_world, choices), found.how, still_open)


@dataclass(frozen=True, slots=True, eq=False)
class _Aligned:
    design_from_world: RigidTransform
    points: SurfacePoints


def _align(section: SurfaceSection, points: SurfacePoints) -> _Aligned:
    """Place points by those whose design coordinates are known; the covariance contains that of the placing."""
    known = {one.target: one.xyz_m for one in section.reference}
    missing = [name for name in known if name not in points.ids]
    if missing:
        raise InputError(f"surface.reference: {', '.join(missing)} are not among the measured targets of the surface")
    fitted = np.array([name in known for name in points.ids])
    wanted = np.array([known.get(name, (0.0, 0.0, 0.0)) for name in points.ids])
    exact = SurfacePoints(points.ids, wanted, np.zeros_like(points.covariance_m2))
    fit = rigid_fit(points, exact, fitted)
    placed = fit.b_from_a.apply(points.points_m)
    return _Aligned(fit.b_from_a, SurfacePoints(points.ids, placed, fit.covariance_m2))


def _facet_names(ids: Sequence[str], parts: Sequence[_Part]) -> tuple[str, ...]:
    names = [""] * len(ids)
    for part in parts:
        if part.section is not None:
            for place in np.flatnonzero(part.members):
                names[place] = part.name
    return tuple(names)


def _facet_points(part: _Part, fit: SurfaceFit, section: SurfaceSection) -> FacetPoints:
    """Return a facet in the frame of the fit; without an outline it is the hull of its points."""
    own = part.section is not None and part.section.design is not None
    design = _require_design(part.design)
    if not own and isinstance(fit.reference, DesignSurface):
        design = fit.reference
    place = _place(part.section) if own and part.section is not None else RigidTransform.identity()
    outline = section.outline_m if part.section is None else part.section.outline_m
    xy = fit.points.points_m[part.members & ~fit.outliers, :2]
    if outline is None:
        if len(xy) < 3:
            raise EstimationError(f"surface: {part.name} has {len(xy)} usable points; three or more are needed")
        corners = hull_outline(xy)
    else:
        corners = _move_onto_surface(np.array(outline), design, place)
    given = None if part.section is None else part.section.reference_point_m
    reference = np.full(2, np.nan) if given is None else _move_onto_surface(np.array([given]), design, place)[0]
    return FacetPoints(
        Facet(part.name, corners, design.quadric, RigidTransform.identity(), reference), design, part.members
    )


def _move_onto_surface(xy: FloatArray, design: DesignSurface, place: RigidTransform) -> FloatArray:
    """Move places x, y of a facet's frame onto its surface and into the frame of the fit."""
    height = design.transformed(place.inverse()).quadric.height(*xy.T)
    return np.asarray(place.apply(np.column_stack([xy, height]))[:, :2])


def _slopes(
    section: SurfaceSection, fit: SurfaceFit, facets: Sequence[FacetPoints]
) -> tuple[SurfaceSlopes | None, Doubt | None]:
    """Return the slope maps; without enough points for one, the reason."""
    if not section.slope_map or not facets:
        return None, None
    step = None if section.grid_step_mm is None else 1e-3 * section.grid_step_mm
    try:
        return surface_slopes(fit, [Patch(one.facet, one.members) for one in facets], step), None
    except EstimationError as error:
        if section.grid_step_mm is not None:
            raise
        return None, Doubt("surface_without_slope_map", f"there is no slope map: {error}")


def _fit_doubts(fit: SurfaceFit, *, placed: bool) -> Iterator[Doubt]:
    if fit.outliers.any():
        names = [name for name, one in zip(fit.points.ids, fit.outliers, strict=True) if one]
        listed = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
        text = f"{len(names)} points are far from the surface and were not used for it: {listed}"
        yield Doubt("surface_points_not_used", text, {"points_count": len(names)})
    weak = fit.held[fit.reference.symmetries().shape[1] :]
    if weak and not placed:
        yield Doubt(
            "surface_not_placed",
            f"the surface is so shallow that the points do not place it along itself ({'; '.join(weak)}): it stays "
            "where the start put it; name three or more [[surface.reference]] targets to place it",
        )


def _comparison_doubts(moved: Displacements) -> Iterator[Doubt]:
    if moved.stable_probability < 1e-3:
        yield Doubt(
            "stable_targets_disagree",
            f"comparison: the stable targets disagree more than their sigmas say (variance factor "
            f"{moved.variance_factor:.2f}); some of them moved, or a sigma is too small",
            {"variance_factor": moved.variance_factor, "stable_probability": moved.stable_probability},
        )
