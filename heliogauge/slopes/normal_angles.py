"""Angles between measured and design normals, in two components: what SDx, SDy and SD are the RMS of.

A mirror's slopes p = dz/dx and q = dz/dy give the normal n = (-p, -q, 1) / L with L = sqrt(1 + p^2 + q^2). Two
directions e_x and e_y across n are the map's x and y axes, turned by the smallest rotation that takes z to n. The
deviation of the measured from the design normal is the smallest rotation between the two; its size is the angle
between them, and its components are the parts of that angle along -e_x and -e_y of the design normal, so that a mirror
that rises too much towards +x has a positive angle in x, like its slope error. Their squares sum to the square of the
whole angle. On a trough (q = 0) the component in x is ``atan(p) - atan(p_design)``, the Observer's -theta_r; on a flat
mirror both components are the slope errors.
"""

import numpy as np

from heliogauge.validate import FloatArray


def tangents(slope_x: FloatArray, slope_y: FloatArray) -> FloatArray:
    """Return the directions e_x and e_y across the normal, shape (2, 3, ...)."""
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    # From n_x^2 / (1 + n_z) and its like: the rotation from z to n, without its axis, which a flat mirror lacks.
    share = 1 / (length * (length + 1))
    mixed = -slope_x * slope_y * share
    along_x = np.stack([1 - slope_x**2 * share, mixed, slope_x / length])
    along_y = np.stack([mixed, 1 - slope_y**2 * share, slope_y / length])
    return np.stack([along_x, along_y])


def normal_angles(
    slope_x: FloatArray, slope_y: FloatArray, design_slope_x: FloatArray, design_slope_y: FloatArray
) -> FloatArray:
    """Return the components in x and y of the angles from design to measured normals, shape (2, ...) [rad].

    Shapes: slopes (...).

    The angle is ``atan2(|n x m|, n.m)`` from the differences of the slopes: arccos would lose all below 1e-8 rad.
    """
    p, q = design_slope_x, design_slope_y
    dp, dq = slope_x - p, slope_y - q
    # n = (-p, -q, 1) and m = n - (dp, dq, 0), not of unit length
    cross = np.sqrt(dp**2 + dq**2 + (p * dq - q * dp) ** 2)
    angle = np.arctan2(cross, 1 + p * slope_x + q * slope_y)
    (x_x, y_x, _), (x_y, y_y, _) = tangents(p, q)
    across = np.stack([x_x * dp + y_x * dq, x_y * dp + y_y * dq])
    return np.asarray(across * (angle / np.maximum(np.hypot(*across), np.finfo(np.float64).tiny)))


def d_angles_d_slopes(slope_x: FloatArray, slope_y: FloatArray) -> FloatArray:
    """Return how the angles of the normal change with the slopes, shape (2, 2, ...); on a trough 1 / (1 + p^2) in x."""
    return tangents(slope_x, slope_y)[:, :2] / np.sqrt(1 + slope_x**2 + slope_y**2)
