"""Terms that a healthy heliostat's residuals do not contain: of its drives, of time, of the sun, of the targets."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.heliostat.diagnosis.linear_model import Windows
from calibration.heliostat.diagnosis.rows import SAME_SPOT_M, coordinates_on_targets
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.kinematic_model.actuators import drive_angle
from calibration.heliostat.kinematic_model.design import (
    POSITION,
    HeliostatDesign,
    LinearActuator,
    PlaneTarget,
    RotaryDrive,
)
from calibration.heliostat.kinematic_model.kinematics import MirrorPoses, mirror_poses
from calibration.heliostat.observations.beam_observations import BeamSpots, SunInCamera
from calibration.heliostat.observations.observations import Group, Observations
from calibration.heliostat.observations.residuals import predicted_spots, whitened_at
from heliogauge.geometry.rigid import rotation_from_vector
from heliogauge.geometry.sun import Site
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray, TimeArray

#: The sky turns once a day [rad/s].
SKY_RAD_PER_S = 2 * np.pi / 86400
#: What the scale of spots, and their mirroring, is about.
SPOTS = "spots on the targets"
# Steps of the differences: 2 s of the sky, 1 mm of a spot.
_TURN_RAD, _STEP_M = 1e-4, 1e-3
# Spots may lie this far beyond the edge, as a share of the target.
_MARGIN = 1.1
# The reading before gives the direction of the last move on the same day only: at night the mirror was stowed.
_LATEST = np.timedelta64(12, "h")
# A period that fits in less than so often cannot be separated from a smooth misfit; more often than so, from noise.
_FEWEST_CYCLES, _MOST_CYCLES = 1.5, 40.0


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """Something that residuals could contain.

    kind: A key of `REMEDIES`.
    name: What it is, for people.
    columns (looks, m, q): Derivatives of the whitened residuals by its q coefficients; several looks where a number
        (a date, a period) has to be found.
    names length q: Its coefficients with units.
    at (looks,): The number of each look.
    columns_at: Makes the columns at any such numbers, to look closer about the best.
    spans (looks, 2): Of an episode: first day, and first day after it; empty for all others.
    voting (n,): Rows among those looked at in which it shall explain something; None for all.
    """

    kind: str
    name: str
    columns: FloatArray | Windows
    names: tuple[str, ...]
    at: FloatArray
    columns_at: Callable[[FloatArray], FloatArray] | None = None
    spans: TimeArray = field(default_factory=lambda: np.empty((0, 2), dtype="datetime64[D]"))
    voting: BoolArray | None = None


def _single(kind: str, name: str, columns: FloatArray, *names: str) -> Term:
    return Term(kind, name, columns[None], names, np.zeros(1))


@dataclass(frozen=True, slots=True, eq=False)
class Terms(ShortRepr):
    """Makes the terms of a fit.

    rows (n,): Rows that are looked at; all must be computable.
    chosen: Components of the rows.
    owner (m,), factor (m,): Row of each component, and the factor on its stated sigma.
    """

    fit: HeliostatFit
    rows: BoolArray
    chosen: BoolArray = field(init=False)
    owner: IntArray = field(init=False)
    factor: FloatArray = field(init=False)
    _poses: list[MirrorPoses] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        chosen = self.rows[self.fit.residuals.owner]
        owner = self.fit.residuals.owner[chosen]
        object.__setattr__(self, "chosen", chosen)
        object.__setattr__(self, "owner", owner)
        object.__setattr__(self, "factor", self.fit.factor[owner])

    def by(self, name: str) -> FloatArray:
        """Return the derivative of the components by a parameter, shape (m,)."""
        column = self.fit.residuals.jacobian[:, self.fit.design.parameters.index(name)]
        return np.asarray(column[self.chosen] / self.factor)

    def by_axis(self, axis: int) -> FloatArray:
        """Return the derivative by the angle of a drive, shape (m,)."""
        drive = self.fit.design.drives[axis]
        if isinstance(drive, RotaryDrive):
            return drive.offset_sign * self.by(drive.offset)
        return self.by(drive.initial_angle)

    def angle(self, axis: int) -> FloatArray:
        """Return the angle of a drive for each component, shape (m,) [rad]."""
        design = self.fit.design
        numbers = dict(zip(design.parameters.names, self.fit.values.tolist(), strict=True))
        angles = drive_angle(design.drives[axis], numbers, self.fit.observations.readings[:, axis]).angle_rad
        return np.asarray(angles[self.owner])

    def moved(self, observations: Observations, step: float) -> FloatArray:
        """Return the derivative by what changed the observations, but not their readings, shape (m,)."""
        # With the nominal design, as the fit did it: its numbers choose axes and weights.
        nominal, values, seen = self.fit.nominal, self.fit.values, self.fit.observations
        if not self._poses:
            self._poses.append(mirror_poses(nominal, values, seen.readings, seen.approach, outside="nan"))
        difference = whitened_at(nominal, values, observations, self._poses[0]) - self.fit.residuals.whitened
        return np.asarray(difference[self.chosen] / self.factor / step)

    # --- drives -------------------------------------------------------------------------------------------------------

    def drives(self) -> list[Term]:
        """Return backlash, sag, scale and periodic error of both drives."""
        terms = self._backlash()
        for axis in (0, 1):
            by_axis, angle, name = self.by_axis(axis), self.angle(axis), f"axis {axis + 1}"
            bent = by_axis[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            terms.append(_single("sag", name, bent, "cos_rad", "sin_rad"))
            if isinstance(self.fit.design.drives[axis], RotaryDrive):
                terms.append(_single("scale", name, (by_axis * (angle - angle.mean()))[:, None], "scale"))
            worm = self._worm(axis, by_axis, angle)
            terms += [worm] if worm is not None else []
        return terms

    def _backlash(self) -> list[Term]:
        approach, found = approaches(self.fit.observations)[self.owner], []
        for axis in (0, 1):
            side = approach[:, axis]
            if len(np.unique(side[side != 0])) == 2:
                columns = (self.by_axis(axis) * side / 2)[:, None]
                found.append(_single("backlash", f"axis {axis + 1}", columns, f"play_{axis + 1}_rad"))
        if len(found) == 2:
            both = np.concatenate([found[0].columns[0], found[1].columns[0]], axis=1)
            found.append(_single("backlash", "both axes", both, *found[0].names, *found[1].names))
        return found

    # --- numbers ------------------------------------------------------------------------------------------------------

    def numbers(self) -> list[Term]:
        """Return what the priors hold of actuators and place: whether the observations contradict them."""
        parameters, design = self.fit.nominal.parameters, self.fit.design
        free = np.isfinite(parameters.sigmas) & parameters.free
        held = {name for name, is_free in zip(parameters.names, free, strict=True) if is_free}
        found = []
        kinds = (("actuator_numbers", "the actuators", actuator_names(design)), ("position", "the place", POSITION))
        for kind, name, members in kinds:
            names = tuple(one for one in members if one in held)
            if names:
                columns = np.stack([self.by(one) * parameters.sigma(one) for one in names], axis=1)
                found.append(_single(kind, name, columns, *names))
        return found

    def _worm(self, axis: int, by_axis: FloatArray, angle: FloatArray) -> Term | None:
        drive = self.fit.design.drives[axis]
        phase, turn = angle, 2 * np.pi
        if isinstance(drive, LinearActuator):
            increment = self.fit.design.parameters.value(drive.increment)
            phase, turn = self.fit.observations.readings[self.owner, axis] / increment, 1.0
        span = float(np.ptp(phase))
        if span == 0 or self.rows.sum() < 12:
            return None
        # Half as many cycles as rows can be separated; steps of a third of a cycle over the span miss no period.
        most = min(_MOST_CYCLES, self.rows.sum() / 2)
        cycles = np.arange(_FEWEST_CYCLES, max(most, _FEWEST_CYCLES + 0.1), 1 / 3)
        numbers = cycles / span * turn

        # Components of a row share its phase.
        first, row = np.unique(self.owner, return_index=True, return_inverse=True)[1:]
        centred = (phase - phase.mean())[first]

        def columns_at(numbers: FloatArray) -> FloatArray:
            waves = 2 * np.pi / turn * numbers[:, None] * centred
            columns = np.empty((numbers.size, row.size, 2))
            columns[:, :, 0], columns[:, :, 1] = np.cos(waves)[:, row] * by_axis, np.sin(waves)[:, row] * by_axis
            return columns

        name = f"axis {axis + 1}"
        return Term("worm_gear", name, columns_at(numbers), ("cos_rad", "sin_rad"), numbers, columns_at)

    # --- sun ----------------------------------------------------------------------------------------------------------

    def sun(self, site: Site | None) -> list[Term]:
        """Return an offset of all times, and refraction."""
        kinds = (BeamSpots, SunInCamera)
        if not any(isinstance(group, kinds) and len(group) for group in self.fit.observations.groups):
            return []
        lifted = with_suns(self.fit.observations, _lifted)
        terms = [_single("refraction", "the sun", self.moved(lifted, _TURN_RAD)[:, None], "share")]
        if site is not None:
            later = turned_sky(self.fit.observations, site, _TURN_RAD / SKY_RAD_PER_S)
            terms.append(
                _single("time_offset", "the clock", self.moved(later, _TURN_RAD / SKY_RAD_PER_S)[:, None], "offset_s")
            )
        return terms

    # --- targets ------------------------------------------------------------------------------------------------------

    def targets(self, targets: Mapping[str, PlaneTarget]) -> list[Term]:
        """Return the place of each target but the first, and the scale of spots on them."""
        labels = np.array(self.fit.observations.label, dtype=np.str_)
        kinds = np.array(self.fit.observations.kind, dtype=np.str_)
        seen = [name for name in dict.fromkeys(labels[self.rows & (kinds == "beam")].tolist()) if name in targets]
        if not seen:
            return []
        right, up = (self.moved(_with_spots(self.fit.observations, targets, axis), _STEP_M) for axis in (0, 1))
        terms = []
        for name in seen:
            mine = (labels[self.owner] == name) & (kinds[self.owner] == "beam")
            if len(seen) > 1 and np.unique(self.owner[mine]).size >= 4:
                columns = np.stack([right * mine, up * mine], axis=1)
                terms.append(_single("target_place", f"target {name}", columns, "right_m", "up_m"))
        # Where beams should be: where they were seen holds the very errors that are looked at.
        spots = self._predicted(targets)
        measured = coordinates_on_targets(self.fit, targets)
        measured = measured[np.isfinite(measured).all(axis=1)]
        if not measured.size or np.ptp(measured, axis=0).min() < SAME_SPOT_M:
            # Beams that were steered to one place have no scale: what the fit leaves would pass for it.
            return terms
        # A row that should lie off its target, or was seen off it, is wrong for another reason and has no vote.
        votes = self._on_their_targets(targets, spots) & self._on_their_targets(targets, self._seen(targets))
        spots = np.where(votes[:, None], spots, 0.0)
        scaled = np.stack([right * spots[self.owner, 0], up * spots[self.owner, 1]], axis=1)
        term = _single("target_scale", SPOTS, scaled, "width_share", "height_share")
        terms.append(replace(term, voting=votes[self.rows]))
        return terms

    def _seen(self, targets: Mapping[str, PlaneTarget]) -> FloatArray:
        return np.nan_to_num(coordinates_on_targets(self.fit, targets), nan=np.inf)

    def _on_their_targets(self, targets: Mapping[str, PlaneTarget], spots: FloatArray) -> BoolArray:
        """Return whether spots (n, 2) lie on the targets that their rows name, with a margin of a tenth."""
        half = np.array(
            [
                (targets[name].width_m, targets[name].height_m) if name in targets else (np.nan, np.nan)
                for name in self.fit.observations.label
            ]
        )
        with np.errstate(invalid="ignore"):
            return np.asarray((np.abs(spots) <= 0.5 * _MARGIN * half).all(axis=1))

    def _predicted(self, targets: Mapping[str, PlaneTarget]) -> FloatArray:
        """Return where the fit has the beams on their targets (n, 2) [m]; 0 where on none."""
        found = []
        for group in self.fit.observations.groups:
            if isinstance(group, BeamSpots) and set(group.target) <= set(targets):
                found.append(predicted_spots(self.fit.design, self.fit.values, group, targets))
            else:
                found.append(np.zeros((len(group), 2)))
        return np.nan_to_num(np.concatenate(found))


def actuator_names(design: HeliostatDesign) -> tuple[str, ...]:
    """Return the numbers of a design's linear actuators."""
    drives = [drive for drive in design.drives if isinstance(drive, LinearActuator)]
    return tuple(
        name
        for drive in drives
        for name in (drive.initial_stroke, drive.offset, drive.pivot_radius, drive.increment, drive.initial_angle)
    )


def approaches(observations: Observations) -> FloatArray:
    """Return the direction of the last moves (n, 2): as recorded, else from the reading before, if not long ago."""
    recorded = observations.approach
    moves = np.zeros((len(observations), 2)) if recorded is None else recorded.copy()
    time, readings = observations.time, observations.readings
    known = np.flatnonzero(~np.isnat(time))
    order = known[np.argsort(time[known], kind="stable")]
    if order.size < 2:
        return moves
    recent = np.diff(time[order]) <= _LATEST
    follow = order[1:][recent]
    guessed = np.sign(np.diff(readings[order], axis=0))[recent]
    moves[follow] = np.where(moves[follow] == 0, guessed, moves[follow])
    return moves


def turned_sky(observations: Observations, site: Site, seconds: float) -> Observations:
    """Return observations with the sun so much later [s]; it turns about the pole, right to 0.3 mrad an hour."""
    latitude = np.radians(site.latitude_deg)
    pole = np.array([0.0, np.cos(latitude), np.sin(latitude)])
    turn = rotation_from_vector(-SKY_RAD_PER_S * seconds * pole)
    return with_suns(observations, lambda suns: suns @ turn.T)


def _lifted(suns: FloatArray) -> FloatArray:
    """Raise suns by a ten-thousandth of the refraction [per rad]: Saemundsson's formula at 1010 hPa and 10 deg C."""
    height = np.degrees(np.arcsin(np.clip(suns[:, 2], 0.0, 1.0)))
    bend = np.radians(1.02 / 60 / np.tan(np.radians(height + 10.3 / (height + 5.11)))) * _TURN_RAD
    flat = np.hypot(suns[:, 0], suns[:, 1])
    level = np.stack([suns[:, 1], -suns[:, 0], np.zeros(len(suns))], axis=1) / np.maximum(flat, 1e-12)[:, None]
    return np.asarray(suns + bend[:, None] * np.cross(level, suns))


def with_suns(observations: Observations, change: Callable[[FloatArray], FloatArray]) -> Observations:
    """Return observations whose directions to the sun (n, 3) were changed."""
    groups: list[Group] = []
    for group in observations.groups:
        if isinstance(group, (BeamSpots, SunInCamera)) and len(group):
            groups.append(replace(group, sun=change(group.sun)))
        else:
            groups.append(group)
    changed = Observations(tuple(groups))
    # Axes and weights rest on what was seen, not on the sun.
    changed.kept.update(observations.kept)
    return changed


def _with_spots(observations: Observations, targets: Mapping[str, PlaneTarget], axis: int) -> Observations:
    groups: list[Group] = []
    for group in observations.groups:
        if isinstance(group, BeamSpots) and len(group):
            known = {name: targets[name].axes[axis] if name in targets else np.zeros(3) for name in set(group.target)}
            steps = np.stack([known[name] for name in group.target])
            group = replace(group, spot_m=group.spot_m + _STEP_M * steps)
        groups.append(group)
    return Observations(tuple(groups))
