"""Parts of a report that need some work before they can be drawn: the traced spot, images, the setup."""

import html
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from heliogauge.reporting.canvas import MapStyle, thinned_map
from heliogauge.reporting.html import Html, show
from heliogauge.reporting.image_figures import camera_image, outline_residuals, setup_sketch
from heliogauge.reporting.line_figures import encircled_energy, spot_image
from heliogauge.reporting.results import Results
from heliogauge.results.folder import Summary, read_table_csv
from heliogauge.slopes.map import SlopeMap, monomials, no_common_modes
from heliogauge.slopes.statistics import QuadraticFit, fit_quadratic
from heliogauge.sunlight.beam import Illumination, SpotImage, direction_to_sun_for, facing_target, trace
from heliogauge.sunlight.sun_shapes import PillboxSun
from heliogauge.validate import BoolArray, FloatArray


def spot_figures(results: Results, *, rays: int = 1_500_000) -> Html:
    """Return the spot on the target and the energy within a circle.

    rays: Rays from the measured mirror.
    Returns: Two figures; a sentence where the light cannot be traced.
    """
    try:
        traced = spots(results, rays=rays)
    except EstimationError as error:
        return Html(f"<p>The light was not traced: {html.escape(str(error))}</p>")
    measured = traced["as measured"]
    return show(spot_image(measured), encircled_energy(traced), caption=measured.describe())


def spots(results: Results, *, rays: int = 1_500_000) -> dict[str, SpotImage]:
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
    light = Illumination(PillboxSun(), direction_to_sun_for(wide, normal, point))
    rng = np.random.Generator(np.random.SFC64(1))
    few_height_m = _height_m(shape, few.x_m, few.y_m)
    # A few rays tell where the spot is and how wide: 5 standard deviations on each side hold all but stray light.
    first = trace(few, few_height_m, light, target=wide, rays=20_000, rng=rng)
    half = float(np.abs(first.center_m).max()) + 5 * max(first.sd_x_m, first.sd_y_m)
    target = facing_target(wide.distance_m, 2 * half)
    return {
        "as measured": trace(
            measured, _height_m(shape, measured.x_m, measured.y_m), light, target=target, rays=rays, rng=rng
        ),
        "design": trace(design, few_height_m, light, target=target, rays=max(rays // 5, 1), rng=rng),
    }


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


def uncertainty_shares(slope_map: SlopeMap) -> dict[str, tuple[float, float]]:
    """Return the RMS over the measured nodes of each share of the uncertainty, in x and in y.

    Returns: "random noise", then each common source [rad].
    """
    valid, common = slope_map.valid, slope_map.common
    count = max(int(np.count_nonzero(valid)), 1)
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    scaled = ((x[valid] - common.center_m[0]) / common.scale_m, (y[valid] - common.center_m[1]) / common.scale_m)
    terms = monomials(*scaled, common.degree)
    # Mean square of a mode from the mean products of its terms: no mode is evaluated at every node.
    squares = np.einsum("kai,ij,kaj->ka", common.coefficients, terms @ terms.T / count, common.coefficients)
    shares = {"random noise": (_rms(slope_map.sigma_random_x[valid]), _rms(slope_map.sigma_random_y[valid]))}
    for source in dict.fromkeys(common.sources):
        chosen = [index for index, name in enumerate(common.sources) if name == source]
        sigma_x, sigma_y = np.sqrt(squares[chosen].sum(axis=0))
        shares[source] = (float(sigma_x), float(sigma_y))
    return shares


def _rms(values: npt.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def image_figures(results: Results) -> Html:
    """Return what the camera saw: modulation, disagreement of the frames, points on the screen.

    Returns: Figures; a sentence where there are no per-pixel results.
    """
    pixels = results.pixels
    styles = {
        "modulation_dn": MapStyle("Fringe modulation", "DN", diverging=False, note="amplitude of the fringes"),
        "residual_dn": MapStyle("Disagreement of the frames", "DN", diverging=False, note="RMS about one sinusoid"),
        "u": MapStyle("Screen point, u", "", diverging=False, limit=1.0, note="fraction from the left edge"),
        "v": MapStyle("Screen point, v", "", diverging=False, limit=1.0, note="fraction from the top edge"),
    }
    names = [name for name in styles if name in pixels]
    if not names:
        return Html("<p>The folder holds no per-pixel results.</p>")
    rows, columns = _seen_part(np.isfinite(pixels[names[0]]))
    corner = (columns.start, rows.start)
    shown = [camera_image(pixels[name][rows, columns], styles[name], origin_px=corner) for name in names]
    return show(*shown, caption="As the camera saw the mirror, row 0 at the top.")


def _seen_part(seen: BoolArray) -> tuple[slice, slice]:
    """Return the rows and columns that hold everything seen, with a margin of a twentieth."""
    parts = []
    for axis, size in ((1, seen.shape[0]), (0, seen.shape[1])):
        lines = np.flatnonzero(seen.any(axis=axis))
        first, last = (int(lines[0]), int(lines[-1])) if lines.size else (0, size - 1)
        margin = 2 + (last - first) // 20
        parts.append(slice(max(first - margin, 0), min(last + margin + 1, size)))
    return parts[0], parts[1]


def setup_figures(results: Results) -> Html:
    """Return where things stood, and how well the mirror's outline fits.

    results: The results; ``outline.csv`` (x_px, y_px, residual_x_px, residual_y_px) in the folder gives the second
        figure.
    Returns: The figures that the results have data for.
    """
    shown = []
    if results.summary.geometry_m:
        shown.append(setup_sketch(results.summary.geometry_m))
    path = results.folder / "outline.csv"
    if path.exists():
        columns = read_table_csv(path, ("x_px", "y_px", "residual_x_px", "residual_y_px"))
        points, residuals = (
            np.column_stack([np.array(columns[f"{prefix}{axis}_px"], dtype=np.float64) for axis in "xy"])
            for prefix in ("", "residual_")
        )
        shown.append(outline_residuals(points, residuals))
    return show(*shown)
