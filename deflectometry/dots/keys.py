"""What measurement.toml of ``kind = "deflectometry-dots"`` may say, and how it is read."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self, TypeVar

from pydantic import Field, field_validator, model_validator

from deflectometry.dots.planning.keys import DotsPlanSection
from deflectometry.keys import BenchMeasurement, BenchModel, DotFieldSection
from heliogauge.errors import InputError
from heliogauge.images.video_names import video_of
from heliogauge.measurement.files import refuse_missing_files
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement
from heliogauge.measurement.models import Section, Text, Vector2


class KnownDotSection(Section):
    """A dot whose place in the photo is known: ``[pattern.known_dot]``."""

    image_px: Vector2 = Field(description="Where it is in the photo, x and y, to half the distance of two dots [px].")
    column: int = Field(0, description="Its column in the table of the dots.")
    row: int = Field(0, description="Its row in the table of the dots.")


class DotPatternSection(Section):
    """The pattern that the mirror shows."""

    dots: Literal["dark", "light"] = Field("dark", description="Dark dots on light ground, or light ones on dark.")
    origin: Literal["light", "unmarked"] = Field(
        "unmarked",
        description="Whether a point light stands beside dot (0, 0); without, the geometry decides, with its odds.",
    )
    marks_file: Text | None = Field(
        None,
        description="Table of the dots' sizes, where two sizes mark their places: columns column, row, radius_m.",
    )
    known_dot: tuple[KnownDotSection, ...] = Field(
        (), description="A dot whose place in the photo is known; of several facets one for each, as a list of tables."
    )

    @field_validator("known_dot", mode="before")
    @classmethod
    def _one_is_a_list(cls, value: object) -> object:
        return (value,) if isinstance(value, dict) else value

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if self.origin == "light" and self.known_dot:
            raise ValueError('origin = "light" and [pattern.known_dot] are both given; leave one')
        return self


class DotFieldModel(BenchModel):
    """What every measurement before a field of dots has."""

    screen: DotFieldSection = Field(description="The field of dots: the place of each, and the pose of them all.")
    pattern: DotPatternSection = Field(DotPatternSection(), description="The pattern that the mirror shows.")

    def named_files(self) -> Iterator[tuple[str, str]]:
        """Yield the key path and the text of every file that is named."""
        yield "screen.file", self.screen.file
        if self.pattern.marks_file not in (None, self.screen.file):
            yield "pattern.marks_file", str(self.pattern.marks_file)
        if (camera := getattr(self.camera, "file", None)) is not None:
            yield "camera.file", camera


_Model = TypeVar("_Model", bound=DotFieldModel)


class DotsModel(DotFieldModel):
    """The whole measurement.toml of ``kind = "deflectometry-dots"``."""

    kind: Literal["deflectometry-dots"] = Field(description="A photo of a field of dots seen in a mirror.")
    photo: Text = Field(description="The photo in which the mirror shows the dots.")
    plan: DotsPlanSection = Field(DotsPlanSection(), description="What a plan expects of the photo.")

    def named_files(self) -> Iterator[tuple[str, str]]:
        """Yield the key path and the text of every file that is named."""
        yield "photo", self.photo
        yield from super().named_files()


@dataclass(frozen=True, slots=True, eq=False)
class DotsMeasurement(BenchMeasurement):
    """A checked measurement with dots.

    model: What measurement.toml says.
    """

    model: DotsModel

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        return (self.folder / MEASUREMENT_FILE, *(video_of(self.path(text)) for _, text in self.model.named_files()))


def load_dots(folder: Path) -> DotsMeasurement:
    """Read and check the folder of a measurement with dots.

    Parameters
    ----------
    folder : Path
        Folder with measurement.toml; the files it names are relative to it.

    Returns
    -------
    DotsMeasurement
        The measurement; every file it names exists.

    Raises
    ------
    InputError
        No such folder or file, not TOML, another kind, an unknown or missing key, or a value that cannot be.
    """
    return DotsMeasurement(folder, read_dot_field(folder, DotsModel))


def read_dot_field(folder: Path, kind: type[_Model]) -> _Model:
    """Read and check the measurement.toml of a kind of measurement before a field of dots.

    InputError: As `load_dots`.
    """
    file, model = read_measurement(folder, kind)
    refuse_missing_files(folder, model.named_files())
    if model.screen.response_file is not None:
        raise InputError(f"{file}: screen.response_file is for fringes; leave it out")
    return model
