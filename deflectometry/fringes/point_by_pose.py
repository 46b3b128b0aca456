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
from heliogauge.validate import FloatArray

#: Share of the display up to which sigmas of relative slopes are tried: off by 0.12, curvatures are off by 2 of them
#: (tests/robustness/test_one_period.py); they follow it as a parabola does.
_MOST_SIGMA = 0.1
#: Steps of central differences (harmless: rounding) [rad, m].
_STEP = 1e-5
_STEPS = _STEP * np.eye(6)


def point_by_pose(setup: Setup, located: LocatedMirror) -> KnownDisplayPoint:
    """Return which point of the display the middle of a single facet of design shape shows.

    located: Where the mirror is, by its outline or as given.
    Returns: The point, with the sigmas of the pose, of the screen's pose, and of 3 mrad by which a good mirror's normal
        may be off that of its outline.
    EstimationError: The pose does not determine it to a tenth of the display, or there are several facets: orders are
        counted from pixel to pixel, and none lead from one facet to the next.
    """
    if len(located.facets) > 1:
        raise EstimationError(
            f"fringes of one period on {len(located.facets)} facets: their orders are counted from pixel to pixel, and "
            "from one facet to the next they cannot be. Show a set below one period; or measure one facet alone, as "
            "the only one in [mirror], or as that on which a point of the display is known ([pattern.known_point])"
        )
    facet = located.facets[0]
    middle = np.append(facet.reference_point_m, facet.design.height(*facet.reference_point_m))
    mirror_point = (located.outline_pose @ facet.ensemble_from_facet).apply(middle)
    image_px = np.rint(setup.camera.project(mirror_point))
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
