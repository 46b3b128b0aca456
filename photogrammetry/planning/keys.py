"""What measurement.toml of ``kind = "photogrammetry-plan"`` may say."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import (
    Count,
    Intrinsic,
    MeasurementModel,
    Number,
    Positive,
    Section,
    Sigma,
    Text,
    Vector3,
)
from photogrammetry.keys.cameras import SELF_CALIBRATED

Angle = Annotated[float, Field(strict=True, ge=0, le=85)]


class PlannedObjectSection(Section):
    """The object: a file of targets, or a design surface with targets at equal spacing."""

    targets: Text | None = Field(
        None, description="Targets: columns id, x_m, y_m, z_m and perhaps normal_x, normal_y, normal_z."
    )
    design: Literal["plane", "paraboloid", "sphere", "trough"] | None = Field(
        None, description="Design surface with targets at equal spacing, instead of a table."
    )
    focal_length_m: Number | None = Field(None, description="Focal length of a paraboloid or trough [m].")
    radius_m: Number | None = Field(None, description="Radius of a sphere [m].")
    width_m: Positive | None = Field(None, description="Size along x [m].")
    height_m: Positive | None = Field(None, description="Size along y [m].")
    spacing_m: Positive | None = Field(None, description="Distance of neighbouring targets [m].")
    center_m: tuple[Number, Number] = Field((0.0, 0.0), description="The object's middle on the design, x and y [m].")
    diameter_mm: Sigma = Field(0.0, description="Diameter of the dots; 0: does not matter [mm].")

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.targets is None) == (self.design is None):
            raise ValueError("give targets = a file, or design = a surface, one of both")
        if self.design is None:
            return self
        lengths = {"paraboloid": "focal_length_m", "trough": "focal_length_m", "sphere": "radius_m"}
        needed = ["width_m", "height_m", "spacing_m", *filter(None, [lengths.get(self.design)])]
        missing = [name for name in needed if getattr(self, name) is None]
        if missing:
            raise ValueError(f'design = "{self.design}" needs {", ".join(missing)}')
        return self


class PlannedCameraSection(Section):
    """The camera: a file, or size and focal length; ``free`` is what the measurement will estimate."""

    file: Text | None = Field(None, description="File of a calibrated camera, instead of size and focal length.")
    width_px: Count | None = Field(None, description="Width of the photos [px].")
    height_px: Count | None = Field(None, description="Height of the photos [px].")
    focal_px: Positive | None = Field(None, description="Focal length over pixel pitch [px].")
    free: tuple[Intrinsic, ...] = Field(
        SELF_CALIBRATED, description="Intrinsics that the measurement will estimate; [] for a camera that is known."
    )
    sigma_px: Positive = Field(description="Standard deviation of an image coordinate [px].")
    smallest_px: Sigma = Field(6.0, description="Smallest diameter of a dot in the image [px].")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        own = [name for name in ("width_px", "height_px", "focal_px") if getattr(self, name) is not None]
        if self.file is None and len(own) < 3:
            raise ValueError("give file, or width_px, height_px and focal_px")
        if self.file is not None and own:
            raise ValueError(f"the file gives the camera, and so does {', '.join(own)}; leave one of both out")
        return self


class StationsSection(Section):
    """Where the camera can be."""

    distance_m: Positive | None = Field(None, description="Distance from the object; default: it fills the image [m].")
    rings_deg: Annotated[tuple[Angle, ...], Field(min_length=1)] = Field(
        (20.0, 35.0, 50.0), description="Angles of the rings from the object's normal [deg]."
    )
    up: Vector3 = Field(
        (0.0, 0.0, 1.0), description="The vertical in the object's frame; y for a mirror that looks at the horizon."
    )
    lowest_m: Number | None = Field(None, description="Lowest height along the vertical; default: any [m].")
    highest_m: Number | None = Field(None, description="Highest height along the vertical; default: any [m].")
    turned: bool = Field(True, description="Every other photo with the camera turned by 90 degrees.")
    largest_incidence_deg: Annotated[float, Field(strict=True, gt=0, le=90)] = Field(
        65.0, description="Largest angle of a ray from a target's normal [deg]."
    )


class PlannedBarSection(Section):
    """A scale bar with a target at either end."""

    from_m: Vector3 = Field(description="One end of the bar in the object's frame [m].")
    to_m: Vector3 = Field(description="The other end [m].")
    sigma_mm: Positive = Field(description="Standard deviation of its length [mm].")


class GoalSection(Section):
    """What is wanted."""

    sigma_mm: Positive = Field(description="Standard deviation of coordinates that is wanted [mm].")
    of: Literal["rms", "largest"] = Field(
        "rms", description="What it is of: the RMS of all coordinates' sigmas, or the largest."
    )
    most_photos: Annotated[int, Field(strict=True, ge=4, le=300)] = Field(80, description="Photos at most.")


class PhotogrammetryPlanModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "photogrammetry-plan"``."""

    kind: Literal["photogrammetry-plan"] = Field(description="Plan of a photo network.")
    object: PlannedObjectSection = Field(description="What is to be measured.")
    camera: PlannedCameraSection = Field(description="The camera.")
    stations: StationsSection = Field(StationsSection(), description="Where the camera can be.")
    scale_bar: tuple[PlannedBarSection, ...] = Field((), description="Scale bars, with a target at either end.")
    goal: GoalSection = Field(description="What is wanted.")


@dataclass(frozen=True, slots=True, eq=False)
class PhotogrammetryPlanMeasurement:
    """A checked plan of a photo network: what the file says, and where its files are.

    folder: The plan's folder.
    model: What measurement.toml says.
    source: The file in it that the model comes from.
    """

    folder: Path
    model: PhotogrammetryPlanModel
    source: str = MEASUREMENT_FILE

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the plan consists of, measurement.toml first."""
        named = (self.model.object.targets, self.model.camera.file)
        return (self.folder / self.source, *(self.folder / name for name in named if name))


def load_photogrammetry_plan(folder: Path) -> PhotogrammetryPlanMeasurement:
    """Read and check a folder with the plan of a photo network.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The plan; every file it names exists.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, PhotogrammetryPlanModel)
    found = PhotogrammetryPlanMeasurement(folder, model)
    refuse_missing(file, found.input_files)
    return found
