"""Read the measurement.toml of a photo network, and the tables that it names."""

from dataclasses import dataclass, replace
from pathlib import Path

from heliogauge.images.video_names import video_of
from heliogauge.measurement.files import image_files
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.short_repr import ShortRepr
from photogrammetry.bundle.constraints import Constraint
from photogrammetry.keys.known_files import with_known_files
from photogrammetry.keys.measurement import PhotogrammetryModel


@dataclass(frozen=True, slots=True, eq=False)
class PhotogrammetryMeasurement(ShortRepr):
    """Checked photos, or image points, of targets: what the file says, and where its files are.

    folder: The measurement's folder.
    model: What measurement.toml says.
    photo_files: The photos; none with image points.
    known: What is known of targets that no file says, by whoever measures the network for a purpose of his own.
    """

    folder: Path
    model: PhotogrammetryModel
    photo_files: tuple[Path, ...]
    known: tuple[Constraint, ...] = ()

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        model = self.model
        named = [*(one.file for one in model.camera), model.image_points and model.image_points.file]
        named += [] if model.start is None else model.start.names
        named += model.files.names
        named += [] if model.targets is None else model.targets.names
        named += [] if model.positions is None else [model.positions.file]
        named += [] if model.surface is None else model.surface.names
        images = dict.fromkeys(video_of(file) for file in self.photo_files)
        return (self.folder / MEASUREMENT_FILE, *(self.folder / name for name in named if name), *images)

    def with_tables(self) -> "PhotogrammetryMeasurement":
        """Return the same with what the tables of ``[files]`` say in the model.

        InputError: A table that cannot be used.
        """
        return replace(self, model=with_known_files(self.model, self.folder))


def load_photogrammetry(folder: Path) -> PhotogrammetryMeasurement:
    """Read and check a folder with photos, or image points, of targets.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The measurement; every file it names exists.
    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, PhotogrammetryModel)
    photos = () if model.images is None else image_files(folder, "images.photos", model.images.photos)
    found = PhotogrammetryMeasurement(folder, model, photos)
    refuse_missing(file, found.input_files)
    return found.with_tables()
