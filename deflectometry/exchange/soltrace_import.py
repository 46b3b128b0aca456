"""Which slope file of a system of SolTrace becomes a measurement."""

from collections import Counter
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.results.soltrace_files import read_system
from heliogauge.sunlight.soltrace_system import SystemElement


def slope_file_of_system(path: Path, element: int | None = None) -> Path:
    """Return the slope file (.sht) of an element of a system.

    path: The system (.stinput); its slope files stand beside it, or where it says.
    element: Number of the element among those with a slope file, from 1; needed where there are several.
    InputError: No system, no element with measured slopes, none of this number, or its file is not there.
    """
    elements = [one for stage in read_system(path).stages for one in stage.elements]
    measured = [one for one in elements if one.surface == "v" and one.surface_file]
    if not measured:
        raise InputError(
            f"{path}: no element has measured slopes (.sht). Its {len(elements)} elements are {_listed(elements)}; "
            "give such a design to a measurement with [mirror] design"
        )
    if element is None and len(measured) > 1:
        names = ", ".join(f"{k} ({one.comment or one.surface_file})" for k, one in enumerate(measured[:12], start=1))
        raise InputError(
            f"{path}: {len(measured)} elements have measured slopes; give element=1 to {len(measured)}: {names}"
        )
    number = 1 if element is None else element
    if not 1 <= number <= len(measured):
        raise InputError(f"element={number}: {path} has {len(measured)} elements with measured slopes, counted from 1")
    # Paths of other machines have either slash.
    name = measured[number - 1].surface_file.replace("\\", "/")
    places = [path.parent / name, path.parent / name.rsplit("/", 1)[-1]]
    for place in places:
        if place.is_file():
            return place
    raise InputError(f"{path}: its slope file {name} is not there; put it beside the system")


def _listed(elements: list[SystemElement]) -> str:
    counts = Counter(_shape(one) for one in elements)
    return ", ".join(f"{count} x {shape}" for shape, count in counts.most_common(6))


def _shape(one: SystemElement) -> str:
    curvatures = one.surface_numbers[:2]
    if one.surface == "p":
        focal = [f"{0.5 / value:.5g} m" if value else "infinite" for value in curvatures]
        return f"paraboloid of focal lengths {focal[0]} in x and {focal[1]} in y"
    if one.surface in "st" and curvatures[0]:
        return f"{'sphere' if one.surface == 's' else 'cylinder'} of radius {1 / curvatures[0]:.5g} m"
    return {"f": "plane"}.get(one.surface, f"surface {one.surface}")
