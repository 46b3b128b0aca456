"""Noise of a heliostat's observations: each row's own, and what moves the zeros of both drives from day to day."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.heliostat.kinematic_model.design import HeliostatDesign, LinearActuator
from calibration.heliostat.observations.observations import Observations
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray

#: More days than this are joined in runs: the slow part changes little within a week.
_MOST_BINS = 200
_DAY = np.timedelta64(86_400_000, "ms")
# Rows without a time have nothing in common with any other: they lie so far apart [d].
_UNKNOWN_APART = 1e5


@dataclass(frozen=True, slots=True)
class NoiseShape:
    """How observations of one heliostat scatter about its kinematics.

    white: Factor on the stated sigma of each row.
    day_rad: What shifts both drives for one day, standard deviation [rad of the drive].
    wander_rad: What shifts them and is forgotten slowly, standard deviation [rad of the drive].
    memory_days: After so many days that is forgotten to 1/e [d].

    The zero of a drive at times t, t' has covariance ``wander^2 exp(-|t - t'| / memory) + day^2 [same day]``; both
    drives move on their own.
    """

    white: float
    day_rad: float
    wander_rad: float
    memory_days: float

    @property
    def drive_variance_rad2(self) -> float:
        """Variance of a drive's zero on a day of which nothing is known [rad^2]."""
        return self.day_rad**2 + self.wander_rad**2

    def times(self, factor: float) -> "NoiseShape":
        """Return the same shape, larger by a factor."""
        return NoiseShape(factor * self.white, factor * self.day_rad, factor * self.wander_rad, self.memory_days)

    def covariance(self, one_days: FloatArray, other_days: FloatArray) -> FloatArray:
        """Return the covariance of a drive's zero between times (a,) and (b,) [d], shape (a, b) [rad^2]."""
        apart = np.abs(one_days[:, None] - other_days)
        same = np.floor(one_days)[:, None] == np.floor(other_days)
        return np.asarray(self.wander_rad**2 * np.exp(-apart / self.memory_days) + self.day_rad**2 * same)


#: Six real heliostats with linear actuators over two years (evidence of `benchmarks/heliostat_field.py`); each number
#: is taken to within a factor of e, and a field's own evidence takes over.
USUAL_NOISE = NoiseShape(2.0, 1.5e-4, 4.5e-4, 90.0)


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations(ShortRepr):
    """What observations say of the offsets x of a heliostat's parameters from their nominal values, under a noise.

    ``-2 log p(observations | x) = square - 2 rhs . x + x . matrix . x + log_determinant``.

    matrix (p, p), rhs (p,): Normal equations.
    square: Squared residuals at no offset, over the noise.
    log_determinant: Of the noise's covariance.
    count: Components.
    """

    matrix: FloatArray
    rhs: FloatArray
    square: float
    log_determinant: float
    count: int

    def scaled(self, factor: float) -> "NormalEquations":
        """Return the equations under a noise larger by a factor."""
        over = 1.0 / factor**2
        grown = self.log_determinant + 2 * self.count * float(np.log(factor))
        return NormalEquations(self.matrix * over, self.rhs * over, self.square * over, grown, self.count)


@dataclass(frozen=True, slots=True, eq=False)
class LinearRows(ShortRepr):
    """Observations of a heliostat, linear in the offsets of its parameters from their nominal values.

    names length p: Parameters.
    residuals (m,): Predicted minus measured at no offset, in stated sigma.
    jacobian (m, p): Derivatives by the offsets.
    drives (m, 2): Derivatives by the angle of each drive [1/rad].
    days (m,): Time of each component [d].
    weight (m,): Weight that a robust fit left to it, above 0.
    """

    names: tuple[str, ...]
    residuals: FloatArray
    jacobian: FloatArray
    drives: FloatArray
    days: FloatArray
    weight: FloatArray

    def equations(self, noise: NoiseShape) -> NormalEquations:
        """Return the normal equations under a noise."""
        return self.solved(noise).equations

    def solved(self, noise: NoiseShape) -> "SolvedRows":
        """Return the normal equations under a noise, and what they take of the drives' zeros.

        With ``K = D + Z C Z'`` (D the rows' own noise, Z from days and drives to components, ``C = L L'``) Woodbury's
        identity gives ``K^-1 = D^-1 - D^-1 Z S' S Z' D^-1``, ``S = chol(1 + L' Z' D^-1 Z L)^-1 L'``: matrices as
        large as the number of days, not of rows.
        """
        from scipy.linalg import solve_triangular

        root = np.sqrt(self.weight) / noise.white
        both = np.column_stack([self.jacobian, self.residuals]) * root[:, None]
        square, log_white = both.T @ both, -2 * float(np.log(root).sum())
        bins, middle = _binned(self.days)
        count, q = self.residuals.size, middle.size
        drift = np.zeros((count, 2 * q))
        every = np.arange(count)
        drift[every, bins], drift[every, q + bins] = (self.drives * root[:, None]).T
        by_drift, drift_square = drift.T @ both, drift.T @ drift
        if noise.drive_variance_rad2 == 0:
            found = _equations(square, log_white, count)
            return SolvedRows(found, middle, by_drift[:, :-1].reshape(2, q, -1))
        half = np.linalg.cholesky(noise.covariance(middle, middle) + 1e-9 * noise.drive_variance_rad2 * np.eye(q))
        lower = np.kron(np.eye(2), half)
        inner = np.linalg.cholesky(np.eye(2 * q) + lower.T @ drift_square @ lower)
        taken = solve_triangular(inner, lower.T, lower=True)
        share = taken @ by_drift
        log_all = log_white + 2 * float(np.log(np.diag(inner)).sum())
        link = by_drift - drift_square @ (taken.T @ share)
        return SolvedRows(_equations(square - share.T @ share, log_all, count), middle, link[:, :-1].reshape(2, q, -1))


class SolvedRows(NamedTuple):
    """Normal equations, and how they depend on what the drives did.

    days (q,): Middle of each run of days [d].
    link (2, q, p): ``Z' K^-1 J``: drives, days, parameters.
    """

    equations: NormalEquations
    days: FloatArray
    link: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Drift(ShortRepr):
    """What a fit knows of the noise along its drives.

    noise: Its size for this heliostat.
    days (q,): When it was observed [d].
    link (2, q, k): Covariance between the estimates of k parameters and a drive's zero is ``-cov(t, days) link``
        (`LinearRows.solved` times the covariance of the estimates).
    """

    noise: NoiseShape
    days: FloatArray
    link: FloatArray

    def shared(self, days: FloatArray, drives: FloatArray) -> FloatArray:
        """Return the covariance of the drives' part of some rows with the estimates' errors, shape (n, 2, k).

        days (n,): Times of the rows [d].
        drives (n, 2, 2): Derivatives of their two components by the angle of each drive.
        """
        kernel = self.noise.covariance(days, self.days)
        return np.asarray(np.einsum("ncd,nq,dqk->nck", drives, kernel, self.link))


def _equations(square: FloatArray, log_determinant: float, count: int) -> NormalEquations:
    return NormalEquations(square[:-1, :-1], -square[:-1, -1], float(square[-1, -1]), log_determinant, count)


def _binned(days: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the runs of days: run of each component (m,), middle of each run (q,)."""
    whole = np.floor(days)
    found, bins = np.unique(whole, return_inverse=True)
    if found.size > _MOST_BINS:
        place = np.arange(found.size) * _MOST_BINS // found.size
        bins = place[bins]
    middle = np.bincount(bins, whole) / np.bincount(bins)
    return bins.astype(np.intp), np.asarray(np.floor(middle) + 0.5, dtype=np.float64)


def row_days(observations: Observations) -> FloatArray:
    """Return the time of each row, shape (n,) [d]; rows without one between their neighbours by number.

    observations: Rows; where none has a time, each lies on its own, far from all others.
    """
    time, number = observations.time, observations.row.astype(np.float64)
    missing = np.isnat(time)
    if missing.all():
        return np.asarray(np.arange(len(observations)) * _UNKNOWN_APART, dtype=np.float64)
    days = np.zeros(len(observations), dtype=np.float64)
    days[~missing] = (time[~missing] - np.datetime64("2000-01-01", "ms")) / _DAY
    order = np.argsort(number[~missing], kind="stable")
    days[missing] = np.interp(number[missing], number[~missing][order], days[~missing][order])
    return np.asarray(days, dtype=np.float64)


def drive_zeros(design: HeliostatDesign) -> tuple[str, str]:
    """Return the names of the parameters that shift the angle of each drive."""
    first, second = (one.initial_angle if isinstance(one, LinearActuator) else one.offset for one in design.drives)
    return first, second
