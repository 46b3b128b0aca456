"""Ellipses as images of circles, and the eccentricity of their centres.

An ellipse is held as centre c and shape S, the set (x - c)' S^-1 (x - c) = 1. Its dual conic, the set of its tangents,
is then C* = [[c c' - S, c], [c', 1]] up to scale: centre and shape are read from C* without any root.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array, freeze

#: Points of the ellipse that are sent through the lens; the lens's curvature needs its first three harmonics.
_LENS_POINTS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Ellipse(ShortRepr):
    """An ellipse in the image.

    center_px (2,): Its centre (x, y) [px].
    shape_px2 (2, 2): Symmetric, positive definite: eigenvalues are the squared semi-axes [px^2].
    InputError: The shape is not symmetric or not positive definite.

    >>> circle = Ellipse(np.array([5.0, 4.0]), 9.0 * np.eye(2))
    >>> circle.radius_px
    3.0
    """

    center_px: FloatArray
    shape_px2: FloatArray

    def __post_init__(self) -> None:
        shape = float_array("shape_px2", self.shape_px2, (2, 2))
        (xx, xy), (yx, yy) = shape.tolist()
        if abs(xy - yx) > 1e-9 * (xx + yy) or not (xx > 0 and xx * yy - xy * yx > 0):
            raise InputError(f"shape_px2: a symmetric, positive definite matrix is needed, not {shape.tolist()}")
        object.__setattr__(self, "center_px", float_array("center_px", self.center_px, (2,)))
        object.__setattr__(self, "shape_px2", shape)

    @property
    def semi_axes_px(self) -> tuple[float, float]:
        """Semi-axes, the larger one first [px]."""
        (xx, xy), (_, yy) = self.shape_px2
        middle, reach = 0.5 * (xx + yy), float(np.hypot(0.5 * (xx - yy), xy))
        return float(np.sqrt(middle + reach)), float(np.sqrt(max(middle - reach, 0.0)))

    @property
    def radius_px(self) -> float:
        """Geometric mean of the semi-axes: the circle of the same area [px]."""
        (xx, xy), (_, yy) = self.shape_px2
        return float((xx * yy - xy * xy) ** 0.25)

    @property
    def frame_px(self) -> FloatArray:
        """Symmetric root R of the shape: c + R (cos t, sin t) runs along the ellipse, shape (2, 2) [px]."""
        root_determinant = self.radius_px**2
        trace = float(np.trace(self.shape_px2))
        return freeze((self.shape_px2 + root_determinant * np.eye(2)) / np.sqrt(trace + 2 * root_determinant))

    def points_px(self, angles_rad: npt.ArrayLike, scale: npt.ArrayLike = 1.0) -> FloatArray:
        """Return points of the ellipse, or of an ellipse of the same centre and form.

        Shapes: result (..., 2).
        angles_rad (...): Parameter t of c + scale R (cos t, sin t) [rad].
        scale: Size relative to this ellipse.
        """
        angles = np.asarray(angles_rad, dtype=np.float64)
        circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1) * np.asarray(scale, dtype=np.float64)[..., None]
        return np.asarray(self.center_px + circle @ self.frame_px.T)

    def moved(self, offset_px: npt.ArrayLike) -> "Ellipse":
        """Return the same ellipse elsewhere.

        offset_px (2,): Added to the centre [px].
        """
        return Ellipse(self.center_px + np.asarray(offset_px, dtype=np.float64), self.shape_px2)


@dataclass(frozen=True, slots=True, eq=False)
class NamedEllipses(ShortRepr):
    """Ellipses of named targets in one photo.

    names length n: The targets.
    centers_px (n, 2): Centres (x, y) [px].
    shapes_px2 (n, 2, 2): Shapes as of `Ellipse` [px^2].
    """

    names: tuple[str, ...]
    centers_px: FloatArray
    shapes_px2: FloatArray

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(self, "centers_px", float_array("centers_px", self.centers_px, (n, 2)))
        object.__setattr__(self, "shapes_px2", float_array("shapes_px2", self.shapes_px2, (n, 2, 2)))

    def __len__(self) -> int:
        return len(self.names)

    def renewed(self, names: tuple[str, ...], centers_px: FloatArray, shapes_px2: FloatArray) -> "NamedEllipses":
        """Return them with other ellipses of some of the targets.

        Shapes: names length m, centers_px (m, 2), shapes_px2 (m, 2, 2).
        """
        place = {name: k for k, name in enumerate(self.names)}
        rows = [place[name] for name in names]
        centers, shapes = self.centers_px.copy(), self.shapes_px2.copy()
        centers[rows], shapes[rows] = centers_px, shapes_px2
        return NamedEllipses(self.names, centers, shapes)


# --- images of circles ----------------------------------------------------------------------------------------------


def circle_image_center_px(
    camera: Camera, centers_cam_m: npt.ArrayLike, normals_cam: npt.ArrayLike, radius_m: npt.ArrayLike
) -> FloatArray:
    """Return where centres of circles are measured: the centres of their images' ellipses.

    Shapes: radius_m (n,).
    centers_cam_m (n, 3): Centres of the circles in the camera's frame [m].
    normals_cam (n, 3): Unit normals of their planes in the camera's frame; the sign does not matter.
    Returns (n, 2): Centres of the ellipses; NaN for circles that reach behind the camera [px].

    A circle of centre X, unit normal n and radius r has in the ideal image (at unit distance) the dual conic
    C* = P Q* P' = X X' - r^2 (I - n n'), from which centre and shape are read. The lens bends this ellipse: twelve of
    its points are sent through the camera, and the first harmonic of their departure, along the normals, from the
    affine image of the ellipse is what a fit to the edge makes of the bending. At 30 px diameter and
    k1 = -0.1 the bending shifts the centre by up to 0.006 px, a fifth of the eccentricity.
    """
    centers = float_array("centers_cam_m", centers_cam_m, (None, 3), finite=False)
    normals = float_array("normals_cam", normals_cam, (len(centers), 3), finite=False)
    radius = np.broadcast_to(np.asarray(radius_m, dtype=np.float64), (len(centers),))
    square = (radius**2)[:, None, None]
    dual = centers[:, :, None] * centers[:, None, :] - square * (np.eye(3) - normals[:, :, None] * normals[:, None, :])
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = dual[:, 2, 2]
        visible = (scale > 0) & (centers[:, 2] > 0)
        scale = np.where(visible, scale, np.nan)
        middle = dual[:, :2, 2] / scale[:, None]
        shape = middle[:, :, None] * middle[:, None, :] - dual[:, :2, :2] / scale[:, None, None]
        return freeze(_through_lens(camera, middle, shape))


def _through_lens(camera: Camera, middle: FloatArray, shape: FloatArray) -> FloatArray:
    """Centres, for a fit to the edge, of ellipses of the ideal image after the lens has bent them."""
    root = np.sqrt(np.maximum(shape[:, 0, 0] * shape[:, 1, 1] - shape[:, 0, 1] ** 2, 0.0))
    trace = shape[:, 0, 0] + shape[:, 1, 1]
    frame = (shape + root[:, None, None] * np.eye(2)) / np.sqrt(trace + 2 * root)[:, None, None]
    angles = np.arange(_LENS_POINTS) * (2 * np.pi / _LENS_POINTS)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ideal = middle[:, None, :] + np.einsum("nij,kj->nki", frame, circle)
    ideal = np.concatenate([middle[:, None, :], ideal], axis=1)
    pixels = camera.project(np.concatenate([ideal, np.ones((*ideal.shape[:2], 1))], axis=2))
    start, outline = pixels[:, 0], pixels[:, 1:]
    affine = np.einsum("nki,kj->nij", outline, circle) * (2 / _LENS_POINTS)
    departure = outline - start[:, None, :] - np.einsum("nij,kj->nki", affine, circle)
    determinant = affine[:, 0, 0] * affine[:, 1, 1] - affine[:, 0, 1] * affine[:, 1, 0]
    determinant = np.where(np.abs(determinant) > 0, determinant, np.nan)
    adjoint = np.empty_like(affine)
    adjoint[:, 0, 0], adjoint[:, 1, 1] = affine[:, 1, 1], affine[:, 0, 0]
    adjoint[:, 0, 1], adjoint[:, 1, 0] = -affine[:, 0, 1], -affine[:, 1, 0]
    in_circle = np.einsum("nij,nkj->nki", adjoint / determinant[:, None, None], departure)
    along_normal = np.einsum("nki,ki->nk", in_circle, circle)
    shift = np.einsum("nk,ki->ni", along_normal, circle) * (2 / _LENS_POINTS)
    # A circle too small to have a shape is a point: nothing to correct.
    return np.asarray(start + np.nan_to_num(np.einsum("nij,nj->ni", affine, shift), nan=0.0))


def eccentricity_px(
    camera: Camera, centers_cam_m: npt.ArrayLike, normals_cam: npt.ArrayLike, radius_m: npt.ArrayLike
) -> FloatArray:
    """Return centre of the ellipse minus image of the circle's centre.

    Shapes: radius_m (n,).
    centers_cam_m (n, 3): Centres of the circles in the camera's frame [m].
    normals_cam (n, 3): Unit normals of their planes in the camera's frame; the sign does not matter.
    Returns (n, 2): To be subtracted from measured centres, or added to projected points [px].

    About 0.005 px at 12 px diameter, 0.03 px at 30 px and 0.09 px at 50 px: worth correcting above 15 px.
    """
    return freeze(
        circle_image_center_px(camera, centers_cam_m, normals_cam, radius_m)
        - camera.project(np.asarray(centers_cam_m, dtype=np.float64))
    )
