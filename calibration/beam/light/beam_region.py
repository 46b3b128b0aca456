"""Where on the target the beam is: beam and background are found in turn, because each needs the other."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np

from calibration.beam.light.background import (
    Background,
    area_resized,
    background_around,
    continued_under,
    shadow_steps,
)
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray

__all__ = ["BeamRegion", "find_beam_region"]

#: The search runs on a picture of this many pixels on the longer side: a beam that is smaller than one of them is not
#: a beam, and panels, seams and noise average out.
_COARSE_PX = 96
#: Smoothing for the outline of the beam [share of the longer side].
_SMOOTHING = 0.01
#: Outline of the beam, as a share of its peak: in the first round; later as faint as the background's scatter allows,
#: between these shares. Skirts that are left out shift the centroid of a lopsided beam and pass for background.
_FIRST_OUTLINE, _FAINTEST, _BRIGHTEST = 0.3, 0.01, 0.1
_OUTLINE_SCATTERS = 5.0
#: Margin around the outline that is not counted as free, for the beam's faint skirts [share of the longer side].
_MARGIN = 0.05
#: Reach of a beam in standard deviations of its core, the light above half the peak: of a Gaussian's core they are
#: 0.554 of its own, so this is three of them.
_CORE_REACH = 5.4
#: What is brighter than this share of the peak is not taken for background, wherever it is.
_SECOND = 0.3
_ROUNDS = 8
#: Share of the pixels that may still change between beam and background when the search ends.
_SETTLED = 0.006
#: Edges of shadows and panels that are looked for.
_EDGES = 2
#: Rounds in which they are looked for: as the beam becomes known, so do the edges that run under it.
_EDGE_ROUNDS = range(1, 5)
#: Share of the target that must stay free of the beam and its margin.
_LEAST_FREE = 0.08


@dataclass(frozen=True, slots=True, eq=False)
class BeamRegion:
    """Beam and background on a coarse grid that covers the whole target.

    values_dn (h, w): The picture, averaged [DN].
    background: The target's own brightness.
    smoothed_dn (h, w): Picture minus background, smoothed [DN].
    inside (h, w): Pixels of the beam.
    free (h, w): Pixels that no beam lights.
    others (h, w): Pixels as bright as a beam that do not belong to this one.
    peak_dn: Largest smoothed value [DN].
    outline_dn: Smoothed value on the outline of the beam [DN].
    smoothing: Standard deviation of the smoothing [share of the longer side].
    scatter_dn: Scatter of smoothed values where no beam is [DN].
    little_background: Whether too little of the target was free.
    """

    values_dn: FloatArray
    background: Background
    smoothed_dn: FloatArray
    inside: BoolArray
    free: BoolArray
    others: BoolArray
    peak_dn: float
    outline_dn: float
    smoothing: float
    scatter_dn: float
    little_background: bool


def find_beam_region(
    values_dn: FloatArray,
    valid: BoolArray,
    *,
    empty: FloatArray | None = None,
    full_scale_dn: float = 255.0,
    edges_first: bool = False,
) -> BeamRegion:
    """Find beam and background of a rectified picture.

    values_dn (h, w): Picture of the target; finite everywhere [DN].
    valid (h, w): Pixels that show the target.
    empty (h, w): The target without a beam [DN].
    full_scale_dn: End of the grey scale [DN].
    edges_first: Whether edges of shadows are looked for before the beam is known: right where a shadow is as strong
        as the beam, wrong where a beam reaches across the target.
    Returns: The brightest beam; whether it is one at all is for the caller to judge from peak and scatter.
    EstimationError: Too little of the target is seen.
    """
    shape = _coarse_shape(values_dn.shape)
    values = area_resized(values_dn, shape)
    seen = area_resized(valid.astype(np.float32), shape) > 0.999
    pattern = None if empty is None else area_resized(empty, shape)
    if seen.sum() < 100:
        raise EstimationError(f"only {int(seen.sum())} of {seen.size} coarse pixels show the target")
    fit = partial(background_around, values, empty=pattern, full_scale_dn=full_scale_dn)
    background = _start(values, seen, fit, _EDGES if edges_first else 0)
    smooth = _smoothing_over(seen)
    background, free, little = _separate(values, seen, fit, smooth, background)
    smoothed = smooth(values - background.values_dn)
    share = _outline_share(smoothed, background)
    inside, bright = _outline(smoothed, seen, share)
    peak = float(smoothed[inside].max()) if inside.any() else 0.0
    scatter = _upper_scatter(smoothed[free])
    floor = full_scale_dn / 255 / np.sqrt(12)
    return BeamRegion(
        values_dn=values,
        background=background,
        smoothed_dn=smoothed,
        inside=inside,
        free=free,
        others=bright & ~inside,
        peak_dn=peak,
        outline_dn=share * float(smoothed.max()),
        smoothing=_SMOOTHING,
        scatter_dn=max(scatter, 0.1 * floor),
        little_background=little,
    )


def _coarse_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    scale = min(1.0, _COARSE_PX / max(shape))
    return max(2, round(shape[0] * scale)), max(2, round(shape[1] * scale))


class _Separated(NamedTuple):
    """The background, the pixels free of the beam, and whether these were too few."""

    background: Background
    free: BoolArray
    is_little: bool


def _separate(
    values: FloatArray,
    seen: BoolArray,
    fit: "partial[Background]",
    smooth: Callable[[FloatArray], FloatArray],
    background: Background,
) -> _Separated:
    """Find beam and background in turn."""
    free, little = seen, False
    steps: list[FloatArray] = []
    for k in range(_ROUNDS):
        smoothed = smooth(values - background.values_dn)
        _, bright = _outline(smoothed, seen, _outline_share(smoothed, background) if k else _FIRST_OUTLINE)
        now_free = seen & ~_grown(bright)
        if now_free.mean() < _LEAST_FREE:
            little = True
            break
        if k > 1 and np.count_nonzero(now_free != free) <= _SETTLED * free.size:
            break
        changed = np.count_nonzero(now_free != free) / free.size
        free = now_free
        # Where no edge was found, none will be, unless the beam turned out to be elsewhere.
        if k in _EDGE_ROUNDS and (steps or k == _EDGE_ROUNDS[0] or changed > 0.02):
            plain = fit(free, continued=False)
            steps = shadow_steps(values, free, plain, _EDGES)
            if not steps:
                background = continued_under(plain, free)
                continue
        background = fit(free, steps=steps, continued=k > 0)
    return _Separated(background, free, little)


def _start(values: FloatArray, seen: BoolArray, fit: "partial[Background]", edges: int) -> Background:
    """Fit the background first without knowing the beam: pixels that are too bright leave one round after another."""
    free = seen
    for _ in range(4):
        background = fit(free, continued=False)
        if edges:
            background = fit(free, steps=shadow_steps(values, free, background, edges), continued=False)
        over = values - background.values_dn
        kept = seen & (over < 2.5 * background.scatter_dn)
        if kept.mean() < _LEAST_FREE:
            break
        free = kept
    return background


def _smoothing_over(seen: BoolArray) -> Callable[[FloatArray], FloatArray]:
    """Return what smooths pictures of which some pixels are seen; the others are 0."""
    sigma = _SMOOTHING * max(seen.shape)
    share = cv2.GaussianBlur(seen.astype(np.float64), (0, 0), sigma)
    factor = seen / np.maximum(share, 1e-3)

    def smooth(difference: FloatArray) -> FloatArray:
        return np.asarray(cv2.GaussianBlur(difference * seen, (0, 0), sigma) * factor)

    return smooth


def _outline_share(smoothed: FloatArray, background: Background) -> float:
    peak = float(smoothed.max())
    # The scatter about the smooth part: under the beam, the panels and shadows in it are not known.
    wanted = _OUTLINE_SCATTERS * background.scatter_dn / peak if peak > 0 else 1.0
    return min(_BRIGHTEST, max(_FAINTEST, wanted))


def _outline(smoothed: FloatArray, seen: BoolArray, share: float) -> tuple[BoolArray, BoolArray]:
    """Return the beam, and what may be lit by a beam: the beam and all that is as bright as a second one."""
    peak = float(smoothed.max())
    bright = seen & (smoothed > share * peak) & (smoothed > 0)
    inside = _most_light(bright, smoothed)
    if not inside.any():
        return inside, bright
    inside = _most_light(inside & _near_core(smoothed, inside & (smoothed > 0.5 * smoothed[inside].max())), smoothed)
    return inside, inside | (bright & (smoothed > _SECOND * peak))


def _most_light(bright: BoolArray, smoothed: FloatArray) -> BoolArray:
    n, labels = cv2.connectedComponents(bright.astype(np.uint8), connectivity=4)
    if n <= 2:
        return bright
    light = np.bincount(labels.ravel(), weights=smoothed.ravel(), minlength=n)
    light[0] = -np.inf
    return np.asarray(labels == int(np.argmax(light)))


def _near_core(smoothed: FloatArray, core: BoolArray) -> BoolArray:
    """Return the pixels within an ellipse about the beam's bright core: faint bridges to shadows end there."""
    if np.count_nonzero(core) < 6:
        return np.ones_like(core)
    share = smoothed * core
    columns, rows = share.sum(axis=0), share.sum(axis=1)
    total = float(rows.sum())
    x, y = np.arange(columns.size, dtype=np.float64), np.arange(rows.size, dtype=np.float64)
    x -= columns @ x / total
    y -= rows @ y / total
    cross = float(y @ share @ x) / total
    spread = np.array([[columns @ x**2 / total, cross], [cross, rows @ y**2 / total]])
    form = np.linalg.inv(spread + 0.1 * np.eye(2))
    reach = np.add.outer(form[1, 1] * y**2, form[0, 0] * x**2) + np.outer(2 * form[0, 1] * y, x)
    return np.asarray(reach < _CORE_REACH**2)


def _upper_scatter(smoothed: FloatArray) -> float:
    """Scatter of what is brighter than the background; marks are darker, and a beam never is."""
    if smoothed.size < 10:
        return 0.0
    middle = float(np.median(smoothed))
    # Quantiles 84 % and 99 % of a normal distribution are 1 and 2.33 sigmas away; structures have longer tails.
    near, far = np.quantile(smoothed, (0.8413, 0.99)) - middle
    return float(max(near, far / 2.326))


def _grown(region: BoolArray) -> BoolArray:
    radius = max(1, round(_MARGIN * max(region.shape)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(cv2.dilate(region.astype(np.uint8), disc) > 0)
