"""What measurement.toml of a theoretical overlay may say."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from deflectometry.keys import CameraSection, MirrorSection
from deflectometry.overlay.planning.keys import OverlayPlanSection
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.measurement.models import MeasurementModel, Positive, Section, Sigma, Text, Vector3, repeated


class SourceSection(Section):
    """The bright source that the facets show: its shape and its place before the heliostat."""

    shape: Literal["rectangle", "disc"] = Field(description="A bright rectangle, or a disc.")
    width_m: Positive | None = Field(None, description="Width of a rectangle, along its x [m].")
    height_m: Positive | None = Field(None, description="Height of a rectangle, along its y [m].")
    diameter_m: Positive | None = Field(None, description="Diameter of a disc [m].")
    center_m: Vector3 = Field(description="Its middle in the heliostat's frame [m].")
    rotation_vector_rad: Vector3 = Field(
        (0.0, 0.0, 0.0), description="From the source's axes to the heliostat's, as a vector; it lies in x and y [rad]."
    )
    sigma_center_mm: Sigma = Field(0.0, description="Standard deviation of each coordinate of its middle [mm].")

    @model_validator(mode="after")
    def _sizes(self) -> Self:
        needed = ("width_m", "height_m") if self.shape == "rectangle" else ("diameter_m",)
        missing = [name for name in needed if getattr(self, name) is None]
        if missing:
            raise ValueError(f'shape = "{self.shape}" needs {" and ".join(missing)}')
        return self


class PointsSection(Section):
    """Points of known place on the heliostat, such as corners of facets: they say where each camera stood."""

    file: Text = Field(description="Table (CSV): photo, x_m, y_m, z_m in the heliostat's frame, x_px, y_px.")
    sigma_px: Positive = Field(0.2, description="Standard deviation of each image coordinate of a point [px].")


class OverlayPhotoSection(Section):
    """One photo, and where it was taken."""

    file: Text = Field(description="The photo.")
    place_m: Vector3 | None = Field(
        None,
        description="Where its camera stood, surveyed, in the heliostat's frame; default: from the points alone [m].",
    )
    sigma_place_mm: Positive = Field(10.0, description="Standard deviation of each coordinate of place_m [mm].")


class OverlayModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "overlay"``."""

    kind: Literal["overlay"] = Field(description="Photos of a heliostat whose facets show a bright source.")
    camera: CameraSection = Field(description="The camera: a file from a calibration, or its parameters.")
    source: SourceSection = Field(description="The source.")
    points: PointsSection = Field(description="Points that place the cameras.")
    photo: Annotated[tuple[OverlayPhotoSection, ...], Field(min_length=1)] = Field(
        description="Photos of all facets, one table each; three from different places are better than one."
    )
    mirror: MirrorSection = Field(description="The heliostat: its facets, each with its design, place and mounts.")
    plan: OverlayPlanSection = Field(
        OverlayPlanSection(), description="What a plan expects of photos that are not there yet."
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if not self.mirror.facet:
            raise ValueError("mirror.facet is missing; one table [[mirror.facet]] for each facet is needed")
        if (twice := repeated(one.file for one in self.photo)) is not None:
            raise ValueError(f"photo.file names {twice!r} twice")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class OverlayMeasurement:
    """A checked overlay: the content of measurement.toml, and where its files are."""

    folder: Path
    model: OverlayModel

    @property
    def photo_files(self) -> tuple[Path, ...]:
        """The photos."""
        return tuple(self.folder / one.file for one in self.model.photo)

    @property
    def points_file(self) -> Path:
        """Points of known place."""
        return self.folder / self.model.points.file

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        return (*self.files_before, self.points_file, *self.photo_files)

    @property
    def files_before(self) -> tuple[Path, ...]:
        """Those that are there before any photo is taken, measurement.toml first."""
        file = getattr(self.model.camera, "file", None)
        return (self.folder / MEASUREMENT_FILE, *(() if file is None else (self.folder / file,)))


def load_overlay(folder: Path) -> OverlayMeasurement:
    """Read and check the folder of an overlay.

    Returns: The measurement; its files exist.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    found = load_overlay_plan(folder)
    refuse_missing(folder / MEASUREMENT_FILE, found.input_files)
    return found


def load_overlay_plan(folder: Path) -> OverlayMeasurement:
    """Read and check the folder of an overlay whose photos and points need not be there yet.

    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, OverlayModel)
    found = OverlayMeasurement(folder, model)
    refuse_missing(file, found.files_before)
    return found
