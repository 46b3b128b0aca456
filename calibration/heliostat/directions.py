"""Small angles between directions: right and up as seen along one of them."""

import numpy as np

from heliogauge.validate import FloatArray


def stereographic(directions: FloatArray, towards: FloatArray) -> FloatArray:
    """Return two coordinates of unit directions about others: angles near them, growing to infinity behind.

    Parameters
    ----------
    directions, towards : ndarray, shape (n, 3)
        Unit vectors.

    Returns
    -------
    ndarray, shape (n, 2)
        ``2 (d.t) / (1 + d.d0)`` along right and up as seen along ``towards`` [rad].
    """
    right, up = tangents(towards)
    denominator = 1.0 + np.einsum("ni,ni->n", directions, towards)
    across = np.stack([np.einsum("ni,ni->n", directions, axis) for axis in (right, up)], axis=1)
    return np.asarray(2.0 * across / denominator[:, None])


def tangents(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return right and up as seen by one who looks along unit directions (n, 3); east is right along the vertical."""
    right = np.stack([directions[:, 1], -directions[:, 0], np.zeros(len(directions))], axis=1)
    length = np.linalg.norm(right, axis=1)
    # Within 1e-6 rad of the vertical the heading is rounding.
    steep = length < 1e-6
    right = np.where(steep[:, None], [1.0, 0.0, 0.0], right / np.where(steep, 1.0, length)[:, None])
    right -= np.einsum("ni,ni->n", right, directions)[:, None] * directions
    return right, np.cross(right, directions)


def stereographic_derivatives(directions: FloatArray, changes: FloatArray, towards: FloatArray) -> FloatArray:
    """Return how `stereographic` changes, shape (n, 2, k), with changes of the directions, shape (n, 3, k).

    Parameters
    ----------
    directions : ndarray, shape (n, 3)
        Unit vectors.
    changes : ndarray, shape (n, 3, k)
        Their derivatives.
    towards : ndarray, shape (n, 3)
        Unit vectors that stay.

    Returns
    -------
    ndarray, shape (n, 2, k)
        Derivatives of both coordinates.
    """
    right, up = tangents(towards)
    denominator = 1.0 + np.einsum("ni,ni->n", directions, towards)
    value = stereographic(directions, towards)
    # d(2 x / (1 + c)) = (2 dx - value dc) / (1 + c): one contraction with a combined direction per coordinate.
    first = (2.0 * right - value[:, :1] * towards) / denominator[:, None]
    second = (2.0 * up - value[:, 1:] * towards) / denominator[:, None]
    return np.stack([first, second], axis=1) @ changes


def cross_columns(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return ``first x second``, shape (n, 3, k), of columns (n, 3, k) with vectors (n, 3)."""
    x, y, z = second[:, 0, None], second[:, 1, None], second[:, 2, None]
    product = np.empty_like(first)
    product[:, 0] = first[:, 1] * z - first[:, 2] * y
    product[:, 1] = first[:, 2] * x - first[:, 0] * z
    product[:, 2] = first[:, 0] * y - first[:, 1] * x
    return product
