"""What errors of the set-up make of a turn between two frames: its scale and its direction, in all frames alike."""

import numpy as np

from deflectometry.pipeline.source_slopes import SolvedSource
from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.common_modes import MovedInput, moved_inputs
from heliogauge.geometry.rigid import rotation_between
from heliogauge.validate import FloatArray

#: Of the screen: what is seen in the middle of the mirror moves by so much.
_STEP = 1e-3


def turn_shares(setup: Setup, located: UncertainPose, slopes: SolvedSource) -> FloatArray:
    """Return what one sigma of each input adds to a turn, as matrices that the turn is multiplied by, (n, 2, 2).

    located: Pose of the first frame from its outline.
    slopes: Its smooth shape.

    The turn moves what is seen in the middle of the mirror over the screen; the bisector of the directions to camera
    and screen turns with it, seen in the frame of a mirror whose normal was the bisector before.
    """
    solution = slopes.solution
    middle_m = np.concatenate(
        [one.facet.ensemble_from_facet.apply(one.facet.corners_m) for one in slopes.usable.samples]
    ).mean(axis=0)
    u, v = (float(np.nanmean(one)) for one in (slopes.screen_map.u, slopes.screen_map.v))
    here = MovedInput("", setup, solution.cam_from_mirror)
    middle = here.cam_from_mirror.inverse().rotate(_bisectors(here, middle_m, u, v)[0])

    def slopes_by_place(moved: MovedInput) -> FloatArray:
        normals = _bisectors(moved, middle_m, u, v)
        rotation = moved.cam_from_mirror.rotation
        own = normals @ (rotation_between(rotation @ middle, normals[0]) @ rotation)
        found = -own[:, :2] / own[:, 2:]
        return np.asarray((found[1:] - found[0]).T / _STEP)

    back = np.linalg.inv(slopes_by_place(here))
    moved = moved_inputs(setup, solution.cam_from_mirror, located)
    return np.array([slopes_by_place(one) @ back - np.eye(2) for one in moved]).reshape(-1, 2, 2)


def _bisectors(moved: MovedInput, middle_m: FloatArray, u: float, v: float) -> FloatArray:
    """Return the normals in the middle that see (u, v), and that one step along u and one along v, (3, 3)."""
    point = moved.cam_from_mirror.apply(middle_m)
    places = moved.setup.screen.points_m(u + np.array([0.0, _STEP, 0.0]), v + np.array([0.0, 0.0, _STEP]))
    to_screen = moved.setup.cam_from_screen.apply(places) - point
    ways = to_screen / np.linalg.norm(to_screen, axis=1, keepdims=True) - point / np.linalg.norm(point)
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))
