"""Keys of measurement.toml of ``kind = "camera"``, and how it is read."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, model_validator

from heliogauge.errors import InputError
from heliogauge.measurement.files import image_files
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement
from heliogauge.measurement.models import Count, Intrinsic, MeasurementModel, PhotosSection, Positive, Section, Text


class CalibratedCameraSection(Section):
    """The camera to calibrate: its size, to check the photos against, and which intrinsics are estimated."""

    name: Text = Field("camera", description="Name of the camera in cameras.json.")
    width_px: Count | None = Field(None, description="Width of the photos, as a check [px].")
    height_px: Count | None = Field(None, description="Height of the photos, as a check [px].")
    free: Annotated[tuple[Intrinsic, ...], Field(min_length=1)] = Field(
        ("focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "p1", "p2", "k3"),
        description="Intrinsics that are estimated; the others are held at 0 or the middle.",
    )


class ChessboardSection(Section):
    """A chessboard; columns and rows count inner corners."""

    type: Literal["chessboard"] = Field(description="A chessboard.")
    columns: Count = Field(description="Inner corners in a row.")
    rows: Count = Field(description="Inner corners in a column; best even where columns is odd, or the reverse.")
    square_mm: Positive | None = Field(None, description="Side of a square; without it lengths are in squares [mm].")


class CharucoSection(Section):
    """A ChArUco board; columns and rows count squares."""

    type: Literal["charuco"] = Field(description="A ChArUco board.")
    columns: Count = Field(description="Squares in a row.")
    rows: Count = Field(description="Squares in a column.")
    square_mm: Positive = Field(description="Side of a square [mm].")
    marker_mm: Positive = Field(description="Side of a marker [mm].")
    dictionary: Text = Field(description="OpenCV's dictionary of the markers, such as DICT_5X5_100.")


class CircleGridSection(Section):
    """A grid of dots; in the asymmetric one every second row is shifted by half a pitch and rows are half as far."""

    type: Literal["circles", "circles-asymmetric"] = Field(
        description="A grid of dots; asymmetric: every second row shifted by half a pitch."
    )
    columns: Count = Field(description="Dots in a row.")
    rows: Count = Field(description="Rows of dots.")
    pitch_mm: Positive | None = Field(
        None, description="Distance of dots in a row; without it lengths are in pitches [mm]."
    )
    diameter_mm: Positive | None = Field(None, description="Diameter of the dots, for their eccentricity [mm].")

    @model_validator(mode="after")
    def _diameter_needs_the_pitch(self) -> Self:
        if self.diameter_mm is not None and self.pitch_mm is None:
            raise ValueError("diameter_mm means nothing without pitch_mm; give both or neither")
        return self


class TargetFieldSection(Section):
    """A plate with coded targets; the file has the columns id, x_m, y_m and perhaps z_m, known to a few per cent."""

    type: Literal["targets"] = Field(description="Ring-coded targets, on a plate or anywhere.")
    dictionary: Text = Field(description="Ring codes, such as aicon-12, or a file with one's own (.csv, .toml).")
    file: Text | None = Field(
        None, description="Rough places: columns id, x_m, y_m and perhaps z_m; default: not known."
    )

    @property
    def named_files(self) -> tuple[tuple[str, str], ...]:
        """Keys that name files, with the names."""
        own = self.dictionary if self.dictionary.lower().endswith((".csv", ".toml")) else None
        return tuple((key, name) for key, name in (("dictionary", own), ("file", self.file)) if name)


BoardSection = Annotated[
    ChessboardSection | CharucoSection | CircleGridSection | TargetFieldSection, Discriminator("type")
]


class CameraCalibrationModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "camera"``."""

    kind: Literal["camera"] = Field(description="Photos of a board or of targets that calibrate a camera.")
    camera: CalibratedCameraSection = Field(
        CalibratedCameraSection(), description="The camera, and what is estimated of it."
    )
    board: BoardSection = Field(description="The board or the targets.")
    images: PhotosSection = Field(description="The photos.")


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibrationMeasurement:
    """Checked photos of a calibration board: the content of measurement.toml, and where its files are.

    folder: The measurement's folder.
    model: The content of measurement.toml.
    """

    folder: Path
    model: CameraCalibrationModel
    photo_files: tuple[Path, ...]

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        board = self.model.board
        named = board.named_files if isinstance(board, TargetFieldSection) else ()
        return (self.folder / MEASUREMENT_FILE, *(self.folder / name for _, name in named), *self.photo_files)


def load_camera_calibration(folder: Path) -> CameraCalibrationMeasurement:
    """Read and check a folder with photos of a calibration board.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The measurement; every file it names exists.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, CameraCalibrationModel)
    for key, name in model.board.named_files if isinstance(model.board, TargetFieldSection) else ():
        if not (folder / name).is_file():
            raise InputError(f"{file}: board.{key} = {name!r}: there is no such file in {folder}")
    return CameraCalibrationMeasurement(folder, model, image_files(folder, "images.photos", model.images.photos))
