"""Which combinations of a heliostat's numbers the observations decide, and which only the priors hold."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray, freeze

#: What could be wrong of a number of which nothing is known: half a radian, a metre of a place, 3 % of anything else
#: (a metre if it is 0). Only the scale on which "not observed" is judged, and the prior that holds what nothing holds.
LARGEST_ANGLE_RAD, LARGEST_LENGTH_M, LARGEST_SHARE = 0.5, 1.0, 0.03
#: Places in the field; all other lengths are parts of a machine.
_PLACES = ("position_", "camera_", "target_")


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """A combination of parameters that the observations determine less well than was known before.

    names: Its parameters, the largest share first.
    coefficients (len(names),): How far each moves along it, in its own unit; the first is positive.
    information: Information of the observations over that of the priors, below 1.
    held_by_prior: Whether all its parameters had a prior sigma; otherwise it was held within what could be wrong at
        all.
    """

    names: tuple[str, ...]
    coefficients: FloatArray
    information: float
    held_by_prior: bool

    @property
    def text(self) -> str:
        """The combination in words."""
        parts = [f"{value:+.2g} {name}" for name, value in zip(self.names, self.coefficients, strict=True)]
        return " ".join(parts).lstrip("+")


def plausible_scales(values: FloatArray, names: Sequence[str], units: Sequence[str]) -> FloatArray:
    """Return how far numbers of which nothing is known could be wrong.

    Shapes: values (p,).
    names length p: Their names: a place can be wrong by more than a part of a machine.
    units length p: ``"rad"``, ``"m"``, ``"1/m"`` or ``"1"`` of each.
    Returns (p,): Standard deviations in the same units.
    """
    scales = np.where(values == 0, LARGEST_LENGTH_M, np.abs(values) * LARGEST_SHARE)
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        if unit == "rad":
            scales[i] = LARGEST_ANGLE_RAD
        elif unit == "m" and name.startswith(_PLACES):
            scales[i] = LARGEST_LENGTH_M
    return scales


def unobserved(
    jacobian: FloatArray, names: Sequence[str], sigmas: FloatArray, scales: FloatArray
) -> tuple[Combination, ...]:
    """Return the combinations that the priors decide rather than the observations.

    jacobian (m, k): Derivatives of the whitened, weighted residuals of the observations.
    names length k: Names of the free parameters.
    sigmas (k,): Their prior standard deviations, inf where there is none.
    scales (k,): What takes their place where there is none.
    Returns: Directions in which the information of the observations is less than that of the priors, least first.
    """
    if not len(names):
        return ()
    yardstick = np.where(np.isfinite(sigmas), sigmas, scales)
    scaled = jacobian * yardstick
    if len(scaled) > len(names):
        # The triangle has the same right singular vectors; all the left ones of 200 residuals would take 7 ms.
        scaled = np.asarray(np.linalg.qr(scaled, mode="r"), dtype=np.float64)
    _, singular, right = np.linalg.svd(scaled, full_matrices=True)
    information = np.zeros(len(names))
    information[: singular.size] = singular**2
    found = []
    for value, direction in zip(information[::-1], right[::-1], strict=True):
        if value >= 1.0:
            break
        # Shares below a tenth of the largest are correlations with what is observed well, not the combination itself.
        order = np.argsort(-np.abs(direction), kind="stable")
        order = order[np.abs(direction[order]) > 0.1 * np.abs(direction[order[0]])]
        moved = direction[order] * yardstick[order]
        moved = moved * np.sign(moved[0])
        held = bool(np.isfinite(sigmas[order]).all())
        found.append(Combination(tuple(names[i] for i in order), freeze(moved), float(value), held))
    return tuple(found)
