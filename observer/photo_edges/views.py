"""Photos of which it is known from where they were taken."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import Float32Array, FloatArray

AnyImage = npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | Float32Array


class View(NamedTuple):
    """The camera of a photo and where it was."""

    camera: Camera
    cam_from_frame: RigidTransform

    @property
    def eye_m(self) -> FloatArray:
        """Where the camera was, shape (3,) [m]."""
        return self.cam_from_frame.inverse().translation_m


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A photo with its view.

    image (height, width): The photo, grey [DN].
    """

    image: AnyImage
    number: int
    view: View
