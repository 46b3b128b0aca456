"""Curves of the tracking error over days: what an error of the model does to the beam from sunrise to sunset.

A controller aims with one model a heliostat that obeys another; the beam's error is seen across the line of sight
(Malan 2014, 4.3). The study of stability asks how an estimate from one day's beams does on other days (4.4).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.heliostat.kinematic_model.design import HeliostatDesign, PlaneTarget
from calibration.heliostat.planning.simulate import Control, commanded_offsets, drawn_beams, monte_carlo
from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ErrorCurve(ShortRepr):
    """The beam's error at each of some suns.

    places_m (n, 2): On the target's plane, right and up from its centre; NaN where the heliostat cannot go or the
        beam leaves the plane [m].
    angles_rad (n, 2): Across the line of sight, right and up as seen from the heliostat; NaN as above [rad].
    """

    places_m: FloatArray
    angles_rad: FloatArray

    @property
    def served(self) -> int:
        """At how many suns there is a beam."""
        return int(np.isfinite(self.angles_rad).all(axis=1).sum())

    @property
    def rms_rad(self) -> float:
        """Root of the mean square of both directions together; NaN without any beam [rad]."""
        known = self.angles_rad[np.isfinite(self.angles_rad).all(axis=1)]
        return float(np.sqrt(np.mean(np.sum(known**2, axis=1)))) if len(known) else float("nan")

    def range_rad(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return least and largest error to the right, and up [rad]."""
        known = self.angles_rad[np.isfinite(self.angles_rad).all(axis=1)]
        if not len(known):
            return (float("nan"), float("nan")), (float("nan"), float("nan"))
        (right, up), (most_right, most_up) = known.min(axis=0).tolist(), known.max(axis=0).tolist()
        return (right, most_right), (up, most_up)


def error_curve(
    truth: HeliostatDesign,
    believed: HeliostatDesign,
    suns: FloatArray,
    target: PlaneTarget,
    control: Control | None = None,
) -> ErrorCurve:
    """Return the error of the beam when a controller with one model aims a heliostat that obeys another.

    Shapes: suns (n, 3).
    believed: The controller's model, of the same readings.
    control: Steps of the drives.
    InputError: A target straight above or below the heliostat.
    """
    places = commanded_offsets(truth, believed, suns, target, control=control)
    sight = target.center_m - believed.position_m
    distance = float(np.linalg.norm(sight))
    right = np.cross(sight, [0.0, 0.0, 1.0])
    if not float(np.linalg.norm(right)) > 1e-6 * distance:
        raise InputError(f"target {target.name}: it stands straight above the heliostat; right and up have no meaning")
    across = PlaneTarget("line of sight", target.center_m, right, np.cross(right, sight), 1.0, 1.0)
    angles = np.arctan(commanded_offsets(truth, believed, suns, across, control=control) / distance)
    return ErrorCurve(places, np.asarray(angles))


def with_change(design: HeliostatDesign, name: str, change: float) -> HeliostatDesign:
    """Return a heliostat with one parameter larger by a change."""
    return design.with_value({name: design.parameters.value(name) + change})


@dataclass(frozen=True, slots=True, eq=False)
class Stability(ShortRepr):
    """How an estimate from one day's beams does on some days.

    rms_rad (t, d): Daily RMS of the beam's error for each draw and day [rad].
    failed: Draws without a fit.
    """

    rms_rad: FloatArray
    failed: int


def stability(
    truth: HeliostatDesign,
    believed: HeliostatDesign,
    suns: FloatArray,
    days: Sequence[FloatArray],
    target: PlaneTarget,
    *,
    sigma_m: float,
    draws: int,
    seed: int = 0,
) -> Stability:
    """Estimate a heliostat from noisy beams of some suns again and again; compare with the truth on other days.

    Shapes: suns (n, 3).
    believed: Values and prior sigmas before the estimate.
    days: Suns of each day, shape (m, 3).
    sigma_m: Of a measured centre, right and up [m].
    InputError: The heliostat can serve none of the suns.
    EstimationError: No draw gave a fit.
    """
    study = monte_carlo(
        truth,
        believed,
        lambda rng: drawn_beams(truth, suns, target, sigma_m, rng),
        draws,
        seed,
        evaluate=lambda found: np.array([error_curve(truth, found, day, target).rms_rad for day in days]),
    )
    return Stability(study.figures, len(study.failed))
