"""Put a network that floats in its own frame and scale where control points or constraints want it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from heliogauge.adjust.least_squares import VECTOR, Options, Problem, solve
from heliogauge.errors import EstimationError
from heliogauge.geometry.alignment import align_points
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector, skew
from heliogauge.validate import FloatArray
from photogrammetry.bundle.constraints import AXES, Constraint, Coordinate, Distance
from photogrammetry.bundle.state import BundleState

#: With so many targets whose three coordinates are known the attitude follows from them at once.
_ENOUGH_TARGETS = 4
#: Attitudes whose squared misfits differ by less than this share (and by 1e-8 of the size, squared) fit alike.
_ALIKE = 1e-2

_NAMES = ("turn x", "turn y", "turn z", "shift x", "shift y", "shift z", "stretch")


def transformed(state: BundleState, world_from_old: RigidTransform, scale: float = 1.0) -> BundleState:
    """Move a network to another frame, ``X' = scale R X + t``; every photo sees every target where it saw it.

    world_from_old: Rotation R and translation t.
    scale: New length of what was 1.
    """
    rotation, shift = world_from_old.rotation, world_from_old.translation_m
    rotations = state.rotations @ rotation.T
    points = scale * state.points_m @ rotation.T + shift
    return BundleState(state.cameras, rotations, scale * state.translations_m - rotations @ shift, points)


def aligned_to_control(state: BundleState, targets: Sequence[str], control_m: Mapping[str, FloatArray]) -> BundleState:
    """Put a network where control points are, and the control points exactly there.

    state: The network, in any frame and scale.
    control_m (3,): Coordinates of at least three of them, not on one line [m].
    Returns: The network, moved by the best-fit similarity; targets of the control have the control's coordinates.
    EstimationError: Fewer than three of the control points are in the network, or all are on one line.
    """
    moved = best_fit(state, targets, control_m)
    place = {name: i for i, name in enumerate(targets)}
    names = [name for name in control_m if name in place]
    moved.points_m[[place[name] for name in names]] = [control_m[name] for name in names]
    return moved


def best_fit(
    state: BundleState, targets: Sequence[str], wanted_m: Mapping[str, FloatArray], *, with_scale: bool = True
) -> BundleState:
    """Move a network as a whole to where coordinates are wanted.

    state: The network, in any frame and scale.
    wanted_m (3,): Coordinates of at least three of them, not on one line [m].
    with_scale: Whether the scale may change too.
    Returns: The network with the smallest sum of squared distances.
    EstimationError: Fewer than three of the targets are in the network, or all are on one line.

    Umeyama, IEEE Trans. PAMI 13 (1991) 376.
    """
    place = {name: i for i, name in enumerate(targets)}
    names = [name for name in wanted_m if name in place]
    own = state.points_m[[place[name] for name in names]]
    wanted = np.array([wanted_m[name] for name in names], dtype=np.float64).reshape(-1, 3)
    found = align_points(own, wanted, with_scale=with_scale, names=names)
    return transformed(state, found.b_from_a, found.scale)


def aligned_to_constraints(state: BundleState, targets: Sequence[str], known: Sequence[Constraint]) -> BundleState:
    """Put a network where constraints want it, as far as they say.

    state: The network, in any frame and scale.
    known: Scale bars, coordinates, planes, weighted control points; those of targets outside the network do not
        count.
    Returns: The network with the scale of its distances (their median) and the place and attitude that fit best,
        from 24 attitudes to start with. Handedness is never changed. Where two attitudes fit alike (a trough turned
        end for end fits its rims as well), it is the one whose z axis points to the side of the photos.
    """
    place = {name: i for i, name in enumerate(targets)}
    usable = [one for one in known if all(name in place for name in one.targets)]
    if not usable:
        return state
    ratios = [
        one.distance_m
        / float(np.linalg.norm(state.points_m[place[one.target_a]] - state.points_m[place[one.target_b]]))
        for one in usable
        if isinstance(one, Distance)
    ]
    scaled = transformed(state, RigidTransform.identity(), float(np.median(ratios)) if ratios else 1.0)
    if len(ratios) == len(usable):
        return scaled
    indices = [[place[name] for name in one.targets] for one in usable]
    held = ("stretch",) if ratios else ()
    # Poses only follow; the search moves the targets alone.
    bare = replace(scaled, rotations=scaled.rotations[:0], translations_m=scaled.translations_m[:0])
    near = _attitude_of_coordinates(bare, place, usable)
    trials = [_fit_from(bare, usable, indices, one, held) for one in (_attitudes() if near is None else [near])]
    best = min(trial.misfit for trial in trials)
    # Rounding must not choose between attitudes that fit alike; their misfits differ by what the iteration left over.
    alike = [trial for trial in trials if trial.misfit <= best * (1 + _ALIKE) + (1e-8 * _size(scaled)) ** 2]
    towards_photos = scaled.centers_m.mean(axis=0) - scaled.points_m.mean(axis=0)
    chosen = max(alike, key=lambda trial: float(trial.world_from_old.rotation[2] @ towards_photos))
    return transformed(scaled, chosen.world_from_old, chosen.scale)


def _size(state: BundleState) -> float:
    """Return the targets' distance from their centre, RMS [m]."""
    return float(np.sqrt(((state.points_m - state.points_m.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _attitude_of_coordinates(
    state: BundleState, place: Mapping[str, int], known: Sequence[Constraint]
) -> FloatArray | None:
    """Return the best attitude for the targets with three known coordinates; None where they leave a turn open."""
    listed: dict[str, dict[str, float]] = {}
    for one in known:
        if isinstance(one, Coordinate):
            listed.setdefault(one.target, {})[one.axis] = one.value_m
    whole = {name: [axes[axis] for axis in AXES] for name, axes in listed.items() if len(axes) == len(AXES)}
    if len(whole) < _ENOUGH_TARGETS:
        return None
    own, wanted = state.points_m[[place[name] for name in whole]], np.array(list(whole.values()))
    try:
        return align_points(own, wanted, with_scale=True).b_from_a.rotation
    except EstimationError:
        return None


def _attitudes() -> list[FloatArray]:
    """Return the 24 rotations of a cube."""
    signs = [np.array(one) for one in product((1.0, -1.0), repeat=3)]
    matrices = [np.eye(3)[list(order)] * sign for order in permutations(range(3)) for sign in signs]
    return [matrix for matrix in matrices if np.linalg.det(matrix) > 0]


class _Trial(NamedTuple):
    """A network moved onto its constraints: sum of squares left, movement and scale."""

    misfit: float
    world_from_old: RigidTransform
    scale: float


def _fit_from(
    state: BundleState,
    known: Sequence[Constraint],
    indices: Sequence[list[int]],
    attitude: FloatArray,
    held: tuple[str, ...],
) -> _Trial:
    """Fit up to seven parameters to the constraints from one attitude."""
    turned = transformed(state, RigidTransform(attitude, np.zeros(3)))
    center = turned.points_m.mean(axis=0)
    size = _size(turned)

    def movement(values: FloatArray) -> tuple[RigidTransform, float]:
        # From an attitude that is wrong the stretch runs away: a factor of 1e9 either way is a misfit like any other.
        rotation, scale = rotation_from_vector(values[:3]), float(np.exp(np.clip(values[6], -20.0, 20.0)))
        return RigidTransform(rotation, center + values[3:6] * size - scale * rotation @ center), scale

    def evaluate(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        here = transformed(turned, *movement(values))
        arms = here.points_m - here.points_m.mean(axis=0)
        d_points = np.concatenate([-skew(arms), np.broadcast_to(size * np.eye(3), (len(arms), 3, 3))], axis=2)
        d_points = np.concatenate([d_points, arms[:, :, None]], axis=2)
        rows = [_in_metres(*one.rows(here.points_m[index])) for one, index in zip(known, indices, strict=True)]
        jacobian = [np.einsum("rkc,kcd->rd", own, d_points[i]) for (_, own), i in zip(rows, indices, strict=True)]
        # The rotation vector is moved by adding: its derivative is that of the left-invariant turn.
        full = np.concatenate(jacobian)
        full[:, :3] = full[:, :3] @ _left_jacobian(values[:3])
        return np.concatenate([residuals for residuals, _ in rows]), full

    problem = Problem(_NAMES, evaluate, VECTOR, held=held)
    solution = solve(problem, np.zeros(7), options=Options(max_iterations=60, tolerance=1e-3, initial_damping=1e-3))
    moved, scale = movement(solution.parameters)
    return _Trial(
        float((solution.residuals**2).sum()), RigidTransform(moved.rotation @ attitude, moved.translation_m), scale
    )


def _in_metres(residuals: FloatArray, jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Undo the weights: far from the answer a sigma of a micrometre would outweigh everything else."""
    sizes = np.maximum(np.sqrt((jacobian**2).sum(axis=(1, 2))), 1e-300)
    return residuals / sizes, jacobian / sizes[:, None, None]


def _left_jacobian(vector: FloatArray) -> FloatArray:
    """Return J of the turn ``R(v + dv) = R(J dv) R(v)``."""
    angle, cross = float(np.linalg.norm(vector)), skew(vector)
    if angle < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * cross)
    first, second = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)
