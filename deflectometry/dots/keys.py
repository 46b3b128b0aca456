"""What measurement.toml of ``kind = "deflectometry-dots"`` may say, and how it is read."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from deflectometry.keys import BenchMeasurement, BenchModel, DotFieldSection
from heliogauge.errors import InputError
from heliogauge.images.video_names import video_of
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


class DotsModel(BenchModel):
    """The whole measurement.toml of ``kind = "deflectometry-dots"``."""

    kind: Literal["deflectometry-dots"] = Field(description="A photo of a field of dots seen in a mirror.")
    screen: DotFieldSection = Field(description="The field of dots: the place of each, and the pose of them all.")
    photo: Text = Field(description="The photo in which the mirror shows the dots.")
    pattern: DotPatternSection = Field(DotPatternSection(), description="The pattern that the mirror shows.")

    def named_files(self) -> Iterator[tuple[str, str]]:
        """Yield the key path and the text of every file that is named."""
        yield "photo", self.photo
        yield "screen.file", self.screen.file
        if self.pattern.marks_file not in (None, self.screen.file):
            yield "pattern.marks_file", str(self.pattern.marks_file)
        if (camera := getattr(self.camera, "file", None)) is not None:
            yield "camera.file", camera


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
    file, model = read_measurement(folder, DotsModel)
    missing = [f"{key} = {text!r}" for key, text in model.named_files() if not (folder / text).is_file()]
    if missing:
        raise InputError(f"{file}: {', '.join(missing)}: there is no such file in {folder}")
    if model.screen.response_file is not None:
        raise InputError(f"{file}: screen.response_file is for fringes; leave it out")
    return DotsMeasurement(folder, model)
