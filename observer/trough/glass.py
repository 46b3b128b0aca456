"""What the glass around the absorber does to lines of sight that pass close to the metal."""

import numpy as np

from observer.trough.collector import Collector


def turned_rad(collector: Collector, radii: float) -> float:
    """Return by what angle the glass turns a line of sight on its way in, before it passes the middle.

    radii: Distance at which the line passes the middle of the glass, in radii of the tube.
    Returns: Angle towards the side on which the line passes, in the plane across the tube; on the way out it is
        turned by as much once more; 0 without glass [rad].

    By the plane law of refraction: towards the middle at the outer face, away from it at the inner one. Beyond the
    inner face it stays what it is there.
    """
    glass = collector.glass
    if glass is None:
        return 0.0
    inner = min(radii * collector.absorber_diameter_m / glass.inner_diameter_m, 1.0)
    outer = inner * glass.inner_diameter_m / glass.outer_diameter_m
    at_inner = np.arcsin(inner) - np.arcsin(inner / glass.index)
    return float(at_inner - np.arcsin(outer) + np.arcsin(outer / glass.index))
