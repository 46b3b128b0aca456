"""From which corner a board was counted in each photo, where its print looks the same turned: from its own shape.

A chessboard of 9 x 7 corners looks the same after half a turn, so nothing in one photo shows which corner is the first.
But no board is as it was drawn. If all photos are counted alike, one departure from the drawing explains them all.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.camera.boards import Chessboard, CircleGrid, renumbering
from calibration.camera.corners.detection import BoardPoints
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray

#: Departures of a print are smooth: polynomials up to this degree in x, y for each of x, y, z.
_DEGREE = 4
#: Turning a photo by mistake must cost this much, in variances of a residual: 5.5 sigma.
_SURE = 30.0
#: Photos to begin the search from; a wrong first guess of the others is repaired by the sweeps.
_BEGINNINGS = 4
_MOST_SWEEPS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Orientations:
    """How each photo was counted.

    quarter_turns length p: By how much each photo's numbering must be turned.
    cost (p,): What the cheapest other turn of each photo would cost, in variances of a residual.
    """

    quarter_turns: tuple[int, ...]
    cost: FloatArray

    @property
    def turned(self) -> list[int]:
        """Photos that are counted otherwise than they were found."""
        return [i for i, turns in enumerate(self.quarter_turns) if turns]

    @property
    def open(self) -> list[int]:
        """Photos whose turn the board's shape does not determine."""
        return np.nonzero(self.cost < _SURE)[0].tolist()


def find_orientations(
    board: Chessboard | CircleGrid, photos: Sequence[BoardPoints], poses: Sequence[RigidTransform], camera: Camera
) -> Orientations:
    """Choose the numbering of each photo so that one shape of the board explains all of them best.

    Shapes: photos length p.
    board: The board, whose `same_turns` are the choices.
    poses length p: ``cam_from_board`` with that numbering and the board as drawn.
    camera: Adjusted with the board as drawn.
    Returns: The turns. All of them together are open: the first photo keeps its numbering, unless more photos do
        otherwise.

    One step of the adjustment, linear in poses, intrinsics and the board's departure (polynomials of degree 4 in the
    plane for each coordinate). For a choice of turns its sum of squares is ``s - b^T N^-1 b`` with s, b and N sums
    over the photos, so that trying a choice is the solution of 55 equations. Photos are added one by one, then turned
    one by one as long as that helps, from several beginnings.
    """
    parts = [_parts(board, *each, camera) for each in zip(photos, poses, strict=True)]
    totals = np.array([part.square for part in parts])
    redundancy = max(sum(2 * one.n - 6 for one in photos) - parts[0].right.shape[1], 1)
    best: tuple[float, list[int]] = (np.inf, [])
    order = np.argsort(-totals).tolist()
    for first in order[:_BEGINNINGS]:
        chosen = _searched(parts, [first, *(i for i in order if i != first)])
        cost = _cost(parts, chosen)
        if cost < best[0] - 1e-9 * totals.sum():
            best = (cost, chosen)
    cost, chosen = best
    rivals = np.full(len(parts), np.inf)
    for photo, own in enumerate(chosen):
        for other in range(len(parts[photo].right)):
            if other != own:
                rivals[photo] = min(rivals[photo], _cost(parts, [*chosen[:photo], other, *chosen[photo + 1 :]]) - cost)
    turns = board.same_turns
    # All photos together may be turned: as many as possible stay as they were found.
    common = max(turns, key=lambda back: sum((turns[k] - back) % 4 == 0 for k in chosen))
    return Orientations(tuple((turns[k] - common) % 4 for k in chosen), rivals / max(cost / redundancy, 1e-300))


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """One photo's share of the normal equations, for each turn; its pose is eliminated."""

    normal: FloatArray
    right: FloatArray
    square: float


def _parts(board: Chessboard | CircleGrid, photo: BoardPoints, pose: RigidTransform, camera: Camera) -> _Parts:
    drawn = board.points_m
    seen = camera.project_posed(drawn[photo.index], pose)
    weight = 1 / np.sqrt(0.5 * np.trace(photo.covariance_px2, axis1=1, axis2=2))
    misfit = ((photo.pixels_px - seen.pixels_px) * weight[:, None]).ravel()
    d_pose = (seen.d_pixel_d_pose * weight[:, None, None]).reshape(-1, 6)
    basis = np.linalg.qr(d_pose / np.linalg.norm(d_pose, axis=0))[0]
    d_camera = (seen.d_pixel_d_parameters * weight[:, None, None]).reshape(len(misfit), -1)
    misfit = misfit - basis @ (basis.T @ misfit)
    normals, rights = [], []
    for turns in board.same_turns:
        new = renumbering(board, turns)[photo.index]
        angle = 0.5 * np.pi * turns
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        d_point = (seen.d_pixel_d_point @ turn.T) * weight[:, None, None]
        d_shape = d_point[:, :, :, None] * _terms(drawn)[new][:, None, None, :]
        design = np.hstack([d_shape.reshape(len(misfit), -1), d_camera])
        design = design - basis @ (basis.T @ design)
        normals.append(design.T @ design)
        rights.append(design.T @ misfit)
    return _Parts(np.array(normals), np.array(rights), float(misfit @ misfit))


def _terms(points_m: FloatArray) -> FloatArray:
    """Return the terms of the board's departure at its points, shape (n, 15)."""
    x, y = (points_m[:, :2] / np.abs(points_m[:, :2]).max()).T
    return np.stack([x**i * y**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)], axis=1)


def _cost(parts: Sequence[_Parts], chosen: Sequence[int], photos: Sequence[int] | None = None) -> float:
    """Return the sum of squares for a choice of turns, of some of the photos."""
    which = range(len(parts)) if photos is None else photos
    normal = sum((parts[i].normal[chosen[i]] for i in which), np.zeros_like(parts[0].normal[0]))
    right = sum((parts[i].right[chosen[i]] for i in which), np.zeros_like(parts[0].right[0]))
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    unit = normal / scale[:, None] / scale
    # Frame and scale of the board are open; a millionth keeps the equations solvable and changes nothing else.
    unit[np.diag_indices_from(unit)] += 1e-6
    reduced = right / scale
    return sum(parts[i].square for i in which) - float(reduced @ np.linalg.solve(unit, reduced))


def _searched(parts: Sequence[_Parts], order: Sequence[int]) -> list[int]:
    chosen = [0] * len(parts)
    for count in range(2, len(order) + 1):
        _turn_best(parts, chosen, order[count - 1], order[:count])
    for _ in range(_MOST_SWEEPS):
        before = list(chosen)
        for photo in order[1:]:
            _turn_best(parts, chosen, photo, order)
        if chosen == before:
            break
    return chosen


def _turn_best(parts: Sequence[_Parts], chosen: list[int], photo: int, photos: Sequence[int]) -> None:
    costs = []
    for turn in range(len(parts[photo].right)):
        chosen[photo] = turn
        costs.append(_cost(parts, chosen, photos))
    chosen[photo] = int(np.argmin(costs))
