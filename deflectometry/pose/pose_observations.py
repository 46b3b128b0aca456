"""A mirror's pose with its uncertainty, and what is known of it beside the image: distances, points, the roll."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from deflectometry.setup.camera_and_screen import Setup
from heliogauge.adjust.least_squares import Constraint
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.validate import FloatArray, float_array, positive


@dataclass(frozen=True, slots=True, eq=False)
class DistanceObservation:
    """A measured distance between a point of the mirror and a point fixed to the camera.

    sigma_m: Its standard deviation, with that of the fixed point along the line [m].
    mirror_point_m (3,): The point in the mirror's frame [m].
    cam_point_m (3,): The other point, the origin of the screen, in the camera frame [m].
    InputError: A distance or sigma that is not positive.
    """

    distance_m: float
    sigma_m: float
    mirror_point_m: FloatArray
    cam_point_m: FloatArray

    def __post_init__(self) -> None:
        positive("distance_m", self.distance_m, "metres")
        positive("sigma of the distance", self.sigma_m, "metres")
        for name in ("mirror_point_m", "cam_point_m"):
            object.__setattr__(self, name, float_array(name, getattr(self, name), (3,)))

    def predict(self, pose: RigidTransform) -> tuple[float, FloatArray]:
        """Return the distance at a pose [m] and its derivatives by the steps of `RigidTransform.moved`, shape (6,)."""
        turned = pose.rotate(self.mirror_point_m)
        line = turned + pose.translation_m - self.cam_point_m
        distance = float(np.linalg.norm(line))
        direction = line / distance
        return distance, np.concatenate([-direction @ skew(turned), direction])

    def constraint(self) -> Constraint[RigidTransform]:
        """Return the distance as an observation of the adjustment."""

        def evaluate(pose: RigidTransform) -> tuple[FloatArray, FloatArray]:
            distance, derivatives = self.predict(pose)
            return np.array([distance - self.distance_m]), derivatives[None]

        return Constraint("distance from mirror to screen", evaluate, self.sigma_m)


@dataclass(frozen=True, slots=True, eq=False)
class KnownPoints:
    """Points with known coordinates that were measured in the image.

    points_m (n, 3): In the mirror's frame [m].
    image_px (n, 2): In the image [px].
    sigma_px (n,): Standard deviation of each coordinate [px].
    """

    points_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    image_px: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    sigma_px: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_m", float_array("known points_m", self.points_m, (None, 3)))
        count = len(self.points_m)
        object.__setattr__(self, "image_px", float_array("known image_px", self.image_px, (count, 2)))
        object.__setattr__(self, "sigma_px", float_array("known sigma_px", self.sigma_px, (count,)))
        if not (self.sigma_px > 0).all():
            raise InputError("known sigma_px: positive numbers of pixels are needed")

    def rows(self, camera: Camera, pose: RigidTransform) -> tuple[FloatArray, FloatArray]:
        """Return whitened residuals (2 n,) and derivatives (2 n, 6)."""
        if not len(self.points_m):
            return np.zeros(0), np.zeros((0, 6))
        projection = camera.project_posed(self.points_m, pose)
        residuals = (projection.pixels_px - self.image_px) / self.sigma_px[:, None]
        return residuals.ravel(), (projection.d_pixel_d_pose / self.sigma_px[:, None, None]).reshape(-1, 6)


#: Rims, bevels and glints move a whole side. On the reference facet the sides seen in the modulation and in the bright
#: frame differ by up to 0.04 px at an edge width of 2 px, twice the scatter of single edge points.
SIDE_SHARE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What else is known of the pose, beside the image of the outline.

    distances: Measured distances.
    roll_rad: Expected angle from the image's x axis to the mirror's x axis, counter-clockwise as displayed [rad].
    sigma_outline_m: Standard deviation of where the design puts each side of the outline [m].
    side_share: Standard deviation of what all edge points of one side have in common, as a share of the edges'
        width.
    sigma_places_m: Standard deviations (3,) of each facet's place along the axes of the ensemble; None where none is
        stated. Empty: for no facet.
    InputError: A negative sigma.
    """

    distances: tuple[DistanceObservation, ...] = ()
    points: KnownPoints = field(default_factory=KnownPoints)
    roll_rad: float = 0.0
    sigma_outline_m: float = 0.0
    side_share: float = SIDE_SHARE
    sigma_places_m: tuple[FloatArray | None, ...] = ()

    @property
    def beside_m(self) -> FloatArray:
        """How far each facet may be from its place as stated, (n,), 0 where nothing is [m]."""
        return np.array([0.0 if one is None else float(one.max()) for one in self.sigma_places_m])

    def __post_init__(self) -> None:
        for name in ("sigma_outline_m", "side_share"):
            if not getattr(self, name) >= 0:
                raise InputError(f"{name}: zero or more is needed, not {getattr(self, name)}")


@dataclass(frozen=True, slots=True, eq=False)
class UncertainPose:
    """The pose of a mirror before alignment, how well it is known, and how it follows camera and screen.

    covariance (6, 6): Covariance for steps of `RigidTransform.moved` [rad, m], for camera and screen as given.
    with_setup: The pose that the same observations give with another setup; without it the pose stays where it is.
    """

    cam_from_mirror: RigidTransform
    covariance: FloatArray
    with_setup: Callable[[Setup], RigidTransform] | None = None

    def following(self, setup: Setup, aligned: RigidTransform) -> RigidTransform:
        """Return an aligned pose moved by what another setup does to the pose."""
        if self.with_setup is None:
            return aligned
        return self.with_setup(setup) @ self.cam_from_mirror.inverse() @ aligned
