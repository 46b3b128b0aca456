"""How a camera passes a trough: a drone's pass, a mast, several passes, a fixed camera before a turning collector."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from data_synth.optics.pinhole import PinholeCamera
from data_synth.troughs.scene import TroughView
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.validate import FloatArray

#: Where cameras look: between vertex and rim of a usual trough [m].
_LOOK_AT_Z_M = 0.6


def look_at_trough(position_m: FloatArray, target_m: FloatArray, roll_rad: float = 0.0) -> RigidTransform:
    """Return the pose ``cam_from_trough`` of a camera that looks at a point, the long side of its image along +y.

    position_m, target_m (3,): Camera and point in the trough's frame [m].
    roll_rad: Turn about the line of sight [rad].
    InputError: The camera looks along the trough.
    """
    forward = np.asarray(target_m, dtype=np.float64) - position_m
    forward = forward / np.linalg.norm(forward)
    down = np.cross(forward, [0.0, 1.0, 0.0])
    if np.linalg.norm(down) < 1e-3:
        raise InputError("camera: it looks along the trough; the image's long side cannot be along y")
    down /= np.linalg.norm(down)
    rotation = rotation_from_vector(np.array([0.0, 0.0, roll_rad])) @ np.stack([np.cross(down, forward), down, forward])
    return RigidTransform(rotation, -rotation @ np.asarray(position_m, dtype=np.float64))


def straight_pass(
    camera: PinholeCamera,
    *,
    n_photos: int,
    height_m: float = 15.0,
    reach_m: float = 3.0,
    y_m: float = 0.0,
    look_y_m: float = 0.0,
) -> tuple[TroughView, ...]:
    """Fly straight across the aperture, looking at the collector all the time.

    n_photos: Number of photos, evenly spaced.
    height_m: Height of the camera above the vertex [m].
    reach_m: Photos from x = -reach to +reach [m].
    y_m: Where along the trough [m].
    look_y_m: Which part of the trough it looks at [m].
    """
    target = np.array([0.0, look_y_m, _LOOK_AT_Z_M])
    return tuple(
        TroughView(f"photo_{k + 1:03d}", camera, look_at_trough(np.array([x, y_m, height_m]), target))
        for k, x in enumerate(np.linspace(-reach_m, reach_m, n_photos))
    )


def level_pass(
    camera: PinholeCamera, *, n_photos: int, from_x_m: float, to_x_m: float, height_m: float = 12.0
) -> tuple[TroughView, ...]:
    """Fly straight across several rows of troughs, looking straight down all the time.

    n_photos: Number of photos, evenly spaced.
    from_x_m, to_x_m: Where the pass begins and ends [m].
    height_m: Height of the camera above the vertices [m].
    """
    return numbered(
        TroughView("", camera, look_at_trough(np.array([x, 0.0, height_m]), np.array([x, 0.0, 0.0])))
        for x in np.linspace(from_x_m, to_x_m, n_photos)
    )


def several_passes(
    camera: PinholeCamera, y_m: tuple[float, ...], *, n_photos: int, height_m: float = 15.0, reach_m: float = 3.0
) -> tuple[TroughView, ...]:
    """Fly across the aperture at several places along the trough.

    n_photos: Number of photos of all passes together.
    height_m, reach_m: As in `straight_pass` [m].
    Returns: The photos, pass after pass.
    """
    shares = np.array_split(np.arange(n_photos), len(y_m))
    flown = [
        straight_pass(camera, n_photos=len(share), height_m=height_m, reach_m=reach_m, y_m=y)
        for y, share in zip(y_m, shares, strict=True)
    ]
    return numbered(view for views in flown for view in views)


def numbered(views: Iterable[TroughView], prefix: str = "photo") -> tuple[TroughView, ...]:
    """Return the photos with names in their order."""
    return tuple(replace(view, name=f"{prefix}_{k + 1:03d}") for k, view in enumerate(views))


def wobbling(
    views: tuple[TroughView, ...],
    rng: np.random.Generator,
    *,
    position_m: float = 0.08,
    aim_rad: float = 0.01,
    roll_rad: float = 0.02,
) -> tuple[TroughView, ...]:
    """Return photos as a drone in wind or a mast takes them: off the path, off the aim, rolled.

    position_m: Standard deviation of each coordinate of the camera [m].
    aim_rad, roll_rad: Standard deviation of its turns across and about the line of sight [rad].
    """
    taken = []
    for view in views:
        turn = rng.standard_normal(3) * (aim_rad, aim_rad, roll_rad)
        rotation = rotation_from_vector(turn) @ view.cam_from_trough.rotation
        position = view.position_m + position_m * rng.standard_normal(3)
        taken.append(replace(view, cam_from_trough=RigidTransform(rotation, -rotation @ position)))
    return tuple(taken)


def mast_pass(
    camera: PinholeCamera, rng: np.random.Generator, *, n_photos: int, distance_m: float = 12.0, reach_m: float = 2.9
) -> tuple[TroughView, ...]:
    """Raise a camera on a mast before a collector that faces the horizon: across the aperture, swaying at the top.

    rng: Sway, more of it the higher the camera (towards -x of a collector turned by +90 deg).
    reach_m: Photos from x = -reach to +reach [m].
    """
    views = straight_pass(camera, n_photos=n_photos, height_m=distance_m, reach_m=reach_m)
    share = np.linspace(1.0, 0.0, n_photos)
    return tuple(
        wobbling((view,), rng, position_m=0.005 + 0.05 * part, aim_rad=0.002 + 0.006 * part, roll_rad=0.005)[0]
        for view, part in zip(views, share, strict=True)
    )


def turning_collector(
    camera: PinholeCamera, position_m: FloatArray, orientations_deg: FloatArray, *, pivot_z_m: float = 0.3
) -> tuple[TroughView, ...]:
    """Photograph a collector that turns before a fixed camera.

    camera: The camera, aimed at the pivot.
    position_m (3,): Where it is in the frame of the collector at zenith [m].
    orientations_deg (n,): Turns of the collector from zenith, by the right hand about +y [deg].
    pivot_z_m: Height of the axis of rotation over the vertex [m].
    """
    pivot = np.array([0.0, 0.0, pivot_z_m])
    cam_from_world = look_at_trough(np.asarray(position_m, dtype=np.float64), pivot)
    views = []
    for orientation in np.asarray(orientations_deg, dtype=np.float64):
        turn = rotation_from_vector(np.array([0.0, np.radians(orientation), 0.0]))
        world_from_trough = RigidTransform(turn, pivot - turn @ pivot)
        views.append(TroughView("", camera, cam_from_world @ world_from_trough, orientation_deg=float(orientation)))
    return numbered(views)


def absorber_pair(
    camera: PinholeCamera, *, x_m: float = 7.0, z_m: float = 7.0, y_m: float = 0.0
) -> tuple[TroughView, ...]:
    """Photograph the absorber from both sides (Owkes 2012, sec. 7.2.2 and 7.4)."""
    target = np.array([0.0, y_m, 1.2])
    views = (
        TroughView("", camera, look_at_trough(np.array([x, y_m, z_m]), target), purpose="absorber") for x in (-x_m, x_m)
    )
    return numbered(views, "absorber")
