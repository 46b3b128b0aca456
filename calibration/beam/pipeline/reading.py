"""The photos of a measurement: files, their targets, and what is known of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calibration.beam.exchange.paint_records import read_records
from calibration.beam.exchange.tower import find_tower, read_targets
from calibration.beam.images.target_frames import TargetFrame, WholeImage, frame_of_section
from calibration.beam.keys import BeamsMeasurement, BeamTargetSection, PaintBeamsSection
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site, direction_from_angles, sun_directions, utc_times
from heliogauge.geometry.target_planes import PlaneTarget
from heliogauge.images.video import list_frames
from heliogauge.results.tables import read_table_csv
from heliogauge.validate import FloatArray

__all__ = ["BeamPhotos", "read_photos"]

#: Columns of a table of photos that are numbers and used here.
NUMBERS = (
    "distance_m",
    "power_w",
    "sigma_power_w",
    "label_x_m",
    "label_y_m",
    "sun_azimuth_deg",
    "sun_elevation_deg",
)


@dataclass(frozen=True, slots=True, eq=False)
class BeamPhotos:
    """Photos of beams and what is known of each.

    files, targets length n: Photos in order, and the target in each.
    frames: Where each target is in its photos.
    distances_m: From the mirror to each target, by name; missing where not known [m].
    numbers: Columns of `NUMBERS`, shape (n,); NaN where not known.
    passed_on: Other columns as texts.
    left_out: Rows without a usable photo: name and reason.
    doubts: What was wrong with the files and was got round.
    shared_files: Files beside the photos that were read.
    planes: Targets in the field, by name; missing where their place is not known.
    to_sun (n, 3): Direction to the sun of each photo, east, north, up; NaN where not known.
    """

    files: tuple[Path, ...]
    targets: tuple[str, ...]
    frames: Mapping[str, TargetFrame]
    distances_m: Mapping[str, float] = field(default_factory=dict)
    numbers: Mapping[str, FloatArray] = field(default_factory=dict)
    passed_on: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    doubts: tuple[Doubt, ...] = ()
    shared_files: tuple[Path, ...] = ()
    planes: Mapping[str, PlaneTarget] = field(default_factory=dict)
    to_sun: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def read_photos(measurement: BeamsMeasurement) -> BeamPhotos:
    """List the photos of a measurement.

    InputError: A table, a record or a video that cannot be read; a target that is not described; no photo.
    """
    model = measurement.model
    if model.paint is not None:
        return _of_paint(measurement, model.paint)
    sections = {one.target: one for one in model.images}
    channel = model.evaluation.channel
    frames = {
        one.name: frame_of_section(sections[one.name], _corners(one), measurement.folder, channel)
        for one in model.target
    }
    if model.flux.reflectance_map is not None:
        file = measurement.path(model.flux.reflectance_map)
        frames = {name: replace(one, reflectance_file=file) for name, one in frames.items()}
    distances = {one.name: one.distance_m for one in model.target if one.distance_m is not None}
    photos = model.photos
    if photos is None:
        raise InputError(f"{measurement.folder}: [photos] is missing")
    target = photos.target or model.target[0].name
    if photos.table is not None:
        found = _of_table(measurement, photos.table, target, frames, distances)
        return replace(found, planes=_planes(model.target), to_sun=_suns(measurement, found))
    planes = _planes(model.target)
    files, doubts = measurement.photo_files, tuple[Doubt, ...]()
    if photos.video is not None:
        video = list_frames(measurement.path(photos.video), every_nth=photos.every_nth)
        files, doubts = video.files, video.doubts
    empty = {file for one in frames.values() for file in one.empty_files}
    files = tuple(file for file in files if file not in empty)
    if not files:
        raise InputError(f"{measurement.folder}: all photos are empty frames (images.empty); give photos of beams, too")
    nowhere = np.full((len(files), 3), np.nan)
    return BeamPhotos(files, (target,) * len(files), frames, distances, doubts=doubts, planes=planes, to_sun=nowhere)


def _planes(targets: Sequence[BeamTargetSection]) -> dict[str, PlaneTarget]:
    found = {}
    for one in targets:
        if one.center_m is not None and one.facing_azimuth_deg is not None:
            width, height = np.ptp(_corners(one), axis=0)
            azimuth = np.radians(one.facing_azimuth_deg)
            found[one.name] = PlaneTarget.facing(
                one.name, np.array(one.center_m), float(azimuth), float(width), float(height)
            )
    return found


def _suns(measurement: BeamsMeasurement, photos: BeamPhotos) -> FloatArray:
    """Directions to the sun: from the table's angles, else from its times and the site."""
    to_sun = np.full((len(photos.files), 3), np.nan)
    angles = [photos.numbers[name] for name in ("sun_azimuth_deg", "sun_elevation_deg")]
    known = np.isfinite(angles[0]) & np.isfinite(angles[1])
    if known.any():
        to_sun[known] = direction_from_angles(np.radians(angles[0][known]), np.radians(angles[1][known]))
    times, site = photos.passed_on.get("time_utc"), measurement.model.site
    if times is not None and site is not None:
        rows = [row for row, text in enumerate(times) if text and not known[row]]
        if rows:
            place = Site(site.latitude_deg, site.longitude_deg, site.altitude_m)
            to_sun[rows] = sun_directions(utc_times([times[row] for row in rows]), place)
    return to_sun


def _corners(target: BeamTargetSection) -> FloatArray:
    if target.corners_m is not None:
        return np.array(target.corners_m)
    half = np.array([target.width_m, target.height_m], dtype=np.float64) / 2
    return np.asarray(half * [[-1, 1], [1, 1], [1, -1], [-1, -1]])


def _of_table(
    measurement: BeamsMeasurement,
    table: str,
    target: str,
    frames: Mapping[str, TargetFrame],
    distances: Mapping[str, float],
) -> BeamPhotos:
    path = measurement.path(table)
    columns = read_table_csv(path, ("image",))
    count = len(columns["image"])
    targets = [one or target for one in columns.get("target", [""] * count)]
    left_out: dict[str, str] = {}
    kept = []
    for row, (name, own) in enumerate(zip(columns["image"], targets, strict=True)):
        if not name:
            left_out[f"row {row + 2}"] = "names no photo"
        elif own not in frames:
            left_out[name] = f"target {own!r} is not among [[target]]: {', '.join(frames)}"
        elif not measurement.path(name).is_file():
            left_out[name] = f"there is no such file in {measurement.folder}"
        else:
            kept.append(row)
    if not kept:
        raise InputError(f"{path}: no row names a photo that is there ({next(iter(left_out.items()), ('', ''))})")
    numbers = {}
    for name in NUMBERS:
        cells = columns.get(name)
        numbers[name] = np.array([_value(path, name, cells[row], row) if cells else np.nan for row in kept])
    texts = {
        name: tuple(cells[row] for row in kept)
        for name, cells in columns.items()
        if name not in (*NUMBERS, "image", "target")
    }
    files = tuple(measurement.path(columns["image"][row]) for row in kept)
    return BeamPhotos(files, tuple(targets[row] for row in kept), frames, distances, numbers, texts, left_out)


def _value(path: Path, name: str, text: str, row: int) -> float:
    try:
        return float(text) if text.strip() else float("nan")
    except ValueError:
        raise InputError(f"{path}: row {row + 2}: {name} = {text!r} is not a number") from None


def _of_paint(measurement: BeamsMeasurement, paint: PaintBeamsSection) -> BeamPhotos:
    folder = measurement.path(paint.folder)
    tower = find_tower(folder) if paint.tower is None else measurement.path(paint.tower)
    targets = read_targets(tower)
    records = read_records(folder, targets, paint.pictures)
    left_out = {one.number: one.fault for one in records if one.fault}
    used = [(one, one.picture) for one in records if not one.fault and one.picture is not None]
    if not used:
        raise InputError(f"{folder}: no record has a picture on a known target ({next(iter(left_out.values()), '')})")
    channel = measurement.model.evaluation.channel
    names = dict.fromkeys(one.target for one, _ in used)
    frames = {name: TargetFrame(targets.corners_m[name], WholeImage("index"), channel=channel) for name in names}
    label = np.array([one.label_m for one, _ in used])
    numbers = {name: np.full(len(used), np.nan) for name in NUMBERS}
    numbers["label_x_m"], numbers["label_y_m"] = label[:, 0], label[:, 1]
    readings = [[f"{value:g}" if np.isfinite(value) else "" for value in one.readings] for one, _ in used]
    texts = {
        "record": tuple(one.number for one, _ in used),
        "reading_1": tuple(one[0] for one in readings),
        "reading_2": tuple(one[1] for one in readings),
    }
    sun = np.array([one.to_sun for one, _ in used])
    for name, values in zip(("sun_e", "sun_n", "sun_u"), sun.T, strict=True):
        if np.isfinite(values).any():
            texts[name] = tuple(f"{value:.9g}" if np.isfinite(value) else "" for value in values)
    files = tuple(picture for _, picture in used)
    return BeamPhotos(
        files,
        tuple(one.target for one, _ in used),
        frames,
        {},
        numbers,
        texts,
        left_out,
        shared_files=(tower,),
        planes=targets.planes,
        to_sun=sun,
    )
