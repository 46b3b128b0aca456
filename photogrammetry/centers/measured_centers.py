"""Centres of targets by least-squares template matching: the blurred discs that reproduce the pixels best.

The pixels of many targets form one array, and every step is one operation on it: one by one a dozen discs of a few
hundred pixels take longer than decoding their photo, most of it in calls. One target is a batch of one.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.adjust.robust_scale import SIGMA_PER_MAD
from heliogauge.adjust.small_fits import Descent, SmallFits, descend
from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.validate import BoolArray, FloatArray, IntArray, freeze
from photogrammetry.centers.disc_model import N_PARAMETERS, disc_model
from photogrammetry.centers.edge_noise import HARMONICS, edge_powers
from photogrammetry.centers.ellipse import Ellipse
from photogrammetry.centers.target_center import REACH, TargetCenter, UnmeasuredTargetError

#: Variance of a pixel's own width [px^2]: the projection of a unit square has it in every direction.
_PIXEL_VARIANCE = 1 / 12
#: Pixels farther from the edge than this say nothing about the centre, up to a blur of 1.5 px; beyond, so many blurs of
#: it. Holes and marks in the middle of a dot lie farther in than this share of it [px].
_BAND_PX, _SHARP_PX, _BAND_BLURS, _MOST_BAND = 4.0, 1.5, 3.0, 0.5
#: Pixels off by more than this many robust sigmas are dust or glare, if also off by this share of the contrast.
_OUTLIER_SIGMAS, _OUTLIER_CONTRAST = 5.0, 0.05
#: Sectors into which an outline is divided, and separate runs of sectors with outliers from which these are no dust but
#: how all the photo's edges are: the steps of a display's pixels. Photos of drawn displays have 2 to 6 (median of the
#: targets), with a dozen specks of dust for each target 1.
_SECTORS, _STEPPED_RUNS = 24, 2
#: Width of an edge before it is measured, known to 0.5 px: it keeps discs of a few pixels from running away.
_USUAL_WIDTH_PX = 0.75
_SMALL_PX = 5.0
#: Slope of inside minus outside that is always allowed, per pixel, as a share of the contrast. On discs of 6 px a free
#: slope doubles the centre's sigma (0.0042 px instead of 0.0022 at SNR 200); this floor costs 0.001 px.
_SLOPE_FLOOR = 0.0003
#: Contrast over level below which there is nothing but the round-off of numbers in single precision.
_LEAST_STEP = 1e-5
#: Contrast in units of its own sigma below which there is nothing; in pure noise the best disc has up to five.
_LEAST_STEP_SIGMAS = 8.0
#: A centre that moves farther than this from its start is fitted again, with the pixels that then are its own. Without,
#: centres of discs of 10 px err by 0.00442 px, with fits from the final place by 0.00430 px (sigma 0.006 px) [radii].
_MOVED_RADII = 0.1


@dataclass(frozen=True, slots=True)
class _Effort:
    """How a batch is fitted.

    precision: Of pixels, model and derivatives; equations are in double. Single takes two thirds of the time of double
        and costs 2e-6 px.
    most_steps: Steps within which a fit must end.
    enough_px: A step of the centre below this is taken and is the last one [px]: the next would be some thirty times
        smaller, a hundredth of the best centres' sigma.
    persistent: Damp a step that climbs or runs away; else such a fit does not settle.
    rejects: Whether dust and glare are left out.
    band_px: Distance from the edge within which pixels are used [px].
    width_px: Width of an edge before it is measured [px].
    pixels_at_once: Pixels of windows that are fitted together: with fewer the calls cost more than is gained by what
        stays in the caches.
    """

    precision: np.dtype[Any]
    most_steps: int
    enough_px: float
    persistent: bool
    pixels_at_once: int
    rejects: bool = True
    band_px: float = _BAND_PX
    width_px: float = _USUAL_WIDTH_PX

    @property
    def descent(self) -> Descent:
        """How the fits descend."""
        return Descent(
            self.most_steps,
            0.0,
            0.1,
            10.0,
            least=1e-3,
            gone=1e-6,
            rise=1e-6,
            linear_below=1e-2,
            persistent=self.persistent,
        )


_CAREFUL = _Effort(np.dtype(np.float32), 25, 1e-3, True, 40_000)
_COARSE = replace(_CAREFUL, enough_px=2e-2)
_QUICK = _Effort(np.dtype(np.float32), 8, 1e-3, False, 80_000)
#: What a quick fit gives of each target.
_TAKEN = ("centers_px", "shapes_px2", "covariance_px2", "contrast_dn", "inside_dn", "residual_dn", "edge_powers")


def measure_center(image_dn: npt.NDArray[np.generic], start: Ellipse, reach: float = REACH) -> TargetCenter:
    """Measure a target's centre by fitting a blurred elliptic disc on a plane to the pixels.

    image_dn (h, w): Grey values [DN].
    start: The outline to half a pixel or so.
    reach: How far from the centre pixels are used, in radii of the dot: code rings must begin beyond.
    Returns: Centre with covariance, outline, blur, contrast.
    EstimationError: The target touches the border, too few pixels, no contrast, or the fit ran away from its start.

    Levels inside and outside are planes of their own, so neither shading nor a slope of the ground shifts the centre.
    Used are the pixels within 1.65 radii (a code ring begins at 2) and not far inside. Dust and glare are left out: 5
    robust sigmas and 5 % of the contrast. The covariance takes the residuals' variance, that of the inside and of the
    outside apart, because photon noise differs.
    """
    found = measure_centers(image_dn, [start], reach)[0]
    if isinstance(found, EstimationError):
        raise found
    return found


def measure_centers(
    image_dn: npt.NDArray[np.generic], starts: Sequence[Ellipse], reach: float = REACH
) -> tuple[TargetCenter | EstimationError, ...]:
    """Measure the centres of all targets of a photo, many at a time: the same numbers as one by one, but faster.

    image_dn (h, w): Grey values [DN].
    starts: The outlines to half a pixel or so, in the photo's pixels.
    reach: How far from the centre pixels are used, in radii of the dot: code rings must begin beyond.
    Returns: One for each start; why there is no centre otherwise.
    """
    found: list[TargetCenter | EstimationError | None] = [_cut_by_border(image_dn, start) for start in starts]
    begun = list(starts)
    runs = np.zeros(len(starts))

    def fit(which: list[int], effort: _Effort) -> None:
        # Targets of nearly one size share a batch, whose windows have the size of the largest.
        which = sorted(which, key=lambda k: begun[k].radius_px)
        centers = np.array([begun[k].center_px for k in which]).reshape(-1, 2)
        shapes = np.array([begun[k].shape_px2 for k in which]).reshape(-1, 2, 2)
        for rows in _batches(_window_sizes(shapes, reach), effort.pixels_at_once):
            own = _fitted([image_dn], np.zeros(rows.size, np.intp), centers[rows], shapes[rows], reach, effort)
            for k, row in enumerate(rows.tolist()):
                found[which[row]] = own.result(k)
            runs[[which[row] for row in rows.tolist()]] = own.outlier_runs

    # On small discs the choice of pixels matters: choose them by a first, coarse fit, not by the start.
    whole = [k for k, one in enumerate(found) if one is None]
    small = [k for k in whole if begun[k].semi_axes_px[1] < _SMALL_PX]
    fit(small, _COARSE)
    for k in small:
        one = found[k]
        if isinstance(one, TargetCenter):
            begun[k] = one.ellipse
    effort, left = _CAREFUL, [k for k in whole if not isinstance(found[k], EstimationError)]
    fit(left, effort)
    if left and np.median(runs[left]) >= _STEPPED_RUNS:
        effort = replace(effort, rejects=False)
        fit(left, effort)
    _widen(found, begun, fit, effort)
    return tuple(one for one in found if one is not None)


def _widen(
    found: list[TargetCenter | EstimationError | None],
    begun: list[Ellipse],
    fit: Callable[[list[int], _Effort], None],
    effort: _Effort,
) -> None:
    """Fit large dots that are blurred by more than the usual band shows once more, with a wider one."""
    blurred: dict[float, list[int]] = {}
    for k, one in enumerate(found):
        if not isinstance(one, TargetCenter) or one.blur_px <= _SHARP_PX:
            continue
        if _MOST_BAND * one.ellipse.semi_axes_px[1] > _BAND_PX:
            blurred.setdefault(float(np.ceil(_BAND_BLURS * one.blur_px)), []).append(k)
    for band_px, rows in blurred.items():
        before = {k: found[k] for k in rows}
        for k in rows:
            one = before[k]
            if isinstance(one, TargetCenter):
                begun[k] = one.ellipse
        fit(rows, replace(effort, band_px=band_px, width_px=band_px / _BAND_BLURS))
        for k in rows:
            if isinstance(found[k], EstimationError):
                found[k] = before[k]


def _cut_by_border(image_dn: npt.NDArray[np.generic], start: Ellipse) -> EstimationError | None:
    (x, y), (radius_x, radius_y) = start.center_px, np.sqrt(np.diag(start.shape_px2))
    height, width = image_dn.shape
    if x - radius_x < 1 or y - radius_y < 1 or x + radius_x > width - 2 or y + radius_y > height - 2:
        return UnmeasuredTargetError(
            SampleFlag.CUT_BY_BORDER, f"the target at ({x:.1f}, {y:.1f}) px touches the border of the image"
        )
    return None


@dataclass(frozen=True, slots=True, eq=False)
class CentersNear:
    """Centres of n targets.

    centers_px (n, 2): Centres (x, y) [px].
    shapes_px2 (n, 2, 2): Their ellipses [px^2].
    covariance_px2 (n, 2, 2): Covariances of the centres [px^2].
    contrast_dn, inside_dn, residual_dn (n,): As in `TargetCenter` [DN].
    edge_powers (n, 4): Power of the residuals in harmonics of the outlines, as in `TargetCenter`.
    settled (n,): Whether the fit ended; else the numbers mean nothing and `measure_center` may try.
    """

    centers_px: FloatArray
    shapes_px2: FloatArray
    covariance_px2: FloatArray
    contrast_dn: FloatArray
    inside_dn: FloatArray
    residual_dn: FloatArray
    edge_powers: FloatArray
    settled: BoolArray

    def put(self, row: int, center: TargetCenter) -> None:
        """Put down the centre of one target that was measured by itself."""
        self.centers_px[row], self.covariance_px2[row] = center.center_px, center.covariance_px2
        self.shapes_px2[row], self.settled[row] = center.ellipse.shape_px2, True
        self.contrast_dn[row], self.inside_dn[row] = center.contrast_dn, center.inside_dn
        self.residual_dn[row], self.edge_powers[row] = center.residual_dn, center.edge_powers


def centers_near(
    images: Sequence[npt.NDArray[np.generic]],
    photo: IntArray,
    centers_px: FloatArray,
    shapes_px2: FloatArray,
    reach: float,
) -> CentersNear:
    """Measure centres near known places in several photos, quickly: in single precision, without persistence.

    Shapes: images (h, w), photo (n,).
    centers_px (n, 2): Places to half a pixel or so [px].
    shapes_px2 (n, 2, 2): Ellipses to a few percent [px^2].
    reach: How far from the centre pixels are used, in radii of the dot.
    """
    count = len(photo)
    found = CentersNear(
        np.array(centers_px),
        np.array(shapes_px2),
        np.full((count, 2, 2), np.nan),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
        np.ones((count, len(HARMONICS))),
        np.zeros(count, dtype=np.bool_),
    )
    sizes = _window_sizes(shapes_px2, reach)
    for batch in _batches(np.full_like(sizes, sizes.max(initial=0.0)), _QUICK.pixels_at_once):
        rows = batch
        for _ in range(2):
            start = found.centers_px[rows]
            own = _fitted(images, photo[rows], start, found.shapes_px2[rows], reach, _QUICK)
            good = own.settled & own.stands_out
            found.settled[rows] = good
            for name in _TAKEN:
                getattr(found, name)[rows[good]] = getattr(own, name)[good]
            moved = np.hypot(*(found.centers_px[rows] - start).T)
            rows = rows[good & (moved > _MOVED_RADII * _smaller(shapes_px2[rows]))]
            if not rows.size:
                break
    return found


def _batches(sizes: FloatArray, pixels_at_once: int) -> Iterator[IntArray]:
    """Yield consecutive rows that are fitted together, their windows as large as the largest."""
    first = 0
    while first < len(sizes):
        last = first + 1
        while last < len(sizes) and (last + 1 - first) * sizes[first : last + 1].max() <= pixels_at_once:
            last += 1
        yield np.arange(first, last)
        first = last


def _window_sizes(shapes: FloatArray, reach: float) -> FloatArray:
    """Return the number of pixels of each window, shape (n,)."""
    return np.asarray((2 * reach * np.sqrt(np.einsum("nii->ni", shapes).max(axis=1, initial=1.0)) + 3) ** 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """Pixels of n targets, k each: places from the start of the fit, values, radius (1 on the edge), whether used."""

    x: FloatArray
    y: FloatArray
    values_dn: FloatArray
    radius: FloatArray
    used: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """Start and prior of n fits, shape (12, n) each; weights are noise variance over own variance.

    is_seen, has_contrast (n,): Whether enough pixels lie on both sides of the edge, and they differ.
    """

    parameters: FloatArray
    mean: FloatArray
    weights: FloatArray
    is_seen: BoolArray
    has_contrast: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """What came of n fits; the numbers of one that did not settle, or does not stand out, mean nothing."""

    centers_px: FloatArray
    shapes_px2: FloatArray
    covariance_px2: FloatArray
    contrast_dn: FloatArray
    inside_dn: FloatArray
    blur_px: FloatArray
    residual_dn: FloatArray
    on_edge: IntArray
    n_used: IntArray
    start: _Start
    settled: BoolArray
    edge_powers: FloatArray
    stands_out: BoolArray
    outlier_runs: IntArray

    def result(self, k: int) -> TargetCenter | EstimationError:
        """Return one centre, or why there is none."""
        on_edge, used = int(self.on_edge[k]), int(self.n_used[k])
        if on_edge < 2 * N_PARAMETERS:
            return UnmeasuredTargetError(
                SampleFlag.TOO_SMALL, f"{on_edge} pixels show the target's edge; a template needs {2 * N_PARAMETERS}"
            )
        if not self.start.is_seen[k]:
            return UnmeasuredTargetError(
                SampleFlag.TOO_SMALL, "the target covers too few pixels to separate its level from the ground's"
            )
        if not self.start.has_contrast[k]:
            return EstimationError("the target has no contrast against its ground")
        if not self.settled[k]:
            return UnmeasuredTargetError(
                SampleFlag.PARTLY_COVERED,
                f"the template did not settle within {_CAREFUL.most_steps} steps; the spot is no blurred disc",
            )
        if not _enough(used, on_edge):
            return UnmeasuredTargetError(
                SampleFlag.PARTLY_COVERED,
                f"{on_edge - used} of {on_edge} pixels do not fit a blurred disc: partly covered?",
            )
        if np.isnan(self.covariance_px2[k]).any():
            return EstimationError("the pixels do not determine the disc")
        if not self.stands_out[k]:
            return EstimationError(
                f"a contrast of {abs(self.contrast_dn[k]):.1f} DN does not stand out from noise of "
                f"{self.residual_dn[k]:.1f} DN"
            )
        return TargetCenter(
            Ellipse(self.centers_px[k], self.shapes_px2[k]),
            freeze(self.covariance_px2[k]),
            float(self.contrast_dn[k]),
            float(self.inside_dn[k]),
            float(self.blur_px[k]),
            float(self.residual_dn[k]),
            used,
            self.edge_powers[k],
        )


def _enough(used: Any, on_edge: Any) -> Any:
    return (used >= 2 * N_PARAMETERS) & (used >= 0.6 * on_edge)


def _fitted(
    images: Sequence[npt.NDArray[np.generic]],
    photo: IntArray,
    centers: FloatArray,
    shapes: FloatArray,
    reach: float,
    effort: _Effort,
) -> _Fitted:
    """Fit the discs of one batch."""
    pixels = _cut_out(images, photo, centers, shapes, reach, effort)
    start = _started(pixels, shapes, effort)
    fits = _robust(pixels, start, effort)
    parameters, residuals, kept = fits.parameters.T, fits.residuals, fits.roots
    precision = effort.precision
    jacobian = fits.jacobian * kept[:, None]
    count, on_edge = (kept > 0).sum(axis=1), pixels.used.sum(axis=1)
    enough = _enough(count, on_edge)
    normal = (jacobian @ np.swapaxes(jacobian, 1, 2)).astype(np.float64)
    prior = start.weights.T
    normal[:, np.arange(N_PARAMETERS), np.arange(N_PARAMETERS)] += prior
    # Fits that did not settle have no derivatives.
    normal[~(fits.settled & enough)] = np.eye(N_PARAMETERS)
    inverse = _inverse(normal)
    influence = inverse[:, :2].astype(precision) @ jacobian
    freedom = (count / np.maximum(count - N_PARAMETERS, 1)).astype(precision)
    square = (residuals * kept) ** 2 * freedom[:, None]
    total = square.sum(axis=1) / np.maximum(count, 1)
    # Two variances, inside and outside, mixed by coverage; a side with a handful of pixels leans on the mean.
    coverage = np.clip(jacobian[:, 9], 0.0, 1.0)
    inside, outside = (
        ((share * square).sum(axis=1) + N_PARAMETERS * total) / (np.maximum(share.sum(axis=1), 1.0) + N_PARAMETERS)
        for share in (coverage, (kept > 0) - coverage)
    )
    noise = outside[:, None] + coverage * (inside - outside)[:, None]
    # What the prior does not know counts as noise of its own.
    by_prior = (inverse[:, :2] * prior[:, None]) @ np.swapaxes(inverse[:, :2], 1, 2)
    covariance = (influence * noise[:, None]) @ np.swapaxes(influence, 1, 2) + total[:, None, None] * by_prior
    m11, m12, m22 = parameters[2:5]
    circle = np.moveaxis(np.array([[m11, m12], [m12, m22]]), -1, 0).astype(precision)
    center = parameters[:2].astype(precision)
    unit = circle @ np.stack([pixels.x - center[0, :, None], pixels.y - center[1, :, None]], axis=1)
    powers = edge_powers(circle @ influence, (unit[:, 0], unit[:, 1]), residuals, noise)
    with np.errstate(divide="ignore", invalid="ignore"):
        frame = np.moveaxis(np.array([[m22, -m12], [-m12, m11]]) / (m11 * m22 - m12 * m12), -1, 0)
    step = parameters[9] + parameters[10] * parameters[0] + parameters[11] * parameters[1]
    ground = parameters[6] + parameters[7] * parameters[0] + parameters[8] * parameters[1]
    return _Fitted(
        centers + parameters[:2].T,
        frame @ frame,
        covariance,
        step,
        ground + step,
        np.sqrt(np.maximum(parameters[5] ** 2 - _PIXEL_VARIANCE, 0.0)),
        np.sqrt(total),
        on_edge,
        count,
        start,
        fits.settled,
        powers,
        enough & (parameters[9] ** 2 >= _LEAST_STEP_SIGMAS**2 * total * inverse[:, 9, 9]),
        _runs(unit, pixels.used & (kept == 0)),
    )


def _runs(unit: FloatArray, outliers: BoolArray) -> IntArray:
    """Return in how many separate runs of sectors outlines have outliers.

    Shapes: unit (n, 2, k), outliers (n, k), result (n,).
    """
    row, pixel = np.nonzero(outliers)
    turn = np.arctan2(unit[row, 1, pixel], unit[row, 0, pixel]) * (_SECTORS / (2 * np.pi))
    spoilt = np.zeros((len(outliers), _SECTORS), dtype=np.bool_)
    spoilt[row, np.floor(turn).astype(np.intp) % _SECTORS] = True
    runs = (spoilt & ~np.roll(spoilt, 1, axis=1)).sum(axis=1)
    # Outliers all round are no single run: what covers a target leaves a third of its outline.
    return np.where(spoilt.sum(axis=1) > 2 / 3 * _SECTORS, _SECTORS, runs)


def _inverse(matrices: FloatArray) -> FloatArray:
    """Return the inverses, NaN for singular matrices."""
    try:
        return np.asarray(np.linalg.inv(matrices))
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full_like(matrices, np.nan)
        return np.concatenate([_inverse(one[None]) for one in matrices])


def _cut_out(
    images: Sequence[npt.NDArray[np.generic]],
    photo: IntArray,
    centers: FloatArray,
    shapes: FloatArray,
    reach: float,
    effort: _Effort,
) -> _Pixels:
    """Gather the pixels near the outlines.

    Quickly all targets have the same places about their middle pixel, and what lies beyond the photo's border repeats
    it; carefully each target has its own pixels, those of the photo alone.
    """
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
    smaller = _smaller(shapes)
    wide = effort.band_px > _BAND_PX
    band = (np.minimum(effort.band_px, _MOST_BAND * smaller) if wide else effort.band_px) / smaller
    band = band[:, None, None]
    used = (radius > 1 - band) & (radius < np.minimum(reach, 1 + band))
    sizes = np.array([one.shape for one in images])[photo]
    if effort.persistent:
        for axis, size in ((0, sizes[:, 1]), (1, sizes[:, 0])):
            place = middle[:, axis, None] + offset
            within = (place >= 0) & (place < size[:, None])
            used &= within[:, None, :] if axis == 0 else within[:, :, None]
        count = used.sum(axis=(1, 2))
        slot = np.arange(int(count.max(initial=0))) < count[:, None]
        row, column = (np.zeros(slot.shape, dtype=np.intp) for _ in range(2))
        _, row[slot], column[slot] = np.nonzero(used)
        target = np.arange(len(photo))[:, None]
        dx, dy, radius, used = dx[target, column], dy[target, row], radius[target, row, column], slot
    else:
        row, column = np.nonzero(used.any(axis=0))
        dx, dy, radius, used = dx[:, column], dy[:, row], radius[:, row, column], used[:, row, column]
        row, column = (np.broadcast_to(one, used.shape) for one in (row, column))
    values = np.empty(used.shape, dtype=effort.precision)
    for one in np.unique(photo):
        own, image = photo == one, images[one]
        rows = np.clip(middle[own, 1, None] + offset[row[own]], 0, image.shape[0] - 1)
        columns = np.clip(middle[own, 0, None] + offset[column[own]], 0, image.shape[1] - 1)
        values[own] = image[rows, columns]
    return _Pixels(dx.astype(effort.precision), dy.astype(effort.precision), values, radius, used)


def _smaller(shapes: FloatArray) -> FloatArray:
    """Return the smaller semi-axes, shape (n,) [px]."""
    xx, xy, yy = shapes[:, 0, 0], shapes[:, 0, 1], shapes[:, 1, 1]
    return np.asarray(np.sqrt(np.maximum(0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy), 0.0)))


def _started(pixels: _Pixels, shapes: FloatArray, effort: _Effort) -> _Start:
    """Estimate levels, noise and prior of all fits."""
    count, smaller = len(shapes), _smaller(shapes)
    far = pixels.used & (pixels.radius > 1 + np.minimum(0.25, 2 / smaller)[:, None])
    core = pixels.used & (pixels.radius < 1 - np.minimum(0.2, 2 / smaller)[:, None])
    planes = np.stack([np.ones_like(pixels.x), pixels.x, pixels.y], axis=1) * far[:, None]
    normal = planes @ np.swapaxes(planes, 1, 2) + 1e-9 * np.eye(3)
    plane = np.linalg.solve(normal, planes @ pixels.values_dn[:, :, None])[..., 0]
    left = np.abs(pixels.values_dn - (plane[:, None] @ planes)[:, 0])
    noise = np.maximum(_medians(left, far) * SIGMA_PER_MAD, 0.3)
    inside = _medians(pixels.values_dn, core)
    step = inside - plane[:, 0]
    parameters, mean = np.zeros((N_PARAMETERS, count)), np.zeros((N_PARAMETERS, count))
    sigma = np.full((N_PARAMETERS, count), np.inf)
    # The symmetric root of a matrix of two rows: (S + sqrt(det) I) / sqrt(trace + 2 sqrt(det)).
    area = np.sqrt(np.linalg.det(shapes))[:, None, None]
    root = (shapes + area * np.eye(2)) / np.sqrt(np.trace(shapes, axis1=1, axis2=2)[:, None, None] + 2 * area)
    inverse = np.linalg.inv(root)
    parameters[2:6] = inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1], np.minimum(effort.width_px, 0.4 * smaller)
    parameters[6:9], parameters[9] = plane.T, step
    # Shading multiplies (the dark side slopes less) or adds (both slope alike): half way, with that as its sigma.
    lighter = np.maximum(np.maximum(np.abs(plane[:, 0]), np.abs(inside)), 1.0)
    slope = 0.5 * step / lighter * plane[:, 1:].T
    mean[5], sigma[5] = effort.width_px, 0.5
    mean[10:] = parameters[10:] = slope
    sigma[10:] = np.hypot(*slope) + _SLOPE_FLOOR * np.abs(step)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.nan_to_num((noise / sigma) ** 2, nan=0.0, posinf=0.0)
    is_seen = (pixels.used.sum(axis=1) >= 2 * N_PARAMETERS) & (core.sum(axis=1) >= 3) & (far.sum(axis=1) >= 8)
    # A step of round-off is none.
    has_contrast = is_seen & (np.abs(step) > _LEAST_STEP * lighter) & np.isfinite(step)
    return _Start(parameters, mean, weights, is_seen, has_contrast)


def _medians(values: FloatArray, among: BoolArray) -> FloatArray:
    """Return the upper median of some values of each row, shape (n,); NaN of none."""
    if not values.shape[1]:
        return np.full(len(values), np.nan)
    ordered = np.sort(np.where(among, values, np.inf), axis=1)
    middle = np.minimum(among.sum(axis=1) // 2, values.shape[1] - 1)
    found = ordered[np.arange(len(values)), middle]
    return np.where(np.isfinite(found), found, np.nan)


def _robust(pixels: _Pixels, start: _Start, effort: _Effort) -> SmallFits:
    """Settle all fits, and again without the pixels that are dust or glare."""
    kept = pixels.used.astype(effort.precision)
    fits = SmallFits(
        start.parameters.T.copy(),
        np.zeros_like(kept),
        np.zeros((N_PARAMETERS, *kept.shape), effort.precision).transpose(1, 0, 2),
        kept,
        start.mean.T,
        start.weights.T,
        np.zeros(len(kept), dtype=np.bool_),
    )
    radius = (start.parameters[2] * start.parameters[4] - start.parameters[3] ** 2) ** -0.5

    def evaluate(rows: IntArray, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        own = slice(None) if rows.size == len(kept) else rows
        values = pixels.values_dn[own]
        model, jacobian = disc_model(parameters.T[:, :, None].astype(values.dtype), pixels.x[own], pixels.y[own])
        return values - model, jacobian.transpose(0, 2, 1)

    active = np.flatnonzero(start.has_contrast)
    for turn in range(4):
        if turn == 0 or not effort.persistent:
            fits.residuals[active], fits.jacobian[active] = evaluate(active, fits.parameters[active])
        descend(
            fits,
            active,
            evaluate,
            lambda step: np.hypot(step[:, 0], step[:, 1]) < effort.enough_px,
            effort.descent,
            lambda rows, trial: _plausible(trial.T, radius[rows]),
        )
        size = np.abs(fits.residuals)
        # On a display the light side alone has a raster, no pixel of which is dust.
        light = fits.parameters[:, 9] > 0
        lighter = (fits.jacobian[:, 9] > 0.5) == light[:, None]
        usual = np.fmax(_medians(size, pixels.used), _medians(size, pixels.used & lighter))
        limit = np.maximum(_OUTLIER_SIGMAS * SIGMA_PER_MAD * usual, _OUTLIER_CONTRAST * np.abs(fits.parameters[:, 9]))[
            :, None
        ]
        other = (pixels.used & ((size <= limit) | (not effort.rejects))).astype(effort.precision)
        active = active[fits.settled[active] & (other != kept)[active].any(axis=1)]
        if not active.size:
            break
        kept[active] = other[active]
    return fits


def _plausible(parameters: FloatArray, reach: FloatArray) -> BoolArray:
    """Return whether ellipses stay near their start, of their size, with an edge narrower than themselves."""
    determinant = parameters[2] * parameters[4] - parameters[3] ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        radius = determinant**-0.5
        near = np.hypot(parameters[0], parameters[1]) < 0.5 * reach + 1
        size = (radius > 0.4 * reach) & (radius < 2.5 * reach)
        edge = (parameters[5] > 0.2) & (parameters[5] < np.maximum(0.8 * radius, 0.6))
    return np.asarray((determinant > 0) & (parameters[2] > 0) & near & size & edge)
