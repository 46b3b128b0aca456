"""What measurement.toml of a laser scan may say."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from deflectometry.exchange.measure_slopes import SlopesEvaluationSection, SlopesMirrorSection
from deflectometry.laser.planning.keys import LaserPlanSection
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import MeasurementModel, Positive, Section, Sigma, Text, Vector2


class ScanSection(Section):
    """The beams and their spots, or the lines of two sweeps, and how well the instrument is known."""

    file: Text | None = Field(
        None, description="Table (CSV): direction_x, direction_y, direction_z, spot_x_m, spot_y_m[, spot_z_m]."
    )
    lines_file: Text | None = Field(
        None,
        description="Of a line laser instead: sweep, line, normal_x, normal_y, normal_z, spot_x_m, spot_y_m (CSV).",
    )
    sigma_spot_mm: Positive = Field(
        description="Standard deviation of each spot in x and in y, or of each point of a line across it [mm]."
    )
    sigma_direction_mrad: Sigma = Field(
        0.0,
        description="Standard deviation of each beam's direction, or of each sheet of light across it [mrad].",
    )
    sigma_laser_place_mm: Positive | None = Field(
        None, description="Standard deviation of the laser's place on the target, each axis [mm]."
    )
    sigma_target_scale_permille: Positive | None = Field(
        None, description="Standard deviation of the scale of the spots' coordinates, each axis [permille]."
    )
    sigma_angle_scale_permille: Positive | None = Field(
        None, description="Standard deviation of the scale of the beams' angles, each axis [permille]."
    )
    sigma_roll_mrad: Positive | None = Field(
        None, description="Standard deviation of the turn between the beams' axes and the target's [mrad]."
    )

    @model_validator(mode="after")
    def _one_table(self) -> Self:
        if (self.file is None) == (self.lines_file is None):
            raise ValueError("give file (beams one by one) or lines_file (two sweeps of a line laser), one of both")
        return self


class LaserMirrorSection(SlopesMirrorSection):
    """The mirror's design, and where it stands before the laser."""

    distance_m: Positive = Field(description="From the laser to the origin of the mirror's frame, along z [m].")
    sigma_distance_mm: Positive | None = Field(None, description="Its standard deviation [mm].")
    offset_m: Vector2 = Field(
        (0.0, 0.0), description="The mirror's origin beside the laser: x to the right, y up, seen from there [m]."
    )
    sigma_offset_mm: Positive | None = Field(None, description="Standard deviation of each [mm].")


class LaserEvaluationSection(SlopesEvaluationSection):
    """Choices of the evaluation."""

    align: Literal["normal", "outline"] = Field(
        "normal", description="Orientation: as the slopes have it, or the mirror's frame parallel to the laser's."
    )


class LaserModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "laser-scan"``."""

    kind: Literal["laser-scan"] = Field(description="Beams of a laser and the spots they make after a mirror.")
    scan: ScanSection = Field(description="The beams and their spots.")
    mirror: LaserMirrorSection = Field(description="The mirror's design and place.")
    evaluation: LaserEvaluationSection = Field(LaserEvaluationSection(), description="Choices of the evaluation.")
    plan: LaserPlanSection | None = Field(None, description="What a plan expects of mirror, beams and target.")


@dataclass(frozen=True, slots=True, eq=False)
class LaserMeasurement:
    """A checked laser scan: the content of measurement.toml, and where its files are."""

    folder: Path
    model: LaserModel

    @property
    def scan_file(self) -> Path:
        """Table of the beams or of the lines."""
        return self.folder / str(self.model.scan.file or self.model.scan.lines_file)

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        return (self.folder / MEASUREMENT_FILE, self.scan_file)


def load_laser(folder: Path) -> LaserMeasurement:
    """Read and check the folder of a laser scan.

    Returns: The measurement; its table exists.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, LaserModel)
    found = LaserMeasurement(folder, model)
    refuse_missing(file, found.input_files)
    return found
