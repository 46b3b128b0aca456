"""Checks that derivatives are derivatives, for every model of the software."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import numpy.typing as npt

StateT = TypeVar("StateT")
FloatArray = npt.NDArray[np.float64]


def central_differences(
    predict: Callable[[StateT], FloatArray],
    state: StateT,
    retract: Callable[[StateT, FloatArray], StateT],
    steps: npt.ArrayLike,
) -> FloatArray:
    """Differentiate by central differences, extrapolated once (error of fourth order in the steps)."""
    steps = np.asarray(steps, dtype=np.float64)
    columns = []
    for i, size in enumerate(steps):
        slopes = []
        for share in (1.0, 0.5):
            step = np.zeros(steps.size)
            step[i] = size * share
            slopes.append((predict(retract(state, step)) - predict(retract(state, -step))) / (2 * size * share))
        columns.append((4 * slopes[1] - slopes[0]) / 3)
    return np.stack(columns, axis=-1)


def check_jacobian(
    jacobian: FloatArray, differences: FloatArray, *, relative: float = 1e-7, structural_zeros: bool = True
) -> None:
    """Compare a Jacobian, shape (..., n), with differences: each column to a share of its own largest entry.

    With ``structural_zeros`` an entry given as exactly 0 must be one to 1e-9 of its column.
    """
    assert jacobian.shape == differences.shape
    assert np.isfinite(jacobian).all()
    flat, other = jacobian.reshape(-1, jacobian.shape[-1]), differences.reshape(-1, jacobian.shape[-1])
    largest = np.maximum(np.abs(other).max(axis=0), 1e-300)
    error = np.abs(flat - other) / largest
    worst = np.unravel_index(np.argmax(error), error.shape)
    assert error.max() <= relative, f"entry {worst}: {flat[worst]} given, {other[worst]} by differences"
    if structural_zeros:
        false_zeros = (flat == 0) & (np.abs(other) / largest > 1e-9)
        assert not false_zeros.any(), f"entries given as zero that are not: {np.argwhere(false_zeros)[:5].tolist()}"
