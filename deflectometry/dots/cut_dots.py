"""Dots that an edge of the mirror cuts: their middle from what is seen of them."""

from dataclasses import replace

import cv2
import numpy as np

from deflectometry.dots.found_dots import FoundDots
from deflectometry.dots.rim import BLURS, Rim
from heliogauge.validate import FloatArray
from photogrammetry.centers import Ellipse, TargetCenter

#: Samples along each side of a pixel: the area of what is seen of a dot of 4 px is then right to a per cent.
_FINE = 4
#: Most steps of the fit, and the step that is its last [px]: the next would be a tenth, far below any sigma. Of a dot
#: whose steps do not end the place is not known.
_STEPS, _ENOUGH_PX = 12, 5e-3
#: Share of the dots' distance from where a dot is expected beyond which what is seen there is another one.
_FARTHEST = 0.35
#: Sigmas of the contrast that make a dot, as of any target, and shares of the usual contrast that it may have.
_STANDS_OUT, _LEAST_CONTRAST, _MOST_CONTRAST = 8.0, 0.5, 1.5
#: Step for derivatives [px].
_STEP_PX = 0.05


def fit_cut_dot(rim: Rim, start: Ellipse, contrast_dn: float, dots: FoundDots) -> TargetCenter | None:
    """Return the middle of a dot of which the mirror shows more than half; None where there is none.

    start: Where it is expected, as large as the dots around it.
    contrast_dn: Usual difference of dot and ground [DN].
    dots: The others, which say how the sizes of dots scatter.

    What is seen is the dot as large as its neighbours, cut along the outline and then blurred. Middle and contrast are
    fitted; the residuals, the outline and the size, which may be off, make the covariance.
    """
    window = _Window.around(rim, start, dots.blur_px)
    if window is None:
        return None
    place, contrast, farthest_px = start.center_px, -window.sign * contrast_dn, _FARTHEST * dots.spacing_px
    for _ in range(_STEPS):
        model, jacobian = window.model(place, start.shape_px2, 0.0)
        normal = np.column_stack([contrast * jacobian, model])
        residual = window.values_dn - contrast * model
        step = np.linalg.lstsq(normal, residual, rcond=None)[0]
        place, contrast = place + np.clip(step[:2], -1.0, 1.0), contrast + step[2]
        if np.linalg.norm(place - start.center_px) > farthest_px:
            return None
        if np.abs(step[:2]).max() < _ENOUGH_PX:
            break
    else:
        return None
    if not rim.holds(place):
        return None
    model, jacobian = window.model(place, start.shape_px2, 0.0)
    normal = np.column_stack([contrast * jacobian, model])
    residual = window.values_dn - contrast * model
    free = max(len(residual) - 3, 1)
    try:
        inverse = np.linalg.inv(normal.T @ normal)
    except np.linalg.LinAlgError:
        return None
    noise = float(residual @ residual) / free
    if not abs(contrast) > _STANDS_OUT * np.sqrt(noise * inverse[2, 2]):
        return None
    if not _LEAST_CONTRAST < abs(contrast) / contrast_dn < _MOST_CONTRAST:
        return None
    covariance = noise * inverse[:2, :2]
    # At the edge dots are bent otherwise than their neighbours: each way in which the shapes of dots scatter counts.
    scatter = np.std(dots.outlines_px2, axis=0)
    ways = [scatter * (np.arange(4) == k).reshape(2, 2) for k in (0, 3)] + [scatter * (1 - np.eye(2))]
    for shape, moved in [(start.shape_px2 + one, 0.0) for one in ways] + [(start.shape_px2, rim.sigma_px)]:
        other, _ = window.model(place, shape, moved)
        beside = 0.0 if not moved else window.step_off(moved)
        off = inverse @ normal.T @ (contrast * (other - model) + beside)
        covariance = covariance + np.outer(off[:2], off[:2])
    return TargetCenter(
        replace(start, center_px=place), covariance, float(contrast), 0.0, dots.blur_px, float(np.sqrt(noise)), free
    )


class _Window:
    """The pixels around a dot, what the photo has there beside its ground, and what a dot would make of them."""

    def __init__(
        self, rim: Rim, start: Ellipse, blur_px: float, corner: tuple[int, int], size: tuple[int, int]
    ) -> None:
        (left, top), (width, height) = corner, size
        part = slice(top, top + height), slice(left, left + width)
        self.corner, self.size, self.blur_px, self.edge_blur_px = corner, size, blur_px, rim.blur_px
        self.inside_px, self.step_dn = rim.inside_px[part], rim.step_dn[part]
        x, y = np.meshgrid(np.arange(width) + left - start.center_px[0], np.arange(height) + top - start.center_px[1])
        away = np.stack([x, y], axis=-1)
        near = np.einsum("...i,ij,...j->...", away, np.linalg.inv(start.shape_px2), away)
        reach = (1.0 + BLURS * blur_px / start.radius_px) ** 2
        # What is farther outside than the blur shows nothing of the mirror.
        self.used = (near < reach) & (self.inside_px > -BLURS * blur_px)
        # Without the dots around, whose own light is in many pixels of the window where they stand close.
        self.values_dn = (rim.photo_dn[part] - rim.ground_dn[part])[self.used]
        middle = self.values_dn[(near < 0.5)[self.used]]
        self.sign = 1.0 if middle.size and np.median(middle) < 0.0 else -1.0
        self.fine_x = (np.arange(width * _FINE) + 0.5) / _FINE - 0.5 + left
        self.fine_y = ((np.arange(height * _FINE) + 0.5) / _FINE - 0.5 + top)[:, None]
        resized = cv2.resize(self.inside_px, (width * _FINE, height * _FINE), interpolation=cv2.INTER_LINEAR)
        self.fine_inside_px = np.asarray(resized, dtype=np.float64)

    @classmethod
    def around(cls, rim: Rim, start: Ellipse, blur_px: float) -> "_Window | None":
        """Return the window of a dot; None where it reaches beyond the photo."""
        reach = start.semi_axes_px[0] + (BLURS + 1.0) * blur_px + 2.0
        low, high = np.floor(start.center_px - reach).astype(int), np.ceil(start.center_px + reach).astype(int) + 1
        height, width = rim.inside_px.shape
        if low.min() < 0 or high[0] > width or high[1] > height:
            return None
        made = cls(rim, start, blur_px, (int(low[0]), int(low[1])), (int(high[0] - low[0]), int(high[1] - low[1])))
        return made if np.count_nonzero(made.used) > 12 else None

    def model(self, place_px: FloatArray, shape_px2: FloatArray, moved_px: float) -> tuple[FloatArray, FloatArray]:
        """Return the share of each used pixel that shows the dot (n,), and its derivative by the place (n, 2) [1/px].

        moved_px: How far the outline is moved outwards [px].
        """
        shares = [
            self._share(place_px + off, shape_px2, moved_px)
            for off in ((0, 0), (_STEP_PX, 0), (-_STEP_PX, 0), (0, _STEP_PX), (0, -_STEP_PX))
        ]
        by_x, by_y = ((shares[k] - shares[k + 1]) / (2 * _STEP_PX) for k in (1, 3))
        return shares[0], np.stack([by_x, by_y], axis=1)

    def _share(self, place_px: FloatArray, shape_px2: FloatArray, moved_px: float) -> FloatArray:
        (a, b), (_, c) = np.linalg.inv(shape_px2)
        x, y = self.fine_x - place_px[0], self.fine_y - place_px[1]
        square = a * x * x + (2 * b * y) * x + c * y * y
        radius = float(np.linalg.det(shape_px2)) ** 0.25
        # Each sample stands for its own area: edges as soft as that.
        dot = np.clip((1.0 - np.sqrt(square)) * radius * _FINE + 0.5, 0.0, 1.0)
        dot *= np.clip((self.fine_inside_px + moved_px) * _FINE + 0.5, 0.0, 1.0)
        # The blur holds the pixel already.
        width = float(np.sqrt(max(self.blur_px**2 - 1 / 12, 1e-4)))
        blurred = cv2.GaussianBlur(dot, (0, 0), width * _FINE, borderType=cv2.BORDER_CONSTANT)
        columns, rows = self.size
        pixels = blurred.reshape(rows, _FINE, columns, _FINE).mean(axis=(1, 3))
        return np.asarray(pixels[self.used])

    def step_off(self, moved_px: float) -> FloatArray:
        """Return what an outline that is moved outwards leaves of the edge in the photo without it, (n,) [DN]."""
        from scipy.special import ndtr

        before, after = (ndtr((self.inside_px + off) / self.edge_blur_px) for off in (0.0, moved_px))
        return np.asarray((self.step_dn * (after - before))[self.used])
