"""The absorber's stated place beside where the photos of the reflection show the tube itself."""

import numpy as np

from heliogauge.doubts import Doubt, Severity
from heliogauge.validate import FloatArray
from observer.absorber.position import AbsorberSolution, StationFate
from observer.doubts.by_chance import contradicting_sigmas
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

#: Coordinates that are judged, across and in height.
_N_COORDINATES = 2
#: Places across the aperture at which slopes are asked for.
_N_PLACES = 101


def stated_absorber_doubt(
    stated: AbsorberPath,
    seen: AbsorberSolution,
    collector: Collector,
    usual_sigma_rad: float,
    n_modules: int = 1,
) -> Doubt | None:
    """Say that the photos show the tube elsewhere than it is stated.

    stated: The tube as it was used.
    seen: The tube as the photos show it directly.
    usual_sigma_rad: Usual sigma of a slope [rad].
    n_modules: Modules of the flight, each of which is asked.
    Returns: None where the means of both along the trough agree.

    A table's stations are stated apart from each other, but its frame errs for all alike: its mean is given the sigma
    of one station. The photos' mean has that of their joint covariance.
    """
    measured = seen.fate == StationFate.MEASURED
    path, count = seen.path, np.count_nonzero(measured)
    x, z = stated.at(path.y_m[measured])
    apart = np.array([np.mean(path.x_m[measured] - x), np.mean(path.z_m[measured] - z)])
    mean = np.kron(np.eye(_N_COORDINATES), measured / count)
    of_stated = [float(np.median(sigma)) for sigma in stated.sigma_at(path.y_m[measured])]
    sigma = np.sqrt(np.diag(mean @ path.covariance_m2 @ mean.T) + np.square(of_stated))
    wrong = np.abs(apart) > contradicting_sigmas(_N_COORDINATES * n_modules) * sigma
    if not wrong.any():
        return None
    moved_rad = float(np.sqrt(np.mean(_moved_slopes(apart, collector) ** 2)))
    said = [
        f"{1e3 * off:+.1f} +- {1e3 * own:.1f} mm in {axis}"
        for off, own, axis, is_wrong in zip(apart, sigma, "xz", wrong, strict=True)
        if is_wrong
    ]
    return Doubt(
        "stated_absorber_contradicts_photos",
        f"absorber: the photos show the tube {' and '.join(said)} beside where it is stated; slopes are "
        f"{1e3 * moved_rad:.2g} mrad RMS off with a wrong one (their sigma is {1e3 * usual_sigma_rad:.2g}). Is the "
        'table in the frame of the list of targets, of this collector and day? source = "photos" measures it',
        {"apart_x_m": float(apart[0]), "apart_z_m": float(apart[1]), "slopes_moved_rad": moved_rad},
        Severity.SERIOUS if moved_rad > usual_sigma_rad else Severity.DOUBT,
    )


def _moved_slopes(apart_m: FloatArray, collector: Collector) -> FloatArray:
    """Return by how much slopes across the aperture are others with the tube beside its place [rad]."""
    half = 0.5 * collector.aperture_width_m
    x = np.linspace(-half, half, _N_PLACES)
    slope, to_z = x / (2 * collector.focal_length_m), collector.focal_length_m - x**2 / (4 * collector.focal_length_m)
    # The normal bisects the directions to camera and tube.
    turn = (to_z * apart_m[0] + x * apart_m[1]) / (2 * (x**2 + to_z**2))
    return np.asarray((1 + slope**2) * turn)
