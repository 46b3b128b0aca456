"""Photographs of uniform grey levels to the response of camera and display: read, choose pixels, fit."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from calibration.screen.files import GreyReadings, Result
from calibration.screen.keys import ResponseMeasurement
from calibration.screen.response import GreyStep, fit_response
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.images.photos import Frames, read_frames
from heliogauge.results.folder import hash_files
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import BoolArray

#: More saturated pixels than this among those used spoil a mean; fewer are hot pixels.
_SATURATED_SHARE = 1e-3
#: Pixels that enter the fit. The mean of so many is known to 0.003 DN at a noise of 1 DN.
_MOST_PIXELS = 100_000
#: One display seen through vignetting differs by up to 20 % between pixels; a region half beside it by 100 %.
_DOUBTFUL_SPREAD = 0.3


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    jobs: Threads that decode images; None for all processors.
    """

    jobs: int | None = None


def run(measurement: ResponseMeasurement, options: Options | None = None, progress: Progress | None = None) -> Result:
    """Fit the response of camera and display.

    Returns: The look-up with its sigma.
    InputError: Photographs that cannot be used, or a region outside them.
    EstimationError: Nothing brightens, too few steps that are not saturated, readings that fall while the level
        rises, or levels that the camera does not separate.
    """
    options, progress = options or Options(), progress or SilentProgress()
    frames = read_frames(measurement.grey_files, jobs=options.jobs, progress=progress)
    with progress.stage("fit response"):
        result = _fit(measurement, frames)
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    return replace(result, durations_s=dict(progress.durations_s), input_sha256=hashes)


def _fit(measurement: ResponseMeasurement, frames: Frames) -> Result:
    section, display = measurement.model.images, measurement.model.display
    level = np.asarray(display.levels) / display.full_level
    if section.region_px is None:
        used = lit_pixels(frames.images_dn)
    else:
        used = _pixels_of_region(frames.images_dn.shape[1:], section.region_px)
    rows, columns = np.nonzero(used)
    every = -(-rows.size // _MOST_PIXELS)
    pixels = frames.images_dn[:, rows[::every], columns[::every]].astype(np.float64)
    saturation_dn = section.saturation_dn or float(frames.full_scale_dn)
    is_saturated = np.mean(pixels >= saturation_dn, axis=1) > _SATURATED_SHARE
    saturated = _check_saturation(is_saturated, measurement.grey_files, saturation_dn)
    good = np.flatnonzero(~is_saturated)
    response = fit_response([GreyStep(float(level[index]), pixels[index]) for index in good])
    if 2 * response.camera_dn.size < good.size:
        # Noise alone brightens in some pixels: chosen for that, they show a rise from the first to the last level.
        raise EstimationError(
            f"screen response: the camera separates only {response.camera_dn.size} of {good.size} levels; raise the "
            "exposure, or give the pixels that see the display as images.region_px"
        )
    brightness = pixels[good[-1]] - pixels[good[0]]
    readings = GreyReadings(
        level, pixels.mean(axis=1), is_saturated, pixels.shape[1], float(brightness.std() / brightness.mean())
    )
    uneven = None
    if readings.gain_spread > _DOUBTFUL_SPREAD:
        uneven = Doubt(
            "pixels_differ_in_brightness",
            f"the pixels used differ in brightness by {readings.gain_spread:.0%} (standard deviation): some may not "
            "see the display; narrow images.region_px",
            {"brightness_spread_share": readings.gain_spread},
        )
    doubts = gather_doubts(frames.doubts, saturated, uneven)
    return Result(response, readings, name=measurement.model.name, doubts=doubts)


def lit_pixels(images_dn: npt.NDArray[Any]) -> BoolArray:
    """Find the pixels that see the display: those that brighten by at least half of what the brightest do.

    Shapes: result (height, width).
    images_dn (n, height, width): Photographs, dark to bright [DN].
    EstimationError: No pixel brightens.
    """
    # The median of 5 x 5 pixels takes out hot pixels and glints, so that "the brightest" is an area.
    rise = cv2.medianBlur(images_dn[-1].astype(np.float32) - images_dn[0].astype(np.float32), 5)
    most = float(rise.max())
    if not most > 0:
        raise EstimationError(
            "screen response: no pixel is brighter in the last photograph than in the first; check that the camera "
            "sees the display and that the photographs go from dark to bright"
        )
    return np.asarray(rise >= 0.5 * most)


def _pixels_of_region(shape: tuple[int, ...], region_px: tuple[int, int, int, int]) -> BoolArray:
    x_first, y_first, x_last, y_last = region_px
    height, width = shape
    if x_last >= width or y_last >= height:
        raise InputError(
            f"images.region_px = {list(region_px)}: the photographs have {width} x {height} px, so the last pixel is "
            f"({width - 1}, {height - 1})"
        )
    chosen = np.zeros(shape, dtype=bool)
    chosen[y_first : y_last + 1, x_first : x_last + 1] = True
    return chosen


def _check_saturation(is_saturated: BoolArray, files: tuple[Path, ...], saturation_dn: float) -> Doubt | None:
    """Return a doubt that names the saturated steps; refuse when too few are left."""
    if not is_saturated.any():
        return None
    names = [file.name for file, dropped in zip(files, is_saturated, strict=True) if dropped]
    listed = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
    left = len(files) - len(names)
    if left < 3:
        raise EstimationError(
            f"screen response: {left} of {len(files)} grey steps are not saturated ({listed} reach {saturation_dn:g} "
            "DN), 3 are needed; shorten the exposure or close the aperture, for the fringes too"
        )
    return Doubt(
        "grey_steps_saturated",
        f"{len(names)} of {len(files)} grey steps are saturated (pixels at {saturation_dn:g} DN) and left out: "
        f"{listed}; fringes must not use these levels: shorten the exposure",
        {"saturated_count": len(names), "steps_count": len(files), "saturation_dn": saturation_dn},
    )
