"""The only place that checks arrays: every public border gets read-only float64 copies of known shape."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]
TimeArray = npt.NDArray[np.datetime64]
FlagArray = npt.NDArray[np.uint32]
AnyFloatArray = npt.NDArray[np.float64] | npt.NDArray[np.float32]


def _shape_text(shape: Sequence[int | None]) -> str:
    return "(" + ", ".join("n" if size is None else str(size) for size in shape) + ")"


def float_array(name: str, values: npt.ArrayLike, shape: Sequence[int | None], *, finite: bool = True) -> FloatArray:
    """Copy values into a read-only float64 array of a given shape.

    name: Name of the argument, used in the message.
    values: What the caller gave.
    shape: Wanted shape; None stands for any length of that axis.
    finite: Refuse NaN and infinity.
    InputError: Not numbers, another shape, or not finite.

    >>> float_array("point_m", [1, 2, 3], (3,))
    array([1., 2., 3.])
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: numbers of shape {_shape_text(shape)} are needed, not {values!r:.80}") from error
    # The quick comparison first: values of single targets are checked by the thousand.
    if array.shape != shape and not (
        array.ndim == len(shape)
        and all(want is None or size == want for size, want in zip(array.shape, shape, strict=True))
    ):
        raise InputError(f"{name}: shape {_shape_text(shape)} is needed, not {array.shape}")
    if finite and not np.isfinite(array).all():
        raise InputError(f"{name}: {np.count_nonzero(~np.isfinite(array))} of {array.size} values are not finite")
    array.setflags(write=False)
    return array


def positive(name: str, value: float, unit: str) -> float:
    """Return a number that must be finite and above zero.

    name: Name of the argument, used in the message.
    value: What the caller gave.
    InputError: Zero, negative or not finite.
    """
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name}: a positive number of {unit} is needed, not {value}")
    return float(value)


def covariance_matrix(name: str, values: npt.ArrayLike, size: int) -> FloatArray:
    """Copy a covariance matrix, checked to be symmetric and positive semi-definite.

    name: Name of the argument, used in the message.
    values (size, size): What the caller gave.
    Returns (size, size): A read-only copy.
    InputError: Another shape, not symmetric, or a negative variance along some direction.
    """
    matrix = float_array(name, values, (size, size))
    # Parameters of one matrix differ in unit by many powers of ten: judge symmetry and sign on the correlations.
    scale = np.sqrt(np.abs(np.diag(matrix)))
    scale[scale == 0] = 1.0
    correlation = matrix / scale[:, None] / scale[None, :]
    if size and np.abs(correlation - correlation.T).max() > 1e-9:
        raise InputError(f"{name}: a covariance matrix must be symmetric")
    if size and np.linalg.eigvalsh(correlation).min() < -1e-9 * size:
        raise InputError(f"{name}: a covariance matrix must not have a negative variance along any direction")
    return matrix


def freeze(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Make an array read-only in place and return it (for arrays that the caller has just computed)."""
    array.setflags(write=False)
    return array
