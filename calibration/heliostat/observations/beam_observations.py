"""Observations through the mirror: sunlight on a target or in a camera, a target in the mirror seen by a drone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from calibration.heliostat.kinematic_model.design import HeliostatDesign, PlaneTarget
from calibration.heliostat.kinematic_model.parameters import Parameters
from calibration.heliostat.observations.pointings import (
    ObservationGroup,
    Place,
    Pointings,
    check_names,
    check_places,
    covariance_rows,
    joined_parameters,
    prior_sigmas,
    sigma_rows,
    unit_rows,
)
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, float_array


@dataclass(frozen=True, slots=True, eq=False)
class BeamSpots(ObservationGroup):
    """Centres of the reflected sunlight on targets.

    pointings: Readings, rows, times.
    sun (n, 3): Directions to the sun.
    spot_m (n, 3): Where the beam's centre was seen, in the field's frame [m].
    covariance_m2 (n, 3, 3): Its covariance; singular across the target [m^2].
    target length n: On which target.
    InputError: Lengths differ, a value is not finite, a direction has no length.
    """

    kind: ClassVar[str] = "beam"
    pointings: Pointings
    sun: FloatArray
    spot_m: FloatArray
    covariance_m2: FloatArray
    target: tuple[str, ...]

    def __post_init__(self) -> None:
        count = len(self.pointings)
        object.__setattr__(self, "sun", unit_rows("sun", self.sun, count))
        object.__setattr__(self, "spot_m", float_array("spot_m", self.spot_m, (count, 3)))
        object.__setattr__(self, "covariance_m2", covariance_rows("covariance_m2", self.covariance_m2, count))
        check_names("target", self.target, count)

    @classmethod
    def on_targets(
        cls,
        pointings: Pointings,
        sun: npt.ArrayLike,
        targets: Mapping[str, PlaneTarget],
        target: Sequence[str],
        xy_m: npt.ArrayLike,
        sigma_m: npt.ArrayLike,
    ) -> "BeamSpots":
        """Build from coordinates on flat targets.

        Shapes: sun (n, 3), target length n.
        pointings: Readings, rows, times.
        xy_m (n, 2): Coordinates on it: right and up as seen from the field [m].
        sigma_m (): Their standard deviation [m].
        Returns: The same in the field's frame.
        InputError: A target is unknown, or shapes do not fit.
        """
        unknown = sorted(set(target) - set(targets))
        if unknown:
            raise InputError(f"target {', '.join(unknown)}: no such target; there are {', '.join(targets)}")
        count = len(pointings)
        check_names("target", tuple(target), count)
        xy = float_array("xy_m", xy_m, (count, 2))
        sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (count, 2))
        if not (np.isfinite(sigma) & (sigma > 0)).all():
            raise InputError("sigma_m: positive numbers of metres are needed")
        spot, covariance = np.empty((count, 3)), np.empty((count, 3, 3))
        for name in set(target):
            chosen = np.array([one == name for one in target], dtype=np.bool_)
            spot[chosen] = targets[name].points(xy[chosen])
            axes = targets[name].axes
            covariance[chosen] = np.einsum("nk,ki,kj->nij", sigma[chosen] ** 2, axes, axes)
        return cls(pointings, np.asarray(sun), spot, covariance, tuple(target))

    @classmethod
    def at_points(
        cls,
        pointings: Pointings,
        sun: npt.ArrayLike,
        spot_m: npt.ArrayLike,
        sigma_m: npt.ArrayLike,
        target: Sequence[str],
    ) -> "BeamSpots":
        """Build from points of the field's frame, (n, 3) [m], with one sigma [m] in all directions."""
        count = len(pointings)
        sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (count,))
        covariance = np.eye(3) * (sigma**2)[:, None, None]
        return cls(pointings, np.asarray(sun), np.asarray(spot_m), covariance, tuple(target))

    @property
    def label(self) -> tuple[str, ...]:
        """Target of each row."""
        return self.target

    @property
    def sun_or_nan(self) -> FloatArray:
        """Direction to the sun of each row, shape (n, 3)."""
        return self.sun


@dataclass(frozen=True, slots=True, eq=False)
class SunInCamera(ObservationGroup):
    """The sun's reflection seen in the middle of the mirror by a camera in the field, whose place may be unknown.

    pointings: Readings, rows, times.
    sun (n, 3): Directions to the sun.
    camera length n: By which camera.
    cameras: The cameras; those of unknown place (sigma inf) become parameters ``camera_<name>_e``, ``_n``, ``_u``.
    sigma_rad () or (n,): How well the beam's centre is known to meet the camera, per axis [rad of the beam].
    InputError: Lengths differ, a camera is unknown, a sigma is not positive.
    """

    kind: ClassVar[str] = "camera"
    pointings: Pointings
    sun: FloatArray
    camera: tuple[str, ...]
    cameras: tuple[Place, ...]
    sigma_rad: FloatArray

    def __post_init__(self) -> None:
        count = len(self.pointings)
        object.__setattr__(self, "sun", unit_rows("sun", self.sun, count))
        object.__setattr__(self, "sigma_rad", sigma_rows("sigma_rad", self.sigma_rad, count))
        check_places("camera", self.camera, self.cameras, count)

    @property
    def label(self) -> tuple[str, ...]:
        """Camera of each row."""
        return self.camera

    @property
    def sun_or_nan(self) -> FloatArray:
        """Direction to the sun of each row, shape (n, 3)."""
        return self.sun

    def extra_parameters(self, design: HeliostatDesign) -> Parameters:
        """Return the coordinates of the cameras."""
        del design
        return joined_parameters(place.parameters("camera") for place in self.cameras if place.name in self.camera)


@dataclass(frozen=True, slots=True, eq=False)
class DroneSightings(ObservationGroup):
    """A drone that sees a point of a target in the middle of the mirror (Gouws 2018).

    pointings: Readings, rows, times.
    source_m (n, 3): Where the drone's antenna was measured [m].
    source_covariance_m2 (n, 3, 3): Covariance of the drone's place, with the error of the centre in the image
        carried to it [m^2].
    target length n: Which point was seen.
    targets: The points; they become parameters ``target_<name>_e``, ``_n``, ``_u`` with their sigma.
    offset_sigma_m () or (3,): Standard deviation of the camera's place relative to the antenna [m]; parameters
        ``drone_offset_e``, ``_n``, ``_u``.
    InputError: Lengths differ, a target is unknown, a covariance is not positive definite.

    The residual lies at the drone, across the line of sight: there is the error. A residual on the target grows with
    the distance of the target, and least squares would shorten it: 50 mm at 27 m with points of 10 mm.
    """

    kind: ClassVar[str] = "drone"
    pointings: Pointings
    source_m: FloatArray
    source_covariance_m2: FloatArray
    target: tuple[str, ...]
    targets: tuple[Place, ...]
    offset_sigma_m: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        count = len(self.pointings)
        object.__setattr__(self, "source_m", float_array("source_m", self.source_m, (count, 3)))
        covariances = covariance_rows("source_covariance_m2", self.source_covariance_m2, count)
        object.__setattr__(self, "source_covariance_m2", covariances)
        object.__setattr__(self, "offset_sigma_m", prior_sigmas("offset_sigma_m", self.offset_sigma_m, 3))
        check_places("target", self.target, self.targets, count)

    @property
    def label(self) -> tuple[str, ...]:
        """Target of each row."""
        return self.target

    def extra_parameters(self, design: HeliostatDesign) -> Parameters:
        """Return the coordinates of the targets and the offset of the camera from the antenna."""
        del design
        names = tuple(f"drone_offset_{axis}" for axis in "enu")
        offset = Parameters(names, np.zeros(3), self.offset_sigma_m, ("m",) * 3)
        return joined_parameters(
            [*(place.parameters("target") for place in self.targets if place.name in self.target), offset]
        )
