"""The reflecting surface of a mirror as patches, facet by facet, and how it stands when it sends the sun to a target.

Frame of the mirror: x along the width and y along the height as seen from the front, z out of the mirror [m].
"""

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.geometry.target_planes import unit_vector
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array, freeze

__all__ = ["Facet", "Mirror", "Mount", "canted", "curved", "mirror_rotation"]

#: How a mirror turns about its normal: axes azimuth and elevation, or an axis to the east that carries a second one
#: along the mirror's height (two linear actuators, as in Juelich).
Mount: TypeAlias = Literal["azimuth-elevation", "east-axis"]


@dataclass(frozen=True, slots=True, eq=False)
class Facet(ShortRepr):
    """One facet as patches.

    center_m (3,): Middle of the facet: it is canted about this point [m].
    points_m (n, 3): Middles of its patches [m].
    normals (n, 3): Their unit normals.
    area_m2 (n,): Their areas [m^2].
    """

    center_m: FloatArray
    points_m: FloatArray
    normals: FloatArray
    area_m2: FloatArray

    def __post_init__(self) -> None:
        points = float_array("facet points_m", self.points_m, (None, 3))
        normals = float_array("facet normals", self.normals, points.shape)
        lengths = np.linalg.norm(normals, axis=1)
        if not (lengths > 0).all() or not (normals[:, 2] > 0).all():
            raise InputError("facet normals: they must point out of the mirror (z > 0)")
        object.__setattr__(self, "center_m", float_array("facet center_m", self.center_m, (3,)))
        object.__setattr__(self, "points_m", points)
        object.__setattr__(self, "normals", freeze(normals / lengths[:, None]))
        object.__setattr__(self, "area_m2", float_array("facet area_m2", self.area_m2, (len(points),)))


@dataclass(frozen=True, slots=True, eq=False)
class Mirror(ShortRepr):
    """A mirror of one or more facets.

    names length k: Names of the facets.
    source: Where the surface comes from, in words.
    """

    facets: tuple[Facet, ...]
    names: tuple[str, ...]
    source: str = ""

    def __post_init__(self) -> None:
        if not self.facets or len(self.facets) != len(self.names):
            raise InputError(f"mirror: {len(self.facets)} facets and {len(self.names)} names; one name for each")

    @property
    def area_m2(self) -> float:
        """Area of all patches [m^2]."""
        return float(sum(one.area_m2.sum() for one in self.facets))

    @property
    def size_m(self) -> float:
        """Largest distance of a patch from the middle of the mirror [m]."""
        return float(max(np.linalg.norm(one.points_m[:, :2], axis=1).max() for one in self.facets))


def canted(mirror: Mirror, canting_rad: npt.ArrayLike) -> Mirror:
    """Turn each facet about its middle by small angles.

    canting_rad (k, 2): Turn of each facet's normal towards +x and +y [rad].
    """
    turns = float_array("canting_rad", canting_rad, (len(mirror.facets), 2))
    return replace(mirror, facets=tuple(_turned(one, turn) for one, turn in zip(mirror.facets, turns, strict=True)))


def _turned(facet: Facet, turn_rad: FloatArray) -> Facet:
    # A turn of the normal towards +x is one about +y, towards +y one about -x.
    rotation = rotation_from_vector(np.array([-turn_rad[1], turn_rad[0], 0.0]))
    points = facet.center_m + (facet.points_m - facet.center_m) @ rotation.T
    return replace(facet, points_m=points, normals=facet.normals @ rotation.T)


def curved(mirror: Mirror, curvature_1pm: float) -> Mirror:
    """Bend all facets about their middles: each normal leans back towards the facet's middle by more.

    curvature_1pm: Added second derivative of the height, 1 / (2 f) of a paraboloid of focal length f [1/m].
    """
    if curvature_1pm == 0:
        return mirror
    facets = []
    for one in mirror.facets:
        offset = one.points_m - one.center_m
        slopes = -one.normals[:, :2] / one.normals[:, 2:] + curvature_1pm * offset[:, :2]
        points = one.points_m.copy()
        points[:, 2] += 0.5 * curvature_1pm * np.sum(offset[:, :2] ** 2, axis=1)
        facets.append(replace(one, points_m=points, normals=np.column_stack([-slopes, np.ones(len(slopes))])))
    return replace(mirror, facets=tuple(facets))


def mirror_rotation(to_sun: npt.ArrayLike, to_target: npt.ArrayLike, mount: Mount) -> FloatArray:
    """Return how a mirror stands that sends the sun to a target, shape (3, 3): columns are its axes in the field.

    to_sun, to_target (3,): Directions from the mirror, in the field's frame.
    mount: How it turns about its normal.
    InputError: Sun and target in opposite directions.
    """
    normal = unit_vector("normal", unit_vector("to_sun", to_sun) + unit_vector("to_target", to_target))
    if mount == "azimuth-elevation":
        across = np.cross([0.0, 0.0, 1.0], normal)
        x = unit_vector("mirror x", across) if np.linalg.norm(across) > 1e-9 else np.array([1.0, 0.0, 0.0])
    else:
        # R_e(a) R_u(b) takes (0, -1, 0) to the normal (sin b, -cos b cos a, -cos b sin a).
        first, second = np.arctan2(-normal[2], -normal[1]), np.arcsin(np.clip(normal[0], -1.0, 1.0))
        x = np.array([np.cos(second), np.sin(second) * np.cos(first), np.sin(second) * np.sin(first)])
    return np.asarray(freeze(np.stack([x, np.cross(normal, x), normal], axis=1)))
