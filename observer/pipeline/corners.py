"""Photos without marked targets: corners of the mirror panels from drawing, drone's positions and gimbal's turns.

The camera's place and turn predict where a collector is in a photo but for two things that the whole flight has in
common: where the drone's positions have the collector, and how compass and drawing are turned against each other. Both
come from a few photos in which the collector is searched for everywhere, as far as these agree. Then each photo is
looked at where it is predicted. Where nobody says how the camera was turned, its place alone predicts how the drawing
looks, and it is searched for in the whole photo.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.images.photos import read_luma
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.running.progress import Progress
from heliogauge.running.threads import side_by_side
from heliogauge.validate import FloatArray
from observer.corners.corner_points import corner_points
from observer.corners.lattice import PanelLattice
from observer.corners.panel_lines import FittedPose, fit_pose, photo_noise
from observer.corners.start_pose import (
    EdgeMap,
    Match,
    aimed_at_origin,
    edge_map,
    match_at_place,
    turned_about_axis,
)
from observer.corners.tie import SearchedCollector, SearchedPhoto, Tied, tie
from observer.photo_edges.views import View
from observer.pipeline.reading.photos import Finder, FirstLook
from observer.product.pictures import empty_slices
from photogrammetry.detection import Detections
from photogrammetry.pipeline import OnePhoto
from photogrammetry.start_values import LeftOut, spans_an_area

#: Photos in which the collectors are searched for everywhere: of one, and at most of several.
_START_PHOTOS, _MOST_START_PHOTOS = 3, 7
#: Turns about the line of sight that are tried, and how far a direction may be off, in sigmas of the turns.
_TURNS, _REACH = (-2.0, -1.2, -0.4, 0.4, 1.2, 2.0), 3.0
#: A photo is refused when its place contradicts the drone's by so many sigmas: by chance one in 10^6.
_CONTRADICTED = 5.0
#: Fewest corners of a photo that hold its pose.
_LEAST_CORNERS = 6


class PlacesOfPhotos(Protocol):
    """Places and turns of cameras about some origin: those of a drone, or before a collector that turns."""

    @property
    def photos(self) -> tuple[str, ...]:
        """Names of the photos."""

    @property
    def enu_m(self) -> FloatArray:
        """Places, shape (n, 3) [m]."""

    @property
    def sigma_m(self) -> FloatArray:
        """Their standard deviations, shape (n, 3) [m]."""

    def enu_from_camera(self, number: int) -> FloatArray | None:
        """Return the rotation of a photo's camera, shape (3, 3); None where unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class CornerSearch:
    """What predicts the corners of a collector.

    collector: Its drawing, turn and place.
    positions: Places and turns of the camera.
    is_tied: Whether the places are in the collector's frame already, as those of a far camera.
    motion_sigma_m: How far the camera may fly while it reads the rows of a photo [m].
    """

    collector: SearchedCollector
    positions: PlacesOfPhotos
    is_tied: bool = False
    motion_sigma_m: float = 0.0

    @property
    def lattice(self) -> PanelLattice:
        """The drawing."""
        return self.collector.lattice


def find_corners(
    files: Sequence[Path], finder: Finder, search: CornerSearch, *, jobs: int | None, progress: Progress
) -> FirstLook:
    """Find the corners of the panels in all photos.

    files: The photos.
    finder: With the cameras.
    Returns: Corners and provisional poses; photos that were refused have a reason and neither.
    InputError: The camera is not known, positions are missing, or a photo cannot be read.
    EstimationError: The collector is not found, or it may lie in several places.
    """
    [look] = find_corners_of_each(files, [finder], [search], jobs=jobs, progress=progress)
    if len(look.poses) < 2:
        reasons = "; ".join(f"{one.refused[0].name}: {one.refused[0].reason}" for one in look.targets if one.refused)
        raise EstimationError(
            f"corners: {len(look.poses)} photos show enough of them, two are needed ({reasons[:400]})"
        )
    return look


def find_corners_of_each(
    files: Sequence[Path],
    finders: Sequence[Finder],
    searches: Sequence[CornerSearch],
    *,
    jobs: int | None,
    progress: Progress,
) -> list[FirstLook]:
    """Find the corners of several collectors in the same photos, each of which is read once.

    finders, searches: Of each collector, with the same cameras and positions.
    Returns: Of each collector what the photos show of it.
    InputError: The camera is not known, positions are missing, or a photo cannot be read.
    EstimationError: The collectors are not found, or they may lie in several places.
    """
    camera_of, positions = finders[0].camera_of, searches[0].positions
    missing = [file.name for file in files if file.name not in camera_of]
    if missing:
        raise InputError("corners: the camera must be known (a file, or focal_px): corners predict from it")
    said = {name: k for k, name in enumerate(positions.photos)}
    placed = [file for file in files if file.name in said]
    if len(placed) < 2 and not searches[0].is_tied:
        raise InputError(
            f"positions: {len(placed)} of {len(files)} photos have a place, two are needed to predict where the "
            "panels' corners are"
        )

    def opened(file: Path) -> SearchedPhoto:
        row = said[file.name]
        image = np.asarray(read_luma(file), dtype=np.float32)
        return SearchedPhoto(
            file.name,
            image,
            camera_of[file.name],
            positions.enu_m[row],
            positions.sigma_m[row],
            positions.enu_from_camera(row),
        )

    collectors = [one.collector for one in searches]
    tied = Tied(np.eye(3), np.zeros(3))
    if not searches[0].is_tied:
        with progress.stage("find the collector"):
            some = [opened(file) for file in _start_photos(placed, len(searches))]
            tied = tie(some, collectors, lambda one, count: side_by_side(one, range(count), jobs))
    with progress.stage("find corners", len(files)) as stage:

        def one(number: int) -> list[tuple[OnePhoto, RigidTransform | None]]:
            file = files[number]
            if file.name in said:
                photo = opened(file)
                found = [_look(photo, each.collector, tied, each.motion_sigma_m) for each in searches]
            else:
                none = _refused(file.name, read_luma(file).shape, "nobody says where it was taken"), None
                found = [none for _ in collectors]
            stage.advance()
            return found

        found = side_by_side(one, range(len(files)), jobs)
    names = tuple(file.name for file in files)
    looks = []
    for k, finder in enumerate(finders):
        own = [of_photo[k] for of_photo in found]
        poses = {name: pose for name, (_, pose) in zip(names, own, strict=True) if pose is not None}
        slices = empty_slices(finder.expected.collector, finder.expected.y_m, len(files))
        looks.append(FirstLook(names, tuple(one for one, _ in own), poses, {}, {}, slices, finder.encodings))
    return looks


def _start_photos(files: Sequence[Path], n_collectors: int) -> list[Path]:
    """Return photos in which the collectors are searched for: of one the inner part of a pass, where all of it is seen.

    Of several the first and the last ones, too: rows look alike, and only their ends tell which is which.
    """
    if n_collectors > 1:
        count = min(_START_PHOTOS + n_collectors - 1, _MOST_START_PHOTOS)
        return [files[k] for k in np.unique(np.linspace(0, len(files) - 1, count).round().astype(int))]
    some = [files[k] for k in np.unique(np.linspace(0, len(files) - 1, _START_PHOTOS + 2).round().astype(int))]
    return some[1:-1] if len(some) > 3 else some


def _look(
    photo: SearchedPhoto, own: SearchedCollector, tied: Tied, motion_sigma_m: float
) -> tuple[OnePhoto, RigidTransform | None]:
    """Find the corners of one collector in one photo."""
    lattice, shape = own.lattice, photo.image.shape
    enu_from_frame = tied.enu_from_frame(own)
    antenna = enu_from_frame.T @ (photo.place_m - tied.origin_of(own))
    noise, reason = photo_noise(photo.image), "it shows too little of the collector, by the drone's place"
    edges = edge_map(photo.image)
    fitted: FittedPose | None = None
    for match in _predicted(photo, own, tied, antenna, edges):
        reason = "the panels' edges are not where drone and drawing predict them"
        fitted = fit_pose(photo.image, View(photo.camera, match.cam_from_frame), lattice, noise)
        if fitted is None:
            continue
        pose = fitted.cam_from_frame
        off = enu_from_frame @ (pose.inverse().apply(own.lever_m) - antenna)
        turned = enu_from_frame @ pose.origin_covariance(fitted.covariance) @ enu_from_frame.T
        expected = turned + np.diag(2 * photo.sigma_m**2)
        far = float(np.linalg.norm(off))
        if float(off @ np.linalg.solve(expected, off)) <= _CONTRADICTED**2 or far <= own.same_m:
            break
        reason, fitted = f"by its panels' edges it was taken {far:.2g} m from where the drone says", None
    if fitted is None:
        return _refused(photo.name, shape, reason), None
    pose = fitted.cam_from_frame
    points = corner_points(View(photo.camera, pose), lattice, fitted, motion_sigma_m)
    found = Detections(
        photo.name,
        lattice.names,
        points.pixels_px,
        points.covariance_px2,
        np.full(len(lattice.names), np.nan),
        points.flags,
    )
    refused = tuple(
        LeftOut(f"{name} in {photo.name}", _REASONS[SampleFlag(int(flag))])
        for name, flag in zip(lattice.names, points.flags, strict=True)
        if flag
    )
    count = int(np.count_nonzero(found.usable))
    if count < _LEAST_CORNERS or not spans_an_area(lattice.points_m[found.usable]):
        return _refused(photo.name, shape, f"{count} corners, {_LEAST_CORNERS} not on a line are needed"), None
    none = found.chosen(np.zeros(0, dtype=np.intp))
    shapes = np.full((len(found), 2, 2), np.nan)
    size = int(shape[1]), int(shape[0])
    one = OnePhoto(found, shapes, size, refused, none, np.zeros((0, 2, 2)))
    return one.with_thumbnail(make_thumbnail(photo.image)), pose


def _predicted(
    photo: SearchedPhoto, own: SearchedCollector, tied: Tied, antenna_m: FloatArray, edges: EdgeMap
) -> Iterator[Match]:
    """Yield where the collector is in a photo by the drone, the likeliest first.

    antenna_m (3,): The drone's place in the collector's frame [m].
    """
    enu_from_frame, sigma = tied.enu_from_frame(own), own.turn_sigma_rad
    turns = (sigma * np.array(_TURNS)).tolist()
    if photo.enu_from_camera is not None:
        rotation = photo.enu_from_camera.T @ enu_from_frame
        match = match_at_place(edges, _posed(photo, rotation, own, antenna_m), own.lattice, _REACH * sigma, turns)
        yield from [] if match is None else [match]
        return
    if not tied.headings:
        return
    # The camera is turned as in the nearest photo in which the collector was found, or points at it as there.
    near = min(tied.headings, key=lambda one: float(np.linalg.norm(one.place_m - photo.place_m)))
    held = _posed(photo, near.enu_from_camera.T @ enu_from_frame, own, antenna_m)
    aimed = aimed_at_origin(held)
    yield from _whole_turn(held, aimed, own, edges, turns)


def _whole_turn(
    held: View, aimed: View, own: SearchedCollector, edges: EdgeMap, turns: Sequence[float]
) -> Iterator[Match]:
    """Yield where a camera of unknown direction shows the collector; then turned by half a turn, as on the way back."""
    aside = float(np.linalg.norm(held.eye_m[:2]))
    for half in (0.0, np.pi):
        # Above the middle of a collector that looks the same after half a turn a photo does not tell them apart.
        if half and own.is_symmetric and 2 * aside < own.same_m:
            return
        tried = [
            match_at_place(edges, turned_about_axis(view, half), own.lattice, np.pi / 2, turns)
            for view in (held, aimed)
        ]
        found = [match for match in tried if match is not None]
        yield from sorted(found, key=lambda match: -match.score)[:1]


def _posed(photo: SearchedPhoto, rotation: FloatArray, own: SearchedCollector, antenna_m: FloatArray) -> View:
    eye = antenna_m - rotation.T @ own.lever_m
    return View(photo.camera, RigidTransform(rotation, -rotation @ eye))


#: Why a corner is missing.
_REASONS = {
    SampleFlag.CUT_BY_BORDER: "the lines that meet there are behind the receiver or beyond the border of the photo",
    SampleFlag.OUTLIER: "farther from the drawing than panels are mounted: it may be an edge of the reflection",
    SampleFlag.PARTLY_COVERED: "not all of the lines that meet there are seen clearly",
}


def _refused(name: str, shape: tuple[int, ...], reason: str) -> OnePhoto:
    none = Detections(name, (), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), np.zeros(0, dtype=np.uint32))
    size = int(shape[1]), int(shape[0])
    return OnePhoto(none, np.zeros((0, 2, 2)), size, (LeftOut(name, f"left out: {reason}"),), none, np.zeros((0, 2, 2)))
