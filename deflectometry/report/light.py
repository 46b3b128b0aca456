"""What a measured mirror does to sunlight: the spot on a target, and the energy within a circle."""

import html
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.reporting.html import Html, beside, join
from heliogauge.reporting.look import FAINT, LINE_X, LINE_Y, thinned_map
from heliogauge.reporting.results import Results
from heliogauge.results.folder import Summary
from heliogauge.slopes.map import no_common_modes
from heliogauge.slopes.statistics import QuadraticFit, fit_quadratic
from heliogauge.sunlight.beam import (
    Illumination,
    SpotImage,
    TargetPlane,
    direction_to_sun_for,
    facing_target,
    trace,
)
from heliogauge.sunlight.sun_shapes import PillboxSun
from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView
from heliogauge.view.maps import MapLayer, MapView

#: 200,000 rays know the radius of 90 % of the energy to 0.1 %, and each of 80 x 80 px of the spot to a tenth.
RAYS = 200_000
SPOT_PIXELS = 80
#: Shares of the energy whose radii are said.
ENERGY_SHARES = (0.5, 0.9, 0.99)


def light(results: Results) -> Html:
    """Return the spot and the energy within a circle; a sentence where the light cannot be traced."""
    try:
        traced = spots(results)
    except EstimationError as error:
        return Html(f"<p>The light was not traced: {html.escape(str(error))}</p>")
    measured = traced["as measured"]
    below = Html(f'<p class="caption">{html.escape(measured.describe())}</p>')
    return join(beside(spot_view(measured), energy_chart(traced)), below)


def spots(results: Results, *, rays: int = RAYS) -> dict[str, SpotImage]:
    """Trace sunlight from the measured mirror, and from its design, to a target in its focus.

    rays: Rays from the measured mirror; the design gets a fifth.

    Sun: a uniform disc of 4.65 mrad half angle, placed so that the middle of the design mirror lights the target's
    centre. Target: ``target_distance_m`` of the summary, or the design's focal length (the shorter of x and y), or
    100 m where that is beyond 1 km.
    """
    # The common uncertainty does not enter the light; carrying it costs more than the rays.
    measured = replace(results.slope_map, common=no_common_modes())
    few = thinned_map(measured)
    design = replace(few, slope_x=few.design_slope_x, slope_y=few.design_slope_y)
    shape = fit_quadratic(design)
    wide = facing_target(_target_distance_m(results.summary, shape), 1.0)
    middle = np.array([float(np.mean(grid[few.aperture])) for grid in np.meshgrid(few.x_m, few.y_m)])
    a, b, c, d, e = shape.coefficients
    normal = (-2 * a * middle[0] - c - e * middle[1], -2 * b * middle[1] - d - e * middle[0], 1.0)
    point = (*middle, _height_m(shape, middle[:1], middle[1:]).item())
    sun = Illumination(PillboxSun(), direction_to_sun_for(wide, normal, point))
    rng = np.random.Generator(np.random.SFC64(1))
    few_height_m = _height_m(shape, few.x_m, few.y_m)
    # A few rays tell where the spot is and how wide: 5 standard deviations on each side hold all but stray light.
    first = trace(few, few_height_m, sun, target=wide, rays=20_000, rng=rng)
    half = float(np.abs(first.center_m).max()) + 5 * max(first.sd_x_m, first.sd_y_m)
    facing = facing_target(wide.distance_m, 2 * half)
    target = TargetPlane(facing.facet_from_target, facing.width_m, facing.height_m, SPOT_PIXELS, SPOT_PIXELS)
    height_m = _height_m(shape, measured.x_m, measured.y_m)
    return {
        "as measured": trace(measured, height_m, sun, target=target, rays=rays, rng=rng),
        "design": trace(design, few_height_m, sun, target=target, rays=max(rays // 5, 1), rng=rng),
    }


def spot_view(spot: SpotImage) -> MapView:
    """Return the flux on the target, for one unit of reflected power."""
    shape = spot.flux_per_m2.shape
    radii = (f"{share:.0%} within {spot.radius_of_share(share):.4g} m" for share in ENERGY_SHARES)
    layer = MapLayer(
        "flux",
        "Sunlight on the target",
        "1/m\u00b2",
        spot.flux_per_m2,
        sigma=spot.sigma_flux_per_m2,
        diverging=False,
        low=0.0,
        limit=float(spot.flux_per_m2.max()) or 1.0,
    )
    return MapView(
        name=f"Sunlight on the target at {spot.distance_m:.4g} m",
        x_m=spot.x_m,
        y_m=spot.y_m,
        layers=(layer,),
        flags=np.zeros(shape, dtype=np.uint32),
        aperture=np.ones(shape, dtype=bool),
        note=f"energy: {', '.join(radii)}; RMS width x {spot.sd_x_m:.4f} m, y {spot.sd_y_m:.4f} m",
    )


def energy_chart(traced: Mapping[str, SpotImage]) -> ChartView:
    """Return the share of the energy within a circle about the spot's centre."""
    first = next(iter(traced.values()))
    share = ENERGY_SHARES[1]
    end = 1.6 * min(max(spot.radius_of_share(share) for spot in traced.values()), float(first.radius_m[-1]))
    series = []
    for (name, spot), color in zip(traced.items(), (LINE_X, LINE_Y, FAINT), strict=False):
        # A thousand radii are more than the eye tells apart.
        kept = np.flatnonzero(spot.radius_m <= end)[::4]
        series.append(ChartSeries(name, spot.radius_m[kept], spot.encircled_share[kept], color))
    note = f"{share:.0%} within {first.radius_of_share(share):.4f} m"
    return ChartView("Energy within a circle", "radius [m]", "share of the energy", tuple(series), note=note)


def _height_m(shape: QuadraticFit, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    a, b, c, d, e = shape.coefficients
    x, y = np.meshgrid(x_m, y_m)
    return np.asarray(a * x**2 + b * y**2 + c * x + d * y + e * x * y)


def _target_distance_m(summary: Summary, shape: QuadraticFit) -> float:
    given = summary.numbers.get("target_distance_m")
    if given is not None:
        return float(given)
    focus = min(abs(shape.focal_length_x_m), abs(shape.focal_length_y_m))
    return focus if focus < 1000 else 100.0
