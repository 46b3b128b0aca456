"""What a camera's pass over a trough resolves: the figures by which flights are compared (Owkes 2012, section 7.1)."""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray, float_array, positive
from observer.trough.collector import Collector


@dataclass(frozen=True, slots=True)
class FlightFigures:
    """Figures of a straight pass across the aperture.

    pixel_on_aperture_m: Size of a pixel at the collector, dx_ap (eq. 7.13 above the vertex) [m].
    pixel_on_absorber_m: Size of a pixel at the absorber, dx_abs (eq. 7.12), mean over the photos [m].
    camera_angle_step_rad: Mean change of the camera's angle across the trough between photos, dPhi_c (eq. 7.14)
        [rad].
    camera_target_angle_rad: Angle between targets on both rims as the camera sees them, theta_ct (eq. 7.16) [rad].
    longitudinal_incidence_rad: Largest angle along the trough between a line of sight to the rim's plane and the
        optical axis [rad].
    """

    pixel_on_aperture_m: float
    pixel_on_absorber_m: float
    camera_angle_step_rad: float
    camera_target_angle_rad: float
    longitudinal_incidence_rad: float


def flight_figures(collector: Collector, pixel_rad: float, eyes_m: FloatArray) -> FlightFigures:
    """Work out the figures of a pass.

    pixel_rad: Pitch of the pixels over the focal length [rad].
    eyes_m (n, 3): Where the camera is, photo by photo, at least two [m].
    InputError: Fewer than two cameras, or one that is not above the rim.

    Eq. 7.14 is the mean absolute difference of atan(X_c / Z_c) between neighbours across the trough.
    """
    positive("pixel_rad", pixel_rad, "radians")
    eyes = float_array("eyes_m", eyes_m, (None, 3))
    height = float(eyes[:, 2].mean())
    above_rim = height - collector.rim_height_m
    positive("height of the cameras above the rim", above_rim, "metres")
    positive("number of photos less one", float(len(eyes) - 1), "photos")
    angles = np.sort(np.arctan2(eyes[:, 0], eyes[:, 2]))
    to_absorber = np.hypot(eyes[:, 0], eyes[:, 2] - collector.focal_length_m)
    ends = np.array([-0.5, 0.5]) * collector.length_m
    away = np.abs(eyes[:, 1:2] - ends).max()
    return FlightFigures(
        pixel_rad * height,
        float(pixel_rad * to_absorber.mean()),
        float(np.abs(np.diff(angles)).mean()),
        2 * float(np.arctan(collector.aperture_width_m / 2 / above_rim)),
        float(np.arctan(away / above_rim)),
    )


def reach_needed_m(collector: Collector, height_m: float, slope_error_rad: float) -> float:
    """Return how far to either side of the middle a pass must go for the whole aperture to show both edges of the tube.

    height_m: Height of the camera above the vertex [m].
    slope_error_rad: Largest slope error of the mirror (of the normal) [rad].
    Returns: Size of X_c at the ends of the pass [m].

    From Phi = 2 theta_ra -/+ w with sin(w) = r_a / distance (Owkes 2012, eqs 5.4 and 5.10).
    """
    x = np.linspace(0.0, collector.aperture_width_m / 2, 201)
    z = x**2 / (4 * collector.focal_length_m)
    half = np.arcsin(collector.absorber_diameter_m / 2 / np.hypot(x, collector.focal_length_m - z))
    return float((x + (height_m - z) * np.tan(half + 2 * slope_error_rad)).max())
