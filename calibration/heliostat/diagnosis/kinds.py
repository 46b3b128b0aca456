"""Whether kinds of observation agree: beams, normals, points and sightings, each beside what the rest predict."""

from typing import NamedTuple

import numpy as np

from calibration.heliostat.diagnosis.findings import Finding, Severity, dates_of
from calibration.heliostat.fitting.fit_model import REFUTED_FROM
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.robust_fit import fit as refit
from calibration.heliostat.observations.residuals import evaluate
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, FloatArray

_WORDS = {
    "beam": "beams",
    "normal": "normals",
    "point": "points",
    "drone": "sightings of drones",
    "camera": "sightings of cameras",
    "lamp": "sightings of lamps",
}


class _Apart(NamedTuple):
    """How far the rows of a kind are from what the others predict of them.

    ratio: Root mean square, over what is expected.
    chance: Of as much if they agree.
    is_refuted: Whether the others themselves scatter more than their sigmas say.
    """

    kind: str
    rows: BoolArray
    ratio: float
    chance: float
    is_refuted: bool


def contradiction_finding(fit: HeliostatFit, significance: float) -> Finding | None:
    """Predict each kind of observation from the other ones, and say which are contradicted; None where all agree.

    significance: Chance that kinds which agree get a finding.

    With residuals ``r`` of the n components of a kind at the fit to the others, whose covariance is ``S``, ``r^T (J S
    J^T + f^2 I)^-1 r`` is chi-square with n degrees of freedom, in units of the stated sigma. The factor ``f`` on it is
    what a fit to the kind alone scatters, at least 1: a sigma that is too small for all rows contradicts no other kind.
    """
    used = fit.used
    kinds = np.array(fit.observations.kind, dtype=np.str_)
    names = tuple(dict.fromkeys(kinds[used].tolist()))
    if len(names) < 2:
        return None
    found = [one for name in names if (one := _apart(fit, name, used & (kinds == name), used & (kinds != name)))]
    chances = [one for one in found if one.chance * len(names) < significance]
    if not chances:
        return None
    worst = max(chances, key=lambda one: one.ratio)
    said = "; ".join(f"{int(one.rows.sum())} {_WORDS[one.kind]} are {one.ratio:.1f} times as far" for one in chances)
    text = (
        f"Kinds of observation contradict each other: from what the others predict, {said} as their sigmas allow. "
        "Until that is mended no finding of times, drives or terms is a fault. Check the frame of each kind (a turn "
        "about the vertical first), the places and the clock it was measured with, and its sigmas."
    )
    evidence = {"kinds_count": float(len(names)), "largest_ratio": worst.ratio}
    # Where the model lacks something for the others too, that may be what stands between the kinds.
    severity: Severity = "doubt" if worst.is_refuted else "fault"
    rows, times = fit.observations.row[worst.rows], fit.observations.time[worst.rows]
    chance = min(1.0, worst.chance * len(names))
    return Finding("unexplained", severity, text, evidence, chance, tuple(rows.tolist()), dates_of(times))


def _apart(fit: HeliostatFit, kind: str, own: BoolArray, others: BoolArray) -> _Apart | None:
    """Compare the rows of a kind with the others; None where these do not say anything of them."""
    seen, options = fit.observations, FitOptions(restarts=0)
    try:
        rest = refit(fit.nominal, seen.select(others), options)
        alone = refit(fit.nominal, seen.select(own), options)
        columns = np.flatnonzero(rest.design.parameters.free)
        rows = evaluate(rest.design, rest.values, seen.select(own), columns=columns)
    except (EstimationError, InputError):
        return None
    known = rows.computable[rows.owner]
    missed, moved = rows.whitened[known], rows.jacobian[known]
    # What the kind's own rows scatter, refuted or not; of too few that is not known.
    scatter = alone.sigma0.get(kind, np.nan)
    factor = max(scatter, 1.0) if np.isfinite(scatter) else 1.0
    if not np.isfinite(rest.solution.covariance).all():
        return None
    square = squared_distance(missed, moved, rest.solution.covariance, factor)
    refuted = max(rest.sigma_factors.values(), default=1.0) > REFUTED_FROM
    ratio = float(np.sqrt(square / max(missed.size, 1)))
    return _Apart(kind, own, ratio, 1.0 - chi_square_cdf(square, missed.size), refuted)


def squared_distance(missed: FloatArray, moved: FloatArray, covariance: FloatArray, noise: float) -> float:
    """Return how far residuals are from nothing, in units of what noise and parameters make of them.

    missed (n,): Residuals.
    moved (n, p): What each parameter changes of them.
    covariance (p, p): Of the parameters.
    noise: Standard deviation of each residual.

    ``r^T (J S J^T + f^2 I)^-1 r`` is the least of ``|r - U z|^2 / f^2 + |z|^2`` over z, where ``S = L L^T`` and ``U = J
    L``: no matrix of n by n is needed, and nothing large is subtracted from something large.
    """
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0, sigma, 1.0)
    shares, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = scale[:, None] * axes * np.sqrt(np.maximum(shares, 0.0))
    system = np.vstack([moved @ root / noise, np.eye(sigma.size)])
    wanted = np.concatenate([missed / noise, np.zeros(sigma.size)])
    left = wanted - system @ np.linalg.lstsq(system, wanted, rcond=None)[0]
    return float(left @ left)
