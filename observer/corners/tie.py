"""Where a drone's positions have the collectors of a flight: from a few photos that must agree.

Each of these photos is searched for the drawing everywhere. A place in it says where the origin that all collectors
have in common would be in the drone's positions; of all such places that is taken on which photos and collectors agree.
Without the camera's turns its directions are tried out, and so is the half turn after which most drawings look the
same: the drone's way from photo to photo contradicts it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, nearest_rotation, rotation_from_vector
from heliogauge.validate import Float32Array, FloatArray
from observer.corners.lattice import PanelLattice
from observer.corners.panel_lines import FittedPose, fit_pose, photo_noise
from observer.corners.start_pose import COARSE_SIDE_PX, Match, edge_map, match_anywhere, turned_to_fit
from observer.photo_edges.views import View

#: A collector is found when the odds against the next best place are this large.
_CLEAR_ODDS = float(np.log(1e3))
#: Directions to the collector that are tried where nobody says how the camera was turned, across and along the trough:
#: a pass from 15 m is seen from 13 degrees aside at its ends, from half of that in the photos that are searched [rad].
_ACROSS, _ALONG = np.radians([-12.0, -6.0, 0.0, 6.0, 12.0]), np.radians([-5.0, 0.0, 5.0])
#: ... with distances so far apart; the best poses are turned and moved until they fit.
_COARSE_STEP = 0.05
#: Panels' edges that lie so near to their mirror images make the drawing look the same after half a turn [m].
_SYMMETRIC_M = 0.05
#: Two turns of one camera are the same, not half a turn apart, by the trace of one against the other: 3 less twice the
#: angle's versed sine; 90 degrees lie between.
_ALIKE_TRACE = 1.0
#: A camera that looks down, the long side of its image along the trough; rows are its axes in the trough's frame.
_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_HALF_TURN = RigidTransform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


@dataclass(frozen=True, eq=False)
class SearchedCollector:
    """A collector that is looked for.

    lattice: The drawing.
    enu_from_frame (3, 3): Its turn by azimuth and orientation.
    place_enu_m (3,): Its origin from that which all collectors of the flight have in common, east, north, up [m].
    lever_m (3,): From the camera to what is positioned, in the camera's frame [m].
    turn_sigma_rad: Error of the turns, 1 sigma [rad].
    """

    lattice: PanelLattice
    enu_from_frame: FloatArray
    place_enu_m: FloatArray
    lever_m: FloatArray
    turn_sigma_rad: float

    @cached_property
    def is_symmetric(self) -> bool:
        """Whether the drawing looks the same after half a turn."""
        return all(bool(np.all(np.abs(edges + edges[::-1]) < _SYMMETRIC_M)) for edges in self.lattice.edges_m)

    @property
    def same_m(self) -> float:
        """Two places of the drone against the drawing are the same within half a panel: wrong ones are panels off [m].

        Positions are good to centimetres; poses of single photos are moved by a decimetre by corners that are off by
        millimetres.
        """
        return 0.5 * min(float(np.diff(edges).min()) for edges in self.lattice.edges_m)

    def looks_like(self, other: "SearchedCollector") -> bool:
        """Return whether a photo that is searched for one is searched for the other as well."""
        return np.allclose(self.enu_from_frame, other.enu_from_frame) and all(
            own.shape == its.shape and np.allclose(own, its)
            for own, its in zip(
                (*self.lattice.edges_m, np.array([self.lattice.collector.focal_length_m])),
                (*other.lattice.edges_m, np.array([other.lattice.collector.focal_length_m])),
                strict=True,
            )
        )


class SearchedPhoto(NamedTuple):
    """A photo in hand: name, image, camera, the drone's place with its sigma, and the camera's turn if it is known."""

    name: str
    image: Float32Array
    camera: Camera
    place_m: FloatArray
    sigma_m: FloatArray
    enu_from_camera: FloatArray | None


class Heading(NamedTuple):
    """How the camera was turned in a photo in which the collector was found.

    place_m (3,): Where the drone says it was, east, north, up [m].
    enu_from_camera (3, 3): Its turn.
    """

    place_m: FloatArray
    enu_from_camera: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Tied:
    """The drone's positions against the collectors.

    turn (3, 3): What compass, azimuth and orientation together are off: it turns the stated directions into those seen.
    origin_m (3,): The common origin, east, north, up [m].
    headings: Cameras' turns where the collector was found; empty where the drone says them.
    """

    turn: FloatArray
    origin_m: FloatArray
    headings: tuple[Heading, ...] = ()

    def enu_from_frame(self, one: SearchedCollector) -> FloatArray:
        """Return the turn of a collector."""
        return np.asarray(self.turn @ one.enu_from_frame)

    def origin_of(self, one: SearchedCollector) -> FloatArray:
        """Return the origin of a collector, east, north, up [m]."""
        return np.asarray(self.origin_m + self.turn @ one.place_enu_m)


class _Candidate(NamedTuple):
    """A place at which a photo may show a collector.

    turn: What the stated directions would be off by the camera's stated turn.
    origin_m: Where it has the common origin, by the stated directions: gimbals are off by different amounts from photo
        to photo.
    """

    photo: int
    collector: int
    fitted: FittedPose
    turn: FloatArray
    origin_m: FloatArray


def tie(
    photos: Sequence[SearchedPhoto],
    collectors: Sequence[SearchedCollector],
    each: Callable[[Callable[[int], list[list[FittedPose]]], int], list[list[list[FittedPose]]]],
) -> Tied:
    """Find the collectors in some photos, and from these where the drone's positions have them.

    photos: Some of a flight, apart from each other.
    each: Calls a function with the number of each photo, as side by side.
    EstimationError: No place in which the photos agree, or two.
    """
    kinds = _kinds(collectors)

    def one(number: int) -> list[list[FittedPose]]:
        return [_found(photos[number], collectors[members[0]]) for members in kinds]

    candidates = [
        _candidate(number, k, fitted, photos[number], collectors[k])
        for number, of_kinds in enumerate(each(one, len(photos)))
        for members, found in zip(kinds, of_kinds, strict=True)
        for k in members
        for fitted in found
    ]
    if not candidates:
        raise EstimationError(
            f"corners: the panels' edges of the drawing are in none of {', '.join(one.name for one in photos)}; are "
            "panel_edges_x_m, panel_edges_y_m, azimuth_deg, the camera and its turns right?"
        )
    same_m = min(one.same_m for one in collectors)
    origins, odds = np.array([one.origin_m for one in candidates]), [one.fitted.log_odds for one in candidates]
    pair = np.array([one.photo * len(collectors) + one.collector for one in candidates])
    near = np.linalg.norm(origins[:, None] - origins, axis=2) <= same_m
    totals = np.array([_agreeing(pair[row], np.array(odds)[row]) for row in near])
    best = int(np.argmax(totals))
    if totals[best] - float(totals[~near[best]].max(initial=0.0)) < _CLEAR_ODDS:
        raise EstimationError(
            "corners: the panels' edges fit the photos in two places nearly as well, by whole panels or rows apart; "
            "show more of the collectors' ends in the photos, or mark targets"
        )
    _refuse_other_rows(totals, origins - origins[best], collectors)
    same = [one for one, is_near in zip(candidates, near[best], strict=True) if is_near]
    turn = nearest_rotation(np.sum([one.turn for one in same], axis=0))
    places = [
        photos[one.photo].place_m
        - turn
        @ (
            collectors[one.collector].enu_from_frame
            @ one.fitted.cam_from_frame.inverse().apply(collectors[one.collector].lever_m)
            + collectors[one.collector].place_enu_m
        )
        for one in same
    ]
    return Tied(turn, np.median(places, axis=0), _headings(same, photos, collectors))


def _kinds(collectors: Sequence[SearchedCollector]) -> list[list[int]]:
    """Return numbers of collectors that look the same, so that a photo is searched for them once."""
    kinds: list[list[int]] = []
    for number, one in enumerate(collectors):
        kind = next((kind for kind in kinds if one.looks_like(collectors[kind[0]])), None)
        if kind is None:
            kinds.append([number])
        else:
            kind.append(number)
    return kinds


def _found(photo: SearchedPhoto, one: SearchedCollector) -> list[FittedPose]:
    """Return poses at which a photo may show a collector."""
    noise, found = photo_noise(photo.image), []
    for match in _matches(photo, one):
        fitted = fit_pose(photo.image, View(photo.camera, match.cam_from_frame), one.lattice, noise)
        if fitted is not None:
            found.append(fitted)
            if photo.enu_from_camera is None and one.is_symmetric:
                found.append(fitted.turned(_HALF_TURN))
    return found


def _matches(photo: SearchedPhoto, one: SearchedCollector) -> list[Match]:
    edges, steps = edge_map(photo.image), one.turn_sigma_rad * np.array([-1.0, 0.0, 1.0])
    if photo.enu_from_camera is not None:
        rotation = photo.enu_from_camera.T @ one.enu_from_frame
        turned = [rotation_from_vector(np.array([0.0, 0.0, step])) @ rotation for step in steps]
        return match_anywhere(edges, photo.camera, turned, one.lattice)
    quarters = np.radians([0.0, 90.0] if one.is_symmetric else [0.0, 90.0, 180.0, 270.0])
    tried = [
        rotation_from_vector(np.array([0.0, 0.0, quarter])) @ _DOWN @ rotation_from_vector(np.array([along, across, 0]))
        for quarter in quarters
        for across in _ACROSS
        for along in _ALONG
    ]
    small = edge_map(photo.image, COARSE_SIDE_PX)
    coarse = match_anywhere(small, photo.camera, tried, one.lattice, step=_COARSE_STEP)
    fitting: list[Match] = []
    for match in coarse:
        best = turned_to_fit(edges, photo.camera, match, one.lattice, float(_ACROSS[3]) / 2)
        # Many a guess ends at the same place.
        if all(np.linalg.norm(best.eye_m - other.eye_m) > one.same_m for other in fitting):
            fitting.append(best)
    return fitting


def _candidate(
    number: int, collector: int, fitted: FittedPose, photo: SearchedPhoto, one: SearchedCollector
) -> _Candidate:
    eye = one.enu_from_frame @ fitted.cam_from_frame.inverse().apply(one.lever_m)
    turn = np.eye(3)
    if photo.enu_from_camera is not None:
        turn = photo.enu_from_camera @ fitted.cam_from_frame.rotation @ one.enu_from_frame.T
    return _Candidate(number, collector, fitted, turn, photo.place_m - eye - one.place_enu_m)


def _agreeing(pair: FloatArray, log_odds: FloatArray) -> float:
    """Return the logarithm of the odds of a place from all photos: of each collector in each its best candidate."""
    best = np.zeros(int(pair.max()) + 1)
    np.maximum.at(best, pair.astype(np.intp), log_odds)
    return float(best.sum())


def _headings(
    same: Sequence[_Candidate], photos: Sequence[SearchedPhoto], collectors: Sequence[SearchedCollector]
) -> tuple[Heading, ...]:
    """Return the cameras' turns where nobody else says them; photos that half a turn leaves open say none.

    Above the middle of a collector, or of two rows, a photo may have been taken from either side.
    """
    turns: dict[int, list[FloatArray]] = {}
    for one in same:
        if photos[one.photo].enu_from_camera is None:
            turn = collectors[one.collector].enu_from_frame @ one.fitted.cam_from_frame.rotation.T
            turns.setdefault(one.photo, []).append(turn)
    return tuple(
        Heading(photos[number].place_m, own[0])
        for number, own in turns.items()
        if all(float(np.trace(own[0].T @ other)) > _ALIKE_TRACE for other in own)
    )


def _refuse_other_rows(totals: FloatArray, off_m: FloatArray, collectors: Sequence[SearchedCollector]) -> None:
    """Refuse stated rows that may as well be the next ones.

    Shapes: off_m (n, 3): Of the places from the best one.
    EstimationError: Moved by a row, the stated ones lose less than half of what one of them shows: where these are all
        there are, they lose all of one.
    """
    count = len(collectors)
    other = np.linalg.norm(off_m, axis=1) > min(one.lattice.collector.aperture_width_m for one in collectors)
    if count > 1 and float(totals[other].max(initial=0.0)) > (1 - 0.5 / count) * float(totals.max()):
        raise EstimationError(
            f"corners: the photos show more rows than the {count} modules, and do not tell which of them these are; "
            "name each row that the photos show as a [[module]], and show the ends of the field"
        )
