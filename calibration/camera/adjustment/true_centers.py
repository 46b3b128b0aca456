"""Centres of the images of circles become images of the centres of circles."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.camera.boards import CircleGrid, TargetField
from calibration.camera.corners.detection import BoardPoints
from calibration.camera.start_values.board_network import BoardNetwork
from photogrammetry.bundle import BundleState, eccentricity
from photogrammetry.centers import eccentricity_px


def with_true_centers(network: BoardNetwork, measured: Sequence[BoardPoints], state: BundleState) -> BoardNetwork:
    """Move centres of circles' images to the images of their centres, seen from the poses of the state.

    state: Camera, poses and points.
    Returns: With corrected points; unchanged for boards without circles.
    """
    if isinstance(network.board, TargetField):
        return _with_true_targets(network, measured, state)
    board = network.board
    if not isinstance(board, CircleGrid):
        return network
    places_m, normals = board.points_m.copy(), np.tile([0.0, 0.0, 1.0], (len(board.names), 1))
    places_m[network.seen] = state.points_m
    x, y = places_m[:, 0], places_m[:, 1]
    # A print is bent smoothly: its normals come from a quadratic.
    terms = np.stack([np.ones(x.size), x, y, x * x, x * y, y * y], axis=1)
    bent = np.linalg.lstsq(terms[network.seen], places_m[network.seen, 2], rcond=None)[0]
    normals[:, 0] = -(bent[1] + 2 * bent[3] * x + bent[4] * y)
    normals[:, 1] = -(bent[2] + bent[4] * x + 2 * bent[5] * y)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    radius, points = 0.5 * board.diameter_share * board.pitch_m, []
    for i, one in enumerate(measured):
        pose = state.cam_from_world(i)
        shift = eccentricity_px(
            state.cameras[0], pose.apply(places_m[one.index]), pose.rotate(normals[one.index]), radius
        )
        points.append(replace(one, pixels_px=one.pixels_px - shift))
    return replace(network, points=tuple(points))


def _with_true_targets(network: BoardNetwork, measured: Sequence[BoardPoints], state: BundleState) -> BoardNetwork:
    """Do the same for targets, whose size and attitude come from their ellipses in all photos."""
    table = replace(network, points=tuple(measured)).observations()
    ellipses = np.concatenate([one.ellipses_px2 for one in measured])
    if len(ellipses) != table.n:
        return network
    camera_of_photo = np.zeros(len(table.photos), dtype=np.intp)
    discs = eccentricity.estimate_discs(table, ellipses, state, camera_of_photo)
    shifts = eccentricity.eccentricities_px(table, discs, state, camera_of_photo)
    points = [replace(one, pixels_px=one.pixels_px - shifts[table.photo_index == i]) for i, one in enumerate(measured)]
    return replace(network, points=tuple(points))
