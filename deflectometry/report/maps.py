"""Maps and charts of the mirror: slopes, shape, distribution, sections, and what the camera saw."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.reporting.html import Html, wrap
from heliogauge.reporting.look import LINE_X, LINE_Y, robust_limit
from heliogauge.reporting.results import Results
from heliogauge.slopes.grid import curl, curvature
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.slopes.normal_angles import normal_angles
from heliogauge.validate import BoolArray, FloatArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.maps import MapLayer, MapView, slope_map_view

MRAD = 1e3
_COLORS = {"x": LINE_X, "y": LINE_Y}


def slope_view(results: Results) -> MapView:
    """Return the map of the mirror with all its layers."""
    return slope_map_view(results.slope_map, results.summary.name)


def facet_views(results: Results) -> Html:
    """Return the map of each facet at its own place in the page; nothing for a single facet."""
    views = [
        wrap(f'<div id="{facet_mark(number)}">', [slope_map_view(one, name)], "</div>")
        for number, (name, one) in enumerate(results.facets.items(), start=1)
    ]
    return wrap("<h2>Facets one by one</h2>" if views else "", views, "")


def facet_mark(number: int) -> str:
    """Return the place in the page of a facet, counted from 1."""
    return f"facet-{number}"


def shape_view(slope_map: SlopeMap) -> MapView:
    """Return shape and self-check: what a quadratic surface leaves, curvatures, and the curl over its sigma."""
    bare = replace(slope_map, common=no_common_modes())
    curvatures = [one.value_per_m for one in curvature(bare)]
    turned = curl(slope_map)
    ratio = np.divide(
        turned.value_per_m, turned.sigma_per_m, out=np.full(slope_map.shape, np.nan), where=turned.sigma_per_m > 0
    )
    layers = [
        MapLayer(f"curvature_{axis}", f"Curvature in {axis} minus its mean", "mrad/m", one - _mean(one), MRAD)
        for axis, one in zip("xy", curvatures, strict=True)
    ]
    layers.append(MapLayer("curl", "Curl over its sigma", "sigma", ratio, limit=4.0))
    if np.isfinite(slope_map.height_m).any():
        deviation = height_deviation_m(slope_map)
        layers.insert(0, MapLayer("height_deviation", "Height minus best-fit quadratic", "\u00b5m", deviation, 1e6))
    return MapView(
        name="Shape and self-check",
        x_m=slope_map.x_m,
        y_m=slope_map.y_m,
        layers=tuple(layers),
        flags=slope_map.flags,
        aperture=slope_map.aperture,
        note="A real surface has no curl: a pattern beyond 3 sigma is an error that the sigma does not know.",
    )


def height_deviation_m(slope_map: SlopeMap) -> FloatArray:
    """Return the height minus its best-fit quadratic [m]."""
    x, y = np.meshgrid(*(axis / max(float(np.abs(axis).max()), 1e-9) for axis in (slope_map.x_m, slope_map.y_m)))
    known = np.isfinite(slope_map.height_m)
    chosen = np.stack([one[known] for one in (np.ones_like(x), x, y, x**2, x * y, y**2)], axis=1)
    deviation = np.full(slope_map.shape, np.nan)
    if len(chosen) > chosen.shape[1]:
        heights = slope_map.height_m[known]
        # Normal equations: 1 s quicker for a million nodes, and 6 terms of scaled coordinates are harmless.
        deviation[known] = heights - chosen @ np.linalg.lstsq(chosen.T @ chosen, chosen.T @ heights, rcond=None)[0]
    return deviation


def distribution_chart(slope_map: SlopeMap) -> ChartView:
    """Return the distribution of the angles of the normal from the design's, in x and in y."""
    slopes = slope_map.slope_x, slope_map.slope_y, slope_map.design_slope_x, slope_map.design_slope_y
    angles = [MRAD * one for one in normal_angles(*(one[slope_map.valid] for one in slopes))]
    limit = 1.25 * robust_limit(*angles)
    bins = np.linspace(-limit, limit, 81)
    series, notes = [], []
    for axis, values in zip("xy", angles, strict=True):
        counts, _ = np.histogram(values, bins)
        density = counts / max(values.size, 1) / np.diff(bins)
        series.append(ChartSeries(axis, 0.5 * (bins[1:] + bins[:-1]), density, _COLORS[axis], Mark.STEPS))
        notes.append(f"{axis}: mean {_mean(values):+.3f}, RMS {_rms(values):.3f} mrad")
    return ChartView(
        "Distribution of the angle from the design",
        "angle of the normal [mrad]",
        "share of the nodes per mrad",
        tuple(series),
        note="; ".join(notes),
    )


def section_chart(slope_map: SlopeMap, axis: str) -> ChartView:
    """Return the slope errors along the middle row (axis x) or column (axis y) with their sigma."""
    along, across = (slope_map.x_m, slope_map.y_m) if axis == "x" else (slope_map.y_m, slope_map.x_m)
    counts = np.count_nonzero(slope_map.valid, axis=1 if axis == "x" else 0)
    full = np.flatnonzero(counts >= 0.5 * counts.max())
    index = int(full[np.argmin(np.abs(full - 0.5 * (full[0] + full[-1])))])
    cut: Any = (index, slice(None)) if axis == "x" else (slice(None), index)
    here = np.full(along.size, across[index])
    common = slope_map.common.evaluate(*((along, here) if axis == "x" else (here, along)))
    errors = (slope_map.slope_error_x, slope_map.slope_error_y)
    randoms = (slope_map.sigma_random_x, slope_map.sigma_random_y)
    series = []
    for number, (name, color) in enumerate(_COLORS.items()):
        line = np.where(slope_map.valid, errors[number], np.nan)[cut] * MRAD
        sigma = np.sqrt(randoms[number][cut] ** 2 + np.sum(common[:, number] ** 2, axis=0)) * MRAD
        series.append(ChartSeries(f"slope error in {name}", along, line, color, sigma=sigma))
    other = "y" if axis == "x" else "x"
    note = f"at {other} = {across[index]:.3f} m, through the middle; bands: 1 sigma"
    return ChartView(f"Section along {axis}", f"{axis} [m]", "slope error [mrad]", tuple(series), note=note)


def image_view(results: Results) -> MapView | Html:
    """Return what the camera saw: contrast, disagreement of the frames, points on the screen.

    Returns: A map over the part of the image that was seen; a sentence where there are no per-pixel results.
    """
    layers = _image_layers(results.pixels)
    if not layers:
        return Html("<p>The folder holds no per-pixel results.</p>")
    rows, columns = seen_part(np.isfinite(layers[0].values))
    cut = tuple(replace(one, values=one.values[rows, columns]) for one in layers)
    seen = np.isfinite(cut[0].values)
    flags = results.pixels.get("flag")
    return MapView(
        name="What the camera saw",
        x_m=np.arange(columns.start, columns.stop, dtype=np.float64),
        y_m=np.arange(rows.start, rows.stop, dtype=np.float64),
        layers=cut,
        flags=np.zeros(seen.shape, np.uint32) if flags is None else flags[rows, columns].astype(np.uint32),
        aperture=seen if flags is None else seen | (flags[rows, columns] != 0),
        axis_unit="px",
        y_down=True,
    )


def _image_layers(pixels: Mapping[str, npt.NDArray[Any]]) -> Sequence[MapLayer]:
    every = (
        ("modulation_dn", "Contrast of the fringes", "DN", 0.0, None),
        ("residual_dn", "Disagreement of the frames", "DN", 0.0, None),
        ("u", "Point on the screen, u from the left", "", 0.0, 1.0),
        ("v", "Point on the screen, v from the top", "", 0.0, 1.0),
    )
    return [
        MapLayer(key, name, unit, pixels[key].astype(np.float64), diverging=False, low=low, limit=limit)
        for key, name, unit, low, limit in every
        if key in pixels
    ]


def seen_part(seen: BoolArray) -> tuple[slice, slice]:
    """Return the rows and columns that hold everything seen, with a margin of a twentieth."""
    parts = []
    for axis, size in ((1, seen.shape[0]), (0, seen.shape[1])):
        lines = np.flatnonzero(seen.any(axis=axis))
        first, last = (int(lines[0]), int(lines[-1])) if lines.size else (0, size - 1)
        margin = 2 + (last - first) // 20
        parts.append(slice(max(first - margin, 0), min(last + margin + 1, size)))
    return parts[0], parts[1]


def _mean(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if finite.size else 0.0


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
