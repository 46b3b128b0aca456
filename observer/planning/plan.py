"""From measurement.toml to what a pass over a trough will give: sigmas, what is missing, where to fly."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import FLAG_TEXTS, SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.models import PhotosSection
from heliogauge.results.folder import PhotoPose, Summary, hash_files, write_cameras_json, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import read_slope_map, write_slope_map
from heliogauge.results.tables import read_table_csv
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.files import COLLECTOR, read_absorber, write_collector
from observer.pipeline.inputs import AXES, build_collector, read_targets
from observer.planning.alternatives import AS_PLANNED, Alternative, other_flights, theta_r_sigmas
from observer.planning.keys import ObserverPlanMeasurement, ObserverPlanModel
from observer.planning.monte_carlo import MonteCarlo, monte_carlo
from observer.planning.photo_network import Believed, PlannedNetwork, drawn_network
from observer.planning.planned_flight import Pass, advice, steps_too_wide
from observer.planning.simulated_edges import EdgeNoise, Scene, in_image
from observer.planning.simulated_flight import Evaluation, Simulated, simulate
from observer.product.figures_of_merit import FlightFigures, flight_figures
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.expectation import Expectation
from observer.trough.typical_mirror import MeasuredMirror, Mirror, TypicalMirror
from photogrammetry.bundle import BundleResult
from photogrammetry.keys import (
    CoordinateSection,
    DatumSection,
    PhotogrammetryMeasurement,
    PhotogrammetryModel,
    TargetsSection,
)
from photogrammetry.pipeline import build_cameras, build_constraints

#: A photo with fewer targets has no pose of its own.
_LEAST_IN_PHOTO = 4
#: Targets that are planned along the rims stand so far beside them [m].
_BESIDE_RIM_M = 0.1
#: Longitudinal incidence from which slope errors along the trough are felt (Owkes 2012, sec. 5.2) [rad].
_LARGEST_INCIDENCE_RAD = np.radians(15.0)


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult(InstrumentResult):
    """What a plan promises, ready to be written.

    collector: The design.
    network: Photos and targets.
    bundle: What the photo network will know.
    simulated: One measurement as the plan would give it.
    missing: Share of the mirror that will not be measured, by reason.
    figures: Figures of merit of the first pass.
    spread: Scatter of many simulated measurements; None where not asked.
    alternatives: What other flights would give, the planned one first; empty where not asked.
    """

    kind: ClassVar[str] = "observer-plan"
    collector: Collector
    network: PlannedNetwork
    bundle: BundleResult
    simulated: Simulated
    missing: dict[SampleFlag, float]
    figures: FlightFigures
    spread: MonteCarlo | None
    alternatives: tuple[Alternative, ...] = ()

    def summarise(self) -> Summary:
        """Collect the headline numbers of a plan."""
        slope_map, path = self.simulated.slope_map, self.simulated.absorber
        valid = slope_map.valid
        sigma, own = slope_map.sigma_slope()[0][valid], slope_map.sigma_random_x[valid]
        sigma_theta_r = theta_r_sigmas(slope_map)
        sigma_x, sigma_z = path.sigma_at(path.y_m)
        eyes = _place_variances(self)
        figures, spread = self.figures, self.spread
        numbers: dict[str, float | int | None] = {
            "photos_count": len(self.network.poses),
            "sigma_theta_r_median_rad": float(np.median(sigma_theta_r)),
            "sigma_theta_r_95_percent_rad": float(np.percentile(sigma_theta_r, 95)),
            "sigma_theta_r_without_tilt_median_rad": float(np.median(theta_r_sigmas(slope_map, with_tilt=False))),
            "sigma_slope_x_median_rad": float(np.median(sigma)),
            "sigma_slope_x_95_percent_rad": float(np.percentile(sigma, 95)),
            "sigma_random_slope_x_median_rad": float(np.median(own)),
            "measured_share": slope_map.measured_share,
            "sigma_absorber_x_rms_m": float(np.sqrt(np.mean(sigma_x**2))),
            "sigma_absorber_z_rms_m": float(np.sqrt(np.mean(sigma_z**2))),
            "sigma_camera_position_rms_m": float(np.sqrt(eyes.mean())),
            "pixel_on_aperture_m": figures.pixel_on_aperture_m,
            "pixel_on_absorber_m": figures.pixel_on_absorber_m,
            "camera_angle_step_rad": figures.camera_angle_step_rad,
            "camera_target_angle_deg": float(np.degrees(figures.camera_target_angle_rad)),
            "longitudinal_incidence_deg": float(np.degrees(figures.longitudinal_incidence_rad)),
        }
        if spread is not None:
            numbers |= {
                "monte_carlo_runs_count": spread.runs,
                "monte_carlo_rms_slope_x_rad": spread.rms_rad,
                "monte_carlo_95_percent_rad": spread.percentile_95_rad,
                "monte_carlo_over_sigma_ratio": spread.ratio,
            }
        texts = {
            "design": slope_map.design,
            "datum": self.bundle.datum,
            "sigma": "at a node before any removal, of dz/dx (sigma_slope_x) and of the normal (sigma_theta_r): noise, "
            "what lies between photos, slopes along the trough as far as their prior, cameras and absorber, which all "
            "nodes share",
            "not_included": "false edges, clouds, glass and blur beyond the sigmas of the edges given",
        }
        return self._summary(numbers, texts)

    def write_files(self, folder: Path) -> None:
        """Write stations, maps, absorber and cameras of a plan into an existing folder."""
        write_table_csv(folder / "stations.csv", _station_columns(self))
        write_slope_map(folder / "slope_map.nc", {"": self.simulated.slope_map}, {"input_sha256": self.input_sha256})
        write_table_csv(folder / "missing.csv", _missing_columns(self))
        write_collector(folder / COLLECTOR, self.collector)
        path = self.simulated.absorber
        sigma_x, sigma_z = path.sigma_at(path.y_m)
        write_table_csv(
            folder / "absorber.csv",
            {"y_m": path.y_m, "x_a_m": path.x_m, "z_a_m": path.z_m, "sigma_x_a_m": sigma_x, "sigma_z_a_m": sigma_z},
        )
        photos = self.bundle.problem.observations.photos
        poses = {
            name: PhotoPose("camera", pose, 0.5 * (matrix + matrix.T))
            for name, pose, matrix in zip(photos, self.network.poses, self.bundle.covariance.poses, strict=True)
        }
        write_cameras_json(folder / "cameras.json", {"camera": self.bundle.cameras[0]}, poses)
        if self.alternatives:
            write_table_csv(folder / "alternatives.csv", _alternative_columns(self.alternatives))
        if self.spread is not None:
            write_table_csv(folder / "monte_carlo.csv", _spread_columns(self, self.spread))
            write_table_csv(
                folder / "monte_carlo_settling.csv",
                {
                    "runs_count": [count for count, _ in self.spread.settling],
                    "rms_slope_x_rad": [value for _, value in self.spread.settling],
                },
            )

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return headline_text(self.summarise())


def run(measurement: ObserverPlanMeasurement, progress: Progress | None = None) -> PlanResult:
    """Simulate what is planned.

    Returns: Sigmas at every point, what is missing, advice.
    InputError: Targets, camera, passes or an earlier result that cannot be used.
    EstimationError: The photos show too few targets, or too little of the reflection.
    """
    progress = progress or SilentProgress()
    model = measurement.model
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    collector = build_collector(model.collector)
    passes = planned_passes(model)
    poses = tuple(pose for one in passes for pose in one.poses())
    with progress.stage("photo network"):
        network, left_out = planned_network(model, measurement.folder, poses)
        bundle = drawn_network(network, None)
    noise = EdgeNoise(model.noise.reflection_px, model.noise.absorber_px)
    evaluation = planned_evaluation(model)
    with progress.stage("simulate the measurement"):
        rng = np.random.default_rng([model.mirror.seed, 1])
        scene = planned_scene(measurement, collector, network, 1e-3 * model.evaluation.row_step_mm, rng)
        simulated = simulate(scene, Believed.of(drawn_network(network, rng)), noise, evaluation, rng)
        missing = missing_shares(simulated.slope_map)
    eyes = np.array([pose.inverse().translation_m for pose in network.poses])
    spread = _spread(measurement, collector, network, progress)
    pixel_rad = 1 / max(network.camera.focal_x_px, network.camera.focal_y_px)
    figures = flight_figures(collector, pixel_rad, eyes[: passes[0].photos])
    slope_error_rad = 1e-3 * model.mirror.slope_error_mrad
    doubts = gather_doubts(
        advice(collector, passes, missing, slope_error_rad),
        steps_too_wide(passes),
        _steep_incidence(passes, figures),
        _spread_doubts(spread),
        left_out,
    )
    return PlanResult(
        collector,
        network,
        bundle,
        simulated,
        missing,
        figures,
        spread,
        _alternatives(
            measurement, collector, passes, Alternative.of(AS_PLANNED, len(network.poses), simulated), progress
        ),
        name=model.name,
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def _alternatives(
    measurement: ObserverPlanMeasurement,
    collector: Collector,
    passes: tuple[Pass, ...],
    as_planned: Alternative,
    progress: Progress,
) -> tuple[Alternative, ...]:
    """Evaluate other flights over the same mirror, where that is asked; those that determine nothing are left out."""
    model = measurement.model
    if not model.alternatives:
        return ()
    noise, evaluation = EdgeNoise(model.noise.reflection_px, model.noise.absorber_px), planned_evaluation(model)
    flights, found = other_flights(passes, collector.length_m), [as_planned]
    with progress.stage("other flights", len(flights)) as stage:
        for name, flown in flights.items():
            # The mirror is drawn first: all flights pass over the same one.
            rng = np.random.default_rng([model.mirror.seed, 1])
            poses = tuple(pose for one in flown for pose in one.poses())
            with suppress(EstimationError):
                network, _ = planned_network(model, measurement.folder, poses)
                scene = planned_scene(measurement, collector, network, 1e-3 * model.evaluation.row_step_mm, rng)
                one = simulate(scene, Believed.of(drawn_network(network, rng)), noise, evaluation, rng)
                found.append(Alternative.of(name, len(network.poses), one))
            stage.advance()
    return tuple(found)


def _alternative_columns(alternatives: tuple[Alternative, ...]) -> dict[str, Any]:
    return {
        "flight": [one.name for one in alternatives],
        "photos": [one.photos for one in alternatives],
        "sigma_theta_r_median_rad": [one.sigma_theta_r_rad for one in alternatives],
        "sigma_theta_r_without_tilt_median_rad": [one.sigma_without_tilt_rad for one in alternatives],
        "sigma_random_slope_x_median_rad": [one.sigma_random_rad for one in alternatives],
        "measured_share": [one.measured_share for one in alternatives],
        "sigma_absorber_x_rms_m": [one.sigma_absorber_x_m for one in alternatives],
        "sigma_absorber_z_rms_m": [one.sigma_absorber_z_m for one in alternatives],
    }


def planned_passes(model: ObserverPlanModel) -> tuple[Pass, ...]:
    """Return the passes that measurement.toml plans.

    InputError: A pass that cannot be flown.
    """
    return tuple(Pass(one.height_m, one.reach_m, one.photos, one.y_m, one.look_y_m) for one in model.flight)


def planned_network(
    model: ObserverPlanModel, folder: Path, poses: tuple[RigidTransform, ...]
) -> tuple[PlannedNetwork, tuple[Doubt, ...]]:
    """Build the photo network of a plan.

    model: What measurement.toml says.
    poses: ``cam_from_frame`` of each planned photo.
    Returns: The network, and why photos were left out.
    InputError: A list of targets or a camera that cannot be used.
    EstimationError: Fewer than two photos see four targets.
    """
    planned = planned_targets(model, folder)
    photogrammetry = PhotogrammetryModel(
        kind="photogrammetry",
        name=model.name,
        camera=(model.camera,),
        images=PhotosSection(photos=("planned",)),
        targets=TargetsSection(dictionary="aicon-12"),
        scale_bar=model.scale_bar,
        constraint=(*planned.coordinates, *model.distance),
        datum=DatumSection(kind="inner"),
    )
    found = build_cameras(PhotogrammetryMeasurement(folder, photogrammetry, ()), ["planned"], None)
    network = PlannedNetwork(
        found.cameras[0],
        found.models[0],
        poses,
        planned.names,
        planned.points_m,
        build_constraints(photogrammetry),
        model.targets.sigma_px,
    )
    seen = np.array([in_image(view, planned.points_m).sum() for view in network.views])
    keep = seen >= _LEAST_IN_PHOTO
    if keep.sum() < 2:
        raise EstimationError(
            f"plan: {int(keep.sum())} photos see {_LEAST_IN_PHOTO} of {len(planned.names)} targets, two are needed; "
            "fly higher, look at the collector, or use a shorter focal length"
        )
    left_out = tuple(
        Doubt("plan_photo_left_out", f"photo_{k + 1:03d}: sees {seen[k]} targets", {"targets_count": int(seen[k])})
        for k in np.nonzero(~keep)[0]
    )
    return replace(network, poses=tuple(pose for pose, good in zip(poses, keep, strict=True) if good)), left_out


class PlannedTargets(NamedTuple):
    """Targets of a plan: what will be known of them, their names, their places, shape (n, 3) [m]."""

    coordinates: tuple[CoordinateSection, ...]
    names: tuple[str, ...]
    points_m: FloatArray


def planned_targets(model: ObserverPlanModel, folder: Path) -> PlannedTargets:
    """Return the targets that are planned: as the list has them, or along the rims.

    model: What measurement.toml says.
    InputError: A list that cannot be used.
    """
    section, design = model.targets, model.collector
    if section.list_file is not None:
        path = folder / section.list_file
        return PlannedTargets(read_targets(path), *_places(path))
    half = (section.rim_count or 0) // 2
    across, along = design.aperture_width_m / 2 + _BESIDE_RIM_M, 0.49 * design.length_m
    height = design.aperture_width_m**2 / (16 * design.focal_length_m)
    points = np.array([[side * across, y, height] for side in (-1, 1) for y in np.linspace(-along, along, half)])
    names = tuple(str(k + 1) for k in range(len(points)))
    coordinates = tuple(
        CoordinateSection(kind="coordinate", target=name, axis=axis, value_m=float(value), sigma_mm=section.sigma_mm)
        for name, point in zip(names, points, strict=True)
        for axis, value in zip(AXES, point, strict=True)
    )
    return PlannedTargets(coordinates, names, points)


def _places(path: Path) -> tuple[tuple[str, ...], FloatArray]:
    """Read where the targets are planned; those whose coordinates will not be known (empty sigma) have a place too."""
    table = read_table_csv(path, ("target", "x_m", "y_m", "z_m"))
    rows = []
    for line, name in enumerate(table["target"], start=2):
        try:
            rows.append([float(table[f"{axis}_m"][line - 2]) for axis in "xyz"])
        except ValueError:
            raise InputError(
                f"{path}, line {line}: target {name} needs x_m, y_m and z_m for a plan; leave the sigmas empty where "
                "the coordinates will not be known"
            ) from None
    return tuple(table["target"]), np.array(rows)


def planned_evaluation(model: ObserverPlanModel) -> Evaluation:
    """Return how the planned measurement will be evaluated.

    model: What measurement.toml says.
    """
    return Evaluation(
        1e-3 * model.evaluation.column_step_mm,
        model.absorber.station_step_m,
        1e-3 * model.evaluation.longitudinal_slope_mrad,
        model.absorber.source == "photos",
    )


def planned_scene(
    measurement: ObserverPlanMeasurement,
    collector: Collector,
    network: PlannedNetwork,
    row_step_m: float,
    rng: np.random.Generator,
) -> Scene:
    """Return what the planned photos look at.

    rng: Draws the mirror where no earlier result says it.
    InputError: An earlier result that cannot be read.
    """
    model = measurement.model
    mirror: Mirror = TypicalMirror.drawn(
        collector, rng, 1e-3 * model.mirror.slope_error_mrad, 1e-3 * model.mirror.longitudinal_error_mrad
    )
    absorber = AbsorberPath.designed(collector)
    if measurement.earlier is not None:
        mirror = MeasuredMirror.of(read_slope_map(measurement.earlier / "slope_map.nc"))
        path = read_absorber(measurement.earlier / "absorber.csv")
        absorber = AbsorberPath(path.y_m, path.x_m, path.z_m, np.zeros_like(path.covariance_m2))
    truth = Expectation(
        collector, absorber, collector.rows_m(row_step_m), 1e-3 * model.evaluation.largest_slope_error_mrad
    )
    return Scene(truth, mirror, network.views)


def missing_shares(slope_map: SlopeMap) -> dict[SampleFlag, float]:
    """Return which share of a mirror is not measured for which reason.

    Returns: Shares of the nodes on panels; reasons that do not occur are left out.
    """
    lost = slope_map.aperture & ~slope_map.valid
    count = max(int(slope_map.aperture.sum()), 1)
    shares = {flag: int((lost & ((slope_map.flags & np.uint32(flag)) > 0)).sum()) / count for flag in SampleFlag}
    return {flag: share for flag, share in shares.items() if share > 0}


def _spread(
    measurement: ObserverPlanMeasurement, collector: Collector, network: PlannedNetwork, progress: Progress
) -> MonteCarlo | None:
    """Repeat the simulated measurement with another mirror, network and noise each time, where that is asked."""
    model = measurement.model
    runs = model.monte_carlo.runs
    if runs == 0:
        return None
    noise, evaluation = EdgeNoise(model.noise.reflection_px, model.noise.absorber_px), planned_evaluation(model)

    def once(rng: np.random.Generator) -> Simulated:
        scene = planned_scene(measurement, collector, network, 1e-3 * model.monte_carlo.row_step_mm, rng)
        return simulate(scene, Believed.of(drawn_network(network, rng)), noise, evaluation, rng)

    with progress.stage("Monte Carlo", runs) as stage:
        return monte_carlo(once, runs, model.monte_carlo.seed, stage.advance)


def _steep_incidence(passes: tuple[Pass, ...], figures: FlightFigures) -> Doubt | None:
    incidence = figures.longitudinal_incidence_rad
    if len({one.y_m for one in passes}) > 1 or incidence <= _LARGEST_INCIDENCE_RAD:
        return None
    return Doubt(
        "plan_incidence_large",
        f"longitudinal incidence up to {np.degrees(incidence):.1f} degrees: from 15 degrees on slope errors along "
        "the trough are felt (0.5 mrad at two sigma of 5 mrad); fly higher, or two passes at different y",
        {"incidence_rad": incidence},
    )


def _spread_doubts(spread: MonteCarlo | None) -> Iterator[Doubt]:
    if spread is None:
        return
    if not spread.has_settled:
        text = f"Monte Carlo: the scatter has not settled within 5 % after {spread.runs} runs; ask for more"
        yield Doubt("monte_carlo_not_settled", text, {"runs_count": spread.runs})
    if spread.failed:
        text = f"Monte Carlo: {len(spread.failed)} simulations gave no result, the first: {spread.failed[0]}"
        yield Doubt("monte_carlo_runs_failed", text, {"failed_count": len(spread.failed)})


def _place_variances(result: PlanResult) -> FloatArray:
    """Return the mean variance of the three coordinates of each camera's place, shape (n,) [m^2]."""
    both = zip(result.network.poses, result.bundle.covariance.poses, strict=True)
    return np.array([np.trace(pose.origin_covariance(one)) / 3 for pose, one in both])


def _station_columns(result: PlanResult) -> dict[str, Any]:
    table = result.bundle.problem.observations
    inverse = [pose.inverse() for pose in result.network.poses]
    eyes, looks = (np.array([getattr(one, name) for one in inverse]) for name in ("translation_m", "rotation"))
    sigma = np.sqrt(_place_variances(result))
    columns: dict[str, Any] = {"name": list(table.photos)}
    columns |= {f"{axis}_m": eyes[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"direction_{axis}": looks[:, i, 2] for i, axis in enumerate("xyz")}
    return columns | {"targets_count": table.n_targets_in_photo, "sigma_position_m": sigma}


def _missing_columns(result: PlanResult) -> dict[str, Any]:
    return {
        "reason": [FLAG_TEXTS[flag] for flag in result.missing],
        "share": [result.missing[flag] for flag in result.missing],
    }


def _spread_columns(result: PlanResult, spread: MonteCarlo) -> dict[str, Any]:
    """Return the map of the scatter, a row for each node that is measured."""
    rows, columns = spread.rms_slope_x.shape
    x = result.simulated.slope_map.x_m
    length = result.collector.length_m
    y = (np.arange(rows) + 0.5) * (length / rows) - length / 2
    grid_x, grid_y = np.meshgrid(x, y)
    known = np.isfinite(spread.rms_slope_x)
    if x.size != columns:
        raise InputError("Monte Carlo: its map has other columns than the plan's")
    return {
        "x_m": grid_x[known],
        "y_m": grid_y[known],
        "rms_error_slope_x_rad": spread.rms_slope_x[known],
        "sigma_slope_x_rad": spread.stated_slope_x[known],
    }


def headline_text(summary: Summary) -> str:
    """Say the plan in a few lines for the terminal."""
    numbers = summary.numbers

    def value(key: str, factor: float = 1e3) -> str:
        return f"{factor * float(numbers[key] or 0.0):.3g}"

    lines = [
        f"{summary.name}: {numbers['photos_count']} photos",
        f"  sigma of theta_r  {value('sigma_theta_r_median_rad')} mrad median, 95 % of the points below "
        f"{value('sigma_theta_r_95_percent_rad')} mrad",
        f"  measured          {value('measured_share', 100)} % of the mirror, see missing.csv",
        f"  absorber          sigma x {value('sigma_absorber_x_rms_m')} mm, z {value('sigma_absorber_z_rms_m')} mm",
        f"  cameras           sigma {value('sigma_camera_position_rms_m')} mm from the targets alone",
        f"  pass              pixel {value('pixel_on_aperture_m')} mm on the mirror, photos "
        f"{value('camera_angle_step_rad')} mrad apart, longitudinal incidence up to "
        f"{value('longitudinal_incidence_deg', 1)} degrees",
    ]
    if "monte_carlo_runs_count" in numbers:
        lines.append(
            f"  Monte Carlo       {numbers['monte_carlo_runs_count']} runs: "
            f"{value('monte_carlo_rms_slope_x_rad')} mrad RMS of dz/dx, 95 % within "
            f"{value('monte_carlo_95_percent_rad')} mrad; over stated sigma {value('monte_carlo_over_sigma_ratio', 1)}"
        )
    return "\n".join(lines)
