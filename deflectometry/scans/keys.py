"""What measurement.toml of a scan of the surface may say."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from deflectometry.exchange.measure_slopes import SlopesEvaluationSection, SlopesMirrorSection
from deflectometry.scans.planning.keys import SurfacePlanSection
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import MeasurementModel, Number, Positive, Section, Text


class PointsSection(Section):
    """The points, and how well the scanner measures them."""

    file: Text = Field(description="Points: CSV (x_m, y_m, z_m[, normal_x, normal_y, normal_z]), PLY or E57.")
    unit: Literal["m", "mm"] = Field("m", description="Unit of the coordinates of PLY and E57.")
    sigma_point_mm: Positive | None = Field(
        None, description="Standard deviation of each coordinate of a point; default: from the points [mm]."
    )
    sigma_scale_ppm: Positive | None = Field(
        None, description="Standard deviation of the scanner's scale [ppm]; without it lengths count as exact."
    )
    scanner_m: tuple[Number, Number, Number] = Field(
        (0.0, 0.0, 0.0), description="Where the scanner stood, in the frame of the points; in front of the mirror [m]."
    )
    x_axis: tuple[Number, Number, Number] | None = Field(
        None,
        description="About which way the mirror's x axis points, in the frame of the points; default: by their axes.",
    )
    slopes_from: Literal["points", "normals"] = Field(
        "points", description="Slopes from patches of points, or from the normals that the file has."
    )
    sigma_normal_mrad: Positive | None = Field(
        None, description="Standard deviation of a normal's angle in one direction, for slopes from normals [mrad]."
    )


class ScanEvaluationSection(SlopesEvaluationSection):
    """Choices of the evaluation."""

    patch_mm: Positive | None = Field(
        None, description="Side of the patch of a slope; default: where noise and what the patch loses are least [mm]."
    )
    place: Literal["fit", "given"] = Field(
        "fit", description="Place of the mirror: fitted to the design, or the points are in its frame."
    )


class SurfaceScanModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "surface-scan"``."""

    kind: Literal["surface-scan"] = Field(description="Points of the mirror's surface.")
    points: PointsSection = Field(description="The points.")
    mirror: SlopesMirrorSection = Field(description="The mirror's design.")
    evaluation: ScanEvaluationSection = Field(ScanEvaluationSection(), description="Choices of the evaluation.")
    plan: SurfacePlanSection | None = Field(None, description="What is expected of a scan before it is made.")


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceScanMeasurement:
    """A checked scan of the surface: the content of measurement.toml, and where its files are."""

    folder: Path
    model: SurfaceScanModel

    @property
    def points_file(self) -> Path:
        """The points."""
        return self.folder / self.model.points.file

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        return (self.folder / MEASUREMENT_FILE, self.points_file)


def load_surface_scan(folder: Path) -> SurfaceScanMeasurement:
    """Read and check the folder of a scan of the surface.

    Returns: The measurement; its points exist.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, SurfaceScanModel)
    found = SurfaceScanMeasurement(folder, model)
    refuse_missing(file, found.input_files)
    return found
