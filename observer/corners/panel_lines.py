"""Gaps between panels and rims in one photo, each beside where a pose predicts it, and the pose that fits them.

A gap is a dark (or bright) line, a rim a step. Along each the photo is averaged over pieces of a few pixels, which are
filtered across. First the straight line with the largest sum of responses, each cut off at what is usual, is sought:
what crosses a gap, as the edge of the tube's reflection, has a large response in a few pieces only. Then the pieces'
own places near it give the line and, by their scatter, its covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from heliogauge.adjust.robust_loss import Tukey
from heliogauge.adjust.robust_scale import SIGMA_PER_MAD, robust_scale
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray
from observer.corners.lattice import PanelLattice, PanelLine
from observer.photo_edges.reflection_edges import beside_receiver_m
from observer.photo_edges.views import AnyImage, View

#: Samples across a line, and length of a piece along it [px].
_STEP_PX, _PIECE_PX = 0.5, 8.0
#: Width of the filters: below the lens's blur the grid of pixels shows, far above it neighbouring lines mix [px].
_FILTER_PX = 1.0
#: Both ends of a line are left out: other lines and their blur are there [px], and panels' shifts [m].
_END_PX, _END_M = 4.0, 0.02
#: A receiver lies so far off its place [m].
_RECEIVER_OFF_M = 0.02
#: Fewest pieces that give a line with a scatter.
_FEWEST_PIECES = 6
#: A piece shows a line where its response stands so many times above the noise's: by chance in one of 10^4 pieces, of
#: which a window has some ten independent places.
_NOISE_TIMES = 4.0
#: Share of the pieces that must show the line, and lie on it.
_LEAST_SHARE = 0.4
#: A second line beside the first one whose sum is so large a share of the first one's leaves open which is meant.
_SECOND_SHARE = 0.8
#: Pieces' own places count so near the line [px].
_NEAR_PX = 1.5
#: Share of the pieces that show a line that is there, and that show something else in its place: in drawn photos 0.85
#: to 0.98, and 0.2 to 0.3 where a pose is wrong. Pieces beside each other show the same thing.
_SHOWN, _CHANCE, _ALIKE_PIECES = 0.9, 0.3, 4
#: Weights of what lies beside a line, or beside a pose; rounds of the fit, and the change at which it ends.
_TUKEY, _ROUNDS, _SETTLED = Tukey(), 12, 1e-2
#: What grid of pixels and resampling leave of a line's place [px].
_FLOOR_PX = 0.01


class Pieces(NamedTuple):
    """Brightness across lines at their pieces, one line's after the other's.

    values (p, m): Along the normal, `_STEP_PX` apart, the middle where the line is predicted [DN].
    share (p,): Where along its line each piece is, 0 at the first corner to 1 at the last.
    line (p,): Number of the line, ascending.
    """

    values: FloatArray
    share: FloatArray
    line: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class FoundLine:
    """A line as a photo shows it: ``offset + slope (share - middle)`` across the predicted one, along its normal.

    offset_px, slope_px: Of the line [px].
    middle: Share about which both are nearly independent.
    covariance_px2 (2, 2): Of both [px^2].
    hits: Share of its pieces that show it.
    """

    line: PanelLine
    offset_px: float
    slope_px: float
    middle: float
    covariance_px2: FloatArray
    hits: float

    def at(self, share: float) -> tuple[float, float]:
        """Return offset and variance at a place along the line [px, px^2]."""
        row = np.array([1.0, share - self.middle])
        return float(row @ [self.offset_px, self.slope_px]), float(row @ self.covariance_px2 @ row)


def normals_at(
    view: View, lattice: PanelLattice, lines: Sequence[PanelLine], which: IntArray, share: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the image points of places on lines and the unit normals to the images there; NaN where unseen.

    Shapes: share (...), image points and normals (..., 2).
    which (...): Number of the line of each place.
    share: Where along the line.
    """
    step = 1e-3
    points = lattice.on_lines(lines, which, np.stack([share, share - step, share + step]))
    pixels = view.camera.project(view.cam_from_frame.apply(points))
    along = pixels[2] - pixels[1]
    with np.errstate(invalid="ignore", divide="ignore"):
        along = along / np.hypot(along[..., :1], along[..., 1:])
    return pixels[0], np.stack([-along[..., 1], along[..., 0]], axis=-1)


def normal_at(view: View, lattice: PanelLattice, line: PanelLine, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the same of one line, shape (n, 2) each."""
    return normals_at(view, lattice, [line], np.zeros(share.size, dtype=np.intp), share)


def line_pieces(
    image: AnyImage, view: View, lattice: PanelLattice, lines: Sequence[PanelLine], reach_px: float
) -> Pieces:
    """Read the brightness across lines; without those of which the photo shows less than a few pieces.

    reach_px: How far to both sides [px].
    """
    number = np.arange(len(lines))[:, None]
    course = normals_at(view, lattice, lines, number, np.broadcast_to([0.0, 0.5, 1.0], (len(lines), 3)))[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        length = np.linalg.norm(np.diff(course, axis=1), axis=2).sum(axis=1)
        margin = _END_PX / length + _END_M / np.array([lattice.length_m[line] for line in lines])
        whole = np.floor((1 - 2 * margin) * length / _PIECE_PX)
    pieces = np.where(whole >= _FEWEST_PIECES, whole, 0.0).astype(np.intp)
    each, line = int(_PIECE_PX), np.repeat(np.arange(len(lines)), pieces)
    within = np.arange(line.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    place = (within[:, None] + (np.arange(each) + 0.5) / each) / pieces[line, None]
    share = margin[line, None] + (1 - 2 * margin[line, None]) * place
    places, normals = normals_at(view, lattice, lines, line[:, None], share)
    across = np.arange(-reach_px, reach_px + _STEP_PX / 2, _STEP_PX)
    height, width = image.shape[:2]
    ends = places[..., None, :] + across[[0, -1], None] * normals[..., None, :]
    inside = ((ends >= 1) & (ends <= (width - 2, height - 2))).all(axis=(1, 2, 3))
    middles = share.mean(axis=1)
    inside &= ~_is_behind_receiver(lattice, lattice.on_lines(lines, line, middles), view.eye_m)
    inside &= (np.bincount(line[inside], minlength=len(lines)) >= _FEWEST_PIECES)[line]
    places, normals, line, middles = places[inside], normals[inside], line[inside], middles[inside]
    if not line.size:
        return Pieces(np.zeros((0, across.size)), middles, line)
    # A row for each piece: OpenCV takes no picture of more than 32767 rows.
    maps = [
        (places[..., k, None] + across * normals[..., k, None]).astype(np.float32).reshape(line.size, -1)
        for k in (0, 1)
    ]
    read = cv2.remap(image, maps[0], maps[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(read, dtype=np.float64).reshape(line.size, each, across.size).mean(axis=1)
    return Pieces(values, middles, line)


def _is_behind_receiver(lattice: PanelLattice, points_m: FloatArray, eye_m: FloatArray) -> BoolArray:
    """Return which points the receiver hides, or shows through its glass; all around it a little more."""
    eyes = np.broadcast_to(eye_m, points_m.shape)
    beside = beside_receiver_m(points_m, eyes, lattice.collector, lattice.receiver)
    return np.asarray(beside < _RECEIVER_OFF_M)


def photo_noise(image: AnyImage) -> float:
    """Return the noise of a photo's pixels from third differences, which shading leaves out [DN]."""
    some = np.asarray(image[:: max(1, image.shape[0] // 32)], dtype=np.float64)
    return max(robust_scale(np.diff(some, 3, axis=1), upper=True) / float(np.sqrt(20.0)), 0.1)


def find_lines(
    image: AnyImage,
    view: View,
    lattice: PanelLattice,
    reach_px: float,
    noise_dn: float,
    wanted: tuple[PanelLine, ...] | None = None,
) -> tuple[tuple[FoundLine | None, ...], IntArray]:
    """Find lines of the lattice near where a pose predicts them.

    noise_dn: Of a pixel [DN].
    wanted: Which ones; None: all.
    lines, pieces: Each line as found, None where the photo does not show it, or two that it may be; and in how many
        pieces the photo shows the place where it would be.
    """
    lines = lattice.lines if wanted is None else wanted
    return lines_in([line_pieces(image, view, lattice, lines, reach_px)], lines, [noise_dn])[0]


def lines_in(
    parts: Sequence[Pieces], lines: Sequence[PanelLine], noise_dn: Sequence[float]
) -> list[tuple[tuple[FoundLine | None, ...], IntArray]]:
    """Find lines in the pieces of some photos, as `find_lines` does in one.

    parts: Pieces of each photo.
    noise_dn: Of a pixel of each photo [DN].

    All lines at once: one by one a photo's twenty lines take three times as long, in calls on a few numbers, and sixty
    photos twice as long as together.
    """
    each = len(lines)
    pieces = Pieces(
        np.concatenate([one.values for one in parts]),
        np.concatenate([one.share for one in parts]),
        np.concatenate([one.line + k * each for k, one in enumerate(parts)]),
    )
    count = np.bincount(pieces.line, minlength=each * len(parts))
    found: list[FoundLine | None] = [None] * count.size
    if pieces.line.size:
        shown = np.flatnonzero(count)
        # Only lines that are shown have a number from here on.
        own = pieces._replace(line=np.searchsorted(shown, pieces.line))
        noise = np.asarray(noise_dn, dtype=np.float64)[shown // each]
        kept = shown.tolist()
        for k, one in zip(kept, _found(own, [lines[k % each] for k in kept], noise), strict=True):
            found[k] = one
    numbers = [slice(k * each, (k + 1) * each) for k in range(len(parts))]
    return [(tuple(found[some]), np.asarray(count[some], dtype=np.intp)) for some in numbers]


def _found(pieces: Pieces, lines: Sequence[PanelLine], noise_dn: FloatArray) -> list[FoundLine | None]:
    """Return each line as its pieces show it; every line has some.

    noise_dn (n,): Of a pixel of each line's photo [DN].
    """
    is_rim = np.array([line.is_rim for line in lines])
    kernels = {kind: _kernel(is_rim=kind) for kind in (True, False)}
    margin = kernels[True].size // 2
    windows = np.lib.stride_tricks.sliding_window_view(pieces.values, 2 * margin + 1, axis=1)
    response, noise = np.empty(windows.shape[:2]), np.empty(len(lines))
    for kind, kernel in kernels.items():
        own = is_rim[pieces.line] == kind
        response[own] = windows[own] @ kernel[::-1]
        beside_piece = float(np.sqrt((kernel**2).sum() * _STEP_PX / _PIECE_PX))
        noise[is_rim == kind] = beside_piece * noise_dn[is_rim == kind]
    voted = _vote(response, pieces, noise)
    signed = voted.sign[pieces.line, None] * response
    middle = (pieces.values.shape[1] - 1) / 2 - margin
    fitted = _fit(signed, pieces, noise, voted, middle)
    found: list[FoundLine | None] = [
        None if one is None else FoundLine(line, *one) for line, one in zip(lines, fitted, strict=True)
    ]
    gaps = [k for k, one in enumerate(found) if one is not None and not is_rim[k]]
    moved = _moved_by_step_px(pieces, found, signed, margin)
    for k in gaps:
        one = found[k]
        # Its pieces were looked for so near it: a step that may have moved it by more is no gap.
        if moved[k] > _NEAR_PX:
            found[k] = None
        elif one is not None:
            found[k] = replace(one, covariance_px2=one.covariance_px2 + np.diag([moved[k] ** 2, 0.0]))
    return found


def _moved_by_step_px(
    pieces: Pieces, found: Sequence[FoundLine | None], response: FloatArray, margin: int
) -> FloatArray:
    """Return by how much different brightness on both sides of gaps may have moved them, shape (n,) [px].

    response (p, m - 2 margin): Of the filter, positive at the gap.

    A gap of area A (depth times width) with a step S in it, both blurred to the width w, has its strongest response
    ``S w^2 / (3 A)`` beside its middle; the response there is ``A / (sqrt(2 pi) w)`` for a filter of that width.
    """
    none = (np.nan, 0.0, 0.0)
    offset, slope, middle = np.array(
        [none if one is None else (one.offset_px, one.slope_px, one.middle) for one in found]
    ).T
    line = pieces.line
    column = (pieces.values.shape[1] - 1) / 2 + (offset[line] + slope[line] * (pieces.share - middle[line])) / _STEP_PX
    # What was not found compares as outside.
    column = np.rint(np.nan_to_num(column, nan=-1.0)).astype(np.intp)
    rows = np.flatnonzero((column >= margin) & (column < pieces.values.shape[1] - margin))
    away, column, line = np.arange(margin // 2, margin + 1), column[rows, None], line[rows]
    beside = [pieces.values[rows[:, None], column + way * away].mean(axis=1) for way in (1, -1)]
    step = _medians(beside[0] - beside[1], line, len(found))
    height = _medians(response[rows, column[:, 0] - margin], line, len(found))
    moved = _FILTER_PX * np.abs(step) / (3 * float(np.sqrt(2 * np.pi)) * np.maximum(height, 1e-9))
    return np.nan_to_num(moved)


def _medians(values: FloatArray, group: IntArray, count: int) -> FloatArray:
    """Return the median of each group, shape (count,); NaN of none.

    Shapes: values (n,).
    group (n,): Number of the group of each, ascending.
    """
    ordered = np.append(values[np.lexsort((values, group))], np.nan)
    first = np.searchsorted(group, np.arange(count + 1))
    size = np.diff(first)
    low = np.where(size > 0, first[:-1] + (size - 1) // 2, -1)
    return np.asarray(0.5 * (ordered[low] + ordered[low + (size > 0) * (1 - size % 2)]))


class _Voted(NamedTuple):
    """Straight lines with the largest sums of responses.

    sign (n,): Of the responses, 0 where there is no line, or two.
    first, last (n,): Columns at the first and the last piece.
    """

    sign: FloatArray
    first: FloatArray
    last: FloatArray


def _kernel(*, is_rim: bool) -> FloatArray:
    width = _FILTER_PX / _STEP_PX
    place = np.arange(-np.ceil(4 * width), np.ceil(4 * width) + 1)
    bell = np.exp(-0.5 * (place / width) ** 2)
    bell /= bell.sum()
    # A rim is a step: the first derivative. A gap is a line: the second one, which a slope beside it does not move.
    kernel = place / width * bell if is_rim else (place**2 / width**2 - 1) * bell
    return np.asarray(kernel - kernel.mean())


def _along(pieces: Pieces) -> FloatArray:
    """Return how far along its line each piece is, 0 at the first to 1 at the last, shape (p,)."""
    first = np.flatnonzero(np.diff(pieces.line, prepend=-1))
    last = np.append(first[1:], pieces.line.size) - 1
    start, run = pieces.share[first], np.maximum(pieces.share[last] - pieces.share[first], 1e-9)
    return np.asarray((pieces.share - start[pieces.line]) / run[pieces.line])


def _vote(response: FloatArray, pieces: Pieces, noise: FloatArray) -> _Voted:
    """Find the straight lines with the largest sums of responses.

    response (p, w): Of the filter.
    noise (n,): Of the responses of each line's pieces [DN].
    """
    line, width, count = pieces.line, response.shape[1], noise.size
    both = np.stack([response, -response])
    usual = np.stack([_medians(one.max(axis=1), line, count) for one in both])
    cut = np.clip(both, 0.0, np.maximum(usual, noise)[:, line, None]).astype(np.float32)
    place, start, first = _along(pieces), np.arange(width), np.flatnonzero(np.diff(line, prepend=-1))
    # A line may be turned against the predicted one by half the window between its ends.
    turns = np.arange(-(width // 4), width // 4 + 1)
    sums = np.empty((2, count, turns.size, width), dtype=np.float32)
    for k, turn in enumerate(turns.tolist()):
        columns = start + np.rint(turn * (place[:, None] - 0.5)).astype(np.intp)
        valid = (columns >= 0) & (columns < width)
        turned = np.where(valid, cut[:, np.arange(line.size)[:, None], np.clip(columns, 0, width - 1)], 0)
        sums[:, :, k] = np.add.reduceat(turned, first, axis=1)
    turn, middle = np.divmod(sums.reshape(2, count, -1).argmax(axis=2), width)
    best = sums.max(axis=(2, 3))
    # Lines that cross the best one have its responses in some pieces; only such beside it compete.
    apart = np.abs(start - middle[..., None]) > 4 * _FILTER_PX / _STEP_PX
    near = np.abs(turns - turns[turn][..., None]) <= 2
    second = np.where(near[..., None] & apart[:, :, None], sums, -np.inf).max(axis=(2, 3))
    total = np.where((usual > 0) & (second <= _SECOND_SHARE * best), best, -np.inf)
    way, own = total.argmax(axis=0), np.arange(count)
    sign = np.where(np.isfinite(total[way, own]), 1.0 - 2.0 * way, 0.0)
    middle, half = middle[way, own], turns[turn[way, own]] / 2
    return _Voted(sign, middle - half, middle + half)


#: Offset and slope of a line, the share about which they are nearly independent, covariance, share of pieces on it.
_Line = tuple[float, float, float, FloatArray, float]


def _fit(response: FloatArray, pieces: Pieces, noise: FloatArray, voted: _Voted, middle: float) -> list[_Line | None]:
    """Fit lines to the pieces' own places near the voted ones.

    response (p, w): Of the filter, positive on the lines.
    middle: Column where they are predicted.
    """
    line, width = pieces.line, response.shape[1]
    expected = voted.first[line] + _along(pieces) * (voted.last - voted.first)[line]
    near = np.abs(np.arange(width) - expected[:, None]) <= _NEAR_PX / _STEP_PX
    column = np.argmax(np.where(near, response, -np.inf), axis=1)
    inner = (column > 0) & (column < width - 1)
    column = np.clip(column, 1, width - 2)
    before, here, after = (response[np.arange(column.size), column + k] for k in (-1, 0, 1))
    is_peak = inner & (here >= before) & (here >= after) & (here > _NOISE_TIMES * noise[line])
    is_peak &= voted.sign[line] != 0
    bend = np.where(is_peak, before - 2 * here + after, -1.0)
    offset = _STEP_PX * (column + 0.5 * (before - after) / np.minimum(bend, -1e-12) - middle)
    fits = _robust_lines(pieces.share[is_peak], offset[is_peak], line[is_peak], noise.size)
    first = np.searchsorted(line[is_peak], np.arange(noise.size + 1))
    found: list[_Line | None] = []
    for k, size in enumerate(np.bincount(line, minlength=noise.size).tolist()):
        own = slice(first[k], first[k + 1])
        kept = fits.weight[own] > 0
        hits = float(np.count_nonzero(kept)) / size
        if not fits.stands[k] or hits < _LEAST_SHARE or np.count_nonzero(kept) < _FEWEST_PIECES:
            found.append(None)
            continue
        scatter = float(fits.scatter_px[k])
        variance = scatter**2 * _growth(fits.miss_px[own][kept], scatter)
        covariance = np.diag([variance / fits.total[k] + _FLOOR_PX**2, variance / fits.square[k]])
        found.append((float(fits.offset_px[k]), float(fits.slope_px[k]), float(fits.centre[k]), covariance, hits))
    return found


class _Fits(NamedTuple):
    """Lines fitted to places with Tukey's weights.

    stands (n,): Whether enough places lie on each; else its numbers mean nothing.
    weight, miss_px (m,): Of the places.
    """

    stands: BoolArray
    total: FloatArray
    centre: FloatArray
    square: FloatArray
    offset_px: FloatArray
    slope_px: FloatArray
    scatter_px: FloatArray
    weight: FloatArray
    miss_px: FloatArray


def _robust_lines(share: FloatArray, offset_px: FloatArray, line: IntArray, count: int) -> _Fits:
    """Fit lines with Tukey's weights.

    Shapes: share, offset_px (m,).
    line (m,): Number of the line of each place, ascending.
    """
    weight, miss = np.ones(share.size), np.zeros(share.size)
    # Total weight, its middle, square of the arms, offset, slope, scatter.
    numbers, stands = np.zeros((6, count)), np.bincount(line, minlength=count) >= _FEWEST_PIECES
    open_ones = stands.copy()
    for _ in range(_ROUNDS):
        with np.errstate(invalid="ignore", divide="ignore"):
            total = np.asarray(np.bincount(line, weight, count), dtype=np.float64)
            centre = np.bincount(line, weight * share, count) / total
            arm = share - centre[line]
            square = np.asarray(np.bincount(line, weight * arm**2, count), dtype=np.float64)
            value = np.bincount(line, weight * offset_px, count) / total
            slope = np.bincount(line, weight * arm * offset_px, count) / square
            off = offset_px - value[line] - slope[line] * arm
            scatter = np.fmax(SIGMA_PER_MAD * _medians(np.abs(off), line, count), _FLOOR_PX)
            found = _TUKEY.weight(np.abs(off) / scatter[line])
            changed = np.zeros(count)
            np.maximum.at(changed, line, np.abs(found - weight))
        is_open = open_ones[line]
        numbers = np.where(open_ones, np.stack([total, centre, square, value, slope, scatter]), numbers)
        miss = np.where(is_open, off, miss)
        weight = np.where(is_open, found, weight)
        stands &= (square > 0) | ~open_ones
        stands &= (np.bincount(line[weight > 0], minlength=count) >= _FEWEST_PIECES) | ~open_ones
        open_ones &= stands & (changed >= _SETTLED)
        if not open_ones.any():
            break
    total, centre, square, value, slope, scatter = tuple(numbers)
    return _Fits(stands, total, centre, square, value, slope, scatter, weight, miss)


def _growth(miss_px: FloatArray, scatter_px: float) -> float:
    """Return by how much means of four neighbours scatter more than independent ones would; 1 at least.

    Pieces beside each other share errors of the panels' edges and of the background, which makes the line's error
    larger than their scatter alone would.
    """
    runs = miss_px.size // 4
    if runs < 3:
        return 2.0
    means = miss_px[: 4 * runs].reshape(runs, 4).mean(axis=1)
    return max(1.0, float(np.mean(means**2)) * 4 / scatter_px**2)


@dataclass(frozen=True, slots=True, eq=False)
class FittedPose:
    """The pose that fits the lines of a photo.

    cam_from_frame: The pose.
    lines: Those found near it; None where one is not seen.
    pieces (n,): In how many pieces the photo shows the place of each.
    covariance (6, 6): Of the steps of `RigidTransform.moved`, for corners off their places as the drawing says [rad,
        m].
    """

    cam_from_frame: RigidTransform
    lines: tuple[FoundLine | None, ...]
    pieces: IntArray
    covariance: FloatArray

    @property
    def log_odds(self) -> float:
        """Logarithm of the odds that lines are where they were found, against other things by chance."""
        hits = np.array([0.0 if one is None else one.hits for one in self.lines])
        each = hits * np.log(_SHOWN / _CHANCE) + (1 - hits) * np.log((1 - _SHOWN) / (1 - _CHANCE))
        return float(self.pieces @ each) / _ALIKE_PIECES

    def turned(self, frame_from_turned: RigidTransform) -> "FittedPose":
        """Return the same picture of a collector that is turned into itself: the lines keep their odds, not names."""
        return replace(self, cam_from_frame=self.cam_from_frame @ frame_from_turned)


def fit_pose(
    image: Float32Array,
    view: View,
    lattice: PanelLattice,
    noise_dn: float,
    reaches_px: tuple[float, ...] = (24.0, 12.0, 6.0),
) -> FittedPose | None:
    """Move a pose until the lines lie where it predicts them; None where too few are seen.

    reaches_px: How far beside their predictions lines are looked for, round by round [px].
    """
    pose, moved = view.cam_from_frame, None
    for reach in reaches_px:
        found, _ = find_lines(image, View(view.camera, pose), lattice, reach, noise_dn)
        moved = _moved(View(view.camera, pose), lattice, found)
        if moved is None:
            return None
        pose = moved.cam_from_frame
    if moved is None:
        return None
    lines, pieces = find_lines(image, View(view.camera, pose), lattice, reaches_px[-1], noise_dn)
    return FittedPose(pose, lines, pieces, moved.covariance)


class _Moved(NamedTuple):
    cam_from_frame: RigidTransform
    covariance: FloatArray


def _moved(view: View, lattice: PanelLattice, found: tuple[FoundLine | None, ...]) -> _Moved | None:
    """Return the pose at which found lines would lie on the predicted ones."""
    rows, values, sigmas = [], [], []
    for one in found:
        if one is None:
            continue
        share = np.array([0.25, 0.75])
        _, normals = normal_at(view, lattice, one.line, share)
        seen = view.camera.project_posed(lattice.along(one.line, share), view.cam_from_frame)
        pixel_m = float(np.median(view.cam_from_frame.apply(lattice.along(one.line, share))[:, 2]))
        mounting = lattice.mounting_sigma_m * view.camera.focal_x_px / pixel_m
        for k in range(2):
            offset, variance = one.at(float(share[k]))
            rows.append(normals[k] @ seen.d_pixel_d_pose[k])
            values.append(offset)
            sigmas.append(float(np.sqrt(variance + mounting**2)))
    if len(rows) < 2 * _FEWEST_PIECES:
        return None
    jacobian, value, sigma = np.array(rows), np.array(values), np.array(sigmas)
    weight: FloatArray = np.asarray(1 / sigma)
    step: FloatArray = np.zeros(6)
    scale = 1.0
    for _ in range(10):
        found_step = np.linalg.lstsq(jacobian * weight[:, None], value * weight, rcond=None)[0]
        step = np.asarray(found_step, dtype=np.float64)
        miss = (value - jacobian @ step) / sigma
        scale = max(robust_scale(miss), 1.0)
        weight = np.asarray(np.sqrt(_TUKEY.weight(np.abs(miss) / scale)) / sigma)
    if np.count_nonzero(weight) < 2 * _FEWEST_PIECES or not np.isfinite(step).all():
        return None
    scaled = jacobian * (weight > 0)[:, None] / sigma[:, None]
    return _Moved(view.cam_from_frame.moved(step), np.linalg.pinv(scaled.T @ scaled) * scale**2)
