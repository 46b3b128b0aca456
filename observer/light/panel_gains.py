"""What aligning panels to the absorber gains, panel by panel."""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.light.cases import MeasuredTrough, Sensitivity
from observer.light.intercept import TroughOptics, Windows, along_path

#: A gain is sure where the panel's angle and the gain are beyond so many of their sigmas.
_SURE = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class PanelGains:
    """What the intercept factor gains, the sun on the optical axis, when panels are turned.

    gain_ratio, sigma_gain_ratio (k,): By turning each panel alone until its mean theta_ra is zero; NaN where that mean
        is not known.
    sure (k,): Which panels surely gain: mean angle and gain both beyond three sigma.
    together_ratio, sigma_together_ratio: What all of those gain together; zero where there is none.
    """

    gain_ratio: FloatArray
    sigma_gain_ratio: FloatArray
    sure: BoolArray
    together_ratio: float
    sigma_together_ratio: float


def panel_gains(
    trough: MeasuredTrough, optics: TroughOptics, panel: IntArray, theta_ra_rad: FloatArray, sigma_rad: FloatArray
) -> PanelGains:
    """Compute what turning each panel gains.

    Shapes: panel (m,): The panel of each node; -1 for nodes of none.
    optics: Of the trough as measured.
    theta_ra_rad, sigma_rad (k,): Mean theta_ra of each panel and its standard deviation; NaN where it is not known
        [rad].
    Returns: Gains; their sigmas are of first order in slopes and absorber and hold the second order, too.

    A turn of the normal by ``-t`` moves both acceptance angles of a node by ``-2 t``: they are ``2 theta_ra -+ w``.
    """
    known = np.isfinite(theta_ra_rad)
    light, windows, profile = optics.light(0.0), optics.windows, optics.profile
    own = np.where(panel >= 0, panel, 0)
    turned = (panel >= 0) & known[own]
    turn = np.where(turned, -2.0 * theta_ra_rad[own], 0.0)
    sigma = np.where(turned, 2.0 * sigma_rad[own], 0.0)
    after = windows.moved(turn, turn)

    def lost(at: Windows, step: FloatArray) -> FloatArray:
        """Return what each panel loses on average when angles are one step higher and lower."""
        sides = (at, at.moved(step, step), at.moved(-step, -step))
        first, high, low = (profile.below(one.upper_rad) - profile.below(one.lower_rad) for one in sides)
        return _sums(light * (first - 0.5 * (high + low)), panel, turned, known.size)

    collected = [profile.below(one.upper_rad) - profile.below(one.lower_rad) for one in (after, windows)]
    gain = _sums(light * (collected[0] - collected[1]), panel, turned, known.size)
    noise = np.abs(windows.d_slope_x) * trough.sigma_slope
    # The measured angle is not quite the true one; and noise of the slopes spreads the light that was computed.
    second = np.stack([lost(after, sigma), lost(after, noise) - lost(windows, noise)])
    variance = trough.covariance(_sensitivity(optics, after, panel, turned, known.size))
    sigmas = np.sqrt(np.maximum(np.diagonal(variance), 0.0) + (second**2).sum(axis=0))
    gain, sigmas = np.where(known, gain, np.nan), np.where(known, sigmas, np.nan)
    with np.errstate(invalid="ignore"):
        sure = (np.abs(theta_ra_rad) > _SURE * sigma_rad) & (gain > _SURE * sigmas)
    both = np.ix_(sure, sure)
    total = float(np.sqrt(max(variance[both].sum(), 0.0) + (second[:, sure].sum(axis=1) ** 2).sum()))
    return PanelGains(gain, sigmas, sure, float(gain[sure].sum()), total)


def _sums(values: FloatArray, panel: IntArray, turned: BoolArray, count: int) -> FloatArray:
    return np.asarray(np.bincount(panel[turned], values[turned], count))


def _sensitivity(optics: TroughOptics, after: Windows, panel: IntArray, turned: BoolArray, count: int) -> Sensitivity:
    """Differentiate each panel's gain with respect to slopes and absorber; the turn follows what was measured."""
    light, before, profile = optics.light(0.0), optics.windows, optics.profile
    changes = [
        light * (profile.density_at(getattr(after, edge)) - profile.density_at(getattr(before, edge)))
        for edge in ("upper_rad", "lower_rad")
    ]
    # What one unit of all acceptance angles of a panel changes after the turn, shared evenly: the turn is a mean.
    per_unit = light * (profile.density_at(after.upper_rad) - profile.density_at(after.lower_rad))
    nodes = np.maximum(np.bincount(panel[turned], minlength=count), 1)
    follow = np.zeros(panel.size)
    follow[turned] = (_sums(per_unit, panel, turned, count) / nodes)[panel[turned]]
    upper, lower = changes
    d_slope = (upper - lower - follow) * before.d_slope_x
    d_absorber = (
        upper[:, None] * before.d_upper_d_absorber
        - lower[:, None] * before.d_lower_d_absorber
        - follow[:, None] * before.d_middle_d_absorber
    )
    slopes, absorber = np.zeros((count, panel.size)), np.zeros((count, 2 * optics.stations.shape[1]))
    for number in range(count):
        here = turned & (panel == number)
        slopes[number, here] = d_slope[here]
        absorber[number] = along_path(optics.stations[here], d_absorber[here])
    return Sensitivity(slopes, absorber)
