"""What measurement.toml of ``kind = "stars"`` may say."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from deflectometry.field.keys import FieldCameraSection, HeliostatSection
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import MeasurementModel, Names, Number, Positive, Section, Sigma, Text


class SiteSection(Section):
    """Where the heliostat stands on earth, and the air."""

    latitude_deg: Number = Field(ge=-90, le=90, description="Geodetic latitude, north positive [deg].")
    longitude_deg: Number = Field(ge=-180, le=360, description="Longitude, east positive [deg].")
    altitude_m: Number = Field(0.0, description="Height above sea level [m].")
    pressure_hpa: Positive | None = Field(
        None, description="Air pressure at the site; default: the standard atmosphere's there [hPa]."
    )
    temperature_c: Number = Field(12.0, description="Temperature of the air [Celsius].")


class NightPhotoSection(Section):
    """One photo of the heliostat at night."""

    file: Text = Field(description="The photo.")
    time: Text = Field(
        description="When the exposure began, ISO 8601 with its zone: 2026-03-14T21:30:00.0Z or ...+01:00."
    )
    exposure_s: Positive = Field(description="Exposure time: stars count at its middle [s].")

    @field_validator("time")
    @classmethod
    def _has_zone(cls, time: str) -> str:
        try:
            moment = datetime.fromisoformat(time.strip())
        except ValueError:
            raise ValueError("not an ISO 8601 time such as 2026-03-14T21:30:00Z") from None
        if moment.utcoffset() is None:
            raise ValueError(
                "says no zone; append Z for UTC or an offset such as +01:00 (stars turn by 15 deg an hour)"
            )
        return time


class StarsEvaluationSection(Section):
    """Choices of the evaluation; the command line can override them."""

    align: Literal["normal", "outline"] = Field(
        "normal", description="Slopes refer to the mirror's own mean normal, or to the nominal one (outline)."
    )
    grid_step_mm: Positive | None = Field(None, description="Step of the maps; default: 40 nodes a facet [mm].")
    remove: Literal["nothing", "tilt", "focus", "quadratic"] = Field(
        "nothing", description="What is taken out of the maps and headline numbers."
    )
    sigma_normal_mrad: Positive = Field(
        10.0, description="How well the nominal normal of the whole mirror is known, each way [mrad]."
    )
    sigma_canting_mrad: Positive = Field(
        3.0, description="Canting errors of facets that are expected, one standard deviation [mrad]."
    )
    sigma_bow_mrad_per_m: Positive = Field(
        0.3, description="Departures of a facet's curvatures from the design's that are expected [mrad/m]."
    )
    faintest_magnitude: Number = Field(9.0, description="Faintest stars of the catalogue that are looked for.")
    sigma_time_s: Sigma = Field(1.0, description="Standard deviation of the times; UT1 - UTC alone is up to 0.9 s [s].")


class StarsPlanSection(Section):
    """What `heliogauge deflectometry plan` compares; measuring does not read it."""

    times: Names = Field(
        (),
        description="When a photo might be taken, ISO 8601 with zone; default: every half hour with the sun 12 degrees "
        "and more below the horizon, of the night of the first photo's time.",
    )
    sigma_faintest_px: Positive = Field(
        0.1,
        description="Each image coordinate of a star of faintest_magnitude, one standard deviation; brighter ones are "
        "better by the root of their light [px].",
    )


class StarsModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "stars"``."""

    kind: Literal["stars"] = Field(description="Stars seen in the facets of a heliostat.")
    site: SiteSection = Field(description="Where on earth it is.")
    camera: FieldCameraSection = Field(description="The camera, which stood still.")
    photo: Annotated[tuple[NightPhotoSection, ...], Field(min_length=1)] = Field(
        description="The photos, a table each; those of one night are adjusted together."
    )
    mirror: HeliostatSection = Field(description="The heliostat; it stood still.")
    evaluation: StarsEvaluationSection = Field(StarsEvaluationSection(), description="Choices of the evaluation.")
    plan: StarsPlanSection = Field(StarsPlanSection(), description="What a plan compares.")

    @model_validator(mode="after")
    def _no_sun(self) -> Self:
        if self.mirror.normal is None:
            raise ValueError("mirror.normal is needed: at night no sun is aimed")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class StarsMeasurement:
    """A checked measurement by stars: the content of measurement.toml, and where its files are."""

    folder: Path
    model: StarsModel

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        photos = tuple(self.folder / one.file for one in self.model.photo)
        return (*self.files_before, *photos)

    @property
    def files_before(self) -> tuple[Path, ...]:
        """Those that are there before any photo is taken, measurement.toml first."""
        camera = getattr(self.model.camera.camera, "file", None)
        return (self.folder / MEASUREMENT_FILE, *(() if camera is None else (self.folder / camera,)))


def load_stars(folder: Path) -> StarsMeasurement:
    """Read and check the folder of a measurement by stars.

    Returns: The measurement; its photos exist.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    found = load_stars_plan(folder)
    refuse_missing(folder / MEASUREMENT_FILE, found.input_files)
    return found


def load_stars_plan(folder: Path) -> StarsMeasurement:
    """Read and check the folder of a measurement by stars whose photos need not be there yet.

    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, StarsModel)
    found = StarsMeasurement(folder, model)
    refuse_missing(file, found.files_before)
    return found
