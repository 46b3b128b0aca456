"""Slope maps of any instrument in the form of other programs: SolTrace, PLY, CSV."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.measurement.writer import write_text
from heliogauge.results.slope_map_file import facet_names, read_slope_map, slope_map_in
from heliogauge.results.tables import write_table_csv
from heliogauge.results.used_results import serious_result
from heliogauge.slopes.map import SlopeMap, monomials
from heliogauge.validate import FloatArray

#: Degree of the surface that SolTrace takes for the height; a paraboloid has 2, a sagging panel a little of 4.
_DEGREE = 4


def export_slope_map(result: Path, out: Path, form: str, *, facet: str | None = None, force: bool = False) -> str:
    """Write the slope map of a folder of results as a file of another program.

    result: Folder with ``slope_map.nc``.
    out: The file.
    form: "soltrace", "ply" or "csv".
    facet: One facet of several; all together without it.
    force: Replace a file that is there.
    Returns: What was written, in a sentence, and in a second one what is serious about the result.
    InputError: There is no slope map, nothing in it, no such facet, or the file cannot be written.
    """
    file = slope_map_in(result)
    if facet is not None and facet not in facet_names(file):
        known = ", ".join(facet_names(file)) or "none, the map is of one facet"
        raise InputError(f"facet={facet}: no such facet in {file}; there are: {known}")
    if out.is_dir():
        raise InputError(f"{out}: a folder; name a file, such as {out / _FORMS[form][0]}")
    if out.exists() and not force:
        raise InputError(f"{out}: the file exists already; choose another name or give force=True to replace it")
    slope_map = read_slope_map(file, facet)
    if not slope_map.valid.any():
        raise InputError(f"{file}: no node has a slope, so there is nothing to export")
    serious = serious_result(result)
    across_only = "" if form == "csv" else words_of_design_along(slope_map)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: no folder can be made there ({error.strerror or error})") from error
    _FORMS[form][1](out, slope_map)
    said = [f"{int(slope_map.valid.sum())} nodes: {out}", across_only, "" if serious is None else f"serious: {serious}"]
    return "\n".join(filter(None, said))


def words_of_design_along(slope_map: SlopeMap) -> str:
    """Return, in a clause, at how many nodes only dz/dx was measured, so that files have the design's dz/dy."""
    measured = int(np.count_nonzero(slope_map.valid))
    missing = measured - int(np.count_nonzero(slope_map.valid & np.isfinite(slope_map.slope_y)))
    share = "all nodes" if missing == measured else f"{missing} of {measured} nodes"
    return f"dz/dy is the design's at {share}: only dz/dx was measured there" if missing else ""


def _write_csv(out: Path, slope_map: SlopeMap) -> None:
    """Write every node of the mirror; what was not measured is empty."""
    inside = slope_map.aperture
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    sigma_x, sigma_y = slope_map.sigma_slope()
    planes: Mapping[str, FloatArray] = {
        "x_m": x,
        "y_m": y,
        "slope_x": slope_map.slope_x,
        "slope_y": slope_map.slope_y,
        "design_slope_x": slope_map.design_slope_x,
        "design_slope_y": slope_map.design_slope_y,
        "sigma_slope_x": sigma_x,
        "sigma_slope_y": sigma_y,
        "height_m": slope_map.height_m,
    }
    columns: dict[str, np.ndarray] = {name: plane[inside] for name, plane in planes.items()}
    write_table_csv(out, columns | {"flag": slope_map.flags[inside].astype(np.int64)})


def fit_monomials(
    x: FloatArray, y: FloatArray, slope_x: FloatArray, slope_y: FloatArray, degree: int = _DEGREE
) -> FloatArray:
    """Fit a polynomial surface to slopes.

    Shapes: all (n,).
    x, y: Where the slopes were measured [m].
    degree: Total degree of the polynomial.
    Returns (n_terms,): Coefficients of ``x**(k - j) * y**j`` for k = 0 .. degree, j = 0 .. k [m]; the first is 0.
    """
    scale = float(max(np.abs(x).max(), np.abs(y).max(), 1e-9))
    u, v = x / scale, y / scale
    powers = [(k - j, j) for k in range(degree + 1) for j in range(k + 1)]
    lower = dict(
        zip([(k - j, j) for k in range(degree) for j in range(k + 1)], monomials(u, v, degree - 1), strict=True)
    )
    none = np.zeros_like(u)
    d_x = np.stack([i * lower.get((i - 1, j), none) for i, j in powers[1:]])
    d_y = np.stack([j * lower.get((i, j - 1), none) for i, j in powers[1:]])
    design = np.concatenate([d_x, d_y], axis=1).T / scale
    found = np.linalg.lstsq(design, np.concatenate([slope_x, slope_y]), rcond=None)[0]
    return np.array([0.0, *(c / scale ** (i + j) for c, (i, j) in zip(found, powers[1:], strict=True))])


def _write_soltrace(out: Path, slope_map: SlopeMap) -> None:
    """Write a VSHOT file: SolTrace takes the height from the polynomial and the normal from the slope angles.

    Coefficients B(k, m) stand at x^m y^(k - m); points are x, y [m], and the angles whose tangents are dz/dx and dz/dy
    [rad] (SolTrace's core, surface type 5).
    """
    if out.suffix.lower() != ".sht":
        raise InputError(f"{out}: SolTrace knows the file by its ending; name it {out.with_suffix('.sht').name}")
    good = slope_map.valid
    x, y = (plane[good] for plane in np.meshgrid(slope_map.x_m, slope_map.y_m))
    slopes = slope_map.slope_x[good], slope_map.with_both_slopes().slope_y[good]
    write_text(out, soltrace_text(x, y, *slopes, words_of_design_along(slope_map))[0])


def soltrace_text(
    x: FloatArray, y: FloatArray, slope_x: FloatArray, slope_y: FloatArray, comment: str = ""
) -> tuple[str, FloatArray]:
    """Return a VSHOT file as text, and the surface in its header.

    x, y, slope_x, slope_y (n,): Places [m] and slopes.
    comment: What its first line, the title, says beside who wrote it.
    Returns: The text; coefficients as `fit_monomials` has them [m].
    """
    surface = fit_monomials(x, y, slope_x, slope_y)
    fitted = iter(surface.tolist())
    rows = [[next(fitted) for _ in range(k + 1)] for k in range(_DEGREE + 1)]
    points = np.column_stack([x, y, np.arctan(slope_x), np.arctan(slope_y)])
    title = "; ".join(filter(None, ["slope map exported by heliogauge", comment]))
    lines = [title, "0\t0\t0", f"0\t{_DEGREE}\t{len(points)}", "0\t0"]
    # Ours fall in powers of x, SolTrace's rise.
    lines += [f"{value:.12e}" for row in rows for value in reversed(row)]
    lines += ["\t".join(f"{value:.9f}" for value in point) + "\t0" for point in points.tolist()]
    return "\n".join(lines) + "\n", surface


def _write_ply(out: Path, slope_map: SlopeMap) -> None:
    """Write points with normals, and triangles between neighbours that all have a height."""
    good = slope_map.valid & np.isfinite(slope_map.height_m)
    if not good.any():
        raise InputError(
            f"{out}: the map has slopes but no heights, which points of a surface need; integrate them, or export csv"
        )
    number = np.full(good.shape, -1)
    number[good] = np.arange(int(good.sum()))
    x, y = (plane[good] for plane in np.meshgrid(slope_map.x_m, slope_map.y_m))
    comment = "; ".join(filter(None, ["metres; heliogauge", words_of_design_along(slope_map)]))
    slope_map = slope_map.with_both_slopes()
    normals = np.column_stack([-slope_map.slope_x[good], -slope_map.slope_y[good], np.ones(x.size)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.column_stack([x, y, slope_map.height_m[good], normals]).astype("<f4")
    corners = [number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]]
    quads = np.stack(corners, axis=-1)[(np.stack(corners) >= 0).all(axis=0)]
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype("<i4")
    faces = np.zeros(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment {comment}\n"
        f"element vertex {len(points)}\n"
        + "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
        + f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    try:
        out.write_bytes(header.encode("ascii") + points.tobytes() + faces.tobytes())
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror or error})") from error


#: An example of a name, and what writes the file, of each form.
_FORMS: Mapping[str, tuple[str, Callable[[Path, SlopeMap], None]]] = {
    "soltrace": ("mirror.sht", _write_soltrace),
    "ply": ("mirror.ply", _write_ply),
    "csv": ("mirror.csv", _write_csv),
}
