"""Names for points without a code, from a list of approximate coordinates."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from heliogauge.adjust.chi_square import chi_square_limit
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.alignment import align_points
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray, float_array
from photogrammetry.start_values.network import LeftOut

#: Probability of refusing a point that is the listed one.
_SIGNIFICANCE = 1e-4
#: A rival must fit worse by this chi-square, 1 to 3000 against it.
_CLEARLY = 16.0
#: Triples of listed targets from which the frame is tried.
_BASES = 60


@dataclass(frozen=True, slots=True, eq=False)
class ListedTargets(ShortRepr):
    """Targets with approximate coordinates in a frame of their own.

    names length n: Their names.
    points_m (n, 3): Approximate coordinates [m].
    sigma_m (n, 3): How approximate, each axis [m].
    InputError: A name twice, lengths that differ, or a sigma that is not positive.
    """

    names: tuple[str, ...]
    points_m: FloatArray
    sigma_m: FloatArray

    def __post_init__(self) -> None:
        n = len(self.names)
        twice = next((name for name in self.names if self.names.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"listed targets: {twice} is listed twice")
        for name in ("points_m", "sigma_m"):
            object.__setattr__(self, name, float_array(f"listed targets: {name}", getattr(self, name), (n, 3)))
        if (self.sigma_m <= 0).any():
            bad = self.names[int(np.argmax((self.sigma_m <= 0).any(axis=1)))]
            raise InputError(f"listed targets: {bad}: a positive sigma is needed")

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True, slots=True, eq=False)
class NamedPoints:
    """Which point is which listed target.

    names: Name of each point; None for those that are not in the list.
    left: Listed targets without a point, with the reason.
    """

    names: tuple[str | None, ...]
    left: tuple[LeftOut, ...]


def name_points(
    points_m: FloatArray, covariance_m2: FloatArray, listed: ListedTargets, list_from_world: RigidTransform
) -> NamedPoints:
    """Give points the names of the listed targets they agree with.

    Shapes: covariance_m2 (n, 3, 3).
    points_m (n, 3): The points in the network's frame [m].
    list_from_world: The network's frame in the list's.
    Returns: Names where point and listed target agree within their sigmas and nothing else does nearly as well.
    """
    names: list[str | None] = [None] * len(points_m)
    squares, far = _distances(points_m, covariance_m2, listed, list_from_world)
    gate = chi_square_limit(_SIGNIFICANCE, 3)
    left = []
    for k, name in enumerate(listed.names):
        fitting = np.nonzero(squares[k] < gate)[0]
        if not fitting.size:
            near = f"; the nearest point is {1e3 * far[k].min():.1f} mm off" if far.size else ""
            left.append(LeftOut(name, f"no point agrees with its listed place{near}"))
            continue
        best = int(fitting[np.argmin(squares[k, fitting])])
        rivals = np.delete(squares[k], best)
        others = np.delete(squares[:, best], k)
        if (rivals < squares[k, best] + _CLEARLY).any():
            left.append(LeftOut(name, "two points agree with its listed place; state it with a smaller sigma"))
        elif (others < squares[k, best] + _CLEARLY).any():
            other = listed.names[[i for i in range(len(listed)) if i != k][int(np.argmin(others))]]
            left.append(LeftOut(name, f"the point there may as well be {other}; state both with a smaller sigma"))
        else:
            names[best] = name
    return NamedPoints(tuple(names), tuple(left))


def _distances(
    points_m: FloatArray, covariance_m2: FloatArray, listed: ListedTargets, list_from_world: RigidTransform
) -> tuple[FloatArray, FloatArray]:
    """Return squared distances in sigma and distances [m] of listed targets and points, (k, n)."""
    off = list_from_world.apply(points_m)[None] - listed.points_m[:, None]
    turn = list_from_world.rotation
    whole = (turn @ covariance_m2 @ turn.T)[None] + (listed.sigma_m**2)[:, None, :, None] * np.eye(3)
    squares = np.einsum("kni,kni->kn", off, np.linalg.solve(whole, off[..., None])[..., 0])
    return squares, np.linalg.norm(off, axis=2)


def list_frame(points_m: FloatArray, known_m: Mapping[str, FloatArray], listed: ListedTargets) -> RigidTransform:
    """Find the network's frame in the list's: from common names, else from the distances between points.

    Shapes: known_m (3,).
    points_m (n, 3): Points without a name in the network's frame, which must have the right scale [m].
    listed: The list; three names of the network in it settle the frame.
    EstimationError: Nothing fits, the common names are on one line, or two different frames fit equally well.

    Without common names, triples of points with the three distances of listed targets give frames; the one in which
    most listed targets find a point is taken. Mirror images are never taken. A rival is a frame with other names, as
    many but one, and distances that the sigmas allow: the layout is symmetric within them.
    """
    common = [k for k, name in enumerate(listed.names) if name in known_m]
    if len(common) >= 3:
        own = np.array([known_m[listed.names[k]] for k in common])
        return align_points(own, listed.points_m[common], names=[listed.names[k] for k in common]).b_from_a
    if len(listed) < 3 or len(points_m) < 3:
        raise EstimationError(
            f"listed targets: {len(listed)} of them and {len(points_m)} points without a code leave open the list's "
            "frame; give control points, or list three coded targets too"
        )
    reach = 4 * float(np.sqrt((listed.sigma_m**2).sum(axis=1).mean()))
    return _find_frame(points_m, listed, reach)


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """A frame, the point of each listed target (-1 for none) and their squared distances in sigma."""

    list_from_world: RigidTransform
    point_of: IntArray
    square: float

    @property
    def count(self) -> int:
        """Number of listed targets that have a point."""
        return int((self.point_of >= 0).sum())


def _bases(listed: ListedTargets, reach: float) -> Iterator[IntArray]:
    """Yield triples of listed targets, not nearly on a line, in a fixed random order: any of them may be missing."""
    rng = np.random.default_rng(0)
    for _ in range(_BASES):
        base = rng.choice(len(listed), 3, replace=False)
        a, b, c = base.tolist()
        one, two = listed.points_m[b] - listed.points_m[a], listed.points_m[c] - listed.points_m[a]
        longest = float(np.linalg.norm(one))
        if longest > 5 * reach and float(np.linalg.norm(np.cross(one, two))) > 5 * reach * longest:
            yield base


def _try_frames(points_m: FloatArray, listed: ListedTargets, base: IntArray, reach: float) -> list[_Frame]:
    """Return frames from triples of points whose three distances are those of listed targets."""
    a, b, c = base.tolist()
    sides = np.linalg.norm(points_m[:, None] - points_m[None], axis=2)
    ab, ac, bc = (float(np.linalg.norm(listed.points_m[p] - listed.points_m[q])) for p, q in ((a, b), (a, c), (b, c)))
    found = []
    for i, j in zip(*np.nonzero(np.abs(sides - ab) < reach), strict=True):
        third = np.nonzero((np.abs(sides[i] - ac) < reach) & (np.abs(sides[j] - bc) < reach))[0]
        for k in third.tolist():
            try:
                start = align_points(points_m[[i, j, k]], listed.points_m[base]).b_from_a
                found.append(_settle(start, points_m, listed, reach))
            except EstimationError:
                continue
    return found


def _settle(frame: RigidTransform, points_m: FloatArray, listed: ListedTargets, reach: float) -> _Frame:
    """Fit a frame to all targets that find a point; fewer than three, or on a line, are refused."""
    sigma = np.sqrt((listed.sigma_m**2).mean(axis=1))
    # Errors of a triple grow outwards: twice the reach at first.
    for limit in (2 * reach, reach, reach):
        far = np.linalg.norm(frame.apply(points_m)[None] - listed.points_m[:, None], axis=2)
        nearest = np.argmin(far, axis=1)
        own = far[np.arange(len(listed)), nearest]
        good = (own < limit) & (np.argmin(far, axis=0)[nearest] == np.arange(len(listed)))
        frame = align_points(points_m[nearest[good]], listed.points_m[good]).b_from_a
    return _Frame(frame, np.where(good, nearest, -1), float(((own / sigma)[good] ** 2).sum()))


def _find_frame(points_m: FloatArray, listed: ListedTargets, reach: float) -> RigidTransform:
    found: list[_Frame] = []
    clear = 0
    for base in _bases(listed, reach):
        found += _try_frames(points_m, listed, base, reach)
        # A few more after the first good one: a rival of a symmetric layout comes from the same triple.
        clear += bool(found) and max(one.count for one in found) >= max(0.6 * len(listed), 4)
        if clear > 3:
            break
    found.sort(key=lambda one: (-one.count, one.square))
    if not found or found[0].count < 4:
        raise EstimationError(
            f"listed targets: no frame puts 4 of the {len(listed)} near points; are coordinates, sigmas and the scale "
            "of the network right?"
        )
    best = found[0]
    for one in found[1:]:
        both = (one.point_of >= 0) & (best.point_of >= 0)
        differs = not both.any() or (one.point_of[both] != best.point_of[both]).any()
        limit = max(chi_square_limit(_SIGNIFICANCE, max(3 * one.count - 6, 1)), 1.5 * best.square)
        if differs and one.count >= best.count - 1 and one.square < limit:
            raise EstimationError(
                f"listed targets: two ways of naming fit {best.count} points equally well (a symmetric layout); give "
                "control points, or list three coded targets too"
            )
    return best.list_from_world
