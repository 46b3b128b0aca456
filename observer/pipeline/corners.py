"""Photos without marked targets: corners of the mirror panels from drawing, drone's positions and gimbal's turns.

The camera's place and turn predict where the collector is in a photo but for two things that the whole flight has in
common: where the drone's positions have the collector, and how compass and drawing are turned against each other. Both
come from a few photos in which the collector is searched for everywhere, as far as these agree. Then each photo is
looked at where it is predicted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform, nearest_rotation
from heliogauge.images.photos import read_luma
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.running.progress import Progress
from heliogauge.running.threads import side_by_side
from heliogauge.validate import Float32Array, FloatArray
from observer.corners.corner_points import corner_points
from observer.corners.lattice import PanelLattice
from observer.corners.panel_lines import FittedPose, fit_pose, photo_noise
from observer.corners.start_pose import edge_map, match_anywhere, match_at_place
from observer.photo_edges.views import View
from observer.pipeline.photos import Finder, FirstLook
from observer.product.pictures import empty_slices
from observer.targets.module_targets import spans_an_area
from photogrammetry.detection import Detections
from photogrammetry.pipeline import OnePhoto
from photogrammetry.start_values import LeftOut

#: Photos in which the collector is searched for everywhere.
_START_PHOTOS = 3
#: Turns about the line of sight that are tried, and how far a direction may be off, in sigmas of the turns.
_TURNS, _REACH = (-2.0, -1.2, -0.4, 0.4, 1.2, 2.0), 3.0
#: A collector is found when the odds against the next best place are this large.
_CLEAR_ODDS = float(np.log(1e3))
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
    """What predicts the corners.

    lattice: The drawing.
    positions: Places and turns of the camera.
    lever_m (3,): From the camera to what is positioned, in the camera's frame [m].
    enu_from_frame (3, 3): The collector's turn by azimuth and orientation.
    turn_sigma_rad: Error of the turns, 1 sigma [rad].
    is_tied: Whether the places are in the collector's frame already, as those of a far camera.
    """

    lattice: PanelLattice
    positions: PlacesOfPhotos
    lever_m: FloatArray
    enu_from_frame: FloatArray
    turn_sigma_rad: float
    is_tied: bool = False

    @property
    def same_m(self) -> float:
        """Two places of the drone against the drawing are the same within half a panel: wrong ones are panels off [m].

        Positions are good to centimetres; poses of single photos are moved by a decimetre by corners that are off by
        millimetres.
        """
        return 0.5 * min(float(np.diff(edges).min()) for edges in self.lattice.edges_m)


class _Tied(NamedTuple):
    """The drone's positions in the collector's frame: its turn, and its origin east, north, up [m]."""

    enu_from_frame: FloatArray
    origin_m: FloatArray


class _Photo(NamedTuple):
    """A photo in hand: name, image, camera by the finder, and the place and turn that the drone says."""

    name: str
    image: Float32Array
    place_m: FloatArray
    sigma_m: FloatArray
    enu_from_camera: FloatArray


def find_corners(
    files: Sequence[Path], finder: Finder, search: CornerSearch, *, jobs: int | None, progress: Progress
) -> FirstLook:
    """Find the corners of the panels in all photos.

    files: The photos.
    finder: With the cameras.
    Returns: Corners and provisional poses; photos that were refused have a reason and neither.
    InputError: The camera is not known, positions or turns are missing, or a photo cannot be read.
    EstimationError: The collector is not found, or it may lie in several places.
    """
    missing = [file.name for file in files if file.name not in finder.camera_of]
    if missing:
        raise InputError("corners: the camera must be known (a file, or focal_px): corners predict from it")
    said = {name: k for k, name in enumerate(search.positions.photos)}
    turned = [file for file in files if _row(search, said, file.name) is not None]
    if len(turned) < 2 and not search.is_tied:
        raise InputError(
            f"positions: {len(turned)} of {len(files)} photos have a place and the turn of the camera (yaw, pitch, "
            "roll), two are needed to predict where the panels' corners are"
        )
    with progress.stage("find the collector"):
        some = [turned[k] for k in np.unique(np.linspace(0, len(turned) - 1, _START_PHOTOS + 2).round().astype(int))]
        some = some[1:-1] if len(some) > 3 else some
        tied = _Tied(np.eye(3), np.zeros(3)) if search.is_tied else _tie(some, finder, search, said, jobs)
    with progress.stage("find corners", len(files)) as stage:

        def one(number: int) -> tuple[OnePhoto, RigidTransform | None]:
            found = _look(files[number], finder, search, said, tied)
            stage.advance()
            return found

        found = side_by_side(one, range(len(files)), jobs)
    names = tuple(file.name for file in files)
    poses = {name: pose for name, (_, pose) in zip(names, found, strict=True) if pose is not None}
    if len(poses) < 2:
        reasons = "; ".join(f"{one.refused[0].name}: {one.refused[0].reason}" for one, _ in found if one.refused)
        raise EstimationError(f"corners: {len(poses)} photos show enough of them, two are needed ({reasons[:400]})")
    slices = empty_slices(finder.expected.collector, finder.expected.y_m, len(files))
    return FirstLook(names, tuple(one for one, _ in found), poses, {}, {}, slices, finder.encodings)


def _row(search: CornerSearch, said: dict[str, int], name: str) -> tuple[int, FloatArray] | None:
    row = said.get(name)
    turn = None if row is None else search.positions.enu_from_camera(row)
    return None if row is None or turn is None else (row, turn)


def _open(file: Path, search: CornerSearch, said: dict[str, int]) -> _Photo | None:
    known = _row(search, said, file.name)
    if known is None:
        return None
    row, turn = known
    image = np.asarray(read_luma(file), dtype=np.float32)
    return _Photo(file.name, image, search.positions.enu_m[row], search.positions.sigma_m[row], turn)


class _Candidate(NamedTuple):
    """A place at which a photo may show the collector."""

    photo: int
    fitted: FittedPose
    enu_from_frame: FloatArray
    origin_m: FloatArray


def _tie(files: Sequence[Path], finder: Finder, search: CornerSearch, said: dict[str, int], jobs: int | None) -> _Tied:
    """Find the collector in some photos, and from these where the drone's positions have it.

    EstimationError: No place in which the photos agree, or two.
    """

    def one(number: int) -> list[_Candidate]:
        photo = _open(files[number], search, said)
        if photo is None:
            return []
        camera = finder.camera_of[photo.name]
        rotation = photo.enu_from_camera.T @ search.enu_from_frame
        turns = search.turn_sigma_rad * np.array([-1.0, 0.0, 1.0])
        start = View(camera, RigidTransform(rotation, np.array([0.0, 0.0, 1.0])))
        noise = photo_noise(photo.image)
        found = []
        for match in match_anywhere(edge_map(photo.image), start, search.lattice, turns.tolist()):
            fitted = fit_pose(photo.image, View(camera, match.cam_from_frame), search.lattice, noise)
            if fitted is not None:
                found.append(_candidate(number, fitted, photo, search))
        return found

    candidates = [one for part in side_by_side(one, range(len(files)), jobs) for one in part]
    if not candidates:
        raise EstimationError(
            f"corners: the panels' edges of the drawing are in none of {', '.join(file.name for file in files)}; are "
            "panel_edges_x_m, panel_edges_y_m, azimuth_deg, the camera and its turns right?"
        )
    totals = np.array([_agreeing(one, candidates, len(files), search.same_m) for one in candidates])
    best = candidates[int(np.argmax(totals))]
    apart = np.array([np.linalg.norm(one.origin_m - best.origin_m) > search.same_m for one in candidates])
    rival = float(totals[apart].max(initial=0.0))
    if totals.max() - rival < _CLEAR_ODDS:
        raise EstimationError(
            "corners: the panels' edges fit the photos in two places nearly as well, by whole panels apart; show more "
            "of the collector's ends in the photos, or mark targets"
        )
    same = [one for one, is_apart in zip(candidates, apart, strict=True) if not is_apart]
    turn = nearest_rotation(np.sum([one.enu_from_frame for one in same], axis=0))
    origins = [
        photo_place - turn @ one.fitted.cam_from_frame.inverse().apply(search.lever_m)
        for one in same
        for photo_place in [search.positions.enu_m[said[files[one.photo].name]]]
    ]
    return _Tied(turn, np.median(origins, axis=0))


def _candidate(number: int, fitted: FittedPose, photo: _Photo, search: CornerSearch) -> _Candidate:
    turn = photo.enu_from_camera @ fitted.cam_from_frame.rotation
    # By the stated turn: gimbals are off by different amounts from photo to photo.
    origin = photo.place_m - search.enu_from_frame @ fitted.cam_from_frame.inverse().apply(search.lever_m)
    return _Candidate(number, fitted, turn, origin)


def _agreeing(one: _Candidate, candidates: Sequence[_Candidate], count: int, same_m: float) -> float:
    """Return the logarithm of the odds of a place from all photos: of each its best candidate that agrees."""
    best = np.zeros(count)
    for other in candidates:
        if float(np.linalg.norm(other.origin_m - one.origin_m)) <= same_m:
            best[other.photo] = max(best[other.photo], other.fitted.log_odds)
    return float(best.sum())


def _look(
    file: Path, finder: Finder, search: CornerSearch, said: dict[str, int], tied: _Tied
) -> tuple[OnePhoto, RigidTransform | None]:
    """Find the corners of one photo."""
    photo = _open(file, search, said)
    if photo is None:
        return _refused(file.name, read_luma(file).shape, "no position and turn of the camera"), None
    camera, lattice, shape = finder.camera_of[photo.name], search.lattice, photo.image.shape
    rotation = photo.enu_from_camera.T @ tied.enu_from_frame
    antenna = tied.enu_from_frame.T @ (photo.place_m - tied.origin_m)
    eye = antenna - rotation.T @ search.lever_m
    start = View(camera, RigidTransform(rotation, -rotation @ eye))
    turns = search.turn_sigma_rad * np.array(_TURNS)
    match = match_at_place(edge_map(photo.image), start, lattice, _REACH * search.turn_sigma_rad, turns.tolist())
    noise = photo_noise(photo.image)
    fitted = None if match is None else fit_pose(photo.image, View(camera, match.cam_from_frame), lattice, noise)
    if fitted is None:
        return _refused(file.name, shape, "the panels' edges are not where drone and drawing predict them"), None
    pose = fitted.cam_from_frame
    off = tied.enu_from_frame @ (pose.inverse().apply(search.lever_m) - antenna)
    turned = tied.enu_from_frame @ pose.origin_covariance(fitted.covariance) @ tied.enu_from_frame.T
    expected = turned + np.diag(2 * photo.sigma_m**2)
    if float(off @ np.linalg.solve(expected, off)) > _CONTRADICTED**2 and float(np.linalg.norm(off)) > search.same_m:
        reason = f"by its panels' edges it was taken {float(np.linalg.norm(off)):.2g} m from where the drone says"
        return _refused(file.name, shape, reason), None
    points = corner_points(View(camera, pose), lattice, fitted)
    found = Detections(
        file.name,
        lattice.names,
        points.pixels_px,
        points.covariance_px2,
        np.full(len(lattice.names), np.nan),
        points.flags,
    )
    refused = tuple(
        LeftOut(f"{name} in {file.name}", _REASONS[SampleFlag(int(flag))])
        for name, flag in zip(lattice.names, points.flags, strict=True)
        if flag
    )
    count = int(np.count_nonzero(found.usable))
    if count < _LEAST_CORNERS or not spans_an_area(lattice.points_m[found.usable]):
        return _refused(file.name, shape, f"{count} corners, {_LEAST_CORNERS} not on a line are needed"), None
    none = found.chosen(np.zeros(0, dtype=np.intp))
    shapes = np.full((len(found), 2, 2), np.nan)
    size = int(shape[1]), int(shape[0])
    one = OnePhoto(found, shapes, size, refused, none, np.zeros((0, 2, 2)))
    return one.with_thumbnail(make_thumbnail(photo.image)), pose


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
