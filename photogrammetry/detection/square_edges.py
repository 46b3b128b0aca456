"""Corners of black squares from lines fitted to their sides: sub-pixel, with a covariance for each corner."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from heliogauge.adjust.small_fits import Descent, SmallFits, descend
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, IntArray, freeze
from photogrammetry.centers.disc_model import normal_distribution

#: Part of a side that is used; near the corners the other side's blur disturbs, and corners are rounded in print.
_FROM, _TO = 0.1, 0.9
#: Half width of the band of pixels round a side: at most this, and at most this share of a cell [px].
_MOST_BAND_PX, _BAND_CELLS = 4.0, 0.85
#: Passes: the detector's corners are off by a pixel or two, so the band is laid anew.
_PASSES = 3
#: Pixels of bands that are fitted together.
_PIXELS_AT_ONCE = 20_000
_N_PARAMETERS = 7
#: Undamped steps alone swing for ever on edges narrower than a pixel, by 0.3 px on photos of a wall.
_DESCENT = Descent(most_steps=20, first=1e-3, down=0.1, up=10.0, rise=1e-9, ridge=1e-9)
#: Step of a line that is the last (a corner is known to hundredths), and how far a line may be from its start [px].
_CLOSE_PX, _MOST_OFF_PX = 5e-4, 4.0
#: A pixel's own width, less a little for its square shape [px].
_LEAST_WIDTH_PX = 0.25
#: Width of an edge before it is measured: small markers do not separate it from a shift of the side.
_USUAL_WIDTH_PX, _WIDTH_SIGMA_PX = 0.6, 0.3
#: Below this many pixels for a cell, the border's inner edge is seen together with its outer one.
_LEAST_CELL_PX = 1.5
#: Sections of a side whose own offsets show how straight it is.
_SECTIONS = 6
#: Variance of a pixel's own width [px^2].
_PIXEL_VARIANCE = 1 / 12
#: Error of whole sides as a multiple of what their sections scatter beyond independent pixels.
_WHOLE_SIDES = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class SquareCorners:
    """The corners of one black square.

    corners_px (4, 2): In the order of the start values [px].
    covariance_px2 (4, 2, 2): Covariance of each [px^2].
    straightness_px: Rms offset of sections of the sides from their lines [px].
    contrast_dn: Paper minus ink, the least of the four sides [DN].
    blur_px: Width of the edges as the standard deviation of a Gaussian, without the pixel's own; the median of the
        sides [px].
    section_excess: Variance of the sections' offsets over what independent pixels would give; 1 for ideal edges.
    """

    corners_px: FloatArray
    covariance_px2: FloatArray
    straightness_px: float
    contrast_dn: float
    blur_px: float
    section_excess: float


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """Offsets of a line from the start's, at its first and second corner, outwards positive.

    edge (5,): Width [px], ink and step with their slopes along the side [DN].
    """

    offsets_px: FloatArray
    edge: FloatArray
    covariance_px2: FloatArray
    section_offsets_px: FloatArray
    contrast_dn: float
    width_px: float
    excess: float


@dataclass(frozen=True, slots=True, eq=False)
class _Band:
    """Pixels near one side.

    along: Position along it (0 to 1).
    outwards_px: Distance outwards [px].
    values_dn: Grey values [DN].
    border_px, white: What follows on the black border: the border's width there [px], and how white it is.
    inside_dn, outside_dn: Levels of ink and paper [DN].
    """

    along: FloatArray
    outwards_px: FloatArray
    values_dn: FloatArray
    border_px: FloatArray
    white: FloatArray
    inside_dn: float
    outside_dn: float


def square_corners(
    window_dn: npt.NDArray[np.float64], corners_px: npt.ArrayLike, white: npt.NDArray[np.bool_]
) -> SquareCorners:
    """Measure the corners of a black square on light ground.

    window_dn (h, w): Grey values [DN].
    corners_px (4, 2): Corners to two pixels or so, in order round the square, in the window's pixels.
    white (cells, cells): Which cells are white, the black border's included, in the order of the corners: cells of
        the second row that are white make the border narrow there.
    EstimationError: A side has no clear edge, or too few pixels.

    Each side: grey values of the pixels near it, between a tenth and nine tenths of its length, are fitted by a
    blurred step, ground and step running linearly along the side, and by the step back where white cells follow on
    the black border. A line follows from some hundred pixels, so that a corner is known to a few hundredths of a
    pixel, where a corner operator sees a dozen pixels that the print rounds.
    """
    found = corners_of_squares([window_dn], [np.asarray(corners_px)], [white])[0]
    if isinstance(found, EstimationError):
        raise found
    return found


def corners_of_squares(
    windows_dn: Sequence[FloatArray], corners_px: Sequence[FloatArray], white: Sequence[BoolArray]
) -> tuple[SquareCorners | EstimationError, ...]:
    """Measure the corners of many squares, the sides of all of them at once: the same numbers as one by one.

    windows_dn, corners_px, white: As `square_corners` takes them, of each square.
    Returns: One for each square; why there are no corners otherwise.
    """
    corners = [np.array(one, dtype=np.float64) for one in corners_px]
    found: list[SquareCorners | EstimationError | None] = [None] * len(corners)
    sides: dict[int, list[_Side]] = {}
    active = list(range(len(corners)))
    for last in (False,) * (_PASSES - 1) + (True,):
        bands: dict[int, list[_Band]] = {}
        for k in active:
            try:
                # Turned so that the side runs along the first row, from its first cell to its last.
                turned = [np.rot90(white[k], side)[1] for side in range(4)]
                bands[k] = [_band_of_side(windows_dn[k], corners[k], side, turned[side]) for side in range(4)]
            except EstimationError as error:
                found[k] = error
        active = []
        for group in _fitted_together(bands):
            fits = _fit_sides(
                [one for k in group for one in bands[k]], [one for k in group for one in sides.get(k, [])]
            )
            for first, k in enumerate(group):
                try:
                    sides[k] = [_side(*fits[4 * first + side], bands[k][side]) for side in range(4)]
                    moved, derivatives = _intersections(corners[k], sides[k])
                except EstimationError as error:
                    found[k] = error
                    continue
                step, corners[k] = np.abs(moved - corners[k]).max(), moved
                if last or step < 1e-3:
                    found[k] = _measured(moved, derivatives, sides[k])
                else:
                    active.append(k)
    return tuple(one for one in found if one is not None)


def _fitted_together(bands: dict[int, list[_Band]]) -> Iterator[list[int]]:
    """Yield squares of nearly one size, as many as stay in the caches: the longest band is the length of all."""
    longest = {k: max(one.along.size for one in bands[k]) for k in bands}
    group: list[int] = []
    for k in sorted(longest, key=longest.__getitem__):
        if group and 4 * (len(group) + 1) * longest[k] > _PIXELS_AT_ONCE:
            yield group
            group = []
        group.append(k)
    if group:
        yield group


def _measured(corners: FloatArray, derivatives: list[FloatArray], sides: list[_Side]) -> SquareCorners:
    """Return the corners with their covariances from those of the sides, and what the sides say of the square."""
    covariances = []
    for k in range(4):
        before, after = sides[k - 1].covariance_px2, sides[k].covariance_px2
        one = derivatives[k][:, :2] @ before @ derivatives[k][:, :2].T
        one = one + derivatives[k][:, 2:] @ after @ derivatives[k][:, 2:].T
        covariances.append(0.5 * (one + one.T))
    sections = np.concatenate([side.section_offsets_px for side in sides])
    width = float(np.median([side.width_px for side in sides]))
    return SquareCorners(
        freeze(corners),
        freeze(np.array(covariances)),
        float(np.sqrt(np.mean(sections**2))),
        min(side.contrast_dn for side in sides),
        float(np.sqrt(max(width**2 - _PIXEL_VARIANCE, 0.0))),
        float(np.mean([side.excess for side in sides])),
    )


def with_correlated_errors(squares: Sequence[SquareCorners]) -> tuple[SquareCorners, ...]:
    """Enlarge the covariances of a photo's squares by what neighbouring pixels have in common.

    squares: All squares of one photo, as `square_corners` returns them.

    `square_corners` takes the errors of pixels for independent. Demosaicing, sharpening and JPEG make neighbours err
    alike, and print and paper are not straight: sections of the sides scatter 1.5 times as much as independent pixels
    would make them. The median of that excess over the photo's squares (one square gives it to a third only)
    multiplies the covariance. What bends or shifts a side as a whole does not show as scatter of its sections; it is
    taken to be twice their excess, and alike for all corners. On the 54 photos of ``scene_reconstruction`` residuals
    of the network over these sigmas are 1.0 for small, large, near and tilted markers alike; with independent pixels
    they are 3.0 for the best and 1.1 for the worst corners. On drawn markers the excess is 1 and nothing is added.
    """
    if not squares:
        return ()
    excess = max(float(np.median([square.section_excess for square in squares])), 1.0)
    sections = float(np.median([square.straightness_px**2 for square in squares])) * _SECTIONS / (_SECTIONS - 2)
    unseen = _WHOLE_SIDES**2 * sections * (1 - 1 / excess)
    return tuple(
        replace(square, covariance_px2=freeze(excess * square.covariance_px2 + unseen * np.eye(2)))
        for square in squares
    )


def _band_of_side(window_dn: FloatArray, corners: FloatArray, k: int, behind: npt.NDArray[np.bool_]) -> _Band:
    """Return the pixels near the side from corner k to the next."""
    cells = len(behind)
    first, second = corners[k], corners[(k + 1) % 4]
    along = second - first
    length = float(np.hypot(*along))
    if length < _LEAST_CELL_PX * cells:
        raise EstimationError(
            f"a side of {length:.1f} px is too short for {cells} cells; {_LEAST_CELL_PX:g} px for each are needed"
        )
    along = along / length
    outward = np.array([along[1], -along[0]])
    if (corners.mean(axis=0) - first) @ outward > 0:
        outward = -outward
    # Inside, the band ends within the black border; a tilted square's border is narrower than its side suggests.
    ends = [abs((c - first) @ outward) / cells for c in (corners[(k + 3) % 4], corners[(k + 2) % 4])]
    border = min(length / cells, *ends)
    band = min(_MOST_BAND_PX, max(_BAND_CELLS * border, 1.0)), min(_MOST_BAND_PX, max(border, 2.0))
    t, d, values = _near_side(window_dn, first, along / length, outward, band)
    within, beyond = values[d < -0.3 * band[0]], values[d > 0.3 * band[1]]
    if len(values) < 3 * _N_PARAMETERS or min(len(within), len(beyond)) < _N_PARAMETERS:
        raise EstimationError(f"{len(values)} pixels show a side; {3 * _N_PARAMETERS} are needed")
    inside, outside = float(np.median(within)), float(np.median(beyond))
    if outside - inside <= 0:
        raise EstimationError("a side of the square is not darker inside than outside")
    white = _white_behind(t * length, behind, length)
    return _Band(t, d, values, ends[0] + t * (ends[1] - ends[0]), white, inside, outside)


def _fit_sides(bands: list[_Band], before: list[_Side]) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Fit the lines of all sides: parameters (7,), derivatives (7, k) and residuals (k,) of each.

    before: The same sides in the pass before: the corners have moved to their lines, and the edges are as wide and
        high as they were. Empty in the first pass.
    """
    counts = [one.along.size for one in bands]

    def together(name: str) -> FloatArray:
        padded = np.zeros((len(bands), max(counts)))
        for row, one in enumerate(bands):
            padded[row, : counts[row]] = getattr(one, name)
        return padded

    t, d, values, border, white = map(together, ("along", "outwards_px", "values_dn", "border_px", "white"))
    used = np.arange(max(counts)) < np.array(counts)[:, None]
    start = np.zeros((len(bands), _N_PARAMETERS))
    for row, one in enumerate(bands):
        edge = [_USUAL_WIDTH_PX, one.inside_dn, 0.0, one.outside_dn - one.inside_dn, 0.0]
        start[row, 2:] = before[row].edge if before else edge
    mean = np.zeros_like(start)
    mean[:, 2] = _USUAL_WIDTH_PX
    fits = SmallFits(
        start, *_step_model(start, t, d, values, border, white), used.astype(np.float64), mean, np.zeros_like(start),
        np.zeros(len(bands), dtype=np.bool_),
    )  # fmt: skip

    def variances() -> FloatArray:
        squares = (fits.roots * fits.residuals**2).sum(axis=1)
        return np.asarray(squares / (np.array(counts) - _N_PARAMETERS))

    # The width's own knowledge weighs by the noise, which the residuals show once the line is near.
    for _ in range(1 if before else 2):
        fits.prior_weights[:, 2] = variances() / _WIDTH_SIGMA_PX**2
        descend(
            fits,
            np.arange(len(bands)),
            lambda rows, p: _step_model(p, t[rows], d[rows], values[rows], border[rows], white[rows]),
            lambda step: np.abs(step[:, :2]).max(axis=1) < _CLOSE_PX,
            _DESCENT,
            _limit_width,
        )
    return [
        (fits.parameters[row], fits.jacobian[row, :, :count], fits.residuals[row, :count])
        for row, count in enumerate(counts)
    ]


def _limit_width(rows: IntArray, trial: FloatArray) -> npt.NDArray[np.bool_]:
    trial[:, 2] = np.clip(trial[:, 2], _LEAST_WIDTH_PX, _MOST_BAND_PX)
    return np.asarray(np.abs(trial[:, :2]).max(axis=1) < _MOST_OFF_PX)


def _side(p: FloatArray, jacobian: FloatArray, residuals: FloatArray, band: _Band) -> _Side:
    """Return a fitted side with its covariance, and how straight it is."""
    if np.abs(p[:2]).max() > _MOST_OFF_PX or p[5] <= 0 or not np.isfinite(p).all():
        raise EstimationError("a side of the square lies elsewhere: no clear edge")
    normal = jacobian @ jacobian.T
    variance = float(residuals @ residuals) / (residuals.size - _N_PARAMETERS)
    normal[2, 2] += variance / _WIDTH_SIGMA_PX**2
    covariance = np.asarray(variance * np.linalg.pinv(normal), dtype=np.float64)
    slope = jacobian[0] + jacobian[1]
    section = np.minimum(((band.along - _FROM) / (_TO - _FROM) * _SECTIONS).astype(np.intp), _SECTIONS - 1)
    weights = np.bincount(section, slope * slope, _SECTIONS)
    offsets = np.bincount(section, slope * residuals, _SECTIONS) / np.maximum(weights, 1e-9)
    # Two of the sections' degrees of freedom went into the line.
    excess = float(np.sum(offsets**2 * weights)) / (variance * (_SECTIONS - 2))
    return _Side(p[:2], p[2:], covariance[:2, :2], offsets, float(p[5] + 0.5 * p[6]), float(p[2]), excess)


def _near_side(
    window_dn: FloatArray, first: FloatArray, along_per_px: FloatArray, outward: FloatArray, band: tuple[float, float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position along the side (0 to 1), distance outwards [px] and grey value [DN] of the pixels in a band."""
    x = np.arange(window_dn.shape[1]) - first[0]
    y = (np.arange(window_dn.shape[0]) - first[1])[:, None]
    t = along_per_px[0] * x + along_per_px[1] * y
    d = outward[0] * x + outward[1] * y
    near = (t > _FROM) & (t < _TO) & (d > -band[0]) & (d < band[1])
    return t[near], d[near], np.asarray(window_dn[near], dtype=np.float64)


def _white_behind(along_px: FloatArray, behind: npt.NDArray[np.bool_], length: float) -> FloatArray:
    """Share of white behind the border at places along a side, blurred as edges usually are."""
    share = np.zeros_like(along_px)
    cell = length / len(behind)
    for j in np.flatnonzero(behind).tolist():
        share += normal_distribution((along_px - j * cell) / _USUAL_WIDTH_PX)[0]
        share -= normal_distribution((along_px - (j + 1) * cell) / _USUAL_WIDTH_PX)[0]
    return share


def _step_model(
    p: FloatArray, t: FloatArray, d: FloatArray, values: FloatArray, border: FloatArray, white: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return residuals (m, k) and derivatives of the model (m, 7, k) of m sides; the arguments are those of `_Band`."""
    first, second, width, ink, ink_slope, step, step_slope = p.T[..., None]
    z = (d - (1 - t) * first - t * second) / width
    front, bell = normal_distribution(z)
    # The inner edge moves with the outer one, by one border's width inwards.
    inner = z + border / width
    rear, rear_bell = normal_distribution(-inner)
    share = front + white * rear
    height = step + step_slope * t
    residuals = values - (ink + ink_slope * t + height * share)
    by_z = height * (bell - white * rear_bell) / width
    by_width = height * (bell * z - white * rear_bell * inner) / width
    jacobian = np.stack([-by_z * (1 - t), -by_z * t, -by_width, np.ones_like(t), t, share, share * t], axis=1)
    return residuals, jacobian


def _intersections(corners: FloatArray, sides: list[_Side]) -> tuple[FloatArray, list[FloatArray]]:
    """Corners where neighbouring lines meet, and their derivatives by the two lines' offsets, shape (2, 4) each."""
    normals, starts, ends = [], [], []
    for k in range(4):
        first, second = corners[k], corners[(k + 1) % 4]
        along = (second - first) / np.hypot(*(second - first))
        outward = np.array([along[1], -along[0]])
        if (corners.mean(axis=0) - first) @ outward > 0:
            outward = -outward
        normals.append(outward)
        starts.append(first + outward * sides[k].offsets_px[0])
        ends.append(second + outward * sides[k].offsets_px[1])
    found, derivatives = [], []
    for k in range(4):
        lines = []
        for j in (k - 1, k):
            direction = ends[j] - starts[j]
            lines.append((np.array([direction[1], -direction[0]]) / np.hypot(*direction), starts[j]))
        matrix = np.array([line[0] for line in lines])
        if abs(np.linalg.det(matrix)) < 0.05:
            raise EstimationError("two sides of the square are nearly parallel: no corner")
        inverse = np.linalg.inv(matrix)
        found.append(inverse @ np.array([normal @ point for normal, point in lines]))
        derivative = np.zeros((2, 4))
        for column, j in enumerate((k - 1, k)):
            # The line moves along its normal by the offsets' values at this corner: its end before, its start after.
            direction = ends[j] - starts[j]
            at = float((found[-1] - starts[j]) @ direction / (direction @ direction))
            sign = float(np.sign(matrix[column] @ normals[j]))
            derivative[:, 2 * column : 2 * column + 2] = sign * np.outer(inverse[:, column], [1 - at, at])
        derivatives.append(derivative)
    return np.array(found), derivatives
