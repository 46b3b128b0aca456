"""Camera parameters of other programs: OpenCV, COLMAP and photogrammetry in millimetres, in and out."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from heliogauge.camera import Camera
from heliogauge.distortion import BrownDistortion, DistortionDirection
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, float_array


def from_opencv(matrix: npt.ArrayLike, distortion: npt.ArrayLike | None, image_size: Sequence[int]) -> Camera:
    """Build a camera from OpenCV's parameters.

    Parameters
    ----------
    matrix : array_like, shape (3, 3)
        Camera matrix [px].
    distortion : array_like, shape (0,), (4,), (5,), (8,), (12,) or (14,), or None
        Coefficients k1, k2, p1, p2, k3, ...; those after k3 must be zero.
    image_size : sequence of int, length 2
        Width and height [px].

    Returns
    -------
    Camera
        The camera; covariance zero.

    Raises
    ------
    InputError
        A matrix that is no camera matrix, or coefficients outside Brown's model.
    """
    k = float_array("OpenCV camera matrix", matrix, (3, 3))
    if k[1, 0] or k[2, 0] or k[2, 1] or k[2, 2] != 1:
        raise InputError("OpenCV camera matrix: [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] is needed")
    c = np.zeros(0) if distortion is None else np.asarray(distortion, dtype=np.float64).ravel()
    c = float_array("OpenCV distortion", c, (None,))
    if c.size not in (0, 4, 5, 8, 12, 14):
        raise InputError(f"OpenCV distortion: 0, 4, 5, 8, 12 or 14 coefficients are needed, not {c.size}")
    if c[5:].any():
        raise InputError("OpenCV distortion: the rational, thin-prism and tilted terms (after k3) must be zero")
    k1, k2, p1, p2, k3 = np.pad(c[:5], (0, max(0, 5 - c.size))).tolist()
    lens = BrownDistortion(k1=k1, k2=k2, k3=k3, p1=p1, p2=p2, direction=DistortionDirection.IDEAL_TO_MEASURED)
    width, height = image_size
    return Camera(width, height, k[0, 0], k[1, 1], k[0, 2], k[1, 2], skew=k[0, 1], distortion=lens)


def to_opencv(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return OpenCV's camera matrix, shape (3, 3), and coefficients k1, k2, p1, p2, k3, shape (5,).

    Parameters
    ----------
    camera : Camera
        A camera whose polynomial goes from ideal to measured.

    Returns
    -------
    tuple of ndarray
        Matrix and coefficients.

    Raises
    ------
    InputError
        The other direction, or a skew.
    """
    if not camera.distortion.is_zero and not camera.distortion.distorts_in_closed_form:
        raise InputError("camera: OpenCV's model goes from ideal to measured; convert first and look at the residual")
    return camera.matrix, camera.distortion.coefficients
