"""Centre operators that work on edges: dual conic from gradients, and spec 002's average of contour ellipses.

`CENTER_OPERATORS` holds all operators of the package under their names; they share one signature and one test suite.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray, IntArray, freeze
from photogrammetry.centers.contours import closed_contours
from photogrammetry.centers.ellipse import Ellipse, EllipseFit, fit_ellipse
from photogrammetry.centers.operator import (
    REACH,
    CenterOperator,
    Grounds,
    TargetCenter,
    ground_noise,
    influence_covariance,
    normalised_radius,
)
from photogrammetry.centers.template import template_center

#: Levels of the contours, as shares of the way from inside to outside.
_LEVELS = (0.35, 0.45, 0.55, 0.65)
#: A contour's length must match its ellipse's circumference to this share (spec 002 1.3); noise adds a little.
_LENGTH_TOLERANCE = 0.1
#: Passes of the dual conic: from the start's ring to the ring of its own ellipse.
_RING_PASSES = 2
#: Half width of the ring in which gradients count, at least [px].
_RING_HALF_WIDTH_PX = 2.5
#: Contrast over noise below which there is no edge to speak of.
_MIN_SNR = 3.0
#: What the pixel grid does to the centres without any noise, standard deviation of x and y [px]: at 0.5 px blur and
#: 6 to 30 px diameter 0.002 (dual conic) and 0.003 (level lines between pixels are not straight).
_DUAL_GRID_PX, _CONTOUR_GRID_PX = 0.002, 0.004


def dual_conic_center(window_dn: npt.NDArray[np.float64], start: Ellipse) -> TargetCenter:
    """Measure a target's centre from the lines that the gradients define.

    window_dn (h, w): Grey values [DN].
    start: The outline to a pixel or so, in the window's pixels.
    Returns: Centre with covariance, outline, contrast; the blur is NaN.
    EstimationError: Too few pixels, no contrast, or the lines touch no ellipse.

    The line through a pixel x, square to its gradient g, is l = (g, -g.x). Tangents of an ellipse satisfy l' C* l =
    0, which is linear in the dual conic C*; squared gradients weight the equations (Ouellet and Hebert, Precise
    ellipse estimation without contour point extraction, Machine Vision and Applications 21, 2009). A gradient of
    another edge falsifies the centre by pixels, so only pixels in the ring round the target's own edge are used, and
    only gradients that point its way. The ground's slope, found outside the ring, is taken off before.
    """
    ellipse = start
    for _ in range(_RING_PASSES):
        edges = _edges(window_dn, ellipse)
        theta, normal = _tangent_conic(edges)
        previous = ellipse
        ellipse = _placed(theta, edges, previous)
        _refuse_runaway(previous, ellipse)
    misfit = edges.equations @ theta + edges.along**2
    # A line's misfit, over the derivative 2 by its distance and the squared gradient, is a distance in radii.
    distance = edges.scale_px * 0.5 * float(np.sqrt(misfit @ misfit / np.sum((edges.gx**2 + edges.gy**2) ** 2)))
    steepness = float(np.sqrt(np.mean(edges.gx**2 + edges.gy**2)))
    grounds = edges.grounds
    step = abs(grounds.outside_dn - grounds.inside_dn)
    influence = _dual_influence(edges, theta, normal, window_dn.shape)
    return TargetCenter(
        ellipse,
        freeze(influence_covariance(influence, window_dn, grounds) + _DUAL_GRID_PX**2 * np.eye(2)),
        grounds.inside_dn - grounds.outside_dn,
        grounds.inside_dn,
        float("nan"),
        distance * steepness * step,
        len(misfit),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """Gradients in the ring, in units of the contrast; places in radii from the start's centre."""

    rows: IntArray
    columns: IntArray
    x: FloatArray
    y: FloatArray
    gx: FloatArray
    gy: FloatArray
    scale_px: float
    grounds: Grounds

    @property
    def along(self) -> FloatArray:
        return -(self.gx * self.x + self.gy * self.y)

    @property
    def equations(self) -> FloatArray:
        """Rows of l' C* l with C* = [[c1, c2 / 2, c4 / 2], [., c3, c5 / 2], [., ., 1]], without the last term."""
        along = self.along
        return np.stack([self.gx**2, self.gx * self.gy, self.gy**2, self.gx * along, self.gy * along], axis=1)


def _edges(window_dn: FloatArray, ellipse: Ellipse) -> _Edges:
    grounds = ground_noise(window_dn, ellipse)
    step = grounds.outside_dn - grounds.inside_dn
    noise = float(np.sqrt(min(grounds.inside_variance_dn2, grounds.outside_variance_dn2)))
    if abs(step) <= _MIN_SNR * noise or step == 0:
        raise EstimationError(f"the target's contrast is {abs(step):.1f} DN at {noise:.1f} DN noise: too little")
    gx = cv2.Sobel(window_dn, cv2.CV_64F, 1, 0, ksize=5, scale=1 / 128) - grounds.slope_dn_px[0]
    gy = cv2.Sobel(window_dn, cv2.CV_64F, 0, 1, ksize=5, scale=1 / 128) - grounds.slope_dn_px[1]
    radius = normalised_radius(window_dn.shape, ellipse)
    half = max(_RING_HALF_WIDTH_PX / ellipse.semi_axes_px[1], 0.3)
    x = np.arange(window_dn.shape[1]) - ellipse.center_px[0]
    y = (np.arange(window_dn.shape[0]) - ellipse.center_px[1])[:, None]
    conic = np.linalg.inv(ellipse.shape_px2)
    outward_x, outward_y = conic[0, 0] * x + conic[0, 1] * y, conic[0, 1] * x + conic[1, 1] * y
    right_way = (gx * outward_x + gy * outward_y) * step > 0
    ring = (radius > 1 - half) & (radius < min(1 + half, 1 + 0.9 * (REACH - 1))) & right_way
    ring[[0, 1, -2, -1]] = ring[:, [0, 1, -2, -1]] = False
    rows, columns = np.nonzero(ring)
    if len(rows) < 10:
        raise EstimationError(f"{len(rows)} pixels show the target's edge; 10 are needed")
    scale = ellipse.radius_px
    return _Edges(
        rows,
        columns,
        x[columns] / scale,
        y[rows, 0] / scale,
        gx[rows, columns] / step,
        gy[rows, columns] / step,
        scale,
        grounds,
    )


def _tangent_conic(edges: _Edges) -> tuple[FloatArray, FloatArray]:
    equations = edges.equations
    normal = equations.T @ equations
    try:
        return np.asarray(np.linalg.solve(normal, -equations.T @ edges.along**2), dtype=np.float64), normal
    except np.linalg.LinAlgError:
        raise EstimationError("the gradients are not those of an ellipse") from None


def _placed(theta: FloatArray, edges: _Edges, start: Ellipse) -> Ellipse:
    """Return the ellipse of a dual conic in the window's pixels."""
    dual = np.array(
        [
            [theta[0], 0.5 * theta[1], 0.5 * theta[3]],
            [0.5 * theta[1], theta[2], 0.5 * theta[4]],
            [0.5 * theta[3], 0.5 * theta[4], 1.0],
        ]
    )
    try:
        found = Ellipse.from_dual_conic(dual)
    except InputError:
        raise EstimationError("the gradients are not those of an ellipse") from None
    return Ellipse(start.center_px + found.center_px * edges.scale_px, found.shape_px2 * edges.scale_px**2)


def _refuse_runaway(start: Ellipse, found: Ellipse) -> None:
    moved = float(np.hypot(*(found.center_px - start.center_px)))
    if moved > 0.5 * start.radius_px + 1 or not 0.4 < found.radius_px / start.radius_px < 2.5:
        raise EstimationError(f"the edge lies {moved:.1f} px from where it was looked for, or is of another size")


def _dual_influence(edges: _Edges, theta: FloatArray, normal: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Movement of the dual conic's centre by each grey value, shape (2, h, w) [px/DN]."""
    to_center = -0.5 * edges.scale_px * np.linalg.solve(normal, edges.equations.T)[3:]
    along = edges.along
    tangent_x = 2 * theta[0] * edges.gx + theta[1] * edges.gy + theta[3] * along
    tangent_y = theta[1] * edges.gx + 2 * theta[2] * edges.gy + theta[4] * along
    tangent_1 = theta[3] * edges.gx + theta[4] * edges.gy + 2 * along
    step = edges.grounds.outside_dn - edges.grounds.inside_dn
    by_x, by_y = np.zeros((2, *shape)), np.zeros((2, *shape))
    by_x[:, edges.rows, edges.columns] = to_center * (tangent_x - edges.x * tangent_1) / step
    by_y[:, edges.rows, edges.columns] = to_center * (tangent_y - edges.y * tangent_1) / step
    # The transpose of a filter whose kernel is odd along one axis is minus the filter.
    return -np.stack(
        [
            cv2.Sobel(by_x[k], cv2.CV_64F, 1, 0, ksize=5, scale=1 / 128, borderType=cv2.BORDER_CONSTANT)
            + cv2.Sobel(by_y[k], cv2.CV_64F, 0, 1, ksize=5, scale=1 / 128, borderType=cv2.BORDER_CONSTANT)
            for k in range(2)
        ]
    )


def contour_center(window_dn: npt.NDArray[np.float64], start: Ellipse) -> TargetCenter:
    """Measure a target's centre as the mean of ellipses fitted to level lines (spec 002 1.3).

    window_dn (h, w): Grey values [DN].
    start: The outline to a pixel or so, in the window's pixels.
    Returns: Centre with covariance, outline, contrast; the blur is NaN.
    EstimationError: No level line is closed and as long as its ellipse.

    Level lines at 35 to 65 % of the way between the levels inside and outside, closed ones that surround the start
    and are as long as their ellipse's circumference to 10 %. The ground's slope, found outside the ring, is taken off
    before. Neighbouring levels see the same pixels, so that four levels are hardly better than one; the covariance
    knows it.
    """
    grounds = ground_noise(window_dn, start)
    x = np.arange(window_dn.shape[1]) - start.center_px[0]
    y = (np.arange(window_dn.shape[0]) - start.center_px[1])[:, None]
    level = window_dn - grounds.slope_dn_px[0] * x - grounds.slope_dn_px[1] * y
    fits, influences, distances = [], [], []
    for share in _LEVELS:
        height = grounds.inside_dn + share * (grounds.outside_dn - grounds.inside_dn)
        for contour in closed_contours(level, height):
            if not 0.5 < contour.length_px / start.circumference_px < 2:
                continue
            try:
                fit = fit_ellipse(contour.points_px)
            except EstimationError:
                continue
            too_long = abs(contour.length_px / fit.ellipse.circumference_px - 1) > _LENGTH_TOLERANCE
            if too_long or np.hypot(*(fit.ellipse.center_px - start.center_px)) > 0.5 * start.radius_px + 1:
                continue
            fits.append(fit)
            one, steepness = _contour_influence(level, contour.points_px, fit)
            influences.append(one)
            distances.append(fit.rms_px * steepness)
    if not fits:
        raise EstimationError("no level line is closed and as long as its ellipse: partly covered, or no target")
    influence = np.mean(influences, axis=0)
    return TargetCenter(
        Ellipse(
            np.mean([fit.ellipse.center_px for fit in fits], axis=0),
            np.mean([fit.ellipse.shape_px2 for fit in fits], axis=0),
        ),
        freeze(influence_covariance(influence, window_dn, grounds) + _CONTOUR_GRID_PX**2 * np.eye(2)),
        grounds.inside_dn - grounds.outside_dn,
        grounds.inside_dn,
        float("nan"),
        float(np.mean(distances)),
        sum(len(fit.normals) for fit in fits),
    )


def _contour_influence(level_dn: FloatArray, points: FloatArray, fit: EllipseFit) -> tuple[FloatArray, float]:
    """Movement of a contour's centre by each grey value, shape (2, h, w), and the mean steepness at the contour."""
    low = np.floor(points + 1e-9).astype(np.intp)
    along_x = np.abs(points[:, 0] - np.round(points[:, 0])) > 1e-9
    high = low + np.stack([along_x, ~along_x], axis=1)
    share = (points - low).max(axis=1)
    difference = level_dn[high[:, 1], high[:, 0]] - level_dn[low[:, 1], low[:, 0]]
    normal = np.where(along_x, fit.normals[:, 0], fit.normals[:, 1])
    safe = np.where(difference == 0, np.inf, difference)
    by_level = -fit.center_per_normal * (normal / safe)[:, None]
    influence = np.zeros((2, *level_dn.shape))
    for corner, weight in ((low, 1 - share), (high, share)):
        for k in range(2):
            np.add.at(influence[k], (corner[:, 1], corner[:, 0]), by_level[:, k] * weight)
    steep = np.abs(difference / np.where(np.abs(normal) > 0.3, normal, np.nan))
    return influence, float(np.nanmean(steep)) if np.isfinite(steep).any() else 0.0


#: All centre operators: least squares first, then by falling precision.
CENTER_OPERATORS: Mapping[str, CenterOperator] = MappingProxyType(
    {"template": template_center, "dual-conic": dual_conic_center, "contours": contour_center}
)
