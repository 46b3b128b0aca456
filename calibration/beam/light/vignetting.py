"""What a lens takes from the light towards the corners of its photos, as a target without a beam shows it."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from heliogauge.validate import FloatArray

__all__ = ["LightFall", "light_fall"]

#: Blocks of the target along each side, as large as panels, which differ by their paint.
_BLOCKS = 6
#: A pixel so much darker than its block shows a seam or a mark (paint differs by a tenth, dark paint is at most a third
#: as bright); blocks with more of them than seams make are left out: their edges, blurred, pull what is left.
_DARK, _MOST_DARK = 0.7, 0.05
#: Rounds of the robust fit, and Tukey's constant for 95 % efficiency.
_ROUNDS, _TUKEY = 20, 4.685


@dataclass(frozen=True, slots=True, eq=False)
class LightFall:
    """Fall of the light towards the photo's corners, straight changes across the target taken out.

    per_radius2, sigma_per_radius2: Loss at the photo's corner, as a share, and its standard deviation; the loss grows
        with the square of the distance from the photo's middle.
    over_target: Largest minus least of it over the target, as a share.
    x_m (w,), y_m (h,): Columns and rows of the target, ascending [m].
    log_gradient_1pm (h, w, 2): How the logarithm of what the lens passes changes to the right and up [1/m].
    """

    per_radius2: float
    sigma_per_radius2: float
    over_target: float
    x_m: FloatArray
    y_m: FloatArray
    log_gradient_1pm: FloatArray

    @property
    def is_seen(self) -> bool:
        """Whether the light falls towards the corners by more than three sigma."""
        return self.per_radius2 > 3 * self.sigma_per_radius2

    def shift_m(self, place_m: FloatArray, covariance_m2: FloatArray) -> FloatArray:
        """Return by how much it moves the centre of a beam, to first order, shape (2,) [m].

        place_m (2,): Centre of the beam [m].
        covariance_m2 (2, 2): Second moments of its light [m^2].
        """
        row = int(np.argmin(np.abs(self.y_m - place_m[1])))
        column = int(np.argmin(np.abs(self.x_m - place_m[0])))
        return np.asarray(covariance_m2 @ self.log_gradient_1pm[row, column])


def light_fall(values_dn: FloatArray, radius2: FloatArray, x_m: FloatArray, y_m: FloatArray) -> LightFall | None:
    """Estimate what a lens takes from the light in a picture of an empty target.

    values_dn (h, w): Brightness of the target without a beam; NaN where it is not known [DN].
    radius2 (h, w): Squared distance of each of its pixels from the photo's middle, that of the photo's corner being 1.
    x_m (w,), y_m (h,): Places of its columns and rows [m].
    Returns None: where the target is too dark, or too little of it is seen.

    Daylight that bends across the target as a lens does is not told apart from it: this is at most what the lens takes.
    """
    height, width = values_dn.shape
    rows = np.linspace(0, height, _BLOCKS + 1).astype(int)
    columns = np.linspace(0, width, _BLOCKS + 1).astype(int)
    points = []
    for low, high in pairwise(rows.tolist()):
        for left, right in pairwise(columns.tolist()):
            block = values_dn[low:high, left:right]
            known = block[np.isfinite(block)]
            level = _level(known) if known.size >= 20 else 0.0
            dark = float(np.mean(known < _DARK * level)) if level > 0 else 1.0
            if known.size >= 0.5 * block.size and dark < _MOST_DARK:
                middle = (low + high) // 2, (left + right) // 2
                here = radius2[low:high, left:right].mean()
                points.append((np.log(level), x_m[middle[1]], y_m[middle[0]], here))
    if len(points) < 20:
        return None
    table = np.array(points)
    design = np.column_stack([np.ones(len(table)), table[:, 1:]])
    # Light that falls evenly, then what bends: marks in the corners must not pass for the lens.
    found = np.array([float(np.median(table[:, 0])), 0.0, 0.0, 0.0])
    for _ in range(_ROUNDS):
        residuals = table[:, 0] - design @ found
        scale = max(1.4826 * float(np.median(np.abs(residuals - np.median(residuals)))), 1e-6)
        # Tukey's biweight: what is far off counts for nothing.
        share = np.minimum(np.abs(residuals - np.median(residuals)) / (_TUKEY * scale), 1.0)
        weights = (1 - share**2) ** 2
        root = np.sqrt(weights)[:, None]
        found, *_ = np.linalg.lstsq(root * design, root[:, 0] * table[:, 0], rcond=None)
    # Panels differ, and blocks of one panel are alike: rows and columns of blocks are left out in turn.
    sigma = max(_left_out(table, design, weights, column) for column in (1, 2))
    loss = -float(found[3])
    up, across = np.gradient(-loss * radius2, y_m, x_m)
    return LightFall(
        loss,
        sigma,
        abs(loss) * float(np.ptp(radius2[np.isfinite(values_dn)])),
        x_m,
        y_m,
        np.stack([across, up], axis=-1),
    )


def _level(values: FloatArray) -> float:
    """Return the brightness of a block without its seams and marks: finer than a grey level, which a median is not."""
    middle = float(np.median(values))
    scatter = max(1.4826 * float(np.median(np.abs(values - middle))), 0.5)
    return float(values[np.abs(values - middle) < 3 * scatter].mean())


def _left_out(table: FloatArray, design: FloatArray, weights: FloatArray, column: int) -> float:
    """Return the standard deviation of the last coefficient when blocks of one place are left out in turn."""
    values = []
    for place in np.unique(table[:, column]):
        kept = np.sqrt(weights * (table[:, column] != place))[:, None]
        values.append(float(np.linalg.lstsq(kept * design, kept[:, 0] * table[:, 0], rcond=None)[0][3]))
    groups = len(values)
    return float(np.sqrt((groups - 1) / groups * np.sum((np.array(values) - np.mean(values)) ** 2)))
