"""What measurement.toml of ``kind = "camera"`` may say, and how it is read."""

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

    name: Text = "camera"
    width_px: Count | None = None
    height_px: Count | None = None
    free: Annotated[tuple[Intrinsic, ...], Field(min_length=1)] = (
        "focal_px",
        "aspect",
        "center_x_px",
        "center_y_px",
        "k1",
        "k2",
        "p1",
        "p2",
        "k3",
    )


class ChessboardSection(Section):
    """A chessboard; columns and rows count inner corners."""

    type: Literal["chessboard"]
    columns: Count
    rows: Count
    square_mm: Positive | None = None


class CharucoSection(Section):
    """A ChArUco board; columns and rows count squares."""

    type: Literal["charuco"]
    columns: Count
    rows: Count
    square_mm: Positive
    marker_mm: Positive
    dictionary: Text


class CircleGridSection(Section):
    """A grid of dots; in the asymmetric one every second row is shifted by half a pitch and rows are half as far."""

    type: Literal["circles", "circles-asymmetric"]
    columns: Count
    rows: Count
    pitch_mm: Positive | None = None
    diameter_mm: Positive | None = None

    @model_validator(mode="after")
    def _diameter_needs_the_pitch(self) -> Self:
        if self.diameter_mm is not None and self.pitch_mm is None:
            raise ValueError("diameter_mm says nothing without pitch_mm; give both or neither")
        return self


class TargetFieldSection(Section):
    """A plate with coded targets; the file has the columns id, x_m, y_m and perhaps z_m, known to a few per cent.

    Without a file nothing is known of the targets' places, and they need not be near a plane. A dictionary that ends in
    .csv or .toml is a file with ring codes of one's own.
    """

    type: Literal["targets"]
    dictionary: Text
    file: Text | None = None

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

    kind: Literal["camera"]
    camera: CalibratedCameraSection = CalibratedCameraSection()
    board: BoardSection
    images: PhotosSection


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibrationMeasurement:
    """Checked photos of a calibration board: what the file says, and where its files are.

    folder: The measurement's folder.
    model: What measurement.toml says.
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
