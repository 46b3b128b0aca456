"""Pictures of several modules side by side: their maps with one scale of colours."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.reporting.look import extent_of, robust_limit
from heliogauge.validate import BoolArray, FloatArray
from heliogauge.view.still_maps import MapPicture
from heliogauge.view.stills import WIDTH_PX, Sheet
from observer.files import ModuleMap

CHANGES_TITLE = "Change of theta_r against the first orientation, without its mean"
_MRAD = 1e3
#: Maps are not drawn higher [px], and not more of them in a row.
_HIGHEST_PX, _MOST_IN_ROW = 430.0, 3
#: Room beside a map for the names of its axes, and beside the last one for the colours [px].
_BESIDE_PX, _BAR_PX = 78.0, 72.0
_TITLE_PX = 44.0


@dataclass(frozen=True, slots=True, eq=False)
class OneMap:
    """One map of angles beside others.

    name: What it is called.
    x_m, y_m (nx,): Nodes [m].
    angle_rad (ny, nx): The angle; NaN where not measured [rad].
    sigma_rad (ny, nx): Its standard deviation; None where not known [rad].
    """

    name: str
    x_m: FloatArray
    y_m: FloatArray
    angle_rad: FloatArray
    sigma_rad: FloatArray | None = None

    @property
    def aperture(self) -> BoolArray:
        """All nodes: they lie in a rectangle."""
        return np.ones(self.angle_rad.shape, dtype=np.bool_)


def module_angle(one: ModuleMap, angle: str) -> OneMap:
    """Return one angle of a module as it is shown.

    angle: "theta_ra", or "theta_r", which is shown without the module's mean.
    """
    shown = one.theta_ra_rad if angle == "theta_ra" else one.theta_r_rad
    if angle == "theta_r" and np.isfinite(shown).any():
        shown = np.asarray(shown - np.nanmean(shown))
    return OneMap(one.name, one.x_m, one.y_m, shown)


def maps_sheet(maps: Sequence[OneMap], title: str, *, wide: bool = False) -> Sheet:
    """Draw maps of angles beside each other with one scale of colours and one of length.

    wide: As wide as a page; otherwise few maps stand on a narrow sheet, whose letters stay readable beside numbers.
    Returns: x to the right and y up, as seen from the front.
    """
    limit = robust_limit(*(_MRAD * one.angle_rad for one in maps))
    columns = min(len(maps), _MOST_IN_ROW)
    widths, heights = ([extent[k + 1] - extent[k] for extent in map(extent_of, maps)] for k in (0, 2))
    across = 2 * WIDTH_PX if wide else float(np.clip(230 * columns, WIDTH_PX, 2 * WIDTH_PX))
    room = (across - _BAR_PX) / columns - _BESIDE_PX
    px_per_m = min(room / max(widths), _HIGHEST_PX / max(heights))
    step = px_per_m * max(widths) + _BESIDE_PX
    across = max(columns * step + _BAR_PX, WIDTH_PX)
    whole = Sheet(across, _TITLE_PX, (0.0, 0.0, across, 1.0), (0.0, 1.0), (0.0, 1.0))
    whole.title(title, "+ towards +x; seen from the front")
    for number, (one, width) in enumerate(zip(maps, widths, strict=True)):
        shown = _MRAD * one.angle_rad
        rms = f"{float(np.sqrt(np.nanmean(shown**2))):.2f} mrad RMS" if np.isfinite(shown).any() else "not measured"
        is_last = number % columns == columns - 1 or number == len(maps) - 1
        picture = MapPicture(
            title=f"{one.name}: {rms}",
            note="",
            unit="mrad",
            values=shown,
            aperture=one.aperture,
            extent=extent_of(one),
            axis_unit="m",
            low=-limit,
            high=limit,
            diverging=True,
            y_down=False,
        )
        own = px_per_m * width + _BESIDE_PX + (_BAR_PX if is_last else 0.0)
        part = picture.sheet(width=own, tallest_px=np.inf, bar=is_last)
        column = number % columns
        if column == 0:
            top = whole.height
        whole.inset(part, column * step, top)
        whole.height = max(whole.height, top + part.height)
    return whole
