"""Flat targets of beams: where they are in the field, and coordinates on them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array, freeze, positive

__all__ = ["PlaneTarget", "unit_vector"]


@dataclass(frozen=True, slots=True, eq=False)
class PlaneTarget(ShortRepr):
    """A flat target with its own coordinates: x to the right and y up, as seen from the field, from the centre [m].

    center_m (3,): Its centre in the field's frame [m].
    right, up (3,): Directions to the right and up for one who looks at it from the field; perpendicular, of any
        length.
    width_m, height_m: Its size [m].
    flatness_m: Largest distance of a measured corner from the plane [m].
    InputError: Directions that are not perpendicular, or a size that is not positive.

    >>> target = PlaneTarget.facing("lower", [0.0, 0.0, 36.0], np.pi, 5.4, 7.0)
    >>> target.normal.round(12) + 0.0
    array([ 0., -1.,  0.])
    >>> target.coordinates([[1.0, 0.0, 38.0]]).round(12)
    array([[1., 2.]])
    """

    name: str
    center_m: FloatArray
    right: FloatArray
    up: FloatArray
    width_m: float
    height_m: float
    flatness_m: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "center_m", float_array(f"center of target {self.name}", self.center_m, (3,)))
        right, up = (
            unit_vector(f"right of target {self.name}", self.right),
            unit_vector(f"up of target {self.name}", self.up),
        )
        if abs(right @ up) > 1e-9:
            raise InputError(
                f"target {self.name}: right and up must be perpendicular; their cosine is {right @ up:.2g}"
            )
        object.__setattr__(self, "right", right)
        object.__setattr__(self, "up", up)
        positive(f"width_m of target {self.name}", self.width_m, "metres")
        positive(f"height_m of target {self.name}", self.height_m, "metres")

    @classmethod
    def facing(
        cls, name: str, center_m: npt.ArrayLike, azimuth_rad: float, width_m: float, height_m: float
    ) -> "PlaneTarget":
        """Return an upright target whose normal has this azimuth (0 = north, clockwise; pi faces south) [rad]."""
        right = [-np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0]
        return cls(name, np.asarray(center_m), np.array(right), np.array([0.0, 0.0, 1.0]), width_m, height_m)

    @classmethod
    def from_corners(cls, name: str, corners_m: npt.ArrayLike) -> "PlaneTarget":
        """Return the target through four measured corners.

        corners_m (4, 3): Upper left, upper right, lower right, lower left, as seen from the field [m].
        Returns: The best-fitting plane; up is along the mean of the two sides, size and centre are means.
        InputError: The corners are not a quadrilateral in that order.
        """
        corners = float_array(f"corners of target {name}", corners_m, (4, 3))
        upper_left, upper_right, lower_right, lower_left = corners
        across = (upper_right - upper_left + lower_right - lower_left) / 2
        along = (upper_left - lower_left + upper_right - lower_right) / 2
        # For four points the best plane through the mean is spanned by the two means of opposite sides: the one
        # remaining freedom, the twist, is the same at all corners but for its sign.
        normal = np.cross(across, along)
        area = float(np.linalg.norm(normal))
        if area < 0.1 * float(np.linalg.norm(across) * np.linalg.norm(along)) or area == 0:
            raise InputError(f"target {name}: corners must go upper left, upper right, lower right, lower left")
        normal /= area
        up = along / np.linalg.norm(along)
        center = corners.mean(axis=0)
        width, height = area / float(np.linalg.norm(along)), float(np.linalg.norm(along))
        flatness = float(np.abs((corners - center) @ normal).max())
        return cls(name, center, np.cross(up, normal), up, width, height, flatness)

    @property
    def normal(self) -> FloatArray:
        """Unit normal to the side of the field, shape (3,)."""
        return np.asarray(np.cross(self.right, self.up))

    @property
    def axes(self) -> FloatArray:
        """Right and up as rows, shape (2, 3)."""
        return np.asarray(freeze(np.stack([self.right, self.up])))

    def coordinates(self, points_m: npt.ArrayLike) -> FloatArray:
        """Return x, y on the target, shape (n, 2) [m], of points (n, 3) [m]; what lies off the plane is dropped."""
        return np.asarray((np.asarray(points_m, dtype=np.float64) - self.center_m) @ self.axes.T)

    def points(self, coordinates_m: npt.ArrayLike) -> FloatArray:
        """Return the points of the field's frame, shape (n, 3) [m], at x, y on the target (n, 2) [m]."""
        return np.asarray(np.asarray(coordinates_m, dtype=np.float64) @ self.axes + self.center_m)

    def contains(self, coordinates_m: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return whether x, y on the target (n, 2) [m] lie within its edges, shape (n,)."""
        half = np.array([self.width_m, self.height_m]) / 2
        return np.asarray((np.abs(np.asarray(coordinates_m, dtype=np.float64)) <= half).all(axis=-1))


def unit_vector(name: str, vector: npt.ArrayLike) -> FloatArray:
    """Return a vector at length one, shape (3,).

    name: What it is, for messages.
    InputError: Its length is zero.
    """
    array = float_array(name, vector, (3,))
    length = float(np.linalg.norm(array))
    if length == 0:
        raise InputError(f"{name}: a vector of length zero has no direction")
    # A direction that is a unit vector already keeps its bits: (0, 0, 1) stays exact.
    return array if length == 1.0 else np.asarray(freeze(array / length))
