"""Measured surfaces of other programs, as slopes: NURBS of the PAINT database and ARTIST, PLY, points with normals."""

from pathlib import Path
from typing import Any

import numpy as np

from deflectometry.exchange.slope_points import SlopePoints, refuse_implausible
from heliogauge.errors import InputError
from heliogauge.files.hdf5 import open_hdf5
from heliogauge.files.ply import read_ply_columns
from heliogauge.geometry.rigid import rotation_between
from heliogauge.results.tables import read_columns_csv
from heliogauge.validate import FloatArray

_POINTS = ("x_m", "y_m", "z_m", "normal_x", "normal_y", "normal_z")
#: Places on a NURBS surface along each of its directions: several for each of 20 control points.
_PLACES = 60


def read_surface(
    file: Path, heliostat: str | None = None, facet: str | None = None, *, without_canting: bool = False
) -> SlopePoints:
    """Read a measured surface.

    file: HDF5 with NURBS as ARTIST writes them, PLY with normals, or CSV with columns x_m, y_m, z_m, normal_x,
        normal_y, normal_z.
    heliostat, facet: Which surface of an HDF5 file with several; all facets without one.
    without_canting: Turn each facet of an HDF5 file back by the canting that the file gives it.
    Returns: Slopes where the surface is known; without sigmas.
    InputError: The file cannot be read, or has no such surface, no normals, or a surface seen from behind.
    """
    suffix = file.suffix.lower()
    if suffix in (".h5", ".hdf5"):
        points, normals = _read_nurbs(file, heliostat, facet, without_canting)
    elif without_canting:
        raise InputError(f"{file}: only NURBS of ARTIST (.h5) say how their facets are canted; leave it out")
    elif suffix == ".ply":
        points, normals = _read_ply(file)
    elif suffix == ".csv":
        _, table = read_columns_csv(file, (), _POINTS)
        columns = np.column_stack([table[name] for name in _POINTS])
        points, normals = np.split(columns[np.isfinite(columns).all(axis=1)], 2, axis=1)
    else:
        raise InputError(f"{file}: NURBS (.h5), PLY (.ply) or points with normals (.csv) are needed")
    return _slopes(file, points, normals)


def _slopes(file: Path, points: FloatArray, normals: FloatArray) -> SlopePoints:
    """Turn normals into slopes; all of them may point backwards, as some programs write them."""
    if len(points) == 0:
        raise InputError(f"{file}: there are no points with a normal")
    if np.median(normals[:, 2]) < 0:
        normals = -normals
    if not (normals[:, 2] > 0).all():
        count = int((normals[:, 2] <= 0).sum())
        raise InputError(
            f"{file}: {count} of {len(points)} normals lie across z or point the other way; turn the surface so that z "
            "points out of the mirror, and leave its edges out"
        )
    slope_x, slope_y = -normals[:, 0] / normals[:, 2], -normals[:, 1] / normals[:, 2]
    unknown = np.full(len(points), np.nan)
    return refuse_implausible(file, SlopePoints(points[:, 0], points[:, 1], slope_x, slope_y, unknown, unknown))


def _read_nurbs(
    file: Path, heliostat: str | None, facet: str | None, without_canting: bool
) -> tuple[FloatArray, FloatArray]:
    with open_hdf5(file) as content:
        surfaces = {name: one for name, one in content.get("heliostats", {}).items() if "surface/facets" in one}
        if not surfaces:
            raise InputError(f"{file}: there is no heliostats/NAME/surface/facets, as ARTIST writes it")
        if heliostat is None and len(surfaces) > 1:
            raise InputError(f"{file}: {len(surfaces)} heliostats ({', '.join(surfaces)}); give heliostat")
        name = heliostat or next(iter(surfaces))
        if name not in surfaces:
            raise InputError(f"heliostat={name}: not in {file}; there are {', '.join(surfaces)}")
        facets = surfaces[name]["surface/facets"]
        if facet is not None and facet not in facets:
            raise InputError(f"facet={facet}: not in {file}; there are {', '.join(facets)}")
        if not len(facets):
            raise InputError(f"{file}: heliostats/{name}/surface/facets is empty; export the heliostat again")
        chosen = [facets[one] for one in ([facet] if facet else facets)]
        try:
            grids = [(np.asarray(one["control_points"], float), [int(d) for d in one["degrees"]]) for one in chosen]
            turns = [_uncanted(one) if without_canting else np.eye(3) for one in chosen]
        except (KeyError, TypeError, ValueError, OSError) as error:
            what = "control points, degrees or canting" if without_canting else "control points or degrees"
            raise InputError(f"{file}: the {what} of {name} cannot be read ({error})") from None
    found = [evaluate_nurbs(file, control, degrees)[1] for control, degrees in grids]
    points = np.concatenate([fitted_places(control) for control, _ in grids])
    # Only the normals: the places stay where they are on the heliostat.
    return points, np.concatenate([one @ turn.T for one, turn in zip(found, turns, strict=True)])


def fitted_places(control_m: FloatArray) -> FloatArray:
    """Return where the normals of a facet belong that ARTIST fitted to measured ones.

    control_m (m, n, 3): Control points [m].
    Returns: Places in the order of `evaluate_nurbs`, shape (k, 3) [m].

    ARTIST (SurfaceGenerator.fit_nurbs) compares a measured normal with the surface's at the parameters that are the
    place's share of the facet's extent. Its control points keep their even lattice, and on that the surface's own
    places at those parameters are up to three times as far apart at the rim: slopes there would count too much.
    """
    share = (np.arange(_PLACES) + 0.5) / _PLACES
    weight = np.stack([1 - share, share], axis=1)
    corners = control_m[np.ix_([0, -1], [0, -1])]
    return np.asarray(np.einsum("ua,vb,abk->uvk", weight, weight, corners).reshape(-1, 3))


def _uncanted(facet: Any) -> FloatArray:
    """Return the rotation that takes the normal of a canted facet to z: the file has two vectors along the facet."""
    canting = np.asarray(facet["canting"], dtype=np.float64)
    if canting.ndim != 2 or canting.shape[0] != 2 or canting.shape[1] < 3:
        raise ValueError(f"canting of shape {canting.shape}, two vectors are needed")
    normal = np.cross(canting[0, :3], canting[1, :3])
    return rotation_between(normal if normal[2] > 0 else -normal, [0.0, 0.0, 1.0])


def evaluate_nurbs(file: Path, control_m: FloatArray, degrees: list[int]) -> tuple[FloatArray, FloatArray]:
    """Evaluate a NURBS surface with equal weights and clamped uniform knots.

    file: For messages.
    control_m (m, n, 3): Control points [m].
    degrees: In both directions.
    Returns: Points and normals, each of shape (k, 3).
    InputError: Not a grid of control points, or fewer than the degrees need.
    """
    from scipy.interpolate import BSpline

    is_grid = control_m.ndim == 3 and control_m.shape[2] == 3 and len(degrees) == 2
    if not (is_grid and np.isfinite(control_m).all()) or min(degrees) < 1 or min(control_m.shape[:2]) <= max(degrees):
        raise InputError(f"{file}: control points of shape {control_m.shape} and degrees {degrees} are no surface")
    place = (np.arange(_PLACES) + 0.5) / _PLACES

    def along(values: FloatArray, degree: int, axis: int, order: int) -> FloatArray:
        knots = np.r_[np.zeros(degree), np.linspace(0, 1, values.shape[axis] - degree + 1), np.ones(degree)]
        return np.asarray(BSpline(knots, np.moveaxis(values, axis, 0), degree)(place, nu=order)).swapaxes(0, axis)

    surface, d_u, d_v = (
        along(along(control_m, degrees[0], 0, of_u), degrees[1], 1, of_v) for of_u, of_v in ((0, 0), (1, 0), (0, 1))
    )
    return surface.reshape(-1, 3), np.cross(d_u, d_v).reshape(-1, 3)


def _read_ply(file: Path) -> tuple[FloatArray, FloatArray]:
    columns = read_ply_columns(file)
    if not {"x", "y", "z", "nx", "ny", "nz"} <= set(columns):
        raise InputError(
            f"{file}: vertices with x, y, z and normals nx, ny, nz are needed; points without normals are a scan of "
            "the surface (`heliogauge deflectometry init FOLDER --scan`)"
        )
    points = np.column_stack([columns[name] for name in ("x", "y", "z")])
    normals = np.column_stack([columns[name] for name in ("nx", "ny", "nz")])
    good = np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1) & (np.abs(normals).max(axis=1) > 0)
    return points[good], normals[good]
