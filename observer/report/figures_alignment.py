"""Pictures of a prescription: the theoretical image of the absorber over a photo, and how far each mount is to move."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from heliogauge.reporting.look import FAINT, INK
from heliogauge.validate import FloatArray
from heliogauge.view.stills import LegendEntry, Sheet, colors_of, fitted_sheet
from observer.trough.collector import Collector

_MRAD, _MM = 1e3, 1e3
#: Letters of the picture stay readable on a page of paper.
_WIDTH_PX, _TALLEST_PX = 900.0, 700.0
_THEORY, _FOUND = "#f2a11f", "#20b2d6"


def theory_sheet(
    image: npt.NDArray[np.uint8],
    name: str,
    edges_px: Sequence[FloatArray],
    found_px: Sequence[FloatArray],
) -> Sheet:
    """Draw the theoretical image of the absorber over a photo (TOP).

    Shapes: image (height, width).
    edges_px (k, 2): Lines along each edge of the image in each panel [px].
    found_px (k, 2): Lines along each edge as it is [px].
    """
    rows, columns = image.shape
    extent = (-0.5, columns - 0.5, rows - 0.5, -0.5)
    sheet = fitted_sheet(extent[:2], extent[2:], width=_WIDTH_PX, tallest_px=_TALLEST_PX, bar=False)
    sheet.title(f"Theoretical image of the absorber in {name}", "where it is, and the mirror as designed")
    sheet.photo(image, extent)
    for line in found_px:
        sheet.line(line[:, 0], line[:, 1], _FOUND, width=1.4)
    for line in edges_px:
        sheet.line(line[:, 0], line[:, 1], _THEORY, width=1.8, dashed=True)
    sheet.axes("column of the part shown [px]", "row [px]", grid=False)
    sheet.legend(
        [
            LegendEntry("edges as they would be with aligned panels", _THEORY, "dashed"),
            LegendEntry("as measured", _FOUND),
        ]
    )
    return sheet


def moves_sheet(
    collector: Collector,
    tilts_rad: FloatArray,
    mounts_m: FloatArray,
    moves: tuple[FloatArray, FloatArray],
    advice: Sequence[str] | None = None,
) -> Sheet:
    """Draw each panel's mean angle to the absorber, and the move of each mount.

    tilts_rad (k,): Mean theta_ra of each panel; NaN where there is no prescription [rad].
    mounts_m (n, 2): x and y of the mounts [m].
    moves (n,): Their moves along the normal, positive towards the absorber, with standard deviations; NaN where
        none [m].
    advice (k,): What to do with each panel, written below its number; None: nobody computed what turns gain.
    Returns: x to the right and y up, as seen from the front.
    """
    x, y = collector.panel_edges_x_m, collector.panel_edges_y_m
    sheet = fitted_sheet((x[0], x[-1]), (y[0], y[-1]), width=_WIDTH_PX, tallest_px=_TALLEST_PX)
    usual = _MM * float(np.nanmedian(moves[1])) if np.isfinite(moves[1]).any() else float("nan")
    note = f"moves of the mounts along the normal [mm], + towards the absorber; sigma {usual:.2f} mm (median)"
    sheet.title("What each mount is to be moved", f"{note}; colours: mean theta_ra of a panel, + towards +x")
    # Half as much again keeps the numbers readable on the strongest colours.
    limit = 1.5 * max(_MRAD * float(np.nanmax(np.abs(tilts_rad), initial=0.0)), 0.1)
    colors = colors_of(_MRAD * tilts_rad, -limit, limit, diverging=True)
    for number, color in enumerate(colors):
        row, column = divmod(number, len(x) - 1)
        left, right, low, high = x[column], x[column + 1], y[row], y[row + 1]
        sheet.area([left, right, right, left], [low, low, high, high], color, edge=FAINT, opacity=0.75)
        middle = float(sheet.place_x((left + right) / 2)), float(sheet.place_y((low + high) / 2))
        sheet.write(middle[0], middle[1] + 5, f"{number + 1}", text_anchor="middle", font_size=15)
        if advice is not None:
            sheet.write(middle[0], middle[1] + 18, advice[number], text_anchor="middle", font_size=10)
    sheet.dots(mounts_m[:, 0], mounts_m[:, 1], [INK], size_px=5.0)
    middles = (x[1:] + x[:-1]) / 2
    for (mount_x, mount_y), move in zip(mounts_m, moves[0], strict=True):
        if np.isfinite(move):
            is_left = mount_x < middles[np.argmin(np.abs(middles - mount_x))]
            place = float(sheet.place_x(mount_x)) + (7 if is_left else -7), float(sheet.place_y(mount_y)) + 4
            words = f"{_MM * move:+.2f}".replace("-", "\u2212")
            sheet.write(*place, words, text_anchor="start" if is_left else "end", font_size=11)
    sheet.axes("x [m], seen from the front", "y [m]", grid=False)
    sheet.color_bar(-limit, limit, "mrad", diverging=True)
    return sheet
