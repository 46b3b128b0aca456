"""Whether the listed targets are those in the photos, and determine where the trough's frame lies."""

from collections.abc import Mapping, Sequence

import numpy as np

from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import skew
from heliogauge.validate import BoolArray, FloatArray
from observer.trough.collector import Collector

#: Fewest targets that determine a frame.
_FEWEST = 3
#: A frame that may be turned by more than this is none: slopes of troughs are wanted to a tenth of a milliradian [rad].
_LOOSE_RAD = 5e-3
#: Names that are printed of each list.
_SHOWN = 8
#: A listed target is elsewhere when it is so many times further off than it should be and than most others are ...
_STRAY_TIMES = 8.0
#: ... and so is at most this share of all: as many may have been exchanged, more are another camera or another list.
_MOST_STRAYS = 0.25
#: Lines of sight that differ by less say nothing of how far a target is [rad].
_LEAST_ANGLE_RAD = 0.02
#: Targets on rims are as high as the mirror there, within this share of the rim's height.
_BESIDE_SHARE = 0.3
_AXES = ("x", "y", "z")


def refuse_strange_targets(listed: Sequence[str], seen: Sequence[str], file: str) -> None:
    """Refuse a list of which the photos show hardly any target: names or dictionary are wrong.

    file: Name of the list, for the message.
    InputError: Fewer than three listed targets are seen.
    """
    shown = sorted(set(seen), key=_by_number)
    both = set(listed) & set(shown)
    if len(both) >= _FEWEST or not shown:
        return
    raise InputError(
        f"targets: of the {len(set(listed))} targets in {file} ({_some(listed)}) the photos show {len(both)}, and "
        f"{len(shown)} in all ({_some(shown)}); are the names right, and is it the right [targets] dictionary?"
    )


def refuse_loose_frame(points_m: FloatArray, sigma_m: FloatArray, left_out: Sequence[str] = ()) -> None:
    """Refuse coordinates that leave the trough's frame free to turn, as those of targets along one line.

    points_m (n, 3), sigma_m (n, 3): As for `free_axis`.
    left_out: Targets whose listed places the others contradict, for the message.
    EstimationError: The frame may be turned by more than 5 mrad.
    """
    axis = free_axis(points_m, sigma_m)
    if axis is None:
        return
    without = f", without those that the others contradict ({_some(left_out)})," if left_out else ""
    raise EstimationError(
        f"targets: the listed coordinates of the {len(points_m)} targets that the photos show{without} leave the "
        f"trough's frame free to turn, mostly about {axis}; list the coordinates of at least four targets that are not "
        "on one line, on both rims"
    )


def free_axis(points_m: FloatArray, sigma_m: FloatArray) -> str | None:
    """Return about which axis listed coordinates leave the frame free to turn, by more than 5 mrad; None: about none.

    points_m (n, 3): Targets with listed coordinates, as adjusted [m].
    sigma_m (n, 3): Standard deviations of their listed coordinates; NaN where a coordinate is not known [m].
    """
    weights = np.nan_to_num(1 / sigma_m**2)
    total = weights.sum(axis=0)
    middle = (weights * points_m).sum(axis=0) / np.maximum(total, 1e-12)
    # A small turn w moves a point by w x p: the columns of -[p]x.
    turned = -skew(points_m - middle)
    moved = np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], axis=2).reshape(-1, 6)
    normal = moved.T @ (weights.reshape(-1, 1) * moved)
    information = normal[:3, :3] - normal[:3, 3:] @ np.linalg.pinv(normal[3:, 3:]) @ normal[3:, :3]
    values, vectors = np.linalg.eigh(information)
    if (total > 0).all() and values[0] * _LOOSE_RAD**2 > 1:
        return None
    return _AXES[int(np.argmax(np.abs(vectors[:, 0])))]


def stray_targets(residual_px: FloatArray, sigma_px: FloatArray) -> BoolArray:
    """Return which listed targets are not where the list has them, as most of the others are.

    residual_px (n,): How far each is, in a usual photo, from where the pose that most targets agree with shows it
        [px].
    sigma_px (n,): How far it may be, as a standard deviation [px].
    Returns (n,): Targets with a wrong entry; none where so many contradict each other that any may be right, or the
        camera wrong.
    """
    far = residual_px > _STRAY_TIMES * np.maximum(sigma_px, float(np.median(residual_px)) if residual_px.size else 0.0)
    left = far.size - int(np.count_nonzero(far))
    few = np.count_nonzero(far) <= _MOST_STRAYS * far.size and left > _FEWEST
    return np.asarray(far & few)


def intersect(eyes_m: FloatArray, lines: FloatArray) -> FloatArray | None:
    """Return the point nearest to lines of sight.

    Shapes: eyes_m (n, 3), lines (n, 3), result (3,) [m].
    Returns: None where the lines are fewer than two or run nearly alike.
    """
    unit = lines / np.linalg.norm(lines, axis=1, keepdims=True)
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    normal = across.sum(axis=0)
    # Of two lines at an angle a the smallest eigenvalue is 1 - cos a.
    if len(eyes_m) < 2 or np.linalg.eigvalsh(normal)[0] < len(eyes_m) * (1 - np.cos(_LEAST_ANGLE_RAD)) / 2:
        return None
    return np.asarray(np.linalg.solve(normal, (across @ eyes_m[:, :, None])[..., 0].sum(axis=0)))


def exchanged_pairs(
    seen_m: Mapping[int, FloatArray],
    points_m: FloatArray,
    sigma_m: FloatArray,
    point_m: float,
    unseen: Sequence[int] = (),
) -> list[tuple[int, int]]:
    """Return pairs of stray targets each of which the photos show where the list has the other.

    Shapes: points_m (n, 3), sigma_m (n,).
    seen_m: Where the photos show the stray ones, by their numbers [m].
    point_m: How well a photo shows a place [m].
    unseen: Targets that no photo shows under their name, as dots without a code that are not where they are listed: of
        a pair with one of them the other one alone tells.
    """
    strays = sorted(seen_m)
    pairs = []
    for k, a in enumerate(strays):
        for b in strays[k + 1 :]:
            sigma = _STRAY_TIMES * np.hypot(sigma_m[[b, a]], point_m)
            off = [np.linalg.norm(seen_m[a] - points_m[b]), np.linalg.norm(seen_m[b] - points_m[a])]
            if (np.array(off) < sigma).all():
                pairs.append((a, b))
        reach_m = _STRAY_TIMES * np.hypot(sigma_m, point_m)
        pairs += [(a, b) for b in unseen if np.linalg.norm(seen_m[a] - points_m[b]) < reach_m[b]]
    members = [one for pair in pairs for one in pair]
    return [pair for pair in pairs if members.count(pair[0]) == members.count(pair[1]) == 1]


def refuse_upside_down(points_m: FloatArray, collector: Collector) -> None:
    """Refuse a list of targets beside the mirror whose z has the wrong sign.

    Shapes: points_m (n, 3).
    InputError: Most targets would be beside the mirror if z were the opposite.
    """
    x, _, z = points_m.T
    height = x**2 / (4 * collector.focal_length_m)
    near = np.abs(z + height) < _BESIDE_SHARE * collector.rim_height_m
    if 2 * np.count_nonzero(near & (height > 2 * _BESIDE_SHARE * collector.rim_height_m)) > len(points_m):
        raise InputError(
            f"targets: with z = {float(np.median(z)):.3f} m (median) they are as far below the vertex as the mirror is "
            "above it; z goes from the vertex to the absorber: change the sign of z_m for all targets"
        )


def _some(names: Sequence[str]) -> str:
    return ", ".join(list(names)[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def _by_number(name: str) -> tuple[int, str]:
    return (int(name) if name.isdigit() else 0, name)
