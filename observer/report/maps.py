"""Maps of a trough in its report: angles, uncertainty and what was not measured."""

import numpy as np

from heliogauge.reporting.html import Html, join, table
from heliogauge.reporting.look import INK, LINE_X, LINE_Y, robust_limit
from heliogauge.reporting.uncertainty import uncertainty_shares
from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.maps import MapLayer, MapMark, MapView, Removals, slope_removals
from heliogauge.view.still_maps import flag_still
from heliogauge.view.stills import side_by_side
from observer.report.results import TroughResults
from observer.trough.collector import Collector

_MRAD = 1e3
#: What the angles are of, by their names in angles.nc.
_ANGLES = {"theta_r": "mirror alone", "theta_ra": "mirror and absorber", "theta_a": "absorber alone"}


def mirror_view(results: TroughResults) -> MapView:
    """Return all that is known of the mirror as a map; theta_r is shown at first."""
    slope_map = results.base.slope_map
    valid = slope_map.valid
    found = {name: np.where(valid, values, np.nan) for name, values in results.angles.items()}
    limit = _limit(results)
    layers = [
        MapLayer(
            name,
            f"{name} (+ to +x): {words}",
            "mrad",
            found[name],
            _MRAD,
            found[f"sigma_{name}"],
            limit=None if name == "theta_a" else limit,
        )
        for name, words in _ANGLES.items()
    ]
    sigma_x, sigma_y = (np.where(valid, one, np.nan) for one in slope_map.sigma_slope())
    layers.append(
        MapLayer(
            "slope_error_x",
            "Slope error dz/dx",
            "mrad",
            np.where(valid, slope_map.slope_error_x, np.nan),
            _MRAD,
            sigma_x,
        )
    )
    removals: tuple[Removals, ...] = ()
    along = np.where(valid, slope_map.slope_error_y, np.nan)
    if np.isfinite(along).any():
        # It takes passes at different places along the trough.
        layers.append(MapLayer("slope_error_y", "Slope error dz/dy", "mrad", along, _MRAD, sigma_y))
        if np.isfinite(along[valid]).all():
            removals = tuple(one for one in (slope_removals(slope_map),) if one.parts)
    layers += [
        MapLayer(
            f"sigma_{name}", f"Uncertainty of {name} (1 sigma)", "mrad", found[f"sigma_{name}"], _MRAD, None, False
        )
        for name in ("theta_r", "theta_ra")
    ]
    if np.isfinite(slope_map.height_m).any():
        x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
        departure = slope_map.height_m - results.collector.surface.height(x, y)
        layers.append(MapLayer("height", "Height of the mirror minus design", "mm", departure, 1e3))
    return MapView(
        "Mirror",
        slope_map.x_m,
        slope_map.y_m,
        tuple(layers),
        slope_map.flags,
        slope_map.aperture,
        removals,
        "Positive where the mirror's normal is turned towards +x. Grey: not measured. Numbers: panels.",
        lines=panel_lines(results.collector),
        marks=panel_marks(results.collector),
        stills=[] if valid.any() else [_reasons(results)],
    )


def _reasons(results: TroughResults) -> Html:
    """Draw why parts of the mirror have no value."""
    return flag_still(results.base.slope_map, panel_lines(results.collector))


def maps(results: TroughResults) -> Html:
    """Return the maps beside the first one, the distribution of the angles, and where their uncertainty comes from."""
    slope_map = results.base.slope_map
    if not slope_map.valid.any():
        return Html("<p>No point of the mirror was measured.</p>")
    view = mirror_view(results)
    drawn = [*map(view.layer_still, ("theta_a", "sigma_theta_r")), _reasons(results)]
    note = (
        'What the sun meets is theta_ra = theta_r + theta_a, all across the trough. "+ to +x": positive where the '
        "mirror's normal is turned towards +x. "
        "slope_map.nc holds dz/dx, whose sign is the opposite: theta_r = atan(design slope) - atan(measured slope). "
        "Thin lines: edges of the panels and receiver supports."
    )
    return side_by_side(drawn, caption=note)


def spread(results: TroughResults) -> Html:
    """Return the distribution of the angles, and where their uncertainty comes from."""
    if not results.base.slope_map.valid.any():
        return Html("")
    return join(histogram(results), _shares(results))


def _limit(results: TroughResults) -> float:
    """Return where the colours of theta_ra and theta_r end [mrad]."""
    return robust_limit(*(_MRAD * results.angles[name] for name in ("theta_ra", "theta_r")))


def _shares(results: TroughResults) -> Html:
    """Return where the uncertainty of the slopes comes from."""
    shares = uncertainty_shares(results.base.slope_map)
    rows = [(name, f"{_MRAD * across:.4f} mrad") for name, (across, _) in shares.items()]
    return table(("uncertainty of theta_r, RMS over the mirror", "1 sigma"), rows, numbers=(1,))


def histogram(results: TroughResults) -> ChartView:
    """Return the distributions of theta_ra and theta_r, and the normal distribution of the width of theta_r."""
    valid = results.base.slope_map.valid
    both = {name: _MRAD * results.angles[name][valid] for name in ("theta_r", "theta_ra")}
    limit = robust_limit(*both.values())
    mean, width = float(both["theta_r"].mean()), float(both["theta_r"].std())
    bins = np.linspace(-1.25 * limit, 1.25 * limit, 81)
    middles = 0.5 * (bins[1:] + bins[:-1])
    series = []
    for (name, values), (color, mark) in zip(both.items(), ((LINE_X, Mark.BARS), (LINE_Y, Mark.STEPS)), strict=True):
        density = np.histogram(values, bins)[0] / max(values.size, 1) / np.diff(bins)
        series.append(ChartSeries(name, middles, density, color, mark))
    if width > 0:
        normal = np.exp(-0.5 * ((middles - mean) / width) ** 2) / (width * np.sqrt(2 * np.pi))
        series.append(ChartSeries("normal, as wide as theta_r", middles, normal, INK))
    return ChartView(
        "Distribution of theta_r and theta_ra",
        "angle [mrad], + towards +x",
        "share of the nodes per mrad",
        tuple(series),
        f"theta_r: mean {mean:+.3f} mrad, standard deviation {width:.3f} mrad",
    )


def panel_marks(collector: Collector) -> tuple[MapMark, ...]:
    """Return the numbers of the panels, as tables have them; none for a mirror of one panel."""
    x, y = collector.panel_edges_x_m, collector.panel_edges_y_m
    middles = [(float(one), float(other)) for other in (y[1:] + y[:-1]) / 2 for one in (x[1:] + x[:-1]) / 2]
    if len(middles) == 1:
        return ()
    return tuple(MapMark(place, f"{number}", f"panel {number}") for number, place in enumerate(middles, start=1))


def panel_lines(collector: Collector) -> tuple[FloatArray, ...]:
    """Return the edges between panels and the supports as lines on the mirror, of shape (2, 2) each [m]."""
    x, y = collector.panel_edges_x_m, collector.panel_edges_y_m
    across = [np.array([[x[0], one], [x[-1], one]]) for one in (*y[1:-1], *_inner_supports(collector))]
    return (*(np.array([[one, y[0]], [one, y[-1]]]) for one in x[1:-1]), *across)


def _inner_supports(collector: Collector) -> list[float]:
    return [float(y) for y in collector.support_y_m if abs(y) < collector.length_m / 2 - 0.01]
