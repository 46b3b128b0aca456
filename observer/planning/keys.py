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
    """Table of the targets, as of ``kind = "observer"``, or how many along the rims; how well their images are found.

    ``rim_count`` targets stand evenly along both rims, known to ``sigma_mm``.
    """

    file: Text | None = None
    rim_count: Annotated[int, Field(strict=True, ge=4, le=500)] | None = None
    sigma_mm: Positive = 1.0
    sigma_px: Positive = 0.1

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

    height_m: Positive = 15.0
    reach_m: Positive = 3.0
    photos: Annotated[int, Field(strict=True, ge=2, le=2000)] = 100
    y_m: Number = 0.0
    look_y_m: Number = 0.0


class PlannedMirrorSection(Section):
    """The mirror as it is expected: RMS slope errors, or the slope map of an earlier result."""

    slope_error_mrad: Positive = 3.0
    longitudinal_error_mrad: Sigma = 0.0
    like: Text | None = None
    seed: Annotated[int, Field(strict=True, ge=0)] = 0


class PlannedAbsorberSection(Section):
    """Whether the photos will tell the absorber's place, or its design is believed."""

    source: Literal["photos", "design"] = "photos"
    station_step_m: Positive = 0.25


class PlannedNoiseSection(Section):
    """How well edges are found, in pixels."""

    reflection_px: Positive = 0.05
    absorber_px: Positive = 0.05


class MonteCarloSection(Section):
    """Repeat the simulated measurement with everything uncertain disturbed; ``runs = 0`` does without."""

    runs: Annotated[int, Field(strict=True, ge=0, le=5000)] = 0
    row_step_mm: Positive = 200.0
    seed: Annotated[int, Field(strict=True, ge=0)] = 0


class ObserverPlanModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "observer-plan"``."""

    kind: Literal["observer-plan"]
    collector: TroughSection
    camera: NetworkCameraSection
    targets: PlannedTargetsSection = PlannedTargetsSection()
    scale_bar: tuple[ScaleBarSection, ...] = ()
    distance: tuple[DistanceSection, ...] = ()
    flight: Annotated[tuple[PlannedPassSection, ...], Field(min_length=1)] = (PlannedPassSection(),)
    mirror: PlannedMirrorSection = PlannedMirrorSection()
    absorber: PlannedAbsorberSection = PlannedAbsorberSection()
    noise: PlannedNoiseSection = PlannedNoiseSection()
    monte_carlo: MonteCarloSection = MonteCarloSection()
    evaluation: ObserverEvaluationSection = ObserverEvaluationSection()

    @model_validator(mode="after")
    def _planned_camera(self) -> Self:
        if not self.camera.is_known or not self.camera.has_size:
            raise ValueError("camera: give a file, or width_px, height_px and focal_px; a plan has no photos to tell")
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
        """Folder of the earlier result that tells mirror and absorber; None where a typical mirror stands for it."""
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
