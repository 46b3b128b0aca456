"""Surfaces that points are compared with: orthogonal distances, free curvatures, motions that change nothing."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, Self

import numpy as np

from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Quadric
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray, freeze

#: A motion changes a surface if it changes its matrix by more than this share: far above rounding (1e-15), far below
#: what any panel could show (a radius of 1 km seen over 1 m bends by 1e-3).
_INVARIANT = 1e-9
#: The distance along the normal converges quadratically: six steps from anywhere near the surface.
_FOOT_STEPS = 30


@dataclass(frozen=True, slots=True, eq=False)
class Feet:
    """Where points stand over a surface.

    distance_m (n,): Orthogonal distance, positive on the +z side; NaN where the surface has no foot [m].
    normals (n, 3): Unit normal at the foot, on the +z side.
    d_distance_d_curvature (n, k): Change of the distance with each free curvature [m^2].
    """

    distance_m: FloatArray
    normals: FloatArray
    d_distance_d_curvature: FloatArray


class Reference(Protocol):
    """A surface in its own frame that points are fitted to."""

    @property
    def curvature_names(self) -> tuple[str, ...]:
        """Names of the lengths (1 / curvature) that can be free."""
        ...

    @property
    def curvatures_per_m(self) -> FloatArray:
        """Curvatures, shape (k,) [1/m]."""
        ...

    def with_curvatures(self, curvatures_per_m: FloatArray) -> "Reference":
        """Return the surface with other curvatures."""
        ...

    def feet(self, points_m: FloatArray) -> Feet:
        """Return distances and normals of points, shape (n, 3)."""
        ...

    def symmetries(self) -> FloatArray:
        """Return motions that leave the surface as it is, shape (6, s): rotation vectors, then shifts."""
        ...

    def describe(self) -> str:
        """Return the surface in words."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class DesignSurface(ShortRepr):
    """A design surface whose focal lengths or radius can be estimated.

    make: Lengths [m] to the optic's surface; the matrix must be linear in 1 / length, as those of all constructors
        of `heliogauge.geometry.surfaces` are.
    curvatures_per_m (k,): 1 / length [1/m].
    curvature_names length k: Names of the lengths ("focal_length_m", "radius_m").
    design_from_optic: From the optic's frame to the frame of the result.

    Curvature, not length, is estimated: distances are linear in it, and a flat panel is an ordinary value.
    """

    make: Callable[..., Quadric]
    curvatures_per_m: FloatArray
    curvature_names: tuple[str, ...]
    design_from_optic: RigidTransform

    def __post_init__(self) -> None:
        object.__setattr__(self, "curvatures_per_m", freeze(np.array(self.curvatures_per_m, dtype=np.float64)))

    def with_curvatures(self, curvatures_per_m: FloatArray) -> "DesignSurface":
        """Return the surface with other curvatures, shape (k,) [1/m]."""
        return replace(self, curvatures_per_m=curvatures_per_m)

    def transformed(self, b_from_a: RigidTransform) -> "DesignSurface":
        """Return the same surface in another frame."""
        return replace(self, design_from_optic=b_from_a @ self.design_from_optic)

    @property
    def quadric(self) -> Quadric:
        """The surface in the frame of the result."""
        return self._made(self.curvatures_per_m).transformed(self.design_from_optic)

    def describe(self) -> str:
        """Return the surface in words."""
        return self.quadric.describe()

    def _made(self, curvatures: FloatArray) -> Quadric:
        with np.errstate(divide="ignore"):
            return self.make(*(1.0 / curvatures).tolist())

    def feet(self, points_m: FloatArray) -> Feet:
        """Return orthogonal distances of points.

        Shapes: points_m (n, 3).

        With ``F = p^T Q p`` and half gradient g the foot s of x obeys ``x = s + l g(s)``: in the eigenvectors of Q's
        upper block ``s = (x - l b) / (1 + l a)``, and F(s(l)) = 0 is one equation for l, solved by Newton's method.
        """
        quadric = self.quadric
        distance, normals, feet, half = _find_feet(quadric.matrix, points_m)
        lifted = np.column_stack([feet, np.ones(len(feet))])
        columns = [
            0.5 * np.einsum("ni,ij,nj->n", lifted, change, lifted) / half for change in self._d_matrix_d_curvature()
        ]
        return Feet(distance, normals, np.stack(columns, axis=1) if columns else np.zeros((len(points_m), 0)))

    def _d_matrix_d_curvature(self) -> list[FloatArray]:
        """Matrices by which Q changes for one more unit of each curvature; exact, as Q is linear."""
        at_zero = self._made(np.zeros(self.curvatures_per_m.size))
        flat = at_zero.transformed(self.design_from_optic).matrix
        return [
            np.asarray(self._made(unit).transformed(self.design_from_optic).matrix - flat)
            for unit in np.eye(self.curvatures_per_m.size)
        ]

    def symmetries(self) -> FloatArray:
        """Return motions that leave the surface as it is, shape (6, s): rotation vectors [rad], then shifts [m]."""
        return null_motions(motion_changes(self.quadric.matrix))


class RigidReference:
    """A surface of which no length is free."""

    __slots__ = ()

    @property
    def curvature_names(self) -> tuple[str, ...]:
        """Empty."""
        return ()

    @property
    def curvatures_per_m(self) -> FloatArray:
        """Empty, shape (0,)."""
        return np.zeros(0)

    def with_curvatures(self, curvatures_per_m: FloatArray) -> Self:
        """Return the same: there is nothing to change."""
        return self


@dataclass(frozen=True, slots=True, eq=False)
class CompositeDesign(RigidReference):
    """Several design surfaces in one frame, each with its own points: facets that are no part of one surface.

    which (n,): The surface of each point, in the order in which points are given.
    """

    designs: tuple[DesignSurface, ...]
    which: IntArray

    def feet(self, points_m: FloatArray) -> Feet:
        """Return orthogonal distances of points, each from its own surface, shape (n, 3) in the order of ``which``."""
        if len(points_m) != self.which.size:
            raise InputError(f"points_m: {self.which.size} points are needed, not {len(points_m)}")
        distance, normals = np.empty(len(points_m)), np.empty((len(points_m), 3))
        for place, design in enumerate(self.designs):
            own = self.which == place
            distance[own], normals[own] = _find_feet(design.quadric.matrix, points_m[own])[:2]
        return Feet(distance, normals, np.zeros((len(points_m), 0)))

    def symmetries(self) -> FloatArray:
        """Return motions that leave all surfaces as they are, shape (6, s)."""
        return null_motions(np.concatenate([motion_changes(one.quadric.matrix) for one in self.designs]))

    def describe(self) -> str:
        """Return the surfaces in words."""
        return f"{len(self.designs)} facets: " + "; ".join(dict.fromkeys(one.describe() for one in self.designs))


def motion_changes(matrix: FloatArray) -> FloatArray:
    """Return how a quadric's matrix changes with each rigid motion, as columns, shape (16, 6), relative."""
    generators = np.zeros((6, 4, 4))
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        generators[axis, first, second], generators[axis, second, first] = -1.0, 1.0
        generators[3 + axis, axis, 3] = 1.0
    changes = np.einsum("ij,kjl->kil", matrix, generators)
    changes = changes + np.swapaxes(changes, 1, 2)
    return np.asarray(changes.reshape(6, 16).T / np.abs(matrix).max())


def null_motions(changes: FloatArray, tolerance: float = _INVARIANT) -> FloatArray:
    """Return a readable basis of the motions that change nothing, shape (6, s).

    changes (m, 6): What each motion (rotations about x, y, z, then shifts) changes.
    tolerance: Singular values below this share of the largest count as none.
    Returns (6, s): Columns in reduced echelon form: single rotations and shifts as far as possible.
    """
    _, singular, rows = np.linalg.svd(changes)
    full = np.zeros(6)
    full[: singular.size] = singular
    basis = rows[full < tolerance * max(float(full[0]), 1e-300)]
    done = 0
    for column in range(6):
        if done == len(basis):
            break
        pivot = done + int(np.argmax(np.abs(basis[done:, column])))
        if abs(basis[pivot, column]) < 1e-6:
            continue
        basis[[done, pivot]] = basis[[pivot, done]]
        basis[done] /= basis[done, column]
        others = np.arange(len(basis)) != done
        basis[others] -= basis[others, column][:, None] * basis[done]
        done += 1
    basis[np.abs(basis) < 1e-12] = 0.0
    return np.asarray(basis.T)


def motion_words(motions: FloatArray) -> tuple[str, ...]:
    """Say in words what motions are.

    motions (6, s): Rotation vectors, then shifts.
    Returns: "rotation about z", "shift along y", ...

    >>> motion_words(np.eye(6)[:, [2, 4]])
    ('rotation about z', 'shift along y')
    """
    return tuple(_words(column[:3], column[3:]) for column in motions.T)


def _words(turn: FloatArray, shift: FloatArray) -> str:
    if not turn.any():
        return f"shift along {_direction(shift)}"
    point = np.cross(turn, shift) / (turn @ turn)
    where = "" if np.abs(point).max() < 1e-9 else f" through ({point[0]:.4g}, {point[1]:.4g}, {point[2]:.4g}) m"
    return f"rotation about {_direction(turn)}{where}"


def _direction(vector: FloatArray) -> str:
    unit = vector / np.linalg.norm(vector)
    for axis, name in enumerate("xyz"):
        if abs(unit[axis]) > 1 - 1e-12:
            return name
    return f"({unit[0]:.3f}, {unit[1]:.3f}, {unit[2]:.3f})"


class _QuadricFeet(NamedTuple):
    """Distance, unit normal, foot and length of the half gradient there of each point."""

    distance: FloatArray
    normals: FloatArray
    feet: FloatArray
    half_gradient: FloatArray


def _find_feet(matrix: FloatArray, points: FloatArray) -> _QuadricFeet:
    values, vectors = np.linalg.eigh(matrix[:3, :3])
    x, b = points @ vectors, matrix[:3, 3] @ vectors
    step, constant = np.zeros(len(points)), matrix[3, 3]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(_FOOT_STEPS):
            stretch = 1 + step[:, None] * values
            foot = (x - step[:, None] * b) / stretch
            half = foot * values + b
            residual = ((half + b) * foot).sum(axis=1) + constant
            change = residual / (2 * (half**2 / stretch).sum(axis=1))
            step = step + change
            # Newton's error after this step is of the order of change^2.
            if not (np.abs(change) > 1e-12 * (1 + np.abs(step))).any():
                break
        stretch = 1 + step[:, None] * values
        foot = (x - step[:, None] * b) / stretch
        half = foot * values + b
        length = np.sqrt((half**2).sum(axis=1))
        distance = step * length
        # Beyond a centre of curvature the foot is on the other sheet.
        distance = np.where((stretch > 0).all(axis=1) & np.isfinite(distance), distance, np.nan)
        normals = half @ vectors.T / length[:, None]
    return _QuadricFeet(distance, normals, foot @ vectors.T, length)


def require_feet(ids: Sequence[str], feet: Feet) -> Feet:
    """Return the feet if all points have one.

    InputError: A point is so far from the surface that its foot is not defined.
    """
    lost = np.nonzero(~np.isfinite(feet.distance_m))[0]
    if lost.size:
        names = ", ".join(ids[i] for i in lost[:8])
        raise InputError(
            f"surface: {lost.size} points are beyond the centre of curvature of the design ({names}); the design or "
            "the targets named for it are wrong"
        )
    return feet
