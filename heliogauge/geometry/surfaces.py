"""Design surfaces as quadrics, and facets cut from them.

Every design (plane, paraboloid, trough, sphere, ...) is one 4 x 4 matrix, so that an off-axis or canted facet is the
same code as a centred one: the matrix is transformed into the facet's frame exactly, nothing expanded about a vertex.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_between
from heliogauge.validate import BoolArray, FloatArray, float_array, freeze

# 16384 float64 are 128 KiB: the dozen buffers of one block stay in a 2 MiB second-level cache.
_BLOCK = 16384


class HeightAndSlopes(NamedTuple):
    """Height and slopes of a surface at points (x, y), each of shape (...).

    height_m: z [m].
    slope_x, slope_y: dz/dx and dz/dy.
    """

    height_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Quadric:
    """A surface ``F(p) = p^T Q p = 0`` in homogeneous coordinates ``p = (x, y, z, 1)``, seen as a sheet z(x, y).

    matrix (4, 4): Symmetric matrix Q, coordinates in metres. Its scale is free; its sign is chosen here so that
        dF/dz >= 0 at the frame's origin.
    name: The shape in words with its numbers.
    InputError: The matrix is not symmetric, or the surface has no sheet z(x, y) at the origin.

    Of the two sheets of a quadric the one nearer the plane z = 0 at the origin is meant (the one with dF/dz > 0).
    Concave mirrors open to +z: a focal length or radius above zero is concave, below zero convex, infinite flat.
    Roots are written ``2 c / (b + sqrt(b^2 - 4 a c))``, which has no cancellation when the curvature vanishes: planes
    and paraboloids of any focal length share one code path to round-off.

    >>> dish = paraboloid(10.0)
    >>> float(dish.height(2.0, 0.0)), [float(slope) for slope in dish.gradient(2.0, 0.0)]
    (0.1, [0.1, 0.0])
    """

    matrix: FloatArray
    name: str

    def __post_init__(self) -> None:
        matrix = float_array("matrix", self.matrix, (4, 4))
        if not np.allclose(matrix, matrix.T, rtol=1e-12, atol=1e-14 * float(np.abs(matrix).max())):
            raise InputError("matrix: a quadric needs a symmetric matrix")
        matrix = 0.5 * (matrix + matrix.T)
        if not matrix[2].any():
            raise InputError(f"matrix: {self.name} has no sheet z(x, y): z does not occur in it")
        object.__setattr__(self, "matrix", freeze(matrix if matrix[2, 3] >= 0 else -matrix))

    def transformed(self, b_from_a: RigidTransform) -> "Quadric":
        """Return the same surface in frame b.

        b_from_a: From this surface's frame to the new one.
        Returns: The surface in frame b, exact to round-off.
        """
        a_from_b = np.eye(4)
        inverse = b_from_a.inverse()
        a_from_b[:3, :3], a_from_b[:3, 3] = inverse.rotation, inverse.translation_m
        matrix = a_from_b.T @ self.matrix @ a_from_b
        return Quadric(0.5 * (matrix + matrix.T), self.name)

    def height(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Return the height of the sheet.

        x_m, y_m (...): Positions [m], broadcast against each other.
        Returns (...): z [m]; NaN where the surface does not reach.
        """
        return self._sheet(x_m, y_m, with_gradient=False)[0]

    def gradient(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the slopes of the sheet.

        x_m, y_m (...): Positions [m], broadcast against each other.
        Returns (...): dz/dx and dz/dy (dimensionless).
        """
        return self._sheet(x_m, y_m)[1:]

    def height_and_gradient(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> HeightAndSlopes:
        """Return z [m], dz/dx and dz/dy, at the cost of one of them.

        x_m, y_m (...): Positions [m], broadcast against each other.
        Returns: Height [m] and both slopes, each of shape (...); NaN where the surface does not reach.
        """
        return self._sheet(x_m, y_m)

    def normal(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Return the unit normal on the +z side.

        Shapes: result (..., 3).
        x_m, y_m (...): Positions [m], broadcast against each other.
        """
        slope_x, slope_y = self.gradient(x_m, y_m)
        normals = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
        return np.asarray(normals / np.sqrt(1 + slope_x**2 + slope_y**2)[..., None])

    def intersect(self, origins_m: npt.ArrayLike, directions: npt.ArrayLike) -> FloatArray:
        """Intersect lines with the sheet.

        origins_m (..., 3): A point of each line [m], broadcast against the directions.
        directions (..., 3): Directions of any length.
        Returns (...): t with ``origin + t * direction`` on the surface, in lengths of the direction; may be
            negative; NaN where the line misses.

        A line that runs towards -z meets the sheet's +z side, one that runs towards +z its back; so turning a
        direction round turns only the sign of t. A ray that rises and still meets the front (from low inside a deep
        trough towards its rim) is outside this rule.

        The quadratic is solved from where the line crosses z = 0, not from its origin: seen from 1 km the point on a
        sphere of 4 m is then good to 2e-13 m instead of 8e-11 m.
        """
        origins = np.asarray(origins_m, dtype=np.float64)
        rays = np.asarray(directions, dtype=np.float64)
        if origins.shape[-1:] != (3,) or rays.shape[-1:] != (3,):
            raise InputError(f"origins_m, directions: (..., 3) is needed, not {origins.shape} and {rays.shape}")
        shape = np.broadcast_shapes(origins.shape, rays.shape)[:-1]
        flat_rays = np.broadcast_to(rays, (*shape, 3)).reshape(-1, 3)
        # One camera, many rays: its centre stays three numbers.
        one_origin = origins.size == 3
        flat_origins = origins.reshape(1, 3) if one_origin else np.broadcast_to(origins, (*shape, 3)).reshape(-1, 3)
        result = np.empty(flat_rays.shape[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            for rows in _blocks(result.size):
                start = flat_origins[:1] if one_origin else flat_origins[rows]
                result[rows] = self._meet(start, flat_rays[rows])
        return result.reshape(shape)

    def describe(self) -> str:
        """Return the shape in words, with its height and slopes at the origin where they are not zero."""
        height, slope_x, slope_y = (float(value) for value in self._sheet(0.0, 0.0))
        parts = []
        if abs(height) > 1e-9:
            parts.append(f"height {1e3 * height:.4g} mm")
        if max(abs(slope_x), abs(slope_y)) > 1e-9:
            parts.append(f"slopes {1e3 * slope_x:.4g}, {1e3 * slope_y:.4g} mrad")
        return f"{self.name} ({' and '.join(parts)} at the origin of its frame)" if parts else self.name

    def _sheet(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike, *, with_gradient: bool = True) -> HeightAndSlopes:
        grid_x, grid_y = np.broadcast_arrays(np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64))
        flat_x, flat_y = grid_x.reshape(-1), grid_y.reshape(-1)
        height = np.empty(flat_x.size)
        slope_x, slope_y = (np.empty(flat_x.size if with_gradient else 0) for _ in range(2))
        q = self.matrix
        with np.errstate(divide="ignore", invalid="ignore"):
            for rows in _blocks(flat_x.size):
                x, y = flat_x[rows], flat_y[rows]
                # F = a z^2 + 2 b z + c and its half derivatives
                half_x = _linear(q[0, 0], x, q[0, 1], y, q[0, 3])
                half_y = _linear(q[0, 1], x, q[1, 1], y, q[1, 3])
                b = _linear(q[0, 2], x, q[1, 2], y, q[2, 3])
                c = (half_x + q[0, 3]) * x + (half_y + q[1, 3]) * y + q[3, 3]
                z, half_z = _upper_root(q[2, 2], b, c)
                height[rows] = z
                if with_gradient:
                    slope_x[rows] = -_linear(q[0, 2], z, 1.0, half_x, 0.0) / half_z
                    slope_y[rows] = -_linear(q[1, 2], z, 1.0, half_y, 0.0) / half_z
        gradient_shape = grid_x.shape if with_gradient else (0,)
        return HeightAndSlopes(
            height.reshape(grid_x.shape), slope_x.reshape(gradient_shape), slope_y.reshape(gradient_shape)
        )

    def _meet(self, origins: FloatArray, rays: FloatArray) -> FloatArray:
        q = self.matrix
        dx, dy, dz = np.ascontiguousarray(rays.T)
        ox, oy, oz = np.ascontiguousarray(origins.T)
        shift = -oz / dz
        flat = np.abs(dz) < 1e-6 * (np.abs(dx) + np.abs(dy))
        if flat.any():
            # Parallel to the facet's plane: start from the point nearest to the origin instead.
            nearest = -(ox * dx + oy * dy + oz * dz) / (dx * dx + dy * dy + dz * dz)
            shift = np.where(flat, nearest, shift)
        x, y, z = ox + shift * dx, oy + shift * dy, oz + shift * dz
        half_x = _linear(q[0, 0], x, q[0, 1], y, q[0, 3]) + q[0, 2] * z
        half_y = _linear(q[0, 1], x, q[1, 1], y, q[1, 3]) + q[1, 2] * z
        half_z = _linear(q[0, 2], x, q[1, 2], y, q[2, 3]) + q[2, 2] * z
        c = (half_x + q[0, 3]) * x + (half_y + q[1, 3]) * y + (half_z + q[2, 3]) * z + q[3, 3]
        b = half_x * dx + half_y * dy + half_z * dz
        a = (q[0, 0] * dx + 2 * q[0, 1] * dy + 2 * q[0, 2] * dz) * dx + (q[1, 1] * dy + 2 * q[1, 2] * dz) * dy
        a += q[2, 2] * dz * dz
        # Going up, dF/dt > 0; going down, dF/dt < 0: reverse the line so that the same root serves.
        turn = np.where(dz > 0, 1.0, -1.0)
        t = shift + turn * _upper_root(a, turn * b, c)[0]
        return np.where(np.isfinite(t), t, np.nan)


def _upper_root(a: FloatArray | float, b: FloatArray | float, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve ``a z^2 + 2 b z + c = 0`` for the root with ``a z + b >= 0``; also return that half derivative."""
    half_derivative = np.sqrt(b * b - a * c) if np.any(a) else np.abs(b) + 0.0 * c
    # No cancellation for b > 0, which holds wherever the plane z = 0 is nearer to this sheet than to the other one.
    return np.asarray(-c / (b + half_derivative)), np.asarray(half_derivative)


def _linear(
    k1: float, v1: FloatArray | float, k2: float, v2: FloatArray | float, constant: float
) -> FloatArray | float:
    """Return ``k1 v1 + k2 v2 + constant`` without the passes whose factor is zero (most of them, for most designs)."""
    total: FloatArray | float = constant
    for factor, values in ((k1, v1), (k2, v2)):
        if factor == 1.0:
            total = values + total if isinstance(total, np.ndarray) or total != 0 else values
        elif factor != 0.0:
            term = factor * values
            total = term + total if isinstance(total, np.ndarray) or total != 0 else term
    return total


def _blocks(size: int) -> Iterator[slice]:
    for start in range(0, size, _BLOCK):
        yield slice(start, min(start + _BLOCK, size))


def quadric(coefficients: npt.ArrayLike, name: str | None = None) -> Quadric:
    """Return ``z = A x^2 + B y^2 + C x + D y + E x y + F``.

    Shapes: coefficients (6,).
    name: The shape in words.
    InputError: Not six finite numbers.
    """
    a, b, c, d, e, f = float_array("coefficients", coefficients, (6,)).tolist()
    words = f"z = {a:.6g} x^2 + {b:.6g} y^2 + {c:.6g} x + {d:.6g} y + {e:.6g} x y + {f:.6g} (metres)"
    matrix = np.array(
        [[-a, -0.5 * e, 0, -0.5 * c], [-0.5 * e, -b, 0, -0.5 * d], [0, 0, 0, 0.5], [-0.5 * c, -0.5 * d, 0.5, -f]]
    )
    return Quadric(matrix, name or words)


def plane() -> Quadric:
    """Return the plane z = 0."""
    return quadric(np.zeros(6), "plane")


def paraboloid(focal_length_m: float) -> Quadric:
    """Return ``z = (x^2 + y^2) / (4 f)``, the focus at (0, 0, f) [m]."""
    a = 0.25 / _nonzero("focal_length_m", focal_length_m)
    return quadric([a, a, 0, 0, 0, 0], f"paraboloid of focal length {focal_length_m:.6g} m")


def paraboloid_xy(focal_length_x_m: float, focal_length_y_m: float) -> Quadric:
    """Return ``z = x^2 / (4 fx) + y^2 / (4 fy)`` (astigmatic) [m]."""
    a = 0.25 / _nonzero("focal_length_x_m", focal_length_x_m)
    b = 0.25 / _nonzero("focal_length_y_m", focal_length_y_m)
    words = f"astigmatic paraboloid of focal lengths {focal_length_x_m:.6g} m in x and {focal_length_y_m:.6g} m in y"
    return quadric([a, b, 0, 0, 0, 0], words)


def trough(focal_length_m: float) -> Quadric:
    """Return the parabolic trough ``z = x^2 / (4 f)``, straight along y, focal line at z = f [m]."""
    a = 0.25 / _nonzero("focal_length_m", focal_length_m)
    return quadric([a, 0, 0, 0, 0, 0], f"parabolic trough of focal length {focal_length_m:.6g} m")


def sphere(radius_m: float) -> Quadric:
    """Return the sphere through the origin with its centre at (0, 0, radius) [m]."""
    k = 0.5 / _nonzero("radius_m", radius_m)
    matrix = np.diag([-k, -k, -k, 0.0])
    matrix[2, 3] = matrix[3, 2] = 0.5
    return Quadric(matrix, f"sphere of radius {radius_m:.6g} m")


def cylinder(radius_m: float) -> Quadric:
    """Return the circular cylinder along y through the origin with its axis at z = radius [m]."""
    k = 0.5 / _nonzero("radius_m", radius_m)
    matrix = np.diag([-k, 0.0, -k, 0.0])
    matrix[2, 3] = matrix[3, 2] = 0.5
    return Quadric(matrix, f"circular cylinder of radius {radius_m:.6g} m")


def _nonzero(name: str, length_m: float) -> float:
    if np.isnan(length_m) or length_m == 0:
        raise InputError(f"{name}: a length other than zero is needed (infinite for flat), not {length_m} m")
    return float(length_m)


@dataclass(frozen=True, slots=True, eq=False)
class Facet:
    """One mirror: its outline and design in its own frame, and where it sits in an ensemble.

    name: Name in files and messages.
    outline_m (n, 2): Corners in facet x and y, counter-clockwise seen from the front [m].
    design: Design surface in the facet's frame.
    ensemble_from_facet: Place of the facet; the identity for a single mirror.
    reference_point_m (2,): Point whose normal stands for the facet (canting) [m]; the outline's centroid when left
        out.
    InputError: Fewer than three corners, a corner twice, sides that cross, no area, or clockwise corners.
    """

    name: str
    outline_m: FloatArray
    design: Quadric
    ensemble_from_facet: RigidTransform = field(default_factory=RigidTransform.identity)
    reference_point_m: FloatArray = field(default_factory=lambda: np.full(2, np.nan))

    def __post_init__(self) -> None:
        outline = float_array("outline_m", self.outline_m, (None, 2))
        if outline.shape[0] < 3:
            raise InputError(f"outline_m: facet {self.name} needs at least 3 corners, not {outline.shape[0]}")
        _refuse_crossing(self.name, outline)
        area, centroid = _polygon_area_and_centroid(outline)
        if area <= 0:
            raise InputError(
                f"outline_m: the corners of facet {self.name} enclose {area:.6g} m^2; order them counter-clockwise "
                "seen from the front"
            )
        object.__setattr__(self, "outline_m", outline)
        reference = float_array("reference_point_m", self.reference_point_m, (2,), finite=False)
        object.__setattr__(self, "reference_point_m", freeze(centroid) if np.isnan(reference).any() else reference)

    @property
    def area_m2(self) -> float:
        """Area of the outline projected along z [m^2]."""
        return _polygon_area_and_centroid(self.outline_m)[0]

    @property
    def corners_m(self) -> FloatArray:
        """The outline's corners on the design surface, facet frame, shape (n, 3) [m]."""
        return np.column_stack([self.outline_m, self.design.height(self.outline_m[:, 0], self.outline_m[:, 1])])

    def contains(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> BoolArray:
        """Tell which points lie inside the outline (even-odd rule).

        x_m, y_m (...): Positions in the facet frame [m], broadcast against each other.
        Returns (...): True inside. Of a point on the edge, left and lower edges count as inside: facets that share
            an edge share no point.
        """
        grid_x, grid_y = np.broadcast_arrays(np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64))
        flat_x, flat_y = grid_x.reshape(-1), grid_y.reshape(-1)
        inside = np.zeros(flat_x.size, dtype=np.bool_)
        starts, ends = self.outline_m, np.roll(self.outline_m, -1, axis=0)
        for rows in _blocks(flat_x.size):
            x, y = flat_x[rows], flat_y[rows]
            for (x0, y0), (x1, y1) in zip(starts.tolist(), ends.tolist(), strict=True):
                if y0 != y1:
                    crosses = (y0 <= y) != (y1 <= y)
                    inside[rows] ^= crosses & (x < x0 + (y - y0) * ((x1 - x0) / (y1 - y0)))
        return inside.reshape(grid_x.shape)


def _refuse_crossing(name: str, outline_m: FloatArray) -> None:
    """Refuse an outline with a corner given twice, or with sides that cross."""
    start, side = outline_m, np.roll(outline_m, -1, axis=0) - outline_m
    n, size = len(outline_m), float(np.ptp(outline_m, axis=0).max())
    short = np.flatnonzero(np.hypot(side[:, 0], side[:, 1]) <= 1e-9 * size)
    if short.size:
        first = int(short[0])
        raise InputError(
            f"outline_m: corners {first + 1} and {(first + 1) % n + 1} of facet {name} are one point; leave one out"
        )
    # Side i from a to b meets side j from c to d where a + s (b - a) = c + t (d - c), with s and t between 0 and 1.
    offset = start[None, :] - start[:, None]
    along, other = side[:, None], side[None, :]
    determinant = along[..., 0] * other[..., 1] - along[..., 1] * other[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (offset[..., 0] * other[..., 1] - offset[..., 1] * other[..., 0]) / determinant
        t = (offset[..., 0] * along[..., 1] - offset[..., 1] * along[..., 0]) / determinant
    for first, second in np.argwhere((s > 0) & (s < 1) & (t > 0) & (t < 1)):
        if (second - first) % n not in (0, 1, n - 1):
            raise InputError(
                f"outline_m: sides {first + 1} and {second + 1} of facet {name} cross each other; give the corners in "
                "order, counter-clockwise seen from the front"
            )


def _polygon_area_and_centroid(outline_m: FloatArray) -> tuple[float, FloatArray]:
    # Shoelace about the mean corner, so that a facet far from its origin loses no digits.
    middle = outline_m.mean(axis=0)
    start = outline_m - middle
    end = np.roll(start, -1, axis=0)
    cross = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    area = 0.5 * float(cross.sum())
    if area == 0:
        return 0.0, middle
    return area, middle + ((start + end) * cross[:, None]).sum(axis=0) / (6 * area)


def facet_on_optic(
    design_in_optic: Quadric,
    center_xy_m: npt.ArrayLike,
    orientation: Literal["normal", "axis"] = "normal",
) -> RigidTransform:
    """Place a facet's frame on the surface of a larger optic.

    center_xy_m (2,): Where the facet's origin sits, x and y in the optic's frame [m].
    orientation: Facet z along the surface normal there (the smallest turn from the optic's axes), or along the
        optic's z.
    Returns: ``optic_from_facet``; the facet's own design is
        ``design_in_optic.transformed(optic_from_facet.inverse())``.
    InputError: The surface does not reach that point, or the orientation is unknown.
    """
    x, y = float_array("center_xy_m", center_xy_m, (2,)).tolist()
    height = float(design_in_optic.height(x, y))
    if np.isnan(height):
        raise InputError(f"center_xy_m: {design_in_optic.name} has no point at x = {x} m, y = {y} m")
    if orientation == "axis":
        return RigidTransform(np.eye(3), np.array([x, y, height]))
    if orientation == "normal":
        turn = rotation_between([0.0, 0.0, 1.0], design_in_optic.normal(x, y))
        return RigidTransform(turn, np.array([x, y, height]))
    raise InputError(f"orientation: 'normal' or 'axis' is needed, not {orientation!r}")
