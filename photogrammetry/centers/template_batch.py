"""Centres of many targets at once whose outlines are known to half a pixel: the fit of `template_center`, stacked.

One by one a dozen discs of a few hundred pixels take longer than decoding their photo, most of it in calls. Here the
pixels of all targets of several photos form one array, and every step is one operation on it. Pixels, model, priors and
the rule for dust are those of `photogrammetry.centers.template`; a fit that does not run straight to its end is its.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.centers.operator import TargetCenter
from photogrammetry.centers.template import (
    BAND_PX,
    ENOUGH_PX,
    LEAST_STEP_SIGMAS,
    N_PARAMETERS,
    OUTLIER_CONTRAST,
    OUTLIER_SIGMAS,
    SLOPE_FLOOR,
    USUAL_WIDTH_PX,
    disc_model,
)

#: Pixels, model and derivatives are in single precision: half the time, and 1e-5 px. Equations are in double.
_SINGLE: np.dtype[Any] = np.dtype(np.float32)

#: Steps within which a fit from a good start ends.
_MOST_STEPS = 8
#: A centre that moves farther than this from its start is fitted again, with the pixels that then are its own. Without,
#: centres of discs of 10 px err by 0.00442 px, with fits from the final place by 0.00430 px (sigma 0.006 px) [radii].
_MOVED_RADII = 0.1
#: Pixels that are fitted together: with fewer the calls cost more than is gained by what stays in the caches.
_STACK_PIXELS = 80_000


@dataclass(frozen=True, slots=True, eq=False)
class StackedCenters:
    """Centres of n targets.

    centers_px (n, 2): Centres (x, y) [px].
    shapes_px2 (n, 2, 2): Their ellipses [px^2].
    covariance_px2 (n, 2, 2): Covariances of the centres [px^2].
    contrast_dn, inside_dn, residual_dn (n,): As in `photogrammetry.centers.operator.TargetCenter` [DN].
    settled (n,): Whether the fit ended; else the numbers mean nothing and `template_center` may try.
    """

    centers_px: FloatArray
    shapes_px2: FloatArray
    covariance_px2: FloatArray
    contrast_dn: FloatArray
    inside_dn: FloatArray
    residual_dn: FloatArray
    settled: BoolArray

    def put(self, row: int, center: TargetCenter) -> None:
        """Put down the centre of one target that was measured by itself."""
        self.centers_px[row], self.covariance_px2[row] = center.center_px, center.covariance_px2
        self.shapes_px2[row], self.settled[row] = center.ellipse.shape_px2, True
        self.contrast_dn[row], self.inside_dn[row] = center.contrast_dn, center.inside_dn
        self.residual_dn[row] = center.residual_dn


def stacked_centers(
    images: Sequence[npt.NDArray[np.generic]],
    photo: IntArray,
    centers_px: FloatArray,
    shapes_px2: FloatArray,
    reach: float,
) -> StackedCenters:
    """Measure centres near known places.

    Shapes: images (h, w), photo (n,).
    centers_px (n, 2): Places to half a pixel or so [px].
    shapes_px2 (n, 2, 2): Ellipses to a few percent [px^2].
    reach: How far from the centre pixels are used, in radii of the dot.
    """
    count = len(photo)
    found = StackedCenters(
        np.array(centers_px),
        np.array(shapes_px2),
        np.full((count, 2, 2), np.nan),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count, dtype=np.bool_),
    )
    size = (2 * reach * np.sqrt(np.einsum("nii->ni", shapes_px2).max(initial=1.0)) + 3) ** 2
    at_once = max(1, int(_STACK_PIXELS / size))
    for first in range(0, count, at_once):
        rows = np.arange(first, min(first + at_once, count))
        for _ in range(2):
            start = found.centers_px[rows]
            _measure(images, photo[rows], found, rows, reach)
            moved = np.hypot(*(found.centers_px[rows] - start).T)
            rows = rows[found.settled[rows] & (moved > _MOVED_RADII * _smaller(shapes_px2[rows]))]
            if not rows.size:
                break
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """Pixels of n targets, k each: places from the start of the fit, values, whether they are used."""

    x: FloatArray
    y: FloatArray
    values_dn: FloatArray
    used: BoolArray
    radius: FloatArray

    def chosen(self, which: BoolArray | IntArray) -> "_Pixels":
        return _Pixels(*(getattr(self, name)[which] for name in self.__slots__))


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """Start and prior of n fits, shape (12, n) each; weights are noise variance over own variance."""

    parameters: FloatArray
    mean: FloatArray
    weights: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """Fits after their last step: parameters (12, n), residuals (n, k), derivatives (n, 12, k), all others zero."""

    parameters: FloatArray
    residuals: FloatArray
    jacobian: FloatArray
    settled: BoolArray


def _measure(
    images: Sequence[npt.NDArray[np.generic]], photo: IntArray, found: StackedCenters, rows: IntArray, reach: float
) -> None:
    """Fit some targets and put down what came out."""
    centers, shapes = found.centers_px[rows], found.shapes_px2[rows]
    pixels = _cut_out(images, photo, (centers, shapes), reach)
    start, usable = _started(pixels, shapes)
    fitted = _robust(pixels, start)
    parameters = fitted.parameters
    m11, m12, m22 = parameters[2:5]
    with np.errstate(divide="ignore", invalid="ignore"):
        frame = np.array([[m22, -m12], [-m12, m11]]) / (m11 * m22 - m12 * m12)
    frame = np.moveaxis(frame, -1, 0)
    covariance, residual, stands_out = _covariance(pixels, start, fitted)
    settled = fitted.settled & usable & stands_out
    good = rows[settled]
    found.settled[rows] = settled
    found.centers_px[good] = (centers + parameters[:2].T)[settled]
    found.shapes_px2[good] = (frame @ frame)[settled]
    found.covariance_px2[good] = covariance[settled]
    step = parameters[9] + parameters[10] * parameters[0] + parameters[11] * parameters[1]
    outside = parameters[6] + parameters[7] * parameters[0] + parameters[8] * parameters[1]
    found.contrast_dn[good], found.inside_dn[good] = step[settled], (outside + step)[settled]
    found.residual_dn[good] = residual[settled]


def _cut_out(
    images: Sequence[npt.NDArray[np.generic]], photo: IntArray, outlines: tuple[FloatArray, FloatArray], reach: float
) -> _Pixels:
    """Gather the pixels near the outlines; all targets have the same places about their middle pixel."""
    centers, shapes = outlines
    middle = np.rint(centers).astype(np.intp)
    half = int(np.ceil(reach * np.sqrt(np.einsum("nii->ni", shapes).max()))) + 1
    offset = np.arange(-half, half + 1)
    dx, dy = (offset - (centers[:, i] - middle[:, i])[:, None] for i in (0, 1))
    inverse = np.linalg.inv(shapes)
    radius = np.sqrt(
        (inverse[:, 0, 0, None] * dx**2)[:, None, :]
        + 2 * inverse[:, 0, 1, None, None] * dy[:, :, None] * dx[:, None, :]
        + (inverse[:, 1, 1, None] * dy**2)[:, :, None]
    )
    band = (BAND_PX / _smaller(shapes))[:, None, None]
    used = (radius > 1 - band) & (radius < np.minimum(reach, 1 + band))
    row, column = np.nonzero(used.any(axis=0))
    values = np.empty((len(photo), row.size), dtype=_SINGLE)
    for one in np.unique(photo):
        own, image = photo == one, images[one]
        rows = np.clip(middle[own, 1, None] + offset[row], 0, image.shape[0] - 1)
        columns = np.clip(middle[own, 0, None] + offset[column], 0, image.shape[1] - 1)
        values[own] = image[rows, columns]
    dx, dy = dx.astype(_SINGLE), dy.astype(_SINGLE)
    return _Pixels(dx[:, column], dy[:, row], values, used[:, row, column], radius[:, row, column])


def _smaller(shapes: FloatArray) -> FloatArray:
    """Return the smaller semi-axes, shape (n,) [px]."""
    xx, xy, yy = shapes[:, 0, 0], shapes[:, 0, 1], shapes[:, 1, 1]
    return np.asarray(np.sqrt(np.maximum(0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy), 0.0)))


def _started(pixels: _Pixels, shapes: FloatArray) -> tuple[_Start, BoolArray]:
    """Tell levels, noise and prior of all fits; and which have enough pixels."""
    count, smaller = len(shapes), _smaller(shapes)
    far = pixels.used & (pixels.radius > 1 + np.minimum(0.25, 2 / smaller)[:, None])
    core = pixels.used & (pixels.radius < 1 - np.minimum(0.2, 2 / smaller)[:, None])
    usable = (pixels.used.sum(axis=1) >= 2 * N_PARAMETERS) & (core.sum(axis=1) >= 3) & (far.sum(axis=1) >= 8)
    planes = np.stack([np.ones_like(pixels.x), pixels.x, pixels.y], axis=1) * far[:, None]
    normal = planes @ np.swapaxes(planes, 1, 2) + 1e-9 * np.eye(3)
    plane = np.linalg.solve(normal, planes @ pixels.values_dn[:, :, None])[..., 0]
    left = np.abs(pixels.values_dn - (plane[:, None] @ planes)[:, 0])
    noise = np.maximum(_medians(left, far) * 1.4826, 0.3)
    inside = _medians(pixels.values_dn, core)
    step = inside - plane[:, 0]
    usable &= (step != 0) & np.isfinite(step)
    parameters, mean, sigma = (
        np.zeros((N_PARAMETERS, count)),
        np.zeros((N_PARAMETERS, count)),
        np.full((N_PARAMETERS, count), np.inf),
    )
    # The symmetric root of a matrix of two rows: (S + sqrt(det) I) / sqrt(trace + 2 sqrt(det)).
    area = np.sqrt(np.linalg.det(shapes))
    root = (shapes + area[:, None, None] * np.eye(2)) / np.sqrt(np.trace(shapes, axis1=1, axis2=2) + 2 * area)[
        :, None, None
    ]
    inverse = np.linalg.inv(root)
    parameters[2:6] = inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1], np.minimum(USUAL_WIDTH_PX, 0.4 * smaller)
    parameters[6:9], parameters[9] = plane.T, step
    lighter = np.maximum(np.maximum(np.abs(plane[:, 0]), np.abs(inside)), 1.0)
    slope = 0.5 * step / lighter * plane[:, 1:].T
    mean[5], sigma[5] = USUAL_WIDTH_PX, 0.5
    mean[10:] = parameters[10:] = slope
    sigma[10:] = np.hypot(*slope) + SLOPE_FLOOR * np.abs(step)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.nan_to_num((noise / sigma) ** 2, nan=0.0, posinf=0.0)
    return _Start(parameters, mean, weights), usable


def _medians(values: FloatArray, among: BoolArray) -> FloatArray:
    """Return the upper median of some values of each row, shape (n,); NaN of none."""
    ordered = np.sort(np.where(among, values, np.inf), axis=1)
    middle = np.minimum(among.sum(axis=1) // 2, values.shape[1] - 1)
    found = ordered[np.arange(len(values)), middle]
    return np.where(np.isfinite(found), found, np.nan)


def _robust(pixels: _Pixels, start: _Start) -> _Fitted:
    """Settle all fits, and again without the pixels that are dust or glare."""
    fitted = _settle(pixels, start, pixels.used.astype(_SINGLE))
    for _ in range(3):
        kept = pixels.used & ~_dust(pixels, fitted)
        again = np.flatnonzero(fitted.settled & (kept != (fitted.jacobian[:, 6] != 0)).any(axis=1))
        if not again.size:
            break
        some = _Start(fitted.parameters[:, again], start.mean[:, again], start.weights[:, again])
        other = _settle(pixels.chosen(again), some, kept[again].astype(_SINGLE))
        for name in ("residuals", "jacobian", "settled"):
            getattr(fitted, name)[again] = getattr(other, name)
        fitted.parameters[:, again] = other.parameters
    return fitted


def _single(parameters: FloatArray) -> FloatArray:
    """Return parameters, one column for each target, in the precision of the pixels."""
    return parameters[:, :, None].astype(_SINGLE)


def _dust(pixels: _Pixels, fitted: _Fitted) -> BoolArray:
    """Return pixels that are further from the fit than noise, shape (n, k)."""
    size = np.abs(fitted.residuals)
    if (fitted.jacobian[:, 6] != pixels.used).any():
        # Residuals of pixels that took no part are not among those of the fit.
        size = np.abs(pixels.values_dn - disc_model(_single(fitted.parameters), pixels.x, pixels.y)[0])
    limit = np.maximum(
        OUTLIER_SIGMAS * 1.4826 * _medians(size, pixels.used), OUTLIER_CONTRAST * np.abs(fitted.parameters[9])
    )
    return np.asarray(size > limit[:, None])


def _settle(pixels: _Pixels, start: _Start, kept: FloatArray) -> _Fitted:
    """Gauss-Newton steps of all fits at once; each stops by itself, one that climbs or runs away does not settle."""
    count = kept.shape[0]
    parameters, residuals = start.parameters.copy(), np.zeros_like(kept)
    jacobian, settled = (
        np.zeros((count, N_PARAMETERS, kept.shape[1]), dtype=_SINGLE),
        np.zeros(count, dtype=np.bool_),
    )
    radius = (start.parameters[2] * start.parameters[4] - start.parameters[3] ** 2) ** -0.5
    cost, active = np.full(count, np.inf), np.arange(count)
    for _ in range(_MOST_STEPS):
        own = slice(None) if active.size == count else active
        here, mean, prior = parameters[:, own], start.mean[:, own], start.weights[:, own]
        model, derivatives = disc_model(_single(here), pixels.x[own], pixels.y[own])
        weights = kept[own]
        left = (pixels.values_dn[own] - model) * weights
        derivatives = np.moveaxis(derivatives, -1, 1) * weights[:, None]
        now = (left * left).sum(axis=1) + (prior * (mean - here) ** 2).sum(axis=0)
        normal = (derivatives @ np.swapaxes(derivatives, 1, 2)).astype(np.float64)
        normal[:, np.arange(N_PARAMETERS), np.arange(N_PARAMETERS)] += prior.T
        right = (derivatives @ left[:, :, None])[..., 0] + (prior * (mean - here)).T
        try:
            step = np.linalg.solve(normal, right[..., None])[..., 0]
        except np.linalg.LinAlgError:
            break
        moved = here + step.T
        fine = (now <= cost[active] * (1 + 1e-6)) & _plausible(moved, radius[own])
        last = fine & (np.hypot(step[:, 0], step[:, 1]) < ENOUGH_PX)
        ended = active[last]
        residuals[ended] = left[last] - (step[last, None].astype(_SINGLE) @ derivatives[last])[:, 0]
        jacobian[ended], settled[ended] = derivatives[last], True
        parameters[:, active[fine]] = moved[:, fine]
        cost[active] = now
        active = active[fine & ~last]
        if not active.size:
            break
    return _Fitted(parameters, residuals, jacobian, settled)


def _plausible(parameters: FloatArray, reach: FloatArray) -> BoolArray:
    """Return whether ellipses stay near their start, of their size, with an edge narrower than themselves."""
    determinant = parameters[2] * parameters[4] - parameters[3] ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        radius = determinant**-0.5
        near = np.hypot(parameters[0], parameters[1]) < 0.5 * reach + 1
        size = (radius > 0.4 * reach) & (radius < 2.5 * reach)
        edge = (parameters[5] > 0.2) & (parameters[5] < np.maximum(0.8 * radius, 0.6))
    return np.asarray((determinant > 0) & (parameters[2] > 0) & near & size & edge)


def _covariance(pixels: _Pixels, start: _Start, fitted: _Fitted) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return covariances of the centres, residuals per degree of freedom, and whether each disc stands out."""
    jacobian, residuals = fitted.jacobian, fitted.residuals
    used = jacobian[:, 6] != 0
    count = used.sum(axis=1)
    enough = (count >= 2 * N_PARAMETERS) & (count >= 0.6 * pixels.used.sum(axis=1))
    normal = (jacobian @ np.swapaxes(jacobian, 1, 2)).astype(np.float64)
    prior = start.weights.T
    normal[:, np.arange(N_PARAMETERS), np.arange(N_PARAMETERS)] += prior
    # Fits that did not settle have no derivatives.
    normal[~(fitted.settled & enough)] = np.eye(N_PARAMETERS)
    inverse = np.linalg.inv(normal)
    influence = inverse[:, :2].astype(_SINGLE) @ jacobian
    freedom = (count / np.maximum(count - N_PARAMETERS, 1)).astype(_SINGLE)
    square = residuals**2 * freedom[:, None]
    total = square.sum(axis=1) / np.maximum(count, 1)
    coverage = np.clip(jacobian[:, 9], 0.0, 1.0)
    beside = used - coverage
    inside, outside = (
        ((share * square).sum(axis=1) + N_PARAMETERS * total) / (np.maximum(share.sum(axis=1), 1.0) + N_PARAMETERS)
        for share in (coverage, beside)
    )
    noise = outside[:, None] + coverage * (inside - outside)[:, None]
    by_prior = (inverse[:, :2] * prior[:, None]) @ np.swapaxes(inverse[:, :2], 1, 2)
    covariance = (influence * noise[:, None]) @ np.swapaxes(influence, 1, 2) + total[:, None, None] * by_prior
    stands_out = fitted.parameters[9] ** 2 >= LEAST_STEP_SIGMAS**2 * total * inverse[:, 9, 9]
    return covariance, np.sqrt(total), enough & stands_out
