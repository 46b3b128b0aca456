"""What measurement.toml of ``kind = "backward-gazing"`` may say."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from deflectometry.field.keys import FieldCameraSection, HeliostatSection
from heliogauge.measurement.files import image_files
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement
from heliogauge.measurement.models import (
    ImageFiles,
    MeasurementModel,
    Number,
    Positive,
    Section,
    Sigma,
    repeated,
)


class SunCameraSection(Section):
    """Images of the sun by the camera on the sun, and where the sun stood."""

    frames: ImageFiles = Field(description="Its images while the others looked at the mirror.")
    dark: ImageFiles = Field(description="Its dark frames, same exposure.")
    flat: ImageFiles | None = Field(None, description="Images of an even source; default: all pixels respond alike.")
    flat_dark: ImageFiles | None = Field(None, description="Dark frames of the flat field; default: those of frames.")
    exposure_ms: Positive = Field(description="Exposure time [ms].")
    focal_px: Positive = Field(description="Focal length over pixel pitch: it scales the sun's profile [px].")
    sigma_focal_permille: Sigma = Field(0.0, description="Its standard deviation; 0: exactly known [permille].")
    saturation_dn: Positive | None = Field(
        None, description="Level that counts as saturated; default: the file format's largest [DN]."
    )
    azimuth_deg: Number = Field(description="The sun's centre while frames were taken: from north, clockwise [deg].")
    elevation_deg: Number = Field(gt=0, lt=90, description="Its apparent elevation [deg].")
    sigma_direction_mrad: Sigma = Field(
        0.0, description="Standard deviation of that direction, each way; a clock of 1 s is 0.07 [mrad]."
    )


class GazingCameraSection(FieldCameraSection):
    """A camera near the receiver: images of the mirror, of the sun through the same filter, darks and flats."""

    frames: ImageFiles = Field(description="Its images of the mirror that reflects the sun; several average noise.")
    dark: ImageFiles = Field(description="Dark frames of the same exposure time.")
    flat: ImageFiles | None = Field(None, description="Images of an even source (integrating sphere).")
    flat_dark: ImageFiles | None = Field(None, description="Dark frames of the flat field; default: those of frames.")
    exposure_ms: Positive = Field(description="Exposure time of frames [ms].")
    sun: ImageFiles = Field(description="Its images of the sun itself, through the same filter: they give its level.")
    sun_dark: ImageFiles | None = Field(None, description="Dark frames of sun; default: those of frames.")
    sun_exposure_ms: Positive = Field(description="Exposure time of sun [ms].")
    saturation_dn: Positive | None = Field(
        None, description="Level that counts as saturated; default: the file format's largest [DN]."
    )


class PhotometrySection(Section):
    """How well brightnesses compare."""

    reflectance: Positive = Field(0.93, le=1, description="Specular reflectance of the mirror within the sun's disc.")
    sigma_reflectance_percent: Positive = Field(
        2.0, description="Its standard deviation, all cameras together [percent]."
    )
    sigma_level_percent: Positive = Field(
        1.0, description="Standard deviation of each camera's level: filter, flat field, sunlight between [percent]."
    )
    sigma_missing_flat_percent: Positive = Field(
        3.0, description="Standard deviation of the level of a camera without a flat field [percent]."
    )


class GazingEvaluationSection(Section):
    """Choices of the evaluation; the command line can override them."""

    align: Literal["normal", "outline"] = Field(
        "normal", description="Slopes refer to the mirror's own mean normal, or to the nominal one (outline)."
    )
    grid_step_mm: Positive | None = Field(None, description="Step of the maps; default: 4 image pixels [mm].")
    remove: Literal["nothing", "tilt", "focus", "quadratic"] = Field(
        "nothing", description="What is taken out of the maps and headline numbers."
    )
    largest_sigma_mrad: Positive = Field(
        0.1, description="A point that the brightness leaves more uncertain is blind; 0.1: 1 % of 0.7 mrad SD [mrad]."
    )


class GazingModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "backward-gazing"``."""

    kind: Literal["backward-gazing"] = Field(description="The sun's image in a heliostat, from near the receiver.")
    sun: SunCameraSection = Field(description="The camera on the sun.")
    camera: Annotated[tuple[GazingCameraSection, ...], Field(min_length=3)] = Field(
        description="The cameras near the receiver, a table each; four or more."
    )
    mirror: HeliostatSection = Field(description="The heliostat.")
    photometry: PhotometrySection = Field(PhotometrySection(), description="How well brightnesses compare.")
    evaluation: GazingEvaluationSection = Field(GazingEvaluationSection(), description="Choices of the evaluation.")

    @model_validator(mode="after")
    def _cameras_differ(self) -> Self:
        if (twice := repeated(one.name for one in self.camera)) is not None:
            raise ValueError(f'two cameras are called "{twice}"; each needs its own name')
        for number, one in enumerate(self.camera):
            for other in self.camera[:number]:
                if one.place_m == other.place_m:
                    raise ValueError(f"cameras {other.name} and {one.name} have the same place_m")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class GazingMeasurement:
    """A checked measurement by backward gazing: the content of measurement.toml, and where its files are."""

    folder: Path
    model: GazingModel

    def files(self, key: str, named: str | tuple[str, ...]) -> tuple[Path, ...]:
        """Return the files that a key names."""
        return image_files(self.folder, key, named)

    def named_images(self) -> Iterator[tuple[str, str | tuple[str, ...]]]:
        """Yield the key path and the text of all images."""
        sections = [("sun", self.model.sun), *((f"camera.{one.name}", one) for one in self.model.camera)]
        for path, section in sections:
            for key in ("frames", "dark", "flat", "flat_dark", "sun", "sun_dark"):
                if (named := getattr(section, key, None)) is not None:
                    yield f"{path}.{key}", named

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        images = [file for key, named in self.named_images() for file in self.files(key, named)]
        cameras = (getattr(one.camera, "file", None) for one in self.model.camera)
        calibrations = [self.folder / file for file in cameras if file is not None]
        return tuple(dict.fromkeys([self.folder / MEASUREMENT_FILE, *calibrations, *images]))


def load_gazing(folder: Path) -> GazingMeasurement:
    """Read and check the folder of a measurement by backward gazing.

    Returns: The measurement; its images exist.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    found = GazingMeasurement(folder, read_measurement(folder, GazingModel)[1])
    for key, named in found.named_images():
        found.files(key, named)
    return found
