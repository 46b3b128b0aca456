"""What measurement.toml of ``kind = "deflectometry-poses"`` may say, and how it is read."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from deflectometry.keys import DeflectometryMeasurement, EvaluationSection, load_deflectometry
from heliogauge.errors import InputError
from heliogauge.files.regular import read_regular
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement
from heliogauge.measurement.models import MeasurementModel, Section, Text, repeated
from heliogauge.short_repr import ShortRepr

#: Keys of the mirror that may differ from pose to pose: where it stands and how that was measured.
_OF_ONE_POSE = {"roll_deg", "pose", "distance", "known_point"}


class PoseFolderSection(Section):
    """A pose of the mirror: ``[[pose]]``."""

    folder: Text = Field(
        description="Folder of its measurement, in this one: a measurement.toml of kind deflectometry and its images."
    )


class PosesModel(MeasurementModel):
    """The whole measurement.toml of ``kind = "deflectometry-poses"``."""

    kind: Literal["deflectometry-poses"] = Field(
        description="Fringe images of one mirror in several poses before the same camera and screen."
    )
    pose: Annotated[tuple[PoseFolderSection, ...], Field(min_length=2)] = Field(
        description="The poses, two or more; between them the mirror is turned, moved or tilted, and nothing else."
    )
    evaluation: EvaluationSection = Field(
        EvaluationSection(),
        description="Choices of the evaluation, for all poses; of those of the poses contradictions counts alone.",
    )

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        if (twice := repeated(one.folder for one in self.pose)) is not None:
            raise ValueError(f'two poses have folder = "{twice}"; each needs its own measurement')
        return self


@dataclass(frozen=True, slots=True, eq=False)
class PosesMeasurement(ShortRepr):
    """A checked measurement in several poses.

    folder: Its folder.
    model: What measurement.toml says.
    poses: The measurement of each pose by the name of its folder.
    """

    folder: Path
    model: PosesModel
    poses: dict[str, DeflectometryMeasurement]

    @property
    def fringe_files(self) -> tuple[Path, ...]:
        """Images of the frames of all poses."""
        return tuple(file for one in self.poses.values() for file in one.fringe_files)

    @property
    def input_files(self) -> tuple[Path, ...]:
        """All files the measurement consists of, measurement.toml first."""
        return (self.folder / MEASUREMENT_FILE, *(file for one in self.poses.values() for file in one.input_files))


def load_poses(folder: Path) -> PosesMeasurement:
    """Read and check the folder of a measurement in several poses.

    Returns: The measurement of each pose; camera, screen and mirror are the same in all.
    InputError: As for `deflectometry.keys.load_deflectometry`, or poses that differ in more than the mirror's pose.
    """
    file, model = read_measurement(folder, PosesModel)
    for one in model.pose:
        if Path(one.folder).is_absolute() or ".." in Path(one.folder).parts:
            raise InputError(f"{file}: pose.folder = {one.folder!r}: a folder in {folder} is needed")
    poses = {one.folder: load_deflectometry(folder / one.folder) for one in model.pose}
    first = model.pose[0].folder
    for name, other in poses.items():
        for key in _differences(poses[first], other):
            raise InputError(
                f"{file}: {key} is not the same in {first} and {name}; the poses of one measurement share camera, "
                "screen and mirror, and differ in where the mirror stands"
            )
    return PosesMeasurement(folder, model, poses)


def _differences(first: DeflectometryMeasurement, other: DeflectometryMeasurement) -> list[str]:
    """Return the keys of camera, screen and mirror that are not the same in two poses."""
    sections = [_shared(one) for one in (first, other)]
    return [
        f"{name}.{key}"
        for name in sections[0]
        for key in sorted(sections[0][name].keys() | sections[1][name].keys())
        if sections[0][name].get(key) != sections[1][name].get(key)
    ]


def _shared(measurement: DeflectometryMeasurement) -> dict[str, dict[str, Any]]:
    model = measurement.model
    return {
        "camera": _with_contents(measurement, model.camera.model_dump()),
        "screen": _with_contents(measurement, model.screen.model_dump(exclude={"response_file"})),
        "mirror": model.mirror.model_dump(exclude=_OF_ONE_POSE),
    }


def _with_contents(measurement: DeflectometryMeasurement, section: dict[str, Any]) -> dict[str, Any]:
    """Put the content of a file in the place of its name: each pose may have its own copy."""
    if "file" not in section:
        return section
    return section | {"file": read_regular(measurement.path(section["file"]))}
