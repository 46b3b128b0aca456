"""A line laser swept over a mirror twice: where two lines cross on the target, both of their sheets of light met."""

from dataclasses import dataclass

import numpy as np

from deflectometry.laser.scan import LaserScan
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Points of a line farther apart than so many times their usual distance have a gap between them.
_GAP = 4.0
#: Points on each side that tell the direction of a line.
_BESIDE = 5
#: Sheets of two sweeps that are closer to parallel than 30 degrees determine no beam.
_LEAST_SINE = 0.5
#: A line has a direction where it is longer than twice the standard deviation of its length, that of two points.
_LEAST_LENGTH = 2.0 * np.sqrt(2.0)


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Lines on the target, one after the other.

    normals (k, 3): Unit normals of the sheets of light, which contain the laser, in the laser's frame.
    line (n,): To which sheet each point of a line belongs.
    points_m (n, 2): Points of the lines on the target, in the order in which they follow on the line [m].
    """

    normals: FloatArray
    line: IntArray
    points_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CrossedLines:
    """The beams in which the sheets of two sweeps cut each other.

    scan: Each beam with the spot where its two lines cross.
    unclear (n,): Beams without a spot because their lines cross more than once, or one of them is a point there.
    """

    scan: LaserScan
    unclear: BoolArray


def cross_lines(first: Sweep, second: Sweep, sigma_spot_m: float) -> CrossedLines:
    """Return a scan of all beams in which sheets of two sweeps cut each other.

    sigma_spot_m: Standard deviation of each point of a line across it [m].
    EstimationError: The sheets of both sweeps are nearly parallel.

    A point P of the mirror is lit by sheet i of one sweep and by sheet j of the other, and sends both to the same point
    of the target: lines i and j cross there. The beam to P is the one in which the sheets cut each other, along
    ``n_i x n_j``. So k and m lines give k m beams, and all that is known of beams (spec 003 C-26b, c) holds for them.
    Where the mirror sends two beams to one point of the target, lines cross more than once: those beams are left out,
    and so are those where a line is no longer than its noise and crosses wherever that happens to lead it.
    """
    sheets = np.cross(first.normals[:, None], second.normals[None])
    sine = np.linalg.norm(sheets, axis=-1)
    if sine.min() < _LEAST_SINE:
        raise EstimationError(
            f"sheets of both sweeps are {np.degrees(np.arcsin(sine.min())):.0f} degrees from parallel: they determine "
            "no beam; sweep across and along"
        )
    directions = (sheets * np.where(sheets[..., 2:] > 0, -1.0, 1.0) / sine[..., None]).reshape(-1, 3)
    one, other = _segments(first), _segments(second)
    beam, spots, steps, shorter_m = _crossings(one, other, len(second.normals))
    number = np.bincount(beam, minlength=len(directions))
    least_m = _LEAST_LENGTH * sigma_spot_m
    clear = (number[beam] == 1) & (shorter_m >= least_m)
    points = [_is_point(sweep, part, least_m) for sweep, part in ((first, one), (second, other))]
    unclear = np.asarray(points[0][:, None] | points[1]).ravel()
    unclear[beam[~clear]] = True
    once = clear & ~unclear[beam]
    spots_m, spot_steps = np.full((3, len(directions)), np.nan), np.zeros((2, 3, len(directions)))
    spots_m[:2, beam[once]], spots_m[2, beam[once]] = spots[once].T, 0.0
    spot_steps[:, :2, beam[once]] = steps[once].transpose(2, 1, 0)
    met = np.count_nonzero(number)
    shared = 0.5 * (met / max(len(np.unique(first.line)), 1) + met / max(len(np.unique(second.line)), 1))
    scan = LaserScan(
        directions.T, spots_m, _direction_steps(first.normals, second.normals, directions), spot_steps, max(shared, 1.0)
    )
    return CrossedLines(scan, unclear)


def is_in_order(points_m: FloatArray, sigma_spot_m: float) -> bool:
    """Return whether the points (n, 2) of a line follow each other on it [m].

    The usual step to the next point is that to the nearest one, as far as noise does not bring others nearer.
    """
    from scipy.spatial import cKDTree

    seen = points_m[np.isfinite(points_m).all(axis=1)]
    if len(seen) < 3:
        return True
    step = float(np.median(np.hypot(*np.diff(seen, axis=0).T)))
    nearest = float(np.median(cKDTree(seen).query(seen, k=2)[0][:, 1]))
    return bool(step <= max(_GAP * nearest, _LEAST_LENGTH * sigma_spot_m))


def _direction_steps(first: FloatArray, second: FloatArray, directions: FloatArray) -> FloatArray:
    """Return how beams follow when one of their sheets turns by 1 rad: they stay in the other, shape (2, 3, n)."""
    one = np.repeat(first, len(second), axis=0)
    other = np.tile(second, (len(first), 1))
    steps = []
    for turned, kept in ((one, other), (other, one)):
        along = np.cross(kept, directions)
        steps.append((along / np.einsum("ni,ni->n", along, turned)[:, None]).T)
    return np.stack(steps)


@dataclass(frozen=True, slots=True, eq=False)
class _Segments:
    """Pieces of lines between neighbouring points.

    line (n,), begin_m (n, 2), step_m (n, 2): To the next point. across (n, 2): Unit vectors across the line.
    length_m (n,): Of the part of the line that tells its direction.
    """

    line: IntArray
    begin_m: FloatArray
    step_m: FloatArray
    across: FloatArray
    length_m: FloatArray


def _segments(sweep: Sweep) -> _Segments:
    step = np.diff(sweep.points_m, axis=0)
    length = np.hypot(*step.T)
    same = (np.diff(sweep.line) == 0) & (length > 0)
    usual = np.ones(len(sweep.normals))
    for number in np.unique(sweep.line[:-1][same]):
        usual[number] = np.median(length[same & (sweep.line[:-1] == number)])
    same &= length < _GAP * usual[sweep.line[:-1]]
    piece = np.flatnonzero(same)
    # Noise of its two points turns a piece: the line's direction is that of some more, as far as it has no gap.
    begins = np.append(True, ~same)
    first, last = np.flatnonzero(begins), np.flatnonzero(np.append(begins[1:], True))
    run = np.cumsum(begins)[piece] - 1
    low, high = np.maximum(piece - _BESIDE, first[run]), np.minimum(piece + 1 + _BESIDE, last[run])
    chord = sweep.points_m[high] - sweep.points_m[low]
    length_m = np.hypot(*chord.T)
    across = np.stack([-chord[:, 1], chord[:, 0]], axis=1) / length_m[:, None]
    return _Segments(sweep.line[piece], sweep.points_m[piece], step[piece], across, length_m)


def _is_point(sweep: Sweep, pieces: _Segments, least_m: float) -> BoolArray:
    """Return which sheets are seen on the target, but nowhere as a line, shape (k,)."""
    seen = np.isin(np.arange(len(sweep.normals)), sweep.line[np.isfinite(sweep.points_m).all(axis=1)])
    return seen & ~np.isin(np.arange(len(sweep.normals)), pieces.line[pieces.length_m >= least_m])


def _crossings(one: _Segments, other: _Segments, lines: int) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return where lines of both sweeps cross.

    lines: How many the second sweep has.
    Returns: Number of the beam (c,), place (c, 2) [m], what one metre of noise of each line does to it (c, 2, 2), and
        the length that tells the direction of the shorter line (c,) [m].
    """
    from scipy.spatial import cKDTree

    if not (one.line.size and other.line.size):
        return np.zeros(0, dtype=np.intp), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0)
    reach = 0.5 * (np.hypot(*one.step_m.T).max() + np.hypot(*other.step_m.T).max())
    middles = (cKDTree(part.begin_m + 0.5 * part.step_m) for part in (one, other))
    near = next(middles).query_ball_tree(next(middles), reach)
    a = np.repeat(np.arange(len(near)), [len(found) for found in near])
    b = np.array([n for found in near for n in found], dtype=np.intp)
    step_a, step_b, apart = one.step_m[a], other.step_m[b], other.begin_m[b] - one.begin_m[a]
    area = _cross(step_a, step_b)
    with np.errstate(divide="ignore", invalid="ignore"):
        along_a, along_b = _cross(apart, step_b) / area, _cross(apart, step_a) / area
    cut = (along_a >= 0) & (along_a < 1) & (along_b >= 0) & (along_b < 1)
    a, b, along_a, along_b = a[cut], b[cut], along_a[cut], along_b[cut]
    across = np.stack([one.across[a], other.across[b]], axis=1)
    # Each line moves by the noise of the two points beside the crossing, weighted as the line between them is.
    noise = np.stack([np.hypot(1 - along_a, along_a), np.hypot(1 - along_b, along_b)], axis=1)
    steps = np.linalg.inv(across) * noise[:, None, :]
    beam = one.line[a] * lines + other.line[b]
    shorter_m = np.minimum(one.length_m[a], other.length_m[b])
    return beam, one.begin_m[a] + along_a[:, None] * one.step_m[a], steps, shorter_m


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
