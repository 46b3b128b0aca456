"""A camera on the mirror that looks at the sun while the heliostat follows it (Stage-STE 12.6, 1.3.6.1).

The heliostat works as a sun tracker, and the sun's image ought to stay where it is. Its shifts are the tracking error
of the *normal*, for the camera turns with the mirror; no beam is reflected, so there is no factor of two.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray, float_array, freeze

__all__ = ["SunDisc", "sun_disc", "sun_shifts_rad"]

#: Levels between which a pixel passes from outside to inside the disc, as shares of its brightness: the limb is
#: blurred, and what is on the disc (limb darkening, overexposure) does not matter.
_LOW, _HIGH = 0.3, 0.7
_LEAST_PIXELS = 12


@dataclass(frozen=True, slots=True, eq=False)
class SunDisc:
    """The sun in a picture taken through a dark filter.

    center_px (2,): Column and row of its centre [px].
    sigma_px: Uncertainty of a coordinate by the noise beside the disc [px].
    radius_px: Radius of the circle of the same area [px].
    roundness: Minor over major axis: well below 1 where a cloud or the border cuts the disc.
    """

    center_px: FloatArray
    sigma_px: float
    radius_px: float
    roundness: float


def sun_disc(image_dn: npt.NDArray[np.generic]) -> SunDisc:
    """Find the sun's disc.

    Shapes: image_dn (h, w).
    Returns: Centre of the area above half the disc's brightness, radius, roundness.
    InputError: Not a grey picture.
    EstimationError: No bright disc, or it touches the border.
    """
    if image_dn.ndim != 2:
        raise InputError(f"image: shape (height, width) is needed, not {image_dn.shape}; make colours grey first")
    values = float_array("image_dn", image_dn, (None, None))
    dark = float(np.median(values))
    bright = float(np.quantile(values, 1 - _LEAST_PIXELS / values.size))
    beside = values[values < dark + 0.1 * (bright - dark)]
    noise = robust_scale(beside, centred=False) if beside.size else 0.0
    if bright - dark < max(10 * noise, 1e-9):
        raise EstimationError(f"no sun: the brightest pixels are {bright - dark:.1f} DN above the rest")
    # The level of the disc itself, not of its brightest pixels.
    bright = float(np.median(values[values > (dark + bright) / 2]))
    area = np.clip(((values - dark) / (bright - dark) - _LOW) / (_HIGH - _LOW), 0, 1)
    count, labels, statistics, _ = cv2.connectedComponentsWithStats((area > 0).astype(np.uint8), connectivity=8)
    sizes = np.where(np.arange(count) > 0, statistics[:, cv2.CC_STAT_AREA], 0)
    largest = int(np.argmax(sizes))
    if sizes[largest] < _LEAST_PIXELS:
        raise EstimationError(f"no sun: the largest bright spot has {int(sizes[largest])} pixels")
    area = np.where(labels == largest, area, 0.0)
    if area[[0, -1], :].any() or area[:, [0, -1]].any():
        raise EstimationError("the sun's disc touches the border of the picture")
    rows, columns = area.sum(axis=1), area.sum(axis=0)
    total = float(rows.sum())
    x, y = np.arange(columns.size), np.arange(rows.size)
    center = np.array([columns @ x, rows @ y]) / total
    cross = float((y - center[1]) @ area @ (x - center[0])) / total
    spread = np.array([[columns @ (x - center[0]) ** 2, 0.0], [0.0, rows @ (y - center[1]) ** 2]]) / total
    minor, major = np.linalg.eigvalsh(spread + [[0.0, cross], [cross, 0.0]])
    on_ramp = (area > 0) & (area < 1)
    arms = (x[None, :] - center[0]) ** 2 + (y[:, None] - center[1]) ** 2
    slope = noise / ((bright - dark) * (_HIGH - _LOW) * total)
    sigma = slope * float(np.sqrt(arms[on_ramp].sum() / 2))
    return SunDisc(freeze(center), sigma, float(np.sqrt(total / np.pi)), float(np.sqrt(minor / major)))


def sun_shifts_rad(camera: Camera, centers_px: npt.ArrayLike) -> FloatArray:
    """Return how far the camera's axis turned against the sun since the first picture.

    Shapes: centers_px (n, 2).
    Returns (n, 2): Shift of the sun's direction to the right and up in the picture: angles of the normal [rad].
    InputError: No pictures, or a place where the lens model is not one-to-one.
    """
    centers = float_array("centers_px", centers_px, (None, 2))
    if centers.shape[0] == 0:
        raise InputError("centers_px: at least one picture is needed")
    rays = camera.cast_rays(centers)
    if not np.isfinite(rays).all():
        raise InputError("centers_px: a place where the lens model is not one-to-one")
    angles = np.stack([np.arctan2(rays[:, 0], rays[:, 2]), -np.arctan2(rays[:, 1], rays[:, 2])], axis=1)
    return freeze(angles - angles[0])
