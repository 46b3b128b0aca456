"""Slope maps and per-pixel results on disk: NetCDF-4, opens in xarray, Panoply, MATLAB, ncdump.

A NetCDF-4 file is an HDF5 file with dimension scales and creation order: it is written here through h5py. Importing
xarray with h5netcdf takes 0.43 s of CPU, 29 % of the whole command on a small facet (benchmarks/facet_command.py,
median of 9 pairs), which needs nothing else of them. The tests read the files through xarray.
"""

import hashlib
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from heliogauge import __version__
from heliogauge.errors import InputError
from heliogauge.files.hdf5 import open_hdf5
from heliogauge.flags import FLAG_TEXTS, SampleFlag
from heliogauge.slopes.map import CommonModes, SlopeMap, no_common_modes

#: Raised when a variable changes its name or meaning; readers refuse what is newer than they are.
SLOPE_MAP_SCHEMA = 1
#: Name of the map at the root of a file that also holds one group for each facet.
ASSEMBLED = ""

#: Side of the squares that a variable of which a part is blank is stored in.
_CHUNK_PIXELS = 128

# HDF5 keeps an attribute in the object header, which ends at 64 KiB: the hashes of some 600 files.
_LONGEST_ATTRIBUTE = 60_000

ORIENTATION = (
    "seen from the front (from the reflecting side): x to the right, y up, z out of the mirror towards the viewer; "
    "slope_x = dz/dx, slope_y = dz/dy; slope error = measured minus design, of the surface normal"
)

#: Unit and meaning of each per-pixel variable; arrays are [row, column], pixel (0, 0) is the one at the top left.
PIXEL_VARIABLES: dict[str, tuple[str, str]] = {
    "x": ("m", "point on the mirror seen by the pixel, mirror frame, x"),
    "y": ("m", "point on the mirror seen by the pixel, mirror frame, y"),
    "z": ("m", "point on the mirror seen by the pixel, mirror frame, z"),
    "slope_x": ("rad", "measured dz/dx"),
    "slope_y": ("rad", "measured dz/dy"),
    "sigma_x": ("rad", "random standard deviation of slope_x"),
    "sigma_y": ("rad", "random standard deviation of slope_y"),
    "u": ("1", "screen point seen by the pixel, fraction of the displayed width from its left edge"),
    "v": ("1", "screen point seen by the pixel, fraction of the displayed height from its top edge"),
    "sigma_u": ("1", "standard deviation of u"),
    "sigma_v": ("1", "standard deviation of v"),
    "modulation_dn": ("DN", "amplitude of the fringes in the images"),
    "image_x_px": ("px", "where the sample is in the image, to the right"),
    "image_y_px": ("px", "where the sample is in the image, down"),
    "residual_dn": ("DN", "rms of the frames about their sinusoid"),
    "facet": ("1", "number of the facet, from 1; 0 is none"),
    "flag": ("1", "why a pixel is missing or doubtful"),
}

# (variable, attribute of SlopeMap, unit, long name): float32 keeps 0.3 nrad of a slope of 5 mrad and 7 nm of a height
# of 0.1 m, far below every noise, at half the bytes.
_FIELDS = (
    ("slope_x", "slope_x", "rad", "measured slope dz/dx"),
    ("slope_y", "slope_y", "rad", "measured slope dz/dy"),
    ("design_slope_x", "design_slope_x", "rad", "design slope dz/dx"),
    ("design_slope_y", "design_slope_y", "rad", "design slope dz/dy"),
    ("slope_error_x", "slope_error_x", "rad", "slope error dz/dx, measured minus design"),
    ("slope_error_y", "slope_error_y", "rad", "slope error dz/dy, measured minus design"),
    ("sigma_random_slope_x", "sigma_random_x", "rad", "standard deviation of slope_x, random share"),
    ("sigma_random_slope_y", "sigma_random_y", "rad", "standard deviation of slope_y, random share"),
    ("height", "height_m", "m", "height of the surface over the plane z = 0"),
)


def write_slope_map(path: Path, maps: Mapping[str, SlopeMap], attributes: Mapping[str, Any] | None = None) -> None:
    """Write slope maps into one NetCDF-4 file.

    path: The file, usually ``slope_map.nc``; replaced where it exists.
    maps: One map: it stands at the root of the file. Several: one group for each name, and the map of the name
        `ASSEMBLED` (the empty string) at the root.
    attributes: More global attributes: strings and numbers as they are, mappings and lists as JSON text
        (``input_sha256`` is such a mapping).
    InputError: No map, several maps without an assembled one, or the file cannot be written.

    No compression: on measured maps deflate saves a third of the bytes and costs 1.3 s of CPU for 1200 x 1200 nodes.
    """
    facets = {name: slope_map for name, slope_map in maps.items() if name != ASSEMBLED}
    if len(maps) == 1:
        root, facets = next(iter(maps.values())), {}
    elif ASSEMBLED in maps:
        root = maps[ASSEMBLED]
    else:
        raise InputError(f"maps: {len(maps)} maps given; the assembled map of the name '' is needed beside the facets")
    with written_at_once(path) as file:
        write_global_attributes(file, attributes or {})
        _write_map(file, root)
        for name, slope_map in facets.items():
            _write_map(file.create_group(_group_name(name), track_order=True), slope_map)


@contextmanager
def written_at_once(path: Path) -> Iterator[h5py.File]:
    """Build an HDF5 file in memory and write it in one go.

    On a full disk HDF5 fails again when it closes its file, and the interpreter crashes when it ends.
    """
    content = io.BytesIO()
    with h5py.File(content, "w", track_order=True) as file:
        yield file
    try:
        path.write_bytes(content.getbuffer())
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}); check permissions and space"
        ) from error


def slope_map_in(result: Path) -> Path:
    """Return the file with the slope map of a folder of results.

    InputError: There is none; where folders in it have one, as those of several modules, one of them is named.
    """
    file = result / "slope_map.nc"
    if file.is_file():
        return file
    inside = sorted(one.parent for one in result.glob("*/slope_map.nc"))
    if inside:
        raise InputError(
            f"{result}: {len(inside)} mirrors have a folder of results each in it; give one of them, as {inside[0]}"
        )
    raise InputError(f"{result}: there is no slope_map.nc; results with a slope map are needed")


def read_slope_map(path: Path, group: str | None = None) -> SlopeMap:
    """Read one slope map back, its fields to float32.

    group: Name of a facet; the map at the root without it.
    """
    with open_file(path) as file:
        if group is None:
            return _read_map(file, str(path))
        names = _group_names(file)
        if _group_name(group) not in names:
            known = ", ".join(names) or "none, the map is at the root"
            raise InputError(f"{path}: no facet {group!r} (facets here: {known})")
        return _read_map(file[_group_name(group)], f"{path}, facet {group}")


def facet_names(path: Path) -> tuple[str, ...]:
    """Return the names of the facets in a slope map file, in the order of writing; empty for a single map."""
    with open_file(path) as file:
        return _group_names(file)


def read_slope_map_attributes(path: Path) -> dict[str, Any]:
    """Return the global attributes of a slope map file; JSON texts are parsed."""
    with open_file(path) as file:
        return {name: plain_value(value) for name, value in file.attrs.items() if not name.startswith("_")}


@dataclass(frozen=True, slots=True)
class CutOut:
    """The part of an image that arrays hold; around it are only blank pixels.

    image_shape: Rows and columns of the whole image.
    first_row, first_column: Place of the part's first pixel in it [px].
    blanks: What stands around it, by variable; NaN or 0 for the rest.
    """

    image_shape: tuple[int, int]
    first_row: int
    first_column: int
    blanks: Mapping[str, int]


def write_pixels(
    path: Path,
    arrays: Mapping[str, npt.NDArray[Any]],
    attributes: Mapping[str, Any] | None = None,
    *,
    cut_out: CutOut | None = None,
) -> None:
    """Write what each camera pixel saw, dims (row, column).

    arrays (n_rows, n_columns): Some of `PIXEL_VARIABLES`; floating values are stored as float32.
    attributes: Global attributes. ``first_row``, ``first_column`` place a cut-out, ``step`` a decimated one, in the
        image [px].
    cut_out: Place of the arrays in an image that is stored whole: only the part that they hold takes space in the file.
    InputError: Unknown variable, differing shapes, or the file cannot be written.

    float32 keeps 0.2 um on a 3 m facet and 1e-5 of a sigma: below every measured noise, at half the bytes.
    """
    shapes = {np.shape(array) for array in arrays.values()}
    unknown = sorted(set(arrays) - set(PIXEL_VARIABLES))
    if unknown or len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise InputError(
            f"pixels: arrays of one shape (rows, columns) with names from {', '.join(PIXEL_VARIABLES)} are needed, "
            f"not {', '.join(unknown) or 'shapes ' + str(sorted(shapes))}"
        )
    rows, columns = next(iter(shapes)) if cut_out is None else cut_out.image_shape
    with written_at_once(path) as file:
        write_global_attributes(file, attributes or {})
        scales = [_write_bare_dimension(file, name, size) for name, size in (("row", rows), ("column", columns))]
        for name, array in arrays.items():
            labels = dict(zip(("units", "long_name"), PIXEL_VARIABLES[name], strict=True))
            if name == "flag":
                _write_flags(file, array, scales, cut_out)
            else:
                is_float = np.issubdtype(array.dtype, np.floating)
                values = array.astype(np.float32, copy=False) if is_float else array
                write_variable(file, name, values, scales, labels, cut_out)


def read_pixels(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Read what `write_pixels` wrote.

    Returns (n_rows, n_columns): The arrays by name.
    """
    with open_file(path) as file:
        return {name: stored_values(file[name]) for name in file if name in PIXEL_VARIABLES}


@contextmanager
def open_file(path: Path) -> Iterator[Any]:
    """Open a NetCDF-4 file of results for reading.

    InputError: As `heliogauge.files.hdf5.open_hdf5`; or written by another program, or a later version.
    """
    with open_hdf5(path) as file:
        schema = int(plain_value(file.attrs.get("heliogauge_schema", 0)))
        if not 1 <= schema <= SLOPE_MAP_SCHEMA:
            raise InputError(
                f"{path}: heliogauge_schema {schema} is not one this version reads (1 to {SLOPE_MAP_SCHEMA}); "
                "a results file of heliogauge is needed, of this version or older"
            )
        yield file


def _group_name(name: str) -> str:
    return name.replace("/", "_")


def _group_names(file: Any) -> tuple[str, ...]:
    return tuple(name for name, item in file.items() if isinstance(item, h5py.Group))


def _text(value: str) -> Any:
    # Characters, not an HDF5 string object, wherever ASCII allows it: CF checkers and old readers ask for them.
    return np.bytes_(value) if value.isascii() and value else value


def _write_attributes(owner: Any, attributes: Mapping[str, Any]) -> None:
    target = owner.attrs
    for name, value in attributes.items():
        target[name] = _text(value) if isinstance(value, str) else value


def write_global_attributes(file: Any, attributes: Mapping[str, Any]) -> None:
    """Write what every file of results says of itself, and more.

    attributes: The rest; what is neither text nor number is written as JSON.
    """
    own = {"heliogauge_schema": np.int32(SLOPE_MAP_SCHEMA), "software": "heliogauge", "software_version": __version__}
    _write_attributes(file, {"Conventions": "CF-1.11", **own})
    plain = (str, int, float, np.number)
    for name, value in attributes.items():
        stored = value if isinstance(value, plain) else json.dumps(value)
        if isinstance(stored, str) and len(stored) > _LONGEST_ATTRIBUTE:
            stored = f"sha256 of the whole text: {hashlib.sha256(stored.encode()).hexdigest()} (see summary.json)"
        _write_attributes(file, {name: stored})


def plain_value(value: Any) -> Any:
    """Return an attribute as a Python value; JSON is read.

    value: As HDF5 gives it. xarray and h5netcdf write each number as an array of one.
    Returns: Text, number, list or dict; an array of several as it is.
    ValueError: A text is no UTF-8; no file of ours could hold it.
    """
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    if isinstance(value, bytes):
        value = value.decode("utf-8")
    if isinstance(value, str):
        # h5py hands on bytes that are no UTF-8 as halves of characters.
        value.encode("utf-8")
    if isinstance(value, str) and value[:1] in ("{", "["):
        try:
            content = json.loads(value)
        except (ValueError, RecursionError):
            return value
        json.dumps(content, ensure_ascii=False).encode("utf-8")
        return content
    return value.item() if isinstance(value, np.generic) else value


def stored_values(variable: Any) -> npt.NDArray[Any]:
    """Return the values of a variable; those that another program packed into whole numbers are unpacked."""
    values: npt.NDArray[Any] = variable[...]
    packed = [name for name in ("scale_factor", "add_offset") if name in variable.attrs]
    if not packed:
        return values
    scale, offset = (
        float(plain_value(variable.attrs.get(*one))) for one in (("scale_factor", 1.0), ("add_offset", 0.0))
    )
    unpacked = scale * values.astype(np.float64) + offset
    missing = [plain_value(variable.attrs[name]) for name in ("_FillValue", "missing_value") if name in variable.attrs]
    return np.asarray(np.where(np.isin(values, missing), np.nan, unpacked))


def _write_bare_dimension(group: Any, name: str, size: int) -> Any:
    # The name netCDF-4 gives to a dimension without coordinates, as its format specification wants it.
    scale = group.create_dataset(name, shape=(size,), dtype=">f4", track_order=True)
    scale.make_scale(f"This is a netCDF dimension but not a netCDF variable. {size:9d}")
    return scale


def _write_map(group: Any, slope_map: SlopeMap) -> None:
    scales = []
    for axis, values, text in (("y", slope_map.y_m, "up"), ("x", slope_map.x_m, "to the right")):
        scale = group.create_dataset(axis, data=values, track_order=True)
        scale.make_scale(axis)
        labels = {"units": "m", "axis": axis.upper(), "long_name": f"{axis}, {text}, seen from the front"}
        _write_attributes(scale, labels)
        scales.append(scale)
    for name, attribute, unit, text in _FIELDS:
        values = getattr(slope_map, attribute).astype(np.float32)
        write_variable(group, name, values, scales, {"units": unit, "long_name": text})
    for axis, sigma in zip("xy", slope_map.sigma_slope(), strict=True):
        text = f"standard deviation of slope_{axis}, random and common shares together"
        labels = {"units": "rad", "long_name": text}
        write_variable(group, f"sigma_slope_{axis}", sigma.astype(np.float32), scales, labels)
    _write_flags(group, slope_map.flags, scales)
    aperture = {"flag_values": np.array([0, 1], np.uint8), "flag_meanings": "outside mirror", "units": "1"}
    aperture_bits = slope_map.aperture.astype(np.uint8)
    write_variable(group, "aperture", aperture_bits, scales, {**aperture, "long_name": "node belongs to the mirror"})
    _write_common_modes(group, slope_map.common)
    words = {"design": slope_map.design, "frame": slope_map.frame, "removed": slope_map.removed}
    _write_attributes(
        group,
        {
            **words,
            "measured_share": slope_map.measured_share,
            "noise_correlation": slope_map.noise_correlation,
            "fine_share": slope_map.fine_share,
            "orientation": ORIENTATION,
        },
    )


def write_variable(
    group: Any,
    name: str,
    values: npt.NDArray[Any],
    scales: Sequence[Any],
    attributes: Mapping[str, Any],
    cut_out: CutOut | None = None,
) -> None:
    """Write one variable with its dimensions.

    values: Its values; NaN is missing.
    scales: One dimension scale for each axis.
    attributes: Unit, long name and the like.
    cut_out: Place of the values, where they are a part of the variable.
    """
    is_float = np.issubdtype(values.dtype, np.floating)
    fill = values.dtype.type(np.nan) if is_float else None
    if cut_out is None:
        variable = group.create_dataset(name, data=values, fillvalue=fill, track_order=True)
    else:
        # Of a chunked variable HDF5 stores the chunks that were written; what it reads elsewhere is the fill value.
        blank = values.dtype.type(cut_out.blanks.get(name, 0)) if fill is None else fill
        shape = cut_out.image_shape
        chunks = tuple(min(size, _CHUNK_PIXELS) for size in shape)
        variable = group.create_dataset(
            name, shape=shape, dtype=values.dtype, chunks=chunks, fillvalue=blank, track_order=True
        )
        row, column = cut_out.first_row, cut_out.first_column
        variable[row : row + values.shape[0], column : column + values.shape[1]] = values
    for dimension, scale in zip(variable.dims, scales, strict=True):
        dimension.attach_scale(scale)
    _write_attributes(variable, {"_FillValue": np.array([fill]), **attributes} if is_float else attributes)


def _write_flags(group: Any, flags: npt.NDArray[Any], scales: Sequence[Any], cut_out: CutOut | None = None) -> None:
    attributes = {
        "units": "1",
        "long_name": "why a sample is missing or doubtful; 0 is good",
        "flag_masks": np.array([int(flag) for flag in SampleFlag], dtype=np.uint32),
        "flag_meanings": " ".join(str(flag.name).lower() for flag in SampleFlag),
        "flag_texts": "; ".join(FLAG_TEXTS[flag] for flag in SampleFlag),
    }
    write_variable(group, "flag", flags.astype(np.uint32, copy=False), scales, attributes, cut_out)


def _write_common_modes(group: Any, common: CommonModes) -> None:
    # A NetCDF dimension of length 0 would be an unlimited one: a map without common modes has no such variable.
    count, _, terms = common.coefficients.shape
    if not count:
        return
    sizes = {"common_mode": count, "slope_component": 2, "common_term": terms}
    scales = [_write_bare_dimension(group, name, size) for name, size in sizes.items()]
    attributes = {
        "units": "rad",
        "long_name": "slope change for +1 sigma of each common source, on u**(n-j) * v**j, n = 0 .. degree, j = 0 .. n",
        "variables_of_polynomial": "u = (x - center_x) / scale, v = (y - center_y) / scale",
        "degree": np.int32(common.degree),
        "center_x_m": common.center_m[0],
        "center_y_m": common.center_m[1],
        "scale_m": common.scale_m,
        # JSON and not a list: a source may hold any character.
        "sources": json.dumps(common.sources),
    }
    write_variable(group, "common_coefficients", common.coefficients, scales, attributes)


def _read_map(group: Any, where: str) -> SlopeMap:
    # In NetCDF a group has the dimensions of the one above it: xarray leaves out coordinates that are the same there.
    axes = {name: home[name] for name in "xy" for home in (group.parent, group) if name in home}
    known = {*axes, *group}
    missing = [name for name in ("x", "y", "flag", "aperture", *(row[0] for row in _FIELDS)) if name not in known]
    if missing:
        raise InputError(f"{where}: no slope map, the variables {', '.join(missing)} are missing")
    fields: dict[str, Any] = {
        attribute: stored_values(group[name]) for name, attribute, _, _ in _FIELDS if not name.startswith("slope_error")
    }
    return SlopeMap(
        x_m=stored_values(axes["x"]),
        y_m=stored_values(axes["y"]),
        flags=stored_values(group["flag"]),
        aperture=stored_values(group["aperture"]) != 0,
        noise_correlation=float(plain_value(group.attrs["noise_correlation"])),
        fine_share=np.asarray(group.attrs.get("fine_share", np.zeros(2))),
        common=_read_common_modes(group),
        design=str(plain_value(group.attrs["design"])),
        frame=str(plain_value(group.attrs["frame"])),
        removed=str(plain_value(group.attrs["removed"])),
        **fields,
    )


def _read_common_modes(group: Any) -> CommonModes:
    if "common_coefficients" not in group:
        return no_common_modes()
    variable = group["common_coefficients"]
    center = np.array([plain_value(variable.attrs[name]) for name in ("center_x_m", "center_y_m")])
    sources = tuple(plain_value(variable.attrs["sources"]))
    return CommonModes(sources, stored_values(variable), center, float(plain_value(variable.attrs["scale_m"])))
