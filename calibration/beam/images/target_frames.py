"""Where a target is in the photos of a camera, as users and measurement.toml say it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from calibration.beam.keys import BeamImagesSection
from heliogauge.camera.model import Camera
from heliogauge.measurement.files import image_files
from heliogauge.results.folder import read_camera_json
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, float_array

__all__ = [
    "ArucoMarkers",
    "CornerPixels",
    "DarkMarks",
    "MarkerTemplates",
    "Source",
    "TargetFrame",
    "WholeImage",
    "frame_of_section",
]


@dataclass(frozen=True, slots=True)
class WholeImage:
    """The photo shows exactly the target.

    places: "edge": the photo's outer edges are the target's. "index": a pixel's index over the number of pixels is
        its place, as in crops of the PAINT data base.
    """

    places: Literal["edge", "index"] = "edge"


@dataclass(frozen=True, slots=True, eq=False)
class CornerPixels(ShortRepr):
    """The target's corners are given.

    pixels_px (4, 2): Upper left, upper right, lower right, lower left as seen from the field [px].
    sigma_px: Their uncertainty [px].
    """

    pixels_px: FloatArray
    sigma_px: float = 0.0


@dataclass(frozen=True, slots=True)
class MarkerTemplates(ShortRepr):
    """The target's corners have dark marks of which there are pictures.

    files: Four pictures in the order of the corners.
    anchors_px: The target's corner in each; the outer corner of the mark if absent [px].
    """

    files: tuple[Path, ...]
    anchors_px: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class ArucoMarkers(ShortRepr):
    """The middles of four square markers are the target's corners.

    ids: Numbers of the markers in the order of the corners.
    dictionary: OpenCV's name.
    """

    ids: tuple[int, ...]
    dictionary: str = "DICT_4X4_50"


@dataclass(frozen=True, slots=True)
class DarkMarks:
    """The target's corners have dark marks: angles (outer corner) or filled rectangles (inner corner)."""

    corner: Literal["outer", "inner"] = "outer"


Source: TypeAlias = WholeImage | CornerPixels | MarkerTemplates | ArucoMarkers | DarkMarks


@dataclass(frozen=True, slots=True, eq=False)
class TargetFrame(ShortRepr):
    """Where a target is in the photos of one camera.

    corners_m (4, 2): Its corners on its plane: upper left, upper right, lower right, lower left as seen from the
        field [m].
    source: How they are found in a photo.
    camera: The lens.
    empty_files: Photos of the target without a beam.
    channel: Colour that is measured: a sum of colours saturates sooner, and its centroid depends on their weights.
    reflectance_file: Picture of the target's relative reflectance, its edges the target's.
    """

    corners_m: FloatArray
    source: Source = WholeImage()
    camera: Camera | None = None
    empty_files: tuple[Path, ...] = ()
    channel: str = "green"
    reflectance_file: Path | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners_m", float_array("corners_m", self.corners_m, (4, 2)))


def frame_of_section(
    section: BeamImagesSection, corners_m: FloatArray, folder: Path, channel: str = "green"
) -> TargetFrame:
    """Return where a target is in its photos, as a measurement.toml says it.

    section: What the file says.
    corners_m (4, 2): The target's corners on its plane: upper left, upper right, lower right, lower left [m].
    folder: Folder of the measurement.
    channel: Colour that is measured.
    InputError: A file that is not there.
    """
    camera = None if section.camera is None else read_camera_json(folder / section.camera)
    empty = () if section.empty is None else image_files(folder, "images.empty", section.empty)
    return TargetFrame(corners_m, _source(section, folder), camera, empty, channel)


def _source(section: BeamImagesSection, folder: Path) -> Source:
    if section.corners_px is not None:
        return CornerPixels(np.array(section.corners_px), section.corners_sigma_px)
    if section.markers is not None:
        return MarkerTemplates(tuple(folder / name for name in section.markers), section.anchors_px or ())
    if section.aruco_ids is not None:
        return ArucoMarkers(section.aruco_ids, section.dictionary)
    if section.dark_marks is not None:
        return DarkMarks(section.dark_marks)
    return WholeImage(section.whole or "edge")
