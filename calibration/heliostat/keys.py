"""Keys of measurement.toml of ``kind = "heliostat"``, and folders of the PAINT database that need none."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from calibration.beam.images import BeamImagesSection
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import (
    MeasurementModel,
    Names,
    Number,
    Positive,
    Section,
    Text,
    Vector3,
    repeated,
)

Preset = Literal["azimuth-elevation", "drone", "six-error", "two-axes", "linear-actuators"]
Split = Literal["random", "chronological", "azimuth", "azimuth-reversed", "high-variance", "column"]
Label = Literal["UTIS", "HeliOS"]
#: Optional terms of each drive.
DriveTerm = Literal["worm", "worm2", "sag", "backlash", "scale"]
#: inf leaves a parameter to the observations alone.
_PriorSigma = Annotated[float, Field(strict=True, ge=0)]


class SiteSection(Section):
    """Where the plant is, and the air above it: for the sun's apparent position."""

    latitude_deg: Annotated[float, Field(strict=True, ge=-90, le=90)] = Field(
        description="Latitude, north positive [deg]."
    )
    longitude_deg: Annotated[float, Field(strict=True, ge=-180, le=360)] = Field(
        description="Longitude, east positive [deg]."
    )
    altitude_m: Number = Field(0.0, description="Height above sea level [m].")
    pressure_hpa: Annotated[float, Field(strict=True, ge=300, le=1100)] | None = Field(
        None, description="Air pressure; default: standard atmosphere there [hPa]."
    )
    temperature_c: Annotated[float, Field(strict=True, ge=-60, le=70)] = Field(
        12.0, description="Air temperature [degrees Celsius]."
    )


class HeliostatTargetSection(Section):
    """A flat target: its centre, size and the azimuth it faces, or its four measured corners."""

    name: Text = Field(description="Name of the target in the observations.")
    center_m: Vector3 | None = Field(None, description="Its centre: east, north, up [m].")
    width_m: Positive | None = Field(None, description="Its width [m].")
    height_m: Positive | None = Field(None, description="Its height [m].")
    facing_azimuth_deg: Number | None = Field(None, description="Azimuth that it faces; 180: south [deg].")
    corners_m: Annotated[tuple[Vector3, ...], Field(min_length=4, max_length=4)] | None = Field(
        None, description="Instead: upper left, upper right, lower right, lower left, from the field [m]."
    )

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        numbers = {
            "center_m": self.center_m,
            "width_m": self.width_m,
            "height_m": self.height_m,
            "facing_azimuth_deg": self.facing_azimuth_deg,
        }
        given = [key for key, value in numbers.items() if value is not None]
        if self.corners_m is not None and given:
            raise ValueError(f"the corners define the target, and so does {given[0]}; leave one of both out")
        if self.corners_m is None and len(given) < len(numbers):
            missing = ", ".join(key for key in numbers if key not in given)
            raise ValueError(f"{missing} is missing; or give the four corners_m instead")
        return self


class HeliostatCameraSection(Section):
    """A camera in which the sun is seen reflected: where it is, with sigma, or that this is not known."""

    name: Text = Field(description="Name of the camera in the observations.")
    center_m: Vector3 | None = Field(None, description="Its place: east, north, up; default: estimated [m].")
    sigma_m: Positive | None = Field(None, description="Standard deviation of that place, each coordinate [m].")


class FileSection(Section):
    """A table that stands in a file of its own."""

    file: Text = Field(description="Name of the table, relative to the folder.")


class ParameterSection(Section):
    """What is known of a parameter beforehand: value, and sigma (0 holds it, inf leaves it to the observations)."""

    value: Number | None = Field(None, description="Its value; default: of the preset or the table of heliostats.")
    sigma: _PriorSigma | None = Field(None, description="Its standard deviation: 0 holds it, inf leaves it open.")


def _as_pair(value: Any) -> Any:
    is_scalar = isinstance(value, int | float) and not isinstance(value, bool)
    return (value, value) if is_scalar else value


FreeNames = Annotated[
    Annotated[Text, Tag("name")] | Annotated[tuple[Text, ...], Tag("list")],
    Discriminator(lambda value: "name" if isinstance(value, str) else "list"),
]


class KinematicsSection(Section):
    """The model: a preset, which of its parameters are estimated, and what is known of them."""

    preset: Preset = Field("azimuth-elevation", description="Kinematic model of the heliostats.")
    free: FreeNames | None = Field(
        None, description="Estimated parameters: a usual choice of the preset (8) or a list of names."
    )
    terms: tuple[DriveTerm, ...] = Field(
        (),
        description="Errors of the drives on top of the model, free within usual priors: worm and worm2 2 mrad, sag 3 "
        "mrad, backlash 4 mrad, scale 0.1 %; [kinematics.parameters] overrides them.",
    )
    counts_per_turn: Annotated[tuple[Number, Number], BeforeValidator(_as_pair)] | None = Field(
        None, description="Motor counts per turn, one number or one for each axis; negative: reversed."
    )
    worm_ratio: Annotated[tuple[Positive, Positive], BeforeValidator(_as_pair)] | None = Field(
        None, description="Cycles of the periodic error per turn (linear actuators: per metre)."
    )
    printed_signs: bool = Field(False, description="Tilts of azimuth-elevation as printed by Malan (2014).")
    axes: tuple[Vector3, Vector3] | None = Field(
        None, description="Directions of both axes at readings 0 (two-axes): east, north, up."
    )
    normal: Vector3 | None = Field(None, description="Direction of the mirror's normal at readings 0 (two-axes).")
    parameters: dict[str, ParameterSection] = Field(
        default_factory=dict, description="What is known of single parameters, a table for each."
    )

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if {"worm", "worm2"} & set(self.terms) and self.worm_ratio is None:
            raise ValueError("a worm's error is asked for, so worm_ratio is needed: its cycles per turn of the axis")
        given = [key for key in ("axes", "normal") if getattr(self, key) is not None]
        if len(given) != (2 if self.preset == "two-axes" else 0):
            raise ValueError('axes (two directions) and normal, both at readings 0, belong to preset = "two-axes"')
        if self.counts_per_turn is not None and 0 in self.counts_per_turn:
            raise ValueError("counts_per_turn must not be 0")
        return self


class PaintSection(Section):
    """Folders as of the PAINT database: of one heliostat, or of many beside the tower's file."""

    folder: Text = Field(".", description="Folder as of the PAINT database.")
    tower: Text | None = Field(None, description="The tower's file; default: beside the heliostats.")
    heliostats: Names = Field((), description="Heliostats to read; default: all.")


class HeliostatEvaluationSection(Section):
    """How the fit is made, and on what it is tried out."""

    split: Split = Field("chronological", description="Which observations are held out to try the model on.")
    model: Text | None = Field(None, description="Usual choice of free parameters, or auto: by trial.")
    label: Label = Field("UTIS", description="Centres of beams in PAINT's files: whose.")
    spot_sigma_mm: Positive = Field(50.0, description="1 sigma of a beam's centre, if not in the table [mm].")
    random_seed: Annotated[int, Field(strict=True, ge=0)] = Field(0, description="Seed of the random split.")


class HeliostatModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "heliostat"``."""

    kind: Literal["heliostat"] = Field(
        description="Observations of heliostats: sightings of beams, and drive readings."
    )
    site: SiteSection | None = Field(None, description="Place of the plant, and its air; PAINT's files may have it.")
    target: tuple[HeliostatTargetSection, ...] = Field((), description="Targets of the beams, a table for each.")
    camera: tuple[HeliostatCameraSection, ...] = Field((), description="Cameras that see the sun in the mirror.")
    heliostats: FileSection = Field(
        FileSection(file="heliostats.csv"),
        description="Columns heliostat, e_m, n_m, u_m (or lat_deg, lon_deg, alt_m), parameters.",
    )
    kinematics: KinematicsSection = Field(
        KinematicsSection(), description="The kinematic model, and what is known of its parameters."
    )
    observations: FileSection = Field(
        FileSection(file="observations.csv"), description="Table of the observations, one row each."
    )
    images: tuple[BeamImagesSection, ...] = Field((), description="Photos of beams, a table for each target.")
    paint: PaintSection | None = Field(None, description="Folders as of the PAINT database, instead of both tables.")
    evaluation: HeliostatEvaluationSection = Field(
        HeliostatEvaluationSection(), description="How the fit is made, and on what it is tried out."
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.paint is not None:
            tables = {"heliostats", "observations", "target"} & self.model_fields_set
            if tables:
                raise ValueError(f"[paint] names the data, and so does [{min(tables)}]; leave one of both out")
        elif self.site is None:
            raise ValueError("[site] is missing: latitude_deg, longitude_deg, altitude_m of the plant, for the sun")
        for kind, names in (("target", self.target), ("camera", self.camera)):
            if (twice := repeated(one.name for one in names)) is not None:
                raise ValueError(f"{kind} {twice!r} is described twice; give each its own name")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class HeliostatMeasurement:
    """Checked observations of heliostats: the content of measurement.toml, and where its files are.

    folder: The measurement's folder.
    model: The content of measurement.toml; for a folder of the PAINT database without one, all is default.
    has_file: Whether there is a measurement.toml.
    """

    folder: Path
    model: HeliostatModel
    has_file: bool = True

    def path(self, text: str) -> Path:
        """Return the path of a file named in measurement.toml."""
        return self.folder / text

    @property
    def input_files(self) -> tuple[Path, ...]:
        """Files that all heliostats share, measurement.toml first; those of PAINT belong to each heliostat."""
        own = (self.folder / MEASUREMENT_FILE,) if self.has_file else ()
        if self.model.paint is not None:
            return own
        return (*own, self.path(self.model.heliostats.file), self.path(self.model.observations.file))


def properties_files(folder: Path) -> Iterator[Path]:
    """Find files with properties of heliostats as the PAINT database has them, in a folder or one or two below.

    Returns: Files such as ``BE36_properties.json`` or ``AA39/Properties/AA39-heliostat-properties.json``.
    """
    for pattern in ("*properties.json", "*/*properties.json", "*/Properties/*properties.json"):
        for file in sorted(folder.glob(pattern)):
            if "calibration" not in file.name.casefold():
                yield file


def paint_measurement(folder: Path) -> HeliostatMeasurement | None:
    """Describe a folder of the PAINT database that has no measurement.toml."""
    if (folder / MEASUREMENT_FILE).exists() or next(properties_files(folder), None) is None:
        return None
    model = HeliostatModel(kind="heliostat", name=folder.resolve().name or "field", paint=PaintSection())
    return HeliostatMeasurement(folder, model, has_file=False)


def load_heliostat(folder: Path) -> HeliostatMeasurement:
    """Read and check a folder with observations of heliostats.

    folder: Folder with measurement.toml, or one as of the PAINT database, which needs none.
    Returns: The measurement; every file it names exists.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    found = paint_measurement(folder)
    if found is None:
        file, model = read_measurement(folder, HeliostatModel)
        found = HeliostatMeasurement(folder, model)
        refuse_missing(file, found.input_files)
    return found
