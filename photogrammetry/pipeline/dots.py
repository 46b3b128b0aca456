"""Targets of photos by whatever names them: codes, marks followed from photo to photo, a list of rough places."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.images.photos import read_image
from heliogauge.results.folder import read_table_csv
from heliogauge.running.progress import Progress
from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.keys.load import PhotogrammetryMeasurement
from photogrammetry.keys.targets import TargetsSection
from photogrammetry.matching.assignment import Sense, assign_targets
from photogrammetry.matching.tracking import Track, TrackedPhoto, TrackLimits, follow, start_track
from photogrammetry.matching.uncoded_names import ListedTargets
from photogrammetry.pipeline.cameras import build_cameras
from photogrammetry.pipeline.inputs import build_search, listed_targets
from photogrammetry.pipeline.photos import MeasuredPhotos, OnePhoto, collect_photos, measure_each
from photogrammetry.start_values.network import LeftOut

_COLUMNS = ("image", "target", "x_px", "y_px")
_Marks = dict[str, tuple[tuple[str, ...], FloatArray]]


def measure_targets_of(
    measurement: PhotogrammetryMeasurement, section: TargetsSection, *, jobs: int | None, progress: Progress
) -> MeasuredPhotos:
    """Measure the targets of all photos.

    section: What targets the photos show, and what names them.
    jobs: Photos measured side by side.
    Returns: Image points with covariances, dots without a name, and what was refused.
    InputError: Photos, dictionary, marks or list that cannot be used; a list alone without a known camera.
    EstimationError: No photo shows a target that can be named.
    """
    files = measurement.photo_files
    search = build_search(section, measurement.folder)
    found = measure_each(files, section, search, jobs=jobs, progress=progress)
    if section.tracked_from is not None:
        tracked = _follow_marks(files, section, measurement.folder / section.tracked_from, progress)
        found = [_join(one, own) for one, own in zip(found, tracked, strict=True)]
    listed = listed_targets(section, measurement.folder)
    if section.dictionary is None and section.tracked_from is None and listed is not None:
        found = _name_by_list(measurement, section, found, listed)
    return collect_photos(found)


# --- marks followed from photo to photo -----------------------------------------------------------------------------


def _follow_marks(files: Sequence[Path], section: TargetsSection, path: Path, progress: Progress) -> list[TrackedPhoto]:
    """Follow marks forwards from the first photo that has some, and backwards from there."""
    marks = _read_marks(path, [file.name for file in files])
    no_codes = section.model_copy(update={"dictionary": None})
    search = replace(build_search(no_codes, path.parent), with_uncoded=True)
    limits = TrackLimits(search_radius_px=section.search_radius_px)
    first = min(k for k, file in enumerate(files) if file.name in marks)
    seen: dict[int, TrackedPhoto] = {}
    with progress.stage("follow marks", len(files)) as stage:
        start: Track | None = None
        for order in (range(first, len(files)), range(first - 1, -1, -1)):
            track = start
            for k in order:
                image, name = read_image(files[k]), files[k].name
                if track is None:
                    track, seen[k] = start_track(image, name, *marks[name], search, limits)
                    start = track
                else:
                    track, seen[k] = follow(track, image, name)
                stage.advance()
    return [seen[k] for k in range(len(files))]


def _read_marks(path: Path, photos: Sequence[str]) -> _Marks:
    """Read the columns image, target, x_px, y_px; the centre of the top-left pixel is (0, 0)."""
    table = read_table_csv(path, _COLUMNS)
    marks: dict[str, tuple[list[str], list[list[float]]]] = {}
    for line, (image, target, x, y) in enumerate(zip(*(table[name] for name in _COLUMNS), strict=True), start=2):
        try:
            place = [float(x), float(y)]
        except ValueError as error:
            raise InputError(f"{path}, line {line}: {error}; is the decimal sign a point?") from None
        if image not in photos:
            raise InputError(f"{path}, line {line}: {image!r} is none of the photos ({photos[0]} ...)")
        if not target:
            raise InputError(f"{path}, line {line}: a target needs a name")
        names, places = marks.setdefault(image, ([], []))
        names.append(target)
        places.append(place)
    if not marks:
        raise InputError(f"{path}: there are no marks in it")
    if len(marks) > 1:
        raise InputError(f"{path}: marks in {len(marks)} photos ({', '.join(sorted(marks)[:3])}); mark one photo only")
    return {image: (tuple(names), np.array(places)) for image, (names, places) in marks.items()}


def _join(one: OnePhoto, followed: TrackedPhoto) -> OnePhoto:
    """Add followed targets to those named by codes; their dots are no others."""
    tracked = followed.detections
    good = np.nonzero(tracked.usable)[0]
    free = _away(one.dots.pixels_px, tracked.pixels_px[good], tracked.radius_px[good])
    return replace(
        one,
        detections=one.detections.joined(tracked.chosen(good)),
        ellipses_px2=np.concatenate([one.ellipses_px2, followed.ellipses_px2[good]]),
        refused=(*one.refused, *followed.lost),
        dots=one.dots.chosen(free),
        dot_ellipses_px2=one.dot_ellipses_px2[free],
    )


def _away(pixels_px: FloatArray, taken_px: FloatArray, radius_px: FloatArray) -> BoolArray:
    """Mark places that are outside of all taken targets."""
    far = np.linalg.norm(pixels_px[:, None] - taken_px[None], axis=2)
    return np.asarray((far > radius_px).all(axis=1))


# --- a list of rough places alone -----------------------------------------------------------------------------------


def _name_by_list(
    measurement: PhotogrammetryMeasurement,
    section: TargetsSection,
    found: Sequence[OnePhoto],
    listed: ListedTargets,
) -> list[OnePhoto]:
    """Name the dots of each photo by the list; photos in which that fails are left out with the reason."""
    for stated in measurement.model.camera:
        if not stated.is_known:
            raise InputError(
                f"camera {stated.name}: targets without a code are named by their list only with a known camera; give "
                "file or focal_px, or use coded targets or tracked_from"
            )
    photos = [one.detections.photo for one in found]
    cameras = build_cameras(measurement, photos, {one.detections.photo: one.size_px for one in found})
    sense = Sense(*(None if value is None else np.array(value) for value in (section.up, section.front)))
    named, reasons = [], []
    for one in found:
        camera = cameras.cameras[cameras.camera_of[one.detections.photo]]
        try:
            named.append(_name_dots(one, camera, listed, sense))
        except EstimationError as error:
            reasons.append(str(error))
            named.append(replace(one, refused=(*one.refused, LeftOut(one.detections.photo, str(error)))))
    if len(reasons) == len(found):
        raise EstimationError(f"images.photos: in none of {len(found)} photos the list names the dots; {reasons[0]}")
    return named


def _name_dots(one: OnePhoto, camera: Camera, listed: ListedTargets, sense: Sense) -> OnePhoto:
    place = assign_targets(camera, one.dots.pixels_px, one.dots.covariance_px2, listed, sense=sense).target_of_dot
    own = np.nonzero(place >= 0)[0]
    named = one.dots.chosen(own).renamed([listed.names[place[k]] for k in own])
    return replace(
        one,
        detections=named,
        ellipses_px2=one.dot_ellipses_px2[own],
        dots=one.dots.chosen(place < 0),
        dot_ellipses_px2=one.dot_ellipses_px2[place < 0],
    )
