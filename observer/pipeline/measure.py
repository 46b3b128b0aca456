"""Photos of a trough to slope errors, absorber position and what they cost: read, measure, solve, write."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.images.photos import read_luma
from heliogauge.results.folder import (
    PhotoPose,
    Summary,
    hash_files,
    refuse_copies,
    write_cameras_json,
    write_points_csv,
    write_summary,
    write_table_csv,
)
from heliogauge.results.slope_map_file import write_slope_map
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.map import SlopeMap
from heliogauge.sunlight.sun_shapes import SunShape
from heliogauge.validate import FloatArray
from observer.absorber.position import AbsorberSolution, solve_absorber
from observer.absorber.product import absorber_columns, absorber_warnings, shape_numbers, span_columns, tube_spans
from observer.doubts.design_checks import heights_doubt, panels_doubt, refuse_impossible_cameras, sparse_doubt
from observer.doubts.stated_camera import blamed, explained, stated_camera_doubt
from observer.files import (
    ANGLES,
    COLLECTOR,
    SLICES,
    read_absorber,
    write_angles,
    write_collector,
    write_overlay,
    write_slices,
)
from observer.keys import ObserverMeasurement
from observer.photo_edges.tone import Tone
from observer.photo_edges.views import Shot, View
from observer.pipeline.design_comparison import design_doubts
from observer.pipeline.headline import (
    absorber_numbers,
    edge_numbers,
    panel_columns,
    slope_numbers,
    surface_numbers,
    surface_text,
)
from observer.pipeline.inputs import (
    absorber_start,
    as_photogrammetry,
    build_collector,
)
from observer.pipeline.intercept import (
    InterceptResult,
    build_sun,
    evaluate_intercept,
    intercept_numbers,
    write_intercept,
)
from observer.pipeline.photos import Finder, FirstLook, SeenInPhotos, build_finder, look_again, look_first
from observer.pipeline.target_list import (
    known_targets,
    photos_with_poses,
    refuse_loose_list,
    refuse_strange_list,
    without_strays,
)
from observer.product.longitudinal import incidence_warning
from observer.product.pictures import Overlay, draw_overlay
from observer.product.slope_map import AngleMaps, angle_maps, known_theta_r, slope_map_of, slopes_to_tube
from observer.selection.edge_refusal import FATE_TEXTS, EdgeFate, unchecked_doubt
from observer.selection.solve_and_refuse import Reflector, solve_reflector
from observer.slopes.pose_modes import Photos
from observer.slopes.row_spline import Roughness
from observer.slopes.shape_share import shape_doubt
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.expectation import Expectation
from observer.trough.visibility import Visibility, coverage_warning, seeable_shares, visibility
from photogrammetry import pipeline as photogrammetry_pipeline
from photogrammetry.keys import PhotogrammetryMeasurement
from photogrammetry.pipeline import collect_photos

#: Cameras and targets, in the form of a photogrammetry measurement; `heliogauge report` makes their report.
NETWORK_FOLDER = "network"


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
    collector : Collector
        The design.
    orientation_rad : float
        Turn of the collector from zenith, by the right hand about +y [rad].
    network : photogrammetry.pipeline.Result
        Cameras and targets.
    seen : SeenInPhotos
        Edges and bearings.
    absorber : AbsorberPath
        The tube's axis, adjusted together with the slopes.
    absorber_solution : AbsorberSolution or None
        Its measurement; None where it was given.
    reflector : Reflector
        The mirror's slope errors.
    slope_map : SlopeMap
        The same in the common form.
    visible : Visibility
        What the cameras can see of the tube by way of each node.
    angles : AngleMaps
        The same as angles, with the absorber's share.
    intercept : InterceptResult
        What mirror and absorber collect.
    photos : Photos
        Poses of the photos with their joint covariance, as the targets tell them.
    poses : tuple of RigidTransform
        The same as the reflection has refined them, ``cam_from_frame``.
    pose_covariances : ndarray, shape (n, 6, 6)
        Of the steps of each [rad, m].
    overlay : Overlay
        One photo with what design and result predict of the reflection.
    doubts : tuple of Doubt
        What makes the result doubtful.
    durations_s : dict of str to float
        Wall time of each stage [s].
    input_sha256 : dict of str to str
        Hash of each file read.
    """

    name: str
    collector: Collector
    orientation_rad: float
    network: photogrammetry_pipeline.Result
    seen: SeenInPhotos
    absorber: AbsorberPath
    absorber_solution: AbsorberSolution | None
    reflector: Reflector
    slope_map: SlopeMap
    visible: Visibility
    angles: AngleMaps
    intercept: InterceptResult
    photos: Photos
    poses: tuple[RigidTransform, ...]
    pose_covariances: FloatArray
    overlay: Overlay
    doubts: tuple[str, ...]
    durations_s: dict[str, float]
    input_sha256: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """What is known before the photos are read.

    collector: The design.
    sun: What shines.
    survey: The photo network.
    finder: What is looked for in each photo.
    """

    collector: Collector
    sun: SunShape
    survey: PhotogrammetryMeasurement
    finder: Finder


def run(measurement: ObserverMeasurement, options: Options | None = None, progress: Progress | None = None) -> Result:
    """Evaluate a measurement.

    Parameters
    ----------
    measurement : ObserverMeasurement
        From `heliogauge.measurement.load_observer`; of a single collector.
    options : Options, optional
        Choices.
    progress : Progress, optional
        Told of each stage.

    Returns
    -------
    Result
        Slope errors, absorber and cameras with their uncertainty, and what is doubtful.

    Raises
    ------
    InputError
        Photos, targets or camera that cannot be used, or several modules.
    EstimationError
        The photos do not hang together, or too little of the reflection is seen.
    """
    options, progress = options or Options(), progress or SilentProgress()
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    prepared = prepare(measurement)
    refuse_copies(prepared.survey.photo_files, hashes, measurement.folder)
    first = look_first(prepared.survey.photo_files, prepared.finder, jobs=options.jobs, progress=progress)
    return replace(evaluate(measurement, prepared, first, options, progress), input_sha256=hashes)


def prepare(measurement: ObserverMeasurement) -> Prepared:
    """Check a measurement and say what is looked for in its photos.

    measurement: Of a single collector.
    Returns: Collector, sun, photo network and what is looked for.
    InputError: Targets, camera or dimensions that cannot be used.
    """
    model = measurement.model
    collector = build_collector(model.collector)
    sun = build_sun(model.sun, measurement.folder)
    step = 1e-3 * model.evaluation.row_step_mm
    rows = max(2, round(collector.length_m / step))
    y = np.asarray((np.arange(rows) + 0.5) * (collector.length_m / rows) - collector.length_m / 2, dtype=np.float64)
    largest_rad = 1e-3 * model.evaluation.largest_slope_error_mrad
    survey = as_photogrammetry(measurement)
    finder = build_finder(
        survey, known_targets(survey), Expectation(collector, absorber_start(collector), y, largest_rad)
    )
    if model.images.encoding != "auto":
        finder = replace(finder, tone=Tone(model.images.encoding))
    return Prepared(collector, sun, survey, finder)


def evaluate(
    measurement: ObserverMeasurement, prepared: Prepared, first: FirstLook, options: Options, progress: Progress
) -> Result:
    """Solve for cameras, mirror and absorber from what was found in the photos.

    first: What was found when the photos were read.
    Returns: Slope errors, absorber and cameras; without the hashes of the inputs.
    InputError: Photos that cannot be used.
    EstimationError: The photos do not hang together, or too little of the reflection is seen.
    """
    model, collector, finder = measurement.model, prepared.collector, prepared.finder
    survey, first, left_out = photos_with_poses(prepared.survey, first, finder.known)
    expected = finder.expected
    y = expected.y_m
    refuse_strange_list(survey, first, model.targets.file)
    survey, strays = without_strays(survey, first, finder)
    with explained():
        network = photogrammetry_pipeline.run(
            survey, photogrammetry_pipeline.Options(jobs=options.jobs), progress,
            measured=collect_photos(first.targets) if first.targets else None, start=first.start,
        )  # fmt: skip
    photos, views, files = _photos(measurement, network)
    refuse_loose_list(network, survey, collector)
    refuse_impossible_cameras(photos.eyes_m, collector)
    seen = look_again(files, views, finder, first, jobs=options.jobs, progress=progress)
    with progress.stage("absorber"), blamed(network):
        absorber, solution, absorber_doubts = _absorber(measurement, seen, photos, collector)
    prior = Roughness(1e-3, 1e-3 * model.evaluation.longitudinal_slope_mrad)
    with progress.stage("slopes"), blamed(network):
        expected = Expectation(collector, absorber, y, expected.slope_error_rad)
        together = photos if solution is None else replace(photos, with_tube=solution.with_poses)
        reflector = solve_reflector(
            seen.edges, together, expected, 1e-3 * model.evaluation.column_step_mm, prior,
            shaped=model.evaluation.shape_from_slopes,
        )  # fmt: skip
        absorber = reflector.absorber
        solution = None if solution is None else replace(solution, path=absorber)
        nodes = (reflector.grid.x_m, y)
        visible = visibility(nodes, photos.eyes_m, collector, absorber, known_theta_r(reflector, collector))
        slope_map = slope_map_of(reflector, collector, visible)
        if not slope_map.valid.any():
            raise EstimationError(f"reflection: {sparse_doubt(0.0, photos.eyes_m)}")
        angles = angle_maps(slope_map, absorber, collector, slopes_to_tube(reflector, slope_map))
    with progress.stage("intercept factor"):
        intercept = evaluate_intercept(
            prepared.sun, model.optics, slope_map, absorber, collector, reflector.sum_covariance()
        )
    with progress.stage("picture"):
        clearest = _clearest_photo(seen, reflector)
        poses, pose_covariances = reflector.unknowns.moved_poses(
            photos.poses, photos.covariance, reflector.errors.common, reflector.errors.covariance_common
        )
        shot = Shot(read_luma(files[clearest]), clearest, View(views[clearest].camera, poses[clearest]))
        picture = draw_overlay(shot, slope_map, absorber_start(collector), absorber, collector)
    coverage = coverage_warning(visible, slope_map.x_m, slope_map.aperture, photos.eyes_m)
    with progress.stage("check the design"):
        camera = stated_camera_doubt(network, survey, first.targets, first.poses)
        sparse = sparse_doubt(seeable_shares(visible, slope_map.aperture, slope_map.valid)[1], photos.eyes_m)
        good = camera is None and sparse is None
        design = (
            camera, panels_doubt(reflector.roughness, collector), heights_doubt(reflector) if good else None, sparse,
            *design_doubts(files, views, network.points, reflector, slope_map, absorber, collector, with_sizes=good),
        )  # fmt: skip
    slanting = incidence_warning(slope_map, photos.eyes_m, collector, reflector.roughness.along_rad)
    shadows = unchecked_doubt(reflector.fate)
    usual_sigma = float(np.median(slope_map.sigma_slope()[0][slope_map.valid]))
    shape = shape_doubt(reflector.shape, model.evaluation.shape_from_slopes, usual_sigma)
    said = (*measurement.doubts, left_out, strays, *design, *absorber_doubts, coverage, slanting, shape, shadows)
    doubts = tuple(text for text in said if text is not None)
    turn = float(np.radians(model.collector.orientation_deg))
    return Result(
        model.name, collector, turn, network, seen, absorber, solution, reflector, slope_map, visible, angles,
        intercept, photos, poses, pose_covariances, picture, (*network.doubts, *doubts, *intercept.doubts),
        dict(progress.durations_s),
    )  # fmt: skip


def _absorber(
    measurement: ObserverMeasurement, seen: SeenInPhotos, photos: Photos, collector: Collector
) -> tuple[AbsorberPath, AbsorberSolution | None, tuple[str, ...]]:
    """Return where the absorber is: measured, as a table says, or where the design has it; and what is doubtful."""
    section, path, solution = measurement.model.absorber, absorber_start(collector), None
    if section.file is not None:
        path = read_absorber(measurement.folder / section.file)
    elif section.source == "photos":
        count = max(2, round(collector.length_m / section.station_step_m))
        stations = np.linspace(-0.5, 0.5, count + 1) * collector.length_m
        solution = solve_absorber(seen.bearings, photos, path, stations)
        path = solution.path
    return path, solution, absorber_warnings(path, solution, collector, is_design=section.source == "design")


def _clearest_photo(seen: SeenInPhotos, reflector: Reflector) -> int:
    """Return the photo that gave most edges."""
    return int(np.argmax(np.bincount(seen.edges.photo[reflector.fate == EdgeFate.USED])))


def _photos(
    measurement: ObserverMeasurement, network: photogrammetry_pipeline.Result
) -> tuple[Photos, list[View], list[Path]]:
    """Return the poses of the photos in the network with their joint covariance, their views and files."""
    bundle = network.solved.bundle
    table = bundle.problem.observations
    files = {file.name: file for file in (*measurement.photo_files, *measurement.absorber_files)}
    poses = tuple(bundle.cam_from_world)
    covariance = bundle.covariance.joint((), np.arange(len(poses)))
    views = [View(bundle.cameras[k], pose) for k, pose in zip(bundle.problem.camera_index, poses, strict=True)]
    return Photos(poses, covariance), views, [files[name] for name in table.photos]


def write(result: Result, folder: Path) -> None:
    """Write the files of a result into an existing folder.

    folder: Where to; usually the folder that `heliogauge.results.folder.ResultFolder` gives.
    """
    write_slope_map(folder / "slope_map.nc", {"": result.slope_map}, {"input_sha256": result.input_sha256})
    write_angles(folder / ANGLES, result.slope_map, result.angles)
    write_collector(folder / COLLECTOR, result.collector)
    names = result.network.solved.bundle.problem.observations.photos
    write_slices(folder / SLICES, result.seen.slices, result.photos.eyes_m, names)
    write_overlay(folder, result.overlay, names[result.overlay.photo])
    network = folder / NETWORK_FOLDER
    network.mkdir()
    result.network.write(network)
    write_intercept(result.intercept, folder)
    panels = panel_columns(result.slope_map, result.angles, result.collector, result.reflector)
    write_table_csv(folder / "panels.csv", panels)
    tube, turn = (result.absorber, result.absorber_solution, result.collector), result.orientation_rad
    write_table_csv(folder / "absorber.csv", absorber_columns(*tube))
    write_table_csv(folder / "absorber_spans.csv", span_columns(tube_spans(*tube, turn)))
    write_points_csv(folder / "points.csv", result.network.points)
    write_cameras_json(folder / "cameras.json", result.network.cameras, refined_poses(result))
    write_table_csv(folder / "reflection_edges.csv", _edge_columns(result))
    refused = result.network.refused
    write_table_csv(
        folder / "rejected.csv", {"name": [one.name for one in refused], "reason": [one.reason for one in refused]}
    )
    write_summary(folder / "summary.json", summarise(result))


def refined_poses(result: Result) -> dict[str, PhotoPose]:
    """Return the poses of all photos as targets and reflection together have them.

    Returns: By the photo's name; residuals are those of the targets.
    """
    before = result.network.photo_poses
    both = zip(before.items(), result.poses, result.pose_covariances, strict=True)
    return {name: replace(one, cam_from_world=pose, covariance=covariance) for (name, one), pose, covariance in both}


def _edge_columns(result: Result) -> dict[str, Any]:
    edges, reflector = result.seen.edges, result.reflector
    names = np.array(result.network.solved.bundle.problem.observations.photos)
    texts = np.array([FATE_TEXTS[fate] for fate in EdgeFate])
    return {
        "image": names[edges.photo],
        # A thousandth of their sigma.
        "x_m": edges.points_m[:, 0].round(7),
        "y_m": edges.points_m[:, 1].round(7),
        "side": edges.side.astype(int),
        "sigma_x_m": edges.sigma_x_m.round(7),
        "residual_rad": reflector.residuals_rad.round(9),
        "fate": texts[reflector.fate],
    }


def summarise(result: Result) -> Summary:
    """Collect the headline numbers of a result with their sigmas, warnings and provenance."""
    bundle = result.network.solved.bundle
    collected, not_collected = intercept_numbers(result.intercept)
    numbers = {
        **slope_numbers(result.slope_map, result.angles, result.visible),
        **absorber_numbers(result.absorber, result.collector, result.absorber_solution),
        **shape_numbers(result.absorber, result.absorber_solution, result.collector, result.orientation_rad),
        "orientation_rad": result.orientation_rad,
        **edge_numbers(result.reflector),
        **surface_numbers(result.reflector),
        **collected,
        "photos_count": len(bundle.problem.observations.photos),
        "image_residual_rms_px": float(np.sqrt((bundle.residuals_px**2).sum(axis=1).mean())),
    }
    texts = {
        "design": result.slope_map.design,
        "removed": result.slope_map.removed,
        "frame": result.slope_map.frame,
        "surface": surface_text(result.reflector),
        "encoding": f"photos are {result.seen.tone.value}",
        "light": result.intercept.light,
        "intercept": result.intercept.assumption,
        "datum": bundle.datum,
        "sign": "slope_x = dz/dx; theta_r = -(its angle error), positive where the normal is turned towards +x",
        "rejected": f"{len(result.network.refused)} image points and photos, see rejected.csv",
    }
    return Summary(
        kind="observer", name=result.name, numbers=numbers, not_determined=not_collected, texts=texts,
        doubts=result.doubts, durations_s=result.durations_s, input_sha256=result.input_sha256,
    )  # fmt: skip
