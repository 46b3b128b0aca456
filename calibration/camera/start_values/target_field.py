"""Start of a calibration from coded targets, their places known roughly or not at all: a network grown from nothing."""

from dataclasses import replace

import numpy as np

from calibration.camera.boards import TargetField, UnknownField
from calibration.camera.corners.detection import BoardPoints, FoundBoards
from calibration.camera.start_values.board_network import LEAST_PHOTOS, BoardNetwork
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, FloatArray, IntArray, freeze
from photogrammetry import ImagePoints
from photogrammetry.bundle import CameraModel, alignment
from photogrammetry.start_values import build_network, guessed_camera


def network_from_targets(
    found: FoundBoards, board: UnknownField | TargetField, free: tuple[str, ...], left_out: dict[str, str]
) -> BoardNetwork:
    """Find camera, poses and places of the targets to start from.

    board: The dictionary, or the targets with their rough places, which need not be near a plane.
    free: Intrinsics that are estimated.
    left_out: Takes photos that could not be tied in, with the reason.
    Returns: In the frame of the rough places, or in one of its own: origin in the middle of the targets, z from the
        plane that fits them best towards the cameras, x along the farthest spread; the unit of length is then the
        mean distance to the nearest target.
    EstimationError: The photos do not hang together.
    """
    points = tuple(one for one in found.points if one.n)
    every = board.names if isinstance(board, TargetField) else found.names
    table = ImagePoints(
        tuple(one.photo for one in points),
        every,
        np.repeat(np.arange(len(points)), [one.n for one in points]),
        np.concatenate([one.index for one in points]),
        np.concatenate([one.pixels_px for one in points]),
        np.concatenate([one.covariance_px2 for one in points]),
    )
    camera = guessed_camera(*found.size_px)
    network = build_network(table, [camera], models=[CameraModel("camera", free)])
    for one in network.photos_left_out:
        left_out[one.name] = f"{one.name}: {one.reason}"
    names, state = network.observations.targets, network.state
    if len(network.observations.photos) < LEAST_PHOTOS:
        raise EstimationError(
            f"{len(network.observations.photos)} photos of targets hang together, {LEAST_PHOTOS} are needed: "
            + "; ".join(left_out.values())
        )
    poses = [state.cam_from_world(i) for i in range(len(network.observations.photos))]
    if isinstance(board, TargetField):
        number = {name: i for i, name in enumerate(board.names)}
        control = {name: board.points_m[number[name]] for name in names}
        state = alignment.aligned_to_control(state, names, control)
        plate, poses = board, [state.cam_from_world(i) for i in range(len(poses))]
    else:
        field_from_world, unit = _own_frame(state.points_m, poses)
        places = field_from_world.apply(state.points_m) / unit
        poses = [_scaled(pose @ field_from_world.inverse(), unit) for pose in poses]
        plate = TargetField(board.dictionary, names, places, is_metric=False)
        number = {name: i for i, name in enumerate(names)}
    agreeing = np.zeros(table.n, dtype=np.bool_)
    agreeing[network.rows] = True
    kept = tuple(
        _agreeing(one, agreeing[table.photo_index == photo], np.array([number.get(name, -1) for name in every]))
        for photo, one in enumerate(points)
        if one.photo in network.observations.photos
    )
    known = isinstance(board, TargetField)
    return BoardNetwork(plate, kept, free, state.cameras[0], tuple(poses), places_known=known)


def _agreeing(one: BoardPoints, chosen: BoolArray, place: IntArray) -> BoardPoints:
    """Keep the points of a photo that agree with the network, under their numbers there."""
    kept = one.subset(chosen)
    return replace(kept, index=place[kept.index])


def _own_frame(points_m: FloatArray, poses: list[RigidTransform]) -> tuple[RigidTransform, float]:
    """Return the targets' own frame, and the mean distance to the nearest target."""
    middle = points_m.mean(axis=0)
    axes = np.linalg.svd(points_m - middle, full_matrices=False)[2]
    centers = np.array([pose.inverse().translation_m for pose in poses])
    if (centers - middle).mean(axis=0) @ axes[2] < 0:
        axes[2] = -axes[2]
    axes[1] = np.cross(axes[2], axes[0])
    distances = np.linalg.norm(points_m[:, None] - points_m, axis=2)
    np.fill_diagonal(distances, np.inf)
    return RigidTransform(freeze(axes), freeze(-axes @ middle)), float(distances.min(axis=1).mean())


def _scaled(pose: RigidTransform, unit: float) -> RigidTransform:
    return RigidTransform(pose.rotation, pose.translation_m / unit)
