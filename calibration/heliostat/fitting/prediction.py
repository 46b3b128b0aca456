"""Where a fitted heliostat will send its beam, how sure that is, and where it was never asked."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from calibration.heliostat.fitting.drift_noise import Drift, Occasions, drive_zeros, occasions_of
from calibration.heliostat.fitting.field_fit import fit_beside
from calibration.heliostat.fitting.fit_model import REFUTED_FROM
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.fitting.priors import PRIORS
from calibration.heliostat.kinematic_model.aiming import aim
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.kinematic_model.kinematics import mirror_poses
from calibration.heliostat.observations.observations import BeamSpots, Observations, Pointings
from calibration.heliostat.observations.residuals import ObservationModel, evaluate
from heliogauge.validate import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from heliogauge.geometry.sun import Site

#: A sun farther than this from all that were used lies beyond them [rad]; the sun moves so far in 40 minutes.
FAR_RAD = float(np.radians(10.0))
#: Leverage from which a position rests on the model rather than on observations near it.
HIGH_LEVERAGE = 1.0
_BLOCKS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predicted pointing at some positions, with its uncertainty.

    readings (n, 2): Readings of both drives; NaN where the aim cannot be reached.
    usable (n,): Whether the drives can go there.
    covariance_rad2 (n, 2, 2): Covariance of the beam's direction, right and up as seen from the mirror [rad^2].
    sigma_parameters_rad (n,): Share of the parameters, root of both axes' variances [rad of the beam].
    sigma_misfit_rad (n,): Share of what the model does not describe, as the residuals show it [rad of the beam].
    sigma_noise_rad (n,): Stated sigma of the measurement at test rows, 0 where nothing is measured [rad of the
        beam].
    leverage (n,): Variance from the parameters over that of one observation.
    distance_rad (n,): Angle to the nearest sun (without suns: mirror normal) that was used [rad].
    extrapolated (n,): Whether the position lies beyond those used.
    reason length n: Why; empty where it does not.
    """

    readings: FloatArray
    usable: BoolArray
    covariance_rad2: FloatArray
    sigma_parameters_rad: FloatArray
    sigma_misfit_rad: FloatArray
    sigma_noise_rad: FloatArray
    leverage: FloatArray
    distance_rad: FloatArray
    extrapolated: BoolArray
    reason: tuple[str, ...]

    @property
    def sigma_beam_rad(self) -> FloatArray:
        """Expected angle of the beam's error (both axes), from parameters and misfit, shape (n,) [rad]."""
        return np.hypot(self.sigma_parameters_rad, self.sigma_misfit_rad)

    @property
    def sigma_normal_rad(self) -> FloatArray:
        """Half of it: the same of the mirror's normal in the plane of incidence, shape (n,) [rad]."""
        return 0.5 * self.sigma_beam_rad


def predict_rows(found: HeliostatFit, observations: Observations) -> Prediction:
    """Predict observations that the fit has not seen.

    observations: Rows with readings; their measurements are not used.
    Returns: One entry per row; the beam's sigma is the line of sight's or the normal's for other kinds.
    InputError: A row needs a camera or target that the fit does not have.

    A fit of some parameters alone is judged by what is known of all (``HeliostatFit.beside``; found here where the
    residuals refute the fit): their covariance, and how far the fit is from them.
    """
    judge = _judge(found)
    if judge is not None:
        return _predict_rows_beside(found, judge, observations)
    if found.drift is not None:
        return _predict_rows_with_drift(found, found.drift, observations)
    columns = _columns(found)
    rows = evaluate(found.design, found.values, observations, columns=columns)
    sigma = rows.sigma_beam_rad
    jacobian = _two_components(rows.jacobian, rows.owner, len(observations)) * sigma[:, None, None]
    normals = mirror_poses(
        found.design, found.values, observations.readings, observations.approach, outside="nan"
    ).normals(found.design)
    positions = observations.sun if _by_sun(found) else normals
    parameters = jacobian @ found.solution.covariance @ jacobian.transpose(0, 2, 1)
    factor = np.array([found.sigma_factors.get(kind, 1.0) for kind in observations.kind])
    misfit = np.maximum(factor**2 - 1, 0.0) * sigma**2
    whole = parameters + misfit[:, None, None] * np.eye(2)
    return _assembled(found, whole, parameters, positions, observations.readings, rows.computable, sigma)


def covariance_of_misses(found: HeliostatFit, observations: Observations, prediction: Prediction) -> FloatArray:
    """Return the covariance of the misses of all rows together, without what each was measured wrong.

    observations: Rows that the fit has not seen, n of them.
    prediction: What was predicted of them.
    Returns (n, 2, n, 2): Rows and axes, twice; the blocks of single rows are the prediction's own [rad^2].

    Rows that are predicted by one fit miss together: its parameters are wrong for all of them, and drives that stand
    off do so for days. What thirty rows show of an expected error is then no more than two or three would.
    """
    judge = _judge(found)
    if judge is not None:
        apart = _between(found, judge, observations)
        together = _moved_together(judge, observations) + apart[:, :, None, None] * apart
    else:
        together = _moved_together(found, observations)
    rows = np.arange(len(observations))
    together[rows, :, rows] = prediction.covariance_rad2
    return together


def _moved_together(found: HeliostatFit, observations: Observations) -> FloatArray:
    """Return the covariance that rows share by parameters and drives, (n, 2, n, 2) [rad^2]."""
    seen = _AlongDrives.of(found, observations)
    count = len(observations)
    by_parameter = seen.by_parameter.reshape(2 * count, -1)
    together = (by_parameter @ found.solution.covariance @ by_parameter.T).reshape(count, 2, count, 2)
    if found.drift is None:
        return together
    occasions = occasions_of(found.design, found.values, observations)
    kernel = found.drift.noise.covariance(occasions, occasions)
    followed = found.drift.shared(occasions, seen.by_drive).reshape(2 * count, -1) @ by_parameter.T
    both = (followed + followed.T).reshape(count, 2, count, 2)
    return np.asarray(together + np.einsum("icv,ij,jdv->icjd", seen.by_drive, kernel, seen.by_drive) - both)


def _judge(found: HeliostatFit) -> HeliostatFit | None:
    """Return what is known of all that may be wrong; None where the fit has it all, or nothing refutes it."""
    if found.beside is not None or found.drift is not None:
        return found.beside
    known = any(name in PRIORS for name in found.design.parameters.names)
    return fit_beside(found, None) if known and _refuted(found) and found.used.any() else None


def _predict_rows_beside(found: HeliostatFit, judge: HeliostatFit, observations: Observations) -> Prediction:
    prediction = predict_rows(judge, observations)
    return _farther(prediction, _between(found, judge, observations), prediction.readings, prediction.usable)


def _between(found: HeliostatFit, judge: HeliostatFit, observations: Observations) -> FloatArray:
    """Return how far the predictions of two fits lie apart, (n, 2) [rad]."""
    apart = []
    for one in (found, judge):
        rows = evaluate(one.design, one.values, observations)
        both = _two_components(rows.whitened[:, None], rows.owner, len(observations))[:, :, 0]
        apart.append(both * rows.sigma_beam_rad[:, None])
    return np.asarray(apart[0] - apart[1])


def _farther(prediction: Prediction, apart: FloatArray, readings: FloatArray, usable: BoolArray) -> Prediction:
    """Return a prediction that is known to lie apart, (n, 2) [rad], from the one that is given."""
    return replace(
        prediction,
        readings=readings,
        usable=usable,
        covariance_rad2=prediction.covariance_rad2 + apart[:, :, None] * apart[:, None],
        sigma_misfit_rad=np.hypot(prediction.sigma_misfit_rad, np.linalg.norm(apart, axis=1)),
    )


def _predict_rows_with_drift(found: HeliostatFit, drift: Drift, observations: Observations) -> Prediction:
    """Predict rows whose drives' zeros have to do with those of the rows that were fitted."""
    seen = _AlongDrives.of(found, observations)
    occasions = occasions_of(found.design, found.values, observations)
    covariance, parameters = seen.covariance(found, drift, occasions)
    positions = observations.sun if _by_sun(found) else occasions.normals
    noise = min(drift.noise.white, 1.0) * seen.sigma_rad
    return _assembled(found, covariance, parameters, positions, observations.readings, seen.computable, noise)


def predict_aim(found: HeliostatFit, sun: npt.ArrayLike, aim_points_m: npt.ArrayLike) -> Prediction:
    """Predict how well the heliostat hits aim points at any suns: a map over the sky, a day, a year.

    Shapes: sun (n, 3).
    aim_points_m (3,) or (n, 3): Where the beam shall go [m].
    Returns: One entry per sun; ``usable`` is False where the drives cannot point.
    InputError: Shapes that do not fit.
    """
    suns = np.atleast_2d(np.asarray(sun, dtype=np.float64))
    points = np.broadcast_to(np.asarray(aim_points_m, dtype=np.float64), suns.shape)
    aimed = aim(found.design, found.values, suns, points)
    usable = np.asarray(aimed.converged & aimed.within_limits)
    readings = np.where(usable[:, None], aimed.readings, np.nan)
    normals = np.where(usable[:, None], aimed.normals, np.nan)
    judge = _judge(found)
    if judge is not None and judge.drift is not None:
        known = _predict_aim_with_drift(judge, judge.drift, suns, points, readings, usable, normals)
        apart = np.full((len(suns), 2), np.nan)
        if usable.any():
            apart[usable] = _between(found, judge, _spots(readings[usable], suns[usable], points[usable]))
        return _farther(known, apart, readings, usable)
    if found.drift is not None:
        return _predict_aim_with_drift(found, found.drift, suns, points, readings, usable, normals)
    columns = _columns(found)
    parameters = np.full((len(suns), 2, 2), np.nan)
    if usable.any():
        rows = evaluate(
            found.design, found.values, _spots(readings[usable], suns[usable], points[usable]), columns=columns
        )
        own = _two_components(rows.jacobian, rows.owner, int(usable.sum())) * rows.sigma_beam_rad[:, None, None]
        parameters[usable] = own @ found.solution.covariance @ own.transpose(0, 2, 1)
    places = suns if _by_sun(found) else normals
    whole = parameters + _typical_misfit(found) ** 2 * np.eye(2)
    return _assembled(found, whole, parameters, places, readings, usable, np.zeros(len(suns)))


def _spots(readings: FloatArray, suns: FloatArray, points: FloatArray) -> Observations:
    """Return beams as if seen at the aim points with a sigma of 1 m: whitened times 1 / distance is the angle."""
    return Observations((BeamSpots.at_points(Pointings(readings), suns, points, 1.0, ("",) * len(suns)),))


def _predict_aim_with_drift(
    found: HeliostatFit,
    drift: Drift,
    suns: FloatArray,
    points: FloatArray,
    readings: FloatArray,
    usable: BoolArray,
    normals: FloatArray,
) -> Prediction:
    """Predict aims on days of which nothing is known but how far the drives' zeros wander."""
    covariance, parameters = np.full((len(suns), 2, 2), np.nan), np.full((len(suns), 2, 2), np.nan)
    if usable.any():
        spots, count = _spots(readings[usable], suns[usable], points[usable]), int(usable.sum())
        # Nothing is measured there: what exceeds the stated sigma is the misfit of the rows that were used.
        seen = replace(_AlongDrives.of(found, spots), sigma_rad=np.full(count, _white_rad(found)))
        unknown = Occasions(np.full(count, np.nan), normals[usable])
        covariance[usable], parameters[usable] = seen.covariance(found, drift, unknown)
    places = suns if _by_sun(found) else normals
    return _assembled(found, covariance, parameters, places, readings, usable, np.zeros(len(suns)))


def _white_rad(found: HeliostatFit) -> float:
    """Stated sigma of the rows used, root mean square [rad]."""
    sigma = found.residuals.sigma_beam_rad[found.used]
    known = sigma[np.isfinite(sigma)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _AlongDrives:
    """How the beams of some rows move.

    by_parameter (n, 2, k): With the free parameters, in the order of the design [rad].
    by_drive (n, 2, 2): With the angle of each drive [rad/rad].
    sigma_rad (n,): Stated sigma of each row [rad].
    computable (n,): Whether the readings lie within the geometry of the actuators.
    """

    by_parameter: FloatArray
    by_drive: FloatArray
    sigma_rad: FloatArray
    computable: BoolArray

    @classmethod
    def of(cls, found: HeliostatFit, observations: Observations) -> "_AlongDrives":
        """Differentiate at the fit."""
        columns = _columns(found)
        both = np.concatenate([columns, found.design.parameters.indices(drive_zeros(found.design))])
        order = np.unique(both)
        rows = evaluate(found.design, found.values, observations, columns=order)
        sigma = rows.sigma_beam_rad
        moved = _two_components(rows.jacobian, rows.owner, len(observations)) * sigma[:, None, None]
        moved = moved[:, :, np.searchsorted(order, both)]
        return cls(moved[:, :, : columns.size], moved[:, :, columns.size :], sigma, rows.computable)

    def covariance(self, found: HeliostatFit, drift: Drift, occasions: Occasions) -> tuple[FloatArray, FloatArray]:
        """Covariance of what the fit predicts wrong, without the stated noise, and the parameters' own share of it.

        occasions: When and where to, n of them. Near those of the fit its parameters have followed the drives' zeros
        a part of the way.
        Returns (n, 2, 2), (n, 2, 2): [rad^2].
        """
        noise = drift.noise
        parameters = self.by_parameter @ found.solution.covariance @ self.by_parameter.transpose(0, 2, 1)
        total = parameters + noise.drive_variance_rad2 * (self.by_drive @ self.by_drive.transpose(0, 2, 1))
        followed = drift.shared(occasions, self.by_drive) @ self.by_parameter.transpose(0, 2, 1)
        total = total - followed - followed.transpose(0, 2, 1)
        misfit = np.maximum(noise.white**2 - 1, 0.0) * self.sigma_rad**2
        return total + misfit[:, None, None] * np.eye(2), parameters


def _assembled(
    found: HeliostatFit,
    covariance: FloatArray,
    parameters: FloatArray,
    positions: FloatArray,
    readings: FloatArray,
    usable: BoolArray,
    noise: FloatArray,
) -> Prediction:
    """Assemble a prediction; the misfit's share is what the parameters leave of the whole."""
    whole = np.trace(covariance, axis1=1, axis2=2)
    own = np.minimum(np.trace(parameters, axis1=1, axis2=2), whole)
    sigma = (found.factor * found.residuals.sigma_beam_rad)[found.used]
    one = 2 * float(np.mean(sigma**2)) if sigma.size else float("nan")
    leverage, distance = own / one, _nearest(positions, _used_positions(found))
    reasons = tuple(_why(*pair) for pair in zip(distance, leverage, strict=True))
    return Prediction(
        readings,
        usable,
        covariance,
        np.sqrt(own),
        np.sqrt(whole - own),
        np.sqrt(2.0) * noise,
        leverage,
        distance,
        np.array([bool(reason) for reason in reasons], dtype=np.bool_),
        reasons,
    )


def sky_blocks(seen: Observations, among: BoolArray) -> tuple[BoolArray, ...]:
    """Cut some rows, (n,), into four runs of neighbouring sun azimuth (of the first reading where there is no sun)."""
    azimuth = np.mod(np.arctan2(seen.sun[:, 0], seen.sun[:, 1]), 2 * np.pi)
    key = azimuth if np.isfinite(azimuth).all() else seen.readings[:, 0]
    rows = np.flatnonzero(among)
    blocks = []
    for part in np.array_split(rows[np.argsort(key[rows], kind="stable")], _BLOCKS):
        mask = np.zeros(len(seen), dtype=np.bool_)
        mask[part] = True
        blocks.append(mask)
    return tuple(blocks)


def tracking_error(
    calibrated: HeliostatDesign,
    truth: HeliostatDesign,
    sun: npt.ArrayLike,
    aim_point_m: npt.ArrayLike,
    *,
    believed_aim_m: npt.ArrayLike | None = None,
) -> FloatArray:
    """Return by how much the beam of a true heliostat misses when a calibrated model commands it.

    Shapes: sun (n, 3).
    calibrated, truth: The model that computes the readings, and the heliostat that takes them.
    aim_point_m (3,) or (n, 3): Where the beam shall go [m].
    believed_aim_m (3,) or (n, 3): Where the model takes that point to be, if it was calibrated with the heliostat
        [m].
    Returns (n, 2): Beam minus aim, right and up as seen from the mirror [rad]; NaN where the model cannot point.
    InputError: Shapes that do not fit.
    """
    suns = np.atleast_2d(np.asarray(sun, dtype=np.float64))
    points = np.broadcast_to(np.asarray(aim_point_m, dtype=np.float64), suns.shape)
    believed = points if believed_aim_m is None else np.broadcast_to(np.asarray(believed_aim_m), suns.shape)
    aimed = aim(calibrated, calibrated.parameters.values, suns, believed)
    known = np.isfinite(aimed.readings).all(axis=1) & aimed.converged
    error = np.full((len(suns), 2), np.nan)
    if known.any():
        seen = BeamSpots.at_points(
            Pointings(aimed.readings[known]), suns[known], points[known], 1.0, ("",) * int(known.sum())
        )
        # Seen at the aim point minus predicted by the truth, the other way round.
        error[known] = -ObservationModel(truth, Observations((seen,))).evaluate(truth.parameters.values).beam_rad
    return error


@dataclass(frozen=True, slots=True, eq=False)
class YearlyError:
    """Tracking error over a year (Gouws 2018, chapter 6).

    error_rad (n, 2): Beam minus aim, right and up [rad]; NaN where the heliostat cannot point.
    day (n,): Which of the days.
    """

    error_rad: FloatArray
    day: IntArray

    @property
    def angle_rad(self) -> FloatArray:
        """Length of each error, shape (n,) [rad of the beam]."""
        return np.hypot(self.error_rad[:, 0], self.error_rad[:, 1])

    @property
    def daily_mean_rad(self) -> FloatArray:
        """Mean length of the errors of each day [rad of the beam]."""
        return np.array([np.nanmean(self.angle_rad[self.day == day]) for day in np.unique(self.day)])

    @property
    def daily_offset_rad(self) -> FloatArray:
        """Length of the mean error of each day: what a shifted aim point would remove [rad of the beam]."""
        means = [np.nanmean(self.error_rad[self.day == day], axis=0) for day in np.unique(self.day)]
        return np.asarray(np.linalg.norm(means, axis=1))

    @property
    def mean_rad(self) -> float:
        """Mean over the days of the daily mean [rad of the beam]."""
        return float(np.mean(self.daily_mean_rad))


def yearly_evaluation(
    calibrated: HeliostatDesign,
    truth: HeliostatDesign,
    site: "Site",
    aim_point_m: npt.ArrayLike,
    *,
    year: int = 2018,
    believed_aim_m: npt.ArrayLike | None = None,
) -> YearlyError:
    """Return the tracking error at 35 suns on the tenth day of every month.

    Shapes: believed_aim_m (3,).
    aim_point_m (3,): Where the beam shall go [m].
    InputError: Shapes that do not fit.
    """
    suns, day = sun_positions_of_year(site, year)
    return YearlyError(tracking_error(calibrated, truth, suns, aim_point_m, believed_aim_m=believed_aim_m), day)


def sun_positions_of_year(
    site: "Site", year: int, *, day_of_month: int = 10, per_day: int = 35, least_elevation_rad: float = 0.0
) -> tuple[FloatArray, IntArray]:
    """Return suns spread evenly over the daylight of one day of each month.

    Shapes: sun (n, 3).
    day (n,): Month of each, 1 to 12.
    """
    from heliogauge.geometry.sun import sun_directions

    parts, days = [], []
    for month in range(1, 13):
        # Local solar midnight, so that no day of daylight is cut in two.
        midnight = np.datetime64(f"{year:04d}-{month:02d}-{day_of_month:02d}T00:00", "ms")
        midnight -= np.timedelta64(round(site.longitude_deg / 15 * 3600e3), "ms")
        minutes = midnight + np.arange(1440) * np.timedelta64(60_000, "ms")
        suns = sun_directions(minutes, site)
        light = np.flatnonzero(suns[:, 2] > np.sin(least_elevation_rad))
        if not light.size:
            continue
        chosen = np.linspace(light[0], light[-1], per_day).round().astype(np.int64)
        parts.append(suns[chosen])
        days.append(np.full(per_day, month, dtype=np.int64))
    return np.concatenate(parts), np.concatenate(days)


def _refuted(found: HeliostatFit) -> bool:
    """Whether the residuals exceed the stated sigmas by more than sigmas are known: the model lacks something."""
    return max(found.sigma_factors.values(), default=1.0) > REFUTED_FROM


def _columns(found: HeliostatFit) -> IntArray:
    return np.flatnonzero(found.design.parameters.free)


def _by_sun(found: HeliostatFit) -> bool:
    return bool(np.isfinite(found.observations.sun).all())


def _two_components(jacobian: FloatArray, owner: IntArray, count: int) -> FloatArray:
    """First two components of each row, (n, 2, k); points have three and no direction."""
    first = np.searchsorted(owner, np.arange(count))
    return np.stack([jacobian[first], jacobian[first + 1]], axis=1)


def _typical_misfit(found: HeliostatFit) -> float:
    """Misfit per axis of the rows used [rad]: by what the estimated sigma exceeds the stated one."""
    sigma, factor = found.residuals.sigma_beam_rad[found.used], found.factor[found.used]
    square = np.maximum(factor**2 - 1, 0.0) * sigma**2
    known = square[np.isfinite(square)]
    return float(np.sqrt(known.mean())) if known.size else 0.0


def _used_positions(found: HeliostatFit) -> FloatArray:
    seen = found.observations
    if _by_sun(found):
        return np.asarray(seen.sun[found.used])
    poses = mirror_poses(found.design, found.values, seen.readings[found.used], outside="nan")
    return poses.normals(found.design)


def _nearest(positions: FloatArray, used: FloatArray) -> FloatArray:
    if not len(used):
        return np.full(len(positions), np.pi)
    # The chord keeps digits where the arc cosine loses them: 1e-8 rad at distance 0.
    chord = np.linalg.norm(positions[:, None, :] - used[None, :, :], axis=2)
    return np.asarray(2 * np.arcsin(np.minimum(chord.min(axis=1) / 2, 1.0)))


def _why(distance: float, leverage: float) -> str:
    parts = []
    if distance > FAR_RAD:
        parts.append(f"{np.degrees(distance):.0f} degrees from the nearest position used")
    if leverage > HIGH_LEVERAGE:
        parts.append(f"leverage {leverage:.1f}: the observations determine it less than one made there would")
    return "; ".join(parts)
