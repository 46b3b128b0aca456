"""Slope maps of facets from their lean and bows: smooth, with all of their uncertainty in common."""

from collections.abc import Sequence

import numpy as np

from deflectometry.setup.setup_steps import principal_steps
from deflectometry.stars.facet_stars import Lean, slopes_of
from heliogauge.flags import SampleFlag
from heliogauge.geometry.surfaces import Facet
from heliogauge.slopes.map import CommonModes, SlopeMap
from heliogauge.validate import FloatArray


def lean_map(
    facet: Facet, lean: Lean, common: Sequence[tuple[str, FloatArray]], step_m: float, frame: str, removed: str
) -> SlopeMap:
    """Return the slope map of a facet.

    common: What each common source does to the five numbers, for one sigma.
    """
    low, high = facet.outline_m.min(axis=0), facet.outline_m.max(axis=0)
    x_m, y_m = (np.linspace(a, b, max(int(np.ceil((b - a) / step_m)) + 1, 5)) for a, b in zip(low, high, strict=True))
    x, y = np.meshgrid(x_m, y_m)
    aperture = facet.contains(x, y)
    height, own_x, own_y = facet.design.height_and_gradient(x, y)
    more_x, more_y = slopes_of(lean.values, x, y)
    rise_x, rise_y, bow_x, bow_y, twist = lean.values
    more = rise_x * x + rise_y * y + 0.5 * (bow_x * x**2 + bow_y * y**2) + twist * x * y
    modes = [("stars", one) for one in principal_steps(lean.covariance)] + list(common)
    # Constant, u and v of each slope: they move as lean and bows do.
    coefficients = np.array([[[a, c, e], [b, e, d]] for _, (a, b, c, d, e) in modes])
    exact = np.where(aperture, 1e-9, np.nan)
    return SlopeMap(
        x_m=x_m,
        y_m=y_m,
        slope_x=np.where(aperture, own_x + more_x, np.nan),
        slope_y=np.where(aperture, own_y + more_y, np.nan),
        design_slope_x=own_x,
        design_slope_y=own_y,
        sigma_random_x=exact,
        sigma_random_y=exact,
        noise_correlation=1.0,
        common=CommonModes(tuple(source for source, _ in modes), coefficients, np.zeros(2), 1.0),
        height_m=np.where(aperture, height + more, np.nan),
        flags=np.where(aperture, 0, SampleFlag.OUTSIDE_MIRROR).astype(np.uint32),
        aperture=aperture,
        design=facet.design.describe(),
        frame=frame,
        removed=removed,
    )
