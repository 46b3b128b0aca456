"""What is known of the centre of one target, and why there is none."""

from dataclasses import dataclass, field

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray
from photogrammetry.centers.ellipse import Ellipse

#: How far from the centre pixels are used, in radii of the ellipse: a coded target's ring begins at 2.
REACH = 1.65


class UnmeasuredTargetError(EstimationError):
    """A target has no centre; the flag names the reason.

    flag: The reason.
    message: The reason, with numbers.
    """

    def __init__(self, flag: SampleFlag, message: str) -> None:
        super().__init__(message)
        self.flag = flag


@dataclass(frozen=True, slots=True, eq=False)
class TargetCenter(ShortRepr):
    """Centre of one target.

    ellipse: The target's outline; its centre is the result.
    covariance_px2 (2, 2): Covariance of the centre [px^2].
    contrast_dn: Inside minus outside level; negative for a dark target [DN].
    inside_dn: Level inside [DN].
    blur_px: Width of the edge as the standard deviation of a Gaussian, without the pixel's own width [px].
    residual_dn: Rms of what the model leaves, per degree of freedom [DN].
    n_samples: Pixels used; 0 for the centre of an outline, which has neither blur nor residual.
    edge_powers (4,): Power of the residuals in harmonics of the outline, over that of independent ones: see
        `photogrammetry.centers.edge_noise`; empty for the centre of an outline.
    """

    ellipse: Ellipse
    covariance_px2: FloatArray
    contrast_dn: float
    inside_dn: float
    blur_px: float
    residual_dn: float
    n_samples: int
    edge_powers: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def center_px(self) -> FloatArray:
        """The centre (x, y), shape (2,) [px]."""
        return self.ellipse.center_px

    @property
    def is_coarse(self) -> bool:
        """Whether this is the centre of an outline, because no blurred disc fits the pixels."""
        return self.n_samples == 0

    @property
    def sigma_px(self) -> float:
        """Mean standard deviation of x and y [px]."""
        return float(np.sqrt(0.5 * np.trace(self.covariance_px2)))

    @property
    def misfit(self) -> float:
        """Residual relative to the contrast: what is no ellipse, or partly covered, shows here."""
        return self.residual_dn / max(abs(self.contrast_dn), 1e-12)
