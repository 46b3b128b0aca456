"""Datum of a photo network: where position, rotation and scale come from, and how a covariance changes with it."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import rotation_from_vector, skew
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray
from photogrammetry.bundle.state import BundleState

# A movement that changes what is known by less than this share of what it could change is free.
_FREE = 1e-9


class DatumKind(StrEnum):
    """How the freedom that the observations leave is taken away."""

    INNER = "inner constraints"
    MINIMAL = "minimal constraints (3-2-1)"
    PHOTOS = "photos held"
    CONTROL = "control"


@dataclass(frozen=True, slots=True)
class Datum(ShortRepr):
    """How position, rotation and scale are defined as far as constraints and fixed targets leave them open.

    kind: Inner constraints share the datum among the chosen targets: their mean shift, rotation and stretch against
        the start are zero, which gives them the smallest mean variance. Minimal constraints hold coordinates of
        three targets, as many as needed. PHOTOS holds position and rotation of one photo and, where there is no
        scale, one coordinate of another. CONTROL: constraints and fixed targets must define all.
    targets: The chosen targets; for inner constraints all by default, for minimal ones three.
    photos: The photos that are held, one or two.
    InputError: Minimal constraints without exactly three targets, or photos held without one or two.
    """

    kind: DatumKind = DatumKind.INNER
    targets: tuple[str, ...] = ()
    photos: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.kind is DatumKind.MINIMAL and len(set(self.targets)) != 3:
            raise InputError(f"datum: minimal constraints need three targets, not {len(set(self.targets))}")
        if self.kind is DatumKind.PHOTOS and not 1 <= len(set(self.photos)) <= 2:
            raise InputError(f"datum: one or two photos are held, not {len(set(self.photos))}")


@dataclass(frozen=True, slots=True, eq=False)
class Movements:
    """Movements of the whole network that no image point sees; the derivative of everything by them.

    points (n, 3, d): Movement of the targets.
    poses (p, 6, d): Movement of the poses, as steps of `RigidTransform.moved`.
    shares (7, d): Shares of three shifts, three rotations and a stretch in each movement.
    """

    points: FloatArray
    poses: FloatArray
    shares: FloatArray

    @property
    def count(self) -> int:
        """Number of movements."""
        return int(self.points.shape[2])

    def combined(self, directions: FloatArray) -> "Movements":
        """Return linear combinations, ``directions`` of shape (d, e)."""
        return Movements(self.points @ directions, self.poses @ directions, self.shares @ directions)

    def describe(self) -> str:
        """Say in words which movements these are."""
        # A turn about a fixed target shifts the centre too: it is a rotation; what neither turns nor stretches shifts.
        turning, both = (_rank(self.shares[3:last]) for last in (6, 7))
        counts = (self.count - both, turning)
        words = [f"{n} of {kind}" for n, kind in zip(counts, ("position", "rotation"), strict=True) if n]
        words += ["scale"] * (both - turning)
        return ", ".join(words) if words else "nothing"


def similarity_movements(state: BundleState, center_m: FloatArray | None = None) -> Movements:
    """Return the seven movements of a network as a whole.

    center_m (3,): Point that rotations and stretch leave where it is; the targets' mean by default [m].
    Returns: Three shifts, three rotations about the centre and a stretch from it, each of unit size at the mean
        distance.

    A world that moves by ``a + w x (X - c) + s (X - c)`` leaves every image point where it is when the poses turn by
    ``-R w`` and shift by ``-R a + R (w x c) + s (t + R c)``.
    """
    points, rotations = state.points_m, state.rotations
    center = points.mean(axis=0) if center_m is None else center_m
    arms = points - center
    size = max(float(np.sqrt((arms**2).sum(axis=1).mean())), 1e-300)
    d_points = np.zeros((len(points), 3, 7))
    d_points[:, :, :3] = np.eye(3)
    d_points[:, :, 3:6] = -skew(arms) / size
    d_points[:, :, 6] = arms / size
    d_poses = np.zeros((len(rotations), 6, 7))
    d_poses[:, 3:, :3] = -rotations
    d_poses[:, :3, 3:6] = -rotations / size
    d_poses[:, 3:, 3:6] = -rotations @ skew(center) / size
    d_poses[:, 3:, 6] = (state.translations_m + rotations @ center) / size
    return Movements(d_points, d_poses, np.eye(7))


def moved_as_a_whole(state: BundleState, shares: FloatArray, center_m: FloatArray) -> BundleState:
    """Move a network by a finite similarity that no image point sees.

    Shapes: center_m (3,).
    shares (7,): Amounts of the movements of `similarity_movements` about the same centre.
    Returns: ``X' = c + a + (1 + s) R(w) (X - c)`` with the poses that see every target where they saw it.
    """
    arms = state.points_m - center_m
    size = max(float(np.sqrt((arms**2).sum(axis=1).mean())), 1e-300)
    turn, stretch = rotation_from_vector(shares[3:6] / size), 1 + shares[6] / size
    points = center_m + shares[:3] + stretch * arms @ turn.T
    rotations = state.rotations @ turn.T
    translations = stretch * (state.translations_m + state.rotations @ center_m)
    return BundleState(state.cameras, rotations, translations - rotations @ (center_m + shares[:3]), points)


def free_movements(
    movements: Movements, jacobians: Sequence[FloatArray], targets: Sequence[IntArray], fixed: IntArray
) -> Movements:
    """Return the movements that no constraint and no fixed target sees.

    movements: The seven of `similarity_movements`.
    jacobians (r, k, 3), targets (k,): Derivatives of each constraint, and the targets they belong to.
    fixed: Targets without error.
    """
    both = zip(jacobians, targets, strict=True)
    seen = [np.einsum("rkc,kcd->rd", jacobian, movements.points[own]) for jacobian, own in both]
    seen.append(movements.points[fixed].reshape(3 * fixed.size, movements.count))
    # Each row against what it could see at most: a distance of sigma 1 um must not hide one of sigma 1 m.
    sizes = [np.sqrt((jacobian**2).sum(axis=(1, 2))) for jacobian in jacobians] + [np.ones(3 * fixed.size)]
    rows = np.concatenate(seen) / np.maximum(np.concatenate(sizes), 1e-300)[:, None]
    if not rows.size:
        return movements
    if len(rows) > movements.count:
        # Same right vectors; a full left factor of thousands of control points would be a square of thousands.
        rows = np.linalg.qr(rows, mode="r")
    _, singular, right = np.linalg.svd(rows)
    rank = int(np.count_nonzero(singular > _FREE * max(1.0, singular[0])))
    return movements.combined(right[rank:].T)


@dataclass(frozen=True, slots=True, eq=False)
class DatumConstraints:
    """Constraint columns of a datum on targets and poses, with its name.

    columns (n, 3, d): Targets: steps obey ``sum columns[i, c] * step[i, c] + sum poses[j, c] * step[j, c] = 0``.
    poses (p, 6, d): The same of the poses.
    text: The datum in words, to print with every sigma.
    """

    columns: FloatArray
    poses: FloatArray
    text: str


def datum_constraints(
    datum: Datum, movements: Movements, chosen: IntArray, *, defined: str = "", names: Sequence[str] = ()
) -> DatumConstraints:
    """Build the constraints that take away the free movements.

    datum: The wanted kind.
    chosen: The datum's targets, or its photos.
    defined: What constraints and fixed targets define, in words.
    names: Names of the chosen ones, for the text.
    EstimationError: The chosen targets or photos do not hold the free movements (too few, or on one line), or
        control leaves some.
    """
    columns, poses = np.zeros(movements.points.shape), np.zeros(movements.poses.shape)
    rest = f"; the rest from {defined}" if defined else ""
    if movements.count == 0:
        return DatumConstraints(columns, poses, f"all of it from {defined}")
    if datum.kind is DatumKind.CONTROL:
        raise EstimationError(
            f"datum: control points and constraints leave {movements.describe()} open; add some, or choose inner "
            "constraints"
        )
    by_photo = datum.kind is DatumKind.PHOTOS
    own = (movements.poses if by_photo else movements.points)[chosen].reshape(-1, movements.count)
    singular = np.linalg.svd(own, compute_uv=False)
    if singular.size < movements.count or singular[-1] < 1e-7 * singular[0]:
        remedy = "name a second photo" if by_photo else "choose at least three that are not on one line"
        raise EstimationError(
            f"datum: {chosen.size} {'photos' if by_photo else 'targets'} do not define {movements.describe()} of the "
            f"network; {remedy}"
        )
    if datum.kind is DatumKind.INNER:
        columns[chosen] = movements.points[chosen]
        text = f"{datum.kind.value} over {chosen.size} targets ({movements.describe()})"
        return DatumConstraints(columns, poses, text + rest)
    labels = names or [str(place) for place in chosen]
    # What the first photo can hold it does; a second one only holds what is left.
    held = sorted(_best_rows(own, preferred=6 if by_photo else 0))
    width = 6 if by_photo else 3
    for column, row in enumerate(held):
        (poses if by_photo else columns)[chosen[row // width], row % width, column] = 1.0
    if by_photo:
        parts = ("rotation x", "rotation y", "rotation z", "shift x", "shift y", "shift z")
        text = ", ".join(
            f"{labels[place]} (position and rotation)"
            if set(range(6 * place, 6 * place + 6)) <= set(held)
            else f"{labels[place]} ({', '.join(parts[row % 6] for row in held if row // 6 == place)} of the camera)"
            for place in sorted({row // 6 for row in held})
        )
    else:
        text = ", ".join(f"{'xyz'[row % 3]} of {labels[row // 3]}" for row in held) + " held"
    return DatumConstraints(columns, poses, f"{datum.kind.value}: {text}{rest}")


def _rank(matrix: FloatArray) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=1e-6)) if matrix.size else 0


def _best_rows(matrix: FloatArray, *, preferred: int = 0) -> list[int]:
    """Choose as many rows as there are columns, the farthest from those already chosen first (pivoted Gram-Schmidt).

    The first ``preferred`` rows go before all others.
    """
    rest, chosen = matrix.copy(), []
    for _ in range(matrix.shape[1]):
        lengths = (rest**2).sum(axis=1)
        if lengths[:preferred].max(initial=0.0) > 1e-18 * (matrix**2).sum():
            lengths[preferred:] = 0.0
        # A small preference for earlier rows keeps the choice the same on every machine.
        row = int(np.argmax(lengths * (1 - 1e-6 * np.arange(len(lengths)))))
        chosen.append(row)
        unit = rest[row] / np.sqrt(lengths[row])
        rest = rest - np.outer(rest @ unit, unit)
    return chosen
