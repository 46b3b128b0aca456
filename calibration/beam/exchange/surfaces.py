"""Surfaces of mirrors from files: NURBS as of ARTIST, slope maps of this program, tables of points and normals."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.beam.keys import BeamFacetSection
from calibration.beam.mirror.facets import Facet, Mirror, canted
from heliogauge.errors import InputError
from heliogauge.files.hdf5 import open_hdf5
from heliogauge.measurement.files import natural_order
from heliogauge.results.folder import read_slope_map, read_table_csv
from heliogauge.validate import FloatArray

__all__ = [
    "ArtistMirror",
    "artist_heliostats",
    "design_mirror",
    "nurbs_patches",
    "read_artist_mirror",
    "read_point_mirror",
    "read_slope_map_mirror",
]

_POINT_COLUMNS = ("x_m", "y_m", "z_m", "slope_x", "slope_y", "area_m2")

#: Patches along each side of a facet: 32 of a facet of 1.6 m are 5 cm, a tenth of the sun's picture 50 m away.
_PATCHES = 32


def nurbs_patches(
    control_points_m: FloatArray, degrees: tuple[int, int], patches: int = _PATCHES
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate a clamped B-spline surface with uniform knots at the middles of equal patches of its parameters.

    control_points_m (p, q, 3): Control points [m].
    degrees: Along both parameters.
    Returns: Points (n, 3) [m], unit normals (n, 3) with z > 0, areas (n,) [m^2].
    """
    middle = (np.arange(patches) + 0.5) / patches
    first = [_basis(count, degree, middle) for count, degree in zip(control_points_m.shape[:2], degrees, strict=True)]
    (u, du), (v, dv) = first
    points = np.einsum("ip,jq,pqk->ijk", u, v, control_points_m).reshape(-1, 3)
    along = np.einsum("ip,jq,pqk->ijk", du, v, control_points_m).reshape(-1, 3)
    across = np.einsum("ip,jq,pqk->ijk", u, dv, control_points_m).reshape(-1, 3)
    normals = np.cross(along, across)
    area = np.linalg.norm(normals, axis=1)
    normals = normals / area[:, None]
    return points, np.where(normals[:, 2:] < 0, -normals, normals), area / patches**2


def _basis(count: int, degree: int, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values and derivatives of clamped uniform B-splines, shape (n, count) each (de Boor)."""
    knots = np.concatenate([np.zeros(degree), np.linspace(0, 1, count - degree + 1), np.ones(degree)])
    values = ((at[:, None] >= knots[:-1]) & (at[:, None] < knots[1:])).astype(np.float64)
    below = values
    for k in range(1, degree + 1):
        below = values
        parts = []
        for i in range(values.shape[1] - 1):
            left, right = knots[i + k] - knots[i], knots[i + k + 1] - knots[i + 1]
            part = np.zeros(at.size)
            if left > 0:
                part += (at - knots[i]) / left * values[:, i]
            if right > 0:
                part += (knots[i + k + 1] - at) / right * values[:, i + 1]
            parts.append(part)
        values = np.stack(parts, axis=1)
    rates = np.zeros_like(values)
    for i in range(count):
        left, right = knots[i + degree] - knots[i], knots[i + degree + 1] - knots[i + 1]
        if left > 0:
            rates[:, i] += degree / left * below[:, i]
        if right > 0:
            rates[:, i] -= degree / right * below[:, i + 1]
    return values, rates


@dataclass(frozen=True, slots=True, eq=False)
class ArtistMirror:
    """A heliostat of a file of ARTIST.

    position_m (3,): Its middle: east, north, up from the plant's origin [m].
    mirror: Its facets.
    """

    position_m: FloatArray
    mirror: Mirror


def artist_heliostats(path: Path) -> tuple[str, ...]:
    """Return the names of the heliostats in a file of ARTIST."""
    with open_hdf5(path) as file:
        return tuple(file["heliostats"]) if "heliostats" in file else ()


def read_artist_mirror(path: Path, heliostat: str) -> ArtistMirror:
    """Read the facets of a heliostat from a file of ARTIST: NURBS of each.

    InputError: No such heliostat, or a group that is not as ARTIST writes it.

    Surfaces that were fitted to a measurement contain the canting; those by design have it beside them, as the turn of
    each facet. Which of both a file has shows in the mean normals of the facets: along the stated canting they lean by
    most of it, or not at all.
    """
    with open_hdf5(path) as file:
        group: Any = file.get("heliostats")
        if group is None or heliostat not in group:
            known = ", ".join(group) if group is not None else "none"
            raise InputError(f"{path}: heliostat {heliostat!r} is not in it; there are: {known}")
        facets = group[heliostat]["surface"]["facets"]
        place = np.asarray(group[heliostat]["position"][()], dtype=np.float64)[:3]
        names = sorted(facets, key=natural_order)
        read = [
            (
                np.asarray(facets[name]["control_points"][()], dtype=np.float64),
                np.asarray(facets[name]["canting"][()], dtype=np.float64)[:, :3],
                np.asarray(facets[name]["position"][()], dtype=np.float64)[:3],
                np.asarray(facets[name]["degrees"][()]).tolist(),
            )
            for name in names
        ]
    patches = [nurbs_patches(control, (int(degrees[0]), int(degrees[1]))) for control, _, _, degrees in read]
    stated = np.array([_normal(canting)[:2] for _, canting, _, _ in read])
    leaning = np.array([normals.mean(axis=0)[:2] for _, normals, _ in patches])
    contained = float(np.sum(stated * leaning)) > 0.5 * float(np.sum(stated**2))
    found = []
    for (_, _, position, _), (points, normals, area), lean in zip(read, patches, stated, strict=True):
        # Control points of some files are about the facet's middle, of others about the mirror's.
        offset = position if np.linalg.norm(points.mean(axis=0)[:2]) < 0.5 * np.linalg.norm(position[:2]) else 0.0
        facet = Facet(position, points + offset, normals, area)
        found.append(facet if contained else _leaning(facet, lean))
    words = "canting as measured" if contained else "canting as stated"
    mirror = Mirror(tuple(found), tuple(names), f"NURBS of {heliostat} in {path.name}, {words}")
    return ArtistMirror(place, mirror)


def _normal(spanning: FloatArray) -> FloatArray:
    normal = np.cross(spanning[0], spanning[1])
    return np.asarray(normal / np.linalg.norm(normal))


def _leaning(facet: Facet, lean: FloatArray) -> Facet:
    return canted(Mirror((facet,), ("facet",)), lean[None, :]).facets[0]


def read_slope_map_mirror(path: Path) -> Mirror:
    """Read a mirror from a slope map: its measured nodes are the patches, with the design's dz/dy where none is.

    InputError: Not a slope map, or nothing was measured.
    """
    slope_map = read_slope_map(path).with_both_slopes()
    valid = slope_map.valid
    if not valid.any():
        raise InputError(f"{path}: no node of the slope map was measured")
    grid_x, grid_y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    heights = np.where(np.isfinite(slope_map.height_m), slope_map.height_m, 0.0)
    x, y, z = grid_x[valid], grid_y[valid], heights[valid]
    p, q = slope_map.slope_x[valid], slope_map.slope_y[valid]
    cell = float((slope_map.x_m[1] - slope_map.x_m[0]) * (slope_map.y_m[1] - slope_map.y_m[0]))
    return _one_facet(np.column_stack([x, y, z, p, q, cell * np.sqrt(1 + p * p + q * q)]), f"slope map {path.name}")


def read_point_mirror(path: Path) -> Mirror:
    """Read a mirror from a table of points: x_m, y_m, z_m, slope_x, slope_y, area_m2, facet.

    InputError: A column is missing, or a cell is no number.
    """
    table = read_table_csv(path, _POINT_COLUMNS)
    try:
        values = np.array([[float(cell) for cell in table[name]] for name in _POINT_COLUMNS]).T
    except ValueError as error:
        raise InputError(f"{path}: {error}; numbers are needed in {', '.join(_POINT_COLUMNS)}") from error
    names = table.get("facet", [""] * len(values))
    kept = list(dict.fromkeys(names))
    facets = [_one_facet(values[[name == one for name in names]], "").facets[0] for one in kept]
    return Mirror(tuple(facets), tuple(one or "mirror" for one in kept), f"points of {path.name}")


def _one_facet(values: FloatArray, source: str) -> Mirror:
    x, y, z, p, q, area = values.T
    points = np.column_stack([x, y, z])
    center = np.average(points, axis=0, weights=area)
    normals = np.column_stack([-p, -q, np.ones(p.size)])
    return Mirror((Facet(center, points, normals, area),), ("mirror",), source)


def design_mirror(sections: Sequence[BeamFacetSection]) -> Mirror:
    """Return a mirror of rectangular facets by design."""
    middle = (np.arange(_PATCHES) + 0.5) / _PATCHES - 0.5
    facets, turns = [], []
    for one in sections:
        x, y = (part.ravel() for part in np.meshgrid(one.width_m * middle, one.height_m * middle))
        bend = 0.0 if one.focal_length_m is None else 1 / (2 * one.focal_length_m)
        points = np.column_stack([x, y, 0.5 * bend * (x * x + y * y)]) + np.array(one.center_m)
        normals = np.column_stack([-bend * x, -bend * y, np.ones(x.size)])
        area = np.full(x.size, one.width_m * one.height_m / x.size)
        facets.append(Facet(np.array(one.center_m), points, normals, area))
        turns.append([1e-3 * value for value in one.canting_mrad])
    mirror = Mirror(tuple(facets), tuple(f"facet_{k + 1}" for k in range(len(facets))), "facets by design")
    return canted(mirror, np.array(turns))
