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


def across_normal(slope_x: FloatArray, slope_y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what e_x and e_y have along x and y: e_x along x, each along the other's, and e_y along y (...)."""
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    # From n_x^2 / (1 + n_z) and its like: the rotation from z to n, without its axis, which a flat mirror lacks.
    share = 1 / (length * (length + 1))
    return 1 - slope_x**2 * share, -slope_x * slope_y * share, 1 - slope_y**2 * share


def tangents(slope_x: FloatArray, slope_y: FloatArray) -> FloatArray:
    """Return the directions e_x and e_y across the normal, shape (2, 3, ...)."""
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    along_x, mixed, along_y = across_normal(slope_x, slope_y)
    return np.stack([np.stack([along_x, mixed, slope_x / length]), np.stack([mixed, along_y, slope_y / length])])


def normal_angles(
    slope_x: FloatArray,
    slope_y: FloatArray,
    design_slope_x: FloatArray,
    design_slope_y: FloatArray,
) -> FloatArray:
    """Return the components in x and y of the angles from design to measured normals, shape (2, ...) [rad].

    Shapes: slopes (...).

    The angle is ``atan2(|n x m|, n.m)`` from the differences of the slopes: arccos would lose all below 1e-8 rad.
    """
    p, q = design_slope_x, design_slope_y
    return angles_of_errors(slope_x - p, slope_y - q, p, q, across_normal(p, q))


def angles_of_errors(
    error_x: FloatArray,
    error_y: FloatArray,
    design_slope_x: FloatArray,
    design_slope_y: FloatArray,
    across: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """Return what `normal_angles` does, from slope errors (measured minus design) and `across_normal` of the design."""
    p, q, dp, dq = design_slope_x, design_slope_y, error_x, error_y
    along_x, mixed, along_y = across
    direction = np.stack([along_x * dp + mixed * dq, mixed * dp + along_y * dq])
    length = np.sqrt(direction[0] * direction[0] + direction[1] * direction[1])
    # n = (-p, -q, 1) and m = n - (dp, dq, 0), not of unit length: |n x m| = |n| |what m - n has across n|
    squared = 1 + p * p + q * q
    angle = np.arctan2(np.sqrt(squared) * length, squared + p * dp + q * dq)
    direction *= angle / np.maximum(length, np.finfo(np.float64).tiny)
    return direction


def d_angles_d_slopes(slope_x: FloatArray, slope_y: FloatArray) -> FloatArray:
    """Return how the angles of the normal change with the slopes, shape (2, 2, ...); on a trough 1 / (1 + p^2) in x."""
    along_x, mixed, along_y = across_normal(slope_x, slope_y)
    return np.stack([np.stack([along_x, mixed]), np.stack([mixed, along_y])]) / np.sqrt(1 + slope_x**2 + slope_y**2)
