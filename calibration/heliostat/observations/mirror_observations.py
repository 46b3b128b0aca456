"""Observations of the mirror itself: lamps seen by a camera on it, its normals, its points."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.kinematic_model.directions import Sights
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.kinematic_model.parameters import Parameters
from calibration.heliostat.observations.pointings import (
    MountedCamera,
    ObservationGroup,
    Pointings,
    check_names,
    covariance_rows,
    sigma_rows,
    unit_rows,
)
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, float_array


@dataclass(frozen=True, slots=True, eq=False)
class LampSightings(ObservationGroup):
    """Lamps at known places seen by a camera that is rigid on the structure.

    pointings: Readings, rows, times.
    lamp_m (n, 3): Places of the lamps [m].
    lamp length n: Which lamp.
    sigma_rad () or (n,): Standard deviation of the line of sight per axis: of the image, the drives and the lamp's
        place [rad].
    position length n: Uncalibrated camera: label of the image position the lamp was driven to; all rows of a label
        share one unknown direction, parameters ``direction_<label>_a``, ``_b``.
    direction_camera (n, 3): Calibrated camera: direction of the lamp in its frame; its rotation on the structure is
        ``mounted_turn_x``, ``_y``, ``_z``.
    camera: Where the camera sits; parameters ``mounted_x``, ``_y``, ``_z``.
    InputError: Lengths differ, or not exactly one of position and direction is given.

    STAGE-STE Deliverable 12.6, section 4.2.2: intrinsics that drift need not be known if every lamp is driven to the
    same image positions.
    """

    kind: ClassVar[str] = "lamp"
    pointings: Pointings
    lamp_m: FloatArray
    lamp: tuple[str, ...]
    sigma_rad: FloatArray
    position: tuple[str, ...] | None = None
    direction_camera: FloatArray | None = None
    camera: MountedCamera = field(default_factory=MountedCamera)

    def __post_init__(self) -> None:
        count = len(self.pointings)
        object.__setattr__(self, "lamp_m", float_array("lamp_m", self.lamp_m, (count, 3)))
        object.__setattr__(self, "sigma_rad", sigma_rows("sigma_rad", self.sigma_rad, count))
        check_names("lamp", self.lamp, count)
        if (self.position is None) == (self.direction_camera is None):
            raise InputError("lamps: give image positions by name, or directions of a calibrated camera, one of both")
        if self.position is not None:
            check_names("position", self.position, count)
        else:
            directions = unit_rows("direction_camera", self.direction_camera, count)
            object.__setattr__(self, "direction_camera", directions)

    @property
    def label(self) -> tuple[str, ...]:
        """Lamp of each row."""
        return self.lamp

    def extra_parameters(self, design: HeliostatDesign) -> Parameters:
        """Return where the camera sits, and the shared directions as the design's own numbers show them."""
        names = tuple(f"mounted_{axis}" for axis in "xyz")
        point = Parameters(names, self.camera.point_m, self.camera.sigma_m, ("m",) * 3)
        if self.position is None:
            turn = tuple(f"mounted_turn_{axis}" for axis in "xyz")
            return point.extended(Parameters(turn, np.zeros(3), self.camera.sigma_rad, ("rad",) * 3))
        poses = mirror_poses(design, design.parameters.values, self.pointings.readings, self.pointings.approach)
        seen = self.lamp_m - poses.points(self.camera.point_m)
        lines = np.einsum("nji,nj->ni", poses.rotation, seen)
        labels, names_of = sorted(set(self.position)), []
        values = np.empty(2 * len(labels))
        for k, label in enumerate(labels):
            chosen = np.array([one == label for one in self.position], dtype=np.bool_)
            mean = unit_rows("lamp", lines[chosen], int(chosen.sum())).mean(axis=0)
            values[2 * k : 2 * k + 2] = Sights.along(self.camera.axis[None]).coordinates(mean[None])[0]
            names_of += [f"direction_{label}_a", f"direction_{label}_b"]
        directions = Parameters(tuple(names_of), values, np.full(values.size, np.inf), ("rad",) * values.size)
        return point.extended(directions)


@dataclass(frozen=True, slots=True, eq=False)
class MirrorNormals(ObservationGroup):
    """Normals of the mirror in the field's frame, from photogrammetry, a laser tracker, an inclinometer.

    pointings: Readings, rows, times.
    normal (n, 3): Outward normals of any length.
    sigma_rad () or (n,): Standard deviation per axis [rad of the normal].
    InputError: Lengths differ, a direction has no length, a sigma is not positive.
    """

    kind: ClassVar[str] = "normal"
    pointings: Pointings
    normal: FloatArray
    sigma_rad: FloatArray

    def __post_init__(self) -> None:
        count = len(self.pointings)
        object.__setattr__(self, "normal", unit_rows("normal", self.normal, count))
        object.__setattr__(self, "sigma_rad", sigma_rows("sigma_rad", self.sigma_rad, count))


@dataclass(frozen=True, slots=True, eq=False)
class MirrorPoints(ObservationGroup):
    """Points of the mirror measured in the field's frame, by photogrammetry or multilateration.

    pointings: Readings, rows, times; one row per point.
    point_mirror_m (n, 3): The points in the mirror's frame [m].
    point_m (n, 3): The points as measured [m].
    covariance_m2 (n, 3, 3): Their covariance [m^2].
    point length n: Which point.
    InputError: Lengths differ, a value is not finite, a covariance is not positive definite.
    """

    kind: ClassVar[str] = "point"
    n_components: ClassVar[int] = 3
    pointings: Pointings
    point_mirror_m: FloatArray
    point_m: FloatArray
    covariance_m2: FloatArray
    point: tuple[str, ...]

    def __post_init__(self) -> None:
        count = len(self.pointings)
        object.__setattr__(self, "point_mirror_m", float_array("point_mirror_m", self.point_mirror_m, (count, 3)))
        object.__setattr__(self, "point_m", float_array("point_m", self.point_m, (count, 3)))
        object.__setattr__(self, "covariance_m2", covariance_rows("covariance_m2", self.covariance_m2, count))
        check_names("point", self.point, count)

    @property
    def label(self) -> tuple[str, ...]:
        """Point of each row."""
        return self.point
