"""What the walls of the glass around the absorber throw back to the camera, by where the light comes from."""

import numpy as np

from heliogauge.validate import BoolArray, FloatArray
from observer.trough.collector import Collector, GlassTube


def face_reflectances(sine: FloatArray, index: float) -> FloatArray:
    """Return what share of unpolarized light a face of glass reflects, by Fresnel's formulas.

    sine: Sine of the angle outside the glass, of any shape.
    """
    before, behind = np.sqrt(1 - sine**2), np.sqrt(index**2 - sine**2)
    across = (before - behind) / (before + behind)
    along = (index**2 * before - behind) / (index**2 * before + behind)
    return np.asarray(0.5 * (across**2 + along**2))


def thrown_light(
    collector: Collector, glass: GlassTube, down: tuple[float, float], axis_z_m: float, beside_m: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Return what share of light the walls throw back across the tube.

    down: Direction of the line of sight through the axis, x and z.
    axis_z_m: Height of the axis over the vertex [m].
    beside_m (n,): Distances at which lines of sight pass the axis, positive towards larger x [m].
    Returns: From the sky, from the ground and from the mirror below its rims, of each what comes from smaller and from
        larger x, each (n,).

    Across a tube lines keep their distance b from the axis. Reflected at a face of radius r a line turns by ``pi - 2
    asin(b / r)``, and at a face inside glass or behind a wall by what refraction adds; between the faces of one wall
    reflections go on (Stokes's pile of plates). The wall in front throws back before the metal and beside it, the one
    behind beside it only, once, or twice on the inside. Of a tube off the middle of its glass nothing is known here.
    """
    radius = collector.absorber_diameter_m / 2
    outer, inner, index = glass.outer_diameter_m / 2, glass.inner_diameter_m / 2, glass.index
    far, side = np.abs(beside_m), np.sign(beside_m)
    within, beyond = far < inner, (far < inner) & (far > radius)
    b = np.minimum(far, inner)
    at_outer, at_inner = np.arcsin(b / outer), np.arcsin(b / inner)
    in_outer, in_inner = np.arcsin(b / outer / index), np.arcsin(b / inner / index)
    entered, left = at_outer - in_outer, at_inner - in_inner
    # At the inner face's rim the line grazes it.
    by_outer = face_reflectances(b / outer, index)
    by_inner = face_reflectances(np.minimum(b / inner, 1 - 1e-9), index)
    again = 1 / (1 - by_outer * by_inner)
    wall = (1 - by_outer) * (1 - by_inner) * again
    turned = 2 * (left - entered)
    ways: list[tuple[FloatArray, FloatArray, BoolArray]] = [
        (by_outer, np.pi - 2 * at_outer, within),
        ((1 - by_outer) ** 2 * by_inner * again, np.pi - 2 * entered - 2 * in_inner, within),
        (wall**2 * by_inner, turned - np.pi + 2 * at_inner, beyond),
        (wall**2 * (1 - by_inner) ** 2 * by_outer * again, turned - np.pi + 2 * left + 2 * in_outer, beyond),
        (wall * (1 - wall) ** 2, turned - 2 * np.pi + 4 * at_inner, beyond),
    ]
    half = collector.aperture_width_m / 2
    rim = float(np.arctan2(half**2 / (4 * collector.focal_length_m) - axis_z_m, half))
    found = [(np.zeros(b.size), np.zeros(b.size)) for _ in range(3)]
    for share, angle, where in ways:
        sine, cosine = np.sin(side * angle), np.cos(side * angle)
        x, z = down[0] * cosine - down[1] * sine, down[1] * cosine + down[0] * sine
        up = np.arcsin(np.clip(z, -1, 1))
        # From a tube below the rims of a deep trough no ground is seen.
        zone = np.where(up > max(rim, 0.0), 0, np.where(up > rim, 1, 2))
        for k, two in enumerate(found):
            for one, here in zip(two, (x <= 0, x > 0), strict=True):
                one += share * where * (zone == k) * here
    return found
