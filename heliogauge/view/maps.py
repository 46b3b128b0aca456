"""Maps to look into: values with sigma and flag under the pointer, sections, colours, tilt and focus removed live."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.files.extras import of_extra
from heliogauge.flags import FLAG_TEXTS, REJECTED, SampleFlag
from heliogauge.instruments import near_match
from heliogauge.reporting.html import Html
from heliogauge.reporting.look import FAINT, INK, extent_of, nice_ceiling, robust_limit, thinned
from heliogauge.reporting.notation import number_text
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Patterns, Removal, fit_removals, measured_nodes
from heliogauge.slopes.statistics import SlopeStatistics, statistics
from heliogauge.validate import BoolArray, FlagArray, FloatArray
from heliogauge.view.arrays import PAGE, ArrayStore, reading_step
from heliogauge.view.markup import view_frame
from heliogauge.view.still_maps import MapPicture
from heliogauge.view.stills import side_by_side

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MRAD = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class MapLayer:
    """One quantity on the grid of a map.

    key: Short name, unique in the map ("slope_error_x").
    name: What the reader sees.
    unit: Unit of the printed values.
    factor: Printed value for a stored value of one.
    values (ny, nx): Values in stored units; NaN where there is none.
    sigma (ny, nx): Their standard deviations in stored units; None where there are none.
    diverging: Colours symmetric about zero; otherwise from the smallest to the largest value.
    limit: Where the colours end, in the printed unit; None: `robust_limit`, from `low` upwards where not diverging.
    low: Where sequential colours begin, in the printed unit; None: the smallest value.
    """

    key: str
    name: str
    unit: str
    values: FloatArray
    factor: float = 1.0
    sigma: FloatArray | None = None
    diverging: bool = True
    limit: float | None = None
    low: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RemovedPart:
    """What one removal takes out of the slope errors of a map, and the statistics without it.

    removal: Nothing, tilt, focus or quadratic.
    coefficients (2, 4): Slope error in x and in y that is taken out, on the terms 1, x - x_middle, y - y_middle,
        design slope - its mean.
    statistics: SDx, SDy, SD of what is left, from all measured nodes.
    """

    removal: Removal
    coefficients: FloatArray
    statistics: SlopeStatistics


@dataclass(frozen=True, slots=True, eq=False)
class Removals:
    """What may be taken out of the two slope errors of a map.

    layer_x, layer_y: Keys of the layers with the slope errors.
    magnitude: Key of the layer with the root of the sum of their squares; empty where there is none.
    name: What the slope errors are of; empty where the map has one set only.
    middle_m (2,): Mean place of the measured nodes [m].
    design_x, design_y (ny, nx): Slopes of the design.
    design_mean (2,): Their means over the measured nodes.
    parts: One for each removal that the measured nodes determine.
    """

    layer_x: str
    layer_y: str
    magnitude: str
    name: str
    middle_m: FloatArray
    design_x: FloatArray
    design_y: FloatArray
    design_mean: FloatArray
    parts: tuple[RemovedPart, ...]


class MapMark(NamedTuple):
    """A place on a map with what is to be known there.

    place: x and y in the unit of the axes.
    text: A few signs that stand beside its dot where there is room.
    words: What is said when the pointer is at it.
    """

    place: tuple[float, float]
    text: str
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class MapRegions:
    """Parts of a map that have names, such as facets.

    index (ny, nx): Number of the part that each node belongs to, from 0; 255: none.
    names: At most 255.
    """

    index: npt.NDArray[np.uint8]
    names: Sequence[str]


@dataclass(frozen=True, eq=False)
class MapView:
    """Quantities on one grid, x to the right, in equal proportions: a mirror from the front, or the image of a camera.

    name: What the map shows.
    x_m (nx,), y_m (ny,): Columns and rows of the grid, ascending, in `axis_unit` [m].
    layers: Quantities; the first is shown at first.
    flags (ny, nx): Bits of `heliogauge.flags.SampleFlag`.
    aperture (ny, nx): Nodes that belong to the mirror, measured or not.
    removals: What may be taken out of slope errors; empty for maps of other quantities.
    note: A line under the map.
    axis_unit: Unit of columns and rows: "m", or "px" for maps over an image.
    axis_names: What columns and rows are.
    y_down: y grows downwards, as in images; otherwise upwards.
    lines: Vertices of thin lines over the map, such as edges of panels, shape (n, 2) each, in `axis_unit`.
    arrows (n, 2, 2): Foot and tip of arrows over the map, in `axis_unit`.
    marks: Dots with words over the map.
    regions: Names of its parts, said with the value under the pointer; None: it has none.
    stills: Still pictures that stand for it in notebook and print; empty: drawn here.
    InputError: Sizes do not fit, or two layers have one key.
    """

    name: str
    x_m: FloatArray
    y_m: FloatArray
    layers: tuple[MapLayer, ...]
    flags: FlagArray
    aperture: BoolArray
    removals: tuple[Removals, ...] = ()
    note: str = ""
    axis_unit: str = "m"
    axis_names: tuple[str, str] = ("x", "y")
    y_down: bool = False
    lines: Sequence[FloatArray] = ()
    arrows: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))
    marks: Sequence[MapMark] = ()
    regions: MapRegions | None = None
    stills: Sequence[Html] = ()

    def __post_init__(self) -> None:
        shape = (self.y_m.size, self.x_m.size)
        arrays: dict[str, npt.NDArray[Any]] = {"flags": self.flags, "aperture": self.aperture}
        arrays |= {} if self.regions is None else {"regions": self.regions.index}
        arrays |= {layer.key: layer.values for layer in self.layers}
        arrays |= {f"sigma of {layer.key}": layer.sigma for layer in self.layers if layer.sigma is not None}
        for name, array in arrays.items():
            if array.shape != shape:
                raise InputError(f"map {self.name}: {name} has the shape {array.shape}, the grid {shape}")
        if len({layer.key for layer in self.layers}) != len(self.layers) or not self.layers:
            raise InputError(f"map {self.name}: layers with different keys are needed, not {len(self.layers)}")

    @cached_property
    def static(self) -> Html:
        """The still pictures, drawn once."""
        return side_by_side(self.stills or [self._still(one) for one in self.layers[:2]], caption=self.note)

    def layer_still(self, key: str) -> Html:
        """Draw the still picture of one layer."""
        return self._still(next(layer for layer in self.layers if layer.key == key))

    def figure(self, quantity: str | None = None) -> "Figure":
        """Draw one layer.

        quantity: Its key; the first layer without it.
        InputError: There is no such layer, or matplotlib is not installed.
        """
        of_extra("matplotlib")
        from heliogauge.reporting.canvas import MapStyle, map_figure

        layers = {layer.key: layer for layer in self.layers}
        layer = self.layers[0] if quantity is None else layers.get(quantity)
        if layer is None:
            raise InputError(
                f"map {self.name}: quantity {quantity!r} is not in it; {near_match(str(quantity), layers)}"
            )
        low, limit = _colors(layer)
        style = MapStyle(layer.name, layer.unit, layer.factor, layer.diverging, limit, low)
        figure = map_figure(self, layer.values, style)
        for line in self.lines:
            figure.axes[0].plot(*np.asarray(line).T, color=FAINT, linewidth=0.5, zorder=5)
        for foot, tip in self.arrows:
            figure.axes[0].annotate("", tip, foot, arrowprops={"arrowstyle": "->", "color": INK}, zorder=6)
        for one in self.marks:
            figure.axes[0].plot(*one.place, ".", color=INK, markersize=3, zorder=6)
        return figure

    def _still(self, layer: MapLayer) -> Html:
        low, high = _colors(layer)
        shown = thinned(layer.values) * layer.factor
        known = shown[np.isfinite(shown)]
        beyond = float(np.mean((known > high) | (known < low))) if known.size else 0.0
        ends = f", {beyond:.1%} beyond the colours" if beyond >= 0.001 else ""
        note = f"{known.min():.3g} to {known.max():.3g} {layer.unit}{ends}" if known.size else "no value anywhere"
        if layer.diverging and known.size:
            note = f"RMS {float(np.sqrt(np.mean(known**2))):.4g} {layer.unit}; {note}"
        picture = MapPicture(
            title=layer.name,
            note=note,
            unit=layer.unit,
            values=shown,
            aperture=thinned(self.aperture),
            extent=extent_of(self),
            axis_unit=self.axis_unit,
            axis_names=self.axis_names,
            low=low,
            high=high,
            diverging=layer.diverging,
            y_down=self.y_down,
            lines=self.lines,
            arrows=self.arrows,
            marks=[(*one.place, one.text) for one in self.marks],
        )
        return picture.still()

    def _repr_html_(self) -> str:
        return self.static.text

    def page_html(self, store: ArrayStore = PAGE) -> str:
        """Return the view for a page."""
        return view_frame("map", self.name, self._spec(store), self.static)

    def _spec(self, store: ArrayStore) -> dict[str, Any]:
        most = store.most_nodes
        kept: dict[int, dict[str, Any]] = {}

        def keep(array: FloatArray) -> dict[str, Any]:
            # The sigma of a layer is often a layer itself: packed once.
            if id(array) not in kept:
                few = thinned(array, most)
                kept[id(array)] = {"place": len(kept), "array": store.numbers(few, reading_step(few))}
            return {"place": kept[id(array)]["place"]}

        layers = []
        for layer in self.layers:
            low, limit = _colors(layer)
            words = {"key": layer.key, "name": layer.name, "unit": layer.unit, "factor": layer.factor}
            colors = {"diverging": layer.diverging, "low": low, "high": limit}
            sigma = None if layer.sigma is None else keep(layer.sigma)
            layers.append({**words, **colors, "values": keep(layer.values), "sigma": sigma})
        removals = [
            {
                "x": one.layer_x,
                "y": one.layer_y,
                "magnitude": one.magnitude,
                "name": one.name,
                "middle": one.middle_m.tolist(),
                "mean": one.design_mean.tolist(),
                "design": [keep(one.design_x), keep(one.design_y)],
                "parts": [_part(part) for part in one.parts],
            }
            for one in self.removals
        ]
        codes, words_of_codes = _flag_codes(thinned(self.flags, most))
        return {
            "name": self.name,
            "note": self.note,
            "axis_unit": self.axis_unit,
            "axis_names": list(self.axis_names),
            "y_down": self.y_down,
            "x": thinned(self.x_m[None, :], most)[0].tolist(),
            "y": thinned(self.y_m[:, None], most)[:, 0].tolist(),
            "nodes": [self.x_m.size, self.y_m.size],
            "layers": layers,
            "removals": removals,
            "flags": store.codes(codes),
            "reasons": words_of_codes,
            "aperture": store.codes(thinned(self.aperture, most)),
            "lines": [np.asarray(line).tolist() for line in self.lines],
            "arrows": self.arrows.tolist(),
            "marks": [one._asdict() for one in self.marks],
            "regions": None
            if self.regions is None
            else {"index": store.codes(thinned(self.regions.index, most)), "names": list(self.regions.names)},
            "arrays": [one["array"] for one in kept.values()],
        }


def slope_map_view(slope_map: SlopeMap, name: str) -> MapView:
    """Return everything that a slope map holds as a view: errors, slopes, height, sigmas, flags.

    name: What the map shows.
    """
    valid = slope_map.valid
    sigma_x, sigma_y = (np.where(valid, one, np.nan) for one in slope_map.sigma_slope())
    errors = [np.where(valid, one, np.nan) for one in (slope_map.slope_error_x, slope_map.slope_error_y)]
    limit = robust_limit(*(thinned(one) * MRAD for one in errors))
    layers = [
        MapLayer("slope_error_x", "Slope error in x", "mrad", errors[0], MRAD, sigma_x, limit=limit),
        MapLayer("slope_error_y", "Slope error in y", "mrad", errors[1], MRAD, sigma_y, limit=limit),
        MapLayer("slope_error", "Slope error, magnitude", "mrad", np.hypot(*errors), MRAD, diverging=False, low=0.0),
        MapLayer("slope_x", "Slope dz/dx", "mrad", np.where(valid, slope_map.slope_x, np.nan), MRAD, sigma_x),
        MapLayer("slope_y", "Slope dz/dy", "mrad", np.where(valid, slope_map.slope_y, np.nan), MRAD, sigma_y),
        MapLayer("sigma_slope_x", "Sigma of slope x", "\u00b5rad", sigma_x, 1e6, diverging=False, low=0.0),
        MapLayer("sigma_slope_y", "Sigma of slope y", "\u00b5rad", sigma_y, 1e6, diverging=False, low=0.0),
    ]
    if np.isfinite(slope_map.height_m).any():
        layers.insert(5, MapLayer("height", "Height", "mm", slope_map.height_m, 1e3, diverging=False))
    for axis, design in (("x", slope_map.design_slope_x), ("y", slope_map.design_slope_y)):
        layers.append(MapLayer(f"design_slope_{axis}", f"Design slope dz/d{axis}", "mrad", design, MRAD))
    # A trough measured across its axis alone has one slope.
    layers = [layer for layer in layers if np.isfinite(layer.values).any()] or layers[:1]
    removals = slope_removals(slope_map, magnitude="slope_error")
    return MapView(
        name=name,
        x_m=slope_map.x_m,
        y_m=slope_map.y_m,
        layers=tuple(layers),
        flags=slope_map.flags,
        aperture=slope_map.aperture,
        removals=(removals,) if removals.parts else (),
    )


def slope_removals(
    slope_map: SlopeMap,
    *,
    layer_x: str = "slope_error_x",
    layer_y: str = "slope_error_y",
    magnitude: str = "",
    name: str = "",
) -> Removals:
    """Prepare what may be taken out of a map, each with its statistics.

    layer_x, layer_y: Keys of the layers with the slope errors.
    magnitude: Key of the layer with their magnitude; empty where there is none.
    name: What the slope errors are of.
    """
    parts: list[RemovedPart] = []
    middle, means = np.zeros(2), np.zeros(2)
    try:
        nodes = measured_nodes(slope_map)
        patterns = Patterns.of(nodes)
        middle, means = patterns.middle_m, patterns.middle_design
        for removal in Removal:
            (fit,) = fit_removals(nodes, patterns, [removal])
            if np.isfinite(fit.amounts).all():  # not where one of the two slopes was never measured
                coefficients = _coefficients(fit.amounts, patterns.is_flat)
                parts.append(RemovedPart(removal, coefficients, statistics(slope_map, removed=removal)))
    except EstimationError:
        # Too few nodes, or all on a line: what is determined is offered.
        pass
    return Removals(
        layer_x,
        layer_y,
        magnitude,
        name,
        middle,
        slope_map.design_slope_x,
        slope_map.design_slope_y,
        means,
        tuple(parts),
    )


def _coefficients(amounts: FloatArray, flat: bool) -> FloatArray:
    """Return the removed slopes on the terms 1, x, y, design, shape (2, 4)."""
    terms = np.zeros((2, 4))
    terms[:, 0] = amounts[:2] if amounts.size else 0.0
    if amounts.size == 5:
        terms[0, 1:3] = amounts[2], amounts[4]
        terms[1, 1:3] = amounts[4], amounts[3]
    elif amounts.size == 3 and flat:
        terms[0, 1] = terms[1, 2] = 0.5 * amounts[2]
    elif amounts.size == 3:
        terms[:, 3] = amounts[2]
    return terms


def _part(part: RemovedPart) -> dict[str, Any]:
    values = part.statistics
    shown = (("SDx", values.sdx_rad, values.sigma_sdx_rad), ("SDy", values.sdy_rad, values.sigma_sdy_rad))
    numbers = (*shown, ("SD", values.sd_rad, values.sigma_sd_rad))
    return {
        "removal": part.removal.value,
        "terms": part.coefficients.tolist(),
        "numbers": [[name, number_text(value, sigma, "rad")] for name, value, sigma in numbers if np.isfinite(value)],
        "removed": values.removed,
        "reference": values.reference,
    }


def _colors(layer: MapLayer) -> tuple[float, float]:
    """Return where the colours of a layer begin and end, in the printed unit."""
    shown = thinned(layer.values) * layer.factor
    finite = shown[np.isfinite(shown)]
    if layer.diverging:
        limit = robust_limit(shown) if layer.limit is None else layer.limit
        return -limit, limit
    if layer.low == 0.0:
        return 0.0, robust_limit(shown) if layer.limit is None else layer.limit
    low, high = np.percentile(finite, (0.5, 99.5)).tolist() if finite.size else (0.0, 1.0)
    low = low if layer.low is None else layer.low
    high = high if layer.limit is None else layer.limit
    return low, high if high > low else low + nice_ceiling(abs(low) * 1e-3)


def _flag_codes(flags: FlagArray) -> tuple[FlagArray, list[dict[str, Any]]]:
    """Return a small number for each combination of flags, and what each stands for."""
    combinations, codes = np.unique(flags, return_inverse=True)
    counts = np.bincount(codes.ravel())
    # Beyond 255 combinations the rarest share the last number; in practice there are fewer than 30.
    order = np.argsort(-counts, kind="stable")
    rank = np.empty(order.size, dtype=np.uint32)
    rank[order] = np.minimum(np.arange(order.size), 255)
    reasons = []
    for bits in combinations[order][:256].tolist():
        words = [FLAG_TEXTS[flag] for flag in SampleFlag if bits & flag]
        reasons.append({"bits": bits, "words": words, "rejected": bool(bits & REJECTED)})
    return rank[codes].reshape(flags.shape), reasons
