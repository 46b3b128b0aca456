"""Names for points without a code, from a list of approximate coordinates."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from heliogauge.chi_square import chi_square_quantile
from heliogauge.errors import EstimationError, InputError
from heliogauge.rigid import RigidTransform
from heliogauge.validate import FloatArray, float_array
from photogrammetry.network import LeftOut
from photogrammetry.observations import IntArray

__all__ = ["ListedTargets", "NamedPoints", "list_frame", "name_points"]

#: Probability of refusing a point that is the listed one.
_SIGNIFICANCE = 1e-4
#: A rival must fit worse by this chi-square, 1 to 3000 against it.
_CLEARLY = 16.0
#: Pairs of listed targets from which the frame is tried, the longest first.
_PAIRS = 6


@dataclass(frozen=True, slots=True, eq=False)
class ListedTargets:
    """Targets with approximate coordinates in a frame of their own.

    Parameters
    ----------
    names : tuple of str, length n
        Their names.
    points_m : array_like, shape (n, 3)
        Approximate coordinates [m].
    sigma_m : array_like, shape (n, 3)
        How approximate, each axis [m].

    Raises
    ------
    InputError
        A name twice, lengths that differ, or a sigma that is not positive.
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

    Parameters
    ----------
    names : tuple of str or None
        Name of each point; None for those that are not in the list.
    left : tuple of LeftOut
        Listed targets without a point, with the reason.
    """

    names: tuple[str | None, ...]
    left: tuple[LeftOut, ...]


def name_points(
    points_m: FloatArray, covariance_m2: FloatArray, listed: ListedTargets, list_from_world: RigidTransform
) -> NamedPoints:
    """Give points the names of the listed targets they agree with.

    Parameters
    ----------
    points_m : ndarray, shape (n, 3)
        The points in the network's frame [m].
    covariance_m2 : ndarray, shape (n, 3, 3)
        Their covariances [m^2].
    listed : ListedTargets
        The list.
    list_from_world : RigidTransform
        The network's frame in the list's.

    Returns
    -------
    NamedPoints
        Names where point and listed target agree within their sigmas and nothing else does nearly as well.
    """
    names: list[str | None] = [None] * len(points_m)
    squares, far = _distances(points_m, covariance_m2, listed, list_from_world)
    gate = chi_square_quantile(1 - _SIGNIFICANCE, 3)
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

    Parameters
    ----------
    points_m : ndarray, shape (n, 3)
        Points without a name in the network's frame, which must have the right scale [m].
    known_m : mapping of str to ndarray of shape (3,)
        Named targets of the network [m].
    listed : ListedTargets
        The list; three names of the network in it settle the frame.

    Returns
    -------
    RigidTransform
        The frame.

    Raises
    ------
    EstimationError
        Nothing fits, or two different frames fit equally well.

    Notes
    -----
    Without common names, pairs of points as far apart as a pair of listed targets, with a third one, give frames; the
    one that most listed targets find a point in is taken. Mirror images are never taken.
    """
    common = [k for k, name in enumerate(listed.names) if name in known_m]
    if len(common) >= 3:
        own = np.array([known_m[listed.names[k]] for k in common])
        return _fitted(own, listed.points_m[common])
    if len(listed) < 3 or len(points_m) < 3:
        raise EstimationError(
            f"listed targets: {len(listed)} of them and {len(points_m)} points without a code cannot tell the list's "
            "frame; give control points, or list three coded targets too"
        )
    reach = 4 * float(np.sqrt((listed.sigma_m**2).sum(axis=1).mean()))
    trials = _trials(points_m, listed, reach)
    return _best(trials, points_m, listed, reach)


def _trials(points_m: FloatArray, listed: ListedTargets, reach: float) -> list[RigidTransform]:
    """Return frames from triples of points whose three distances are those of listed targets."""
    sides = np.linalg.norm(points_m[:, None] - points_m[None], axis=2)
    known = np.linalg.norm(listed.points_m[:, None] - listed.points_m[None], axis=2)
    pairs = sorted(combinations(range(len(listed)), 2), key=lambda pair: -known[pair])[:_PAIRS]
    found = []
    for a, b in pairs:
        # The third one far from the line of both makes the frame certain.
        axis = (listed.points_m[b] - listed.points_m[a]) / max(known[a, b], 1e-300)
        off = np.linalg.norm(np.cross(listed.points_m - listed.points_m[a], axis), axis=1)
        c = int(np.argmax(off))
        if off[c] < 3 * reach:
            continue
        for i, j in zip(*np.nonzero(np.abs(sides - known[a, b]) < reach), strict=True):
            third = np.nonzero((np.abs(sides[i] - known[a, c]) < reach) & (np.abs(sides[j] - known[b, c]) < reach))[0]
            found += [_fitted(points_m[[i, j, k]], listed.points_m[[a, b, c]]) for k in third.tolist()]
    return found


def _best(
    trials: Sequence[RigidTransform], points_m: FloatArray, listed: ListedTargets, reach: float
) -> RigidTransform:
    judged: list[tuple[int, float, RigidTransform, IntArray]] = []
    for trial in trials:
        frame = trial
        for _ in range(2):
            far = np.linalg.norm(frame.apply(points_m)[None] - listed.points_m[:, None], axis=2)
            nearest = np.argmin(far, axis=1)
            good = (far.min(axis=1) < 2 * reach) & (np.bincount(nearest, minlength=len(points_m))[nearest] == 1)
            if good.sum() < 3:
                break
            frame = _fitted(points_m[nearest[good]], listed.points_m[good])
        else:
            far = np.linalg.norm(frame.apply(points_m)[None] - listed.points_m[:, None], axis=2)
            good &= far[np.arange(len(listed)), nearest] < reach
            place = np.where(good, nearest, -1)
            error = float((np.minimum(far.min(axis=1), reach) ** 2).sum() / (reach / 4) ** 2)
            judged.append((int(good.sum()), error, frame, place))
    judged.sort(key=lambda one: (-one[0], one[1]))
    if not judged or judged[0][0] < min(4, len(listed)):
        raise EstimationError(
            f"listed targets: no frame puts {min(4, len(listed))} of the {len(listed)} near points; are coordinates, "
            "sigmas and the scale of the network right?"
        )
    count, error, frame, place = judged[0]
    rivals = [one for one in judged[1:] if not np.array_equal(one[3][place >= 0], place[place >= 0])]
    if rivals and rivals[0][0] == count and rivals[0][1] < error + _CLEARLY:
        raise EstimationError(
            f"listed targets: two ways of naming fit {count} points equally well (a symmetric layout); give control "
            "points, or list three coded targets too"
        )
    return frame


def _fitted(own_m: FloatArray, wanted_m: FloatArray) -> RigidTransform:
    """Return the rigid motion that moves points best onto others (Kabsch); never a mirror image."""
    middle, aim = own_m.mean(axis=0), wanted_m.mean(axis=0)
    left, _, right = np.linalg.svd((wanted_m - aim).T @ (own_m - middle))
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return RigidTransform(turn, aim - turn @ middle)
