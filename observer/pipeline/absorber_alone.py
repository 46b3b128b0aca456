"""Photos of the absorber alone to its position: for alignment, and for the sag at several orientations."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from heliogauge.doubts import gather_doubts
from heliogauge.errors import EstimationError, showing
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import Summary, write_points_csv, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.running.progress import Progress, SilentProgress
from observer.absorber.position import AbsorberSolution, solve_absorber
from observer.absorber.product import (
    absorber_columns,
    absorber_doubts,
    shape_numbers,
    span_columns,
    tube_spans,
)
from observer.files import COLLECTOR, write_collector
from observer.keys import ObserverMeasurement
from observer.photo_edges.tube_bearings import Bearings, tube_bearings
from observer.photo_edges.views import Shot
from observer.pipeline.cameras import Cameras, adjust_cameras
from observer.pipeline.corners import find_corners
from observer.pipeline.headline import absorber_numbers
from observer.pipeline.inputs import read_inputs
from observer.pipeline.reading.photos import Finder, measure_targets
from observer.pipeline.target_list import check_list, keep_placed
from observer.trough.collector import Collector
from photogrammetry import pipeline as photogrammetry_pipeline

#: Kind of the summary, which names its report.
KIND = "observer-absorber"


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    jobs: Photos that are measured side by side; None for all processors.
    """

    jobs: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """Where the absorber is.

    collector: The design.
    orientation_rad: Turn of the collector from zenith [rad].
    network: Cameras and targets.
    solution: The tube.
    """

    kind: ClassVar[str] = KIND
    collector: Collector
    orientation_rad: float
    network: photogrammetry_pipeline.Result
    solution: AbsorberSolution

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        solution, collector = self.solution, self.collector
        bundle = self.network.solved.bundle
        numbers = {
            **absorber_numbers(solution.path, collector, solution),
            **shape_numbers(solution.path, solution, collector, self.orientation_rad),
            "orientation_rad": self.orientation_rad,
            "photos_count": len(bundle.problem.observations.photos),
            "bearing_residual_rms_rad": solution.residual_rms_rad,
        }
        texts = {
            "design": collector.describe(),
            "frame": "trough: x across the aperture, y along the trough, z to the absorber",
            "datum": bundle.datum,
        }
        return self._summary(numbers, texts)

    def write_files(self, folder: Path) -> None:
        """Write the absorber, its spans, targets and what was left out into an existing folder."""
        solution, collector = self.solution, self.collector
        write_table_csv(folder / "absorber.csv", absorber_columns(solution.path, solution, collector))
        spans = tube_spans(solution.path, solution, collector, self.orientation_rad)
        write_table_csv(folder / "absorber_spans.csv", span_columns(spans))
        write_collector(folder / COLLECTOR, collector)
        write_points_csv(folder / "points.csv", self.network.points)
        refused = self.network.refused
        write_table_csv(
            folder / "rejected.csv", {"name": [one.name for one in refused], "reason": [one.reason for one in refused]}
        )

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return headline_text(self.summarise())


def run(measurement: ObserverMeasurement, options: Options | None = None, progress: Progress | None = None) -> Result:
    """Measure where the absorber is; the mirror is not evaluated.

    Returns: The absorber's axis with covariance, and what is doubtful.
    InputError: Photos, targets or camera that cannot be used.
    EstimationError: The photos do not hang together, or do not show the absorber from two sides.
    """
    options, progress = options or Options(), progress or SilentProgress()
    inputs = read_inputs(measurement, progress)
    collector, finder, survey = inputs.collector, inputs.finder, inputs.survey
    if inputs.corners is None:
        first = measure_targets(survey.photo_files, finder, jobs=options.jobs, progress=progress)
        listed = check_list(survey, finder, inputs.targets_file, first)
    else:
        first = find_corners(survey.photo_files, finder, inputs.corners, jobs=options.jobs, progress=progress)
        listed = keep_placed(survey, first)
    listed, cameras = adjust_cameras(listed, inputs, options.jobs, progress)
    network = cameras.network
    with progress.stage("absorber"), showing(partial(network.measured.pictures, "no edge of the tube")):
        # Photos that are meant for it, where there are any, else all.
        meant = {file.name for file in measurement.absorber_files or survey.photo_files}
        bearings = _bearings(cameras, meant, finder)
        solution = solve_absorber(
            bearings, cameras.photos, finder.expected.absorber, inputs.stations_m, inputs.collector
        )
    doubts = absorber_doubts(solution.path, solution, collector, is_design=False)
    return Result(
        collector,
        inputs.orientation_rad,
        network,
        solution,
        name=inputs.name,
        doubts=gather_doubts(inputs.doubts, listed.doubts, network.doubts, cameras.doubts, doubts),
        durations_s=dict(progress.durations_s),
        input_sha256=dict(inputs.input_sha256),
    )


def _bearings(cameras: Cameras, meant: set[str], finder: Finder) -> Bearings:
    """Find the tube in the photos that are meant for it."""
    parts = []
    for k, (file, view) in enumerate(zip(cameras.files, cameras.views, strict=True)):
        if file.name in meant:
            parts += tube_bearings([Shot(finder.read(file), k, view)], finder.expected)
    if not parts:
        raise EstimationError(
            "absorber: none of its photos shows enough targets to know where it was taken from; see rejected.csv of "
            "`heliogauge observer measure`, or show more targets in them"
        )
    return Bearings(*(np.concatenate([getattr(one, name) for one in parts]) for name in Bearings.__slots__))


def headline_text(summary: Summary) -> str:
    """Say the most important numbers in a few lines for the terminal."""
    numbers = summary.numbers

    def said(key: str, unit: str) -> str:
        value, sigma = numbers.get(key), numbers.get(f"sigma_{key}")
        return "not determined" if value is None else number_text(value, None if sigma is None else float(sigma), unit)

    return "\n".join(
        [
            f"{summary.name}: {numbers['photos_count']} photos, {numbers['absorber_stations_measured_count']} of "
            f"{numbers['absorber_stations_count']} stations of the absorber measured",
            f"  offset   x {said('absorber_mean_x_m', 'm')}, z {said('absorber_mean_z_offset_m', 'm')} from the focal "
            "line",
            f"  tilt     x {said('absorber_tilt_x_rad', 'rad')}, z {said('absorber_tilt_z_rad', 'rad')}",
            f"  sag      {said('absorber_sag_down_m', 'm')} downward, in the span where it is largest",
            f"  design   {summary.texts['design']}",
        ]
    )
