"""An overlay: photos to turns of facets; the stages follow each other in `run`."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from deflectometry.overlay.camera_place import Station, place_camera
from deflectometry.overlay.doubts import doubts_of_turns
from deflectometry.overlay.joint_turns import JointTurns, adjust
from deflectometry.overlay.keys import OverlayMeasurement, SourceSection
from deflectometry.overlay.pipeline.result import (
    DESIGN_LINE,
    FACET_LINE,
    MEASURED_LINE,
    OverlayLine,
    OverlayResult,
)
from deflectometry.overlay.source_image import FacetPixels, Source, outline_px, seen_places
from deflectometry.overlay.turn_fit import FacetView
from deflectometry.pipeline.inputs import build_camera, build_facets, build_mounts
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.images.photos import read_luma
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.results.folder import hash_files
from heliogauge.results.tables import read_columns_csv
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import FloatArray

#: Pixels at the edge of a facet mix it with what is around it.
_EDGE_PX = 3
#: Of a pixel that was rounded to whole numbers.
_LEAST_NOISE_DN = 0.3
#: More pixels of one facet in one photo say nothing new of an edge.
_MOST_PIXELS = 5_000
_FEWEST_PIXELS = 200
#: Lines of the overlay are sharp to this share of a pixel.
_FINER = 4


def run(measurement: OverlayMeasurement, progress: Progress | None = None) -> OverlayResult:
    """Find the turn of each facet from photos of a source that it shows.

    InputError: Photos, points or camera that cannot be used.
    EstimationError: A camera that cannot be placed, or no facet shows the source.
    """
    progress, model = progress or SilentProgress(), measurement.model
    camera = build_camera(model.camera, measurement.folder)
    facets, source = build_facets(model.mirror, model.name), build_source(model.source)
    names = [file.name for file in measurement.photo_files]
    with progress.stage("read photos"):
        images = [_read(file, camera) for file in measurement.photo_files]
    with progress.stage("place cameras"):
        stations = _place(measurement, camera)

    def views(facet: Facet, moved: Sequence[Station]) -> list[FacetView]:
        return list(_views(camera, moved, facet, images))

    with progress.stage("turns of facets"):
        sigma_m = 1e-3 * model.source.sigma_center_mm
        found = adjust(camera, facets, stations, source, sigma_m, views)
    with progress.stage("overlay"):
        lines = tuple(_lines(camera, names, facets, found))
    return OverlayResult(
        name=model.name,
        facets=facets,
        turns=found,
        photos=tuple(names),
        mounts_m=build_mounts(model.mirror),
        lines=lines,
        thumbnails={name: make_thumbnail(_grey(image)) for name, image in zip(names, images, strict=True)},
        size_px=(camera.width_px, camera.height_px),
        doubts=tuple(doubts_of_turns(facets, source, found, names, sigma_m)),
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(measurement.input_files, measurement.folder),
    )


def build_source(section: SourceSection) -> Source:
    """Build the source that measurement.toml describes."""
    place = RigidTransform.from_rotation_vector(section.rotation_vector_rad, section.center_m)
    if section.shape == "disc":
        radius = 0.5 * (section.diameter_m or 0.0)
        return Source((radius, radius), True, place)
    return Source((0.5 * (section.width_m or 0.0), 0.5 * (section.height_m or 0.0)), False, place)


def _read(file: Any, camera: Camera) -> FloatArray:
    image = read_luma(file).astype(np.float64)
    if image.shape != (camera.height_px, camera.width_px):
        raise InputError(
            f"{file}: {image.shape[1]} x {image.shape[0]} px, the camera has {camera.width_px} x {camera.height_px} "
            "px; give the camera that took it, at this size"
        )
    return image


def _grey(image: FloatArray) -> npt.NDArray[np.uint8]:
    high = max(float(image.max()), 1.0)
    return np.asarray(np.clip(255 * image / high, 0, 255).astype(np.uint8))


def _place(measurement: OverlayMeasurement, camera: Camera) -> list[Station]:
    numbers = ("x_m", "y_m", "z_m", "x_px", "y_px")
    texts, table = read_columns_csv(measurement.points_file, ("photo",), numbers)
    of_photo = np.array(texts["photo"])
    photos = [one.file for one in measurement.model.photo]
    if strange := sorted(set(of_photo.tolist()) - set(photos)):
        raise InputError(
            f"{measurement.points_file}: photo {strange[0]!r} is none of [[photo]] file ({', '.join(photos)})"
        )
    columns = np.column_stack([table[name] for name in numbers])
    good = np.isfinite(columns).all(axis=1)
    found = []
    for one in measurement.model.photo:
        mine = columns[(of_photo == one.file) & good]
        station = place_camera(camera, mine[:, :3], mine[:, 3:], measurement.model.points.sigma_px, f"photo {one.file}")
        if one.place_m is not None:
            station = replace(station, place_m=np.array(one.place_m), sigma_place_m=1e-3 * one.sigma_place_mm)
        found.append(station)
    return found


def _views(
    camera: Camera, stations: Sequence[Station], facet: Facet, images: Sequence[FloatArray]
) -> Iterator[FacetView]:
    for number, (station, image) in enumerate(zip(stations, images, strict=True)):
        inside = np.zeros(image.shape, np.uint8)
        outline = outline_px(camera, station.cam_from_heliostat, facet)
        if not np.isfinite(outline).all():
            continue
        cv2.fillPoly(inside, [np.rint(outline).astype(np.int32)], 1)
        eroded = cv2.erode(inside, np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8), borderValue=0)
        rows, columns = np.nonzero(eroded)
        if rows.size < _FEWEST_PIXELS:
            continue
        step = max(1, round(np.sqrt(rows.size / _MOST_PIXELS)))
        chosen = (rows % step == 0) & (columns % step == 0)
        rows, columns = rows[chosen], columns[chosen]
        pixels = np.column_stack([columns, rows]).astype(np.float64)
        beside = np.diff(image, axis=1)[eroded[:, 1:] > 0]
        noise = max(robust_scale(beside) / np.sqrt(2), _LEAST_NOISE_DN)
        seen = FacetPixels.of(camera, station.cam_from_heliostat, facet, pixels)
        yield FacetView(number, seen, image[rows, columns], noise)


def _lines(camera: Camera, names: Sequence[str], facets: Sequence[Facet], found: JointTurns) -> Iterator[OverlayLine]:
    for number, (name, station) in enumerate(zip(names, found.stations, strict=True)):
        pose = station.cam_from_heliostat
        for k, facet in enumerate(facets):
            outline = outline_px(camera, pose, facet)
            if not np.isfinite(outline).all():
                continue
            yield OverlayLine(name, facet.name, FACET_LINE, np.vstack([outline, outline[:1]]))
            kinds = [(DESIGN_LINE, np.zeros(2))]
            if number in found.seen_in[k]:
                kinds.append((MEASURED_LINE, found.turns_rad[k]))
            for kind, turn in kinds:
                for line in _image_lines(camera, pose, facet, turn, found.source, outline):
                    yield OverlayLine(name, facet.name, kind, line)


def _image_lines(
    camera: Camera, pose: RigidTransform, facet: Facet, turn_rad: FloatArray, source: Source, outline: FloatArray
) -> Iterator[FloatArray]:
    """Yield the outline of the source's image within a facet, to a quarter of a pixel."""
    low = np.floor(outline.min(axis=0)).astype(int) - 1
    high = np.ceil(outline.max(axis=0)).astype(int) + 1
    columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    seen = seen_places(FacetPixels.of(camera, pose, facet, pixels), facet, turn_rad, source)
    within = np.minimum(*(half - np.abs(one) for half, one in zip(source.half_m, seen, strict=True)))
    if source.is_disc:
        within = source.half_m[0] - np.hypot(*seen)
    field = np.nan_to_num(within, nan=-1e3).reshape(columns.shape).astype(np.float32)
    size = (field.shape[1] * _FINER, field.shape[0] * _FINER)
    fine = cv2.resize(field, size, interpolation=cv2.INTER_LINEAR)
    inside = np.zeros(fine.shape, np.uint8)
    # Centres of fine pixels: (k + 0.5) / finer - 0.5.
    cv2.fillPoly(inside, [np.rint((outline - low + 0.5) * _FINER - 0.5).astype(np.int32)], 1)
    found, _ = cv2.findContours(((fine > 0) & (inside > 0)).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for contour in found:
        if len(contour) > 8:
            line = (contour[:, 0, :].astype(np.float64) + 0.5) / _FINER - 0.5 + low
            yield np.vstack([line[::2], line[:1]])
