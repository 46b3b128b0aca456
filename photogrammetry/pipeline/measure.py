"""Photos of targets, or image points, to coordinates with standard deviations: read, measure, solve, write."""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import showing
from heliogauge.results.folder import (
    hash_files,
    refuse_copies,
)
from heliogauge.running.progress import Progress, SilentProgress
from photogrammetry.exchange.image_point_files import PixelOrigin, read_image_points_csv
from photogrammetry.keys.load import PhotogrammetryMeasurement
from photogrammetry.keys.measurement import ImagePointsSection
from photogrammetry.matching.uncoded_names import ListedTargets
from photogrammetry.networks.group_sigmas import solve_weighed
from photogrammetry.networks.length_error import state_length_errors
from photogrammetry.networks.quality import check_lengths, check_network
from photogrammetry.networks.solve_network import Knowledge, NetworkCameras, Solved, SolveOptions
from photogrammetry.networks.solve_uncoded import add_dots
from photogrammetry.networks.target_size import check_sizes
from photogrammetry.pipeline.cameras import (
    build_cameras,
    refuse_camera_mismatches,
    sensors_of,
    sizes_of_cameras,
)
from photogrammetry.pipeline.dots import measure_targets_of
from photogrammetry.pipeline.inputs import (
    build_checks,
    build_knowledge,
    build_permissible_error,
    build_solve_options,
    listed_targets,
    stated_diameter_mm,
)
from photogrammetry.pipeline.natural import add_features
from photogrammetry.pipeline.photos import MeasuredPhotos
from photogrammetry.pipeline.positions import check_positions
from photogrammetry.pipeline.result import Result
from photogrammetry.pipeline.surface import measure_surface
from photogrammetry.start_values.network import StartValues


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    jobs: Photos that are measured side by side; None for all processors.
    """

    jobs: int | None = None


def run(
    measurement: PhotogrammetryMeasurement,
    options: Options | None = None,
    progress: Progress | None = None,
    *,
    measured: MeasuredPhotos | None = None,
    start: StartValues | None = None,
) -> Result:
    """Evaluate a measurement.

    measurement: Folder, what its measurement.toml says, and its photos.
    measured: Image points, where the photos were measured already; files are then neither read nor hashed.
    start: Poses and targets to start from instead of those that measurement.toml names.
    Returns: Points, poses and camera with their covariances, and what is doubtful.
    InputError: Photos, image points or camera that cannot be used.
    EstimationError: The photos do not hang together, or something is not determined.
    """
    options, progress = options or Options(), progress or SilentProgress()
    model = measurement.model
    hashes: dict[str, str] = {}
    if measured is None:
        if measurement.photo_files:
            refuse_camera_mismatches(measurement)
        with progress.stage("hash inputs"):
            hashes = hash_files(measurement.input_files, measurement.folder)
        refuse_copies(measurement.photo_files, hashes, measurement.folder)
        measured = measure_points(measurement, options, progress)
    cameras = build_cameras(measurement, measured.points.photos, measured.sizes_px)
    listed = listed_targets(model.targets, measurement.folder)
    knowledge = build_knowledge(measurement, start, listed)
    how = build_solve_options(model, measured.sigma_assumed)
    with progress.stage("adjust"), showing(measured.pictures):
        measured, solved = adjust_points(measured, cameras, knowledge, how)
    with progress.stage("match targets without a code"):
        measured, solved = match_uncoded(measured, solved, listed, cameras, knowledge, how)
    checks = build_checks(model)
    with progress.stage("statistics"):
        lengths = state_length_errors(solved.bundle, checks, build_permissible_error(model))
        positions = check_positions(measurement, solved.bundle)
        sizes = check_sizes(solved, measured.points, measured.ellipses_px2, stated_diameter_mm(model))
        scale = () if positions is None else positions.doubts
        doubts = gather_doubts(measured.doubts, check_network(solved), check_lengths(lengths), sizes, scale)
    surface = None
    if model.surface is not None:
        with progress.stage("surface"):
            surface = measure_surface(model.surface, measurement.folder, solved.bundle)
            doubts = gather_doubts(doubts, surface.doubts)
    return Result(
        name=model.name,
        measured=measured,
        solved=solved,
        checks=checks,
        lengths=lengths,
        sensors=sensors_of(measurement, cameras),
        surface=surface,
        positions=positions,
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def measure_points(measurement: PhotogrammetryMeasurement, options: Options, progress: Progress) -> MeasuredPhotos:
    """Measure targets and natural features of the photos, or read the image points.

    options: How many photos side by side.
    InputError: Files that cannot be used.
    EstimationError: No targets in the photos.
    """
    model = measurement.model
    if model.natural is None:
        return read_points(measurement, options, progress)
    coded = None if model.targets is None else read_points(measurement, options, progress)
    return add_features(measurement, coded, jobs=options.jobs, progress=progress)


def read_points(measurement: PhotogrammetryMeasurement, options: Options, progress: Progress) -> MeasuredPhotos:
    """Measure the photos, or read the image points.

    options: How many photos side by side.
    InputError: Files that cannot be used.
    EstimationError: No targets in the photos.
    """
    model = measurement.model
    if model.targets is not None and measurement.photo_files:
        return measure_targets_of(measurement, model.targets, jobs=options.jobs, progress=progress)
    section = model.image_points or ImagePointsSection()
    with progress.stage("read image points"):
        found = read_image_points_csv(
            measurement.folder / section.file,
            origin=PixelOrigin(section.pixel_origin),
            default_sigma_px=section.default_sigma_px,
            sizes_px=lambda photos: sizes_of_cameras(measurement, photos),
        )
    shapes = np.full((found.points.n, 2, 2), np.nan)
    return MeasuredPhotos(found.points, shapes, None, (), found.doubts, found.sigma_assumed)


def adjust_points(
    measured: MeasuredPhotos, cameras: NetworkCameras, knowledge: Knowledge, options: SolveOptions
) -> tuple[MeasuredPhotos, Solved]:
    """Adjust the network, each kind of image points with a sigma from its own residuals.

    Returns: Image points and dots with their sigmas, and the network.
    EstimationError: The photos do not hang together, or something is not determined.
    """
    kinds = np.zeros(measured.points.n, dtype=np.intp) if measured.kinds is None else measured.kinds
    weighed = solve_weighed(measured.points, measured.ellipses_px2, kinds, cameras, knowledge, options)
    # Dots without a code are measured as the coded targets are, which are the first kind.
    loose = measured.loose and measured.loose.with_sigmas_times(float(weighed.factors[0]))
    return replace(measured, points=weighed.points, loose=loose), weighed.solved


def match_uncoded(
    measured: MeasuredPhotos,
    solved: Solved,
    listed: ListedTargets | None,
    cameras: NetworkCameras,
    knowledge: Knowledge,
    options: SolveOptions,
) -> tuple[MeasuredPhotos, Solved]:
    """Extend a network by the targets without a code.

    measured: All image points, and the dots.
    listed: Names and rough places.
    knowledge: Scale bars, control points, constraints and datum.
    Returns: The image points with those of matched dots, and the network adjusted with them; what could not be
        matched or named is among the refused.
    EstimationError: The network with its points is not determined.
    """
    if measured.loose is None or not len(measured.loose.dots):
        if listed is None:
            return measured, solved
        text = f"{len(listed)} targets without a code are listed, but no dot was found"
        missing = Doubt("listed_targets_not_found", text, {"listed_count": len(listed)})
        return replace(measured, doubts=(*measured.doubts, missing)), solved
    loose = replace(measured.loose, listed=listed)
    found = add_dots(solved, measured.points, measured.ellipses_px2, loose, cameras, knowledge, options)
    refused = found.left
    extended = replace(
        measured,
        points=found.points,
        ellipses_px2=found.ellipses_px2,
        refused=(*measured.refused, *refused),
        doubts=(*measured.doubts, *found.doubts),
    )
    return extended, found.solved
