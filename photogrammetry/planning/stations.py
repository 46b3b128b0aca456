"""Camera stations for a network that is being planned: rings round an object, and what a camera sees from there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, looking_at
from heliogauge.validate import BoolArray, FloatArray, float_array, positive

#: Directions of a ring that are tried where part of it cannot be reached: every degree.
_DIRECTIONS = 360
#: Overlapping parts of an object that does not fit into one image: each takes this share of what the image holds.
_PART_SHARE = 0.6
#: What is closer to the image's edge than this share of its size does not count as seen: nobody aims better.
_EDGE_SHARE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class PlannedObject:
    """Targets to be measured.

    names length n: Their names.
    points_m (n, 3): Where they will be, to a few per cent of the distance [m].
    normals (n, 3): Unit vectors out of their faces; NaN for targets that are seen from everywhere.
    diameter_m: Diameter of the targets; 0 where their size in the image does not matter [m].
    InputError: Fewer than four targets, a name twice, or lengths that differ.
    """

    names: tuple[str, ...]
    points_m: FloatArray
    normals: FloatArray
    diameter_m: float = 0.0

    def __post_init__(self) -> None:
        points = float_array("planned targets: points_m", self.points_m, (None, 3))
        normals = np.array(self.normals, dtype=np.float64).reshape(-1, 3)
        if len(points) < 4 or len(set(self.names)) != len(points) or len(self.names) != len(normals):
            raise InputError(
                f"planned targets: at least four with different names are needed; there are {len(points)} points, "
                f"{len(set(self.names))} names and {len(normals)} normals"
            )
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(lengths > 0, lengths, np.nan)
        normals.setflags(write=False)
        object.__setattr__(self, "points_m", points)
        object.__setattr__(self, "normals", normals)

    @property
    def center_m(self) -> FloatArray:
        """Middle of the targets' extent, shape (3,) [m]."""
        return np.asarray(0.5 * (self.points_m.min(axis=0) + self.points_m.max(axis=0)))

    @property
    def facing(self) -> FloatArray:
        """Mean direction out of the object, shape (3,); of the flattest direction where normals say nothing."""
        mean = np.nansum(self.normals, axis=0)
        if np.linalg.norm(mean) > 0.2 * np.isfinite(self.normals[:, 0]).sum() > 0:
            return np.asarray(mean / np.linalg.norm(mean))
        flat = np.linalg.svd(self.points_m - self.points_m.mean(axis=0))[2][2]
        # Either side would do: the one that looks up, then towards +x.
        return np.asarray(flat * (np.sign(flat[2]) or np.sign(flat[0]) or 1.0))


@dataclass(frozen=True, slots=True)
class Reach:
    """Where a camera can be.

    distance_m: Distance from the camera to what it looks at [m].
    up: The vertical direction.
    lowest_m, highest_m: Heights along it between which a camera can be [m].
    turned: Whether every other photo is taken with the camera turned by 90 degrees about its axis.
    incidence_rad: Largest angle between a target's normal and the ray to the camera [rad].
    InputError: A distance or an angle that cannot be.
    """

    distance_m: float
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    lowest_m: float = float("-inf")
    highest_m: float = float("inf")
    turned: bool = True
    incidence_rad: float = np.radians(65.0)

    def __post_init__(self) -> None:
        positive("plan: distance_m", self.distance_m, "metres")
        positive("plan: length of up", float(np.linalg.norm(self.up)), "any unit")
        if not self.lowest_m < self.highest_m:
            raise InputError(f"plan: lowest_m = {self.lowest_m} is not below highest_m = {self.highest_m}")
        if not 0 < self.incidence_rad <= np.pi / 2:
            raise InputError(f"plan: largest incidence {np.degrees(self.incidence_rad):.0f} degrees: above 0 to 90")


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """One photo to take.

    center_m, aim_m (3,): Where the camera is, and the point in the middle of its image [m].
    ring_rad, azimuth_rad: Angle from the object's normal, and direction round it [rad].
    roll_rad: Turn about the viewing axis from the upright camera, clockwise seen from behind it [rad].
    cam_from_world: The pose.
    """

    center_m: FloatArray
    aim_m: FloatArray
    ring_rad: float
    azimuth_rad: float
    roll_rad: float
    cam_from_world: RigidTransform


def filling_distance_m(target_object: PlannedObject, camera: Camera) -> float:
    """Return the distance at which the object fills the image, seen obliquely and with the camera turned [m]."""
    radius = float(np.linalg.norm(target_object.points_m - target_object.center_m, axis=1).max())
    shorter = min(camera.width_px, camera.height_px)
    focal = min(camera.focal_x_px, camera.focal_y_px)
    # Half of the shorter side less the edge, and the near rim of an object that leans towards the camera.
    return radius * (focal / ((0.5 - _EDGE_SHARE) * shorter) + 0.7)


def aims_m(target_object: PlannedObject, camera: Camera, distance_m: float) -> FloatArray:
    """Divide an object that does not fit into one image; return what the cameras look at, shape (k, 3) [m]."""
    center, facing = target_object.center_m, target_object.facing
    if distance_m >= 0.9 * filling_distance_m(target_object, camera):
        return center[None]
    first, second = _across(facing, target_object.points_m - center)
    arms = target_object.points_m - center
    held = _PART_SHARE * distance_m * min(camera.width_px, camera.height_px) / camera.focal_x_px
    aims = center[None]
    for axis in (first, second):
        low, high = float((arms @ axis).min()), float((arms @ axis).max())
        count = max(1, int(np.ceil((high - low) / held)))
        places = low + (np.arange(count) + 0.5) * (high - low) / count
        aims = (aims[:, None] + places[:, None] * axis).reshape(-1, 3)
    # Onto the nearest target: the middle of a part of a curved object is beside it.
    nearest = np.argmin(np.linalg.norm(target_object.points_m[None] - aims[:, None], axis=2), axis=1)
    along = (target_object.points_m[nearest] - aims) @ facing
    return np.asarray(aims + along[:, None] * facing)


def _across(facing: FloatArray, arms: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the object's longest direction across its normal, and the one across both."""
    flat = arms - np.outer(arms @ facing, facing)
    first = np.linalg.svd(flat, full_matrices=False)[2][0]
    first = first - (first @ facing) * facing
    first /= np.linalg.norm(first)
    # A fixed sign, whatever the machine's linear algebra prefers.
    first *= np.sign(first[np.argmax(np.abs(first))])
    return first, np.cross(facing, first)


def ring_stations(
    target_object: PlannedObject, aims: FloatArray, reach: Reach, rings_rad: Sequence[float], count: int
) -> tuple[Station, ...]:
    """Place cameras on rings round the object's normal.

    aims (k, 3): What the cameras look at in turn [m].
    rings_rad: Angle of each ring from the object's normal [rad].
    Returns: Evenly shared among the rings, and on each among the directions that can be reached; fewer where a ring
        cannot be reached at all.
    """
    facing, up = target_object.facing, np.asarray(reach.up, dtype=np.float64)
    up = up / np.linalg.norm(up)
    first, second = _across(facing, target_object.points_m - target_object.center_m)
    stations: list[Station] = []
    for ring, angle in enumerate(rings_rad):
        own = count // len(rings_rad) + (ring < count % len(rings_rad))
        azimuths = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        round_it = np.cos(azimuths)[:, None] * first + np.sin(azimuths)[:, None] * second
        directions = np.cos(angle) * facing + np.sin(angle) * round_it
        for place in range(own):
            aim = aims[(len(stations)) % len(aims)]
            heights = (aim + reach.distance_m * directions) @ up
            free = np.nonzero((heights >= reach.lowest_m) & (heights <= reach.highest_m))[0]
            if not free.size:
                continue
            # Rings are turned against each other by half a step.
            share = (place + 0.5 * (ring % 2)) / own
            chosen = free[int(share * free.size) % free.size]
            roll = 0.5 * np.pi * (len(stations) % 2) if reach.turned else 0.0
            center = aim + reach.distance_m * directions[chosen]
            pose = looking_at(center, aim, up, roll)
            stations.append(Station(center, aim, float(angle), float(azimuths[chosen]), roll, pose))
    return tuple(stations)


def seen_targets(
    target_object: PlannedObject, camera: Camera, cam_from_world: RigidTransform, reach: Reach, smallest_px: float = 0.0
) -> tuple[BoolArray, FloatArray]:
    """Say which targets a camera sees, and where.

    target_object: The object; what hides targets from each other is not known.
    reach: Gives the largest incidence.
    smallest_px: Smallest diameter in the image across the shorter axis [px].
    Returns (n,): Whether a target is in the image, faces the camera and is large enough; its image point [px].
    """
    points = cam_from_world.apply(target_object.points_m)
    pixels = camera.project(points)
    size = np.array([camera.width_px, camera.height_px])
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= _EDGE_SHARE * size) & (pixels <= (1 - _EDGE_SHARE) * size)).all(axis=1) & (
            points[:, 2] > 0
        )
        normals = target_object.normals @ cam_from_world.rotation.T
        distance = np.linalg.norm(points, axis=1)
        cosine = -np.einsum("ni,ni->n", normals, points) / distance
        faces = ~np.isfinite(cosine) | (cosine >= np.cos(reach.incidence_rad))
        across = np.where(np.isfinite(cosine), cosine, 1.0)
        focal = 0.5 * (camera.focal_x_px + camera.focal_y_px)
        large = target_object.diameter_m * focal * across / distance >= smallest_px
    return np.asarray(inside & faces & (large | (target_object.diameter_m == 0))), pixels
