"""From what measurement.toml says of a design to the surface."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import (
    Quadric,
    facet_on_optic,
    paraboloid,
    paraboloid_xy,
    plane,
    quadric,
    sphere,
    trough,
)
from heliogauge.measurement.models import DESIGN_KEYS, DesignKeys
from heliogauge.validate import FloatArray


def build_design(section: DesignKeys) -> Quadric:
    """Build the design surface of a facet in the facet's own frame.

    section: Shape, numbers, and where on its optic the facet sits.
    """
    optic = _optic(section)
    if section.design_center_m == (0.0, 0.0):
        return optic
    place = facet_on_optic(optic, section.design_center_m, section.design_orientation)
    return optic.transformed(place.inverse())


_CONSTRUCTORS: dict[str, Callable[..., Quadric]] = {
    "plane": plane,
    "paraboloid": paraboloid,
    "paraboloid_xy": paraboloid_xy,
    "trough": trough,
    "sphere": sphere,
}


def _optic(section: DesignKeys) -> Quadric:
    if section.design == "quadric" and section.coefficients is not None:
        return quadric(section.coefficients)
    shape = section.design or "plane"
    return _CONSTRUCTORS[shape](*(getattr(section, name) for name in DESIGN_KEYS[shape]))


@dataclass(frozen=True, slots=True, eq=False)
class DesignFamily:
    """A design with its lengths still free, where on its optic it sits as stated.

    make: Lengths [m] to the optic's surface.
    lengths_m (k,): The stated lengths [m].
    names length k: Their keys.
    facet_from_optic: From the optic's frame to that of the facet, with the stated lengths.
    """

    make: Callable[..., Quadric]
    lengths_m: FloatArray
    names: tuple[str, ...]
    facet_from_optic: RigidTransform


def build_design_family(section: DesignKeys) -> DesignFamily:
    """Build the design of a facet with its lengths free.

    section: Shape, numbers, and where on its optic the facet sits.
    Returns: Constructor, lengths and place; a general quadric has no lengths.
    """
    optic = _optic(section)
    place = RigidTransform.identity()
    if section.design_center_m != (0.0, 0.0):
        place = facet_on_optic(optic, section.design_center_m, section.design_orientation).inverse()
    constructor = _CONSTRUCTORS.get(section.design or "plane")
    if constructor is None:
        return DesignFamily(lambda: optic, np.zeros(0), (), place)
    names = DESIGN_KEYS[section.design or "plane"]
    return DesignFamily(constructor, np.array([getattr(section, name) for name in names], dtype=float), names, place)
