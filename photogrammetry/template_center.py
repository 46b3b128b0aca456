"""Centre of a target by least-squares template matching: the blurred disc that reproduces the pixels best."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, freeze
from photogrammetry.ellipse import Ellipse
from photogrammetry.target_center import REACH, TargetCenter, normalised_radius

__all__ = ["disc_model", "template_center"]

#: Variance of a pixel's own width [px^2]: the projection of a unit square has it in every direction.
_PIXEL_VARIANCE = 1 / 12
#: Pixels farther from the edge than this say nothing about the centre, up to a blur of 2 px [px].
_BAND_PX = 5.0
_MOST_ITERATIONS = 25
#: A step below this share of a pixel ends the iteration: a hundredth of the best centres' sigma.
_ENOUGH_PX, _COARSE_PX = 5e-5, 5e-3
#: Pixels off by more than this many robust sigmas are dust or glare, if also off by this share of the contrast.
_OUTLIER_SIGMAS, _OUTLIER_CONTRAST = 5.0, 0.05
#: Columns of the parameters: centre, inverse frame, edge width, outside plane, inside minus outside plane.
_N_PARAMETERS = 12
#: Width of an edge before it is measured, known to 0.5 px: it keeps discs of a few pixels from running away.
_USUAL_WIDTH_PX = 0.75
_SMALL_PX = 5.0
#: Slope of inside minus outside that is always allowed, per pixel, as a share of the contrast. On discs of 6 px a free
#: slope doubles the centre's sigma (0.0042 px instead of 0.0022 at SNR 200); this floor costs 0.001 px.
_SLOPE_FLOOR = 0.0003


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    x: FloatArray
    y: FloatArray
    values_dn: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Prior:
    """What is known of the parameters before: mean, and noise variance over own variance (0: nothing)."""

    mean: FloatArray
    weights: FloatArray


def normal_distribution(z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cumulative normal distribution and density; Abramowitz and Stegun 7.1.26, error below 1e-7.

    scipy.special has it to round-off, but its import costs more than all centres of a photo.
    """
    bell = np.exp(-0.5 * z * z)
    t = 1.0 / (1.0 + 0.3275911 / np.sqrt(2.0) * np.abs(z))
    tail = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429)))) * bell
    return np.where(z > 0, 1 - 0.5 * tail, 0.5 * tail), bell / np.sqrt(2 * np.pi)


def disc_model(parameters: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the grey values of a blurred elliptic disc on a plane, with their derivatives.

    Parameters
    ----------
    parameters : ndarray, shape (12,)
        Centre (x, y); m11, m12, m22 of the symmetric M that maps the ellipse onto the unit circle; standard deviation s
        of the edge with the pixel's width; plane outside (level at the origin of x and y, slopes); inside minus
        outside (level, slopes).
    x, y : ndarray, shape (n,)
        Pixels.

    Returns
    -------
    values_dn : ndarray, shape (n,)
        Grey values [DN].
    d_values_d_parameters : ndarray, shape (n, 12)
        Their derivatives.

    Notes
    -----
    With u = M (x - c), q = |u| and g = |M u|, the signed distance from the edge is d = (q - q^2) / g, exact for circles
    and to first order for ellipses. The coverage is P(d / s) + (n_x^4 + n_y^4) (z^3 - 3 z) p(z) / (2880 s^4): a
    Gaussian edge of the same variance as blur and pixel square together, and the next term of the Edgeworth series,
    which the square contributes because it is no Gaussian (its cumulant along the normal n is
    -(n_x^4 + n_y^4) / 120 px^4).
    """
    cx, cy, m11, m12, m22, s = parameters[:6]
    dx, dy = x - cx, y - cy
    ux, uy = m11 * dx + m12 * dy, m12 * dx + m22 * dy
    q = np.maximum(np.sqrt(ux * ux + uy * uy), 1e-9)
    vx, vy = m11 * ux + m12 * uy, m12 * ux + m22 * uy
    g = np.maximum(np.sqrt(vx * vx + vy * vy), 1e-12)
    distance = (q - q * q) / g
    z = distance / s
    cumulative, bell = normal_distribution(z)
    normal4 = (vx**4 + vy**4) / g**4
    square = normal4 / (2880 * s**4)
    z2 = z * z
    coverage = cumulative + square * (z2 - 3) * z * bell
    d_coverage_d_z = bell * (1 + square * (-3 + 6 * z2 - z2 * z2))
    outside = parameters[6] + parameters[7] * x + parameters[8] * y
    step = parameters[9] + parameters[10] * x + parameters[11] * y

    # d q = u.du / q,  d g = v.d(M u) / g,  du = dM (x - c) - M dc,  d(M u) = dM u + M du
    d_q = np.stack([-vx, -vy, ux * dx, ux * dy + uy * dx, uy * dy], axis=1) / q[:, None]
    wx, wy = m11 * vx + m12 * vy, m12 * vx + m22 * vy  # M v
    d_g = (
        np.stack(
            [
                -(m11 * wx + m12 * wy),
                -(m12 * wx + m22 * wy),
                vx * ux + wx * dx,
                vx * uy + vy * ux + wx * dy + wy * dx,
                vy * uy + wy * dy,
            ],
            axis=1,
        )
        / g[:, None]
    )
    d_distance = ((1 - 2 * q) / g)[:, None] * d_q - (distance / g)[:, None] * d_g
    jacobian = np.empty((len(x), _N_PARAMETERS))
    along_z = step * d_coverage_d_z / s
    jacobian[:, :5] = along_z[:, None] * d_distance
    jacobian[:, 5] = -along_z * z - step * 4 * square / s * (z2 - 3) * z * bell
    jacobian[:, 6], jacobian[:, 7], jacobian[:, 8] = 1.0, x, y
    jacobian[:, 9], jacobian[:, 10], jacobian[:, 11] = coverage, coverage * x, coverage * y
    return outside + step * coverage, jacobian


def template_center(window_dn: npt.NDArray[np.float64], start: Ellipse) -> TargetCenter:
    """Measure a target's centre by fitting a blurred elliptic disc on a plane to the pixels.

    Parameters
    ----------
    window_dn : ndarray of float64, shape (h, w)
        Grey values [DN].
    start : Ellipse
        The outline to half a pixel or so, in the window's pixels.

    Returns
    -------
    TargetCenter
        Centre with covariance, outline, blur, contrast.

    Raises
    ------
    EstimationError
        Too few pixels, no contrast, or the fit ran away from its start.

    Notes
    -----
    Levels inside and outside are planes of their own, so neither shading nor a slope of the ground shifts the centre.
    Used are the pixels within 1.65 radii (a code ring begins at 2) and not far inside. Dust and glare are left out: 5
    robust sigmas and 5 % of the contrast. The covariance takes the residuals' variance, that of the inside and of the
    outside apart, because photon noise differs.
    """
    if start.semi_axes_px[1] < _SMALL_PX:
        # On small discs the choice of pixels matters: choose them by a first, coarse fit, not by the start.
        start = _fit(window_dn, start, enough_px=_COARSE_PX).ellipse
    return _fit(window_dn, start, enough_px=_ENOUGH_PX)


def _fit(window_dn: FloatArray, start: Ellipse, *, enough_px: float) -> TargetCenter:
    pixels, parameters, prior = _start(window_dn, start)
    weights = np.ones(len(pixels.x))
    parameters, residuals, jacobian = _adjust(pixels, parameters, weights, prior, enough_px=enough_px)
    wrong = _outliers(residuals, parameters)
    for _ in range(3):
        if not wrong.any():
            break
        weights = np.where(wrong, 0.0, 1.0)
        parameters, residuals, jacobian = _adjust(pixels, parameters, weights, prior, enough_px=enough_px)
        again = _outliers(residuals, parameters)
        if np.array_equal(again, wrong):
            break
        wrong = again
    return _result(start, parameters, residuals, (jacobian, weights > 0, prior))


def _start(window_dn: FloatArray, start: Ellipse) -> tuple[_Pixels, FloatArray, _Prior]:
    radius = normalised_radius(window_dn.shape, start)
    smaller = start.semi_axes_px[1]
    width = min(_USUAL_WIDTH_PX, 0.4 * smaller)
    band = _BAND_PX / smaller
    rows, columns = np.nonzero((radius > 1 - band) & (radius < min(REACH, 1 + band)))
    if len(rows) < 2 * _N_PARAMETERS:
        raise EstimationError(f"{len(rows)} pixels show the target's edge; a template needs {2 * _N_PARAMETERS}")
    values, near = window_dn[rows, columns], radius[rows, columns]
    x, y = columns - start.center_px[0], rows - start.center_px[1]
    far, core = near > 1 + min(0.25, 2 / smaller), near < 1 - min(0.2, 2 / smaller)
    if np.count_nonzero(core) < 3 or np.count_nonzero(far) < 8:
        raise EstimationError("the target covers too few pixels to tell its level from the ground's")
    planes = np.stack([np.ones(np.count_nonzero(far)), x[far], y[far]], axis=1)
    plane = np.linalg.lstsq(planes, values[far], rcond=None)[0]
    noise = max(float(np.median(np.abs(values[far] - planes @ plane))) * 1.4826, 0.3)
    inside = float(np.median(values[core]))
    step = inside - plane[0]
    if step == 0:
        raise EstimationError("the target has no contrast against its ground")
    parameters, mean, sigma = np.zeros(_N_PARAMETERS), np.zeros(_N_PARAMETERS), np.full(_N_PARAMETERS, np.inf)
    inverse = np.linalg.inv(start.frame_px)
    parameters[2:6] = inverse[0, 0], inverse[0, 1], inverse[1, 1], width
    parameters[6:9], parameters[9] = plane, step
    # Shading multiplies (the dark side slopes less) or adds (both slope alike): half way, with that as its sigma.
    lighter = max(abs(plane[0]), abs(inside), 1.0)
    half = 0.5 * abs(step) / lighter * plane[1:]
    mean[5], sigma[5] = _USUAL_WIDTH_PX, 0.5
    mean[10:] = -half if step < 0 else half
    sigma[10:] = np.hypot(*half) + _SLOPE_FLOOR * abs(step)
    parameters[10:] = mean[10:]
    return _Pixels(x, y, values), parameters, _Prior(mean, (noise / sigma) ** 2)


def _adjust(
    pixels: _Pixels, parameters: FloatArray, weights: FloatArray, prior: _Prior, *, enough_px: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Levenberg-Marquardt; returns parameters, residuals and Jacobian at the solution."""

    def evaluate(trial: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        model, jacobian = disc_model(trial, pixels.x, pixels.y)
        residuals = pixels.values_dn - model
        off = prior.mean - trial
        return residuals, jacobian, float(residuals @ (weights * residuals) + off @ (prior.weights * off))

    residuals, jacobian, cost = evaluate(parameters)
    damping = 0.0
    reach = 1 / np.sqrt(max(abs(parameters[2] * parameters[4] - parameters[3] ** 2), 1e-12))
    for _ in range(_MOST_ITERATIONS):
        weighted = jacobian * weights[:, None]
        normal = weighted.T @ jacobian + np.diag(prior.weights)
        right = weighted.T @ residuals + prior.weights * (prior.mean - parameters)
        normal[np.diag_indices(_N_PARAMETERS)] *= 1 + damping
        try:
            step = np.linalg.solve(normal, right)
        except np.linalg.LinAlgError:
            damping = max(damping * 10, 1e-3)
            continue
        small = float(np.hypot(step[0], step[1])) < enough_px and damping < 1e-2
        if small:
            return parameters, residuals, jacobian
        if _plausible(parameters + step, reach):
            trial = evaluate(parameters + step)
            # A rise by a millionth is round-off or a step along a direction that hardly matters.
            if trial[2] <= cost * (1 + 1e-6):
                parameters = parameters + step
                residuals, jacobian, cost = trial
                damping = 0.1 * damping if damping > 1e-6 else 0.0
                continue
        damping = max(damping * 10, 1e-3)
    raise EstimationError(f"the template did not settle within {_MOST_ITERATIONS} steps; the spot is no blurred disc")


def _plausible(parameters: FloatArray, reach: float) -> bool:
    """Whether the ellipse stays near its start, of its size, with an edge narrower than itself."""
    determinant = parameters[2] * parameters[4] - parameters[3] ** 2
    if not (determinant > 0 and parameters[2] > 0):
        return False
    radius = determinant**-0.5
    return (
        float(np.hypot(parameters[0], parameters[1])) < 0.5 * reach + 1
        and 0.4 < radius / reach < 2.5
        and 0.2 < parameters[5] < max(0.8 * radius, 0.6)
    )


def _outliers(residuals: FloatArray, parameters: FloatArray) -> BoolArray:
    size = np.abs(residuals)
    limit = max(_OUTLIER_SIGMAS * 1.4826 * float(np.median(size)), _OUTLIER_CONTRAST * abs(parameters[9]))
    return np.asarray(size > limit)


def _result(
    start: Ellipse, parameters: FloatArray, residuals: FloatArray, linear: tuple[FloatArray, BoolArray, _Prior]
) -> TargetCenter:
    jacobian, used, prior = linear
    count = int(np.count_nonzero(used))
    if count < 2 * _N_PARAMETERS or count < 0.6 * len(used):
        raise EstimationError(f"{len(used) - count} of {len(used)} pixels do not fit a blurred disc: partly covered?")
    jacobian, residuals = jacobian[used], residuals[used]
    coverage = np.clip(jacobian[:, 9], 0.0, 1.0)
    try:
        inverse = np.linalg.inv(jacobian.T @ jacobian + np.diag(prior.weights))
    except np.linalg.LinAlgError:
        raise EstimationError("the pixels do not determine the disc") from None
    influence = inverse[:2] @ jacobian.T
    square = residuals**2 * (count / (count - _N_PARAMETERS))
    total = float(square.mean())
    # Two variances, inside and outside, mixed by coverage; a side with a handful of pixels leans on the mean.
    share = np.array([max(float(coverage.sum()), 1.0), max(float((1 - coverage).sum()), 1.0)])
    variances = np.array([float(coverage @ square), float((1 - coverage) @ square)])
    inside, outside = (variances + _N_PARAMETERS * total) / (share + _N_PARAMETERS)
    noise = outside + coverage * (inside - outside)
    m11, m12, m22 = parameters[2:5]
    frame = np.array([[m22, -m12], [-m12, m11]]) / (m11 * m22 - m12 * m12)
    level, slope = parameters[[6, 9]], parameters[[7, 8, 10, 11]].reshape(2, 2)
    outside_dn, step = level + slope @ parameters[:2]
    return TargetCenter(
        Ellipse(start.center_px + parameters[:2], frame @ frame),
        # What the prior does not know counts as noise of its own.
        freeze((influence * noise) @ influence.T + total * (inverse[:2] * prior.weights) @ inverse[:2].T),
        float(step),
        float(outside_dn + step),
        float(np.sqrt(max(parameters[5] ** 2 - _PIXEL_VARIANCE, 0.0))),
        float(np.sqrt(total)),
        count,
    )
