"""What slope errors along the trough do to the angle across it, where one pass cannot tell them apart."""

import numpy as np

from heliogauge.validate import FloatArray
from observer.absorber_path import AbsorberPath
from observer.design import Collector
from observer.sight import Sights, misfit

#: Height from which lines of sight are drawn; only their direction matters [m].
_HEIGHT_M = 100.0


def error_of_theta_ra(collector: Collector, incidence_rad: float, slope_y_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return by how much a slope error along the trough falsifies theta_ra, across the aperture.

    Parameters
    ----------
    collector : Collector
        The collector.
    incidence_rad : float
        Angle of the line of sight along the trough from the optical axis [rad].
    slope_y_rad : float
        Error of dz/dy that the evaluation takes to be zero [rad].

    Returns
    -------
    x_m : ndarray, shape (101,)
        Places across the aperture [m].
    error_rad : ndarray, shape (101,)
        Error of theta_ra where the camera looks down at the place [rad].

    Notes
    -----
    Exact reflection. To first order the error is ``-1/2 sin(2 alpha) tan(incidence) slope_y`` with
    ``tan(alpha) = X / (2 f)``: none at the vertex, most where the mirror stands at 45 degrees (Owkes 2012, sec. 5.2,
    eq. 5.11 and Fig. 5.14).
    """
    half = collector.aperture_width_m / 2
    x = np.linspace(-half, half, 101)
    points = np.stack([x, np.zeros_like(x), x**2 / (4 * collector.focal_length_m)], axis=1)
    eyes = points + _HEIGHT_M * np.array([0.0, np.tan(incidence_rad), 1.0])
    sights = Sights(points, eyes, np.zeros_like(x))
    absorber = AbsorberPath.straight(0.0, collector.focal_length_m, collector.length_m / 2)
    slope_x = x / (2 * collector.focal_length_m)
    angles = [
        misfit(sights, (slope_x, np.full_like(x, slope)), absorber, collector.absorber_diameter_m / 2).angle_rad
        for slope in (0.0, slope_y_rad)
    ]
    # The camera angle of the absorber's centre is 2 theta_ra; psi falls where it grows.
    return x, np.asarray(0.5 * (angles[1] - angles[0]))
