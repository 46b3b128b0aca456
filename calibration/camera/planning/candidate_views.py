"""Views of a board that a next photo could be: turned, tilted, near or far, anywhere in the image."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.validate import FloatArray

#: Turns of the camera about its axis; tilts of 30 to 45 deg are what a person holds and a detector reads.
_ROLLS_RAD = np.radians([0.0, 90.0, 180.0, 270.0])
_TILTS_RAD = np.radians([30.0, 45.0])
_DIRECTIONS_RAD = np.radians(np.arange(0.0, 360.0, 45.0))
#: Sizes of the box in the image that the board fills, as shares of width and height, and where the box is.
_BOXES = ((1.0, (0.5,)), (0.8, (0.0, 1.0)), (0.6, (0.0, 0.5, 1.0)))
#: The image's border stays free by this share: what is nearer is cut when the camera is held by hand.
_FREE_SHARE = 0.02
#: Around the points a board has squares, and needs paper around them: so many pitches are in the photo, too.
_RIM_PITCHES = 1.5
#: Placing the board in its box settles within a pixel in five steps; with a strong lens in ten.
_MOST_STEPS, _SETTLED_PX = 20, 1.0
#: Words for places in thirds of the image, and for sides of the board in eighths of a turn from right over down.
_ACROSS, _DOWN = ("left", "middle", "right"), ("top", "middle", "bottom")
_SIDES = ("right", "lower right", "lower", "lower left", "left", "upper left", "upper", "upper right")


@dataclass(frozen=True, slots=True, eq=False)
class Lengths:
    """What of a board and of its photos limits the next ones.

    points_m (k, 3): The board's points [m].
    pitch_m: Distance of neighbours [m].
    nearest_m, farthest_m: Distances of the camera that are possible [m].
    """

    points_m: FloatArray
    pitch_m: float
    nearest_m: float
    farthest_m: float

    @property
    def outline_m(self) -> FloatArray:
        """Corners of what must be in the photo, shape (4, 3) [m]."""
        low, high = self.points_m.min(axis=0), self.points_m.max(axis=0)
        rim = _RIM_PITCHES * self.pitch_m
        corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
        middle, half = 0.5 * (low + high)[:2], 0.5 * (high - low)[:2] + rim
        height = np.full((4, 1), float(self.points_m[:, 2].mean()))
        return np.concatenate([middle + corners * half, height], axis=1)


def candidate_views(camera: Camera, lengths: Lengths) -> Iterator[RigidTransform]:
    """Yield ``cam_from_board`` of all views that can be taken: the whole board is in the photo.

    camera: The camera, for the size of the image and its lens.
    """
    tilts = [(0.0, 0.0), *product(_TILTS_RAD.tolist(), _DIRECTIONS_RAD.tolist())]
    for roll, (tilt, direction) in product(_ROLLS_RAD.tolist(), tilts):
        across = tilt * np.array([-np.sin(direction), np.cos(direction), 0.0])
        upright = rotation_from_vector(np.array([0.0, 0.0, roll])) @ np.diag([1.0, -1.0, -1.0])
        rotation = rotation_from_vector(across) @ upright
        for size, places in _BOXES:
            for x, y in product(places, places):
                pose = place_in_box(camera, lengths, rotation, size, (x, y))
                if pose is not None:
                    yield pose


def place_in_box(
    camera: Camera, lengths: Lengths, rotation: FloatArray, size: float, place: tuple[float, float]
) -> RigidTransform | None:
    """Move a turned board to where it fills a box in the image.

    rotation (3, 3): Of ``cam_from_board``.
    size: Width and height of the box as a share of the image's.
    place: Where the box is, 0 at the left or upper edge, 1 at the other one.
    Returns: ``cam_from_board``; None where the distance is out of reach or a part of the board is out of the image.
    """
    outline = np.concatenate([lengths.outline_m, lengths.points_m])
    image = np.array([camera.width_px, camera.height_px])
    room = (1 - 2 * _FREE_SHARE) * image
    low = _FREE_SHARE * image + np.array(place) * (1 - size) * room - 0.5
    box, focal = size * room, np.array([camera.focal_x_px, camera.focal_y_px])
    turned = outline @ rotation.T
    middle = 0.5 * (turned.min(axis=0) + turned.max(axis=0))
    depth = float((np.ptp(turned[:, :2], axis=0) * focal / box).max())
    center = (low + 0.5 * box - [camera.center_x_px, camera.center_y_px]) / focal
    origin = np.append(center * depth, depth) - middle
    for _ in range(_MOST_STEPS):
        places = turned + origin
        if places[:, 2].min() <= 0.1 * depth:
            return None
        pixels = camera.project(places)
        if not np.isfinite(pixels).all():
            return None
        first, last = pixels.min(axis=0), pixels.max(axis=0)
        off = low + 0.5 * box - 0.5 * (first + last)
        share = float(((last - first) / box).max())
        if np.abs(off).max() < _SETTLED_PX and abs(share - 1) * float(box.max()) < _SETTLED_PX:
            break
        depth *= share
        moved = (origin[:2] + middle[:2]) / (origin[2] + middle[2]) + off / focal
        origin = np.append(moved * depth, depth) - middle
    else:
        return None
    pose = RigidTransform(rotation, origin)
    reach = float(np.linalg.norm(origin))
    return pose if lengths.nearest_m <= reach <= lengths.farthest_m else None


def place_words(camera: Camera, pixels_px: FloatArray) -> str:
    """Say where in the image the board is.

    pixels_px (n, 2): Its outline [px].
    """
    middle = 0.5 * (pixels_px.min(axis=0) + pixels_px.max(axis=0)) + 0.5
    shares = middle / [camera.width_px, camera.height_px]
    column, row = (int(np.clip(3 * (share - 0.5) * 1.5 + 1.5, 0, 2)) for share in shares)
    if (column, row) == (1, 1):
        return "middle"
    if column == 1 or row == 1:
        return _DOWN[row] if column == 1 else _ACROSS[column]
    return f"{_DOWN[row]} {_ACROSS[column]}"


def nearer_side(pose: RigidTransform) -> str:
    """Say which side of the board in the image is nearer to the camera; empty where none is."""
    normal = pose.rotation[:, 2] * -np.sign(pose.rotation[2, 2])
    if np.hypot(normal[0], normal[1]) < np.sin(0.5 * _TILTS_RAD[0]):
        return ""
    turn = np.arctan2(-normal[1], -normal[0])
    return _SIDES[round(turn / (np.pi / 4)) % 8]
