"""An overlay: photos to turns of facets; the stages follow each other in `run`."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.overlay.camera_place import Station, place_camera
from deflectometry.overlay.doubts import doubts_of_turns
from deflectometry.overlay.facet_fit import FacetFit, Unused, fit_facet
from deflectometry.overlay.facet_sight import LEAST_NOISE_DN, pixels_within
from deflectometry.overlay.joint_turns import JointTurns, adjust
from deflectometry.overlay.keys import OverlayMeasurement, SourceSection
from deflectometry.overlay.pipeline.lines import MEASURED_LINE, OverlayLine, lines_over
from deflectometry.overlay.pipeline.result import OverlayResult
from deflectometry.overlay.source_image import Source
from deflectometry.overlay.source_size import source_sizes
from deflectometry.overlay.turn_fit import FacetView, ViewTurn
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

#: A camera whose place is known to this share of the source's half size shows a facet's image where the others do.
_NARROW = 0.25


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

    surveyed = {n for n, one in enumerate(stations) if one.is_surveyed_to(_NARROW * min(source.half_m))}
    fitted: dict[str, Sequence[ViewTurn]] = {}

    def fits(facet: Facet, moved: Sequence[Station], moved_source: Source, start_rad: FloatArray | None) -> FacetFit:
        views = list(_views(camera, moved, facet, images))
        found = fit_facet(facet, views, moved_source, start_rad, surveyed)
        fitted[facet.name] = found.turns
        outside = set(range(len(images))) - {one.photo for one in views}
        return replace(found, unused={**found.unused, **dict.fromkeys(outside, Unused.OUTSIDE)})

    with progress.stage("turns of facets"):
        sigma_m = 1e-3 * model.source.sigma_center_mm
        found = adjust(camera, facets, stations, source, sigma_m, fits)
    with progress.stage("size of the source"):
        used = {
            facet.name: [one for one in fitted[facet.name] if one.view.photo in photos]
            for facet, photos in zip(facets, found.seen_in, strict=True)
        }
        sizes = source_sizes(facets, used, found.source)
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
        doubts=tuple(doubts_of_turns(facets, source, found, names, sigma_m, sizes)),
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
            station = station.settled(camera)
        found.append(station)
    return found


def _views(
    camera: Camera, stations: Sequence[Station], facet: Facet, images: Sequence[FloatArray]
) -> Iterator[FacetView]:
    for number, (station, image) in enumerate(zip(stations, images, strict=True)):
        seen = pixels_within(camera, station.cam_from_heliostat, facet)
        if seen is None:
            continue
        inside, pixels = seen
        beside = np.diff(image, axis=1)[inside[:, 1:]]
        noise = max(robust_scale(beside) / np.sqrt(2), LEAST_NOISE_DN)
        columns, rows = pixels.pixels_px.astype(np.intp).T
        yield FacetView(number, pixels, image[rows, columns], noise)


def _lines(camera: Camera, names: Sequence[str], facets: Sequence[Facet], found: JointTurns) -> Iterator[OverlayLine]:
    for number, (name, station) in enumerate(zip(names, found.stations, strict=True)):
        for k, facet in enumerate(facets):
            measured = {MEASURED_LINE: found.turns_rad[k]} if number in found.seen_in[k] else {}
            yield from lines_over(camera, name, station.cam_from_heliostat, facet, found.source, measured)
