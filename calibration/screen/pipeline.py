"""Photographs of uniform grey levels to the response of camera and display: read, choose pixels, fit, write."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import numpy.typing as npt

from calibration.screen.keys import ResponseMeasurement
from calibration.screen.response import GreyStep, ScreenResponse, fit_response
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.images.photos import Frames, read_frames
from heliogauge.results.folder import Summary, hash_files, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import BoolArray, FloatArray

#: More saturated pixels than this among those used spoil a mean; fewer are hot pixels.
_SATURATED_SHARE = 1e-3
#: Pixels that carry the fit. The mean of so many is known to 0.003 DN at a noise of 1 DN.
_MOST_PIXELS = 100_000
#: One display seen through vignetting differs by up to 20 % between pixels; a region half beside it by 100 %.
_DOUBTFUL_SPREAD = 0.3


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    jobs: Threads that decode images; None for all processors.
    """

    jobs: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class GreyReadings:
    """What the camera read of each level.

    level (n,): Level shown, as a share of the display's range.
    mean_dn (n,): Mean reading of the pixels used [DN].
    is_saturated (n,): Left out of the fit.
    gain_spread: Standard deviation of the pixels' brightness, as a share of its mean.
    """

    level: FloatArray
    mean_dn: FloatArray
    is_saturated: BoolArray
    pixels: int
    gain_spread: float


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """The response and what it rests on.

    response: The look-up; levels as shares of the display's range.
    readings: Readings of all levels, also those left out.
    """

    kind: ClassVar[str] = "response"
    response: ScreenResponse
    readings: GreyReadings

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        response, readings = self.response, self.readings
        departure, sigma_departure = nonlinearity(response)
        at = int(np.argmax(np.abs(departure)))
        first, last, bent = (response.display_level[index] for index in (0, -1, at))
        sigma_dn = _sigma_dn(response)
        saturated = int(np.count_nonzero(readings.is_saturated))
        numbers = {
            "nonlinearity_share": float(departure[at]),
            "sigma_nonlinearity_share": float(sigma_departure[at]),
            "darkest_dn": float(response.camera_dn[0]),
            "sigma_darkest_dn": float(sigma_dn[0]),
            "brightest_dn": float(response.camera_dn[-1]),
            "sigma_brightest_dn": float(sigma_dn[-1]),
            "levels_count": readings.level.size,
            "used_levels_count": response.camera_dn.size,
            "saturated_levels_count": saturated,
            "joined_levels_count": readings.level.size - saturated - response.camera_dn.size,
            "pixels_count": readings.pixels,
            "brightness_spread_share": readings.gain_spread,
        }
        texts = {
            "nonlinearity": "largest departure of the reading from a straight line between the ends, as a share of the "
            f"readings' range; at level {bent:.3f} of the display's range",
            "range": f"levels {first:.3f} to {last:.3f} of the display's range",
            "joined": "levels that the camera cannot tell from the one below (within two sigma) are joined with it",
            "sigma": "1 standard deviation of a mean reading",
        }
        return self._summary(numbers, texts)

    def write_files(self, folder: Path) -> None:
        """Write response.csv and response.png into an existing folder."""
        from calibration.screen.figures import response_figure
        from heliogauge.reporting.canvas import png_of

        response = self.response
        columns = {"camera_dn": response.camera_dn, "display_level": response.display_level}
        write_table_csv(folder / "response.csv", {**columns, "sigma_camera_dn": _sigma_dn(response)})
        (folder / "response.png").write_bytes(png_of(response_figure(self)))

    def headline(self) -> str:
        """Return the headline numbers as lines for the terminal."""
        response, readings = self.response, self.readings
        departure, sigma = nonlinearity(response)
        at = int(np.argmax(np.abs(departure)))
        return "\n".join(
            (
                f"{self.name}: response of camera and display",
                f"  levels           {response.camera_dn.size} of {readings.level.size} used, "
                f"{np.count_nonzero(readings.is_saturated)} saturated",
                f"  readings         {response.camera_dn[0]:.2f} to {response.camera_dn[-1]:.2f} DN",
                f"  nonlinearity     {100 * departure[at]:+.1f} +- {100 * sigma[at]:.1g} % of the range, at level "
                f"{response.display_level[at]:.2f}",
                f"  pixels           {readings.pixels}, brightness spread {readings.gain_spread:.0%}",
            )
        )


def run(measurement: ResponseMeasurement, options: Options | None = None, progress: Progress | None = None) -> Result:
    """Fit the response of camera and display.

    Returns: The look-up with its sigma.
    InputError: Photographs that cannot be used, or a region outside them.
    EstimationError: Nothing brightens, too few steps that are not saturated, readings that fall while the level
        rises, or levels that the camera cannot tell apart.
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
            f"screen response: the camera tells only {response.camera_dn.size} of {good.size} levels apart; raise the "
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


def _sigma_dn(response: ScreenResponse) -> FloatArray:
    return response.sigma_camera_dn if response.sigma_camera_dn is not None else np.zeros(response.camera_dn.size)


def nonlinearity(response: ScreenResponse) -> tuple[FloatArray, FloatArray]:
    """Return how far the readings lie above the straight line between the ends.

    response: The look-up.
    Returns (n,): Departure and its standard deviation, as shares of the readings' range.
    """
    reading, level, sigma = response.camera_dn, response.display_level, _sigma_dn(response)
    reach = reading[-1] - reading[0]
    share = (reading - reading[0]) / reach
    line = (level - level[0]) / (level[-1] - level[0])
    # The reading itself and both ends of the line; at the ends all three cancel.
    own = sigma * ((share > 0) & (share < 1))
    ends = np.hypot((1 - share) * sigma[0], share * sigma[-1]) * ((share > 0) & (share < 1))
    return share - line, np.hypot(own, ends) / reach
