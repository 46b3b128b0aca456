"""Which observations to learn from and which to try the prediction on, by name; and what came of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.model_choice import ModelChoice
from calibration.heliostat.fitting.prediction import Prediction, covariance_of_misses, predict_rows
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.observations import Observations
from calibration.heliostat.observations.residuals import Residuals, evaluate
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, FloatArray, IntArray, freeze

#: Splits by name; `column` besides takes the user's own.
SPLIT_NAMES = ("random", "chronological", "azimuth", "azimuth-reversed", "high-variance")
# Neighbours whose mean distance measures how lonely a sun position is.
_NEIGHBOURS = 3
_FEWEST = 4


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Rows to learn from and rows to try the prediction on.

    name: Which split.
    train, test (n,): Rows; some may be in neither.
    note: What it asks of a model.
    """

    name: str
    train: BoolArray
    test: BoolArray
    note: str


@dataclass(frozen=True, slots=True)
class AngleSummary:
    """Angles between measurement and prediction, of the beam and of the normal [rad].

    n: Rows.
    beam_rms_rad, beam_median_rad, beam_max_rad: Of the beam (for drones of the line of sight); NaN without such
        rows.
    normal_rms_rad, normal_median_rad, normal_max_rad: Of the mirror's normal.
    """

    n: int
    beam_rms_rad: float
    beam_median_rad: float
    beam_max_rad: float
    normal_rms_rad: float
    normal_median_rad: float
    normal_max_rad: float

    @classmethod
    def of(cls, residuals: Residuals, rows: BoolArray) -> "AngleSummary":
        """Summarise some rows, (n,), of residuals."""
        beam, normal = _angles(residuals.beam_angle_rad[rows]), _angles(residuals.normal_angle_rad[rows])
        return cls(int(rows.sum()), *beam, *normal)


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """A fit to one part of the observations, tried out on the other.

    fit: Fit to the training rows.
    train: Of the training rows that were used.
    test: Of all test rows that can be computed, outliers included: nobody knows them beforehand.
    residuals: Of all rows at the values of the fit.
    prediction: What was predicted of the test rows, with sigma and warning, before they were looked at.
    beyond: That test positions lie beyond those of training, and what to expect; must be known before the numbers are
        read.
    """

    split: Split
    fit: HeliostatFit
    train: AngleSummary
    test: AngleSummary
    residuals: Residuals
    prediction: Prediction
    beyond: Doubt | None

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What must be known before the numbers are read."""
        return gather_doubts(self.beyond, self.fit.doubts)


def make_split(
    observations: Observations,
    name: str,
    *,
    share: float = 0.75,
    count: int = 30,
    seed: int = 0,
    column: Sequence[str] | None = None,
) -> Split:
    """Split observations.

    observations: What was seen.
    name: One of `SPLIT_NAMES`, or "column".
    share: Share of training rows of the random and chronological splits.
    count: Rows in each part of the azimuth and high-variance splits, at most half of all.
    column length n: "train", "test", "validation" or anything else (in neither part) for each row.
    Returns: Masks over the rows.
    InputError: The split does not exist, or the observations lack suns or rows for it.

    Azimuth (0 = north, clockwise): the ``count`` smallest train and the largest are predicted; reversed the other way
    round, as the PAINT benchmark's azimuth split (its azimuth counts from south to east). High variance: the
    ``count`` suns farthest from their three neighbours are predicted from the ``count`` that are nearest to theirs.
    """
    n = len(observations)
    if n < _FEWEST:
        raise InputError(f"split {name}: {n} observations; at least {_FEWEST} are needed")
    if not 0 < share < 1 or count < 1:
        raise InputError(f"split {name}: a share between 0 and 1 and a count of at least 1, not {share} and {count}")
    few = min(count, n // 2)
    if name == "column":
        return _column_split(column, n)
    if name == "random":
        order = np.random.default_rng(seed).permutation(n)
        return _ordered(name, order, round(share * n), n - round(share * n), "the same days and suns as in training")
    if name == "chronological":
        time = observations.time
        missing = bool(np.isnat(time).any())
        order = np.argsort(observations.row if missing else time, kind="stable")
        note = "later than training: drift shows" + (
            " (times are missing: in the order of the rows)" if missing else ""
        )
        return _ordered(name, order, round(share * n), n - round(share * n), note)
    suns = observations.sun
    if np.isnan(suns).any():
        raise InputError(f"split {name}: every observation needs its sun")
    if name in ("azimuth", "azimuth-reversed"):
        order = np.argsort(np.mod(np.arctan2(suns[:, 0], suns[:, 1]), 2 * np.pi), kind="stable")
        order = order if name == "azimuth" else order[::-1]
        return _ordered(name, order, few, few, "suns on the other side of the sky: extrapolation")
    if name == "high-variance":
        order = np.argsort(_loneliness(suns), kind="stable")
        return _ordered(name, order, few, few, "lonely suns from crowded ones: extrapolation")
    raise InputError(f"split {name!r}: no such split; there are {', '.join(SPLIT_NAMES)} and column")


def held_out(
    design: HeliostatDesign,
    observations: Observations,
    split: Split,
    options: FitOptions | None = None,
    *,
    chooser: Callable[[HeliostatDesign, Observations, FitOptions | None], ModelChoice] | None = None,
    refine: Callable[[HeliostatFit], HeliostatFit] | None = None,
    near: HeliostatFit | None = None,
) -> HeldOut:
    """Fit to the training rows and compare with the others.

    chooser: Chooses the free parameters from the training rows alone, such as `choose_model`.
    refine: What is done to the fit, such as `fit_within` what a field knows.
    near: A fit to all rows: about it the training rows are made linear at first, which saves time and nothing else.
    Returns: Fit, residuals of both parts, prediction, doubts.
    EstimationError: The training rows do not determine the heliostat, or there are none.
    InputError: A test row needs a camera or target that no training row has.
    """
    if not split.train.any() or not split.test.any():
        raise EstimationError(
            f"split {split.name}: both parts need rows, not {split.train.sum()} and {split.test.sum()}"
        )
    training = observations.select(split.train)
    chosen = design if chooser is None else chooser(design, training, options).design
    found = fit(chosen, training, options, near=near)
    found = found if refine is None else refine(found)
    both = observations.select(split.train | split.test)
    # Nobody asks for derivatives.
    residuals = evaluate(found.design, found.values, both, columns=[0])
    prediction = predict_rows(found, both.select(split.test[split.train | split.test]))
    place = np.flatnonzero(split.train | split.test)
    used = np.zeros(len(observations), dtype=np.bool_)
    used[np.flatnonzero(split.train)[found.used]] = True
    tested = split.test[place] & residuals.computable
    summaries = AngleSummary.of(residuals, used[place]), AngleSummary.of(residuals, tested)
    return HeldOut(split, found, *summaries, residuals, prediction, _beyond_training(prediction))


@dataclass(frozen=True, slots=True)
class Misses:
    """What test rows missed, beside what was expected of them.

    ratio: RMS of the beam's misses over the expected one, the measurement's own errors included.
    freedom: Independent components that all rows together are worth.
    """

    ratio: float
    freedom: float

    @property
    def chance(self) -> float:
        """Probability of so large a ratio if what was expected is true."""
        return 1.0 - chi_square_cdf(self.freedom * self.ratio**2, self.freedom)

    @classmethod
    def of(cls, held: HeldOut, observations: Observations) -> "Misses | None":
        """Compare the misses of the test rows with their covariance.

        observations: All rows that were split.
        Returns: None where no test row has a beam that can be predicted.

        The sum of squares of misses with covariance C is distributed as ``tr C / v`` times chi-square of ``v = (tr
        C)^2 / tr C^2`` degrees (Satterthwaite 1946): mean and variance are exact.
        """
        missed = held.residuals.beam_rad[held.split.test[held.split.train | held.split.test]]
        known = np.isfinite(missed).all(axis=1) & np.isfinite(held.prediction.covariance_rad2).all(axis=(1, 2))
        if not known.any():
            return None
        covariance = covariance_of_misses(held.fit, observations.select(held.split.test), held.prediction)
        # What is found holds the measurement's own errors too: as stated, or where the residuals show less, that.
        share = min([1.0, *held.fit.sigma_factors.values()])
        rows = np.arange(len(missed))
        noise = 0.5 * (share * held.prediction.sigma_noise_rad) ** 2
        covariance[rows, :, rows] += noise[:, None, None] * np.eye(2)
        own = covariance[known][:, :, known].reshape(2 * int(known.sum()), -1)
        expected = float(np.trace(own))
        if expected <= 0:
            return None
        return cls(float(np.sqrt(np.sum(missed[known] ** 2) / expected)), expected**2 / float(np.sum(own**2)))


def _beyond_training(prediction: Prediction) -> Doubt | None:
    beyond = int(prediction.extrapolated.sum())
    if not beyond:
        return None
    far = float(np.nanmax(prediction.distance_rad))
    expected = float(np.sqrt(np.nanmean(prediction.sigma_beam_rad**2)))
    return Doubt(
        "test_positions_beyond_training",
        f"{beyond} of {len(prediction.extrapolated)} test positions lie beyond those of training, "
        f"up to {np.degrees(far):.0f} degrees away; expect errors of about {1e3 * expected:.2g} mrad of the beam",
        {"beyond_count": beyond, "farthest_rad": far, "expected_beam_rad": expected},
    )


def _ordered(name: str, order: IntArray, first: int, last: int, note: str) -> Split:
    train, test = np.zeros(order.size, dtype=np.bool_), np.zeros(order.size, dtype=np.bool_)
    train[order[:first]] = True
    test[order[order.size - last :]] = True
    return Split(name, freeze(train), freeze(test), note)


def _column_split(column: Sequence[str] | None, count: int) -> Split:
    if column is None or len(column) != count:
        raise InputError(f"split column: {count} entries are needed, not {0 if column is None else len(column)}")
    words = np.array([entry.strip().lower() for entry in column], dtype=np.str_)
    train, test = words == "train", np.isin(words, ("test", "validation"))
    if not (train.any() and test.any()):
        raise InputError("split column: rows marked train and rows marked test or validation are needed")
    return Split("column", freeze(np.asarray(train)), freeze(np.asarray(test)), "as in the table")


def _loneliness(suns: FloatArray) -> FloatArray:
    """Mean angle to the nearest neighbours."""
    angles = np.arccos(np.clip(suns @ suns.T, -1.0, 1.0))
    np.fill_diagonal(angles, np.inf)
    neighbours = min(_NEIGHBOURS, len(suns) - 1)
    return np.asarray(np.sort(angles, axis=1)[:, :neighbours].mean(axis=1))


class _Angles(NamedTuple):
    """RMS, median and largest of angles [rad]."""

    rms_rad: float
    median_rad: float
    max_rad: float


def _angles(angles: FloatArray) -> _Angles:
    known = angles[np.isfinite(angles)]
    if not known.size:
        return _Angles(np.nan, np.nan, np.nan)
    return _Angles(float(np.sqrt(np.mean(known**2))), float(np.median(known)), float(known.max()))
