"""What slope errors along the trough do to the angle across it, where one pass cannot separate them."""

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.observation_equation import Sights, misfit

#: Beyond this incidence along the trough a slope error of 2.5 mrad along it moves theta_ra by 0.5 mrad (Owkes 2012,
#: Fig. 5.14).
STEEP_RAD = np.radians(15.0)
#: So much of the measured mirror may be seen more steeply without a word.
_SILENT_SHARE = 0.05
#: Height from which lines of sight are drawn; only their direction matters [m].
_HEIGHT_M = 100.0


def error_of_theta_ra(collector: Collector, incidence_rad: float, slope_y_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return by how much a slope error along the trough falsifies theta_ra, across the aperture.

    Shapes: x_m (101,).
    incidence_rad: Angle of the line of sight along the trough from the optical axis [rad].
    slope_y_rad: Error of dz/dy that the evaluation takes to be zero [rad].
    error_rad (101,): Error of theta_ra where the camera looks down at the place [rad].

    Exact reflection. To first order the error is ``-1/2 sin(2 alpha) tan(incidence) slope_y`` with
    ``tan(alpha) = X / (2 f)``: none at the vertex, most where the mirror stands at 45 degrees (Owkes 2012, sec. 5.2,
    eq. 5.11 and Fig. 5.14).
    """
    half = collector.aperture_width_m / 2
    x = np.linspace(-half, half, 101)
    points = np.stack([x, np.zeros_like(x), x**2 / (4 * collector.focal_length_m)], axis=1)
    eyes = points + _HEIGHT_M * np.array([0.0, np.tan(incidence_rad), 1.0])
    sights = Sights(points, eyes, np.zeros_like(x))
    absorber = AbsorberPath.designed(collector)
    slope_x = x / (2 * collector.focal_length_m)
    angles = [
        misfit(sights, (slope_x, np.full_like(x, slope)), absorber, collector.absorber_diameter_m / 2).angle_rad
        for slope in (0.0, slope_y_rad)
    ]
    # The camera angle of the absorber's centre is 2 theta_ra; psi falls where it grows.
    return x, np.asarray(0.5 * (angles[1] - angles[0]))


def incidence_doubt(slope_map: SlopeMap, eyes_m: FloatArray, collector: Collector, along_rad: float) -> Doubt | None:
    """Say how much of the mirror was seen so slantwise that slopes along the trough matter, which nobody measured.

    Shapes: eyes_m (n, 3).
    slope_map: The mirror; where its slope along the trough was measured nothing is doubtful.
    along_rad: Standard deviation that the slope along the trough is assumed to have [rad].
    Returns: None where less than a twentieth of the mirror is concerned.
    """
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    height = x**2 / (4 * collector.focal_length_m)
    # The reflection is seen at x by the cameras that stand above it.
    above = np.abs(slope_map.x_m[:, None] - eyes_m[:, 0]).argmin(axis=1)
    eye = eyes_m[above]
    incidence = np.arctan2(np.abs(eye[None, :, 1] - y), eye[None, :, 2] - height)
    alone = slope_map.valid & ~np.isfinite(slope_map.slope_y)
    steep = alone & (incidence > STEEP_RAD)
    share = int(steep.sum()) / max(int(slope_map.valid.sum()), 1)
    if share <= _SILENT_SHARE:
        return None
    most = float(incidence[steep].max())
    moved = float(np.sqrt(np.mean(error_of_theta_ra(collector, most, along_rad)[1] ** 2)))
    return Doubt(
        "mirror_seen_slantwise",
        f"{100 * share:.0f} % of the measured mirror was seen under more than 15 degrees along the trough (up to "
        f"{np.degrees(most):.0f}); slopes along the trough, taken as {1e3 * along_rad:.1f} mrad, move theta_ra there "
        f"by up to {1e3 * moved:.2f} mrad RMS. Fly higher, or a second pass at another place along the trough",
        {"slantwise_share": share, "incidence_rad": most, "effect_rad": moved},
    )
