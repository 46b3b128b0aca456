"""What measurement.toml of ``kind = "deflectometry-dots-series"`` may say, and how it is read."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from deflectometry.dots.keys import DotFieldModel, DotPatternSection, DotsMeasurement, DotsModel, read_dot_field
from deflectometry.keys import BenchMeasurement
from heliogauge.measurement.files import image_files
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.measurement.models import Count, ImageFiles, Positive, Section, Text


class FramesSection(Section):
    """The frames: photos with their times, or a video."""

    photos: ImageFiles | None = Field(None, description="Photos in the order in which they were taken.")
    times_file: Text | None = Field(
        None, description="When each photo was taken: CSV with image and time_s [s]; default: frame_rate_hz."
    )
    video: Text | None = Field(None, description="A video; its frames are the photos.")
    every_nth: Count = Field(1, description="Of a video only every nth frame.")
    frame_rate_hz: Positive | None = Field(
        None, description="Frames in a second; default: as the video says, else times are numbers of frames [1/s]."
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.photos is None) == (self.video is None):
            raise ValueError("one of photos and video must say which frames there are")
        if self.times_file is not None and (self.video is not None or self.frame_rate_hz is not None):
            raise ValueError("times_file goes with photos, in the place of frame_rate_hz")
        return self


class DotSeriesModel(DotFieldModel):
    """The whole measurement.toml of ``kind = "deflectometry-dots-series"``."""

    kind: Literal["deflectometry-dots-series"] = Field(description="Photos of dots seen in a mirror that moves.")
    frames: FramesSection = Field(description="The frames.")
    pattern: DotPatternSection = Field(
        DotPatternSection(), description="The pattern that the mirror shows; a known dot is one of the first frame."
    )

    def named_files(self) -> Iterator[tuple[str, str]]:
        """Yield the key path and the text of every single file that is named (photos are not among them)."""
        yield from super().named_files()
        candidates = (("frames.video", self.frames.video), ("frames.times_file", self.frames.times_file))
        yield from ((key, text) for key, text in candidates if text is not None)


@dataclass(frozen=True, slots=True, eq=False)
class DotSeriesMeasurement(BenchMeasurement):
    """A checked series of photos of dots.

    model: What measurement.toml says.
    photo_files: Photos that a pattern or list names; empty for a video.
    """

    model: DotSeriesModel
    photo_files: tuple[Path, ...]

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        named = (self.path(text) for _, text in self.model.named_files())
        return (self.folder / MEASUREMENT_FILE, *named, *self.photo_files)

    def of_frame(self, frame: Path) -> DotsMeasurement:
        """Return the measurement that one frame is by itself."""
        shared = self.model.model_dump(mode="json", exclude_unset=True, exclude={"kind", "frames"})
        name = str(frame.relative_to(self.folder))
        return DotsMeasurement(self.folder, DotsModel(kind="deflectometry-dots", photo=name, **shared))


def load_series(folder: Path) -> DotSeriesMeasurement:
    """Read and check the folder of a series of photos of dots.

    Parameters
    ----------
    folder : Path
        Folder with measurement.toml; the files it names are relative to it.

    Returns
    -------
    DotSeriesMeasurement
        The measurement; every file it names exists.

    Raises
    ------
    InputError
        No such folder or file, not TOML, another kind, an unknown or missing key, or a value that cannot be.
    """
    model = read_dot_field(folder, DotSeriesModel)
    photos = model.frames.photos
    files = () if photos is None else image_files(folder, "frames.photos", photos)
    return DotSeriesMeasurement(folder, model, files)
