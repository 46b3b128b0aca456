"""Whether the mirror stands still from set to set: shifts of the mean light of each set, by its edges."""

from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.phase import solve_steps
from deflectometry.setup.patterns import FringePattern
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.validate import FloatArray

#: Pixels looked at; the edges of a mirror that fills 800 x 800 px are 5000 of 50 000.
_PIXELS = 50_000
#: Shift that the mean light of good sets may seem to have: the light of the room follows the display's by a per cent,
#: and an edge two pixels wide whose two levels change by that moves by a fiftieth of a pixel.
_LEAST_PX = 0.02
_SIGNIFICANT = 6.0
#: Share of the steepest edge from which on a pixel counts as one of an edge.
_STEEP_SHARE = 0.2


def sets_shifts(frames: npt.NDArray[Any], pattern: FringePattern) -> tuple[FloatArray, FloatArray]:
    """Return the shift of each set against the usual one, and its standard deviation; both (s, 2), x and y [px].

    frames (n, h, w): Frames in the order of the pattern [DN].

    The mean light of a set holds no fringes, but the edges of the mirror and what stands around it. Against the median
    of all sets, each is ``offset + gain * light + shift . gradient of light`` by least squares (Lucas and Kanade 1981),
    linear for a shift below the width of an edge. Sets with frames left out are not compared: theirs holds harmonics.
    """
    height, width = frames.shape[1:]
    stride = max(1, int(np.sqrt(height * width / _PIXELS)))
    around = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))
    places = [
        (slice(1 + down, height - 1 + down, stride), slice(1 + right, width - 1 + right, stride))
        for down, right in around
    ]
    size = len(range(1, height - 1, stride)) * len(range(1, width - 1, stride))
    every = np.empty((len(pattern.sets), len(around), size), dtype=np.float32)
    for number, (one, where) in enumerate(zip(pattern.sets, pattern.frame_slices, strict=True)):
        weights = solve_steps(one.steps_rad).estimate[0].astype(np.float32)
        for target, place in zip(every[number], places, strict=True):
            np.matmul(weights, frames[where, *place].reshape(one.n_frames, -1).astype(np.float32), out=target)
    # Where light changes little from pixel to pixel there is no edge, and fringes that are left weigh more. The mean of
    # all sets tells where; what the edges are like is for their median, which one that moved does not change.
    mean = every.mean(axis=0)
    rough = np.hypot(mean[2] - mean[1], mean[4] - mean[3])
    means = every[:, :, rough > 0.5 * _STEEP_SHARE * np.quantile(rough, 0.995)].astype(np.float64)
    usual = np.median(means, axis=0)
    along = np.stack([0.5 * (usual[2] - usual[1]), 0.5 * (usual[4] - usual[3])])
    steep = np.hypot(*along)
    chosen = steep > 0.5 * _STEEP_SHARE * float(np.quantile(rough, 0.995))
    shifts, sigmas = np.zeros((2, len(means), 2))
    if np.count_nonzero(chosen) < 50 or not np.isfinite(usual).all():
        return shifts, sigmas + np.inf
    matrix = np.stack([np.ones(np.count_nonzero(chosen)), usual[0, chosen], *along[:, chosen]])
    inverse = np.linalg.pinv(matrix @ matrix.T)
    for number, one in enumerate(means):
        left = one[0, chosen] - usual[0, chosen]
        found = inverse @ (matrix @ left)
        scatter = float(robust_scale(left - found @ matrix))
        shifts[number] = -found[2:]
        sigmas[number] = max(scatter, 1e-9) * np.sqrt(np.diag(inverse)[2:])
    return shifts, sigmas


def moved_sets(frames: npt.NDArray[Any], pattern: FringePattern) -> dict[int, FloatArray]:
    """Return the sets that moved, by their place in the pattern, with shift and sigma, shape (2, 2) [px]."""
    steps = [one.steps_rad for one in pattern.sets]
    # Three frames at unequal steps leave harmonics in the mean light.
    if min(map(len, steps)) != max(map(len, steps)):
        return {}
    shifts, sigmas = sets_shifts(frames, pattern)
    far = (np.abs(shifts) > _LEAST_PX + _SIGNIFICANT * sigmas).any(axis=1)
    return {int(k): np.stack([shifts[k], sigmas[k]]) for k in np.flatnonzero(far)}
