"""A plan of a laser scan: what the measurement will be worth, from its measurement.toml before there is a scan."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from deflectometry.laser.keys import LaserModel
from deflectometry.laser.pipeline.measure import doubts_of_sigmas, evaluate_scan
from deflectometry.laser.pipeline.scan_file import FEWEST_BEAMS
from deflectometry.laser.planning.keys import LaserPlanSection
from deflectometry.laser.planning.predicted_scan import predicted_beams, predicted_lines
from deflectometry.laser.scan import LaserScan
from deflectometry.pipeline.choices import Options
from deflectometry.planning.pipeline.changed_values import changed_model, value_of
from deflectometry.planning.pipeline.plan import PlanResult, run_plan
from deflectometry.planning.prospect import NOISE, Change, FacetProspect, Prospect
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError
from heliogauge.files.memory import refuse_large
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Quadric
from heliogauge.measurement.designs import build_design
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import FloatArray

#: Memory that a beam takes at the least: 11,000 bytes were seen with 40,000 of them.
_BEAM_BYTES = 1000
#: Sigmas of what all beams share: key, and what it is of.
_SHARED = {
    "mirror.sigma_distance_mm": "the mirror's distance",
    "mirror.sigma_offset_mm": "the mirror's place beside the laser",
    "scan.sigma_laser_place_mm": "the laser's place on the target",
    "scan.sigma_target_scale_permille": "the target's scale",
    "scan.sigma_angle_scale_permille": "the scale of the beams' angles",
    "scan.sigma_roll_mrad": "the roll between beams and target",
}
#: Distances that are tried, over the planned one; scans in place of one: their mean has half of the noise.
_DISTANCE_FACTORS, _SCANS = (0.8, 1.25), 4


@dataclass(frozen=True, slots=True, eq=False)
class _Sent:
    """Beams that will be sent, with the spots that will be seen.

    unclear: How many have none because their lines cross more than once, or one of them is a point there.
    away: How many come back to no target, however large.
    """

    scan: LaserScan
    unclear: int
    away: int


@dataclass(frozen=True, slots=True, eq=False)
class PlannedScan:
    """A laser before a mirror, to be looked at before there is a scan."""

    folder: Path
    model: LaserModel

    @property
    def name(self) -> str:
        """Name of the mirror."""
        return self.model.name

    @property
    def plan(self) -> LaserPlanSection:
        """What is planned.

        InputError: Nothing is, or more than the free memory holds.
        """
        if self.model.plan is None:
            raise InputError(
                f"{self.folder / MEASUREMENT_FILE}: [plan] is missing; give width_m and height_m of the mirror, and "
                "columns and rows of beams"
            )
        plan = self.model.plan
        where = f"{self.folder / MEASUREMENT_FILE}: [plan]"
        refuse_large(where, _BEAM_BYTES * plan.columns * plan.rows, f"{plan.columns} x {plan.rows} beams")
        return plan

    def prospect(self) -> Prospect:
        """Return what the measurement will be worth.

        InputError, EstimationError: As for `deflectometry.planning.prospect.PlannedSource`.
        """
        plan, mirror = self.plan, self.model.mirror
        laser_m = np.array([-mirror.offset_m[0], -mirror.offset_m[1], mirror.distance_m])
        design = build_design(mirror)
        sent = self._sent(plan, design, laser_m)
        scan = sent.scan
        count = int(np.count_nonzero(scan.seen))
        hole = _hole(sent, plan)
        if count < FEWEST_BEAMS:
            raise EstimationError(
                f"{count} of {scan.seen.size} beams will have a spot, and {FEWEST_BEAMS} are needed: "
                f"{hole or 'send more'}"
            )
        one = evaluate_scan(self.model, scan, Options(), SilentProgress())
        share = count / scan.seen.size
        reach = np.nanmax(np.abs(scan.spots_m[:2]), axis=1)
        return Prospect(
            slope_map=one.as_measured,
            numbers=one.numbers,
            facets=(FacetProspect("mirror", share, hole, one.as_measured, RigidTransform.identity()),),
            spacing_m=float(np.sqrt(plan.width_m * plan.height_m / scan.seen.size)),
            samples=count,
            texts={
                "target": f"spots reach {reach[0]:.3g} m to the sides and {reach[1]:.3g} m up and down from the laser"
            },
            doubts=(
                *doubts_of_sigmas(self.model),
                *_doubts(share, hole),
                *_doubts_of_target(plan, laser_m, reach),
            ),
        )

    def _sent(self, plan: LaserPlanSection, design: Quadric, laser_m: FloatArray) -> _Sent:
        """Return all beams with the spots that will be seen, and why others will not be."""
        endless = plan.model_copy(update={"target_m": None})
        if self.model.scan.lines_file is None:
            scan, without_rim = predicted_beams(plan, design, laser_m), predicted_beams(endless, design, laser_m)
            return _Sent(scan, 0, int(np.count_nonzero(~without_rim.seen)))
        sigma_spot_m = 1e-3 * self.model.scan.sigma_spot_mm
        crossed = predicted_lines(plan, design, laser_m, sigma_spot_m)
        every = crossed if plan.target_m is None else predicted_lines(endless, design, laser_m, sigma_spot_m)
        return _Sent(
            crossed.scan,
            # What is clear on an endless target was cut off by the rim of this one.
            int(np.count_nonzero(crossed.unclear & every.unclear)),
            int(np.count_nonzero(~(every.scan.seen | every.unclear))),
        )

    def limits(self, prospect: Prospect) -> Mapping[str, Mapping[str, float]]:
        """Return the share of each variance that would go if an input were exact, and that of the noise.

        The curl of the slopes ties the inputs together: each is taken out alone, so that shares need not add up to one.
        """
        before, noise = prospect.sigmas(), prospect.limits()
        found = {name: {NOISE: shares[NOISE]} for name, shares in noise.items()}
        for key, words in _SHARED.items():
            if value_of(self.model, key):
                after = self._changed({key: None}).prospect().sigmas()
                for name, sigma in before.items():
                    found[name][words] = max(1.0 - (after[name] / sigma) ** 2, 0.0) if sigma > 0 else 0.0
        return found

    def changes(self) -> Iterator[Change]:
        """Yield what might be done otherwise."""
        plan, mirror, scan = self.plan, self.model.mirror, self.model.scan
        for factor in _DISTANCE_FACTORS:
            yield self._change(
                f"the laser at {factor * mirror.distance_m:.3g} m instead of {mirror.distance_m:.3g} m",
                "mirror.distance_m",
                factor * mirror.distance_m,
            )
        for key, words in _SHARED.items():
            sigma = value_of(self.model, key)
            if sigma:
                yield self._change(f"{words} known twice as well", key, 0.5 * sigma, words)
        # Each beam has both by itself.
        own = {"scan.sigma_spot_mm": scan.sigma_spot_mm, "scan.sigma_direction_mrad": scan.sigma_direction_mrad}
        own = {key: sigma for key, sigma in own.items() if sigma}
        less = {key: sigma / _SCANS**0.5 for key, sigma in own.items()}
        yield Change(
            f"the mean of {_SCANS} scans",
            ", ".join(own),
            ", ".join(f"{one:g}" for one in own.values()),
            ", ".join(f"{one:g}" for one in less.values()),
            self._changed(less),
            (NOISE,),
        )
        more = self._changed({"plan.columns": 2 * plan.columns, "plan.rows": 2 * plan.rows})
        what = "beams" if scan.lines_file is None else "lines"
        yield Change(
            f"twice as many {what} each way",
            "plan.columns, plan.rows",
            f"{plan.columns}, {plan.rows}",
            f"{2 * plan.columns}, {2 * plan.rows}",
            more,
        )

    def _change(self, words: str, key: str, value: float, *betters: str) -> Change:
        before = value_of(self.model, key)
        return Change(words, key, f"{before:g}", f"{value:g}", self._changed({key: value}), betters)

    def _changed(self, values: Mapping[str, Any]) -> "PlannedScan":
        return replace(self, model=changed_model(self.model, values))


def _hole(sent: _Sent, plan: LaserPlanSection) -> str:
    """Say why beams will have no spot."""
    size = sent.scan.seen.size
    beside = int(np.count_nonzero(~sent.scan.seen)) - sent.unclear - sent.away
    said = []
    if sent.unclear:
        said.append(
            f"{sent.unclear / size:.1%} of the pairs of lines cross more than once, or where a line is no longer than "
            "its noise: come nearer to the mirror"
        )
    if sent.away:
        said.append(
            f"{sent.away / size:.1%} of the beams leave the mirror away from the laser and meet no target, however "
            "large: take twice the focal length as distance"
        )
    if beside > 0 and plan.target_m is not None:
        said.append(
            f"{beside / size:.1%} of the beams come back beside the target of {plan.target_m[0]:g} m x "
            f"{plan.target_m[1]:g} m: make it larger, or take twice the focal length as distance"
        )
    return "; ".join(said)


def _doubts(share: float, hole: str) -> Iterator[Doubt]:
    if hole:
        yield Doubt(
            "plan_beams_without_spot", f"{share:.1%} of the mirror will be measured: {hole}", {"seen_share": share}
        )


def _doubts_of_target(plan: LaserPlanSection, laser_m: FloatArray, reach_m: FloatArray) -> Iterator[Doubt]:
    """Name a target that nobody has stated and that is larger than a flat mirror's, which is twice the mirror."""
    beside = np.abs(np.array(plan.center_m) - laser_m[:2])
    flat_m = 2 * beside + np.array([plan.width_m, plan.height_m])
    if plan.target_m is None and (reach_m > flat_m).any():
        yield Doubt(
            "plan_target_large",
            f"all this takes a target of {2 * reach_m[0]:.3g} m x {2 * reach_m[1]:.3g} m around the laser, more than a "
            "flat mirror would: state plan.target_m as it is, or take twice the focal length as distance",
            {"target_width_m": float(2 * reach_m[0]), "target_height_m": float(2 * reach_m[1])},
        )


def run(folder: Path, progress: Progress | None = None) -> PlanResult:
    """Say what a laser scan will be worth, and what would better it.

    InputError, EstimationError: As for `deflectometry.planning.pipeline.plan.run_plan`.
    """
    file, model = read_measurement(folder, LaserModel)
    return run_plan(PlannedScan(folder, model), folder, (file,), progress)
