"""Centre of a target by least-squares template matching: the blurred disc that reproduces the pixels best."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.validate import BoolArray, FloatArray, freeze
from photogrammetry.centers.ellipse import Ellipse
from photogrammetry.centers.operator import REACH, TargetCenter, UnmeasuredTargetError, cut_window, normalised_radius

#: Variance of a pixel's own width [px^2]: the projection of a unit square has it in every direction.
PIXEL_VARIANCE = 1 / 12
#: Pixels farther from the edge than this say nothing about the centre, up to a blur of 1.5 px [px].
BAND_PX = 4.0
_MOST_ITERATIONS = 25
#: A step of the centre below this is taken and is the last one [px]: the next would be some thirty times smaller, a
#: hundredth of the best centres' sigma.
ENOUGH_PX, _COARSE_PX = 1e-3, 2e-2
#: Pixels off by more than this many robust sigmas are dust or glare, if also off by this share of the contrast.
OUTLIER_SIGMAS, OUTLIER_CONTRAST = 5.0, 0.05
#: Columns of the parameters: centre, inverse frame, edge width, outside plane, inside minus outside plane.
N_PARAMETERS = 12
#: Width of an edge before it is measured, known to 0.5 px: it keeps discs of a few pixels from running away.
USUAL_WIDTH_PX = 0.75
_SMALL_PX = 5.0
#: Slope of inside minus outside that is always allowed, per pixel, as a share of the contrast. On discs of 6 px a free
#: slope doubles the centre's sigma (0.0042 px instead of 0.0022 at SNR 200); this floor costs 0.001 px.
SLOPE_FLOOR = 0.0003
#: Pixels that are fitted together: some ten arrays of this length stay in the second-level cache.
_GROUP_PIXELS = 6000
#: Contrast in units of its own sigma below which there is nothing; in pure noise the best disc has up to five.
LEAST_STEP_SIGMAS = 8.0
_NOT_YET = EstimationError("not measured")


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
    t = 1.0 / (1.0 + 0.3275911 / math.sqrt(2.0) * np.abs(z))
    tail = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429)))) * bell
    tail *= 0.5
    bell *= 1 / math.sqrt(2 * math.pi)
    return np.where(z > 0, 1 - tail, tail), bell


def disc_model(parameters: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the grey values of a blurred elliptic disc on a plane, with their derivatives.

    Shapes: x, y (n,) or (k, n), values_dn (n,) or (k, n), d_values_d_parameters (n, 12) or (k, n, 12).
    parameters (12,): Of one disc, of the disc that each pixel belongs to, or of k discs with n pixels each. Centre
        (x, y); m11, m12, m22 of the symmetric M that maps the ellipse onto the unit circle; standard deviation s of
        the edge with the pixel's width; plane outside (level at the origin of x and y, slopes); inside minus
        outside (level, slopes).

    With ``u = M (x - c)``, ``q = |u|`` and ``g = |M u|``, the signed distance from the edge is d = (q - q^2) / g,
    exact
    for circles and to first order for ellipses. The coverage is P(d / s) + (n_x^4 + n_y^4) (z^3 - 3 z) p(z) /
    (2880 s^4): a Gaussian edge of the same variance as blur and pixel square together, and the next term of the
    Edgeworth series, which the square contributes because it is no Gaussian (its cumulant along the normal n is
    -(n_x^4 + n_y^4) / 120 px^4). Here d is the distance less k s^2 / 2: blur moves the middle level of an edge of
    curvature k = (det M)^2 q^3 / g^3 towards the centre of its curvature. Without it discs of 6 px at a blur of 0.5
    px
    are measured 1.9 % too small, and 12 px ones 0.5 %.
    """
    cx, cy, m11, m12, m22, s = parameters[:6]
    dx, dy = x - cx, y - cy
    ux, uy = m11 * dx + m12 * dy, m12 * dx + m22 * dy
    q = np.maximum(np.sqrt(ux * ux + uy * uy), 1e-9)
    vx, vy = m11 * ux + m12 * uy, m12 * ux + m22 * uy
    per_g = 1 / np.maximum(np.sqrt(vx * vx + vy * vy), 1e-12)
    nx2, ny2 = (vx * per_g) ** 2, (vy * per_g) ** 2
    distance = (q - q * q) * per_g
    determinant = m11 * m22 - m12 * m12
    ratio = q * per_g
    # s times the curvature, times its half: blur moves the edge by that much.
    shift = ratio * ratio * ratio
    shift *= 0.5 * s * (determinant * determinant)
    z = distance / s - shift
    cumulative, bell = normal_distribution(z)
    square = nx2 * nx2 + ny2 * ny2
    square /= 2880 * s**4
    z2 = z * z
    skewed = (z2 - 3) * z * bell * square
    coverage = cumulative + skewed
    outside = parameters[6] + parameters[7] * x + parameters[8] * y
    step = parameters[9] + parameters[10] * x + parameters[11] * y

    jacobian = np.empty((N_PARAMETERS, *x.shape), dtype=coverage.dtype)
    along_z = bell * (1 + square * (-3 + 6 * z2 - z2 * z2))
    along_z *= step / s
    jacobian[5] = -along_z * (z + 2 * shift) - 4 / s * step * skewed
    # d q = u.du / q,  d g = v.d(M u) / g,  du = dM (x - c) - M dc,  d(M u) = dM u + M du; of distance - s shift both.
    bend = 3 * s * shift
    by_u = along_z * (((1 - 2 * q) * per_g - bend / q) / q)
    by_v = along_z * ((bend - distance) * per_g * per_g)
    ax, ay, bx, by = by_u * ux, by_u * uy, by_v * vx, by_v * vy
    wx, wy = m11 * bx + m12 * by, m12 * bx + m22 * by
    tx, ty = ax + wx, ay + wy
    jacobian[0], jacobian[1] = -(m11 * tx + m12 * ty), -(m12 * tx + m22 * ty)
    jacobian[2] = bx * ux + tx * dx
    jacobian[3] = bx * uy + by * ux + tx * dy + ty * dx
    jacobian[4] = by * uy + ty * dy
    along_z *= 2 / 3 / determinant * bend
    jacobian[2] -= m22 * along_z
    jacobian[3] += 2 * m12 * along_z
    jacobian[4] -= m11 * along_z
    jacobian[6], jacobian[7], jacobian[8] = 1.0, x, y
    jacobian[9], jacobian[10], jacobian[11] = coverage, coverage * x, coverage * y
    outside += step * coverage
    return outside, np.moveaxis(jacobian, 0, -1)


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
    found = _centers([(window_dn, start)], REACH)[0]
    if isinstance(found, EstimationError):
        raise found
    return found


def template_centers(
    image_dn: npt.NDArray[np.generic], starts: Sequence[Ellipse], reach: float = REACH
) -> tuple[TargetCenter | EstimationError, ...]:
    """Measure the centres of all targets of a photo, several at a time: the same numbers as one by one, but faster.

    image_dn (h, w): Grey values [DN].
    starts: The outlines to half a pixel or so, in the photo's pixels.
    reach: How far from the centre pixels are used, in radii of the dot: code rings must begin beyond.
    Returns: One for each start, in the photo's pixels; why there is no centre otherwise.
    """
    found: list[TargetCenter | EstimationError] = []
    origins: list[FloatArray] = []
    windows: list[tuple[FloatArray, Ellipse]] = []
    at: list[int] = []
    for start in starts:
        try:
            window = cut_window(image_dn, start, reach)
        except EstimationError as error:
            found.append(error)
            continue
        origins.append(np.array(window.origin_px, dtype=np.float64))
        windows.append((window.values_dn, start.moved(-origins[-1])))
        at.append(len(found))
        found.append(EstimationError("not measured"))
    for k, origin, center in zip(at, origins, _centers(windows, reach), strict=True):
        found[k] = center if isinstance(center, EstimationError) else center.moved(origin)
    return tuple(found)


def _centers(windows: Sequence[tuple[FloatArray, Ellipse]], reach: float) -> list[TargetCenter | EstimationError]:
    windows = list(windows)
    found: list[TargetCenter | EstimationError] = [_NOT_YET] * len(windows)
    # On small discs the choice of pixels matters: choose them by a first, coarse fit, not by the start.
    small = [k for k, (_, start) in enumerate(windows) if start.semi_axes_px[1] < _SMALL_PX]
    for k, coarse in zip(small, _fits([windows[k] for k in small], reach, _COARSE_PX), strict=True):
        found[k] = coarse
        if isinstance(coarse, TargetCenter):
            windows[k] = windows[k][0], coarse.ellipse
    left = [k for k in range(len(windows)) if k not in small or isinstance(found[k], TargetCenter)]
    for k, fine in zip(left, _fits([windows[k] for k in left], reach, ENOUGH_PX), strict=True):
        found[k] = fine
    return found


def _fits(
    windows: Sequence[tuple[FloatArray, Ellipse]], reach: float, enough_px: float
) -> list[TargetCenter | EstimationError]:
    """Fit discs, a few thousand pixels at a time: so many stay in the processor's cache."""
    started: list[_Fit | EstimationError] = []
    group: list[_Fit] = []
    for window, start in windows:
        try:
            fit = _start(window, start, reach)
        except EstimationError as error:
            started.append(error)
            continue
        started.append(fit)
        group.append(fit)
        if sum(len(one.x) for one in group) > _GROUP_PIXELS:
            _robust(group, enough_px)
            group = []
    _robust(group, enough_px)
    return [fit if isinstance(fit, EstimationError) else fit.result() for fit in started]


def _robust(group: Sequence["_Fit"], enough_px: float) -> None:
    """Settle the fits of a group, and again without the pixels that are dust or glare."""
    active = list(group)
    for _ in range(4):
        _settle(active, enough_px)
        again = []
        for fit in active:
            wrong = _outliers(fit.residuals, fit.parameters)
            if fit.failure is None and not np.array_equal(wrong, fit.weights == 0):
                fit.weights = np.where(wrong, 0.0, 1.0)
                again.append(fit)
        active = again


@dataclass(slots=True, eq=False)
class _Fit:
    """One disc on its way to its pixels."""

    start: Ellipse
    x: FloatArray
    y: FloatArray
    values_dn: FloatArray
    prior: _Prior
    parameters: FloatArray
    weights: FloatArray
    size_px: float
    residuals: FloatArray
    jacobian: FloatArray
    cost: float = 0.0
    damping: float = 0.0
    failure: EstimationError | None = None

    def weigh(self, residuals: FloatArray, parameters: FloatArray) -> float:
        off = self.prior.mean - parameters
        return float(residuals @ (self.weights * residuals) + off @ (self.prior.weights * off))

    def take(self, step: FloatArray) -> None:
        """Make a step so small that the model is linear in it."""
        self.parameters = self.parameters + step
        self.residuals = self.residuals - self.jacobian @ step

    def normal_equations(self) -> tuple[FloatArray, FloatArray]:
        weighted = self.jacobian.T * self.weights
        normal = weighted @ self.jacobian
        normal[np.diag_indices(N_PARAMETERS)] += self.prior.weights
        normal[np.diag_indices(N_PARAMETERS)] *= 1 + self.damping
        return normal, weighted @ self.residuals + self.prior.weights * (self.prior.mean - self.parameters)

    def result(self) -> TargetCenter | EstimationError:
        if self.failure is not None:
            return self.failure
        try:
            return _result(self.start, self.parameters, self.residuals, (self.jacobian, self.weights > 0, self.prior))
        except EstimationError as error:
            return error


def _start(window_dn: FloatArray, start: Ellipse, reach: float) -> _Fit:
    radius = normalised_radius(window_dn.shape, start)
    smaller = start.semi_axes_px[1]
    width = min(USUAL_WIDTH_PX, 0.4 * smaller)
    band = BAND_PX / smaller
    rows, columns = np.nonzero((radius > 1 - band) & (radius < min(reach, 1 + band)))
    if len(rows) < 2 * N_PARAMETERS:
        raise UnmeasuredTargetError(
            SampleFlag.TOO_SMALL, f"{len(rows)} pixels show the target's edge; a template needs {2 * N_PARAMETERS}"
        )
    values, near = window_dn[rows, columns], radius[rows, columns]
    x, y = columns - start.center_px[0], rows - start.center_px[1]
    far, core = near > 1 + min(0.25, 2 / smaller), near < 1 - min(0.2, 2 / smaller)
    if np.count_nonzero(core) < 3 or np.count_nonzero(far) < 8:
        raise UnmeasuredTargetError(
            SampleFlag.TOO_SMALL, "the target covers too few pixels to tell its level from the ground's"
        )
    planes = np.stack([np.ones(np.count_nonzero(far)), x[far], y[far]])
    plane = np.linalg.solve(planes @ planes.T + 1e-9 * np.eye(3), planes @ values[far])
    noise = max(_median(np.abs(values[far] - plane @ planes)) * 1.4826, 0.3)
    inside = _median(values[core])
    step = inside - plane[0]
    if step == 0:
        raise EstimationError("the target has no contrast against its ground")
    parameters, mean, sigma = np.zeros(N_PARAMETERS), np.zeros(N_PARAMETERS), np.full(N_PARAMETERS, np.inf)
    inverse = np.linalg.inv(start.frame_px)
    parameters[2:6] = inverse[0, 0], inverse[0, 1], inverse[1, 1], width
    parameters[6:9], parameters[9] = plane, step
    # Shading multiplies (the dark side slopes less) or adds (both slope alike): half way, with that as its sigma.
    lighter = max(abs(plane[0]), abs(inside), 1.0)
    half = 0.5 * abs(step) / lighter * plane[1:]
    mean[5], sigma[5] = USUAL_WIDTH_PX, 0.5
    mean[10:] = -half if step < 0 else half
    sigma[10:] = np.hypot(*half) + SLOPE_FLOOR * abs(step)
    parameters[10:] = mean[10:]
    prior = _Prior(mean, (noise / sigma) ** 2)
    empty = np.empty(0)
    return _Fit(start, x, y, values, prior, parameters, np.ones(len(x)), start.radius_px, empty, empty)


def _median(values: FloatArray) -> float:
    """Upper median; numpy's own takes five times as long on a few hundred values."""
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])


def _settle(fits: Sequence[_Fit], enough_px: float) -> None:
    """Levenberg-Marquardt for all fits at once; each stops by itself."""
    fresh = [fit for fit in fits if len(fit.residuals) == 0]
    for fit, residuals, jacobian in _evaluated(fresh, [fit.parameters for fit in fresh]):
        fit.residuals, fit.jacobian = residuals, jacobian
    for fit in fits:
        fit.damping, fit.cost = 0.0, fit.weigh(fit.residuals, fit.parameters)
    active = list(fits)
    for _ in range(_MOST_ITERATIONS):
        waiting, moved, trials = [], [], []
        for fit, step in zip(active, _steps(active), strict=True):
            plausible = _plausible(fit.parameters + step, fit.size_px)
            if plausible and float(np.hypot(step[0], step[1])) < enough_px and fit.damping < 1e-2:
                fit.take(step)
                continue
            waiting.append(fit)
            if plausible:
                moved.append(fit)
                trials.append(fit.parameters + step)
            else:
                fit.damping = max(fit.damping * 10, 1e-3)
        for (fit, residuals, jacobian), trial in zip(_evaluated(moved, trials), trials, strict=True):
            cost = fit.weigh(residuals, trial)
            # A rise by a millionth is round-off or a step along a direction that hardly matters.
            if cost <= fit.cost * (1 + 1e-6):
                fit.parameters, fit.residuals, fit.jacobian, fit.cost = trial, residuals, jacobian, cost
                fit.damping = 0.1 * fit.damping if fit.damping > 1e-6 else 0.0
            else:
                fit.damping = max(fit.damping * 10, 1e-3)
        active = waiting
        if not active:
            return
    for fit in active:
        fit.failure = UnmeasuredTargetError(
            SampleFlag.PARTLY_COVERED,
            f"the template did not settle within {_MOST_ITERATIONS} steps; the spot is no blurred disc",
        )


def _evaluated(fits: Sequence[_Fit], trials: Sequence[FloatArray]) -> list[tuple[_Fit, FloatArray, FloatArray]]:
    """Residuals and Jacobians of fits at trial parameters."""
    if not fits:
        return []
    counts = [len(fit.x) for fit in fits]
    ends = np.cumsum(counts)
    parameters = np.repeat(np.stack(trials, axis=1), counts, axis=1)
    model, jacobian = disc_model(
        parameters, np.concatenate([fit.x for fit in fits]), np.concatenate([fit.y for fit in fits])
    )
    parts = zip(fits, ends - counts, ends, strict=True)
    return [(fit, fit.values_dn - model[a:b], jacobian[a:b]) for fit, a, b in parts]


def _steps(fits: Sequence[_Fit]) -> FloatArray:
    """Return the steps of all fits, shape (n, 12)."""
    equations = [fit.normal_equations() for fit in fits]
    normal = np.array([one for one, _ in equations]).reshape(-1, N_PARAMETERS, N_PARAMETERS)
    right = np.array([one for _, one in equations]).reshape(-1, N_PARAMETERS, 1)
    try:
        return np.asarray(np.linalg.solve(normal, right)[..., 0])
    except np.linalg.LinAlgError:
        return np.asarray((np.linalg.pinv(normal, hermitian=True) @ right)[..., 0])


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
    limit = max(OUTLIER_SIGMAS * 1.4826 * _median(size), OUTLIER_CONTRAST * abs(parameters[9]))
    return np.asarray(size > limit)


def _result(
    start: Ellipse, parameters: FloatArray, residuals: FloatArray, linear: tuple[FloatArray, BoolArray, _Prior]
) -> TargetCenter:
    jacobian, used, prior = linear
    count = int(np.count_nonzero(used))
    if count < 2 * N_PARAMETERS or count < 0.6 * len(used):
        raise UnmeasuredTargetError(
            SampleFlag.PARTLY_COVERED,
            f"{len(used) - count} of {len(used)} pixels do not fit a blurred disc: partly covered?",
        )
    jacobian, residuals = jacobian[used], residuals[used]
    coverage = np.clip(jacobian[:, 9], 0.0, 1.0)
    try:
        inverse = np.linalg.inv(jacobian.T @ jacobian + np.diag(prior.weights))
    except np.linalg.LinAlgError:
        raise EstimationError("the pixels do not determine the disc") from None
    influence = inverse[:2] @ jacobian.T
    square = residuals**2 * (count / (count - N_PARAMETERS))
    total = float(square.mean())
    if parameters[9] ** 2 < LEAST_STEP_SIGMAS**2 * total * inverse[9, 9]:
        raise EstimationError(
            f"a contrast of {abs(parameters[9]):.1f} DN does not stand out from noise of {total**0.5:.1f} DN"
        )
    # Two variances, inside and outside, mixed by coverage; a side with a handful of pixels leans on the mean.
    share = np.array([max(float(coverage.sum()), 1.0), max(float((1 - coverage).sum()), 1.0)])
    variances = np.array([float(coverage @ square), float((1 - coverage) @ square)])
    inside, outside = (variances + N_PARAMETERS * total) / (share + N_PARAMETERS)
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
        float(np.sqrt(max(parameters[5] ** 2 - PIXEL_VARIANCE, 0.0))),
        float(np.sqrt(total)),
        count,
    )
