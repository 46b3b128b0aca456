"""A plan of a photo of dots: what the measurement will be worth, from its measurement.toml before there is a photo."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deflectometry.dots.dot_source import DotSource
from deflectometry.dots.ground import POLARITIES
from deflectometry.dots.keys import DotsMeasurement, DotsModel
from deflectometry.dots.planning.predicted_dots import measured_sample, places_of_dots, predicted_dots
from deflectometry.planning.pipeline.bench import Bench, bench_changes, changed, input_files
from deflectometry.planning.pipeline.plan import PlanResult, run_plan
from deflectometry.planning.prospect import NOISE, Change, Prospect
from deflectometry.setup.dot_screen import DotScreen
from heliogauge.errors import EstimationError, InputError
from heliogauge.measurement.files import refuse_missing_files
from heliogauge.measurement.load import read_measurement
from heliogauge.results.tables import read_number_columns
from heliogauge.running.progress import Progress

#: Fewer dots than this on a facet determine no lattice.
_FEWEST = 25
#: How many photos are tried in place of one: the mean of so many has half of the noise.
_PHOTOS = 4


@dataclass(frozen=True, slots=True, eq=False)
class PlannedDots:
    """A field of dots before a mirror, to be looked at before there is a photo."""

    measurement: DotsMeasurement

    @property
    def name(self) -> str:
        """Name of the mirror."""
        return self.measurement.model.name

    @property
    def bench(self) -> Bench:
        """Camera, field and mirror as they will stand."""
        return Bench.of(self.measurement, self.measurement.model.plan)

    def prospect(self) -> Prospect:
        """Return what the measurement will be worth.

        InputError, EstimationError: As for `deflectometry.planning.prospect.PlannedSource`.
        """
        bench, plan = self.bench, self.measurement.model.plan
        screen = bench.setup.screen
        if not isinstance(screen, DotScreen):
            raise InputError(f"{self.measurement.folder}: [screen] must be a field of dots")
        places = [places_of_dots(bench, one, screen, self._radius_m(screen)) for one in bench.sights]
        usable = [one for one in places if len(one.number) >= _FEWEST]
        if not usable:
            most = max(len(one.number) for one in places)
            raise EstimationError(
                f"a facet shows {most} whole dots at most, and {_FEWEST} are needed: take dots that are nearer to each "
                "other, or a larger field"
            )
        polarity = POLARITIES[self.measurement.model.pattern.dots]
        sample = measured_sample(usable, plan.contrast_dn, plan.noise_dn, plan.blur_px, polarity)
        # The ground is what shines: its edges stand out by the contrast.
        image = bench.image(plan.contrast_dn, plan.noise_dn)
        source = DotSource(image, tuple(predicted_dots(one, sample) for one in usable), screen)
        count = sum(len(one.number) for one in usable)
        sigma = float(np.sqrt(0.5 * np.trace(np.median(sample.covariance_px2, axis=0))))
        words = f"{count} dots of a {screen.describe()}"
        result = bench.result(source, bench.setup, words)
        return bench.prospect(result, {"pattern": words, "noise": f"a dot's centre is known to {sigma:.3g} px"})

    def _radius_m(self, screen: DotScreen) -> float:
        stated = self.measurement.model.plan.dot_radius_mm
        if stated is not None:
            return 1e-3 * stated
        marks = self.measurement.model.pattern.marks_file
        if marks is not None:
            (radii,) = read_number_columns(self.measurement.path(marks), ("radius_m",))
            return float(np.sqrt(np.mean(radii**2)))
        return 0.25 * float(screen.spacing_m.min())

    def limits(self, prospect: Prospect) -> Mapping[str, Mapping[str, float]]:
        """Return the share of each source of errors in each variance."""
        return prospect.limits()

    def changes(self) -> Iterator[Change]:
        """Yield what might be done otherwise."""
        yield from bench_changes(self.bench, PlannedDots)
        noise = self.measurement.model.plan.noise_dn
        yield Change(
            f"the mean of {_PHOTOS} photos",
            "plan.noise_dn",
            f"{noise:g}",
            f"{noise / _PHOTOS**0.5:g}",
            PlannedDots(changed(self.measurement, {"plan.noise_dn": noise / _PHOTOS**0.5})),
            (NOISE,),
        )


def load_dots_plan(folder: Path) -> DotsMeasurement:
    """Read and check the folder of a measurement with dots whose photo need not be there yet.

    InputError: As for `heliogauge.measurement.load.read_measurement`.
    """
    _, model = read_measurement(folder, DotsModel)
    refuse_missing_files(folder, _named(model))
    return DotsMeasurement(folder, model)


def _named(model: DotsModel) -> list[tuple[str, str]]:
    return [(key, text) for key, text in model.named_files() if key != "photo"]


def run(folder: Path, progress: Progress | None = None) -> PlanResult:
    """Say what a photo of dots will be worth, and what would better it.

    InputError, EstimationError: As for `deflectometry.planning.pipeline.plan.run_plan`.
    """
    measurement = load_dots_plan(folder)
    files = input_files(measurement, [text for _, text in _named(measurement.model)])
    return run_plan(PlannedDots(measurement), folder, files, progress)
