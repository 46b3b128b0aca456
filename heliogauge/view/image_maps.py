"""Residuals of image points as layers of a map over the image: means, RMS and counts in its cells."""

import numpy as np

from heliogauge.validate import FloatArray
from heliogauge.view.maps import MapLayer


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
