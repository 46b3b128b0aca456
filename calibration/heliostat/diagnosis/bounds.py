"""How large each finding can physically be."""

from collections.abc import Mapping, Sequence

import numpy as np

from heliogauge.validate import BoolArray, FloatArray

#: Largest coefficients that can be meant, by kind, in the unit of the coefficient.
BOUNDS: Mapping[str, tuple[float, str]] = {
    "drift": (0.02, "angles that creep by 20 mrad in a year would have sunk a post's foot of a metre by 2 cm"),
    "change_point": (0.5, "a larger jump is another zero, not a slip"),
    "episode": (0.5, "a larger jump is another zero, not a slip"),
    "backlash": (0.05, "drives with 3 degrees of play do not hold in wind"),
    "worm_gear": (0.02, "ten times what data sheets of slew drives state"),
    "sag": (0.04, "an edge at 1.5 m would hang by 6 cm"),
    "scale": (0.1, "gear ratios are counted teeth"),
    "refraction": (3.0, "refracted twice or not at all is 1"),
    "time_offset": (3600.0, "beyond an hour the sky does not turn by a small angle: hours are tried out"),
    "target_place": (10.0, "beyond the size of a target it is another one"),
    "target_scale": (0.25, "tapes and corners in photos err by percents; a quarter is another target"),
}
_WAVES = ("sag", "worm_gear")
# A term is linear about a fit that lacks it and is bent by it: bends of 36 to 40 mrad, drawn into the records of real
# heliostats, come out up to a tenth larger. As one sigma of the size.
_SECOND_ORDER = 0.05


def is_physical(kind: str, coefficients: FloatArray, sigmas: FloatArray) -> bool:
    """Return whether a term is not two of its own sigmas larger than it can be, what it lacks as a linear one added.

    Shapes: coefficients (q,), sigmas (q,).
    kind: A key of `BOUNDS`; other kinds have no bound.
    """
    return kind not in BOUNDS or bool(_within(kind, coefficients, sigmas).all())


def prior_of(kind: str, count: int) -> FloatArray | None:
    """Return what keeps coefficients that trade with each other from running away: the bounds as sigmas, shape (q,).

    Returns: None for kinds that have no bound.
    """
    return np.full(count, BOUNDS[kind][0]) if kind in BOUNDS and kind != "target_scale" else None


def beyond_text(kind: str, names: Sequence[str], coefficients: FloatArray, sigmas: FloatArray) -> str:
    """Say which coefficient is larger than can be; empty where none is."""
    if kind not in BOUNDS or _within(kind, coefficients, sigmas).all():
        return ""
    limit, why = BOUNDS[kind]
    worst = int(np.argmax(np.abs(coefficients)))
    return f"{names[worst]} = {coefficients[worst]:.3g} is beyond {limit:g}: {why}"


def _within(kind: str, coefficients: FloatArray, sigmas: FloatArray) -> BoolArray:
    if kind in _WAVES:
        # Sine and cosine of one amplitude.
        sizes, errors = np.array([np.linalg.norm(coefficients)]), np.array([sigmas.max()])
    else:
        sizes, errors = np.abs(coefficients), sigmas
    return np.asarray(sizes - 2 * np.hypot(errors, _SECOND_ORDER * sizes) <= BOUNDS[kind][0])
