"""Noise of a heliostat's observations: each row's own, what days share, what repeats where the mirror stands alike."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from calibration.heliostat.kinematic_model.design import HeliostatDesign, LinearActuator
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.observations.observations import Observations
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: More rows than this are joined in runs of neighbours in time: the slow parts change little within such a run.
_MOST_RUNS = 200
_DAY = np.timedelta64(86_400_000, "ms")
# Rows without a time have nothing in common with any other: they lie so far apart [d].
_UNKNOWN_APART = 1e5


@dataclass(frozen=True, slots=True, eq=False)
class Occasions(ShortRepr):
    """When a heliostat stood where.

    days (n,): Time [d]; NaN where it is not known.
    normals (n, 3): Normal of the mirror; NaN where it is not known.
    """

    days: FloatArray
    normals: FloatArray
    _kept: "list[_Runs]" = field(init=False, default_factory=list)

    @property
    def runs(self) -> "_Runs":
        """Rows that have one occasion, found once: every noise that is tried needs them."""
        if not self._kept:
            self._kept.append(_in_runs(self))
        return self._kept[0]

    def select(self, rows: BoolArray | IntArray) -> "Occasions":
        """Return some of them."""
        return Occasions(self.days[rows], self.normals[rows])


@dataclass(frozen=True, slots=True)
class NoiseShape:
    """How observations of one heliostat scatter about its kinematics.

    white: Factor on the stated sigma of each row.
    day_rad: What shifts both drives for one day, standard deviation [rad of the drive].
    wander_rad: What shifts them and is forgotten slowly, standard deviation [rad of the drive].
    memory_days: After so many days that is forgotten to 1/e [d].
    misfit_rad: What the kinematics lack, and what repeats wherever the mirror stands alike: as an angle of both
        drives, standard deviation [rad of the drive].
    reach_rad: How far the mirror turns until that is another [rad of the normal].

    The zero of a drive on two occasions, t - t' days and d of the normal apart, has covariance ``wander^2
    exp(-|t - t'| / memory) + day^2 [same day] + misfit^2 (1 + a) exp(-a)``, ``a = sqrt(3) d / reach`` (Matern's of
    order 3/2); both drives move on their own.
    """

    white: float
    day_rad: float
    wander_rad: float
    memory_days: float
    misfit_rad: float
    reach_rad: float

    @property
    def drive_variance_rad2(self) -> float:
        """Variance of a drive's zero on an occasion of which nothing is known [rad^2]."""
        return self.day_rad**2 + self.wander_rad**2 + self.misfit_rad**2

    @property
    def followed(self) -> "NoiseShape":
        """What weighs the observations in an estimate: all but the misfit.

        Kinematics that follow what repeats at the suns that were seen predict it there; weighed as noise it is lost,
        and the beam at suns like those is 0.1 mrad worse (seventeen real heliostats).
        """
        return replace(self, misfit_rad=0.0)

    @property
    def misfit(self) -> "NoiseShape":
        """The misfit alone."""
        return replace(self, white=0.0, day_rad=0.0, wander_rad=0.0)

    def times(self, factor: float) -> "NoiseShape":
        """Return the same shape, larger by a factor."""
        return replace(
            self,
            white=factor * self.white,
            day_rad=factor * self.day_rad,
            wander_rad=factor * self.wander_rad,
            misfit_rad=factor * self.misfit_rad,
        )

    def covariance(self, one: Occasions, other: Occasions) -> FloatArray:
        """Return the covariance of a drive's zero between a and b occasions, shape (a, b) [rad^2]."""
        apart = np.abs(one.days[:, None] - other.days)
        same = np.floor(one.days)[:, None] == np.floor(other.days)
        in_time = self.wander_rad**2 * np.exp(-apart / self.memory_days) + self.day_rad**2 * same
        if not np.isfinite(apart).all():
            in_time = np.nan_to_num(in_time)
        if self.misfit_rad == 0:
            return np.asarray(in_time)
        # The chord of unit vectors; times of which nothing is known have nothing in common with others.
        chord = np.maximum(2 - 2 * one.normals @ other.normals.T, 0.0)
        turned = np.sqrt(3 * chord) / self.reach_rad
        in_place = self.misfit_rad**2 * (1 + turned) * np.exp(-turned)
        return np.asarray(in_time + (in_place if np.isfinite(chord).all() else np.nan_to_num(in_place)))


#: Six real heliostats with linear actuators over two years (evidence of `benchmarks/heliostat_field.py`); each size is
#: taken to within a factor of e, and a field's own evidence takes over; memory and reach stay.
USUAL_NOISE = NoiseShape(2.0, 1.5e-4, 4.5e-4, 90.0, 2.8e-4, 0.2)


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
    occasions: When and where to each component was seen, m of them.
    weight (m,): Weight that a robust fit left to it, above 0.
    """

    names: tuple[str, ...]
    residuals: FloatArray
    jacobian: FloatArray
    drives: FloatArray
    occasions: Occasions
    weight: FloatArray

    def equations(self, noise: NoiseShape) -> NormalEquations:
        """Return the normal equations under a noise."""
        return self.solved(noise).equations

    def solved(self, noise: NoiseShape) -> "SolvedRows":
        """Return the normal equations under a noise, and what they take of the drives' zeros."""
        return self.weighing(noise).solved(self.jacobian, self.residuals)

    def weighing(self, noise: NoiseShape) -> "Weighing":
        """Return the inverse of a noise's covariance, for any residuals and derivatives of these rows."""
        return Weighing.of(self, noise)


@dataclass(frozen=True, slots=True, eq=False)
class Weighing(ShortRepr):
    """The inverse of the covariance of some rows' noise, factorised.

    With ``K = D + Z C Z'`` (D the rows' own noise, Z from drives and occasions to components, C the covariance of the
    drives' zeros) and ``G = Z' D^-1 Z = H H'``, two by two for each occasion, Woodbury's identity gives ``Z' K^-1 = (1
    - H (1 + H' C H)^-1 H' C) Z' D^-1`` and ``K^-1 = D^-1 - D^-1 Z C Z' K^-1``: matrices as large as the number of
    occasions.

    over (m,): Diagonal of ``D^-1``.
    drives (m, 2): Z.
    runs: Components of each occasion.
    kernel (q, q): C of one drive; None where the drives do not move.
    half (q, 2, 2): H.
    factor (2 q, 2 q): Lower triangle of ``1 + H' C H``.
    log_determinant: Of K.
    """

    over: FloatArray
    drives: FloatArray
    runs: "_Runs"
    kernel: FloatArray | None
    half: FloatArray
    factor: FloatArray
    log_determinant: float

    @classmethod
    def of(cls, rows: LinearRows, noise: NoiseShape) -> "Weighing":
        """Factorise the covariance of some rows."""
        from scipy.linalg import cho_factor

        over, runs, drives = rows.weight / noise.white**2, rows.occasions.runs, rows.drives
        q, log_white = runs.occasions.days.size, -float(np.log(over).sum())
        pairs = runs.sums((drives[:, :, None] * drives[:, None] * over[:, None, None]).reshape(-1, 4))
        half = _root(pairs.reshape(-1, 2, 2))
        if noise.drive_variance_rad2 == 0:
            return cls(over, drives, runs, None, half, np.eye(2 * q), log_white)
        kernel = noise.covariance(runs.occasions, runs.occasions)
        # The lower triangle is enough.
        whole = np.zeros((2, q, 2, q))
        for one, other in ((0, 0), (1, 0), (1, 1)):
            whole[one, :, other] = kernel * (half[:, :, one] @ half[:, :, other].T)
        inner = whole.reshape(2 * q, 2 * q)
        inner[np.diag_indices(2 * q)] += 1.0
        factor, _ = cho_factor(inner, lower=True, overwrite_a=True, check_finite=False)
        log_all = log_white + 2 * float(np.log(np.diag(factor)).sum())
        return cls(over, drives, runs, kernel, half, factor, log_all)

    def solved(self, jacobian: FloatArray, residuals: FloatArray) -> "SolvedRows":
        """Return the normal equations of residuals (m,) with derivatives (m, p)."""
        from scipy.linalg import cho_solve

        both = np.column_stack([jacobian, residuals])
        weighted = both * self.over[:, None]
        square, count = both.T @ weighted, residuals.size
        by_drive = np.stack([self.runs.sums(self.drives[:, [drive]] * weighted) for drive in (0, 1)])
        if self.kernel is None:
            equations = _equations(square, self.log_determinant, count)
            return SolvedRows(equations, self.runs.occasions, by_drive[:, :, :-1])
        q, columns = self.half.shape[0], both.shape[1]
        moved = _along(self.half.transpose(0, 2, 1), self.kernel @ by_drive).reshape(2 * q, columns)
        taken = cho_solve((self.factor, True), moved, check_finite=False).reshape(2, q, columns)
        link = by_drive - _along(self.half, taken)
        reached = (self.kernel @ link).reshape(2 * q, columns)
        shared = by_drive.reshape(2 * q, columns).T @ reached
        equations = _equations(square - shared, self.log_determinant, count)
        return SolvedRows(equations, self.runs.occasions, link[:, :, :-1])


def _along(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return matrices (q, 2, 2) times the pairs of vectors (2, q, k), shape (2, q, k)."""
    return np.stack([matrices[:, [row], 0] * vectors[0] + matrices[:, [row], 1] * vectors[1] for row in (0, 1)])


class SolvedRows(NamedTuple):
    """Normal equations, and how they depend on what the drives did.

    occasions: Middle of each run of rows, q of them.
    link (2, q, p): ``Z' K^-1 J``: drives, occasions, parameters.
    """

    equations: NormalEquations
    occasions: Occasions
    link: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Drift(ShortRepr):
    """What a fit knows of the noise along its drives.

    noise: Its size for this heliostat.
    occasions: When and where to it was observed, q of them.
    link (2, q, k): Covariance between the estimates of k parameters and a drive's zero on an occasion is ``-cov(it,
        occasions) link`` (`LinearRows.solved` times the covariance of the estimates).
    """

    noise: NoiseShape
    occasions: Occasions
    link: FloatArray

    def shared(self, occasions: Occasions, drives: FloatArray) -> FloatArray:
        """Return the covariance of the drives' part of some rows with the estimates' errors, shape (n, 2, k).

        occasions: Of the rows, n of them.
        drives (n, 2, 2): Derivatives of their two components by the angle of each drive.
        """
        kernel = self.noise.covariance(occasions, self.occasions)
        return np.asarray(np.einsum("ncd,nq,dqk->nck", drives, kernel, self.link, optimize=True))


def _equations(square: FloatArray, log_determinant: float, count: int) -> NormalEquations:
    return NormalEquations(square[:-1, :-1], -square[:-1, -1], float(square[-1, -1]), log_determinant, count)


def _root(squares: FloatArray) -> FloatArray:
    """Return the symmetric root of some two by two matrices, (n, 2, 2) (Cayley and Hamilton)."""
    root = np.sqrt(np.maximum(np.linalg.det(squares), 0.0))
    size = np.sqrt(np.trace(squares, axis1=1, axis2=2) + 2 * root)
    whole = squares + root[:, None, None] * np.eye(2)
    return np.asarray(whole / np.where(size > 0, size, 1.0)[:, None, None])


class _Runs(NamedTuple):
    """Rows that have one occasion: components in their order, first of each run, middle of each."""

    order: IntArray
    first: IntArray
    occasions: Occasions

    def sums(self, components: FloatArray) -> FloatArray:
        """Add up the components of each run, (m, k) to (q, k)."""
        return np.asarray(np.add.reduceat(components[self.order], self.first, axis=0))


def _in_runs(occasions: Occasions) -> _Runs:
    """Return the runs of some components: each row, or rows that follow each other where these are too many."""
    both = np.column_stack([occasions.days, occasions.normals])
    by_value = np.lexsort(both.T[::-1])
    rows = np.zeros(len(both), dtype=np.intp)
    rows[by_value[1:]] = np.cumsum((both[by_value[1:]] != both[by_value[:-1]]).any(axis=1))
    count = int(rows.max()) + 1
    if count > _MOST_RUNS:
        rows = rows * _MOST_RUNS // count
    order = np.argsort(rows, kind="stable").astype(np.intp)
    first = np.searchsorted(rows[order], np.arange(int(rows.max()) + 1)).astype(np.intp)
    sizes = np.diff(np.append(first, rows.size))
    days = np.add.reduceat(occasions.days[order], first) / sizes
    normals = np.add.reduceat(occasions.normals[order], first, axis=0)
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    return _Runs(order, first, Occasions(days, normals))


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


def occasions_of(design: HeliostatDesign, values: FloatArray, observations: Observations) -> Occasions:
    """Return when and where to each row was seen.

    values (p,): Of the design's parameters; milliradians do not matter.
    """
    poses = mirror_poses(design, values, observations.readings, observations.approach, outside="nan")
    return Occasions(row_days(observations), poses.normals(design))
