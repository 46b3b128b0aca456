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
from heliogauge.adjust.robust_scale import robust_scale
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


class Profiles(NamedTuple):
    """Brightness across one line at its pieces.

    values (k, m): Along the normal, `_STEP_PX` apart, the middle where the line is predicted [DN].
    share (k,): Where along the line each piece is, 0 at its first corner to 1 at its last.
    """

    values: FloatArray
    share: FloatArray


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
    view: View, lattice: PanelLattice, lines: Sequence[PanelLine], share: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the image points of k lines and the unit normals to their images there, shape (k, n, 2); NaN where unseen.

    share (n,): Places along each line.
    """
    step, count = 1e-3, share.size
    places = np.concatenate([share, share - step, share + step])
    points = np.stack([lattice.along(line, places) for line in lines])
    pixels = view.camera.project(view.cam_from_frame.apply(points))
    along = pixels[:, 2 * count :] - pixels[:, count : 2 * count]
    with np.errstate(invalid="ignore", divide="ignore"):
        along = along / np.linalg.norm(along, axis=2, keepdims=True)
    return pixels[:, :count], np.stack([-along[..., 1], along[..., 0]], axis=2)


def normal_at(view: View, lattice: PanelLattice, line: PanelLine, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the same of one line, shape (n, 2) each."""
    pixels, normals = normals_at(view, lattice, [line], share)
    return pixels[0], normals[0]


def line_profiles(
    image: AnyImage, view: View, lattice: PanelLattice, line: PanelLine, course_px: FloatArray, reach_px: float
) -> Profiles | None:
    """Read the brightness across a line; None where the photo shows less of it than a few pieces.

    course_px (3, 2): Image of its first corner, its middle and its last corner [px].
    reach_px: How far to both sides [px].
    """
    if not np.isfinite(course_px).all():
        return None
    length = float(np.linalg.norm(np.diff(course_px, axis=0), axis=1).sum())
    margin = _END_PX / length + _END_M / lattice.length_m[line]
    pieces = int((1 - 2 * margin) * length / _PIECE_PX) if length > 0 else 0
    if pieces < _FEWEST_PIECES:
        return None
    each = int(_PIECE_PX)
    share = margin + (1 - 2 * margin) * (np.arange(pieces * each) + 0.5) / (pieces * each)
    places, normals = normal_at(view, lattice, line, share)
    across = np.arange(-reach_px, reach_px + _STEP_PX / 2, _STEP_PX)
    maps = (places[:, None] + across[:, None] * normals[:, None]).astype(np.float32)
    height, width = image.shape[:2]
    inside = ((maps >= 1) & (maps <= (width - 2, height - 2))).all(axis=(1, 2)).reshape(pieces, each).all(axis=1)
    middles = share.reshape(pieces, each).mean(axis=1)
    inside &= ~_is_behind_receiver(lattice, lattice.along(line, middles), view.eye_m)
    if np.count_nonzero(inside) < _FEWEST_PIECES:
        return None
    read = cv2.remap(image, maps, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    values = np.asarray(read, dtype=np.float64).reshape(pieces, each, across.size).mean(axis=1)
    return Profiles(values[inside], middles[inside])


def _is_behind_receiver(lattice: PanelLattice, points_m: FloatArray, eye_m: FloatArray) -> BoolArray:
    """Return which points the receiver hides, or shows through its glass; all around it a little more."""
    eyes = np.broadcast_to(eye_m, points_m.shape)
    beside = beside_receiver_m(points_m, eyes, lattice.collector, lattice.receiver)
    return np.asarray(beside < _RECEIVER_OFF_M)


def find_line(profiles: Profiles, line: PanelLine, noise_dn: float) -> FoundLine | None:
    """Find a line in its profiles; None where they do not show it, or two that it may be.

    noise_dn: Of a pixel [DN].
    """
    kernel = _kernel(is_rim=line.is_rim)
    margin = kernel.size // 2
    windows = np.lib.stride_tricks.sliding_window_view(profiles.values, kernel.size, axis=1)
    response = np.asarray(windows @ kernel[::-1], dtype=np.float64)
    noise = noise_dn * float(np.sqrt((kernel**2).sum() * _STEP_PX)) / np.sqrt(_PIECE_PX)
    found = [_vote(sign * response, profiles.share, noise) for sign in (1.0, -1.0)]
    signed = max((one for one in found if one is not None), key=lambda one: one.total, default=None)
    if signed is None:
        return None
    sign = 1.0 if signed is found[0] else -1.0
    middle = (profiles.values.shape[1] - 1) / 2 - margin
    fitted = _fit(sign * response, profiles.share, noise, signed, middle, line)
    if fitted is None or line.is_rim:
        return fitted
    moved = _moved_by_step_px(profiles, fitted, sign * response, margin)
    return replace(fitted, covariance_px2=fitted.covariance_px2 + np.diag([moved**2, 0.0]))


def _moved_by_step_px(profiles: Profiles, found: FoundLine, response: FloatArray, margin: int) -> float:
    """Return by how much different brightness on both sides of a gap may have moved it [px].

    response (k, m - 2 margin): Of the filter, positive at the gap.

    A gap of area A (depth times width) with a step S in it, both blurred to the width w, has its strongest response
    ``S w^2 / (3 A)`` beside its middle; the response there is ``A / (sqrt(2 pi) w)`` for a filter of that width.
    """
    offset = found.offset_px + found.slope_px * (profiles.share - found.middle)
    column = np.rint((profiles.values.shape[1] - 1) / 2 + offset / _STEP_PX).astype(np.intp)
    rows, away = np.arange(column.size)[:, None], np.arange(margin // 2, margin + 1)
    inside = (column >= margin) & (column < profiles.values.shape[1] - margin)
    if not inside.any():
        return 0.0
    rows, column = rows[inside], column[inside, None]
    step = profiles.values[rows, column + away].mean(axis=1) - profiles.values[rows, column - away].mean(axis=1)
    height = float(np.median(response[rows[:, 0], column[:, 0] - margin]))
    return _FILTER_PX * abs(float(np.median(step))) / (3 * float(np.sqrt(2 * np.pi)) * max(height, 1e-9))


def photo_noise(image: AnyImage) -> float:
    """Return the noise of a photo's pixels from third differences, which shading leaves out [DN]."""
    some = np.asarray(image[:: max(1, image.shape[0] // 128)], dtype=np.float64)
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

    wanted: Which ones; None: all.
    lines, pieces: Each line as found; and in how many pieces the photo shows the place where it would be.
    """
    found, pieces = [], []
    lines = lattice.lines if wanted is None else wanted
    courses, _ = normals_at(view, lattice, lines, np.array([0.0, 0.5, 1.0]))
    for line, course in zip(lines, courses, strict=True):
        profiles = line_profiles(image, view, lattice, line, course, reach_px)
        pieces.append(0 if profiles is None else profiles.share.size)
        found.append(None if profiles is None else find_line(profiles, line, noise_dn))
    return tuple(found), np.array(pieces, dtype=np.intp)


class _Voted(NamedTuple):
    """The straight line with the largest sum of responses: columns at the first and the last piece, and the sum."""

    first: float
    last: float
    total: float


def _kernel(*, is_rim: bool) -> FloatArray:
    width = _FILTER_PX / _STEP_PX
    place = np.arange(-np.ceil(4 * width), np.ceil(4 * width) + 1)
    bell = np.exp(-0.5 * (place / width) ** 2)
    bell /= bell.sum()
    # A rim is a step: the first derivative. A gap is a line: the second one, which a slope beside it does not move.
    kernel = place / width * bell if is_rim else (place**2 / width**2 - 1) * bell
    return np.asarray(kernel - kernel.mean())


def _vote(response: FloatArray, share: FloatArray, noise: float) -> _Voted | None:
    count, width = response.shape
    usual = float(np.median(response.max(axis=1)))
    if usual <= 0:
        return None
    cut = np.clip(response, 0.0, max(usual, noise)).astype(np.float32)
    place = np.linspace(0.0, 1.0, count) if share[-1] == share[0] else (share - share[0]) / (share[-1] - share[0])
    # A line may be turned against the predicted one by half the window between its ends.
    turns = np.arange(-(width // 4), width // 4 + 1)
    start = np.arange(width)
    columns = start + np.rint(turns[:, None, None] * (place[:, None] - 0.5)).astype(np.intp)
    valid = (columns >= 0) & (columns < width)
    sums = np.where(valid, cut[np.arange(count)[:, None], np.clip(columns, 0, width - 1)], 0.0).sum(axis=1)
    turn, middle = np.unravel_index(int(np.argmax(sums)), sums.shape)
    best = float(sums[turn, middle])
    apart = np.abs(start[None, :] - middle) * np.ones((turns.size, 1)) > 4 * _FILTER_PX / _STEP_PX
    # Lines that cross the best one have its responses in some pieces; only such beside it compete.
    beside = apart & (np.abs(turns - turns[turn]) <= 2)[:, None]
    if beside.any() and float(sums[beside].max()) > _SECOND_SHARE * best:
        return None
    half = turns[turn] / 2
    return _Voted(float(middle - half), float(middle + half), best)


def _fit(
    response: FloatArray, share: FloatArray, noise: float, voted: _Voted, middle: float, line: PanelLine
) -> FoundLine | None:
    count, width = response.shape
    place = (share - share[0]) / max(float(share[-1] - share[0]), 1e-9)
    expected = voted.first + place * (voted.last - voted.first)
    near = np.abs(np.arange(width) - expected[:, None]) <= _NEAR_PX / _STEP_PX
    column = np.argmax(np.where(near, response, -np.inf), axis=1)
    inner = (column > 0) & (column < width - 1)
    column = np.clip(column, 1, width - 2)
    before, here, after = (response[np.arange(count), column + k] for k in (-1, 0, 1))
    is_peak = inner & (here >= before) & (here >= after) & (here > _NOISE_TIMES * noise)
    bend = np.where(is_peak, before - 2 * here + after, -1.0)
    offset = _STEP_PX * (column + 0.5 * (before - after) / np.minimum(bend, -1e-12) - middle)
    if np.count_nonzero(is_peak) < _FEWEST_PIECES:
        return None
    fitted = _robust_line(share[is_peak], offset[is_peak])
    if fitted is None:
        return None
    value, covariance, centre, kept = fitted
    hits = float(np.count_nonzero(kept)) / count
    if hits < _LEAST_SHARE or np.count_nonzero(kept) < _FEWEST_PIECES:
        return None
    return FoundLine(line, float(value[0]), float(value[1]), centre, covariance, hits)


def _robust_line(share: FloatArray, offset_px: FloatArray) -> tuple[FloatArray, FloatArray, float, BoolArray] | None:
    """Fit a line with Tukey's weights: values, covariance, the middle of its places, and which count."""
    weight: FloatArray = np.ones(share.size)
    for _ in range(_ROUNDS):
        total = float(weight.sum())
        centre = float(weight @ share) / total
        arm = share - centre
        square = float(weight @ arm**2)
        if square <= 0:
            return None
        value = np.array([float(weight @ offset_px) / total, float(weight @ (arm * offset_px)) / square])
        miss = offset_px - value[0] - value[1] * arm
        scatter = max(robust_scale(miss), _FLOOR_PX)
        before, weight = weight, _TUKEY.weight(np.abs(miss) / scatter)
        if np.count_nonzero(weight) < _FEWEST_PIECES:
            return None
        if np.abs(weight - before).max() < _SETTLED:
            break
    kept = np.asarray(weight > 0)
    variance = scatter**2 * _growth(miss[kept], scatter)
    return value, np.diag([variance / total + _FLOOR_PX**2, variance / square]), centre, kept


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
