"""Still pictures of a calibration: residuals of all photos, correlations, the board's shape."""

import numpy as np

from calibration.camera.files.result import Result
from heliogauge.camera.model import PARAMETER_NAMES
from heliogauge.reporting.html import Html
from heliogauge.reporting.look import INK
from heliogauge.validate import FloatArray
from heliogauge.view.image_maps import residual_still
from heliogauge.view.scenes import ColorScale
from heliogauge.view.still_maps import correlation_still
from heliogauge.view.stills import Sheet, fitted_sheet, side_by_side

#: Arrows of residuals are drawn so that the RMS one has this share of the image's diagonal.
_ARROW_SHARE = 0.02


def residuals(result: Result) -> Html:
    """Draw the residuals of all photos where they are in the image, with refused points as crosses."""
    camera = result.camera
    diagonal = float(np.hypot(camera.width_px, camera.height_px))
    factor = float(f"{_ARROW_SHARE * diagonal / max(result.quality.rms_px, 1e-12):.1g}")
    note = f"predicted minus measured, {factor:.0f} times enlarged; RMS {result.quality.rms_px:.4f} px"
    return residual_still(
        (camera.width_px, camera.height_px),
        np.concatenate([one.pixels_px[one.used] for one in result.photos]),
        np.concatenate([one.residuals_px[one.used] for one in result.photos]),
        factor,
        ("Residuals of all photos, and where the board was", note),
        np.concatenate([one.pixels_px[~one.used] for one in result.photos]),
    )


def correlations(result: Result) -> Html:
    """Draw the correlations of the estimated intrinsics."""
    sigma = result.camera.sigma_parameters
    free = np.nonzero(sigma > 0)[0]
    names = [PARAMETER_NAMES[i].removesuffix("_px").replace("_", " ") for i in free]
    matrix = result.camera.covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    note = "beyond 0.95 two effects are hardly separated"
    return side_by_side([correlation_still(names, matrix, "Correlation of the intrinsics", note)])


def board(result: Result) -> Html:
    """Draw how far the board's points are from where they were drawn; without a drawing, where they are."""
    shape = result.shape
    unit, factor = ("mm", 1e3) if shape.board.is_metric else ("pitches", 1.0)
    places, departure = factor * shape.points_m, factor * shape.departure_m
    if shape.has_drawing:
        rms = np.sqrt((departure**2).mean(axis=0))
        size = float(np.sqrt((departure[:, :2] ** 2).sum(axis=1).mean()))
        enlarge = 0.04 * float(np.hypot(*np.ptp(places[:, :2], axis=0))) / max(size, 1e-12)
        title = "The board's departure from its drawing"
        note = f"rms x {rms[0]:.2g}, y {rms[1]:.2g}, z {rms[2]:.2g} {unit}; arrows {enlarge:.0f} times, colour z"
        height = departure[:, 2]
    else:
        size, enlarge, height = 0.0, 1.0, places[:, 2]
        title, note = "Places of the targets", f"colour: z, from {height.min():.3g} to {height.max():.3g} {unit}"
    end = max(float(np.abs(height).max(initial=0.0)), 1e-12)
    sheet = _board_sheet(places, unit, ColorScale(-end, end, unit, diverging=True), height, (title, note))
    if size > 0:
        dx, dy = enlarge * departure[:, :2].T
        sheet.arrows(places[:, 0], places[:, 1], dx, dy, INK, width=0.7)
    return sheet.html(f"{title}. {note}")


def board_sigma(result: Result) -> Html:
    """Draw how well each point of the board is known: position, rotation and scale of the whole taken out."""
    shape = result.shape
    unit = "mm" if shape.board.is_metric else "1/1000 pitch"
    length = "mm" if shape.board.is_metric else "pitches"
    places = (1e3 if shape.board.is_metric else 1.0) * shape.points_m
    sigma = 1e3 * np.sqrt((shape.sigma_m**2).sum(axis=1))
    note = f"1 sigma, x, y and z in squares [{unit}]; RMS {float(np.sqrt((sigma**2).mean())):.2g}"
    scale = ColorScale(float(sigma.min()), float(sigma.max()), unit)
    title = "Uncertainty of the board's shape"
    return _board_sheet(places, length, scale, sigma, (title, note)).html(f"{title}. {note}")


def _board_sheet(places: FloatArray, unit: str, scale: ColorScale, values: FloatArray, words: tuple[str, str]) -> Sheet:
    """Draw the points of a board, coloured by their values.

    Shapes: places (n, 3), values (n,).
    unit: Of the places.
    """
    room = 0.06 * float(np.ptp(places[:, :2], axis=0).max())
    limits = [(float(one.min()) - room, float(one.max()) + room) for one in places[:, :2].T]
    sheet = fitted_sheet(limits[0], limits[1])
    sheet.title(*words)
    sheet.axes(f"x [{unit}]", f"y [{unit}]", grid=True)
    sheet.dots(places[:, 0], places[:, 1], scale.colors(values), size_px=5.5)
    sheet.color_bar(scale.low, scale.high, scale.unit, diverging=scale.diverging)
    return sheet
