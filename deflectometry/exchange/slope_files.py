"""Slopes that another program or instrument measured: SolTrace's VSHOT files and slope maps become a measurement."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deflectometry.exchange.nearest_design import are_of_surface, curvatures, nearest_design, rms_off
from deflectometry.exchange.slope_points import SlopePoints, points_words, refuse_implausible
from deflectometry.exchange.surface_files import read_surface
from deflectometry.pipeline.design_check import is_other_shape
from heliogauge.errors import InputError
from heliogauge.files.texts import read_text
from heliogauge.measurement.designs import build_design
from heliogauge.measurement.imported import IMPORTED, write_imported
from heliogauge.measurement.models import DesignKeys
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.slope_export import fit_monomials
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.results.tables import read_columns_csv, read_table_csv, write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.validate import FloatArray

SLOPES_FILE, MAP_FILE = "slopes.csv", "slopes.nc"
COLUMNS = ("x_m", "y_m", "slope_x", "slope_y")
SIGMAS = ("sigma_slope_x", "sigma_slope_y")
#: Files that are slope maps of ours.
MAP_SUFFIXES = (".nc", ".nc4")
#: Headers have six decimals: a fit to the points they were made of returns them to one of the last.
_SAME_COEFFICIENT = 1e-6
_QUADRATIC_TERMS = 6


@dataclass(frozen=True, slots=True, eq=False)
class VshotFile:
    """What a VSHOT file says.

    points: Slopes: the tangents of the angles in the third and fourth column.
    coefficients (k,): Surface in its header: factors of ``x**j * y**(i - j)`` for i = 0 .. order, j = 0 .. i [m].
    fitted (k,): The same fitted to its own points by least squares on the slopes. The first, which slopes do not say,
        is the header's; all are where there are too few points.
    """

    points: SlopePoints
    coefficients: FloatArray
    fitted: FloatArray

    @property
    def stated_per_m(self) -> FloatArray | None:
        """A, B, E of the surface ``A x^2 + B y^2 + E x y`` in its header, shape (3,) [1/m]; None without one."""
        if self.coefficients.size < _QUADRATIC_TERMS or not self.coefficients.any() or self.contradiction:
            return None
        return np.asarray(self.coefficients[[5, 3, 4]])

    @property
    def contradiction(self) -> str:
        """What is wrong with the header, in a clause; empty where it is the surface of its points."""
        off = np.abs(self.fitted - self.coefficients)
        if not self.coefficients.any() or off.max() <= _SAME_COEFFICIENT:
            return ""
        term = int(off.argmax())
        i = int((np.sqrt(8 * term + 1) - 1) / 2)
        j = term - i * (i + 1) // 2
        return (
            f"its header is not the surface of its points: x^{j} y^{i - j} has {self.coefficients[term]:.6g} there, "
            f"and {self.fitted[term]:.6g} in a fit to them (SolTrace takes heights from the header and normals from "
            "the points); the points were taken. Are the angles in radians, and in the order x, y?"
        )


def read_soltrace(file: Path) -> VshotFile:
    """Read a VSHOT file (.sht) as SolTrace does, and fit the surface of its header again.

    InputError: The file cannot be read, or is no such file.
    """
    lines = read_text(file, "a VSHOT file of SolTrace").splitlines()
    counts = lines[2].split()[:3] if len(lines) > 2 else []
    if len(counts) < 3 or not all(cell.isdecimal() for cell in counts[1:]):
        raise InputError(
            f"{file}: not a VSHOT file of SolTrace (.sht): its third line must hold three numbers, the last two "
            f"the order of a surface and how many points follow, not {' '.join(counts)[:40]!r}"
        )
    try:
        order, count = (int(cell) for cell in counts[1:])
        first = 4 + (order + 1) * (order + 2) // 2
        coefficients = np.array([float(line.split()[0]) for line in lines[4:first]])
        rows = [[float(cell) for cell in line.split()[:4]] for line in lines[first : first + count]]
        table = np.array(rows, dtype=np.float64)
    except (IndexError, ValueError) as error:
        raise InputError(f"{file}: not a VSHOT file of SolTrace ({error}); its points start with line 11") from None
    if count < 1 or table.shape != (count, 4) or not np.isfinite(table).all():
        raise InputError(f"{file}: {len(rows)} points of x, y and two angles were read, but line 3 says {count}")
    if np.abs(table[:, 2:]).max() >= np.pi / 2:
        raise InputError(f"{file}: an angle of {np.abs(table[:, 2:]).max():.3g} rad; angles of slopes are in radians")
    unknown = np.full(count, np.nan)
    slope_x, slope_y = np.tan(table[:, 2:]).T
    points = refuse_implausible(file, SlopePoints(table[:, 0], table[:, 1], slope_x, slope_y, unknown, unknown))
    fitted = coefficients
    if order > 0 and 2 * count >= coefficients.size:
        # Ours fall in powers of x, SolTrace's rise.
        ours = fit_monomials(points.x_m, points.y_m, slope_x, slope_y, order)
        terms = [ours[k * (k + 1) // 2 : (k + 1) * (k + 2) // 2][::-1] for k in range(1, order + 1)]
        fitted = np.concatenate([coefficients[:1], *terms])
    return VshotFile(points, coefficients, fitted)


def read_slopes(file: Path) -> SlopePoints:
    """Read a slope map: NetCDF of ours, or a table with columns x_m, y_m, slope_x, slope_y (and their sigmas).

    Returns: All points of the mirror: those without slopes count as not measured.
    InputError: The file cannot be read, lacks a column, or has no slopes.
    """
    if file.suffix.lower() in MAP_SUFFIXES:
        slope_map = read_slope_map(file)
        valid, mirror = slope_map.valid, slope_map.aperture
        measured = (slope_map.slope_x, slope_map.slope_y, *slope_map.sigma_slope())
        planes = (*np.meshgrid(slope_map.x_m, slope_map.y_m), *(np.where(valid, one, np.nan) for one in measured))
        points = SlopePoints(*(plane[mirror] for plane in planes))
    else:
        known = [name for name in SIGMAS if name in read_table_csv(file, COLUMNS)]
        _, table = read_columns_csv(file, (), (*COLUMNS, *known))
        placed = np.isfinite(table["x_m"]) & np.isfinite(table["y_m"])
        none = np.full(int(placed.sum()), np.nan)
        sigmas = (table[name][placed] if name in known else none for name in SIGMAS)
        points = SlopePoints(*(table[name][placed] for name in COLUMNS), *sigmas)
    if not points.measured.any():
        raise InputError(f"{file}: no point has both slopes, so there is nothing to evaluate")
    return refuse_implausible(file, points)


def import_slopes(
    file: Path,
    folder: Path,
    form: str,
    design: Mapping[str, Any] | None = None,
    *,
    heliostat: str | None = None,
    facet: str | None = None,
    without_canting: bool = False,
    force: bool = False,
) -> str:
    """Write a measurement folder from slopes of another program.

    form: "soltrace", "slopes" or "surface".
    heliostat, facet: Which surface of a file with several.
    without_canting: Facets of a file that says how they are canted are turned back to the heliostat's plane.
    design: Keys of [mirror]: the design that the slopes are compared with; a plane without them.
    force: Replace a folder that was imported earlier.
    Returns: What was taken over, in a sentence; and which design is nearest, where they are of another shape.
    InputError: The file cannot be read, the design is not one, or the folder is in use.
    """
    if form == "surface":
        vshot = None
        points = read_surface(file, heliostat, facet, without_canting=without_canting)
    else:
        vshot = read_soltrace(file) if form == "soltrace" else None
        points = read_slopes(file) if vshot is None else vshot.points
    wrong = "" if vshot is None else vshot.contradiction
    keys = dict(design or {"design": "plane"})
    # A map of ours stays what it is: with its own design and what makes its sigma.
    is_map = form == "slopes" and file.suffix.lower() in MAP_SUFFIXES
    kept = MAP_FILE if is_map else SLOPES_FILE
    name = " ".join(filter(None, (heliostat, facet))) or file.stem
    with WholeFolder(folder, IMPORTED, force=force) as working:
        if is_map:
            shutil.copyfile(file, working / MAP_FILE)
        else:
            write_points(working / SLOPES_FILE, points)
        write_slopes_measurement(working, name, kept, keys, f"Slopes imported from {file.name}.")
        write_imported(working, form, [file])
    stated = _map_curvatures(file) if is_map else None if vshot is None else vshot.stated_per_m
    source = "the best fit is" if stated is None else "its own design is" if is_map else "the surface in its header is"
    nearer = _nearer_design(points, keys, stated, source, is_given=bool(design))
    return "; ".join(filter(None, (f"{file.name}: {points_words(points)}", wrong, nearer)))


def _map_curvatures(file: Path) -> FloatArray:
    """Return A, B, E of the design of a map of ours, shape (3,) [1/m]."""
    one = read_slope_map(file)
    x, y = np.meshgrid(one.x_m, one.y_m)
    at, unknown = one.valid, np.full(int(np.count_nonzero(one.valid)), np.nan)
    slopes = one.design_slope_x[at], one.design_slope_y[at]
    return curvatures(SlopePoints(x[at], y[at], *slopes, unknown, unknown))


def _nearer_design(
    points: SlopePoints, keys: Mapping[str, Any], stated_per_m: FloatArray | None, source: str, *, is_given: bool
) -> str:
    """Say which simple design is nearest to slopes that are of another shape than theirs; empty otherwise.

    stated_per_m (3,): A, B, E of the surface that the file states; None where it states none.
    source: Where the nearest design is from.
    is_given: Whether the design was chosen.
    """
    if not are_of_surface(points):
        return ""
    design = build_design(DesignKeys(**keys))
    error_rad = rms_off(points, design)
    nearest = nearest_design(points, curvatures(points) if stated_per_m is None else stated_per_m)
    if not is_other_shape(error_rad, nearest.rms_rad):
        return ""
    chosen = "the slopes are" if is_given else "no design was given: the slopes are"
    return (
        f"{chosen} {1e3 * error_rad:.3g} mrad RMS off {design.describe()}, with which they are compared; {source} "
        f"{nearest.describe()}, {1e3 * nearest.rms_rad:.3g} mrad off: {nearest.options}"
    )


def write_points(path: Path, points: SlopePoints) -> None:
    """Write slopes as the table that `read_slopes` reads."""
    columns = dict(zip(COLUMNS, (points.x_m, points.y_m, points.slope_x, points.slope_y), strict=True))
    if np.isfinite(points.sigma_x).any():
        columns |= dict(zip(SIGMAS, (points.sigma_x, points.sigma_y), strict=True))
    write_table_csv(path, columns)


def write_slopes_measurement(working: Path, name: str, file: str, design: Mapping[str, Any], comment: str) -> None:
    """Write measurement.toml of ``kind = "slopes"`` for a table or map in the same folder."""
    content = {"kind": "slopes", "name": name, "slopes": {"file": file}, "mirror": dict(design)}
    write_measurement(working, content, comment=comment)
