"""Camera parameters of OpenCV and COLMAP, in and out."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, float_array

#: COLMAP's models that are special cases of Brown's, smallest first, with their parameters in COLMAP's order.
COLMAP_MODELS: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
#: COLMAP puts the origin at the corner of the first pixel.
_COLMAP_ORIGIN_PX = 0.5


def from_opencv(matrix: npt.ArrayLike, distortion: npt.ArrayLike | None, image_size: Sequence[int]) -> Camera:
    """Build a camera from OpenCV's parameters.

    Shapes: matrix (3, 3).
    distortion: Coefficients k1, k2, p1, p2, k3, ...; those after k3 must be zero.
    image_size length 2: Width and height [px].
    Returns: The camera; covariance zero. Element [0, 1] of the matrix becomes the skew (OpenCV's own functions
        ignore it).
    InputError: A matrix that is no camera matrix, or coefficients outside Brown's model.
    """
    k = float_array("OpenCV camera matrix", matrix, (3, 3))
    if k[1, 0] or k[2, 0] or k[2, 1] or k[2, 2] != 1:
        raise InputError("OpenCV camera matrix: [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] is needed")
    c = float_array("OpenCV distortion", np.ravel(() if distortion is None else np.asarray(distortion)), (None,))
    if c.size not in (0, 4, 5, 8, 12, 14):
        raise InputError(f"OpenCV distortion: 0, 4, 5, 8, 12 or 14 coefficients are needed, not {c.size}")
    if c[5:].any():
        raise InputError(
            "OpenCV distortion: rational, thin-prism or tilted terms are not part of Brown's model; "
            "calibrate again with k1, k2, p1, p2, k3 only"
        )
    if len(image_size) != 2:
        raise InputError(f"image size: width and height are needed, not {image_size!r}")
    k1, k2, p1, p2, k3 = np.pad(c[:5], (0, max(0, 5 - c.size))).tolist()
    lens = BrownDistortion(k1=k1, k2=k2, k3=k3, p1=p1, p2=p2)
    return Camera(image_size[0], image_size[1], k[0, 0], k[1, 1], k[0, 2], k[1, 2], skew=k[0, 1], distortion=lens)


def to_opencv(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return OpenCV's parameters of a camera.

    Shapes: matrix (3, 3).
    camera: A camera without skew whose polynomial goes from ideal to measured.
    distortion (5,): Coefficients k1, k2, p1, p2, k3.
    InputError: The other direction, or a skew.
    """
    _require_forward(camera, "OpenCV")
    return camera.matrix, camera.distortion.coefficients


def from_colmap(model: str, parameters: npt.ArrayLike, width_px: int, height_px: int) -> Camera:
    """Build a camera from COLMAP's parameters, taking its pixel origin (corner) to ours (centre of the first pixel).

    parameters (n,): The model's parameters in COLMAP's order.
    width_px, height_px: Size of the image [px].
    InputError: Another model, another number of parameters, or a denominator (k4, k5, k6) that is not zero.
    """
    if model not in COLMAP_MODELS:
        known = ", ".join(COLMAP_MODELS)
        raise InputError(f"COLMAP camera model {model!r}: not part of Brown's model; use one of {known}")
    names = COLMAP_MODELS[model]
    values = float_array(f"COLMAP parameters of {model} ({', '.join(names)})", parameters, (len(names),))
    named = dict(zip(names, values.tolist(), strict=True))
    if any(named.get(name, 0.0) for name in ("k4", "k5", "k6")):
        raise InputError(
            "COLMAP camera model FULL_OPENCV: k4, k5 and k6 must be zero, a rational model is not supported"
        )
    lens = BrownDistortion(**{name: named.get(name, 0.0) for name in ("k1", "k2", "k3", "p1", "p2")})
    focal_x, focal_y = (named["f"], named["f"]) if "f" in named else (named["fx"], named["fy"])
    center_x, center_y = named["cx"] - _COLMAP_ORIGIN_PX, named["cy"] - _COLMAP_ORIGIN_PX
    return Camera(width_px, height_px, focal_x, focal_y, center_x, center_y, distortion=lens)


def to_colmap(camera: Camera) -> tuple[str, FloatArray]:
    """Return the smallest COLMAP model that holds a camera exactly.

    camera: A camera without skew whose polynomial goes from ideal to measured.
    parameters (n,): The model's parameters in COLMAP's order.
    InputError: The other direction, or a skew.
    """
    _require_forward(camera, "COLMAP")
    lens = camera.distortion
    named = {
        "f": camera.focal_x_px,
        "fx": camera.focal_x_px,
        "fy": camera.focal_y_px,
        "cx": camera.center_x_px + _COLMAP_ORIGIN_PX,
        "cy": camera.center_y_px + _COLMAP_ORIGIN_PX,
        **lens.polynomial._asdict(),
        **dict.fromkeys(("k4", "k5", "k6"), 0.0),
    }
    needed = {name for name, value in lens.polynomial._asdict().items() if value}
    if camera.focal_x_px != camera.focal_y_px:
        needed.add("fy")
    model = next(name for name, held in COLMAP_MODELS.items() if needed <= set(held))
    return model, np.array([named[name] for name in COLMAP_MODELS[model]])


def _require_forward(camera: Camera, program: str) -> None:
    if not (camera.distortion.is_zero or camera.distortion.distorts_in_closed_form):
        raise InputError(
            f"camera: {program} distorts with the polynomial, this lens corrects with it; "
            "use heliogauge.camera.conversion.convert_direction first and mind the residual it reports"
        )
    if camera.skew:
        raise InputError(f"camera: {program} has no skew, this camera's is {camera.skew:g} px")
