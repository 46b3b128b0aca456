"""Where a collector lies in a photo, from its lines alone: templates of them correlated with the photo's edges.

The camera's turn is known roughly, and perhaps where it was. What is left is where in the photo the collector is, and
without its place how far it is: templates of the drawing at several distances and turns about the line of sight are
correlated with the places where brightness changes most.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform, rotation_between, rotation_from_vector
from heliogauge.validate import Float32Array, FloatArray
from observer.corners.lattice import PanelLattice
from observer.photo_edges.views import AnyImage, View

#: Pixels of the longer side of the photo in which the collector is searched: gaps 200 px apart stay 30 px apart; and
#: where thousands of poses are tried before the best ones are looked at closer.
_SIDE_PX, COARSE_SIDE_PX = 320, 160
#: Share of these that are taken for edges: lines of 49 panels' edges of three pixels cover some 15 %.
_EDGE_SHARE = 0.15
#: Step of the distances that are tried: half a step moves lines at the border of the photo by 2 pixels.
_DISTANCE_STEP = 0.025
#: The collector's longer side in shares of the photo's diagonal: from far away, and from so near that most is cut off.
_LEAST_SIZE, _MOST_SIZE = 0.15, 2.0
#: Poses that are looked at closely, for each that is returned.
_REFINED = 4
#: Poses nearer to each other than this are the same [m].
_APART_M = 0.5
#: Points of each line.
_POINTS = 12
#: First step of the distance of a pose that is made to fit, and steps of one size.
_COARSEST_SHARE, _CLIMBS = 0.05, 6


@dataclass(frozen=True, slots=True, eq=False)
class EdgeMap:
    """Where a photo, made smaller, has edges.

    spectrum: Of the edges, less their mean.
    spread: Standard deviation of a pixel.
    reduction: Pixels of the photo for one of the map.
    shape: Rows and columns.
    """

    spectrum: np.ndarray
    spread: float
    reduction: float
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """A pose at which the drawing fits the edges of a photo.

    score: Sum over the drawing's lines in standard deviations of what chance gives.
    """

    cam_from_frame: RigidTransform
    score: float

    @property
    def eye_m(self) -> FloatArray:
        """Where the camera was, shape (3,) [m]."""
        return self.cam_from_frame.inverse().translation_m


def edge_map(image: AnyImage, side_px: int = _SIDE_PX) -> EdgeMap:
    """Return where a photo has edges.

    side_px: Pixels of the map's longer side.
    """
    height, width = image.shape[:2]
    reduction = max(1.0, max(height, width) / side_px)
    smooth = cv2.GaussianBlur(np.asarray(image, dtype=np.float32), (0, 0), 1.0)
    strength = cv2.magnitude(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    size = round(width / reduction), round(height / reduction)
    # The strongest edge in each pixel of the map, so that lines of one pixel do not fade.
    reach = int(np.ceil(reduction))
    strongest = cv2.dilate(strength, np.ones((reach, reach), np.uint8))
    small = cv2.resize(strongest, size, interpolation=cv2.INTER_NEAREST)
    edges = (small > np.quantile(small, 1 - _EDGE_SHARE)).astype(np.float32)
    edges -= edges.mean()
    return EdgeMap(np.fft.rfft2(edges, _padded(edges.shape)), float(edges.std()), reduction, (size[1], size[0]))


def _padded(shape: tuple[int, ...]) -> tuple[int, int]:
    rows, columns = (cv2.getOptimalDFTSize(2 * size) for size in shape[:2])
    return rows, columns + columns % 2


def _template(view: View, lattice: PanelLattice, edges: EdgeMap) -> Float32Array | None:
    """Draw the lines that a pose predicts; None where hardly any are in the photo."""
    rows, columns = edges.shape
    drawn = np.zeros((rows, columns), dtype=np.uint8)
    share = np.linspace(0, 1, _POINTS)
    points = np.concatenate([lattice.along(line, share) for line in lattice.lines])
    inside = view.cam_from_frame.apply(points)
    pixels = np.where(inside[:, 2:] > 0.1, view.camera.project(inside), np.nan).reshape(-1, _POINTS, 2)
    for line in (pixels + 0.5) / edges.reduction - 0.5:
        if np.isfinite(line).all() and np.abs(line).max() < 1e4:
            cv2.polylines(drawn, [np.rint(line).astype(np.int32)], isClosed=False, color=1)
    return None if np.count_nonzero(drawn) < _POINTS else drawn.astype(np.float32)


def _shifts(template: Float32Array, edges: EdgeMap, reach_px: float) -> tuple[float, FloatArray]:
    """Return the best score of a template and the shift that gives it [px of the photo]."""
    padded = _padded(edges.shape)
    sums = np.fft.irfft2(edges.spectrum * np.conj(np.fft.rfft2(template, padded)), padded)
    rows, columns = (np.fft.fftfreq(size, 1 / size) for size in padded)
    most = max(1.0, reach_px / edges.reduction)
    sums = np.where((np.abs(rows) <= most)[:, None] & (np.abs(columns) <= most), sums, -np.inf)
    row, column = np.unravel_index(int(np.argmax(sums)), sums.shape)
    score = float(sums[row, column]) / (edges.spread * float(np.sqrt(np.count_nonzero(template))))
    return score, np.array([columns[column], rows[row]]) * edges.reduction


def match_at_place(
    edges: EdgeMap, view: View, lattice: PanelLattice, reach_rad: float, turns_rad: Sequence[float]
) -> Match | None:
    """Turn a camera whose place is known until the drawing fits; None where the photo does not show the collector.

    view: As predicted.
    reach_rad: How far its direction may be off [rad].
    turns_rad: Turns about its line of sight that are tried [rad].
    """
    camera, eye = view.camera, view.eye_m
    middle = np.array([[0.0, 0.0, 0.0]])
    best: Match | None = None
    for turn in turns_rad:
        rotation = rotation_from_vector(np.array([0.0, 0.0, turn])) @ view.cam_from_frame.rotation
        pose = RigidTransform(rotation, -rotation @ eye)
        for _ in range(2):
            template = _template(View(camera, pose), lattice, edges)
            if template is None:
                break
            score, shift = _shifts(template, edges, reach_rad * camera.focal_x_px)
            start = camera.project(pose.apply(middle))
            rays = camera.cast_rays(np.concatenate([start, start + shift]))
            if not np.isfinite(rays).all():
                break
            rotation = rotation_between(rays[0], rays[1]) @ pose.rotation
            pose = RigidTransform(rotation, -rotation @ eye)
            if best is None or score > best.score:
                best = Match(pose, score)
    return best


def turned_about_axis(view: View, angle_rad: float) -> View:
    """Return a camera in the same place that is turned about its line of sight.

    angle_rad: By the right hand [rad].
    """
    rotation = rotation_from_vector(np.array([0.0, 0.0, angle_rad])) @ view.cam_from_frame.rotation
    return View(view.camera, RigidTransform(rotation, -rotation @ view.eye_m))


def aimed_at_origin(view: View) -> View:
    """Return a camera in the same place that looks at the origin, turned as little as possible."""
    ray = view.cam_from_frame.translation_m
    rotation = rotation_between(ray / np.linalg.norm(ray), np.array([0.0, 0.0, 1.0])) @ view.cam_from_frame.rotation
    return View(view.camera, RigidTransform(rotation, -rotation @ view.eye_m))


def _moved_onto(edges: EdgeMap, camera: Camera, pose: RigidTransform, lattice: PanelLattice) -> Match | None:
    """Move a camera across its line of sight until the drawing fits; the score is that of the pose before."""
    template = _template(View(camera, pose), lattice, edges)
    if template is None:
        return None
    score, shift = _shifts(template, edges, float(np.hypot(camera.width_px, camera.height_px)))
    ray = camera.cast_rays(camera.project(pose.translation_m[None]) + shift)[0]
    if not np.isfinite(ray).all():
        return None
    return Match(RigidTransform(pose.rotation, ray / ray[2] * pose.translation_m[2]), score)


def match_anywhere(
    edges: EdgeMap,
    camera: Camera,
    rotations: Sequence[FloatArray],
    lattice: PanelLattice,
    *,
    step: float = _DISTANCE_STEP,
    most: int = 4,
) -> list[Match]:
    """Find a collector of which only the camera's turn against it is known, or guessed.

    rotations: Turns of the frame into the camera's that are tried, shape (3, 3) each.
    step: Of the distances that are tried, one over the other, less 1.
    most: Poses that are returned, the best first, apart from each other.
    """
    diagonal = float(np.hypot(camera.width_px, camera.height_px))
    size = max(lattice.collector.length_m, lattice.collector.aperture_width_m)
    near, far = (camera.focal_x_px * size / (share * diagonal) for share in (_MOST_SIZE, _LEAST_SIZE))
    count = int(np.log(far / near) / step) + 1
    tried: list[Match] = []
    for distance in np.geomspace(near, far, count):
        for rotation in rotations:
            moved = _moved_onto(edges, camera, RigidTransform(rotation, np.array([0.0, 0.0, distance])), lattice)
            tried += [] if moved is None else [moved]
    tried.sort(key=lambda one: -one.score)
    found: list[Match] = []
    for one in tried[: _REFINED * most]:
        # Drawn where it is seen it looks otherwise than in the middle of the photo.
        for _ in range(2):
            moved = _moved_onto(edges, camera, one.cam_from_frame, lattice)
            if moved is None:
                break
            one = moved
        found.append(one)
    found.sort(key=lambda one: -one.score)
    chosen: list[Match] = []
    for one in found:
        if all(np.linalg.norm(one.eye_m - other.eye_m) > _APART_M for other in chosen):
            chosen.append(one)
        if len(chosen) == most:
            break
    return chosen


def turned_to_fit(edges: EdgeMap, camera: Camera, match: Match, lattice: PanelLattice, step_rad: float) -> Match:
    """Turn a camera whose direction is a guess, and change its distance, until the drawing fits better by neither.

    step_rad: First step; it is halved three times [rad].
    """
    best = match
    for halving in range(4):
        turn, share = step_rad / 2**halving, 0.5 * _COARSEST_SHARE / 2**halving
        for _ in range(_CLIMBS):
            before = best
            for axis, way in ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1), (3, 1), (3, -1)):
                pose = before.cam_from_frame
                middle = pose.translation_m * (1 + way * share if axis == 3 else 1.0)
                # About the collector: its picture stays where it is, the camera goes round it.
                vector = np.zeros(3)
                vector[axis % 3] = 0.0 if axis == 3 else way * turn
                moved = _moved_onto(
                    edges, camera, RigidTransform(rotation_from_vector(vector) @ pose.rotation, middle), lattice
                )
                if moved is not None and moved.score > best.score:
                    best = moved
            if best is before:
                break
    return best
