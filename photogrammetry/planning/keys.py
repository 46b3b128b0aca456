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
    """The object: a file of targets, or a design surface with targets at equal spacing.

    The file has the columns id, x_m, y_m, z_m and perhaps normal_x, normal_y, normal_z (out of the target's face).
    """

    targets: Text | None = None
    design: Literal["plane", "paraboloid", "sphere", "trough"] | None = None
    focal_length_m: Number | None = None
    radius_m: Number | None = None
    width_m: Positive | None = None
    height_m: Positive | None = None
    spacing_m: Positive | None = None
    center_m: tuple[Number, Number] = (0.0, 0.0)
    diameter_mm: Sigma = 0.0

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

    file: Text | None = None
    width_px: Count | None = None
    height_px: Count | None = None
    focal_px: Positive | None = None
    free: tuple[Intrinsic, ...] = SELF_CALIBRATED
    sigma_px: Positive
    smallest_px: Sigma = 6.0

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

    distance_m: Positive | None = None
    rings_deg: Annotated[tuple[Angle, ...], Field(min_length=1)] = (20.0, 35.0, 50.0)
    up: Vector3 = (0.0, 0.0, 1.0)
    lowest_m: Number | None = None
    highest_m: Number | None = None
    turned: bool = True
    largest_incidence_deg: Annotated[float, Field(strict=True, gt=0, le=90)] = 65.0


class PlannedBarSection(Section):
    """A scale bar with a target at either end."""

    from_m: Vector3
    to_m: Vector3
    sigma_mm: Positive


class GoalSection(Section):
    """What is wanted."""

    sigma_mm: Positive
    of: Literal["rms", "largest"] = "rms"
    most_photos: Annotated[int, Field(strict=True, ge=4, le=300)] = 80


class PhotogrammetryPlanModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "photogrammetry-plan"``."""

    kind: Literal["photogrammetry-plan"]
    object: PlannedObjectSection
    camera: PlannedCameraSection
    stations: StationsSection = StationsSection()
    scale_bar: tuple[PlannedBarSection, ...] = ()
    goal: GoalSection


@dataclass(frozen=True, slots=True, eq=False)
class PhotogrammetryPlanMeasurement:
    """A checked plan of a photo network: what the file says, and where its files are.

    folder: The plan's folder.
    model: What measurement.toml says.
    """

    folder: Path
    model: PhotogrammetryPlanModel

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the plan consists of, measurement.toml first."""
        named = (self.model.object.targets, self.model.camera.file)
        return (self.folder / MEASUREMENT_FILE, *(self.folder / name for name in named if name))


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
