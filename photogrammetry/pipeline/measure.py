"""Photos of targets, or image points, to coordinates with standard deviations: read, measure, solve, write."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from heliogauge.camera.millimetres import SENSOR_NAMES, Sensor, sensor_parameters
from heliogauge.camera.model import Camera
from heliogauge.flags import SampleFlag
from heliogauge.results.folder import (
    PhotoPose,
    PointTable,
    Summary,
    hash_files,
    refuse_copies,
    write_cameras_json,
    write_points_csv,
    write_summary,
    write_table_csv,
)
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import IntArray
from photogrammetry.bundle.constraints import Distance
from photogrammetry.bundle.statistics import examine_image_points, examine_intrinsics
from photogrammetry.exchange.image_point_files import PixelOrigin, read_image_points_csv
from photogrammetry.keys.load import PhotogrammetryMeasurement
from photogrammetry.keys.measurement import ImagePointsSection
from photogrammetry.networks.group_sigmas import solve_weighed
from photogrammetry.networks.length_error import LengthStatement, PermissibleError, state_length_errors
from photogrammetry.networks.quality import bar_checks, doubts, headline, length_doubts, quality_texts
from photogrammetry.networks.solve_network import Knowledge, Solved, SolveOptions
from photogrammetry.networks.target_size import size_doubts
from photogrammetry.pipeline.cameras import build_cameras, sensors_of, sizes_of_cameras
from photogrammetry.pipeline.dots import measure_targets_of
from photogrammetry.pipeline.inputs import build_constraints, build_datum, build_start
from photogrammetry.pipeline.natural import add_features
from photogrammetry.pipeline.photos import MeasuredPhotos, Refused
from photogrammetry.pipeline.surface import SurfaceResult, measure_surface
from photogrammetry.pipeline.surface_files import surface_numbers, write_surface
from photogrammetry.pipeline.uncoded import listed_targets, start_with_list, with_uncoded
from photogrammetry.start_values.network import StartValues


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    Parameters
    ----------
    jobs : int or None
        Photos that are measured side by side; None for all processors.
    """

    jobs: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """Everything a measurement gave, ready to be written.

    Parameters
    ----------
    name : str
        Name of what was measured.
    measured : MeasuredPhotos
        All image points, and what in the photos was refused.
    solved : Solved
        The adjusted network.
    checks : tuple of Distance
        Scale bars that were not used, to check against.
    lengths : LengthStatement
        Known lengths against a network that did not use them.
    doubts : tuple of str
        What makes the result doubtful.
    durations_s : dict of str to float
        Wall time of each stage [s].
    input_sha256 : dict of str to str
        Hash of each file read.
    sensors : dict of str to Sensor
        Of the cameras that were given in millimetres.
    surface : SurfaceResult or None
        The surface under the targets, where ``[surface]`` asks for it.
    """

    name: str
    measured: MeasuredPhotos
    solved: Solved
    checks: tuple[Distance, ...]
    lengths: LengthStatement
    doubts: tuple[str, ...]
    durations_s: dict[str, float]
    input_sha256: dict[str, str] = field(default_factory=dict)
    sensors: dict[str, Sensor] = field(default_factory=dict)
    surface: SurfaceResult | None = None

    @property
    def camera(self) -> Camera:
        """The first camera with the covariance of its parameters."""
        return self.solved.bundle.cameras[0]

    @property
    def cameras(self) -> dict[str, Camera]:
        """All cameras by name, with the covariance of their parameters."""
        bundle = self.solved.bundle
        return {model.name: one for model, one in zip(bundle.problem.cameras, bundle.cameras, strict=True)}

    @property
    def points(self) -> PointTable:
        """Coordinates with standard deviations; targets left out stand at the end without coordinates."""
        bundle, left = self.solved.bundle, self.solved.network.targets_left_out
        table = bundle.problem.observations
        rays = table.n_rays
        kept = np.nonzero(rays > 0)[0]
        gone = np.full((len(left), 3), np.nan)
        flags = np.array([0] * len(kept) + [int(SampleFlag.NOT_SEEN)] * len(left), dtype=np.uint32)
        return PointTable(
            tuple(table.targets[i] for i in kept) + tuple(one.name for one in left),
            np.concatenate([bundle.points_m[kept], gone]),
            np.concatenate([bundle.sigma_points_m[kept], gone]),
            np.concatenate([rays[kept], np.zeros(len(left), dtype=np.intp)]).astype(np.int64),
            flags,
        )

    @property
    def photo_poses(self) -> dict[str, PhotoPose]:
        """Camera, pose with covariance and size of the residuals of each photo in the network, by its name."""
        bundle = self.solved.bundle
        table, squares = bundle.problem.observations, (bundle.residuals_px**2).sum(axis=1)
        counts = np.maximum(table.n_targets_in_photo, 1)
        rms = np.sqrt(np.bincount(table.photo_index, weights=squares, minlength=len(table.photos)) / counts)
        covariances = bundle.covariance.poses
        owners = [bundle.problem.cameras[place].name for place in bundle.problem.camera_index]
        return {
            name: PhotoPose(owners[i], pose, 0.5 * (covariances[i] + covariances[i].T), float(rms[i]))
            for i, (name, pose) in enumerate(zip(table.photos, bundle.cam_from_world, strict=True))
        }

    @property
    def refused(self) -> tuple[Refused, ...]:
        """Everything that was not used, by name with the reason."""
        solved = self.solved
        outliers = [Refused(one.label, f"{one.reason}, residual {one.residual_px:.2f} px") for one in solved.rejected]
        left = (*solved.network.suspicious, *solved.network.photos_left_out, *solved.network.targets_left_out)
        others = [Refused(one.name, one.reason) for one in (*left, *solved.unused)]
        return (*self.measured.refused, *others, *outliers)


def run(
    measurement: PhotogrammetryMeasurement,
    options: Options | None = None,
    progress: Progress | None = None,
    *,
    measured: MeasuredPhotos | None = None,
    start: StartValues | None = None,
) -> Result:
    """Evaluate a measurement.

    Parameters
    ----------
    measurement : PhotogrammetryMeasurement
        From `heliogauge.measurement.load_photogrammetry`.
    options : Options, optional
        Choices.
    progress : Progress, optional
        Told of each stage.
    measured : MeasuredPhotos, optional
        Image points, where the photos were measured already; files are then neither read nor hashed.
    start : StartValues, optional
        Poses and targets to start from instead of those that measurement.toml names.

    Returns
    -------
    Result
        Points, poses and camera with their covariances, and what is doubtful.

    Raises
    ------
    InputError
        Photos, image points or camera that cannot be used.
    EstimationError
        The photos do not hang together, or something is not determined.
    """
    options, progress = options or Options(), progress or SilentProgress()
    model = measurement.model
    hashes: dict[str, str] = {}
    if measured is None:
        with progress.stage("hash inputs"):
            hashes = hash_files(measurement.input_files, measurement.folder)
        refuse_copies(measurement.photo_files, hashes, measurement.folder)
        measured, kinds = _read_kinds(measurement, options, progress)
    else:
        kinds = np.zeros(measured.points.n, dtype=np.intp)
    cameras = build_cameras(measurement, measured.points.photos, measured.sizes_px)
    fixed = {one.target: np.array(one.xyz_m) for one in model.control_point if not any(one.sigma_mm)}
    listed = listed_targets(model.targets, measurement.folder)
    start = start_with_list(start or build_start(measurement), model.targets, listed)
    diameter_mm = None if model.targets is None else model.targets.diameter_mm
    knowledge = Knowledge(build_constraints(model), fixed, build_datum(model), start, diameter_mm is not None)
    sigmas = model.adjustment.sigmas
    rescale = measured.sigma_assumed if sigmas is None else sigmas == "from residuals"
    how = SolveOptions(model.adjustment.reject, model.adjustment.family_significance, rescale)
    with progress.stage("adjust"):
        weighed = solve_weighed(measured.points, measured.ellipses_px2, kinds, cameras, knowledge, how)
        # Dots without a code are measured as the coded targets are, which are the first kind.
        loose = measured.loose and measured.loose.with_sigmas_times(float(weighed.factors[0]))
        measured, solved = replace(measured, points=weighed.points, loose=loose), weighed.solved
    with progress.stage("match targets without a code"):
        measured, solved = with_uncoded(measured, solved, listed, cameras, knowledge, how)
    checks = tuple(
        Distance(bar.a, bar.b, bar.length_m, 1e-3 * bar.sigma_mm) for bar in model.scale_bar if bar.check_only
    )
    sensors = sensors_of(measurement, cameras)
    with progress.stage("statistics"):
        limit = model.permissible_length_error
        permissible = None if limit is None else PermissibleError(1e-3 * limit.a_mm, limit.k, 1e-3 * limit.b_mm)
        lengths = state_length_errors(solved.bundle, checks, permissible)
        said = (*measured.doubts, *doubts(solved), *length_doubts(lengths))
        said += size_doubts(solved, (measured.points, measured.ellipses_px2), diameter_mm)
    surface = None
    if model.surface is not None:
        with progress.stage("surface"):
            surface = measure_surface(model.surface, measurement.folder, solved.bundle)
            said = (*said, *surface.doubts)
    times = dict(progress.durations_s)
    return Result(model.name, measured, solved, checks, lengths, said, times, hashes, sensors, surface)


def _read_kinds(
    measurement: PhotogrammetryMeasurement, options: Options, progress: Progress
) -> tuple[MeasuredPhotos, IntArray]:
    """Return image points and their kinds, of which each gets its sigmas from its own residuals."""
    model = measurement.model
    if model.natural is None:
        measured = read_points(measurement, options, progress)
        return measured, np.zeros(measured.points.n, dtype=np.intp)
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


def write(result: Result, folder: Path) -> None:
    """Write the files of a result into an existing folder.

    Parameters
    ----------
    result : Result
        What `run` returned.
    folder : Path
        Where to; usually the folder that `heliogauge.store.ResultFolder` gives.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    write_points_csv(folder / "points.csv", result.points)
    write_cameras_json(folder / "cameras.json", result.cameras, result.photo_poses)
    write_table_csv(folder / "points_covariance.csv", _covariance_columns(result))
    write_table_csv(folder / "residuals.csv", _residual_columns(result))
    refused = result.refused
    write_table_csv(
        folder / "rejected.csv", {"name": [one.name for one in refused], "reason": [one.reason for one in refused]}
    )
    write_table_csv(folder / "constraints.csv", _constraint_columns(result))
    write_table_csv(folder / "lengths.csv", _length_columns(result))
    write_table_csv(folder / "intrinsics.csv", _intrinsic_columns(result))
    if result.sensors:
        write_table_csv(folder / "camera_millimetres.csv", _millimetre_columns(result))
    if result.surface is not None:
        write_surface(result.surface, folder, {"name": result.name, "input_sha256": result.input_sha256})
    write_summary(folder / "summary.json", summarise(result))


def _covariance_columns(result: Result) -> dict[str, Any]:
    bundle = result.solved.bundle
    covariance = bundle.covariance.points
    names = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    columns: dict[str, Any] = {"id": list(bundle.problem.observations.targets)}
    return columns | {f"{name}_m2": covariance[:, i, j] for name, (i, j) in names.items()}


def _residual_columns(result: Result) -> dict[str, Any]:
    bundle = result.solved.bundle
    table, tests = bundle.problem.observations, examine_image_points(bundle)
    sigma = np.sqrt(np.einsum("mii->mi", table.covariance_px2))
    return {
        "image": [table.photos[i] for i in table.photo_index],
        "target": [table.targets[i] for i in table.target_index],
        "x_px": table.pixels_px[:, 0],
        "y_px": table.pixels_px[:, 1],
        "sigma_x_px": sigma[:, 0],
        "sigma_y_px": sigma[:, 1],
        "residual_x_px": bundle.residuals_px[:, 0],
        "residual_y_px": bundle.residuals_px[:, 1],
        "redundancy_x": tests.redundancy[:, 0, 0],
        "redundancy_y": tests.redundancy[:, 1, 1],
        "test": np.sqrt(tests.length_squared),
    }


def _constraint_columns(result: Result) -> dict[str, Any]:
    checked = bar_checks(result.solved.bundle, result.checks)
    return {
        "name": [one.name for one in checked],
        "used": [int(one.used) for one in checked],
        "known_m": [one.known_m for one in checked],
        "sigma_known_m": [one.sigma_known_m for one in checked],
        "measured_m": [one.measured_m for one in checked],
        "sigma_measured_m": [one.sigma_measured_m for one in checked],
        "error_m": [one.measured_m - one.known_m for one in checked],
    }


def _length_columns(result: Result) -> dict[str, Any]:
    names = (
        "name role line known_m sigma_known_m measured_m "
        "sigma_measured_m error_m sigma_error_m permissible_m verdict"
    ).split()
    columns = {name: [getattr(one, name) for one in result.lengths.checks] for name in names}
    return columns | {"permissible_m": [v if np.isfinite(v) else np.nan for v in columns["permissible_m"]]}


def _intrinsic_columns(result: Result) -> dict[str, Any]:
    tests = examine_intrinsics(result.solved.bundle)
    names = ("camera", "name", "value", "sigma", "significance", "rival", "correlation")
    return {name: [getattr(one, name) for one in tests] for name in names}


def _millimetre_columns(result: Result) -> dict[str, Any]:
    columns: dict[str, list[Any]] = {"camera": [], "name": [], "value": [], "sigma": []}
    for camera, sensor in result.sensors.items():
        found = sensor_parameters(result.cameras[camera], sensor)
        columns["camera"] += [camera] * len(found.values)
        columns["name"] += SENSOR_NAMES[sensor.form]
        columns["value"] += found.values.tolist()
        columns["sigma"] += found.sigma.tolist()
    return columns


def summarise(result: Result) -> Summary:
    """Collect the headline numbers of a result with their sigmas, warnings and provenance."""
    bundle = result.solved.bundle
    numbers, missing = headline(result.solved, result.lengths)
    described = [
        f"{model.name}: {one.width_px} x {one.height_px} px; estimated: {', '.join(model.free) or 'nothing'}"
        for model, one in zip(bundle.problem.cameras, bundle.cameras, strict=True)
    ]
    scale = "residuals" if result.solved.image_sigma_factor != 1.0 else "statement"
    texts = {
        "datum": bundle.datum,
        "camera": "; ".join(described if len(described) > 1 else [described[0].partition(": ")[2]]),
        "sigma": f"1 standard deviation under this datum; size of the image points' sigmas from their {scale}",
        "rejected": f"{len(result.refused)} items, see rejected.csv",
        **quality_texts(result.lengths, float(numbers["extent_m"] or 0.0)),
    }
    if result.surface is not None:
        found, words, reasons = surface_numbers(result.surface)
        numbers, texts, missing = numbers | found, texts | words, missing | reasons
    return Summary(
        kind="photogrammetry",
        name=result.name,
        numbers=numbers,
        texts=texts,
        doubts=result.doubts,
        durations_s=result.durations_s,
        input_sha256=result.input_sha256,
        not_determined=missing,
    )
