"""What image files show before any phase is computed: their size, where they saturate, what compression did to them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.fringes.phase import solve_steps
from deflectometry.setup.patterns import FringePattern
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError

#: Largest readings of cameras with 10, 12 and 14 bits, as they are or moved to the upper end of 16 bits [DN].
_FULL_WELLS_DN = frozenset(((1 << bits) - 1) << shift for bits in (10, 12, 14) for shift in (0, 16 - bits))
#: A stated noise this many times off what the frames show is a mistake; half of it is a doubt.
_NOISE_FACTOR = 4.0


def check_size(size_px: Sequence[int], camera: Camera, place: str) -> None:
    """Refuse images that are not the camera's.

    size_px: Width and height of the images [px].
    InputError: Another size than the camera's.
    """
    width, height = size_px
    if (width, height) != (camera.width_px, camera.height_px):
        raise InputError(
            f"{place}: the images have {width} x {height} px, but [camera] is for {camera.width_px} x "
            f"{camera.height_px} px; give the camera of these images, or images that were not cut, turned or scaled"
        )


def saturation_level(frames: npt.NDArray[Any], full_scale_dn: float) -> float:
    """Return the reading at which a camera saturates.

    Shapes: frames (n, h, w).
    full_scale_dn: Largest value of the files [DN].
    Returns: The largest reading if it is the full well of a camera with 10, 12 or 14 bits, else the largest value
        [DN]. Frames that do not saturate lose at most the few pixels that reach that very number.
    """
    top = float(frames.max())
    return top if full_scale_dn > 255 and top in _FULL_WELLS_DN else full_scale_dn


def check_compression(names: Sequence[str]) -> Doubt | None:
    """Return a doubt where images lost details when they were stored: where at least one is a JPEG."""
    lossy = [name for name in names if name.lower().endswith((".jpg", ".jpeg"))]
    if not lossy:
        return None
    return Doubt(
        "fringe_images_compressed",
        f"{len(lossy)} of {len(names)} fringe images are JPEG files ({lossy[0]}, ...): their compression changes "
        "the phase in blocks of 8 x 8 px, which sigma does not contain; store PNG or TIFF",
        {"jpeg_count": len(lossy), "images_count": len(names)},
    )


def check_noise(frames: npt.NDArray[Any], pattern: FringePattern, noise: NoiseModel) -> Doubt | None:
    """Compare a stated noise with the scatter of the frames about their sinusoids.

    Shapes: frames (n, h, w).
    pattern: What was shown.
    Returns: A doubt where it is less than half, or more than twice of it.
    EstimationError: Less than a quarter of what the frames show, or more than 16 times as much.
    """
    step = max(1, int(np.sqrt(frames.shape[1] * frames.shape[2] / 20000)))
    readings = frames[:, ::step, ::step].reshape(len(frames), -1).astype(np.float64)
    left, freedom = np.zeros(readings.shape[1]), 0
    for fringes, position in zip(pattern.sets, pattern.frame_slices, strict=True):
        solver = solve_steps(fringes.steps_rad)
        left += ((solver.residual @ readings[position]) ** 2).sum(axis=0)
        freedom += solver.redundancy
    if freedom == 0:
        return None
    # Without fringes a pixel has the noise of darkness; the median pixel that has some stands for the mirror.
    spread = readings.std(axis=0)
    on_mirror = spread > 0.3 * np.quantile(spread, 0.99)
    seen_dn = float(np.sqrt(np.median(left[on_mirror]) / freedom)) if on_mirror.any() else float("nan")
    stated_dn = float(noise.sigma_read_dn)
    ratio = stated_dn / max(seen_dn, 0.29)
    if not 1 / _NOISE_FACTOR < ratio < 4 * _NOISE_FACTOR:
        raise EstimationError(
            f"images.pixel_noise_dn = {stated_dn:g}, but the readings scatter by {seen_dn:.2g} DN about their "
            "sinusoids; leave the key out to take the noise from the frames, or check the linearity of the display"
        )
    if 2 / _NOISE_FACTOR < ratio < _NOISE_FACTOR / 2:
        return None
    return Doubt(
        "stated_noise_contradicts_frames",
        f"images.pixel_noise_dn = {stated_dn:g}, but the readings scatter by {seen_dn:.2g} DN about their "
        "sinusoids; all sigmas follow the stated number",
        {"stated_noise_dn": stated_dn, "seen_noise_dn": seen_dn},
    )
