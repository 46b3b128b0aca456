"""What backward gazing gave: its files, its summary, its lines on the terminal."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from deflectometry.gazing.sun_profile import SunImage
from deflectometry.pipeline.headline import Numbers, headline_text, reasons
from deflectometry.pipeline.result import write_canting
from deflectometry.shape.facet_canting import CANTING_SIGN, FacetCanting
from heliogauge.geometry.surfaces import Facet
from heliogauge.reporting.notation import number_text
from heliogauge.results.facet_frames import facet_geometry
from heliogauge.results.folder import Summary, write_slope_map, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import ASSEMBLED
from heliogauge.results.sun_tables import write_sun
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray

#: Tables of a result.
CAMERAS_FILE, PROFILE_FILE = "gazing_cameras.csv", "sun_profile.csv"


@dataclass(frozen=True, slots=True, eq=False)
class Pointing:
    """How the mirror's mean normal leans against the nominal one.

    angle_rad, sigma_rad (2,): Mean slope errors in x and y.
    modes (k, 2): What each common source does to them.
    """

    angle_rad: FloatArray
    sigma_rad: FloatArray
    modes: FloatArray

    def numbers(self) -> Numbers:
        """Return both as headline numbers."""
        numbers: Numbers = {}
        for axis, angle, sigma in zip("xy", self.angle_rad.tolist(), self.sigma_rad.tolist(), strict=True):
            numbers |= {f"pointing_{axis}_rad": angle, f"sigma_pointing_{axis}_rad": sigma}
        return numbers


def pointing_line(numbers: Numbers) -> str:
    """Return the pointing as a line for the terminal."""
    said = []
    for axis in "xy":
        value, sigma = (numbers[f"{prefix}pointing_{axis}_rad"] for prefix in ("", "sigma_"))
        said.append(f"{axis} {number_text(float(value or 0.0), sigma, 'rad')}")
    return f"  pointing         {'   '.join(said)}"


@dataclass(frozen=True, slots=True, eq=False)
class CameraRow:
    """How one camera's brightness fits.

    eye_m (3,): Its place in the mirror's frame.
    gain, sigma_gain: What it sees over what it should.
    misfit: RMS of its residuals over their sigmas.
    residual_px: RMS of its points of the mirror.
    reason: Why it is left out; empty where it is not.
    """

    name: str
    eye_m: FloatArray
    gain: float
    sigma_gain: float
    misfit: float
    residual_px: float
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class GazingResult(InstrumentResult):
    """The slope map of a heliostat by backward gazing.

    facets: All facets of the mirror.
    maps: The map of each measured facet, after what was to be removed.
    assembled: The map of the whole mirror.
    numbers, facet_numbers: Headline numbers of the mirror and of each facet.
    cantings: Of each facet; empty for a mirror of one.
    sun: The sun's profile.
    cameras: How each camera's brightness fits.
    sun_direction (3,): In the mirror's frame.
    """

    kind: ClassVar[str] = "backward-gazing"
    facets: tuple[Facet, ...]
    maps: Mapping[str, SlopeMap]
    assembled: SlopeMap
    numbers: Numbers
    facet_numbers: Mapping[str, Numbers]
    cantings: tuple[FacetCanting, ...]
    sun: SunImage
    cameras: tuple[CameraRow, ...]
    sun_direction: FloatArray

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        used = [one for one in self.cameras if not one.reason]
        numbers = self.numbers | {
            "cameras_count": len(used),
            "sun_radius_rad": self.sun.profile.radius_rad,
            "brightness_misfit_ratio": float(np.sqrt(np.mean([one.misfit**2 for one in used]))),
        }
        texts = {
            "design": self.assembled.design,
            "removed": self.assembled.removed,
            "frame": self.assembled.frame,
            "pointing": "mean slope error against the normal that aims the sun as stated, before alignment",
            "sigma": "1 standard deviation; slopes are those of the normal, a beam turns by twice as much",
        }
        if self.cantings:
            texts["canting"] = CANTING_SIGN
        return self._summary(
            numbers,
            texts,
            reasons(numbers, self.facet_numbers),
            facets=self.facet_numbers,
            geometry_m={
                **facet_geometry(self.facets),
                "cameras": [one.eye_m.tolist() for one in self.cameras],
                "sun": self.sun_direction.tolist(),
            },
        )

    def write_files(self, folder: Path) -> None:
        """Write maps, canting, cameras and the sun's profile into an existing folder."""
        maps = dict(self.maps)
        if len(self.facets) > 1:
            maps[ASSEMBLED] = self.assembled
        write_slope_map(folder / "slope_map.nc", maps, {"name": self.name, "input_sha256": self.input_sha256})
        write_canting(folder, self.cantings)
        write_table_csv(
            folder / CAMERAS_FILE,
            {
                "camera": [one.name for one in self.cameras],
                "x_m": [float(one.eye_m[0]) for one in self.cameras],
                "y_m": [float(one.eye_m[1]) for one in self.cameras],
                "z_m": [float(one.eye_m[2]) for one in self.cameras],
                "gain": [one.gain for one in self.cameras],
                "sigma_gain": [one.sigma_gain for one in self.cameras],
                "misfit_over_sigma": [one.misfit for one in self.cameras],
                "points_residual_px": [one.residual_px for one in self.cameras],
                "reason": [one.reason for one in self.cameras],
            },
        )
        write_sun(folder / PROFILE_FILE, self.sun.profile.angle_rad, self.sun.profile.relative)

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return f"{headline_text(self.summarise())}\n{pointing_line(self.numbers)}"
