"""A plan of fringes: what the measurement will be worth, from its measurement.toml before there are images."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deflectometry.fringes.known_point import has_open_orders
from deflectometry.fringes.planning.predicted_fringes import PredictedFringes, screen_points, sigma_of_points
from deflectometry.fringes.point_by_pose import point_by_pose
from deflectometry.keys import DeflectometryMeasurement, DeflectometryModel, FringeSetSection
from deflectometry.pipeline.images import read_known_point
from deflectometry.pipeline.inputs import build_pattern, describe_mirror, pattern_words
from deflectometry.planning.pipeline.bench import Bench, bench_changes, changed, input_files
from deflectometry.planning.pipeline.plan import PlanResult, run_plan
from deflectometry.planning.prospect import NOISE, Change, Prospect
from deflectometry.pose.find_pose import find_pose
from deflectometry.setup.patterns import FringePattern
from deflectometry.sources.noise_model import NoiseModel
from heliogauge.errors import InputError
from heliogauge.measurement.files import refuse_missing_files
from heliogauge.measurement.load import read_measurement
from heliogauge.running.progress import Progress

#: How much finer the finest fringes are tried, and how many times the frames.
_FINER, _MORE_FRAMES = 2.0, 4


@dataclass(frozen=True, slots=True, eq=False)
class PlannedFringes:
    """Fringes before a mirror, to be looked at before they are there."""

    measurement: DeflectometryMeasurement

    @property
    def name(self) -> str:
        """Name of the mirror."""
        return self.measurement.model.name

    @property
    def bench(self) -> Bench:
        """Camera, screen and mirror as they will stand."""
        return Bench.of(self.measurement, self.measurement.model.plan)

    def prospect(self) -> Prospect:
        """Return what the measurement will be worth.

        InputError, EstimationError: As for `deflectometry.planning.prospect.PlannedSource`.
        """
        bench, plan = self.bench, self.measurement.model.plan
        pattern, noise = build_pattern(self.measurement), NoiseModel(plan.noise_dn)
        known, setup, is_open = read_known_point(self.measurement), bench.setup, has_open_orders(pattern)
        is_counted = known is not None or is_open
        sigma = sigma_of_points(bench.sights, pattern, plan.contrast_dn, noise, plan.blur_px, counted=is_counted)
        camera = setup.camera
        u, v = screen_points(bench.sights, (camera.height_px, camera.width_px))
        image = bench.image(*self._edge_light(pattern))
        source = PredictedFringes(image, u, v, sigma, plan.contrast_dn, noise)
        if known is None and is_open:
            known = point_by_pose(setup, find_pose(source, setup, describe_mirror(bench.measurement, setup)))
        if known is not None:
            setup = replace(setup, sigma_shift=known.sigma_shift(pattern))
        result = bench.result(source, setup, pattern_words(pattern))
        on_screen_mm = 1e3 * sigma * setup.size_m
        return bench.prospect(
            result,
            {
                "pattern": pattern_words(pattern),
                "noise": f"a pixel's point on the screen is known to {on_screen_mm[0]:.3g} mm across and "
                f"{on_screen_mm[1]:.3g} mm down",
            },
        )

    def _edge_light(self, pattern: FringePattern) -> tuple[float, float]:
        """Return contrast and noise of the image that shows the outline, as `Observation.mirror_image` has it."""
        model = self.measurement.model
        if model.images.bright is not None:
            frames = 1 if model.images.dark is None else 2
            return 2 * model.plan.contrast_dn, float(np.sqrt(frames)) * model.plan.noise_dn
        return model.plan.contrast_dn, model.plan.noise_dn / float(np.sqrt(pattern.sets[0].n_frames))

    def limits(self, prospect: Prospect) -> Mapping[str, Mapping[str, float]]:
        """Return the share of each source of errors in each variance."""
        return prospect.limits()

    def changes(self) -> Iterator[Change]:
        """Yield what might be done otherwise."""
        yield from bench_changes(self.bench, PlannedFringes)
        sets = self.measurement.model.pattern.set
        finest = {axis: max(one.periods for one in sets if one.axis == axis) for axis in ("x", "y")}
        finer = [
            one.model_copy(update={"periods": _FINER * one.periods}) if one.periods == finest[one.axis] else one
            for one in sets
        ]
        yield Change(
            "the finest fringes twice as fine",
            "pattern.set.periods",
            ", ".join(f"{one:g}" for one in finest.values()),
            ", ".join(f"{_FINER * one:g}" for one in finest.values()),
            PlannedFringes(self._with_sets(finer)),
            (NOISE,),
        )
        more = [one.model_copy(update={"steps_deg": one.steps_deg * _MORE_FRAMES}) for one in sets]
        count = self.measurement.model.pattern.n_frames
        yield Change(
            f"{_MORE_FRAMES} times as many photos",
            "pattern.set.steps_deg",
            str(count),
            str(_MORE_FRAMES * count),
            PlannedFringes(self._with_sets(more)),
            (NOISE,),
        )

    def _with_sets(self, sets: list[FringeSetSection]) -> DeflectometryMeasurement:
        return changed(self.measurement, {"pattern.set": tuple(one.model_dump() for one in sets)})


def load_fringes_plan(folder: Path) -> DeflectometryMeasurement:
    """Read and check the folder of a measurement with fringes whose images need not be there yet.

    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    file, model = read_measurement(folder, DeflectometryModel)
    if model.pattern.gray_code is not None:
        raise InputError(f"{file}: pattern.gray_code: plans are of fringes; state the sets that would be shown")
    refuse_missing_files(folder, _named(model))
    return DeflectometryMeasurement(folder, model, ())


def _named(model: DeflectometryModel) -> list[tuple[str, str]]:
    return [(key, text) for key, text in model.named_files() if key in ("camera.file", "screen.file")]


def run(folder: Path, progress: Progress | None = None) -> PlanResult:
    """Say what a measurement with fringes will be worth, and what would better it.

    InputError, EstimationError: As for `deflectometry.planning.pipeline.plan.run_plan`.
    """
    measurement = load_fringes_plan(folder)
    files = input_files(measurement, [text for _, text in _named(measurement.model)])
    return run_plan(PlannedFringes(measurement), folder, files, progress)
