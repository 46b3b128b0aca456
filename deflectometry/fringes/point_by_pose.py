"""Where on the display a pixel must look by the mirror's pose: fringes of one period are counted from there."""

from dataclasses import replace

import numpy as np

from deflectometry.fringes.known_point import KnownDisplayPoint
from deflectometry.planning.predicted_sight import trace_pixels
from deflectometry.pose.facet_places import MOUNTING_RAD
from deflectometry.pose.find_pose import LocatedMirror
from deflectometry.setup.camera_and_screen import Setup
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import FloatArray

#: Share of the display up to which sigmas of relative slopes are tried: off by 0.12, curvatures are off by 2 of them
#: (tests/robustness/test_one_period.py); they follow it as a parabola does.
_MOST_SIGMA = 0.1
#: Steps of central differences (harmless: rounding) [rad, m].
_STEP = 1e-5
_STEPS = _STEP * np.eye(6)


def point_by_pose(setup: Setup, located: LocatedMirror) -> KnownDisplayPoint:
    """Return which point of the display the middle of a mirror of design shape shows.

    located: Where the mirror is, by its outline or as given.
    Returns: The point, with the sigmas of the pose, of the screen's pose, and of 3 mrad by which a good mirror's normal
        may be off that of its outline.
    EstimationError: The pose does not determine it to a tenth of the display.
    """
    facet, image_px = _in_the_middle(setup, located)
    pose, screen = located.pose, setup.cam_from_screen
    of_pose, of_screen = pose.covariance.copy(), setup.covariance_cam_from_screen
    of_pose[:3, :3] += MOUNTING_RAD**2 * np.eye(3)
    if located.evidence is not None:
        # Two tilts may fit the outline alike: half the way to the other one counts.
        of_pose[:3, :3] += 0.25 * np.outer(located.evidence.other_tilt_rad, located.evidence.other_tilt_rad)

    def seen(cam_from_mirror: RigidTransform, cam_from_screen: RigidTransform) -> FloatArray:
        u, v, _ = trace_pixels(replace(setup, cam_from_screen=cam_from_screen), cam_from_mirror, facet, image_px[None])
        return np.concatenate([u, v])

    display, covariance = seen(pose.cam_from_mirror, screen), np.zeros((2, 2))
    by_pose = [
        seen(pose.cam_from_mirror.moved(k), screen) - seen(pose.cam_from_mirror.moved(-k), screen) for k in _STEPS
    ]
    by_screen = [
        seen(pose.cam_from_mirror, screen.moved(k)) - seen(pose.cam_from_mirror, screen.moved(-k)) for k in _STEPS
    ]
    for changes, known in ((by_pose, of_pose), (by_screen, of_screen)):
        jacobian = np.stack(changes, axis=1) / (2 * _STEP)
        covariance += jacobian @ known @ jacobian.T
    sigma = np.sqrt(np.diag(covariance))
    # Not (<=) rather than >: a mirror that looks away from the screen is none to count from.
    if not (sigma <= _MOST_SIGMA).all():
        raise EstimationError(
            f"fringes of one period: by its pose the mirror shows ({display[0]:.2f}, {display[1]:.2f}) of the display "
            f"in its middle, with sigmas of {sigma[0]:.2g} and {sigma[1]:.2g}; {_MOST_SIGMA:g} are needed. Show a set "
            "below one period, or say which point of the display one pixel sees ([pattern.known_point])"
        )
    return KnownDisplayPoint(image_px, display, sigma, is_stated=False)


def _in_the_middle(setup: Setup, located: LocatedMirror) -> tuple[Facet, FloatArray]:
    """Return the facet nearest to the middle of the image, and the pixel (2,) of its reference point."""
    camera = setup.camera
    middle_px = 0.5 * np.array([camera.width_px - 1, camera.height_px - 1])
    places = []
    for one in located.facets:
        point = np.append(one.reference_point_m, one.design.height(*one.reference_point_m))
        places.append(np.rint(camera.project((located.outline_pose @ one.ensemble_from_facet).apply(point))))
    nearest = int(np.argmin([np.linalg.norm(one - middle_px) for one in places]))
    return located.facets[nearest], places[nearest]
