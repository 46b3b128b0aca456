"""What measurement.toml of ``kind = "heliostat"`` may say, and folders of the PAINT database that need none."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import (
    ImageFiles,
    Index,
    MeasurementModel,
    Number,
    Positive,
    Section,
    Text,
    Vector2,
    Vector3,
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

    latitude_deg: Annotated[float, Field(strict=True, ge=-90, le=90)]
    longitude_deg: Annotated[float, Field(strict=True, ge=-180, le=360)]
    altitude_m: Number = 0.0
    pressure_hpa: Annotated[float, Field(strict=True, ge=300, le=1100)] | None = None
    temperature_c: Annotated[float, Field(strict=True, ge=-60, le=70)] = 12.0


class HeliostatTargetSection(Section):
    """A flat target: its centre, size and the azimuth it faces, or its four measured corners.

    Corners go upper left, upper right, lower right, lower left, as seen from the field.
    """

    name: Text
    center_m: Vector3 | None = None
    width_m: Positive | None = None
    height_m: Positive | None = None
    facing_azimuth_deg: Number | None = None
    corners_m: Annotated[tuple[Vector3, ...], Field(min_length=4, max_length=4)] | None = None

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
            raise ValueError(f"the corners say all, and so does {given[0]}; leave one of both out")
        if self.corners_m is None and len(given) < len(numbers):
            missing = ", ".join(key for key in numbers if key not in given)
            raise ValueError(f"{missing} is missing; or give the four corners_m instead")
        return self


class HeliostatCameraSection(Section):
    """A camera in which the sun is seen reflected: where it is, with sigma, or that this is not known."""

    name: Text
    center_m: Vector3 | None = None
    sigma_m: Positive | None = None


class FileSection(Section):
    """A table that stands in a file of its own."""

    file: Text


class ParameterSection(Section):
    """What is known of a parameter beforehand: value, and sigma (0 holds it, inf leaves it to the observations)."""

    value: Number | None = None
    sigma: _PriorSigma | None = None


def _as_pair(value: Any) -> Any:
    is_scalar = isinstance(value, int | float) and not isinstance(value, bool)
    return (value, value) if is_scalar else value


FreeNames = Annotated[
    Annotated[Text, Tag("name")] | Annotated[tuple[Text, ...], Tag("list")],
    Discriminator(lambda value: "name" if isinstance(value, str) else "list"),
]


class KinematicsSection(Section):
    """The model: a preset, which of its parameters are estimated, and what is known of them.

    ``counts_per_turn`` turns motor counts of rotary drives into angles (one number or one for each axis; negative
    where the count runs against the axis). ``worm_ratio`` is the cycles of the periodic error per turn (per metre of
    stroke of a linear actuator); ``worm2`` has its second harmonic too. ``axes`` and ``normal`` are directions east,
    north, up at readings 0 of the preset "two-axes".
    """

    preset: Preset = "azimuth-elevation"
    free: FreeNames | None = None
    terms: tuple[DriveTerm, ...] = ()
    counts_per_turn: Annotated[tuple[Number, Number], BeforeValidator(_as_pair)] | None = None
    worm_ratio: Annotated[tuple[Positive, Positive], BeforeValidator(_as_pair)] | None = None
    printed_signs: bool = False
    axes: tuple[Vector3, Vector3] | None = None
    normal: Vector3 | None = None
    parameters: dict[str, ParameterSection] = Field(default_factory=dict)

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


class BeamImagesSection(Section):
    """Photos of beams on one target, measured before the fit; the column ``image`` of the observations names them.

    One of these says where the target is in them: ``whole`` (the photo is the target: "edge" where its outer edges are
    the target's, "index" where its outermost pixels' centres are), ``corners_px`` (upper left, upper right, lower
    right, lower left), ``markers`` (four pictures of marks, in that order), ``aruco_ids`` with ``dictionary``,
    ``dark_marks``. ``corners_sigma_px`` is how well the given pixels are known: 0.3 is careful work by hand. ``empty``
    are photos of the target without a beam, ``camera`` a calibrated camera's file.
    """

    target: Text
    whole: Literal["index", "edge"] | None = None
    corners_px: Annotated[tuple[Vector2, ...], Field(min_length=4, max_length=4)] | None = None
    corners_sigma_px: Positive = 0.3
    markers: Annotated[tuple[Text, ...], Field(min_length=4, max_length=4)] | None = None
    aruco_ids: Annotated[tuple[Index, ...], Field(min_length=4, max_length=4)] | None = None
    dictionary: Text = "DICT_4X4_50"
    dark_marks: Literal["outer", "inner"] | None = None
    empty: ImageFiles | None = None
    camera: Text | None = None

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        keys = ("whole", "corners_px", "markers", "aruco_ids", "dark_marks")
        given = [key for key in keys if getattr(self, key) is not None]
        if len(given) != 1:
            said = " and ".join(given) or "nothing"
            raise ValueError(f"one of {', '.join(keys)} must say where the target is in the photos, not {said}")
        return self


class PaintSection(Section):
    """Folders as of the PAINT database: of one heliostat, or of many beside the tower's file."""

    folder: Text = "."
    tower: Text | None = None
    heliostats: tuple[Text, ...] = ()


class HeliostatEvaluationSection(Section):
    """How the fit is made, and on what it is tried out.

    ``model`` names a usual choice of free parameters, or "auto" for the one that predicts best; ``spot_sigma_mm`` is
    the sigma of a beam's centre on the target where the table gives none.
    """

    split: Split = "chronological"
    model: Text | None = None
    label: Label = "UTIS"
    spot_sigma_mm: Positive = 50.0
    random_seed: Annotated[int, Field(strict=True, ge=0)] = 0


class HeliostatModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "heliostat"``."""

    kind: Literal["heliostat"]
    site: SiteSection | None = None
    target: tuple[HeliostatTargetSection, ...] = ()
    camera: tuple[HeliostatCameraSection, ...] = ()
    heliostats: FileSection = FileSection(file="heliostats.csv")
    kinematics: KinematicsSection = KinematicsSection()
    observations: FileSection = FileSection(file="observations.csv")
    images: tuple[BeamImagesSection, ...] = ()
    paint: PaintSection | None = None
    evaluation: HeliostatEvaluationSection = HeliostatEvaluationSection()

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.paint is not None:
            tables = {"heliostats", "observations", "target"} & self.model_fields_set
            if tables:
                raise ValueError(f"[paint] names the data, and so does [{min(tables)}]; leave one of both out")
        elif self.site is None:
            raise ValueError("[site] is missing: latitude_deg, longitude_deg, altitude_m of the plant, for the sun")
        for kind, names in (("target", self.target), ("camera", self.camera)):
            listed = [one.name for one in names]
            twice = next((name for name in listed if listed.count(name) > 1), None)
            if twice is not None:
                raise ValueError(f"{kind} {twice!r} is described twice; give each its own name")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class HeliostatMeasurement:
    """Checked observations of heliostats: what the file says, and where its files are.

    folder: The measurement's folder.
    model: What measurement.toml says; for a folder of the PAINT database without one, all is default.
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
