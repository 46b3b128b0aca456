"""Pictures of beams with a known place, drawn here: Gaussian, flat-topped and round beams on a target with panels."""

import numpy as np
import numpy.typing as npt

from calibration.beam.target.view import TargetImage, whole_image

#: Corners of a target of 8 m x 7 m.
CORNERS_M = np.array([[-4.0, 3.5], [4.0, 3.5], [4.0, -3.5], [-4.0, -3.5]])


def grid_m(shape: tuple[int, int] = (224, 256)) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Places of the pixels' centres, each of shape (h, w) [m]."""
    rows, columns = shape
    x = -4 + (np.arange(columns) + 0.5) * (8 / columns)
    y = 3.5 - (np.arange(rows) + 0.5) * (7 / rows)
    return np.broadcast_to(x, shape).copy(), np.broadcast_to(y[:, None], shape).copy()


def gaussian(
    center_m: tuple[float, float],
    widths_m: tuple[float, float] = (0.9, 0.5),
    direction_rad: float = 0.6,
    *,
    shape: tuple[int, int] = (224, 256),
    exponent: float = 1.0,
) -> npt.NDArray[np.float64]:
    """An elliptic (super-)Gaussian of height 1."""
    x, y = grid_m(shape)
    dx, dy = x - center_m[0], y - center_m[1]
    along = np.cos(direction_rad) * dx + np.sin(direction_rad) * dy
    across = -np.sin(direction_rad) * dx + np.cos(direction_rad) * dy
    form = (along / widths_m[0]) ** 2 + (across / widths_m[1]) ** 2
    return np.asarray(np.exp(-0.5 * form**exponent))


def sky_light(shape: tuple[int, int] = (224, 256)) -> npt.NDArray[np.float64]:
    """Brightness of a plain target: a slope and a little bend [DN]."""
    x, y = grid_m(shape)
    return np.asarray(80 + 2.0 * x + 3.0 * y - 0.3 * x * y + 0.2 * y**2)


def picture(
    values_dn: npt.NDArray[np.float64], *, noise_dn: float = 0.0, seed: int = 0, bits: int | None = 8
) -> TargetImage:
    """A picture with noise, in whole grey values (8 or 16 bit) or exact (None)."""
    noisy = values_dn + noise_dn * np.random.default_rng(seed).standard_normal(values_dn.shape)
    if bits is None:
        return whole_image(noisy, CORNERS_M)
    full = 2**bits - 1
    whole = np.clip(np.rint(noisy), 0, full).astype(np.uint8 if bits == 8 else np.uint16)
    return whole_image(whole, CORNERS_M)
