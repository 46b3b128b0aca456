"""Photos with the board found, and start values: what is adjusted."""

from dataclasses import dataclass, replace

import numpy as np

from calibration.camera.boards import Board
from calibration.camera.corners.detection import BoardPoints
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import IntArray
from photogrammetry import ImagePoints
from photogrammetry.bundle import BundleState

#: Two tilted photos determine a camera with square pixels and nothing to spare; three have something to spare.
LEAST_PHOTOS = 3


@dataclass(frozen=True, slots=True, eq=False)
class BoardNetwork:
    """Photos with the board found, and start values.

    board: The board as drawn, or as it was first found where nothing was known of it.
    points length p: Its points in each photo.
    free: Intrinsics that are estimated.
    poses length p: ``cam_from_board`` to start from.
    places_known: Whether the drawing gives the points' places.
    """

    board: Board
    points: tuple[BoardPoints, ...]
    free: tuple[str, ...]
    camera: Camera
    poses: tuple[RigidTransform, ...]
    places_known: bool = True

    @property
    def seen(self) -> IntArray:
        """Points of the board in at least one photo, shape (k,)."""
        return np.unique(np.concatenate([one.index for one in self.points]))

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        names = self.board.names
        return tuple(names[i] for i in self.seen)

    def observations(self) -> ImagePoints:
        """Gather all photos in one table."""
        place = np.full(len(self.board.names), -1, dtype=np.intp)
        place[self.seen] = np.arange(self.seen.size)
        return ImagePoints(
            tuple(one.photo for one in self.points),
            self.names,
            np.repeat(np.arange(len(self.points)), [one.n for one in self.points]),
            np.concatenate([place[one.index] for one in self.points]),
            np.concatenate([one.pixels_px for one in self.points]),
            np.concatenate([one.covariance_px2 for one in self.points]),
        )

    def start(self) -> BundleState:
        """Return the state to start from: the board as drawn."""
        return BundleState.from_poses([self.camera], self.poses, self.board.points_m[self.seen])

    def without(self, photo: int) -> "BoardNetwork":
        """Return the network without one photo."""
        rest = [i for i in range(len(self.points)) if i != photo]
        return replace(self, points=tuple(self.points[i] for i in rest), poses=tuple(self.poses[i] for i in rest))
