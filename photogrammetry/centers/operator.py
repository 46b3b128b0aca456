"""What every centre operator takes and returns, and how pixel noise becomes a centre's covariance.

Every operator is linearised to an *influence*: by how much the centre moves when one pixel changes by 1 DN. Its
covariance is then the noise of the pixels seen through the influence, so that operators whose intermediate values are
correlated (gradients of neighbouring pixels, contours at several levels) are as honest as a least-squares fit.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.validate import FloatArray
from photogrammetry.centers.ellipse import Ellipse

#: Reach of a window and of the operators, in radii of the ellipse: a coded target's ring begins at 2.
REACH = 1.65


class UnmeasuredTargetError(EstimationError):
    """A target has no centre; the flag tells why in one word.

    flag: The reason.
    message: The reason, with numbers.
    """

    def __init__(self, flag: SampleFlag, message: str) -> None:
        super().__init__(message)
        self.flag = flag


@dataclass(frozen=True, slots=True, eq=False)
class TargetCenter:
    """Centre of one target.

    ellipse: The target's outline; its centre is the result.
    covariance_px2 (2, 2): Covariance of the centre [px^2].
    contrast_dn: Inside minus outside level; negative for a dark target [DN].
    inside_dn: Level inside [DN].
    blur_px: Width of the edge as the standard deviation of a Gaussian, without the pixel's own width; NaN where the
        operator does not estimate it [px].
    residual_dn: Rms of what the operator's model leaves, per degree of freedom [DN].
    n_samples: Pixels, or contour points, used.
    """

    ellipse: Ellipse
    covariance_px2: FloatArray
    contrast_dn: float
    inside_dn: float
    blur_px: float
    residual_dn: float
    n_samples: int

    @property
    def center_px(self) -> FloatArray:
        """The centre (x, y), shape (2,) [px]."""
        return self.ellipse.center_px

    @property
    def sigma_px(self) -> float:
        """Mean standard deviation of x and y [px]."""
        return float(np.sqrt(0.5 * np.trace(self.covariance_px2)))

    @property
    def misfit(self) -> float:
        """Residual relative to the contrast: what is no ellipse, or partly covered, shows here."""
        return self.residual_dn / max(abs(self.contrast_dn), 1e-12)

    def moved(self, offset_px: npt.ArrayLike) -> "TargetCenter":
        """Return the same centre in the pixels of an image of which the window was cut out.

        offset_px (2,): The window's first pixel [px].
        """
        return replace(self, ellipse=self.ellipse.moved(offset_px))


class CenterOperator(Protocol):
    """An estimator of a target's centre."""

    def __call__(self, window_dn: npt.NDArray[np.float64], start: Ellipse) -> TargetCenter:
        """Measure the centre of the target that lies near a start, in the window's own pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Part of an image.

    values_dn (h, w): Its grey values [DN].
    origin_px: Column and row of its first pixel in the image.
    """

    values_dn: FloatArray
    origin_px: tuple[int, int]


def cut_window(image_dn: npt.NDArray[np.generic], target: Ellipse, reach: float = REACH) -> Window:
    """Cut the pixels round a target out of an image.

    image_dn (h, w): Grey values of any type [DN].
    target: The target's outline in the image.
    reach: Half size of the window in radii of the ellipse; three pixels are added.
    EstimationError: The target touches the image's border.
    """
    half_x, half_y = reach * np.sqrt(np.diag(target.shape_px2))
    x, y = target.center_px
    height, width = image_dn.shape
    radius_x, radius_y = np.sqrt(np.diag(target.shape_px2))
    if x - radius_x < 1 or y - radius_y < 1 or x + radius_x > width - 2 or y + radius_y > height - 2:
        raise UnmeasuredTargetError(
            SampleFlag.CUT_BY_BORDER, f"the target at ({x:.1f}, {y:.1f}) px touches the border of the image"
        )
    left, right = max(int(x - half_x) - 3, 0), min(int(x + half_x) + 5, width)
    top, bottom = max(int(y - half_y) - 3, 0), min(int(y + half_y) + 5, height)
    return Window(np.asarray(image_dn[top:bottom, left:right], dtype=np.float64), (left, top))


def normalised_radius(shape: tuple[int, ...], ellipse: Ellipse) -> FloatArray:
    """Return for each pixel its distance from the centre in radii of the ellipse, shape (h, w)."""
    root = np.linalg.inv(ellipse.frame_px)
    x = np.arange(shape[1]) - ellipse.center_px[0]
    y = (np.arange(shape[0]) - ellipse.center_px[1])[:, None]
    return np.asarray(np.sqrt((root[0, 0] * x + root[0, 1] * y) ** 2 + (root[1, 0] * x + root[1, 1] * y) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class Grounds:
    """Levels and noise on both sides of a target's edge; each side's level is a plane.

    inside_dn, outside_dn: Levels at the target's centre [DN].
    inside_variance_dn2, outside_variance_dn2: Variance of a pixel about the plane [DN^2].
    slope_dn_px (2,): Slope of the outside level along x and y; 0 where it is not determined [DN/px].
    """

    inside_dn: float
    outside_dn: float
    inside_variance_dn2: float
    outside_variance_dn2: float
    slope_dn_px: FloatArray


def ground_noise(window_dn: FloatArray, ellipse: Ellipse, margin_px: float = 1.5) -> Grounds:
    """Measure levels and noise inside and outside a target, away from its edge.

    window_dn (h, w): Grey values [DN].
    ellipse: The target's outline in the window.
    margin_px: Pixels nearer to the edge than this are left out.
    Returns: Levels and variances. A side with too few pixels for a plane and its noise takes the other side's
        variance.
    EstimationError: Neither side has enough pixels.
    """
    radius = normalised_radius(window_dn.shape, ellipse)
    smaller = ellipse.semi_axes_px[1]
    inner = max(1 - margin_px / smaller, 0.75 / smaller)  # at least the pixel at the centre
    outer = min(1 + margin_px / smaller, 0.5 * (1 + REACH))
    found = []
    slope = np.zeros(2)
    for side in (radius < inner, (radius > outer) & (radius < REACH)):
        rows, columns = np.nonzero(side)
        values = window_dn[rows, columns]
        if len(values) < 3:
            found.append((float(values.mean()) if len(values) else np.nan, np.nan))
            continue
        planes = np.stack([np.ones(len(rows)), columns - ellipse.center_px[0], rows - ellipse.center_px[1]], axis=1)
        use = 3 if len(values) >= 8 else 1
        solution = np.linalg.lstsq(planes[:, :use], values, rcond=None)[0]
        slope = solution[1:] if use == 3 else np.zeros(2)  # the outside comes last
        left = values - planes[:, :use] @ solution
        freedom = len(values) - use
        found.append((float(solution[0]), float(left @ left) / freedom if freedom >= 5 else np.nan))
    (inside, variance_in), (outside, variance_out) = found
    if not np.isfinite([inside, outside]).all() or (np.isnan(variance_in) and np.isnan(variance_out)):
        raise EstimationError("the target covers too few pixels to tell its level and noise")
    return Grounds(
        inside,
        outside,
        variance_in if np.isfinite(variance_in) else variance_out,
        variance_out if np.isfinite(variance_out) else variance_in,
        slope,
    )


def influence_covariance(influence: FloatArray, window_dn: FloatArray, grounds: Grounds) -> FloatArray:
    """Return the centre's covariance from what each pixel does to it.

    Shapes: result (2, 2).
    influence (2, h, w): Movement of the centre by one grey value of each pixel [px/DN].
    window_dn (h, w): Grey values: noise is taken to run linearly with the level between both grounds, as photon
        noise does [DN].
    grounds: Levels and noise of both sides.
    """
    step = grounds.outside_dn - grounds.inside_dn
    share = np.clip((window_dn - grounds.inside_dn) / step, 0.0, 1.0) if step else np.zeros_like(window_dn)
    variance = grounds.inside_variance_dn2 + share * (grounds.outside_variance_dn2 - grounds.inside_variance_dn2)
    return np.asarray(np.einsum("ihw,jhw,hw->ij", influence, influence, variance))
