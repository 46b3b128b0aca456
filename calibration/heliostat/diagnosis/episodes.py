"""Episodes: the level of the axes changes for some hours or days and comes back."""

from dataclasses import dataclass

import numpy as np

from calibration.heliostat.diagnosis.findings import Finding, Severity, dates_of
from calibration.heliostat.diagnosis.linear_model import EXPLAINED_SIGMAS, FEWEST_ROWS
from calibration.heliostat.fitting.drift_noise import USUAL_NOISE
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.kinematic_model.design import RotaryDrive
from calibration.heliostat.observations.residuals import evaluate
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: So many rows of one level are a fault of the heliostat; fewer are single rows that were wrong.
FAULT_ROWS = 4
# So much of a run must lie on one level: between them a row can be wrong for another reason as well.
_ON_ONE_LEVEL = 0.8
_ROUNDS = 4
# What is as likely by chance is no episode.
_BY_CHANCE = 0.01
# A row's share in a comparison is cut here [sigma].
_CUT = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """Rows in succession that all others contradict, and the level at which they agree with them.

    members (n,): The rows.
    level_rad, sigma_rad (2,): Added to the angles of the axes, with sigma.
    lengths (n,): What is left of each row's residual on that level [sigma]; NaN for other rows.
    chance: Probability that rows which are wrong independently of one another agree so well.
    """

    members: BoolArray
    level_rad: FloatArray
    sigma_rad: FloatArray
    lengths: FloatArray
    chance: float

    def misfit(self) -> float:
        """Return the sum of squares on the level, and what its two numbers cost [BIC]."""
        left = np.minimum(self.lengths[self.members], _CUT)
        return float(left @ left) + 2 * float(np.log(2 * left.size))

    def likelier_than(self, lengths: FloatArray) -> bool:
        """Return whether the level explains the rows better than another reading of them, which has no numbers.

        lengths (n,): Of the residuals of all rows if they are read so [sigma].
        """
        other = np.minimum(np.nan_to_num(lengths[self.members], nan=_CUT), _CUT)
        return self.misfit() + 4.0 < float(other @ other)


def find_episodes(fit: HeliostatFit, excluded: BoolArray) -> tuple[Episode, ...]:
    """Find runs of rejected rows that lie on one other level, with good rows before and after them.

    fit: The fit; most of its rows are right.
    excluded (n,): Rows that are explained already.
    """
    seen, residuals = fit.observations, fit.residuals
    usable = residuals.computable & ~np.isnat(seen.time) & ~excluded & (seen.n_components == 2)
    order = np.flatnonzero(usable)[np.argsort(seen.time[usable], kind="stable")]
    wrong = fit.rejected[order]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], wrong.astype(np.int8), [0]])))
    runs = [(start, end) for start, end in edges.reshape(-1, 2).tolist() if end - start >= 2]
    found = []
    for start, end in runs:
        if np.count_nonzero(~wrong[:start]) < FEWEST_ROWS or np.count_nonzero(~wrong[end:]) < FEWEST_ROWS:
            # Nothing says that it came back: a change on a date, if anything.
            continue
        one = _on_one_level(fit, order[start:end], len(runs))
        if one is not None:
            found.append(one)
    return tuple(found)


def episode_finding(fit: HeliostatFit, episode: Episode) -> Finding:
    """Return an episode as a finding: a fault from four rows on, and beyond what the zeros of drives wander."""
    seen, rows = fit.observations, episode.members
    first, last = seen.time[rows].min(), seen.time[rows].max()
    count = int(rows.sum())
    levels = " and ".join(
        f"{1e3 * value:+.1f} +- {1e3 * sigma:.1f} mrad (axis {axis})"
        for axis, value, sigma in zip((1, 2), episode.level_rad.tolist(), episode.sigma_rad.tolist(), strict=True)
    )
    text = (
        f"From {str(first)[:16]}Z to {str(last)[:16]}Z, in {count} of {rows.size} rows, the level of the axes was off "
        f"by {levels}, and came back; these rows are left out."
    )
    evidence = {"rows_count": float(count), "rows_share": float(rows.mean())}
    for axis in (0, 1):
        evidence[f"level_{axis + 1}_rad"] = float(episode.level_rad[axis])
        evidence[f"sigma_level_{axis + 1}_rad"] = float(episode.sigma_rad[axis])
    # Drives wander anyhow, and rows of one time together: on any of the days.
    spread = USUAL_NOISE.drive_variance_rad2 + episode.sigma_rad**2
    days = np.unique(seen.time[~np.isnat(seen.time)].astype("datetime64[D]")).size
    wandering = min(1.0, days * float(np.exp(-0.5 * np.sum(episode.level_rad**2 / spread))))
    severity: Severity = "fault" if count >= FAULT_ROWS and wandering < _BY_CHANCE else "rows"
    chance = max(episode.chance, wandering)
    return Finding(
        "episode", severity, text, evidence, chance, tuple(seen.row[rows].tolist()), dates_of(seen.time[rows])
    )


def _on_one_level(fit: HeliostatFit, rows: IntArray, runs: int) -> Episode | None:
    """Find the level on which a run of rows agrees with all others."""
    mask = np.zeros(len(fit.observations), dtype=np.bool_)
    mask[rows] = True
    part, factor = fit.observations.select(mask), fit.factor[mask]
    names = [drive.offset if isinstance(drive, RotaryDrive) else drive.initial_angle for drive in fit.design.drives]
    signs = [drive.offset_sign if isinstance(drive, RotaryDrive) else 1.0 for drive in fit.design.drives]
    columns = fit.design.parameters.indices(names)
    level = np.zeros(2)
    for step in range(_ROUNDS + 1):
        values = fit.values.copy()
        values[columns] += np.array(signs) * level
        # The weights of the fit itself stand in the nominal design.
        moved = evaluate(fit.nominal, values, part, columns=columns)
        if not moved.computable.all():
            return None
        whitened = moved.whitened.reshape(-1, 2) / factor[:, None]
        jacobian = moved.jacobian.reshape(-1, 2, 2) * signs / factor[:, None, None]
        if step == _ROUNDS or np.abs(np.linalg.det(jacobian)).min() == 0:
            break
        # The median of what each row asks for: one among them may be wrong for another reason.
        level = level - np.median(np.linalg.solve(jacobian, whitened[..., None])[..., 0], axis=0)
    lengths = np.linalg.norm(whitened, axis=1)
    near = lengths < EXPLAINED_SIGMAS
    count = int(near.sum())
    if count < max(2, _ON_ONE_LEVEL * len(rows)):
        return None
    before = fit.residuals.lengths[mask] / factor
    # Rows that miss anyhow agree with the first of them by the share of the areas.
    share = min(1.0, (EXPLAINED_SIGMAS / max(float(np.median(before[near])), EXPLAINED_SIGMAS)) ** 2)
    chance = min(1.0, runs * share ** (count - 1))
    if chance > _BY_CHANCE:
        return None
    normal = np.einsum("nij,nik->jk", jacobian[near], jacobian[near])
    members, left = np.zeros(len(mask), dtype=np.bool_), np.full(len(mask), np.nan)
    members[np.flatnonzero(mask)[near]] = True
    left[mask] = lengths
    return Episode(members, level, np.sqrt(np.diag(np.linalg.inv(normal))), left, chance)
