"""Residuals of image points over the image: means, RMS and counts in cells of a map, arrows in a still picture."""

import numpy as np

from heliogauge.reporting.html import Html
from heliogauge.reporting.look import LINE_X, LINE_Y
from heliogauge.validate import FloatArray
from heliogauge.view.maps import MapLayer
from heliogauge.view.stills import fitted_sheet

#: Arrows in a still picture; more are one area.
_MOST_ARROWS = 2500


def residual_layers(
    pixels_px: FloatArray, residuals_px: FloatArray, x_px: FloatArray, y_px: FloatArray
) -> tuple[MapLayer, ...]:
    """Return residuals in cells about the nodes of a regular grid; cells without image points have no value.

    Shapes: pixels_px (n, 2), residuals_px (n, 2), x_px (nx,), y_px (ny,).
    Returns: Mean residual in x and y with its sigma, RMS length, number of image points. A model that does not fit
        leaves a pattern in the means.
    """
    columns, rows = (
        np.clip(np.rint((pixels_px[:, axis] - nodes[0]) / (nodes[1] - nodes[0])), 0, nodes.size - 1).astype(np.intp)
        for axis, nodes in ((0, x_px), (1, y_px))
    )
    shape = y_px.size, x_px.size
    cell = rows * shape[1] + columns

    def summed(weights: FloatArray | None) -> FloatArray:
        return np.bincount(cell, weights, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)

    count = summed(None)
    known = np.where(count > 0, count, np.nan)
    squares = [summed(residuals_px[:, axis] ** 2) for axis in (0, 1)]
    means = [
        MapLayer(
            f"mean_{'xy'[axis]}",
            f"Mean residual in {'xy'[axis]}",
            "px",
            summed(residuals_px[:, axis]) / known,
            sigma=np.sqrt(squares[axis]) / known,
        )
        for axis in (0, 1)
    ]
    return (
        *means,
        MapLayer(
            "residual_rms", "RMS residual", "px", np.sqrt((squares[0] + squares[1]) / known), diverging=False, low=0.0
        ),
        MapLayer("count", "Image points in a cell", "", known, diverging=False, low=0.0),
    )


def residual_still(
    size_px: tuple[float, float],
    pixels_px: FloatArray,
    residuals_px: FloatArray,
    factor: float,
    words: tuple[str, str],
    refused_px: FloatArray | None = None,
) -> Html:
    """Draw residuals as arrows where they are in the image; of very many every n-th.

    size_px: Width and height of the image.
    Shapes: pixels_px (n, 2), residuals_px (n, 2).
    factor: By how much arrows are enlarged.
    words: Title, and the line under it.
    refused_px (k, 2): Image points that were refused, drawn as crosses.
    """
    width, height = size_px
    sheet = fitted_sheet((-0.5, width - 0.5), (height - 0.5, -0.5), bar=False)
    sheet.title(*words)
    few = np.s_[:: max(1, -(-len(pixels_px) // _MOST_ARROWS))]
    (x, y), (dx, dy) = pixels_px[few].T, factor * residuals_px[few].T
    sheet.arrows(x, y, dx, dy, LINE_X, width=0.8)
    if refused_px is not None:
        sheet.crosses(refused_px[:, 0], refused_px[:, 1], LINE_Y)
    sheet.axes("x [px]", "y [px]", grid=True)
    return sheet.html(". ".join(words))
