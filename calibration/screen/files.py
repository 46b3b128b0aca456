"""The response of camera and display and what it rests on: summary, files, lines for the terminal."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from calibration.screen.response import ScreenResponse
from heliogauge.results.folder import Summary, read_columns_csv, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.validate import BoolArray, FloatArray

RESPONSE_FILE = "response.csv"
_READINGS_FILE = "readings.csv"


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
            "joined": "levels whose reading is within two sigma of the one below are joined with it",
            "sigma": "1 standard deviation of a mean reading",
        }
        return self._summary(numbers, texts)

    def write_files(self, folder: Path) -> None:
        """Write response.csv and readings.csv into an existing folder."""
        response, readings = self.response, self.readings
        columns = {"camera_dn": response.camera_dn, "display_level": response.display_level}
        write_table_csv(folder / RESPONSE_FILE, {**columns, "sigma_camera_dn": _sigma_dn(response)})
        every = {"display_level": readings.level, "mean_dn": readings.mean_dn}
        write_table_csv(folder / _READINGS_FILE, {**every, "saturated": readings.is_saturated.astype(int)})

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


def _sigma_dn(response: ScreenResponse) -> FloatArray:
    return response.sigma_camera_dn if response.sigma_camera_dn is not None else np.zeros(response.camera_dn.size)


def read_response(folder: Path) -> ScreenResponse:
    """Read the response from a folder of results."""
    names = ("camera_dn", "display_level", "sigma_camera_dn")
    _, numbers = read_columns_csv(folder / RESPONSE_FILE, (), names)
    camera_dn, level, sigma = (numbers[name] for name in names)
    return ScreenResponse(camera_dn=camera_dn, display_level=level, sigma_camera_dn=sigma)


def read_readings(folder: Path, summary: Summary) -> GreyReadings:
    """Read what the camera read of each level from a folder of results.

    summary: Gives the number of pixels.
    """
    names = ("display_level", "mean_dn", "saturated")
    _, numbers = read_columns_csv(folder / _READINGS_FILE, (), names)
    pixels, spread = (summary.numbers.get(key) or 0 for key in ("pixels_count", "brightness_spread_share"))
    return GreyReadings(
        numbers["display_level"], numbers["mean_dn"], numbers["saturated"] > 0, int(pixels), float(spread)
    )
