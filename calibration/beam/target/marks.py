"""Find the four corners of a target by its dark marks: by templates of the marks, or as the darkest lumps there are.

The corner of a mark is where the straight lines through two of its edges meet, each a robust fit to the sub-pixel
crossings of the level half way between mark and target.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.adjust.robust_loss import Tukey
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, FloatArray, float_array, freeze

__all__ = ["CORNERS", "MarkTemplate", "TargetCorners", "dark_corners", "mark_corner", "template_corners"]

#: Order of the corners everywhere, as seen from the field.
CORNERS = ("upper left", "upper right", "lower right", "lower left")
# Sides of a mark at whose crossing each corner of the target lies: sign of x (right), sign of y (down).
_OUTER = {"upper left": (-1, -1), "upper right": (1, -1), "lower right": (1, 1), "lower left": (-1, 1)}
#: Longer side on which templates are searched; they are refined in the full picture.
_SEARCH_PX = 768
_SCALES = 1.06 ** np.arange(-12, 9)
_LEAST_CORRELATION = 0.6
#: Level that makes a pixel dark (Malan 2014, eq. 5.2): darkest plus a fifth of the lightest.
_DARK_SHARE = 0.2
#: Where marks are looked for, from the picture's sides (Malan 2014: 50 of 300 pixels).
_SEED = 1 / 6
_LEAST_CROSSINGS = 5
#: Rows of a mark this much wider than most are those of its level arm.
_ARM = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class MarkTemplate:
    """Picture of a mark and the point of it that is the target's corner.

    values_dn (h, w): The mark and a little of the target around it [DN].
    anchor_px (2,): The corner: column and row in the template [px].
    """

    values_dn: FloatArray
    anchor_px: FloatArray

    def __post_init__(self) -> None:
        values = float_array("template", self.values_dn, (None, None))
        if min(values.shape) < 8 or not np.ptp(values) > 0:
            raise InputError(f"template: a picture of a mark is needed, not {values.shape} pixels of one value")
        object.__setattr__(self, "values_dn", values)
        object.__setattr__(self, "anchor_px", float_array("anchor_px", self.anchor_px, (2,)))


@dataclass(frozen=True, slots=True, eq=False)
class TargetCorners:
    """Where the corners of a target are in a picture.

    pixels_px (4, 2): In the order of `CORNERS` [px].
    sigma_px: Uncertainty of a coordinate [px].
    quality (4,): Correlation with the template; contrast of a dark mark [DN].
    scale: Size of the marks in the picture over their size in the templates.
    """

    pixels_px: FloatArray
    sigma_px: float
    quality: FloatArray
    scale: float = 1.0


def mark_corner(window_dn: npt.ArrayLike, corner: str, *, outer: bool = True) -> tuple[FloatArray, float]:
    """Measure the corner of one dark mark.

    window_dn (h, w): The mark and a little of the target around it [DN].
    outer: The corner away from the target's middle (of an L, the outside of its bend); otherwise the one towards it
        (of a filled rectangle).
    position_px (2,): Column and row [px].
    sigma_px: Uncertainty of a coordinate, from the scatter of the edges about their lines [px].
    InputError: No such corner, or no picture.
    EstimationError: No dark mark, its edges are too short, or it is T-shaped and has no outer corner.
    """
    if corner not in _OUTER:
        raise InputError(f"corner: one of {', '.join(CORNERS)} is needed, not {corner!r}")
    window = float_array("window_dn", window_dn, (None, None))
    signs = _OUTER[corner] if outer else (-_OUTER[corner][0], -_OUTER[corner][1])
    smoothed = np.asarray(cv2.GaussianBlur(window, (0, 0), 0.7), dtype=np.float64)
    dark, bright = float(np.quantile(smoothed, 0.01)), float(np.median(smoothed))
    level = (dark + bright) / 2
    mark = _largest(smoothed < level)
    if mark.sum() < 20 or bright - dark < 1e-9:
        raise EstimationError(f"{corner} corner: no dark mark in a window of {window.shape[1]} x {window.shape[0]} px")
    if outer and (_juts_out(mark, signs[1]) or _juts_out(mark.T, signs[0])):
        raise EstimationError(
            f"{corner} corner: the mark is T-shaped, as where two targets share it: which point of it is the corner "
            "cannot be told from its outline"
        )
    across = _edge(smoothed, mark, level, signs[0])
    down = _edge(smoothed.T, mark.T, level, signs[1])
    # x = a + b y of the upright edge and y = c + d x of the level one.
    (a, b, sigma_x), (c, d, sigma_y) = across, down
    y = (c + d * a) / (1 - b * d)
    return freeze(np.array([a + b * y, y])), float(np.hypot(sigma_x, sigma_y) / np.sqrt(2))


def dark_corners(
    image_dn: npt.NDArray[np.generic],
    *,
    near_px: npt.ArrayLike | None = None,
    reach_px: float | None = None,
    outer: bool = False,
) -> TargetCorners:
    """Find the corners of a target by dark marks, one near each corner (Malan 2014, 5.6.3).

    Shapes: image_dn (h, w).
    near_px (4, 2): Roughly where the marks are, in the order of `CORNERS`; a sixth of the picture from its sides if
        absent [px].
    reach_px: Half the side of the window searched around each; a sixth of the picture's shorter side if absent
        [px].
    outer: Whether the outer corner of a mark (an L) is the target's corner, or the inner one (a filled rectangle).
    InputError: Not a grey picture.
    EstimationError: A mark is not found; which one.
    """
    if image_dn.ndim != 2:
        raise InputError(f"image: shape (height, width) is needed, not {image_dn.shape}; make colours grey first")
    values = np.asarray(image_dn, dtype=np.float64)
    height, width = values.shape
    seeds = np.array([[_SEED, _SEED], [1 - _SEED, _SEED], [1 - _SEED, 1 - _SEED], [_SEED, 1 - _SEED]])
    near = seeds * [width, height] if near_px is None else float_array("near_px", near_px, (4, 2))
    reach = round(_SEED * min(height, width)) if reach_px is None else round(float(reach_px))
    darkest, lightest = float(values.min()), float(values.max())
    threshold = darkest + _DARK_SHARE * lightest
    corners, sigmas, quality = [], [], []
    for name, seed in zip(CORNERS, near, strict=True):
        first = np.maximum(np.rint(seed).astype(int) - reach, 0)
        last = np.rint(seed).astype(int) + reach + 1
        window = values[first[1] : last[1], first[0] : last[0]]
        if min(window.shape) < 8 or not (window < threshold).any():
            raise EstimationError(f"{name} corner: nothing darker than {threshold:.0f} DN near {seed.round().tolist()}")
        place, sigma = mark_corner(window, name, outer=outer)
        corners.append(place + first)
        sigmas.append(sigma)
        quality.append(float(np.median(window) - window.min()))
    return TargetCorners(freeze(np.array(corners)), float(np.sqrt(np.mean(np.square(sigmas)))), np.array(quality))


def template_corners(
    image_dn: npt.NDArray[np.generic], templates: Sequence[MarkTemplate], *, near: TargetCorners | None = None
) -> TargetCorners:
    """Find the corners of a target by templates of its marks.

    image_dn (h, w): The camera's picture [DN].
    templates: Four, in the order of `CORNERS`, all of one scale, which need not be the picture's.
    near: What another picture of the same camera gave: the search over scales and places is then left out, unless
        it leads to nothing.
    InputError: Not a grey picture, or not four templates.
    EstimationError: A mark is not found: its correlation is too low, or the four do not form a quadrilateral.

    The scale, one for all four, and the places come from the largest normalised correlation in a smaller picture; an
    affine registration in the full picture (enhanced correlation, Evangelidis and Psarakis 2008) refines them.
    """
    if image_dn.ndim != 2:
        raise InputError(f"image: shape (height, width) is needed, not {image_dn.shape}; make colours grey first")
    if len(templates) != 4:
        raise InputError(f"templates: four are needed ({', '.join(CORNERS)}), not {len(templates)}")
    image = np.asarray(image_dn, dtype=np.float32)
    if near is not None:
        try:
            return _at(image, templates, near.scale, _middles(templates, near))
        except EstimationError:
            pass  # The camera was moved.
    scale, starts = _search(image, templates)
    return _at(image, templates, scale, starts)


# --- dark marks -----------------------------------------------------------------------------------------------------


def _largest(dark: BoolArray) -> BoolArray:
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8), connectivity=8)
    if count < 2:
        return np.zeros_like(dark)
    areas = np.where(np.arange(count) > 0, statistics[:, cv2.CC_STAT_AREA], 0).astype(np.float64)
    # What reaches the border of the window is the target's own edge or a beam behind it, if there is anything else.
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    areas[np.unique(border)] *= 1e-3
    return np.asarray(labels == int(np.argmax(areas)))


def _juts_out(mark: BoolArray, sign: int) -> bool:
    """Whether an upright bar goes on beyond a level arm, above it (-1) or below it (+1): a T that lies on its side.

    The level arm of an L begins where the upright one ends.
    """
    rows = mark[mark.any(axis=1)]
    widths = np.count_nonzero(rows if sign < 0 else rows[::-1], axis=1)
    bar = float(np.median(widths))
    wide = np.flatnonzero(widths > _ARM * bar)
    # A filled rectangle is as wide everywhere, and a line has no arm.
    if not wide.size or wide.size > 0.5 * widths.size:
        return False
    return bool(wide[0] > max(0.5 * bar, 3.0))


class _Line(NamedTuple):
    """The line x = offset + slope y, and the sigma of x [px]."""

    offset: float
    slope: float
    sigma: float


def _edge(values: FloatArray, mark: BoolArray, level: float, sign: int) -> _Line:
    """Fit a line through the mark's left (-1) or right (+1) edge."""
    if sign > 0:
        other = _edge(values[:, ::-1], mark[:, ::-1], level, -1)
        return _Line(values.shape[1] - 1 - other.offset, -other.slope, other.sigma)
    rows = np.flatnonzero(mark.any(axis=1))
    first = np.argmax(mark[rows], axis=1)
    rows, first = rows[first > 0], first[first > 0]
    if rows.size < _LEAST_CROSSINGS:
        raise EstimationError("the mark's edge is too short or touches the border of the window")
    beyond, inside = values[rows, first - 1], values[rows, first]
    x = first - (level - inside) / np.where(beyond - inside > 1e-9, beyond - inside, np.inf)
    return _line(rows.astype(np.float64), x)


def _line(y: FloatArray, x: FloatArray) -> _Line:
    """Fit x = a + b y to the outermost of the crossings: rows that cross another arm lie far inside."""
    outermost = float(np.quantile(x, 0.1))
    near = x < outermost + 0.25 * max(4.0, float(np.ptp(y)))
    y, x = y[near], x[near]
    middle = float(y.mean())
    rows = np.stack([np.ones_like(y), y - middle], axis=1)
    weights = np.ones_like(y)
    line, scatter = np.array([np.median(x), 0.0]), 1.0
    for _ in range(20):
        normal = (rows * weights[:, None]).T @ rows
        line = np.linalg.solve(normal + 1e-9 * np.eye(2), (rows * weights[:, None]).T @ x)
        residuals = x - rows @ line
        scatter = max(0.02, robust_scale(residuals))
        weights = Tukey(4.7).weight(residuals / scatter)
    # Neighbouring rows share the blur of some two pixels.
    sigma = scatter * np.sqrt(2 / max(float(weights.sum()), 1.0)) * 2
    return _Line(float(line[0] - line[1] * middle), float(line[1]), float(sigma))


# --- templates ------------------------------------------------------------------------------------------------------


def _middles(templates: Sequence[MarkTemplate], near: TargetCorners) -> list[FloatArray]:
    """Return the middle of each template in the picture, from where its anchor was."""
    halves = [np.array(template.values_dn.shape[::-1]) / 2 for template in templates]
    return [
        place + near.scale * (half - template.anchor_px)
        for place, half, template in zip(near.pixels_px, halves, templates, strict=True)
    ]


def _at(
    image: npt.NDArray[np.float32], templates: Sequence[MarkTemplate], scale: float, starts: Sequence[FloatArray]
) -> TargetCorners:
    """Refine all marks and refuse what is none."""
    corners, quality, sigmas = [], [], []
    for name, template, start in zip(CORNERS, templates, starts, strict=True):
        place, correlation, sigma = _refined(image, template, scale, start)
        if correlation < _LEAST_CORRELATION:
            raise EstimationError(
                f"{name} corner: the best place for its mark correlates by {correlation:.2f}, {_LEAST_CORRELATION} are "
                "needed; is the mark hidden, or is the template of another target?"
            )
        corners.append(place)
        quality.append(correlation)
        sigmas.append(sigma)
    found = np.array(corners)
    left, right = found[[0, 3], 0].max(), found[[1, 2], 0].min()
    upper, lower = found[[0, 1], 1].max(), found[[2, 3], 1].min()
    if not (left < right and upper < lower):
        raise EstimationError(f"the marks are found at {found.round().tolist()} px, which is no quadrilateral")
    return TargetCorners(freeze(found), float(np.sqrt(np.mean(np.square(sigmas)))), np.array(quality), scale)


def _search(image: npt.NDArray[np.float32], templates: Sequence[MarkTemplate]) -> tuple[float, list[FloatArray]]:
    """Return the scale that suits all templates and the middle of each in the full picture."""
    factor = min(1.0, _SEARCH_PX / max(image.shape))
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    best = (-np.inf, 1.0, [np.zeros(2)])
    for scale in _SCALES:
        total, places = 0.0, []
        for template in templates:
            size = [round(side * scale * factor) for side in template.values_dn.shape]
            if min(size) < 6 or size[0] >= small.shape[0] or size[1] >= small.shape[1]:
                break
            resized = cv2.resize(template.values_dn.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA)
            scores = cv2.matchTemplate(small, resized, cv2.TM_CCOEFF_NORMED)
            _, score, _, at = cv2.minMaxLoc(scores)
            total += score
            places.append((np.array(at) + np.array(size[::-1]) / 2) / factor)
        else:
            best = max(best, (total, float(scale), places), key=lambda each: each[0])
    if not np.isfinite(best[0]):
        raise EstimationError("templates: they are larger than the picture")
    return best[1], best[2]


class _Registered(NamedTuple):
    """The anchor of a template in the picture [px], the correlation there, and the sigma of the anchor [px]."""

    place_px: FloatArray
    correlation: float
    sigma_px: float


def _refined(image: npt.NDArray[np.float32], template: MarkTemplate, scale: float, middle: FloatArray) -> _Registered:
    """Register the picture to the template."""
    height, width = template.values_dn.shape
    # Rows of the warp take a pixel of the template to one of the picture.
    start = np.array([[scale, 0, middle[0] - scale * width / 2], [0, scale, middle[1] - scale * height / 2]])
    low = np.maximum(np.floor(start[:, 2] - 0.3 * scale * width).astype(int), 0)
    high = np.ceil(start[:, 2] + 1.3 * scale * np.array([width, height])).astype(int)
    window = np.ascontiguousarray(image[low[1] : high[1], low[0] : high[0]])
    warp = start.astype(np.float32)
    warp[:, 2] -= low
    wanted = template.values_dn.astype(np.float32)
    # Of the two pictures the finer one must be as blurred as the coarser.
    if scale > 1:
        window = np.asarray(cv2.GaussianBlur(window, (0, 0), 0.6 * scale), dtype=np.float32)
    else:
        wanted = np.asarray(cv2.GaussianBlur(wanted, (0, 0), 0.6 / scale), dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-7)
    try:
        correlation, found = cv2.findTransformECC(wanted, window, warp, cv2.MOTION_AFFINE, criteria, None, 3)  # type: ignore[call-overload]
    except cv2.error:
        return _Registered(np.array([np.nan, np.nan]), 0.0, np.inf)
    affine = np.asarray(found, dtype=np.float64)
    place = affine[:, :2] @ template.anchor_px + affine[:, 2] + low
    sigma = _registration_sigma(wanted, window, affine, template.anchor_px)
    return _Registered(place, float(correlation), sigma)


def _registration_sigma(
    wanted: npt.NDArray[np.float32], window: npt.NDArray[np.float32], affine: FloatArray, anchor: FloatArray
) -> float:
    """Propagate what the two pictures differ by into the place of the anchor."""
    moved = cv2.warpAffine(
        window,
        affine.astype(np.float32),
        wanted.shape[::-1],
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(np.float64)
    gain, offset = np.polyfit(moved.ravel(), wanted.ravel().astype(np.float64), 1)
    model = gain * moved + offset
    difference = wanted - model
    grad_y, grad_x = np.gradient(model)
    rows, columns = np.mgrid[: wanted.shape[0], : wanted.shape[1]]
    dx, dy = (columns - anchor[0]).ravel() / wanted.shape[1], (rows - anchor[1]).ravel() / wanted.shape[0]
    gx, gy = grad_x.ravel(), grad_y.ravel()
    jacobian = np.stack([gx, gx * dx, gx * dy, gy, gy * dx, gy * dy], axis=1)
    cofactor = np.linalg.inv(jacobian.T @ jacobian + 1e-9 * np.eye(6))
    # Shading differs over some ten pixels rather than from pixel to pixel: as many pixels count as one.
    variance = float(np.mean(difference**2)) * 100
    scale = np.sqrt(abs(float(np.linalg.det(affine[:, :2]))))
    return float(scale * np.sqrt(variance * (cofactor[0, 0] + cofactor[3, 3]) / 2))
