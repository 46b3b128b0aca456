"""Keys of measurement.toml of ``kind = "response"``, and how it is read."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from heliogauge.errors import InputError
from heliogauge.measurement.files import image_files
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement
from heliogauge.measurement.models import ImageFiles, Index, MeasurementModel, Positive, Section, Sigma


class DisplaySection(Section):
    """The grey levels that were shown, in the order of the photographs."""

    levels: Annotated[tuple[Sigma, ...], Field(min_length=3)] = Field(
        description="Grey levels that were displayed, ascending, in the order of the photographs."
    )
    full_level: Positive = Field(
        255.0, description="The display's brightest level: 255 for 8 bit, 1 for levels written as fractions."
    )

    @model_validator(mode="after")
    def _ascending_within_the_range(self) -> Self:
        for position, (level, following) in enumerate(pairwise(self.levels), start=1):
            if following <= level:
                raise ValueError(
                    f"levels must ascend, but level {position} is {level:g} and level {position + 1} is {following:g}; "
                    "put photographs and levels in the order dark to bright"
                )
        if self.levels[-1] > self.full_level:
            raise ValueError(f"level {self.levels[-1]:g} is above full_level = {self.full_level:g}")
        return self


class GreyImagesSection(Section):
    """Photographs of the grey levels, relative to the folder; a text with ``*`` stands for all files that match."""

    grey: ImageFiles = Field(description="One photograph for each level: a text with * (natural order) or a list.")
    saturation_dn: Positive | None = Field(
        None, description="Level that counts as saturated; default: the file format's largest [DN]."
    )
    region_px: tuple[Index, Index, Index, Index] | None = Field(
        None, description="x, y of the first and last pixel to use; default: pixels that brighten [px]."
    )

    @model_validator(mode="after")
    def _region_has_an_area(self) -> Self:
        if self.region_px is not None:
            x_first, y_first, x_last, y_last = self.region_px
            if x_last < x_first or y_last < y_first:
                raise ValueError(f"region_px = {list(self.region_px)}: x and y of the last pixel are below the first")
        return self


class ResponseModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "response"``."""

    kind: Literal["response"] = Field(
        description="Photographs of uniform grey levels: the response of camera and display."
    )
    display: DisplaySection = Field(description="The levels that were displayed.")
    images: GreyImagesSection = Field(description="The photographs.")


@dataclass(frozen=True, slots=True, eq=False)
class ResponseMeasurement:
    """Checked photographs of grey levels: the content of measurement.toml, and where its files are.

    folder: The measurement's folder.
    model: The content of measurement.toml.
    grey_files: Photograph of each level, in the order of the levels.
    """

    folder: Path
    model: ResponseModel
    grey_files: tuple[Path, ...]

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        return (self.folder / MEASUREMENT_FILE, *self.grey_files)


def load_response(folder: Path) -> ResponseMeasurement:
    """Read and check a folder with photographs of grey levels.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The measurement; every file it names exists.
    InputError: As for `heliogauge.measurement.load.read_measurement`; or a number of photographs that differs from that
        of the levels.
    """
    file, model = read_measurement(folder, ResponseModel)
    grey_files = image_files(folder, "images.grey", model.images.grey)
    if len(grey_files) != len(model.display.levels):
        raise InputError(
            f"{file}: images.grey = {model.images.grey!r} gives {len(grey_files)} files, but display.levels has "
            f"{len(model.display.levels)} levels; one photograph for each level is needed, in the same order"
        )
    return ResponseMeasurement(folder, model, grey_files)
