"""Ellipses through edges along rays, for all spots of a photo at once: precise enough to start a fit."""

from dataclasses import dataclass

import numpy as np

from heliogauge.adjust.robust_scale import robust_scale_of_rows
from heliogauge.validate import BoolArray, Float32Array, FloatArray
from photogrammetry.centers.pyramid import Pyramid, ellipse_frames

#: Rays from a spot's centre; passes, each with the reach of its rays and their samples, in radii of the ellipse before.
_RAYS = 24
_PASSES = ((0.4, 1.7, 14), (0.7, 1.4, 15))
#: Share of the rays that must meet an edge.
_SEEN_SHARE = 0.75
#: Edges farther from the ellipse than this many robust sigmas are left out of the second fit.
_OUTLIER_SIGMAS = 3.0
#: Which of the sums of x^4, x^3 y, ... y^4, x^3, ... y^3, x^2, x y, y^2 stands where in a product of (x^2, x y, y^2, x,
#: y) with itself.
_PRODUCTS = np.array([[0, 1, 2, 5, 6], [1, 2, 3, 6, 7], [2, 3, 4, 7, 8], [5, 6, 7, 9, 10], [6, 7, 8, 10, 11]])


@dataclass(frozen=True, slots=True, eq=False)
class Outlines:
    """Ellipses of many spots.

    centers_px (n, 2): Centres [px].
    shapes_px2 (n, 2, 2): Shape matrices [px^2].
    rms_px (n,): Rms distance of the edges from the ellipse [px].
    found (n,): Whether there is an ellipse.
    cornered (n,): Share of that rms, as power, in the third and fourth harmonic of the outline: near 1 for triangles
        and squares, and less for discs in the steps of a display's pixels.
    """

    centers_px: FloatArray
    shapes_px2: FloatArray
    rms_px: FloatArray
    found: BoolArray
    cornered: FloatArray


def outlines_along_rays(
    pyramid: Pyramid, centers_px: FloatArray, shapes_px2: FloatArray, middle_dn: FloatArray, dark: BoolArray
) -> Outlines:
    """Find where rays leave spots, and fit an ellipse to each.

    pyramid: The photo; large spots are looked at on a halving, where neither noise nor a display's pixels disturb.
    centers_px (n, 2): Starts: centres [px].
    shapes_px2 (n, 2, 2): Starts: shape matrices [px^2].
    middle_dn (n,): Level half way between inside and outside [DN].
    dark (n,): Whether the spot is darker than its ground.
    Returns: One for each start, found or not.
    """
    centers, shapes = centers_px.copy(), shapes_px2.copy()
    rms, found = np.full(len(centers), np.inf), np.ones(len(centers), dtype=np.bool_)
    off = np.zeros((len(centers), _RAYS))
    angles = np.arange(_RAYS) * (2 * np.pi / _RAYS)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for low, high, samples in _PASSES:
        frames = ellipse_frames(shapes)
        radii = np.linspace(low, high, samples)
        rays = (circle.T[:, :, None] * radii).reshape(2, -1)
        values = pyramid.around(centers, shapes, rays).reshape(-1, _RAYS, samples)
        edges, seen = _first_crossing(values, middle_dn, dark, radii)
        conic, ok = _fit(edges, seen, circle)
        off = np.abs(_distance(conic, edges, circle))
        known = np.where(seen, off, np.nan)
        known[~seen.any(axis=1)] = 0.0
        spread = robust_scale_of_rows(known)[:, None]
        near = seen & (off <= np.maximum(_OUTLIER_SIGMAS * spread, 0.02))
        conic, ok_again = _fit(edges, near, circle)
        off = np.where(near, _distance(conic, edges, circle), 0.0)
        found &= ok & ok_again & (near.sum(axis=1) >= _SEEN_SHARE * _RAYS)
        moved, inner = _ellipses(conic)
        found &= (np.hypot(*moved.T) < 0.7) & np.isfinite(inner).all(axis=(1, 2))
        radius = np.sqrt(np.sqrt(np.maximum(np.linalg.det(shapes), 0.0)))
        rms = radius * np.sqrt((off**2).sum(axis=1) / np.maximum(near.sum(axis=1) - 5, 1))
        good = found[:, None, None]
        centers = np.where(good[:, 0], centers + np.einsum("nij,nj->ni", frames, np.nan_to_num(moved)), centers)
        shapes = np.where(good, frames @ np.nan_to_num(inner) @ frames, shapes)
    waves = np.exp(1j * np.multiply.outer(angles, (3, 4)))
    power = (np.abs(off @ waves) ** 2).sum(axis=1) * (2 / _RAYS)
    return Outlines(centers, shapes, rms, found, power / np.maximum((off**2).sum(axis=1), 1e-12))


def _first_crossing(
    values: Float32Array, middle: FloatArray, dark: BoolArray, radii: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Radius at which each ray first leaves the spot's side of the middle level, and whether it does.

    It enters it before where the spot has a hole.
    """
    beyond = (values > middle[:, None, None].astype(np.float32)) == dark[:, None, None]
    changes = beyond[..., 1:] & ~beyond[..., :-1]
    at = changes.argmax(axis=2)
    where = np.arange(at.size) * values.shape[2] + at.ravel()
    before, after = (values.ravel()[one].reshape(at.shape).astype(np.float64) for one in (where, where + 1))
    step = before - after
    share = (before - middle[:, None]) / np.where(step == 0, 1.0, step)
    seen = np.take_along_axis(changes, at[..., None], axis=2)[..., 0]
    return radii[at] + share * (radii[1] - radii[0]), seen


def _fit(edges: FloatArray, used: BoolArray, circle: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Conics A x^2 + B x y + C y^2 + D x + E y = 1 near the unit circle, where algebraic distances are true ones."""
    c, s = circle.T
    # Sums of products of x = r c and y = r s over the rays are products of powers of r with those of c and s.
    fourth, third, second, first = (
        np.where(used, edges, 0.0) ** degree @ np.stack([c ** (degree - k) * s**k for k in range(degree + 1)], axis=1)
        for degree in (4, 3, 2, 1)
    )
    normal = np.concatenate([fourth, third, second], axis=1)[:, _PRODUCTS] + 1e-9 * np.eye(5)
    right = np.concatenate([second, first], axis=1)
    ok = used.sum(axis=1) >= 8
    return np.linalg.solve(normal, right[..., None])[..., 0], ok


def _distance(conic: FloatArray, edges: FloatArray, circle: FloatArray) -> FloatArray:
    x, y = edges * circle[:, 0], edges * circle[:, 1]
    a, b, c, d, e = (conic[:, k, None] for k in range(5))
    return np.asarray(0.5 * (a * x * x + b * x * y + c * y * y + d * x + e * y - 1))


def _ellipses(conic: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centres and shapes of conics; NaN where they are none."""
    a, b, c, d, e = conic.T
    determinant = a * c - 0.25 * b * b
    valid = (determinant > 1e-6) & (a > 0)
    determinant = np.where(valid, determinant, np.nan)
    x = (0.25 * b * e - 0.5 * c * d) / determinant
    y = (0.25 * b * d - 0.5 * a * e) / determinant
    level = 1 - 0.5 * (d * x + e * y)
    inverse = np.stack([np.stack([c, -0.5 * b], axis=1), np.stack([-0.5 * b, a], axis=1)], axis=1)
    return np.stack([x, y], axis=1), inverse * (level / determinant)[:, None, None]
