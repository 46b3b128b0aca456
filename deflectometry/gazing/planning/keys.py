"""What measurement.toml of ``kind = "backward-gazing-plan"`` may say."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import MeasurementModel, Positive, Section, Sigma, Text


class PlannedSunSection(Section):
    """The sun: a profile that was measured, or a disc with limb darkening."""

    profile: Text | None = Field(
        None, description="Table angle_mrad, radiance: sun_profile.csv of an earlier result, or a .sun of SolTrace."
    )
    circumsolar_ratio: Sigma = Field(
        0.02, le=0.8, description="Without a profile: circumsolar ratio of the sun shape of Buie et al."
    )


class PlannedGazingSection(Section):
    """What is expected of mirror and cameras."""

    distance_m: Positive = Field(description="From the cameras to the heliostat [m].")
    incidence_deg: Sigma = Field(0.0, lt=80, description="Angle between the normal and the sun [deg].")
    slope_error_mrad: Positive = Field(
        1.0, description="Slopes that are expected against the aim: canting and shape together, RMS each way [mrad]."
    )
    noise_percent: Positive = Field(
        0.3,
        description="Noise of a mirror point's light over the sun's middle: a pixel's by the root of pixels.",
    )
    largest_sigma_mrad: Positive = Field(0.1, description="A point that is known worse is blind [mrad].")


class PlannedCamerasSection(Section):
    """Spacings that are compared: sides of a square of four cameras."""

    closest_m: Positive = Field(0.1, description="Smallest side of the square [m].")
    farthest_m: Positive = Field(2.0, description="Largest side of the square [m].")
    with_middle: bool = Field(False, description="Whether a fifth camera stands in the middle.")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.closest_m >= self.farthest_m:
            raise ValueError("closest_m: it must be smaller than farthest_m")
        return self


class GazingPlanModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "backward-gazing-plan"``."""

    kind: Literal["backward-gazing-plan"] = Field(description="Plan of a measurement by backward gazing.")
    expected: PlannedGazingSection = Field(description="What is expected of mirror and cameras.")
    sun: PlannedSunSection = Field(PlannedSunSection(), description="The sun.")
    cameras: PlannedCamerasSection = Field(PlannedCamerasSection(), description="Spacings that are compared.")


@dataclass(frozen=True, slots=True, eq=False)
class GazingPlanMeasurement:
    """A checked plan: the content of measurement.toml, and where its files are."""

    folder: Path
    model: GazingPlanModel

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files of the plan, measurement.toml first."""
        profile = self.model.sun.profile
        return (self.folder / MEASUREMENT_FILE, *(() if profile is None else (self.folder / profile,)))


def load_gazing_plan(folder: Path) -> GazingPlanMeasurement:
    """Read and check the folder of a plan.

    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, GazingPlanModel)
    found = GazingPlanMeasurement(folder, model)
    refuse_missing(file, found.input_files)
    return found
