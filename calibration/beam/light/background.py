"""Brightness of the target itself: from frames without a beam, or from the picture around the beam.

A target is lit by sky and ground, is made of panels, has marks, and the receiver above may cast a shadow on it.
Where there are frames without a beam, the model is one of them times a plane plus a constant. Where there are none, it
is a quadratic surface. What is left around the beam (panels, edges of shadows) is continued smoothly under the beam.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from calibration.beam.light.shadow_edge import strongest_edge
from heliogauge.adjust.robust_loss import Tukey
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, FloatArray, freeze

__all__ = [
    "Background",
    "TargetSurface",
    "area_resized",
    "background_around",
    "continued_under",
    "empty_target",
    "projection",
    "shadow_steps",
    "taken_by_background",
]

#: Residuals beyond this many robust sigmas are marks, seams or glare, and do not count (Tukey).
_TUKEY_SIGMAS = 4.7
#: Least scatter of a pixel, the rounding of an 8-bit picture [share of the brightness range].
_ROUNDING = 1 / np.sqrt(12) / 255
#: Share of the target that must be free of the beam for a quadratic surface; a plane bends less far under the beam.
_FREE_FOR_QUADRATIC = 0.25
_MOST_ITERATIONS = 12
#: Pixels that are enough for the six coefficients of the smooth part; more of them only cost time.
_ENOUGH_PIXELS = 900


#: Blocks of an empty target along each side that are compared: as large as panels.
_UNEVEN_BLOCKS = 6


@dataclass(frozen=True, slots=True, eq=False)
class TargetSurface:
    """Pattern of a target without a beam, averaged over frames.

    values_dn (h, w): Mean of the frames [DN].
    uneven_share: Scatter of the reflectance from panel to panel, as a share of it.
    """

    values_dn: FloatArray
    n_frames: int
    uneven_share: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """Brightness of the target under and around a beam.

    values_dn (h, w): The brightness without the beam [DN].
    basis (h, w, k): Functions of which its smooth part is made.
    cofactor (k, k): Covariance of their coefficients for pixels of variance 1.
    scatter_dn: Robust scatter of the free pixels about the smooth part [DN].
    residuals_dn (h, w): Picture minus the smooth part where no beam is, limited to what is no mark; 0 elsewhere
        [DN].
    smooth_dn (h, w): The smooth part [DN].
    bending (k,): Functions that bend: without a frame of the empty target, light of the beam may pass for them.
    """

    values_dn: FloatArray
    basis: FloatArray
    cofactor: FloatArray
    scatter_dn: float
    residuals_dn: FloatArray
    smooth_dn: FloatArray
    bending: BoolArray


def empty_target(frames_dn: Sequence[npt.NDArray[np.generic]]) -> TargetSurface:
    """Average frames of the target without a beam.

    frames_dn (h, w): Rectified pictures of one size; NaN where the target is not seen [DN].
    Returns: Their mean after each was scaled to the brightness of the first: light changes between frames, the
        pattern does not.
    InputError: No frame, sizes that differ, or a frame that is black.
    """
    if not frames_dn:
        raise InputError("empty frames: at least one is needed")
    shapes = {frame.shape for frame in frames_dn}
    if len(shapes) > 1:
        raise InputError(f"empty frames: one size is needed, not {sorted(shapes)}")
    frames = [np.asarray(frame, dtype=np.float64) for frame in frames_dn]
    unseen = [number for number, frame in enumerate(frames, start=1) if np.isfinite(frame).mean() < 0.5]
    if unseen:
        raise InputError(
            f"empty frame {unseen[0]} shows less than half of the target: are the corners those of this target in "
            f"this camera?"
        )
    levels = [float(np.nanmedian(frame)) for frame in frames]
    if not min(levels) > 0:
        raise InputError(f"empty frame {int(np.argmin(levels)) + 1} is black (median {min(levels):.3g} DN)")
    scaled = np.array([frame * (levels[0] / level) for frame, level in zip(frames, levels, strict=True)])
    counts = np.isfinite(scaled).sum(axis=0)
    mean = np.where(counts > 0, np.nansum(scaled, axis=0) / np.maximum(counts, 1), np.nan)
    return TargetSurface(freeze(mean), len(frames), _uneven_share(mean))


def _uneven_share(values_dn: FloatArray) -> float:
    """Return by how much panels of an empty target differ, as a share, 1 sigma of one.

    Neighbouring blocks are compared, and half of the differences may be anything: the edge of a shadow crosses few of
    them. Panels that are long in one direction differ across the other: the direction that differs more counts.
    """
    height, width = values_dn.shape
    rows, columns = (np.linspace(0, size, _UNEVEN_BLOCKS + 1).astype(int) for size in (height, width))
    levels = np.full((_UNEVEN_BLOCKS, _UNEVEN_BLOCKS), np.nan)
    noise = levels.copy()
    for i in range(_UNEVEN_BLOCKS):
        for j in range(_UNEVEN_BLOCKS):
            block = values_dn[rows[i] : rows[i + 1], columns[j] : columns[j + 1]]
            known = block[np.isfinite(block)]
            if known.size < 0.5 * block.size or known.size < 16:
                continue
            middle = float(np.median(known))
            scatter = max(1.4826 * float(np.median(np.abs(known - middle))), 1e-3 * abs(middle), 1e-12)
            kept = known[np.abs(known - middle) < 3 * scatter]
            if middle > 0:
                levels[i, j] = np.log(max(float(kept.mean()), 1e-12))
                # Rectified pixels share those of the photo: four count as one.
                noise[i, j] = 4 * (scatter / middle) ** 2 / kept.size
    found = 0.0
    for axis in (0, 1):
        steps = np.diff(levels, axis=axis)
        if np.isfinite(steps).sum() < 0.7 * steps.size or not np.isfinite(steps).any(axis=0).all():
            continue
        # Daylight bends: what steps of a row, and then of a column, have in common is no panel.
        steps = steps - np.nanmedian(steps, axis=0)
        common = [float(np.median(row[np.isfinite(row)])) if np.isfinite(row).any() else 0.0 for row in steps]
        away = np.abs(steps - np.array(common)[:, None])
        spare = steps.size / (steps.size - sum(steps.shape))
        square = (1.4826 * float(np.nanmedian(away))) ** 2 * spare / 2 - float(np.nanmedian(noise))
        found = max(found, float(np.sqrt(max(square, 0.0))))
    return found


def seams_of(empty_dn: FloatArray) -> FloatArray:
    """Return how much less a target reflects along its seams and marks than around them.

    empty_dn (h, w): The target without a beam [DN].
    Returns (h, w): Below 1 on dark lines that are narrower than 3 % of the target, 1 elsewhere. The edge of a shadow is
        no line and stays 1: a shadow dims daylight, not the beam.
    """
    side = 2 * max(1, round(0.015 * max(empty_dn.shape))) + 1
    values = np.asarray(empty_dn, dtype=np.float32)
    filled = np.asarray(cv2.morphologyEx(values, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)), dtype=np.float64)
    ratio = np.where(filled > 0, empty_dn / np.maximum(filled, 1e-9), 1.0)
    # Noise alone makes dips, too: what most pixels have is none.
    usual = float(np.median(ratio))
    scatter = robust_scale(ratio[ratio < 1] - usual) if np.count_nonzero(ratio < 1) > 10 else 0.0
    return np.asarray(np.where(ratio < usual - 4 * scatter, np.clip(ratio / usual, 0.05, 1.0), 1.0))


def area_resized(values: npt.NDArray[np.floating], shape: tuple[int, int]) -> FloatArray:
    """Resample by averaging over areas (down) or linearly (up); the outlines of the two pictures coincide.

    Shapes: values (h, w).
    shape: Rows and columns wanted.
    """
    if values.shape == shape:
        return np.asarray(values, dtype=np.float64)
    smaller = shape[0] <= values.shape[0] and shape[1] <= values.shape[1]
    how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(values, (shape[1], shape[0]), interpolation=how), dtype=np.float64)


def background_around(
    values_dn: FloatArray,
    free: BoolArray,
    *,
    empty: FloatArray | None = None,
    full_scale_dn: float = 255.0,
    steps: Sequence[FloatArray] = (),
    continued: bool = True,
) -> Background:
    """Estimate the target's own brightness from the pixels that no beam lights.

    Shapes: values_dn (h, w), free (h, w).
    empty (h, w): The target without a beam (`TargetSurface`) in the same pixels [DN].
    full_scale_dn: End of the grey scale [DN].
    steps (h, w): Steps from 0 to 1 at straight edges of shadows or panels (`shadow_steps`), with free heights.
    continued: Whether what is left around the beam is continued under it; needed for the last answer only.
    Returns: Its value everywhere, and what its uncertainty follows from.
    EstimationError: Fewer free pixels than the model has coefficients, or they do not determine it.
    """
    degree = 2 if float(free.mean()) >= _FREE_FOR_QUADRATIC else 1
    basis = _basis(values_dn.shape, degree, empty)
    if int(free.sum()) < 4 * basis.shape[2]:
        raise EstimationError(
            f"only {int(free.sum())} pixels of the target are free of the beam; its own brightness needs "
            f"{4 * basis.shape[2]}: take a frame without a beam"
        )
    basis = np.concatenate([basis, *(step[..., None] for step in steps)], axis=2)
    smooth, residuals, scatter, cofactor = _fitted(values_dn, free, basis, full_scale_dn)
    number = np.arange(basis.shape[2])
    bending = (number >= 3) & (number < 6) if empty is None and degree == 2 else np.zeros(number.size, dtype=np.bool_)
    smooth = freeze(smooth)
    found = Background(smooth, freeze(basis), freeze(cofactor), scatter, freeze(residuals), smooth, freeze(bending))
    return continued_under(found, free) if continued else found


def continued_under(background: Background, free: BoolArray) -> Background:
    """Return a background with what is left around the beam continued under it.

    free (h, w): Pixels without a beam.
    """
    under = background.smooth_dn + _continuing(free)(background.residuals_dn)
    return replace(background, values_dn=freeze(under))


def shadow_steps(values_dn: FloatArray, free: BoolArray, background: Background, most: int) -> list[FloatArray]:
    """Look for straight edges that a background without steps does not follow.

    values_dn (h, w): Picture of the target [DN].
    free (h, w): Pixels without a beam.
    Returns (h, w): Steps from 0 to 1.
    """
    basis, residuals, scatter = background.basis, background.residuals_dn, background.scatter_dn
    steps: list[FloatArray] = []
    for _ in range(most):
        # Marks and seams are darker than any shadow; they would hide it.
        edge = strongest_edge(residuals, free & (residuals > -2 * scatter), basis)
        if edge is None:
            break
        steps.append(edge)
        basis = np.concatenate([basis, edge[..., None]], axis=2)
        _, residuals, scatter, _ = _fitted(values_dn, free, basis, scatter)
    return steps


def taken_by_background(free: BoolArray, background: Background) -> Callable[[FloatArray], FloatArray]:
    """Return what tells which part of a beam's skirts a background has taken for its own.

    free (h, w): Pixels that were taken for free of the beam.
    Returns: From the beam where it does not stand out, (h, w), to the part of the background that is the beam's, under
        the beam too [DN].
    """
    project = projection(free, background.basis)
    goes_on = _continuing(free)

    def taken(bell_dn: FloatArray) -> FloatArray:
        smooth = project(bell_dn)
        return smooth + goes_on((bell_dn - smooth) * free)

    return taken


def projection(free: BoolArray, basis: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return what tells the part of a picture, (h, w), that functions take by least squares over some pixels [DN].

    free (h, w): Pixels that count.
    basis (h, w, k): The functions.
    """
    flat = basis.reshape(-1, basis.shape[2])
    rows = (flat * free.reshape(-1, 1)).T
    normal = _with_ridge(rows @ flat)

    def project(values_dn: FloatArray) -> FloatArray:
        return np.asarray(flat @ np.linalg.solve(normal, rows @ values_dn.ravel())).reshape(values_dn.shape)

    return project


class _Smooth(NamedTuple):
    """Smooth part; residuals, limited and 0 where a beam is; their scatter; cofactor of the coefficients."""

    values_dn: FloatArray
    residuals_dn: FloatArray
    scatter_dn: float
    cofactor: FloatArray


def _fitted(values_dn: FloatArray, free: BoolArray, basis: FloatArray, full_scale_dn: float) -> _Smooth:
    # An odd step, so that the pixels taken do not stand in columns.
    chosen = np.flatnonzero(free)
    step = (chosen.size // _ENOUGH_PIXELS) | 1
    chosen = chosen[::step]
    flat = basis.reshape(-1, basis.shape[2])
    coefficients, scatter, cofactor = _robust_fit(flat[chosen], values_dn.ravel()[chosen], _ROUNDING * full_scale_dn)
    smooth = (flat @ coefficients).reshape(values_dn.shape)
    limit = _TUKEY_SIGMAS * scatter
    # What matters are errors that neighbours share; all pixels are as good as every step-th for them.
    residuals = values_dn - smooth
    np.minimum(np.maximum(residuals, -limit, out=residuals), limit, out=residuals)
    residuals *= free
    return _Smooth(smooth, residuals, scatter, cofactor / step)


def _basis(shape: tuple[int, ...], degree: int, empty: FloatArray | None) -> FloatArray:
    if empty is not None:
        plane = _polynomial((shape[0], shape[1]), 1)
        pattern = (empty / float(np.mean(empty)))[..., None]
        return np.concatenate([plane[..., :1], pattern * plane], axis=-1)
    return _polynomial((shape[0], shape[1]), degree)


@lru_cache(maxsize=16)
def _polynomial(shape: tuple[int, int], degree: int) -> FloatArray:
    # Coordinates of the pixels' centres in a square of -1 to 1: the same functions for every resolution.
    y = ((np.arange(shape[0]) + 0.5) * (2 / shape[0]) - 1)[:, None]
    x = ((np.arange(shape[1]) + 0.5) * (2 / shape[1]) - 1)[None, :]
    one = np.ones(shape)
    functions = [one, one * x, one * y]
    if degree == 2:
        functions += [one * x**2, x * y, one * y**2]
    return np.asarray(freeze(np.stack(functions, axis=-1)))


class _Robust(NamedTuple):
    """Coefficients of a robust fit, scatter of the residuals, cofactor."""

    coefficients: FloatArray
    scatter: float
    cofactor: FloatArray


def _robust_fit(rows: FloatArray, values: FloatArray, floor: float) -> _Robust:
    across = np.ascontiguousarray(rows.T)
    weighted = across
    coefficients: FloatArray = np.zeros(rows.shape[1])
    loss, scatter = Tukey(_TUKEY_SIGMAS), floor
    for _ in range(_MOST_ITERATIONS):
        normal = _with_ridge(weighted @ rows)
        previous, coefficients = coefficients, np.asarray(np.linalg.solve(normal, weighted @ values))
        residuals: FloatArray = values - coefficients @ across
        # The fit is robust: the median of the residuals is near zero, and need not be taken off first.
        scatter = math.hypot(robust_scale(residuals, upper=True), floor)
        if np.abs(coefficients - previous).max() < 0.02 * floor:
            break
        weighted = across * loss.weight(residuals / scatter)
    return _Robust(coefficients, scatter, np.asarray(np.linalg.inv(normal)))


def _with_ridge(normal: FloatArray) -> FloatArray:
    """Add a tiny ridge: it holds an empty frame without a pattern and the constant, which are equal, together."""
    diagonal = np.einsum("ii->i", normal)
    diagonal += 1e-9 * diagonal.mean()
    return normal


def _continuing(free: BoolArray) -> Callable[[FloatArray], FloatArray]:
    """Return what continues residuals to where they are not known: averages of ever larger neighbourhoods.

    From known values, 0 where they are not, to values everywhere (pull and push).
    """
    mask = free.astype(np.float32)
    factor = free / np.maximum(cv2.GaussianBlur(mask, (0, 0), 1.0), np.float32(1e-3))
    shares: list[npt.NDArray[Any]] = [mask]
    while min(shares[-1].shape) > 2:
        size = (max(1, shares[-1].shape[1] // 2), max(1, shares[-1].shape[0] // 2))
        shares.append(cv2.resize(shares[-1], size, interpolation=cv2.INTER_AREA))

    def continued(residuals: FloatArray) -> FloatArray:
        blurred = cv2.GaussianBlur(residuals.astype(np.float32), (0, 0), 1.0)
        sums: list[npt.NDArray[Any]] = [blurred * factor]
        for share in shares[1:]:
            sums.append(cv2.resize(sums[-1], share.shape[::-1], interpolation=cv2.INTER_AREA))
        filled = sums[-1] / np.maximum(shares[-1], 1e-6)
        for total, part in zip(sums[-2::-1], shares[-2::-1], strict=True):
            coarser = cv2.resize(filled, (total.shape[1], total.shape[0]), interpolation=cv2.INTER_LINEAR)
            filled = total + coarser * (1 - part)
        return np.asarray(filled, dtype=np.float64)

    return continued
