"""Camera parameters as photogrammetry prints them: millimetres on the sensor, Brown from measured to ideal."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from heliogauge.camera import Camera
from heliogauge.distortion import BrownDistortion, DistortionDirection
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, covariance_matrix, float_array, positive

#: Order of the parameters in the covariance (as DBAT prints them).
PHOTOGRAMMETRIC_NAMES = ("focal_mm", "principal_x_mm", "principal_y_mm", "aspect", "K1", "K2", "K3", "P1", "P2")
#: Rows of a Camera's parameters in that sense: all but the skew.
_WITHOUT_SKEW = np.array([0, 1, 2, 3, 5, 6, 7, 8, 9])

#: Our camera frame (x right, y down, z forward) from the photogrammetric one (x right, y up, looking along -z):
#: ``cam_from_world = CAM_FROM_PHOTOGRAMMETRIC @ rotation_from_omega_phi_kappa(...)``.
CAM_FROM_PHOTOGRAMMETRIC: FloatArray = np.diag([1.0, -1.0, -1.0])
CAM_FROM_PHOTOGRAMMETRIC.setflags(write=False)


class PrincipalOrigin(StrEnum):
    """Where the principal point is counted from."""

    CORNER = "corner"
    CENTER = "center"


@dataclass(frozen=True, slots=True, eq=False)
class PhotogrammetricParameters:
    """Interior orientation in millimetres.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image [px].
    pixel_mm : float
        Height of a pixel [mm].
    focal_mm : float
        Camera constant [mm].
    principal_mm : array_like, shape (2,)
        Principal point: from the outer corner of the first pixel to the right and down, or from the sensor's centre to
        the right and up (down if not ``y_up``); both counted in units of ``pixel_mm``, see Notes [mm].
    radial : array_like, shape (3,)
        K1, K2, K3 [mm^-2, mm^-4, mm^-6].
    tangential : array_like, shape (2,)
        P1, P2; P1 goes with x [mm^-1].
    aspect : float
        A pixel is ``1 + aspect`` times as wide as it is high.
    principal_origin : PrincipalOrigin
        Where the principal point is counted from.
    y_up : bool
        Whether the distortion's y axis points up in the image (it decides the sign of P2).
    direction : DistortionDirection
        Way of the polynomial; MEASURED_TO_IDEAL in photogrammetry.
    covariance : array_like, shape (9, 9)
        Covariance of `PHOTOGRAMMETRIC_NAMES`; zeros say "treated as exact".

    Raises
    ------
    InputError
        A size that is not positive, a wrong shape, or no covariance matrix.

    Notes
    -----
    Owkes (2012) eq. 5.22, reduced by the principal point first: with measured x', y' [mm] and r^2 = x'^2 + y'^2,
    ``x = x' (1 + K1 r^2 + K2 r^4 + K3 r^6) + P1 (r^2 + 2 x'^2) + 2 P2 x' y'``, and for y with P1 and P2 exchanged.
    DBAT prints the corner origin with y up. Its aspect stretches x' after the principal point has been subtracted, so
    the printed principal point counts pixels of the height ``pixel_mm`` in both axes: with that reading its published
    calibration gives back its sigma0 of 0.16148 px, with the other (width of a pixel in x) 0.351 px.
    The equation (6.2) of the same thesis, ``x_I = (x' + s_x/2) N_x/s_x``, counts pixels from the corner: its pixel
    coordinates are ours + 0.5.
    """

    width_px: int
    height_px: int
    pixel_mm: float
    focal_mm: float
    principal_mm: FloatArray
    radial: FloatArray = field(default_factory=lambda: np.zeros(3))
    tangential: FloatArray = field(default_factory=lambda: np.zeros(2))
    aspect: float = 0.0
    principal_origin: PrincipalOrigin = PrincipalOrigin.CORNER
    y_up: bool = True
    direction: DistortionDirection = DistortionDirection.MEASURED_TO_IDEAL
    covariance: FloatArray = field(default_factory=lambda: np.zeros((9, 9)))

    def __post_init__(self) -> None:
        for name, unit in (("width_px", "pixels"), ("height_px", "pixels"), ("pixel_mm", "mm"), ("focal_mm", "mm")):
            positive(name, getattr(self, name), unit)
        positive("1 + aspect", 1 + self.aspect, "one")
        for name, size in (("principal_mm", 2), ("radial", 3), ("tangential", 2)):
            object.__setattr__(self, name, float_array(name, getattr(self, name), (size,)))
        for name, kind in (("principal_origin", PrincipalOrigin), ("direction", DistortionDirection)):
            try:
                object.__setattr__(self, name, kind(getattr(self, name)))
            except ValueError as error:
                raise InputError(f"{name}: one of {', '.join(kind)} is needed, not {getattr(self, name)!r}") from error
        covariance = covariance_matrix("photogrammetric covariance", self.covariance, 9)
        object.__setattr__(self, "covariance", covariance)


def from_photogrammetric(parameters: PhotogrammetricParameters) -> Camera:
    """Build a camera from photogrammetric parameters, exactly, with its covariance.

    Parameters
    ----------
    parameters : PhotogrammetricParameters
        Interior orientation in millimetres.

    Returns
    -------
    Camera
        The camera in pixels, with its distortion in the same direction.
    """
    focal, pixel = parameters.focal_mm, parameters.pixel_mm
    pixel_width = pixel * (1 + parameters.aspect)
    sign = -1.0 if parameters.y_up else 1.0
    origin_px, down = np.zeros(2), 1.0
    if parameters.principal_origin is PrincipalOrigin.CENTER:
        origin_px, down = np.array([parameters.width_px, parameters.height_px]) / 2, sign
    k1, k2, k3 = parameters.radial * focal ** np.array([2, 4, 6])
    p2, p1 = parameters.tangential * focal * [1.0, sign]
    jacobian = _camera_from_photogrammetric(parameters, down, sign)
    return Camera(
        parameters.width_px,
        parameters.height_px,
        focal / pixel_width,
        focal / pixel,
        origin_px[0] + parameters.principal_mm[0] / pixel - 0.5,
        origin_px[1] + down * parameters.principal_mm[1] / pixel - 0.5,
        distortion=BrownDistortion(k1=k1, k2=k2, k3=k3, p1=p1, p2=p2, direction=parameters.direction),
        covariance=_symmetric(jacobian @ parameters.covariance @ jacobian.T),
    )


def to_photogrammetric(
    camera: Camera,
    pixel_mm: float,
    *,
    principal_origin: PrincipalOrigin = PrincipalOrigin.CORNER,
    y_up: bool = True,
) -> PhotogrammetricParameters:
    """Return a camera's parameters in millimetres, exactly, with their covariance.

    Parameters
    ----------
    camera : Camera
        A camera without skew. Its distortion keeps its direction; where another program needs MEASURED_TO_IDEAL,
        convert with `heliogauge.camera_conversion.convert_direction` first.
    pixel_mm : float
        Height of a pixel [mm].
    principal_origin : PrincipalOrigin, optional
        Where the principal point is counted from.
    y_up : bool, optional
        Whether the distortion's y axis points up in the image.

    Returns
    -------
    PhotogrammetricParameters
        The same camera in millimetres.

    Raises
    ------
    InputError
        The camera has a skew, or the pixel has no size.
    """
    positive("pixel_mm", pixel_mm, "mm")
    if camera.skew or camera.covariance[4].any():
        raise InputError(f"camera: photogrammetric parameters have no skew, this camera's is {camera.skew:g} px")
    lens, focal = camera.distortion, camera.focal_y_px * pixel_mm
    aspect = camera.focal_y_px / camera.focal_x_px - 1
    sign = -1.0 if y_up else 1.0
    center = np.array([camera.center_x_px, camera.center_y_px]) + 0.5
    down = 1.0
    if principal_origin is PrincipalOrigin.CENTER:
        center, down = center - np.array([camera.width_px, camera.height_px]) / 2, sign
    exact = PhotogrammetricParameters(
        camera.width_px,
        camera.height_px,
        pixel_mm,
        focal,
        center * [pixel_mm, down * pixel_mm],
        np.array([lens.k1, lens.k2, lens.k3]) / focal ** np.array([2, 4, 6]),
        np.array([lens.p2, sign * lens.p1]) / focal,
        aspect=aspect,
        principal_origin=principal_origin,
        y_up=y_up,
        direction=lens.direction,
    )
    forward = _camera_from_photogrammetric(exact, down, sign)[_WITHOUT_SKEW]
    covariance = carried_back(forward, camera.covariance[np.ix_(_WITHOUT_SKEW, _WITHOUT_SKEW)])
    values = {name: getattr(exact, name) for name in PhotogrammetricParameters.__slots__}
    return PhotogrammetricParameters(**{**values, "covariance": covariance})


def _camera_from_photogrammetric(parameters: PhotogrammetricParameters, down: float, sign: float) -> FloatArray:
    """Return the derivative of the camera's parameters with respect to `PHOTOGRAMMETRIC_NAMES`, shape (10, 9)."""
    focal, pixel, widening = parameters.focal_mm, parameters.pixel_mm, 1 + parameters.aspect
    jacobian = np.zeros((10, 9))
    jacobian[0, 0], jacobian[0, 3] = 1 / (pixel * widening), -focal / (pixel * widening**2)
    jacobian[1, 0] = 1 / pixel
    jacobian[2, 1], jacobian[3, 2] = 1 / pixel, down / pixel
    for power, (row, column) in zip((2, 4, 6), ((5, 4), (6, 5), (9, 6)), strict=True):
        jacobian[row, column] = focal**power
        jacobian[row, 0] = power * parameters.radial[power // 2 - 1] * focal ** (power - 1)
    jacobian[8, 7], jacobian[8, 0] = focal, parameters.tangential[0]
    jacobian[7, 8], jacobian[7, 0] = sign * focal, sign * parameters.tangential[1]
    return jacobian


def carried_back(forward: FloatArray, covariance: FloatArray) -> FloatArray:
    """Carry a covariance through the inverse of a linear map.

    Parameters
    ----------
    forward : ndarray, shape (n, n)
        Derivative of the quantities whose covariance is known by the wanted ones.
    covariance : ndarray, shape (n, n)
        The known covariance.

    Returns
    -------
    ndarray, shape (n, n)
        Covariance of the wanted quantities; exactly zero for those that only rounding moves, such as the ratio of two
        focal lengths that were estimated as one.
    """
    # Columns differ by ten powers of ten (K3 in mm^-6 against px): scale before inverting.
    scale = np.abs(forward).max(axis=0)
    inverse = np.linalg.inv(forward / scale) / scale[:, None]
    carried = _symmetric(inverse @ covariance @ inverse.T)
    largest = np.einsum("ij,jk,ik->i", np.abs(inverse), np.abs(covariance), np.abs(inverse))
    # Sums of ten terms round to 1e-15 of the largest; a real variance that small would be a correlation of 1 - 1e-12.
    held = np.diag(carried) <= 1e-12 * largest
    carried[held] = 0.0
    carried[:, held] = 0.0
    return carried


def _symmetric(covariance: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (covariance + covariance.T))
