"""Cameras in millimetres on the sensor with all ten parameters, as close-range photogrammetry prints them."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, covariance_matrix, float_array, positive

_COUNT = len(PARAMETER_NAMES)
_POWERS = np.array([2, 4, 6])

#: Our camera frame (x right, y down, z forward) from the photogrammetric one (x right, y up, looking along -z):
#: ``cam_from_world = CAM_FROM_PHOTOGRAMMETRIC @ rotation_from_omega_phi_kappa(...)``.
CAM_FROM_PHOTOGRAMMETRIC: FloatArray = np.diag([1.0, -1.0, -1.0])
CAM_FROM_PHOTOGRAMMETRIC.setflags(write=False)


class PrincipalOrigin(StrEnum):
    """Where the principal point is counted from."""

    CORNER = "corner"
    CENTER = "center"


class LensForm(StrEnum):
    """How a program writes its lens."""

    BROWN = "brown"
    AICON = "aicon"


#: Names of the ten parameters in each form, in the order of `SensorParameters.values`.
SENSOR_NAMES: dict[LensForm, tuple[str, ...]] = {
    LensForm.BROWN: (
        "focal_mm",
        "principal_x_mm",
        "principal_y_mm",
        "K1",
        "K2",
        "K3",
        "P1",
        "P2",
        "aspect",
        "shear",
    ),
    LensForm.AICON: ("focal_mm", "principal_x_mm", "principal_y_mm", "A1", "A2", "A3", "B1", "B2", "C1", "C2"),
}


@dataclass(frozen=True, slots=True)
class Sensor:
    """What is not estimated: the sensor, and the conventions of the program that printed the parameters.

    width_px, height_px: Size of the image [px].
    pixel_mm: Height of a pixel [mm].
    form: The lens in the words of DBAT and PhotoModeler, or of AICON and Luhmann.
    zero_radius_mm: Radius r0 at which AICON's radial distortion is zero [mm].
    principal_origin: Whether the principal point counts from the outer corner of the first pixel, to the right and
        down, or from the sensor's centre, to the right and up.
    y_up: Whether y of the lens points up in the image.
    direction: Way of the polynomial; MEASURED_TO_IDEAL in photogrammetry.
    InputError: A size that is not positive, a word that names no convention, or a zero radius in Brown's form.
    """

    width_px: int
    height_px: int
    pixel_mm: float
    form: LensForm = LensForm.BROWN
    zero_radius_mm: float = 0.0
    principal_origin: PrincipalOrigin = PrincipalOrigin.CENTER
    y_up: bool = True
    direction: DistortionDirection = DistortionDirection.MEASURED_TO_IDEAL

    def __post_init__(self) -> None:
        for name, unit in (("width_px", "pixels"), ("height_px", "pixels"), ("pixel_mm", "mm")):
            positive(name, getattr(self, name), unit)
        conventions = (("form", LensForm), ("principal_origin", PrincipalOrigin), ("direction", DistortionDirection))
        for name, kind in conventions:
            try:
                object.__setattr__(self, name, kind(getattr(self, name)))
            except ValueError as error:
                raise InputError(f"{name}: one of {', '.join(kind)} is needed, not {getattr(self, name)!r}") from error
        if self.zero_radius_mm < 0 or (self.zero_radius_mm and self.form is LensForm.BROWN):
            raise InputError("zero_radius_mm: not negative, and only with AICON's form of the lens")

    @property
    def _sign(self) -> float:
        return -1.0 if self.y_up else 1.0

    @property
    def gain(self) -> float:
        """Sign of the printed coefficients in the way of the polynomial: AICON's are errors of the measured image."""
        backward = self.direction is DistortionDirection.MEASURED_TO_IDEAL
        return -1.0 if backward and self.form is LensForm.AICON else 1.0

    def stretch(self, values: npt.NDArray[np.inexact]) -> complex:
        """Return what a zero radius makes of the camera constant: 1 in Brown's form."""
        return complex(1 - (self.gain * values[3:6] * self.zero_radius_mm**_POWERS).sum())

    def to_camera_values(self, values: npt.NDArray[np.inexact]) -> npt.NDArray[np.inexact]:
        """Return `heliogauge.camera.model.PARAMETER_NAMES` from the ten values, shape (10,); real or complex."""
        focal, (c1, c2) = values[0], self.gain * values[8:10]
        radial, tangential = self.gain * values[3:6], self.gain * values[6:8]
        stretch = self.stretch(values)
        if self.direction is DistortionDirection.MEASURED_TO_IDEAL:
            focal_x, focal_y = focal / (stretch + c1), focal / stretch
            skew = -c2 * focal / (stretch * (stretch + c1))
            radial = radial * focal**_POWERS / stretch ** (_POWERS + 1)
            tangential = tangential * focal / stretch**2
        else:
            focal_x, focal_y, skew = focal * (stretch + c1), focal * stretch, c2 * focal
            radial, tangential = radial * focal**_POWERS / stretch, tangential * focal / stretch
        origin, down = self._origin_px()
        center = origin + values[1:3] * np.array([1.0, down]) / self.pixel_mm - 0.5
        own = np.array([focal_x, focal_y]) / self.pixel_mm
        skew_px = self._sign * skew / self.pixel_mm
        k1, k2, k3 = radial
        return np.array([*own, *center, skew_px, k1, k2, self._sign * tangential[1], tangential[0], k3])

    def from_camera_values(self, parameters: FloatArray) -> FloatArray:
        """Return the ten values from `heliogauge.camera.model.PARAMETER_NAMES`, shape (10,)."""
        focal_x, focal_y = parameters[:2] * self.pixel_mm
        radial, tangential = parameters[[5, 6, 9]], parameters[[8, 7]] * [1.0, self._sign]
        skew = self._sign * parameters[4] * self.pixel_mm
        if self.direction is DistortionDirection.MEASURED_TO_IDEAL:
            stretch = 1 / (1 + (radial * (self.zero_radius_mm / focal_y) ** _POWERS).sum())
            focal = focal_y * stretch
            c1 = focal / focal_x - stretch
            c2 = -skew * stretch * (stretch + c1) / focal
            radial, tangential = radial * stretch / focal_y**_POWERS, tangential * stretch / focal_y
        else:
            stretch = 1.0
            # The stretch at r0 depends on the focal length that it stretches: a contraction by 2 |dr/r| each time.
            for _ in range(60):
                stretch = 1 / (1 + (radial * (self.zero_radius_mm * stretch / focal_y) ** _POWERS).sum())
            focal = focal_y / stretch
            c1, c2 = focal_x / focal - stretch, skew / focal
            radial, tangential = radial * stretch / focal**_POWERS, tangential * stretch / focal
        origin, down = self._origin_px()
        principal = (parameters[2:4] + 0.5 - origin) * [self.pixel_mm, down * self.pixel_mm]
        lens = self.gain * np.array([*radial, *tangential, c1, c2])
        return np.array([focal, *principal, *lens])

    def _origin_px(self) -> tuple[FloatArray, float]:
        if self.principal_origin is PrincipalOrigin.CORNER:
            return np.zeros(2), 1.0
        return np.array([self.width_px, self.height_px]) / 2, self._sign

    def derivatives(self, values: FloatArray) -> FloatArray:
        """Return the derivative of `to_camera_values`, shape (10, 10), by complex steps, exact to rounding."""
        jacobian = np.empty((_COUNT, _COUNT))
        for column in range(_COUNT):
            moved = values.astype(np.complex128)
            moved[column] += 1e-30j
            jacobian[:, column] = self.to_camera_values(moved).imag / 1e-30
        return jacobian


@dataclass(frozen=True, slots=True, eq=False)
class SensorParameters:
    """The ten parameters of a camera in millimetres.

    sensor: The sensor and the conventions.
    values (10,): In the order of `SENSOR_NAMES`: camera constant and principal point [mm], K1 to K3 (A1 to A3)
        [mm^-2, mm^-4, mm^-6], P1, P2 (B1, B2) [mm^-1], aspect and shear (C1, C2).
    covariance (10, 10): Their covariance; zeros say "treated as exact".
    InputError: A wrong shape, no covariance, or a camera constant or width of a pixel that is not positive.

    With x', y' reduced by the principal point, r^2 = x'^2 + y'^2, Brown's form corrects measured coordinates by ``x =
    x' (1 + K1 r^2 + K2 r^4 + K3 r^6) + P1 (r^2 + 2 x'^2) + 2 P2 x' y' + aspect x' + shear y'`` and ``y = y' (1 + ...)
    + P2 (r^2 + 2 y'^2) + 2 P1 x' y'``. AICON's (Luhmann et al., Close-Range Photogrammetry and 3D Imaging, sect. 3.3)
    subtracts ``x' [A1 (r^2 - r0^2) + A2 (r^4 - r0^4) + A3 (r^6 - r0^6)] + B1 (r^2 + 2 x'^2) + 2 B2 x' y' + C1 x' + C2
    y'``. IDEAL_TO_MEASURED adds the same terms of the ideal coordinates. Everything but the product of affine and
    other terms is converted exactly: the camera applies aspect and skew to the measured image first, so terms of the
    order C1 (A1 r^2) differ, 3 x 2e-4 x 0.02 of the radius (0.02 px) for a strong lens. Brown's form is Owkes (2012)
    eq. 5.22; its eq. 6.2, ``x_I = (x' + s_x/2) N_x/s_x``, counts pixels from the corner: its pixel coordinates are
    ours + 0.5. DBAT prints the corner origin with y up. Its aspect stretches x' after the principal point has been
    subtracted, so the printed principal point counts pixels of the height ``pixel_mm`` in both axes: with that
    reading its published calibration gives back its sigma0 of 0.16148 px, with the other (width of a pixel in x)
    0.351 px.
    """

    sensor: Sensor
    values: FloatArray
    covariance: FloatArray = field(default_factory=lambda: np.zeros((_COUNT, _COUNT)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", float_array("sensor parameters", self.values, (_COUNT,)))
        positive("focal_mm", float(self.values[0]), "mm")
        stretch = self.sensor.stretch(self.values).real
        positive("1 + aspect (C1)", stretch + self.sensor.gain * float(self.values[8]), "one")
        covariance = covariance_matrix("sensor covariance", self.covariance, _COUNT)
        object.__setattr__(self, "covariance", covariance)

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations, shape (10,)."""
        return np.sqrt(np.diag(self.covariance))

    def camera(self) -> Camera:
        """Return the camera in pixels, with its covariance and its distortion in the same direction.

        InputError: Aspect or lens leave no positive focal length.
        """
        sensor = self.sensor
        values = np.real(sensor.to_camera_values(self.values))
        jacobian = sensor.derivatives(self.values)
        propagated = jacobian @ self.covariance @ jacobian.T
        lens = BrownDistortion(direction=sensor.direction)
        empty = Camera(sensor.width_px, sensor.height_px, 1.0, 1.0, 0.0, 0.0, distortion=lens)
        return empty.with_parameters(values).with_covariance(0.5 * (propagated + propagated.T))


def sensor_parameters(camera: Camera, sensor: Sensor) -> SensorParameters:
    """Return a camera's parameters in millimetres with their covariance.

    camera: The camera; its distortion must have the sensor's direction
        (`heliogauge.camera.conversion.convert_direction`).
    sensor: Pixel size and conventions.
    InputError: The distortion has the other direction.
    """
    if camera.distortion.direction is not sensor.direction:
        raise InputError(
            f"camera: its distortion is {camera.distortion.direction}, not {sensor.direction}; convert it first"
        )
    values = sensor.from_camera_values(camera.parameters)
    return SensorParameters(sensor, values, propagate_back(sensor.derivatives(values), camera.covariance))


def propagate_back(forward: FloatArray, covariance: FloatArray) -> FloatArray:
    """Carry a covariance through the inverse of a linear map.

    Shapes: covariance (n, n).
    forward (n, n): Derivative of the quantities whose covariance is known by the wanted ones.
    Returns (n, n): Covariance of the wanted quantities; exactly zero for those that only rounding moves, such as
        the ratio of two focal lengths that were estimated as one.
    """
    # Columns differ by ten powers of ten (K3 in mm^-6 against px): scale before inverting.
    scale = np.abs(forward).max(axis=0)
    inverse = np.linalg.inv(forward / scale) / scale[:, None]
    propagated = inverse @ covariance @ inverse.T
    propagated = 0.5 * (propagated + propagated.T)
    largest = np.einsum("ij,jk,ik->i", np.abs(inverse), np.abs(covariance), np.abs(inverse))
    # Sums of ten terms round to 1e-15 of the largest; a real variance that small would be a correlation of 1 - 1e-12.
    held = np.diag(propagated) <= 1e-12 * largest
    propagated[held] = 0.0
    propagated[:, held] = 0.0
    return _without_negative_variances(propagated)


def _without_negative_variances(covariance: FloatArray) -> FloatArray:
    """Set to zero what rounding made negative along directions that are nearly without variance.

    Camera constant and radial terms about a zero radius are correlated to 1 - 1e-9 and more in a job of its own.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
    if values.min() >= 0:
        return np.asarray(covariance)
    positive_part = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(0.5 * (positive_part + positive_part.T) * scale[:, None] * scale)
