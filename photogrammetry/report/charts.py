"""Charts of a network's report: residuals over the image and the radius, sigma against rays, errors of lengths."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from heliogauge.camera.model import PARAMETER_NAMES
from heliogauge.reporting.html import Html
from heliogauge.reporting.look import FAINT, INK, LINE_X, LINE_Y
from heliogauge.validate import FloatArray, IntArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.image_maps import residual_layers, residual_still
from heliogauge.view.maps import MapView
from heliogauge.view.still_maps import correlation_still
from heliogauge.view.stills import side_by_side
from photogrammetry.report.network import NetworkResults

#: Cells of the map along the longer side of the image: some image points in each, and not more than one sees.
_LEAST_CELLS, _MOST_CELLS, _POINTS_IN_CELL = 6, 24, 6
#: Dots in a chart; more are one grey area.
_MOST_DOTS = 3000


def residual_map(results: NetworkResults) -> MapView:
    """Return mean residuals, their RMS and the number of image points over the image of the first camera.

    A lens that does not fit leaves a pattern in the means; cells without points are where it is a guess.
    """
    camera, used = results.camera, results.used
    longer = max(camera.width_px, camera.height_px)
    sizes = camera.height_px, camera.width_px
    axes_px: list[FloatArray] = []
    most = np.clip(np.sqrt(len(used.photo) / _POINTS_IN_CELL * longer / min(sizes)), _LEAST_CELLS, _MOST_CELLS)
    for size in sizes:
        cells = max(2, round(float(most) * size / longer))
        axes_px.append(np.asarray((np.arange(cells) + 0.5) * size / cells - 0.5, dtype=np.float64))
    own = _of_first_camera(results)
    pixels = used.pixels_px[own]
    layers = residual_layers(pixels, used.residuals_px[own], axes_px[1], axes_px[0])
    count = np.nan_to_num(layers[3].values)
    shape = count.shape
    empty = float((count == 0).mean())
    half = 0.5 * np.array([camera.width_px, camera.height_px])
    reach = float(np.hypot(*(pixels - half + 0.5).T).max(initial=0.0)) / float(np.hypot(*half))
    note = f"{empty:.0%} of the cells without image points; points out to {reach:.0%} of the way to the corners"
    view = MapView(
        "Residuals over the image, all photos",
        axes_px[1],
        axes_px[0],
        layers,
        np.zeros(shape, dtype=np.uint32),
        np.ones(shape, dtype=bool),
        note=note,
        axis_unit="px",
        y_down=True,
    )
    means = np.stack([layers[0].values, layers[1].values], axis=-1)
    return replace(view, stills=[view.layer_still("count"), _mean_still(results, means, axes_px)])


def _of_first_camera(results: NetworkResults) -> FloatArray:
    """Return which image points are of the first camera: others have another image."""
    first = next(iter(results.cameras))
    own = np.array([pose.camera == first for pose in results.poses.values()], dtype=bool)
    return np.asarray(own[results.used.photo])


def _mean_still(results: NetworkResults, means: FloatArray, axes_px: list[FloatArray]) -> Html:
    """Draw the mean residual of each cell as an arrow.

    Shapes: means (ny, nx, 2).
    """
    sizes = np.linalg.norm(means, axis=-1)
    typical = float(np.sqrt(np.nanmean(sizes**2))) if np.isfinite(sizes).any() else 0.0
    scale = 0.6 * float(axes_px[1][1] - axes_px[1][0]) / typical if typical > 0 else 1.0
    rms = float(np.sqrt((results.used.residuals_px**2).sum(axis=1).mean())) if len(results.used.photo) else 0.0
    note = f"{scale:.0f} times; residuals {rms:.3g} px RMS, their means {typical:.3g} px"
    places = np.stack(np.meshgrid(axes_px[1], axes_px[0]), axis=-1).reshape(-1, 2)
    camera = results.camera
    words = "Mean residual in each part of the image", note
    return residual_still((camera.width_px, camera.height_px), places, means.reshape(-1, 2), scale, words)


class _Parts(NamedTuple):
    """Means over tenths of the image points, with their sigmas."""

    middle: FloatArray
    mean: FloatArray
    sigma: FloatArray


def radius_chart(results: NetworkResults) -> ChartView:
    """Return residuals along and across the radius from the principal point; a lens that does not fit shows here."""
    camera, used = results.camera, results.used
    own = np.nonzero(_of_first_camera(results))[0]
    arm = (used.pixels_px[own] - [camera.center_x_px, camera.center_y_px]).T
    dx, dy = used.residuals_px[own].T
    radius = np.maximum(np.hypot(*arm), 1e-9)
    along, across = (arm[0] * dx + arm[1] * dy) / radius, (arm[0] * dy - arm[1] * dx) / radius
    few = _sample(len(own))
    series = []
    for values, color, name in ((along, LINE_X, "along the radius"), (across, LINE_Y, "across it")):
        labels = [used.targets[own[i]] for i in few]
        series.append(ChartSeries(f"{name}, image points", radius[few], values[few], color, Mark.POINTS, labels=labels))
        parts = _tenths(radius, values)
        series.append(
            ChartSeries(
                f"{name}, mean of a tenth each", parts.middle, parts.mean, color, sigma=parts.sigma, size_px=2.5
            )
        )
    shown = "" if len(few) == len(own) else f"; dots: {len(few)} of {len(own)} image points"
    return ChartView(
        "Residuals against the radius",
        "distance from the principal point [px]",
        "residual [px]",
        tuple(series),
        f"lines: means of a tenth of the image points each, with their sigma{shown}",
    )


def _tenths(radius: FloatArray, values: FloatArray) -> _Parts:
    parts = [part for part in np.array_split(np.argsort(radius, kind="stable"), 10) if part.size > 1]
    return _Parts(
        np.array([radius[part].mean() for part in parts]),
        np.array([values[part].mean() for part in parts]),
        np.array([values[part].std(ddof=1) / np.sqrt(part.size) for part in parts]),
    )


def _sample(count: int) -> IntArray:
    """Return places of at most `_MOST_DOTS` of so many, evenly spread."""
    return np.arange(count)[:: max(1, -(-count // _MOST_DOTS))]


def histogram_chart(results: NetworkResults) -> ChartView:
    """Return the residuals over their own sigma against the normal distribution."""
    used = results.used
    values = used.residuals_px / (used.sigma_px * np.sqrt(np.maximum(used.redundancy, np.finfo(float).tiny)))
    values = values[np.isfinite(values) & (np.abs(values) < 1e6)]
    beyond = float((np.abs(values) > 3).mean()) if values.size else 0.0
    rms = float(np.sqrt((values**2).mean())) if values.size else float("nan")
    bins = np.linspace(-5, 5, 51)
    counts, _ = np.histogram(values, bins)
    middles = 0.5 * (bins[:-1] + bins[1:])
    density = counts / max(values.size, 1) / np.diff(bins)
    fine = np.linspace(-5, 5, 201)
    return ChartView(
        "Residuals over their own sigma",
        "residual / (sigma x square root of redundancy)",
        "density",
        (
            ChartSeries("image points", middles, density, LINE_X, Mark.BARS),
            ChartSeries("normal distribution", fine, np.exp(-0.5 * fine**2) / np.sqrt(2 * np.pi), INK),
        ),
        f"RMS {rms:.3f} (1 expected); {beyond:.2%} beyond 3 (0.27 % expected)",
    )


def ray_chart(results: NetworkResults) -> ChartView:
    """Return the standard deviation of each point against the number of photos that see it."""
    rays = results.points.n_rays[results.known].astype(np.float64)
    sigma_mm = results.sigma_mm / np.sqrt(3)
    few = _sample(len(rays))
    labels = [results.points.ids[i] for i in results.known[few]]
    series = [ChartSeries("points", rays[few], sigma_mm[few], LINE_X, Mark.POINTS, labels=labels, size_px=4)]
    if len(rays) and rays.max() > 0:
        span = np.linspace(max(rays.min(), 1), rays.max(), 50)
        middle = float(np.median(sigma_mm * np.sqrt(rays)))
        series.append(ChartSeries("1 / square root of rays", span, middle / np.sqrt(span), FAINT, dashed=True))
    return ChartView(
        "Sigma and number of rays",
        "photos that see the point",
        "sigma, RMS of the three coordinates [mm]",
        tuple(series),
        "one dot for each point" if len(few) == len(rays) else f"dots: {len(few)} of {len(rays)} points",
    )


def length_chart(results: NetworkResults) -> ChartView | None:
    """Return the errors of known lengths that were not used, with the permissible error; None where there are none."""
    if not results.tables["lengths"]["name"]:
        return None
    known, error, sigma, limit = (
        results.column("lengths", name) for name in ("known_m", "error_m", "sigma_error_m", "permissible_m")
    )
    roles, names = (np.array(results.tables["lengths"][name]) for name in ("role", "name"))
    series = []
    for role, color in (("kept apart", LINE_X), ("left out", LINE_Y)):
        own = roles == role
        if own.any():
            values = known[own], 1e3 * error[own]
            label = f"{role} ({int(own.sum())})"
            series.append(
                ChartSeries(
                    label, *values, color, Mark.POINTS, sigma=1e3 * sigma[own], labels=names[own].tolist(), size_px=6
                )
            )
    if np.isfinite(limit).any():
        order = np.argsort(known)
        for sign, label in ((1, "permissible"), (-1, "permissible, below")):
            series.append(ChartSeries(label, known[order], 1e3 * sign * limit[order], INK, dashed=True))
    note = "measured minus known; bars: 1 sigma of network and known length together"
    return ChartView("Length measurement error", "length [m]", "error [mm]", tuple(series), note)


def correlations(results: NetworkResults) -> Html:
    """Draw the correlations of the camera's parameters; nothing where fewer than two were estimated."""
    covariance = results.camera.covariance
    free = np.nonzero(np.diag(covariance) > 0)[0]
    if free.size < 2:
        return Html("")
    names = [PARAMETER_NAMES[i].removesuffix("_px").replace("_", " ") for i in free]
    sigma = np.sqrt(np.diag(covariance)[free])
    matrix = covariance[np.ix_(free, free)] / np.outer(sigma, sigma)
    words = "Correlations of the camera's parameters", "near 1 or -1: the photos do not separate the two"
    return side_by_side([correlation_still(names, matrix, *words)])
