"""A field of dots to print or to project, as files: dots of two sizes that tell which part of it a mirror shows."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from deflectometry.pipeline.write_patterns import PATTERN_FILE, PATTERNS
from deflectometry.setup.dot_marks import marked_radii
from heliogauge import __version__
from heliogauge.errors import InputError
from heliogauge.images.photos import write_image
from heliogauge.measurement.writer import dump_toml, write_text
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.validate import FloatArray, positive

#: Fewer columns or rows than this are no field; dots nearer to each other than this have sizes of whole pixels.
_FEWEST, _LEAST_PITCH_PX = 8, 8.0


@dataclass(frozen=True, slots=True)
class DotFieldOptions:
    """The field of dots.

    width_px, height_px: Size of the image [px].
    width_mm: Width of the image as it is printed or shown [mm].
    pitch_mm: Distance of two dots there [mm].
    dots: Dark dots on light ground, or light ones on dark.
    """

    width_px: int
    height_px: int
    width_mm: float
    pitch_mm: float
    dots: Literal["dark", "light"] = "dark"


def write_dot_pattern(folder: Path, field: DotFieldOptions, *, force: bool = False) -> tuple[int, int]:
    """Write dots.png, dots.svg, dots.csv and the tables for measurement.toml; the folder is whole or not there.

    Parameters
    ----------
    folder : Path
        Where to write; absent or empty.
    field : DotFieldOptions
        The field.
    force : bool, optional
        Replace earlier patterns.

    Returns
    -------
    tuple of int
        Number of columns and rows.

    Raises
    ------
    InputError
        The folder holds something, or the image has no room for 8 columns and rows of dots 8 px apart.
    """
    px_per_mm = field.width_px / positive("width_mm", field.width_mm, "mm")
    pitch_px = positive("pitch_mm", field.pitch_mm, "mm") * px_per_mm
    size_px = np.array([field.width_px, field.height_px], dtype=np.float64)
    columns, rows = np.floor(size_px / pitch_px).astype(int).tolist()
    if min(columns, rows) < _FEWEST or pitch_px < _LEAST_PITCH_PX:
        raise InputError(
            f"dots {field.pitch_mm:g} mm apart are {pitch_px:.3g} px apart, {columns} columns and {rows} rows of them; "
            f"{_FEWEST} of each and {_LEAST_PITCH_PX:g} px are needed: change pitch_mm or the size of the image"
        )
    column, row = (one.ravel() for one in np.meshgrid(np.arange(columns), np.arange(rows)))
    middle = np.array([0.5 * (columns - 1), 0.5 * (rows - 1)])
    places_px = (np.stack([column, row], axis=1) - middle) * pitch_px + 0.5 * size_px
    radii_px = marked_radii(columns, rows, pitch_px).ravel()
    origin = columns // 2, rows // 2
    to_m = 1e-3 / px_per_mm
    with WholeFolder(folder, PATTERNS, force=force) as working:
        write_image(working / "dots.png", _image(field, places_px, radii_px))
        write_text(working / "dots.svg", _drawing(field, places_px / px_per_mm, radii_px / px_per_mm))
        across, down = ((places_px - 0.5 * size_px) * to_m).T
        table = {"column": column - origin[0], "row": origin[1] - row}
        places = {"x_m": across, "y_m": -down, "z_m": np.zeros(len(column)), "radius_m": radii_px * to_m}
        write_table_csv(working / "dots.csv", table | places)
        content = {
            "screen": {"shape": "dots", "file": "dots.csv"},
            "pattern": {"dots": field.dots, "origin": "unmarked", "marks_file": "dots.csv"},
        }
        text = (
            f"# Field of {columns} x {rows} dots, {field.pitch_mm:g} mm apart; heliogauge {__version__}.\n"
            "# Print dots.svg in its own size, or show dots.png, one image pixel on one display pixel; not mirrored.\n"
            "# The places in dots.csv are those of a flat and exact field: measure the real one (`heliogauge\n"
            "# deflectometry screen geometry`); this table keeps the sizes. Below: for measurement.toml.\n\n"
        )
        write_text(working / PATTERN_FILE, text + dump_toml(content))
    return columns, rows


def _image(field: DotFieldOptions, places_px: FloatArray, radii_px: FloatArray) -> npt.NDArray[np.uint8]:
    """Return the field with soft edges, shape (height_px, width_px).

    places_px (n, 2): Middles from the corner of the image [px].
    """
    cover = np.zeros((field.height_px, field.width_px))
    reach = int(np.ceil(radii_px.max())) + 1
    for (x, y), radius in zip((places_px - 0.5).tolist(), radii_px.tolist(), strict=True):
        left, top = max(round(x) - reach, 0), max(round(y) - reach, 0)
        part = cover[top : round(y) + reach + 1, left : round(x) + reach + 1]
        rows, columns = np.ogrid[: part.shape[0], : part.shape[1]]
        part += np.clip(radius - np.hypot(columns + left - x, rows + top - y) + 0.5, 0.0, 1.0)
    light = cover if field.dots == "light" else 1.0 - cover
    return np.rint(255.0 * light).astype(np.uint8)


def _drawing(field: DotFieldOptions, places_mm: FloatArray, radii_mm: FloatArray) -> str:
    """Return the field as a drawing to print, in millimetres from its upper left corner."""
    height_mm = field.width_mm * field.height_px / field.width_px
    ground, dot = ("white", "black") if field.dots == "dark" else ("black", "white")
    circles = "\n".join(
        f'<circle cx="{x:.4f}" cy="{y:.4f}" r="{radius:.4f}"/>'
        for (x, y), radius in zip(places_mm.tolist(), radii_mm.tolist(), strict=True)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{field.width_mm:g}mm" height="{height_mm:g}mm" '
        f'viewBox="0 0 {field.width_mm:g} {height_mm:g}">\n<rect width="100%" height="100%" fill="{ground}"/>\n'
        f'<g fill="{dot}">\n{circles}\n</g>\n</svg>\n'
    )
