"""What measurement.toml of ``kind = "observer-plan"`` may say."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import MeasurementModel, Number, Positive, Section, Sigma, Text
from observer.keys import ObserverEvaluationSection, TroughSection
from photogrammetry.keys import DistanceSection, NetworkCameraSection, ScaleBarSection


class PlannedTargetsSection(Section):
    """Table of the targets, as of ``kind = "observer"``, or how many along the rims; how well they are found."""

    file: Text | None = Field(None, description="Table of the targets, as for a measurement.")
    rim_count: Annotated[int, Field(strict=True, ge=4, le=500)] | None = Field(
        None, description="Targets that stand evenly along both rims, an even number."
    )
    sigma_mm: Positive = Field(1.0, description="1 sigma of coordinates on the rims [mm].")
    sigma_px: Positive = Field(0.1, description="Standard deviation of a target's image [px].")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.file is not None and self.rim_count is not None:
            raise ValueError("give file or rim_count, one of both")
        if self.rim_count is not None and self.rim_count % 2:
            raise ValueError("rim_count: an even number is needed, half of it for each rim")
        if self.rim_count is None and "sigma_mm" in self.model_fields_set:
            raise ValueError("sigma_mm belongs to rim_count; a file has columns for it")
        return self

    @property
    def list_file(self) -> str | None:
        """The table of the targets; None where they are planned along the rims."""
        return None if self.rim_count is not None else self.file or "targets.csv"


class PlannedPassSection(Section):
    """Photos straight across the aperture, from x = -reach_m to +reach_m, looking at the collector."""

    height_m: Positive = Field(15.0, description="Height of the camera above the vertex [m].")
    reach_m: Positive = Field(3.0, description="Photos from x = -reach_m to +reach_m [m].")
    photos: Annotated[int, Field(strict=True, ge=2, le=2000)] = Field(100, description="Number of photos of the pass.")
    y_m: Number = Field(0.0, description="Where along the trough the camera is [m].")
    look_y_m: Number = Field(0.0, description="Where along the trough it looks [m].")


class PlannedMirrorSection(Section):
    """The mirror as it is expected: RMS slope errors, or the slope map of an earlier result."""

    slope_error_mrad: Positive = Field(3.0, description="RMS slope error across the trough that is expected [mrad].")
    longitudinal_error_mrad: Sigma = Field(0.0, description="RMS slope error along the trough that is expected [mrad].")
    like: Text | None = Field(None, description="Earlier result whose mirror and absorber are taken.")
    seed: Annotated[int, Field(strict=True, ge=0)] = Field(0, description="Seed of the typical mirror.")


class PlannedAbsorberSection(Section):
    """Whether the photos will measure the absorber's place, or the design's is taken."""

    source: Literal["photos", "design"] = Field(
        "photos", description="Whether photos measure its place, or the design is taken."
    )
    station_step_m: Positive = Field(0.25, description="Distance of its places along the trough [m].")


class PlannedNoiseSection(Section):
    """How well edges are found, in pixels."""

    reflection_px: Positive = Field(0.05, description="Standard deviation of an edge of the reflection [px].")
    absorber_px: Positive = Field(
        0.05, description="Standard deviation of the tube's middle [px]; behind glass some 0.3."
    )


class MonteCarloSection(Section):
    """Repeat the simulated measurement with everything uncertain disturbed; ``runs = 0`` does without."""

    runs: Annotated[int, Field(strict=True, ge=0, le=5000)] = Field(
        0, description="Repetitions with everything uncertain disturbed; 0: none."
    )
    row_step_mm: Positive = Field(200.0, description="Distance of the rows that are repeated [mm].")
    seed: Annotated[int, Field(strict=True, ge=0)] = Field(0, description="Seed of the disturbances.")


class ObserverPlanModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "observer-plan"``."""

    kind: Literal["observer-plan"] = Field(description="Plan of a pass over a trough.")
    collector: TroughSection = Field(description="The collector module, as for a measurement.")
    camera: NetworkCameraSection = Field(
        description="The camera: a file or size and focal length; sigma: of its calibration."
    )
    targets: PlannedTargetsSection = Field(PlannedTargetsSection(), description="The targets.")
    scale_bar: tuple[ScaleBarSection, ...] = Field((), description="Known distances of targets, as scale bars.")
    distance: tuple[DistanceSection, ...] = Field((), description="Known distances of targets, as measured by tape.")
    flight: Annotated[tuple[PlannedPassSection, ...], Field(min_length=1)] = Field(
        (PlannedPassSection(),), description="Passes across the aperture, a table each."
    )
    mirror: PlannedMirrorSection = Field(PlannedMirrorSection(), description="The mirror that is expected.")
    absorber: PlannedAbsorberSection = Field(
        PlannedAbsorberSection(), description="How the absorber's position will be known."
    )
    noise: PlannedNoiseSection = Field(PlannedNoiseSection(), description="How well edges are found.")
    monte_carlo: MonteCarloSection = Field(
        MonteCarloSection(), description="Repeat the simulated measurement with everything uncertain disturbed."
    )
    evaluation: ObserverEvaluationSection = Field(
        ObserverEvaluationSection(), description="How the map is made, as for a measurement."
    )
    alternatives: Annotated[bool, Field(strict=True)] = Field(
        False,
        description="Whether other flights are compared: more, fewer and side photos, two passes.",
    )

    @model_validator(mode="after")
    def _planned_camera(self) -> Self:
        if not self.camera.is_known or not self.camera.has_size:
            raise ValueError(
                "camera: give a file, or width_px, height_px and focal_px; a plan has no photos to take them from"
            )
        return self


@dataclass(frozen=True, slots=True, eq=False)
class ObserverPlanMeasurement:
    """A checked plan of a pass over a trough: what the file says, and where its files are.

    folder: The plan's folder.
    model: What measurement.toml says.
    """

    folder: Path
    model: ObserverPlanModel

    @property
    def earlier(self) -> Path | None:
        """Folder of the earlier result with mirror and absorber; None where a typical mirror stands for it."""
        like = self.model.mirror.like
        return None if like is None else self.folder / like

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the plan consists of, measurement.toml first."""
        own = (self.model.camera.file, self.model.targets.list_file)
        found = (self.folder / MEASUREMENT_FILE, *(self.folder / name for name in own if name))
        if self.earlier is None:
            return found
        return (*found, self.earlier / "slope_map.nc", self.earlier / "absorber.csv")


def load_observer_plan(folder: Path) -> ObserverPlanMeasurement:
    """Read and check a folder with the plan of a pass over a trough.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The plan; every file it names exists.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, ObserverPlanModel)
    found = ObserverPlanMeasurement(folder, model)
    refuse_missing(file, found.input_files)
    return found
