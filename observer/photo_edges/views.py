"""Photos of which it is known from where they were taken."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import Float32Array, FloatArray
from photogrammetry.centers import EdgeShape

AnyImage = npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | Float32Array

#: Rounds in which the row of a moving camera's image point settles: each leaves as much as the motion over a frame is
#: of the distance, below 0.01, of the one before.
_ROUNDS = 6


class View(NamedTuple):
    """The camera of a photo and where it was."""

    camera: Camera
    cam_from_frame: RigidTransform

    @property
    def eye_m(self) -> FloatArray:
        """Where the camera was, in the middle of the frame if it moved, shape (3,) [m]."""
        return self.cam_from_frame.inverse().translation_m

    @property
    def moves(self) -> bool:
        """Whether the camera moves while it reads a frame."""
        return False

    def posed(self, cam_from_frame: RigidTransform) -> "View":
        """Return the same camera elsewhere."""
        return View(self.camera, cam_from_frame)

    def project(self, points_m: FloatArray) -> FloatArray:
        """Return image points, each taken while its own row is read; NaN where it cannot be seen.

        Shapes: points_m (..., 3), result (..., 2) [px].
        """
        return self.camera.project(self.cam_from_frame.apply(points_m))

    def eyes_at(self, pixels_px: FloatArray) -> FloatArray:
        """Return where the camera was when it took image points.

        Shapes: pixels_px (..., 2), result (..., 3) [m].
        """
        return np.broadcast_to(self.eye_m, (*pixels_px.shape[:-1], 3))


class MovingView(View):
    """A camera with a rolling shutter that moved in a straight line, without turning, while it read its rows.

    cam_from_frame: While the middle row was read.
    motion_m (3,): Motion in the frame from the first row to the last [m].
    """

    motion_m: FloatArray

    def __new__(cls, camera: Camera, cam_from_frame: RigidTransform, motion_m: FloatArray) -> Self:
        """Return the view."""
        view = super().__new__(cls, camera, cam_from_frame)
        view.motion_m = motion_m
        return view

    def __getnewargs__(self) -> tuple[Camera, RigidTransform, FloatArray]:
        """Return what makes a copy in another process."""
        return self.camera, self.cam_from_frame, self.motion_m

    @property
    def moves(self) -> bool:
        """Whether the camera moves while it reads a frame."""
        return True

    def posed(self, cam_from_frame: RigidTransform) -> "MovingView":
        """Return the same camera elsewhere, moving as before."""
        return MovingView(self.camera, cam_from_frame, self.motion_m)

    def project(self, points_m: FloatArray) -> FloatArray:
        """Return image points, each taken while its own row is read; NaN where it cannot be seen.

        Shapes: points_m (..., 3), result (..., 2) [px].
        """
        motion_cam_m = self.cam_from_frame.rotate(self.motion_m)
        return project_moving(self.camera, self.cam_from_frame.apply(points_m), motion_cam_m)

    def eyes_at(self, pixels_px: FloatArray) -> FloatArray:
        """Return where the camera was when it took image points.

        Shapes: pixels_px (..., 2), result (..., 3) [m].
        """
        return np.asarray(self.eye_m + after_middle(self.camera, pixels_px)[..., None] * self.motion_m)


def after_middle(camera: Camera, pixels_px: FloatArray) -> FloatArray:
    """Return how long after the middle row image points are taken, as share of the readout.

    Shapes: pixels_px (..., 2), result (...).
    """
    return np.asarray((pixels_px[..., 1] - (camera.height_px - 1) / 2) / camera.height_px)


def project_moving(camera: Camera, points_m: FloatArray, motion_m: FloatArray) -> FloatArray:
    """Project points with a camera that moves while it reads its rows.

    Shapes: points_m (..., 3), result (..., 2) [px].
    points_m: In the frame of the camera while it reads the middle row [m].
    motion_m (3,) or (..., 3): Motion from first to last row in that frame [m].
    """
    pixels = camera.project(points_m)
    for _ in range(_ROUNDS):
        pixels = camera.project(points_m - after_middle(camera, pixels)[..., None] * motion_m)
    return pixels


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A photo with its view.

    image (height, width): The photo, grey [DN].
    edges: Tells how its edges are blurred across the trough, or None where no targets say so; asked where it shows
        the tube only.
    """

    image: AnyImage
    number: int
    view: View
    edges: Callable[[], EdgeShape | None] = lambda: None
