"""Keys of measurement.toml of ``kind = "heliostat-tests"``: a section for each test of one heliostat."""

import datetime
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

from pydantic import Field, model_validator

from calibration.heliostat.keys import SiteSection
from heliogauge.errors import InputError
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import (
    Count,
    MeasurementModel,
    Number,
    Positive,
    Section,
    Sigma,
    Text,
    Vector2,
    Vector3,
)

TestName = Literal[
    "day",
    "drift",
    "backlash",
    "repeat",
    "wind",
    "sun_camera",
    "reflectance",
    "quality",
    "control",
    "power",
    "given",
    "year",
]
TESTS: tuple[TestName, ...] = get_args(TestName)
Files = Text | Annotated[tuple[Text, ...], Field(min_length=1)]


class LaboratorySection(Section):
    """Who measured; stands at the head of the data sheet."""

    laboratory: str = Field("", description="Name and address of the laboratory.")
    operator: str = Field("", description="Who measured.")
    approved_by: str = Field("", description="Who signs the data sheet.")
    order: str = Field("", description="Number of the order or of the report.")
    conditions: str = Field("", description="Conditions that hold for all tests, such as sky and temperature.")


class HeliostatSection(Section):
    """The heliostat: where it stands, and what the data sheet says of it (Stage-STE 12.6, 1.4.1)."""

    position_m: Vector3 = Field(description="Middle of the mirror: east, north, up [m].")
    manufacturer: str = Field("", description="Who makes it.")
    model: str = Field("", description="Name of the model.")
    year: Count | None = Field(None, description="Year of make.")
    width_m: Positive | None = Field(None, description="Width of the mirror [m].")
    height_m: Positive | None = Field(None, description="Height of the mirror [m].")
    facets: Count | None = Field(None, description="Number of facets.")
    focal_length_m: Positive | None = Field(None, description="Focal length; default: the distance of the aim [m].")
    drive: str = Field("", description="Kind of drives.")
    controller: str = Field("", description="Kind of controller.")
    glass: str = Field("", description="Maker and thickness of the glass.")
    pedestal: str = Field("", description="Pedestal and foundation.")
    mass_kg: Positive | None = Field(None, description="Mass without foundation [kg].")


class TestTargetSection(Section):
    """The target on which beams were seen: flat, upright unless tilted."""

    center_m: Vector3 = Field(description="Its centre: east, north, up [m].")
    facing_azimuth_deg: Number = Field(description="Azimuth that it faces; 180: south [deg].")
    tilt_deg: Annotated[float, Field(strict=True, gt=-90, lt=90)] = Field(
        0.0, description="Elevation of its normal; below zero it leans towards the field [deg]."
    )
    aim_m: Vector2 = Field((0.0, 0.0), description="Aim from the centre, right and up as seen from the field [m].")
    sigma_aim_m: Sigma = Field(
        0.01, description="Uncertainty of the aim against the target's marks, each direction [m]."
    )
    sigma_place_m: Positive | None = Field(
        None, description="Uncertainty of a beam's place where its table has none [m]."
    )
    sigma_distance_share: Sigma = Field(
        0.001, description="Relative uncertainty of the distance from heliostat to target."
    )


class BeamSection(Section):
    """Beams of a test: tables, folders with photos, or results of ``heliogauge beam measure``."""

    file: Files = Field(
        description="Table with time_utc, x_m and y_m (or _mrad, _deg from the aim), a folder with photos of beams, or "
        "results of `heliogauge beam measure`; a list joins several."
    )
    conditions: str = Field("", description="Conditions of this test.")


class DriftSection(BeamSection):
    """Drift, oscillation and sawtooth (solar spot test): one beam every few seconds or minutes."""

    update_s: Positive | None = Field(
        None, description="Interval at which the drives are updated; default: sought in the beams [s]."
    )


class WindSection(BeamSection):
    """Beams in wind; the table has wind_m_s as well."""

    full_m_s: Positive = Field(8.0, description="Largest mean wind at 10 m of full operation, class W1.1 [m/s].")
    reduced_m_s: Positive = Field(14.0, description="Largest one of operation at reduced accuracy, W1.2 [m/s].")
    stow_m_s: Positive = Field(22.0, description="Wind at which it must have left operation, W2 [m/s].")

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if not self.full_m_s < self.reduced_m_s < self.stow_m_s:
            raise ValueError("full_m_s, reduced_m_s and stow_m_s must ascend")
        return self


class BacklashSection(Section):
    """Play of the axes: marks of a laser on the mirror, or beams with the mirror pushed to both ends."""

    marks: Text | None = Field(
        None, description="Table with axis (azimuth or elevation), mark_1_m and mark_2_m, a row for each repetition."
    )
    distance_m: Positive | None = Field(None, description="From the axis to the wall with the marks [m].")
    sigma_mark_m: Positive | None = Field(
        None, description="Uncertainty of a mark; default: from the scatter of the repetitions [m]."
    )
    sigma_distance_m: Sigma = Field(0.01, description="Uncertainty of that distance [m].")
    spots: Text | None = Field(
        None,
        description="Table with pair, end (1 or 2), x_m, y_m and time_utc, or sun_azimuth_deg and sun_elevation_deg.",
    )
    conditions: str = Field("", description="Conditions of this test.")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.marks is None and self.spots is None:
            raise ValueError("marks or spots is needed")
        if self.marks is not None and self.distance_m is None:
            raise ValueError("distance_m is needed with marks")
        return self


class SunCameraSection(Section):
    """A camera on the mirror that looks at the sun while the heliostat follows it."""

    file: Text | None = Field(
        None, description="Table with time_utc, azimuth_mrad and elevation_mrad (or _rad, _deg) of the normal's error."
    )
    photos: Text | None = Field(None, description="Photos of the sun through the filter: a text with *.")
    camera: Text | None = Field(None, description="camera.json of that camera.")
    interval_s: Positive | None = Field(None, description="Time between photos; default: from their EXIF [s].")
    sigma_mrad: Positive | None = Field(None, description="Uncertainty of one reading where its table has none [mrad].")
    conditions: str = Field("", description="Conditions of this test.")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.file is None) == (self.photos is None):
            raise ValueError("either file or photos is needed")
        if self.photos is not None and self.camera is None:
            raise ValueError("camera is needed with photos")
        return self


class ReflectanceSection(Section):
    """Spectra of reflectance, readings of a reflectometer, or both."""

    spectra: Files | None = Field(
        None, description="Tables with wavelength_nm and a column for each sample: shares, or ..._percent."
    )
    spectrum: Text | None = Field(
        None, description="The sun instead of AM 1.5: a table with wavelength_nm and irradiance."
    )
    sigma_instrument: Sigma | None = Field(
        None, description="Uncertainty that all spectra share, as a share (reference mirror)."
    )
    readings: tuple[Number, ...] = Field((), description="Readings of a reflectometer on the heliostat, as shares.")
    sigma_reading: Sigma | None = Field(None, description="Uncertainty that all readings share, as a share.")
    kind: Literal["hemispherical", "specular"] = Field("hemispherical", description="What was measured.")
    acceptance_mrad: Positive | None = Field(None, description="Half acceptance angle of specular reflectance [mrad].")
    conditions: str = Field("", description="Conditions of this test.")

    @model_validator(mode="after")
    def _something(self) -> Self:
        if self.spectra is None and not self.readings:
            raise ValueError("spectra or readings is needed")
        if any(not 0 <= one <= 1.05 for one in self.readings):
            raise ValueError("readings are shares from 0 to 1 (0.94, not 94)")
        return self


class QualitySection(Section):
    """Results that were measured of the mirror: slope maps (deflectometry, photogrammetry), beams."""

    results: Files = Field(description="Folders of results, relative to this one.")
    conditions: str = Field("", description="Conditions of this test.")


class ControlSection(Section):
    """Log of the controller (tests 1 and 2)."""

    file: Text = Field(description="Table with time_utc, event and state; rows without an event say the state alone.")
    within_s: Positive = Field(600.0, description="Time in which the state that is due must be reached [s].")
    conditions: str = Field("", description="Conditions of this test.")


class PowerSection(Section):
    """Energy that the heliostat used (test 7)."""

    file: Text = Field(description="Table with time_utc and energy_kwh (reading of the meter) or energy_wh.")
    sigma_share: Sigma = Field(0.01, description="Relative uncertainty of the meter.")
    resolution_wh: Sigma = Field(1.0, description="Smallest step of its reading [Wh].")
    conditions: str = Field("", description="Conditions of this test.")


class GivenSection(Section):
    """Numbers measured elsewhere (star reflection, another laboratory)."""

    file: Text = Field(
        description="Table with key, value, sigma, label, method, date, conditions; keys end with their unit."
    )


class YearSection(Section):
    """What errors cost over a year: the aperture that the light is to enter, and the weather."""

    center_m: Vector3 = Field(description="Middle of the aperture: east, north, up [m].")
    facing_azimuth_deg: Number = Field(description="Azimuth that it faces; 0: north [deg].")
    tilt_deg: Annotated[float, Field(strict=True, ge=-90, le=90)] = Field(
        0.0, description="Elevation of its normal; below zero it looks down to the field [deg]."
    )
    width_m: Positive | None = Field(None, description="Its width [m].")
    height_m: Positive | None = Field(None, description="Its height [m].")
    diameter_m: Positive | None = Field(None, description="Instead of both: diameter of a round one [m].")
    dni: Text | None = Field(
        None, description="Table with time_utc and dni_w_m2 over a year; default: every day clear."
    )
    circumsolar_share: Annotated[float, Field(strict=True, ge=0, le=0.7)] = Field(
        0.03, description="Share of the sun's light from outside its disc (Buie's sun shape)."
    )
    reflectance_share: Annotated[float, Field(strict=True, gt=0, le=1)] = Field(
        0.93, description="Reflectance, for the energy in kWh, where [reflectance] has not measured it."
    )
    offset_mrad: Sigma | None = Field(None, description="Systematic offset of the beam; default: that of [day] [mrad].")
    scatter_mrad: Sigma | None = Field(
        None, description="Scatter of the beam, both directions together; default: that of [day] [mrad]."
    )
    slope_mrad: Sigma | None = Field(
        None, description="SD of the normals; default: that of [quality], best focus [mrad]."
    )
    canting_mrad: Sigma | None = Field(
        None, description="RMS canting of the facets' normals; default: that of [quality] [mrad]."
    )

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height, of a round one its diameter [m]."""
        across = self.diameter_m or 0.0
        return (self.width_m or across, self.height_m or across)

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.diameter_m is None) == (self.width_m is None or self.height_m is None):
            raise ValueError("either width_m and height_m, or diameter_m is needed")
        if self.diameter_m is not None and (self.width_m is not None or self.height_m is not None):
            raise ValueError("width_m and height_m are of no use beside diameter_m")
        return self


class HeliostatTestsModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "heliostat-tests"``; ``name`` is the heliostat's."""

    kind: Literal["heliostat-tests"] = Field(description="Tests of one heliostat for its data sheet.")
    laboratory: LaboratorySection = Field(LaboratorySection(), description="Who measured.")
    site: SiteSection | None = Field(None, description="Where the plant is; beams and suns by time need it.")
    heliostat: HeliostatSection = Field(description="The heliostat.")
    target: TestTargetSection | None = Field(None, description="The target; tests with beams need it.")
    day: BeamSection | None = Field(None, description="Tracking over days: accuracy and precision.")
    drift: DriftSection | None = Field(None, description="Drift, oscillation, sawtooth.")
    backlash: BacklashSection | None = Field(None, description="Play of the axes.")
    repeat: BeamSection | None = Field(None, description="Repeated approaches; the table has approach as well.")
    wind: WindSection | None = Field(None, description="Beams in wind.")
    sun_camera: SunCameraSection | None = Field(None, description="Camera on the mirror that looks at the sun.")
    reflectance: ReflectanceSection | None = Field(None, description="Reflectance.")
    quality: QualitySection | None = Field(None, description="Slopes, canting, beam shape of results.")
    control: ControlSection | None = Field(None, description="Log of the controller.")
    power: PowerSection | None = Field(None, description="Energy that the heliostat used.")
    given: GivenSection | None = Field(None, description="Numbers measured elsewhere.")
    year: YearSection | None = Field(None, description="What errors cost over a year.")

    @model_validator(mode="after")
    def _needs(self) -> Self:
        done = [name for name in TESTS if getattr(self, name) is not None]
        if not done:
            raise ValueError(f"no test: one of the sections {', '.join(TESTS)} is needed")
        beams: list[str] = [name for name in ("day", "drift", "repeat", "wind") if name in done]
        if self.backlash is not None and self.backlash.spots is not None:
            beams.append("backlash.spots")
        if beams and self.target is None:
            raise ValueError(f"the section target is needed for {', '.join(beams)}")
        if beams and self.site is None:
            raise ValueError(f"the section site is needed for {', '.join(beams)}: the sun's place is known by it")
        if self.year is not None and self.site is None:
            raise ValueError("the section site is needed for year")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class HeliostatTests:
    """Checked tests of a heliostat: the content of measurement.toml, and where its files are.

    folder: The measurement's folder.
    model: The content of measurement.toml.
    """

    folder: Path
    model: HeliostatTestsModel

    def path(self, name: str) -> Path:
        """Return a file that measurement.toml names."""
        return self.folder / name

    @property
    def date(self) -> str:
        """Day of the measurement in words; empty: not said."""
        date = self.model.date
        return "" if date is None else (date.date() if isinstance(date, datetime.datetime) else date).isoformat()

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first; those of results are not among them."""
        return (
            self.folder / MEASUREMENT_FILE,
            *(path for path in map(self.path, _named(self.model)) if path.is_file()),
        )


def load_tests(folder: Path) -> HeliostatTests:
    """Read and check a folder with tests of a heliostat.

    folder: Folder with measurement.toml; the files it names are relative to it.
    InputError: As for `heliogauge.measurement.load.read_measurement`, or a file that is not there.
    """
    file, model = read_measurement(folder, HeliostatTestsModel)
    # Beams may be a folder of results.
    refuse_missing(file, [path for path in map(folder.joinpath, _named(model)) if not path.is_dir()])
    for name in files_of(model.quality.results) if model.quality is not None else ():
        if not (folder / name).is_dir():
            raise InputError(f"{file}: quality.results: {name} is no folder of results")
    return HeliostatTests(folder, model)


def files_of(names: str | tuple[str, ...]) -> tuple[str, ...]:
    """Return names that are given as a text or a list."""
    return (names,) if isinstance(names, str) else names


def _named(model: HeliostatTestsModel) -> Iterator[str]:
    for section in (model.day, model.drift, model.repeat, model.wind):
        if section is not None:
            yield from files_of(section.file)
    for name in (
        model.backlash and model.backlash.marks,
        model.backlash and model.backlash.spots,
        model.sun_camera and model.sun_camera.file,
        model.sun_camera and model.sun_camera.camera,
        model.reflectance and model.reflectance.spectrum,
        model.control and model.control.file,
        model.power and model.power.file,
        model.given and model.given.file,
        model.year and model.year.dni,
    ):
        if name:
            yield name
    if model.reflectance is not None and model.reflectance.spectra is not None:
        yield from files_of(model.reflectance.spectra)
