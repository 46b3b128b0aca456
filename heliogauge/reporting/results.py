"""A folder of results, read whole for its report."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy.typing as npt

from heliogauge.camera.model import Camera
from heliogauge.results.folder import (
    PhotoPose,
    Summary,
    facet_names,
    read_cameras_json,
    read_pixels,
    read_slope_map,
    read_summary,
)
from heliogauge.slopes.map import SlopeMap


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """What a folder of results holds.

    summary: Headline numbers, warnings, texts.
    slope_map: The map, or the assembled one of several facets.
    facets: Maps of single facets; empty for one facet.
    pixels: Per-pixel results; empty where the file is not there.
    cameras: Cameras by name.
    poses: Poses by photo.
    """

    folder: Path
    summary: Summary
    slope_map: SlopeMap
    facets: dict[str, SlopeMap]
    pixels: dict[str, npt.NDArray[Any]]
    cameras: dict[str, Camera]
    poses: dict[str, PhotoPose]


def open_results(folder: str | Path = ".") -> Results:
    """Read a folder of results.

    folder: The folder; the working directory without it, where reports run.
    InputError: ``summary.json`` or ``slope_map.nc`` is missing, or a file is damaged.
    """
    folder = Path(folder)
    map_path, pixel_path, camera_path = (folder / name for name in ("slope_map.nc", "pixels.nc", "cameras.json"))
    cameras, poses = read_cameras_json(camera_path) if camera_path.exists() else ({}, {})
    return Results(
        folder=folder,
        summary=read_summary(folder / "summary.json"),
        slope_map=read_slope_map(map_path),
        facets={name: read_slope_map(map_path, name) for name in facet_names(map_path)},
        pixels=read_pixels(pixel_path) if pixel_path.exists() else {},
        cameras=cameras,
        poses=poses,
    )
