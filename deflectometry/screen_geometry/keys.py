"""What measurement.toml of ``kind = "screen-geometry"`` may say, and how it is read."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from deflectometry.screen_geometry.planning.keys import ScreenPlanSection
from heliogauge.errors import InputError
from heliogauge.measurement.files import image_files
from heliogauge.measurement.load import read_measurement, refuse_missing
from heliogauge.measurement.models import Section, Text, Vector2
from heliogauge.short_repr import ShortRepr
from photogrammetry.keys import PhotogrammetryMeasurement, PhotogrammetryModel

#: Keys that are not those of a photo network.
_OF_THE_SCREEN = {"kind", "measuring_photo", "dots", "display", "shape", "plan"}


class KnownWallDotSection(Section):
    """A dot of the field whose place in one of the photos is known: ``[dots.known_dot]``."""

    photo: Text = Field(description="Name of the photo.")
    image_px: Vector2 = Field(description="Where the dot is in it, x and y, to half the distance of two dots [px].")
    column: int = Field(0, description="Its column.")
    row: int = Field(0, description="Its row.")


class WallDotsSection(Section):
    """The field of dots that the photos show."""

    dots: Literal["dark", "light"] = Field("dark", description="Dark dots on light ground, or light ones on dark.")
    origin: Literal["corner", "light"] = Field(
        "corner",
        description="Which dot is (0, 0): the lower left one, as the first photo has it, or that beside a point light.",
    )
    known_dot: KnownWallDotSection | None = Field(None, description="A dot whose place in a photo is known.")

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if self.origin != "corner" and self.known_dot is not None:
            raise ValueError(f'origin = "{self.origin}" and [dots.known_dot] are both given; leave one')
        return self


class DisplaySection(Section):
    """A display whose surface is measured by coded targets at known fractions of the displayed image."""

    file: Text = Field(
        description="Table of coded targets on the display or at its rims: columns target, u, v (fractions of the "
        "displayed image from its left and from its top edge). A name without a corner's number (23 for 23.0 to 23.3) "
        "stands for the middle of a square marker."
    )


class ShapeSection(Section):
    """How the screen is described."""

    form: Literal["auto", "plane", "bent", "free"] = Field(
        "auto",
        description="Surface of a display: a plane, bent (second order), free (fourth order); default: the simplest "
        "that the points do not contradict. A field of dots keeps the place of each dot.",
    )
    frame: Literal["screen", "network"] = Field(
        "screen",
        description="Frame of the result: the screen's own (origin in its middle, x right, y up, z towards the "
        "viewer), or that of the control points.",
    )


class ScreenGeometryModel(PhotogrammetryModel):
    """The whole measurement.toml of ``kind = "screen-geometry"``: a photo network, and what of it is the screen."""

    kind: Literal["screen-geometry"] = Field(  # type: ignore[assignment]
        description="Photos of a screen or wall, to its geometry."
    )
    measuring_photo: Text | None = Field(
        None,
        description="The photo that the camera of the deflectometry measurement took from its place, one of the "
        "photos; its pose to the screen is a result.",
    )
    dots: WallDotsSection | None = Field(None, description="The field of dots, printed or displayed.")
    display: DisplaySection | None = Field(None, description="The display, known by coded targets at its rims.")
    shape: ShapeSection = Field(ShapeSection(), description="How the screen is described.")
    plan: ScreenPlanSection | None = Field(None, description="What a plan expects of photos that are not there yet.")

    @model_validator(mode="after")
    def _dots_or_display(self) -> Self:
        if (self.dots is None) == (self.display is None):
            raise ValueError("give [dots] for a field of dots, or [display] for coded targets at the rims, one of both")
        if self.images is None or self.targets is None:
            raise ValueError("[images] with photos and [targets] are needed")
        if not (self.scale_bar or self.control_point or self.files.names):
            raise ValueError(
                "the size of the screen is not determined; give a [[scale_bar]] or [[control_point]], or a table of "
                "them in [files]"
            )
        return self


@dataclass(frozen=True, slots=True, eq=False)
class ScreenMeasurement(ShortRepr):
    """Checked photos of a screen.

    folder: The measurement's folder.
    model: What measurement.toml says.
    photo_files: The photos.
    """

    folder: Path
    model: ScreenGeometryModel
    photo_files: tuple[Path, ...]

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        model = self.model
        own = [] if model.display is None else [model.display.file]
        network = PhotogrammetryMeasurement(self.folder, model, self.photo_files).input_files
        return (*network, *(self.folder / one for one in own))

    @property
    def network(self) -> PhotogrammetryMeasurement:
        """The same as a photo network."""
        keys = self.model.model_dump(exclude_unset=True, exclude=_OF_THE_SCREEN)
        keys["targets"]["find_uncoded"] = False
        network = PhotogrammetryModel.model_validate(keys | {"kind": "photogrammetry"})
        return PhotogrammetryMeasurement(self.folder, network, self.photo_files).with_tables()


def load_screen(folder: Path) -> ScreenMeasurement:
    """Read and check the folder of a screen's photos.

    Parameters
    ----------
    folder : Path
        Folder with measurement.toml; the files it names are relative to it.

    Returns
    -------
    ScreenMeasurement
        The measurement; every file it names exists.

    Raises
    ------
    InputError
        No such folder or file, not TOML, another kind, an unknown or missing key, or a value that cannot be.
    """
    file, model = read_measurement(folder, ScreenGeometryModel)
    section = model.images
    photos = () if section is None else image_files(folder, "images.photos", section.photos)
    measurement = ScreenMeasurement(folder, model, photos)
    refuse_missing(file, measurement.input_files)
    names = {one.name for one in photos}
    stated = [("measuring_photo", model.measuring_photo)]
    if model.dots is not None and model.dots.known_dot is not None:
        stated.append(("dots.known_dot.photo", model.dots.known_dot.photo))
    for key, name in stated:
        if name is not None and name not in names:
            raise InputError(f"{file}: {key} = {name!r} is none of the {len(photos)} photos of images.photos")
    return measurement
