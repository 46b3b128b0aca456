"""A plan of a scan of the surface: what it will be worth, from its measurement.toml before there are points."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from deflectometry.pipeline.choices import Options
from deflectometry.planning.pipeline.changed_values import changed_model
from deflectometry.planning.pipeline.plan import PlanResult, run_plan
from deflectometry.planning.prospect import NOISE, Change, FacetProspect, Prospect
from deflectometry.scans.keys import SurfaceScanModel
from deflectometry.scans.patch_slopes import best_patch
from deflectometry.scans.pipeline.measure import EvaluatedPoints, evaluate_points
from deflectometry.scans.pipeline.read_points import ScannedPoints
from deflectometry.scans.planning.keys import SurfacePlanSection
from deflectometry.scans.planning.predicted_points import predicted_points
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.files.memory import refuse_large
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.designs import build_design
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement
from heliogauge.running.progress import Progress, SilentProgress

#: Scans in place of one: their mean has half of the noise.
_SCANS = 4
#: Memory that a point takes at the least: 1500 bytes were seen with 160,000 of them, 21,000 with 40,000.
_POINT_BYTES = 1000
#: The predicted points have the noise of this draw.
_SEED = 1
#: What the polynomial of a patch does not follow, with what it could lose unseen.
_LOST = "waves that patches lose"


@dataclass(frozen=True, slots=True, eq=False)
class PlannedSurfaceScan:
    """A mirror before a scanner, to be looked at before there are points."""

    folder: Path
    model: SurfaceScanModel

    @property
    def name(self) -> str:
        """Name of the mirror."""
        return self.model.name

    @property
    def plan(self) -> SurfacePlanSection:
        """What is planned.

        InputError: Nothing is, or more than the free memory holds.
        """
        if self.model.plan is None:
            raise InputError(
                f"{self.folder / MEASUREMENT_FILE}: [plan] is missing; give width_m and height_m of the mirror, and "
                "columns and rows of points"
            )
        plan = self.model.plan
        where = f"{self.folder / MEASUREMENT_FILE}: [plan]"
        refuse_large(where, _POINT_BYTES * plan.columns * plan.rows, f"{plan.columns} x {plan.rows} points")
        return plan

    def prospect(self) -> Prospect:
        """Return what the scan will be worth.

        InputError, EstimationError: As for `deflectometry.planning.prospect.PlannedSource`.
        """
        found, plan = self._evaluated(), self.plan
        count = plan.columns * plan.rows
        return Prospect(
            slope_map=found.slope_map,
            numbers=found.numbers,
            facets=(FacetProspect("mirror", 1.0, "", found.slope_map, RigidTransform.identity()),),
            spacing_m=float(np.sqrt(plan.width_m * plan.height_m / count)),
            samples=count,
            doubts=(*found.doubts, *self._doubts_of_waves()),
        )

    def _evaluated(self) -> EvaluatedPoints:
        """Return what the measurement's own evaluation makes of predicted points."""
        plan, points = self.plan, self.model.points
        if points.sigma_point_mm is None:
            raise InputError(
                f"{self.folder / MEASUREMENT_FILE}: [points] sigma_point_mm is missing; before there are points it "
                "cannot be found from them: give what the scanner is good for"
            )
        normal_rad = 1e-3 * (points.sigma_normal_mrad or 0.0)
        design = build_design(self.model.mirror)
        place, normals = predicted_points(plan, design, 1e-3 * points.sigma_point_mm, normal_rad, _SEED)
        # Predicted points are in the mirror's frame: the scanner is somewhere before it.
        before = plan.center_m[0], plan.center_m[1], 10.0 * max(plan.width_m, plan.height_m)
        seen = points.model_copy(update={"scanner_m": before, "x_axis": (1.0, 0.0, 0.0)})
        scanned = ScannedPoints(place, normals if points.slopes_from == "normals" else None)
        model = self.model.model_copy(update={"points": seen})
        return evaluate_points(model, scanned, "the predicted points", Options(), SilentProgress())

    def _doubts_of_waves(self) -> Iterator[Doubt]:
        if self.plan.wave_mrad is None and self.model.points.slopes_from == "points":
            yield Doubt(
                "plan_without_waves",
                "no waves are stated in [plan] (wave_mrad, wave_length_m): the mirror is taken to have the design's "
                "shape, and large patches to lose nothing; slopes of a real mirror are less certain",
            )

    def limits(self, prospect: Prospect) -> Mapping[str, Mapping[str, float]]:
        """Return the share of each source of errors in each variance: of slopes also that of what patches lose."""
        found = {name: dict(shares) for name, shares in prospect.limits().items()}
        patches = self._evaluated().patches
        if patches:
            side_mm = self.model.evaluation.patch_mm
            patch = best_patch(list(patches))
            if side_mm is not None:
                patch = min(patches, key=lambda one: abs(one.side_m - 1e-3 * side_mm))
            square, lost = patch.noise_rad**2, np.nan_to_num(patch.lost_rad) ** 2
            for name, share in zip(("slope_x", "slope_y"), (lost / (square + lost)).tolist(), strict=True):
                both = found[name][NOISE]
                found[name] |= {NOISE: (1 - share) * both, _LOST: share * both}
        return found

    def changes(self) -> Iterator[Change]:
        """Yield what might be done otherwise."""
        plan, points = self.plan, self.model.points
        yield Change(
            "twice as many points each way",
            "plan.columns, plan.rows",
            f"{plan.columns}, {plan.rows}",
            f"{2 * plan.columns}, {2 * plan.rows}",
            self._changed({"plan.columns": 2 * plan.columns, "plan.rows": 2 * plan.rows}),
        )
        own = {"points.sigma_point_mm": points.sigma_point_mm, "points.sigma_normal_mrad": points.sigma_normal_mrad}
        known = {key: sigma for key, sigma in own.items() if sigma}
        less = {key: sigma / _SCANS**0.5 for key, sigma in known.items()}
        yield Change(
            f"the mean of {_SCANS} scans of the same points",
            ", ".join(known),
            ", ".join(f"{one:g}" for one in known.values()),
            ", ".join(f"{one:g}" for one in less.values()),
            self._changed(less),
            (NOISE,),
        )
        if points.sigma_scale_ppm:
            half = 0.5 * points.sigma_scale_ppm
            yield Change(
                "the scanner's scale known twice as well",
                "points.sigma_scale_ppm",
                f"{points.sigma_scale_ppm:g}",
                f"{half:g}",
                self._changed({"points.sigma_scale_ppm": half}),
            )

    def _changed(self, values: Mapping[str, Any]) -> "PlannedSurfaceScan":
        return replace(self, model=changed_model(self.model, values))


def run(folder: Path, progress: Progress | None = None) -> PlanResult:
    """Say what a scan of the surface will be worth, and what would better it.

    InputError, EstimationError: As for `deflectometry.planning.pipeline.plan.run_plan`.
    """
    file, model = read_measurement(folder, SurfaceScanModel)
    return run_plan(PlannedSurfaceScan(folder, model), folder, (file,), progress)
