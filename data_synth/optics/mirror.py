"""The synthetic mirror: design surface, facets, exact height and slope, and where rays meet it and leave it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from data_synth.optics.surface_errors import SurfaceErrors
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_between
from heliogauge.geometry.surfaces import HeightAndSlopes
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, float_array

#: Parameters each design needs.
_PARAMETERS: dict[str, tuple[str, ...]] = {
    "plane": (),
    "sphere": ("radius_m",),
    "paraboloid": ("focal_length_m",),
    "paraboloid_xy": ("focal_length_x_m", "focal_length_y_m"),
    "trough": ("focal_length_m",),
}


@dataclass(frozen=True, slots=True, eq=False)
class Design(ShortRepr):
    """A design surface ``p S p + l p + c = 0``, seen from a facet's frame; z > 0 is the reflecting side.

    shape: One of plane, sphere, paraboloid, paraboloid_xy or trough (curved along x); its vertex is the optic's
        origin.
    parameters: The lengths the shape needs [m].
    optic_from_facet: Where on the optic the facet sits; its origin must lie on the surface. `on_optic` makes one.
    InputError: Unknown shape, missing or extra parameter, or an origin that is not on the surface.
    """

    shape: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    optic_from_facet: RigidTransform = field(default_factory=RigidTransform.identity)
    _quadratic: FloatArray = field(init=False, repr=False)
    _linear: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        needed = _PARAMETERS.get(self.shape)
        if needed is None:
            raise InputError(f"design {self.shape!r}: one of {', '.join(_PARAMETERS)} is needed")
        if set(self.parameters) != set(needed) or any(value == 0 for value in self.parameters.values()):
            raise InputError(f"design {self.shape}: {', '.join(needed) or 'nothing'} needed, not {self.parameters}")
        quadratic, linear = _coefficients(self.shape, self.parameters)
        turn, shift = self.optic_from_facet.rotation, self.optic_from_facet.translation_m
        constant = shift @ quadratic @ shift + linear @ shift
        if abs(constant) > 1e-9 * max(1.0, float(np.abs(linear).max())):
            raise InputError(f"design {self.shape}: the facet's origin {shift.tolist()} m is not on the surface")
        object.__setattr__(self, "_quadratic", turn.T @ quadratic @ turn)
        object.__setattr__(self, "_linear", turn.T @ (2 * quadratic @ shift + linear))

    @classmethod
    def on_optic(
        cls, shape: str, parameters: Mapping[str, float], center_m: tuple[float, float], *, orientation: str = "normal"
    ) -> "Design":
        """Put a facet somewhere on the optic.

        shape: The design surface.
        center_m: Where on the optic (x, y) the facet's origin is [m].
        orientation: "normal": the facet's z is the surface normal there, by the smallest turn from the optic's
            axes; "axis": the facet's axes are parallel to the optic's.
        InputError: Another orientation, or no surface over that place.
        """
        vertex = cls(shape, parameters)
        height, slope_x, slope_y = vertex.evaluate(np.array(center_m[0]), np.array(center_m[1]))
        if not np.isfinite(height):
            raise InputError(f"design {shape}: no surface over {center_m} m")
        rotation = np.eye(3)
        if orientation == "normal":
            rotation = rotation_between([0.0, 0.0, 1.0], [-float(slope_x), -float(slope_y), 1.0])
        elif orientation != "axis":
            raise InputError(f'design orientation {orientation!r}: "normal" or "axis" is needed')
        return cls(shape, parameters, RigidTransform(rotation, np.array([*center_m, float(height)])))

    def evaluate(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return height [m], slope_x and slope_y [rad] of the design over points (x, y) of the facet [m]."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self._quadratic
        in_x, in_y, in_z = self._linear
        b = in_z + 2 * (xz * x_m + yz * y_m)
        c = xx * x_m * x_m + yy * y_m * y_m + 2 * xy * x_m * y_m + in_x * x_m + in_y * y_m
        with np.errstate(invalid="ignore"):
            root = np.sqrt(b * b - 4 * zz * c)
        # The root next to the facet plane, in the form that also holds for zz = 0 and loses no digits.
        z = -2 * c / (b + np.sign(in_z) * root)
        in_height = b + 2 * zz * z
        slope_x = -(in_x + 2 * (xx * x_m + xy * y_m + xz * z)) / in_height
        slope_y = -(in_y + 2 * (xy * x_m + yy * y_m + yz * z)) / in_height
        return HeightAndSlopes(z, slope_x, slope_y)

    def to_json(self) -> dict[str, Any]:
        """Return the design as plain values for truth.json."""
        return {
            "shape": self.shape,
            "parameters": dict(self.parameters),
            "optic_from_facet": transform_to_json(self.optic_from_facet),
        }


def _coefficients(shape: str, lengths: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
    quadratic, linear = np.zeros((3, 3)), np.array([0.0, 0.0, -1.0])
    if shape == "sphere":
        quadratic = np.eye(3) / (2 * lengths["radius_m"])
    elif shape == "paraboloid":
        quadratic = np.diag([1.0, 1.0, 0.0]) / (4 * lengths["focal_length_m"])
    elif shape == "paraboloid_xy":
        quadratic = np.diag([0.25 / lengths["focal_length_x_m"], 0.25 / lengths["focal_length_y_m"], 0.0])
    elif shape == "trough":
        quadratic = np.diag([1.0, 0.0, 0.0]) / (4 * lengths["focal_length_m"])
    return quadratic, linear


def transform_to_json(transform: RigidTransform) -> dict[str, Any]:
    """Return a transform as plain values.

    Returns: ``rotation_vector_rad`` and ``translation_m``.
    """
    return {
        "rotation_vector_rad": transform.rotation_vector_rad.tolist(),
        "translation_m": transform.translation_m.tolist(),
    }


class MetPoints(NamedTuple):
    """Where rays meet a surface: points (..., 3) [m], and slopes there (...) [rad]."""

    points_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticFacet(ShortRepr):
    """One facet of the synthetic mirror: design plus analytic errors, cut out by its outline.

    outline_m (n, 2): Corners in the facet's x, y, counter-clockwise from the front [m].
    design: The design surface in the facet's frame.
    errors: What is added to the height of the design.
    mirror_from_facet: Where the facet should sit in the mirror (nominal; canting errors are tilts among `errors`).
    """

    name: str
    outline_m: FloatArray
    design: Design
    errors: SurfaceErrors = field(default_factory=SurfaceErrors)
    mirror_from_facet: RigidTransform = field(default_factory=RigidTransform.identity)

    def __post_init__(self) -> None:
        object.__setattr__(self, "outline_m", float_array(f"facet {self.name} outline_m", self.outline_m, (None, 2)))
        if len(self.outline_m) < 3:
            raise InputError(f"facet {self.name} outline_m: at least 3 corners are needed")

    def surface(self, x_m: FloatArray, y_m: FloatArray) -> HeightAndSlopes:
        """Return true height [m], slope_x and slope_y [rad] at points (x, y) of the facet [m]."""
        height, slope_x, slope_y = self.design.evaluate(x_m, y_m)
        error, error_x, error_y = self.errors.evaluate(x_m, y_m)
        return HeightAndSlopes(height + error, slope_x + error_x, slope_y + error_y)

    def distance_inside(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return the distance of points from the outline, positive inside, shape as x_m [m]."""
        inside = np.zeros(np.shape(x_m), dtype=bool)
        nearest = np.full(np.shape(x_m), np.inf)
        for start, end in zip(self.outline_m, np.roll(self.outline_m, -1, axis=0), strict=True):
            edge = end - start
            along = ((x_m - start[0]) * edge[0] + (y_m - start[1]) * edge[1]) / (edge @ edge)
            along = np.clip(along, 0.0, 1.0)
            gap_x, gap_y = x_m - start[0] - along * edge[0], y_m - start[1] - along * edge[1]
            np.minimum(nearest, gap_x * gap_x + gap_y * gap_y, out=nearest)
            inside ^= self._crosses(x_m, y_m, start, end)
        return np.asarray(np.where(inside, 1.0, -1.0) * np.sqrt(nearest))

    def contains(self, x_m: FloatArray, y_m: FloatArray) -> BoolArray:
        """Tell whether points lie inside the outline, shape as x_m."""
        inside = np.zeros(np.shape(x_m), dtype=bool)
        for start, end in zip(self.outline_m, np.roll(self.outline_m, -1, axis=0), strict=True):
            inside ^= self._crosses(x_m, y_m, start, end)
        return inside

    @staticmethod
    def _crosses(x_m: FloatArray, y_m: FloatArray, start: FloatArray, end: FloatArray) -> BoolArray:
        """Tell whether the line from a point to the right crosses an edge (even-odd rule)."""
        if start[1] == end[1]:
            return np.zeros(np.shape(x_m), dtype=bool)
        between = (start[1] > y_m) != (end[1] > y_m)
        return np.asarray(between & (x_m < start[0] + (y_m - start[1]) * ((end[0] - start[0]) / (end[1] - start[1]))))

    def intersect(self, origin_m: FloatArray, directions: FloatArray) -> MetPoints:
        """Find where rays meet the true surface, continued beyond the outline.

        origin_m (3,): Common origin of the rays in the facet's frame [m].
        directions (..., 3): Unit directions in the facet's frame.
        Returns: Points, shape (..., 3) [m]; slope_x and slope_y there, shape (...) [rad].
        InputError: Newton's method does not settle: the surface errors are steeper than the rays.
        """
        dx, dy, dz = directions[..., 0], directions[..., 1], directions[..., 2]
        path = -origin_m[2] / dz
        for _ in range(20):
            x, y = origin_m[0] + path * dx, origin_m[1] + path * dy
            height, slope_x, slope_y = self.surface(x, y)
            step = (height - origin_m[2] - path * dz) / (dz - slope_x * dx - slope_y * dy)
            path = path + step
            # Quadratic convergence: after a step of 1e-7 m the next would be below round-off.
            if not np.nanmax(np.abs(step), initial=0.0) > 1e-7:
                x, y = origin_m[0] + path * dx, origin_m[1] + path * dy
                height, slope_x, slope_y = self.surface(x, y)
                return MetPoints(np.stack([x, y, height], axis=-1), slope_x, slope_y)
        raise InputError(f"facet {self.name}: rays do not meet the surface; make the surface errors less steep")


def reflect(directions: FloatArray, slope_x: FloatArray, slope_y: FloatArray) -> FloatArray:
    """Reflect directions on a surface of known slope.

    Shapes: directions (..., 3), slope_x, slope_y (...).
    Returns (..., 3): Directions after the reflection.

    >>> reflect(np.array([0.0, 0.0, -1.0]), np.array(1.0), np.array(0.0))
    array([-1., 0., 0.])
    """
    # The normal (-slope_x, -slope_y, 1) is left at its length: r = d - 2 (d n) n / (n n).
    twice = 2 * (directions[..., 2] - slope_x * directions[..., 0] - slope_y * directions[..., 1])
    twice = twice / (1 + slope_x * slope_x + slope_y * slope_y)
    return np.stack(
        [directions[..., 0] + twice * slope_x, directions[..., 1] + twice * slope_y, directions[..., 2] - twice],
        axis=-1,
    )
