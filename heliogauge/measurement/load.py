"""Read measurement.toml and check it before any work is done.

`load_measurement` is the border: whatever it returns is complete, in range, and names files that exist. Everything
else ends as one `InputError` that names file, key, value and remedy.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from calibration.heliostat.keys import HeliostatMeasurement, HeliostatModel, paint_measurement
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.images.video_names import video_of
from heliogauge.measurement.faults import fault_lines
from heliogauge.measurement.files import image_files
from heliogauge.measurement.models import (
    CameraCalibrationModel,
    DeflectometryModel,
    ResponseModel,
    TargetFieldSection,
)
from observer.keys import ObserverMeasurement, ObserverModel
from observer.planning.keys import ObserverPlanMeasurement, ObserverPlanModel
from photogrammetry.keys import PhotogrammetryModel
from photogrammetry.keys.known_files import with_known_files
from photogrammetry.planning.keys import PhotogrammetryPlanMeasurement, PhotogrammetryPlanModel

MEASUREMENT_FILE = "measurement.toml"
Model = (
    DeflectometryModel
    | ResponseModel
    | CameraCalibrationModel
    | PhotogrammetryModel
    | PhotogrammetryPlanModel
    | ObserverModel
    | ObserverPlanModel
    | HeliostatModel
)
_ModelT = TypeVar("_ModelT", bound=BaseModel)
KINDS: dict[str, type[Model]] = {
    "deflectometry": DeflectometryModel,
    "response": ResponseModel,
    "camera": CameraCalibrationModel,
    "photogrammetry": PhotogrammetryModel,
    "photogrammetry-plan": PhotogrammetryPlanModel,
    "observer": ObserverModel,
    "observer-plan": ObserverPlanModel,
    "heliostat": HeliostatModel,
}
#: The command that evaluates each kind, for whoever calls the wrong one.
COMMANDS = {
    "deflectometry": "heliogauge deflectometry",
    "response": "heliogauge calibrate response",
    "camera": "heliogauge calibrate camera",
    "photogrammetry": "heliogauge photogrammetry",
    "photogrammetry-plan": "heliogauge photogrammetry plan",
    "observer": "heliogauge observer",
    "observer-plan": "heliogauge observer plan",
    "heliostat": "heliogauge calibrate heliostat",
}


@dataclass(frozen=True, slots=True, eq=False)
class DeflectometryMeasurement:
    """A checked deflectometry measurement: what the file says, and where its files are.

    folder: The measurement's folder.
    model: What measurement.toml says.
    fringe_files: Image of each frame, in the order of the pattern.
    """

    folder: Path
    model: DeflectometryModel
    fringe_files: tuple[Path, ...]

    def path(self, text: str) -> Path:
        """Return the path of a file named in measurement.toml."""
        return self.folder / text

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        named = (self.path(text) for _, text in self.model.named_files())
        return (self.folder / MEASUREMENT_FILE, *named, *self.fringe_files)


@dataclass(frozen=True, slots=True, eq=False)
class ResponseMeasurement:
    """Checked photographs of grey levels: what the file says, and where its files are.

    folder: The measurement's folder.
    model: What measurement.toml says.
    grey_files: Photograph of each level, in the order of the levels.
    """

    folder: Path
    model: ResponseModel
    grey_files: tuple[Path, ...]

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        return (self.folder / MEASUREMENT_FILE, *self.grey_files)


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


@dataclass(frozen=True, slots=True, eq=False)
class PhotogrammetryMeasurement:
    """Checked photos, or image points, of targets: what the file says, and where its files are.

    folder: The measurement's folder.
    model: What measurement.toml says.
    photo_files: The photos; none with image points.
    """

    folder: Path
    model: PhotogrammetryModel
    photo_files: tuple[Path, ...]

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        model = self.model
        named = [*(one.file for one in model.camera), model.image_points and model.image_points.file]
        named += [] if model.start is None else model.start.names
        named += model.files.names
        named += [] if model.targets is None else model.targets.names
        named += [] if model.surface is None else model.surface.names
        images = dict.fromkeys(video_of(file) for file in self.photo_files)
        return (self.folder / MEASUREMENT_FILE, *(self.folder / name for name in named if name), *images)


def load_measurement(folder: Path) -> DeflectometryMeasurement:
    """Read and check the folder of a deflectometry measurement.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The measurement; every file it names exists.
    InputError: No such folder or file, not TOML, another kind, an unknown or missing key, a value of the wrong type
        or out of range, a file that does not exist, or a number of frames that does not fit the pattern.
    """
    file, model = _checked(folder, DeflectometryModel)
    for key, text in model.named_files():
        if not (folder / text).is_file():
            raise InputError(f"{file}: {key} = {text!r}: there is no such file in {folder}")
    fringe_files = image_files(folder, "images.fringes", model.images.fringes)
    needed = model.pattern.n_frames
    if len(fringe_files) != needed:
        raise InputError(
            f"{file}: images.fringes = {model.images.fringes!r} gives {len(fringe_files)} files, but the pattern has "
            f"{needed} frames ({len(model.pattern.set)} sets); name the files in the order of the pattern"
        )
    return DeflectometryMeasurement(folder, model, fringe_files)


def load_response(folder: Path) -> ResponseMeasurement:
    """Read and check a folder with photographs of grey levels.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The measurement; every file it names exists.
    InputError: As for `load_measurement`; or a number of photographs that differs from that of the levels.
    """
    file, model = _checked(folder, ResponseModel)
    grey_files = image_files(folder, "images.grey", model.images.grey)
    if len(grey_files) != len(model.display.levels):
        raise InputError(
            f"{file}: images.grey = {model.images.grey!r} gives {len(grey_files)} files, but display.levels has "
            f"{len(model.display.levels)} levels; one photograph for each level is needed, in the same order"
        )
    return ResponseMeasurement(folder, model, grey_files)


def load_camera_calibration(folder: Path) -> CameraCalibrationMeasurement:
    """Read and check a folder with photos of a calibration board.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The measurement; every file it names exists.
    InputError: As for `load_measurement`.
    """
    file, model = _checked(folder, CameraCalibrationModel)
    for key, name in model.board.named_files if isinstance(model.board, TargetFieldSection) else ():
        if not (folder / name).is_file():
            raise InputError(f"{file}: board.{key} = {name!r}: there is no such file in {folder}")
    return CameraCalibrationMeasurement(folder, model, image_files(folder, "images.photos", model.images.photos))


def load_photogrammetry(folder: Path) -> PhotogrammetryMeasurement:
    """Read and check a folder with photos, or image points, of targets.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The measurement; every file it names exists.
    InputError: As for `load_measurement`.
    """
    file, model = _checked(folder, PhotogrammetryModel)
    photos = () if model.images is None else image_files(folder, "images.photos", model.images.photos)
    found = PhotogrammetryMeasurement(folder, model, photos)
    _refuse_missing(file, found.input_files)
    return replace(found, model=with_known_files(model, folder))


def load_observer(folder: Path) -> ObserverMeasurement:
    """Read and check a folder with photos of a trough.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The measurement; every file it names exists.
    InputError: As for `load_measurement`.
    """
    file, model = _checked(folder, ObserverModel)
    images = model.images
    doubts: tuple[Doubt, ...] = ()
    if images.video is not None:
        # OpenCV costs 0.1 s, which only a video is worth.
        from heliogauge.images.video import list_frames

        frames = list_frames(folder / images.video, every_nth=images.every_nth)
        photos, doubts = frames.files, frames.doubts
    else:
        photos = image_files(folder, "images.photos", images.photos or ())
    own = model.absorber.photos
    absorber = () if own is None else image_files(folder, "absorber.photos", own)
    found = ObserverMeasurement(folder, model, photos, absorber, doubts)
    _refuse_missing(file, found.input_files)
    return found


def load_photogrammetry_plan(folder: Path) -> PhotogrammetryPlanMeasurement:
    """Read and check a folder with the plan of a photo network.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The plan; every file it names exists.
    InputError: As for `load_measurement`.
    """
    file, model = _checked(folder, PhotogrammetryPlanModel)
    found = PhotogrammetryPlanMeasurement(folder, model)
    _refuse_missing(file, found.input_files)
    return found


def load_observer_plan(folder: Path) -> ObserverPlanMeasurement:
    """Read and check a folder with the plan of a pass over a trough.

    folder: Folder with measurement.toml; the files it names are relative to it.
    Returns: The plan; every file it names exists.
    InputError: As for `load_measurement`.
    """
    file, model = _checked(folder, ObserverPlanModel)
    found = ObserverPlanMeasurement(folder, model)
    _refuse_missing(file, found.input_files)
    return found


def load_heliostat(folder: Path) -> HeliostatMeasurement:
    """Read and check a folder with observations of heliostats.

    folder: Folder with measurement.toml, or one as of the PAINT database, which needs none.
    Returns: The measurement; every file it names exists.
    InputError: As for `load_measurement`.
    """
    found = paint_measurement(folder)
    if found is None:
        file, model = _checked(folder, HeliostatModel)
        found = HeliostatMeasurement(folder, model)
        _refuse_missing(file, found.input_files)
    return found


def _refuse_missing(file: Path, paths: Sequence[Path]) -> None:
    for path in paths:
        if not path.is_file():
            raise InputError(f"{file}: there is no file {path.relative_to(file.parent)} in {file.parent}")


def _checked(folder: Path, model_type: type[_ModelT]) -> tuple[Path, _ModelT]:
    """Read measurement.toml of a folder, which must be of one kind; return the file and what it says."""
    file = folder / MEASUREMENT_FILE
    kind = next(name for name, one in KINDS.items() if one is model_type)
    model = parse_measurement(_read_toml(folder, kind), file)
    if not isinstance(model, model_type):
        raise InputError(
            f'{file}: kind = "{model.kind}" is not "{kind}"; evaluate this folder with `{COMMANDS[model.kind]}`'
        )
    return file, model


def parse_measurement(content: dict[str, Any], file: Path) -> Model:
    """Check the content of a measurement.toml, without looking for the files it names.

    content: The tables of the file.
    file: Where they come from, for messages.
    InputError: Another kind, an unknown or missing key, or a value that cannot be meant.
    """
    model_type = KINDS[_kind(content, file)]
    try:
        return model_type.model_validate(content)
    except ValidationError as error:
        lines = fault_lines(error, model_type)
        separator = " " if len(lines) == 1 else "\n  "
        raise InputError(f"{file}:{separator}" + "\n  ".join(lines)) from None


def _read_toml(folder: Path, kind: str) -> dict[str, Any]:
    file = folder / MEASUREMENT_FILE
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give a folder with {MEASUREMENT_FILE} and its images")
    if not file.is_file():
        raise InputError(
            f"{file}: there is no such file; write one with `heliogauge init {kind} {folder}` and fill it in"
        )
    try:
        return tomllib.loads(file.read_bytes().decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: byte {error.start} is not UTF-8; save the file as UTF-8 text") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{file}: not valid TOML: {error}; correct that line") from None
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); check its permissions") from None


def _kind(content: dict[str, Any], file: Path) -> str:
    known = ", ".join(f'"{kind}"' for kind in KINDS)
    kind = content.get("kind")
    if kind is None:
        raise InputError(f"{file}: kind is missing; say one of {known} at the top of the file")
    if not isinstance(kind, str) or kind not in KINDS:
        near = get_close_matches(str(kind), KINDS, n=1)
        hint = f'did you mean "{near[0]}"?' if near else f"this version measures {known}"
        raise InputError(f"{file}: kind = {kind!r} is not known; {hint}")
    return kind
