"""Straight edges in the brightness of a target: borders of shadows, panels of another brightness.

A surface that is smooth cannot follow a step, and extends its error under the beam. A shadow that the receiver or
another tower casts on the target ends in a straight line, and so does a panel.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from heliogauge.validate import BoolArray, Float32Array, FloatArray, freeze

__all__ = ["strongest_edge"]

_DIRECTIONS, _OFFSETS = 24, 25
#: Pixels from which edges are sought; edges are long, so every few pixels show them.
_ENOUGH_PIXELS = 800
#: Half the width over which the brightness changes [share of the target's half side]: the sun's disc blurs a shadow.
_BLUR = 0.02
#: Share of the residuals' squares that a step must explain, and the share of the free pixels on its smaller side.
_LEAST_GAIN, _LEAST_SIDE = 0.08, 0.05
#: Share of that gain below which the best of the coarse candidates is not refined: pure noise has less, and of 1187
#: edges in real photos and composites no coarse candidate had less than 0.4 of it.
_HOPELESS = 0.25


def strongest_edge(residuals: FloatArray, free: BoolArray, basis: FloatArray) -> FloatArray | None:
    """Find the straight step that explains most of a background's residuals.

    residuals (h, w): Picture minus the smooth background [DN].
    free (h, w): Pixels without a beam.
    basis (h, w, k): Functions of the smooth background: what they can follow is no step.
    Returns (h, w): The step, from 0 to 1; None where no step explains a good part of the residuals' squares.
    """
    chosen = np.flatnonzero(free)
    chosen = chosen[:: (chosen.size // _ENOUGH_PIXELS) | 1]
    wanted = residuals.ravel()[chosen]
    height, width = residuals.shape
    orthogonal, _ = np.linalg.qr(basis.reshape(-1, basis.shape[2])[chosen])
    wanted = wanted - orthogonal @ (orthogonal.T @ wanted)
    power = float(wanted @ wanted)
    if not power > 0:
        return None
    best = _search(_all_steps((height, width))[chosen], wanted, orthogonal, _all_edges())
    if best.gain < _HOPELESS * _LEAST_GAIN * power:
        return None
    fine = _grid(best.angle, np.pi / _DIRECTIONS, best.offset, 2.6 / _OFFSETS, (11, 11))
    y, x = np.divmod(chosen, width)
    across, down = (x + 0.5) * (2 / width) - 1, (y + 0.5) * (2 / height) - 1
    best = max(best, _search(_steps(across, down, fine), wanted, orthogonal, fine))
    if best.gain < _LEAST_GAIN * power:
        return None
    columns = ((np.arange(width) + 0.5) * (2 / width) - 1)[None, :]
    rows = ((np.arange(height) + 0.5) * (2 / height) - 1)[:, None]
    return _step(columns * np.cos(best.angle) + rows * np.sin(best.angle) - best.offset)


class _Drop(NamedTuple):
    """How far a step lowers the squares of the residuals, and its angle and offset."""

    gain: float
    angle: float
    offset: float


def _grid(angle: float, reach: float, offset: float, spread: float, counts: tuple[int, int]) -> FloatArray:
    """Candidates (angle, offset), shape (n, 2)."""
    if reach == np.pi:
        angles = np.arange(counts[0]) * (np.pi / counts[0])
    else:
        angles = angle + np.linspace(-reach, reach, counts[0])
    offsets = offset + np.linspace(-spread, spread, counts[1])
    return np.stack([each.ravel() for each in np.meshgrid(angles, offsets, indexing="ij")], axis=1)


@lru_cache(maxsize=1)
def _all_edges() -> FloatArray:
    return freeze(_grid(0.0, np.pi, 0.0, 1.3, (_DIRECTIONS, _OFFSETS)))


@lru_cache(maxsize=2)
def _all_steps(shape: tuple[int, int]) -> Float32Array:
    """Return the steps of the coarse candidates at all pixels, (pixels, n): photos of one size share them."""
    y, x = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    steps = _steps((x + 0.5) * (2 / shape[1]) - 1, (y + 0.5) * (2 / shape[0]) - 1, _all_edges())
    steps.setflags(write=False)
    return steps


def _steps(across: FloatArray, down: FloatArray, candidates: FloatArray) -> Float32Array:
    """Return the steps of candidates at pixels, shape (pixels, n).

    Single precision: gains are compared to a percent, and the table of all steps is what takes the time.
    """
    directions = np.stack([np.cos(candidates[:, 0]), np.sin(candidates[:, 0])])
    steps = (np.stack([across, down], axis=1) @ directions).astype(np.float32)
    steps -= candidates[:, 1].astype(np.float32)
    steps *= np.float32(0.5 / _BLUR)
    steps += np.float32(0.5)
    np.clip(steps, 0, 1, out=steps)
    return np.asarray(steps)


def _search(steps: Float32Array, wanted: FloatArray, orthogonal: FloatArray, candidates: FloatArray) -> _Drop:
    """Return the largest drop of the squares."""
    rows = np.concatenate([orthogonal.T, wanted[None], np.full((1, wanted.size), 1 / wanted.size)])
    *parts, drops, beyond = rows.astype(np.float32) @ steps
    # What is orthogonal to the smooth functions has the power of the step less that of its parts along them.
    power = np.einsum("ij,ij->j", steps, steps) - sum(part * part for part in parts)
    usable = (beyond > _LEAST_SIDE) & (beyond < 1 - _LEAST_SIDE) & (power > 1e-3 * wanted.size)
    gain = np.where(usable, drops**2 / np.where(usable, power, 1.0), 0.0)
    k = int(np.argmax(gain))
    return _Drop(float(gain[k]), float(candidates[k, 0]), float(candidates[k, 1]))


def _step(distance: FloatArray) -> FloatArray:
    return np.clip(0.5 + distance / (2 * _BLUR), 0.0, 1.0)
