"""From measurement.toml to a planned network: how many photos, from where, and the sigmas they will give."""

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.surfaces import Quadric, paraboloid, plane, sphere, trough
from heliogauge.results.folder import (
    PhotoPose,
    PointTable,
    Summary,
    hash_files,
    read_camera_json,
    read_table_csv,
    write_cameras_json,
    write_points_csv,
    write_table_csv,
)
from heliogauge.results.frame import InstrumentResult
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import FloatArray
from photogrammetry.bundle.constraints import Distance
from photogrammetry.planning.keys import PhotogrammetryPlanMeasurement, PlannedObjectSection
from photogrammetry.planning.network_design import Goal, Plan, Task, plan_network
from photogrammetry.planning.planned_network import PlannedCamera
from photogrammetry.planning.stations import PlannedObject, Reach, filling_distance_m

#: A grid finer than this is a point cloud, not a plan for targets.
_MOST_TARGETS = 3000


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult(InstrumentResult):
    """A plan, ready to be written.

    task: What was asked.
    plan: The answer.
    """

    kind: ClassVar[str] = "photogrammetry-plan"
    task: Task
    plan: Plan

    def summarise(self) -> Summary:
        """Collect the headline numbers of a plan."""
        plan, task = self.plan, self.task
        prediction = plan.best.prediction
        sigma = np.sqrt((prediction.sigma_m**2).mean(axis=0))
        points = task.target_object.points_m
        extent = max(float(np.linalg.norm(points - one, axis=1).max()) for one in points)
        bundle = prediction.bundle
        numbers: dict[str, float | int | None] = {
            "photos_count": len(prediction.stations),
            "points_count": len(points),
            "image_points_count": int(prediction.rays.sum()),
            "point_sigma_rms_m": prediction.rms_m,
            "point_sigma_x_rms_m": float(sigma[0]),
            "point_sigma_y_rms_m": float(sigma[1]),
            "point_sigma_z_rms_m": float(sigma[2]),
            "point_sigma_largest_m": prediction.largest_m,
            "wanted_sigma_m": task.goal.sigma_m,
            "extent_m": extent,
            "relative_precision_ratio": extent / prediction.rms_m,
            "sigma_with_known_cameras_rms_m": float(np.sqrt((prediction.alone_m**2).mean())),
            "q_ratio": plan.q,
            "distance_m": task.reach.distance_m,
            "convergence_median_deg": float(np.degrees(np.nanmedian(prediction.convergence_rad))),
            "least_rays_count": int(prediction.rays.min()),
            "image_coverage_share": prediction.coverage_share,
            "networks_tried_count": len(plan.trials),
        }
        missing = {
            key: "not all targets are determined" for key, value in numbers.items() if not np.isfinite(value or 0.0)
        }
        what = "largest sigma" if task.goal.of_largest else "RMS of all sigmas"
        texts = {
            "answer": f"{len(prediction.stations)} photos, {plan.best.name} from the object's normal, "
            + ("the wanted sigma is reached" if plan.reached else "the wanted sigma is NOT reached"),
            "compared": f"{what} with the wanted one",
            "datum": "" if bundle is None else bundle.datum,
            "camera": f"estimated: {', '.join(task.planned.free) or 'nothing'}; sigma of an image coordinate "
            f"{task.planned.sigma_px:g} px",
            "planning_rule": "sigma = q S sigma_image / sqrt(k), k a quarter of the rays: q is 0.4 to 0.8 for "
            "strong convergent networks, 1.5 and more for stereo (Fraser 1984)",
            "not_included": "what hides a target from a camera except its own face, depth of field, errors of the "
            "scale bars' lengths beyond their sigma",
        }
        known = {key: None if key in missing else value for key, value in numbers.items()}
        return self._summary(known, texts, missing)

    def write_files(self, folder: Path) -> None:
        """Write points, stations, trials and cameras into an existing folder."""
        prediction, target_object = self.plan.best.prediction, self.task.target_object
        flags = np.where(prediction.rays > 0, 0, int(SampleFlag.NOT_SEEN)).astype(np.uint32)
        rays = prediction.rays.astype(np.int64)
        table = PointTable(target_object.names, target_object.points_m, prediction.sigma_m, rays, flags)
        write_points_csv(folder / "points.csv", table)
        write_table_csv(folder / "stations.csv", _station_columns(self.plan))
        write_table_csv(folder / "trials.csv", _trial_columns(self.plan))
        names = {f"{a}{b}_m2": (i, j) for i, a in enumerate("xyz") for j, b in enumerate("xyz") if j >= i}
        covariance = {name: prediction.covariance_m2[:, i, j] for name, (i, j) in names.items()}
        write_table_csv(folder / "points_covariance.csv", {"id": list(target_object.names), **covariance})
        if prediction.bundle is not None:
            photos = prediction.bundle.problem.observations.photos
            poses = {
                name: PhotoPose("camera", one.cam_from_world, 0.5 * (matrix + matrix.T))
                for name, one, matrix in zip(
                    photos, prediction.stations, prediction.bundle.covariance.poses, strict=True
                )
            }
            write_cameras_json(folder / "cameras.json", {"camera": prediction.bundle.cameras[0]}, poses)

    def headline(self) -> str:
        """Return the plan in a few lines for the terminal."""
        return headline_text(self.summarise())


def run(measurement: PhotogrammetryPlanMeasurement, progress: Progress | None = None) -> PlanResult:
    """Plan a network.

    InputError: Targets or camera that cannot be used.
    EstimationError: No network determines the targets.
    """
    progress = progress or SilentProgress()
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    task = build_task(measurement)
    angles = np.radians(measurement.model.stations.rings_deg).tolist()
    layouts = [(angle,) for angle in angles] + list(combinations(angles, 2))
    with progress.stage("try networks"):
        plan = plan_network(task, layouts)
    return PlanResult(
        name=measurement.model.name,
        task=task,
        plan=plan,
        doubts=plan.doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def build_task(measurement: PhotogrammetryPlanMeasurement) -> Task:
    """Turn what measurement.toml says into what is planned.

    measurement: The checked file.
    Returns: Object, camera, reach, goal, scale bars.
    InputError: A file that cannot be read, too many or too few targets, an impossible direction.
    """
    model = measurement.model
    names, points, normals = _targets(model.object, measurement.folder)
    bars: list[Distance] = []
    for number, bar in enumerate(model.scale_bar, start=1):
        ends = np.array([bar.from_m, bar.to_m])
        own = (f"bar {number} a", f"bar {number} b")
        names += own
        points = np.asarray(np.concatenate([points, ends]))
        normals = np.asarray(np.concatenate([normals, np.full((2, 3), np.nan)]))
        bars.append(Distance(*own, float(np.linalg.norm(ends[1] - ends[0])), 1e-3 * bar.sigma_mm))
    target_object = PlannedObject(names, points, normals, 1e-3 * model.object.diameter_mm)
    camera = _camera(measurement)
    planned = PlannedCamera(camera, model.camera.free, model.camera.sigma_px, model.camera.smallest_px)
    stations = model.stations
    reach = Reach(
        stations.distance_m or filling_distance_m(target_object, camera),
        stations.up,
        float("-inf") if stations.lowest_m is None else stations.lowest_m,
        float("inf") if stations.highest_m is None else stations.highest_m,
        stations.turned,
        float(np.radians(stations.largest_incidence_deg)),
    )
    goal = Goal(1e-3 * model.goal.sigma_mm, model.goal.of == "largest", model.goal.most_photos)
    return Task(target_object, planned, reach, goal, tuple(bars))


class _Targets(NamedTuple):
    """Names, places [m] and outward normals (NaN where not known) of planned targets."""

    names: tuple[str, ...]
    points_m: FloatArray
    normals: FloatArray


def _targets(section: PlannedObjectSection, folder: Path) -> _Targets:
    if section.targets is not None:
        return _listed_targets(folder / section.targets)
    width, height, spacing = (float(v or 0.0) for v in (section.width_m, section.height_m, section.spacing_m))
    columns, rows = (round(size / spacing) + 1 for size in (width, height))
    if not 4 <= columns * rows <= _MOST_TARGETS:
        raise InputError(
            f"object: spacing_m = {spacing:g} gives {columns * rows} targets; 4 to {_MOST_TARGETS} can be planned"
        )
    grid_x, grid_y = np.meshgrid(
        section.center_m[0] + np.linspace(-0.5, 0.5, columns) * width,
        section.center_m[1] + np.linspace(-0.5, 0.5, rows) * height,
    )
    x, y = grid_x.ravel(), grid_y.ravel()
    surface = _design(section)
    points = np.stack([x, y, surface.height(x, y)], axis=1)
    if not np.isfinite(points).all():
        raise InputError("object: the surface does not reach all of the object; check radius_m, width_m and height_m")
    return _Targets(tuple(str(i + 1) for i in range(x.size)), points, surface.normal(x, y))


def _design(section: PlannedObjectSection) -> Quadric:
    length = float(section.focal_length_m or section.radius_m or 1.0)
    if section.design == "plane":
        return plane()
    return {"paraboloid": paraboloid, "sphere": sphere, "trough": trough}[str(section.design)](length)


def _listed_targets(file: Path) -> _Targets:
    table = read_table_csv(file, ("id", "x_m", "y_m", "z_m"))

    def numbers(names: tuple[str, ...]) -> FloatArray:
        try:
            return np.array([[float(cell) if cell else np.nan for cell in table[name]] for name in names]).T
        except ValueError as error:
            raise InputError(f"{file}: numbers are needed in {', '.join(names)} ({error})") from None

    points: FloatArray = numbers(("x_m", "y_m", "z_m")).reshape(-1, 3)
    if not np.isfinite(points).all():
        raise InputError(
            f"{file}: a coordinate is missing for target {table['id'][int(np.nonzero(~np.isfinite(points))[0][0])]}"
        )
    axes = ("normal_x", "normal_y", "normal_z")
    normals = numbers(axes) if all(axis in table for axis in axes) else np.full(points.shape, np.nan)
    return _Targets(tuple(table["id"]), points, normals.reshape(-1, 3))


def _camera(measurement: PhotogrammetryPlanMeasurement) -> Camera:
    section = measurement.model.camera
    if section.file is not None:
        return read_camera_json(measurement.folder / section.file)
    width, height, focal = int(section.width_px or 0), int(section.height_px or 0), float(section.focal_px or 0.0)
    return Camera(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))


def _station_columns(plan: Plan) -> dict[str, Any]:
    prediction = plan.best.prediction
    stations = prediction.stations
    photos, seen = [], np.zeros(len(stations), dtype=np.intp)
    if prediction.bundle is not None:
        photos = list(prediction.bundle.problem.observations.photos)
        seen = prediction.bundle.problem.observations.n_targets_in_photo
    centers, aims = (
        np.array([getattr(one, name) for one in stations]).reshape(-1, 3) for name in ("center_m", "aim_m")
    )
    looks = (aims - centers) / np.linalg.norm(aims - centers, axis=1, keepdims=True)
    columns: dict[str, Any] = {"name": photos or [f"photo_{i + 1:03d}" for i in range(len(stations))]}
    columns |= {f"{axis}_m": centers[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"direction_{axis}": looks[:, i] for i, axis in enumerate("xyz")}
    columns |= {
        f"{name}_deg": np.degrees([getattr(one, f"{name}_rad") for one in stations])
        for name in ("roll", "ring", "azimuth")
    }
    return columns | {"targets_count": seen}


def _trial_columns(plan: Plan) -> dict[str, Any]:
    trials = plan.trials
    return {
        "layout": [one.name for one in trials],
        "photos_count": [one.count for one in trials],
        "sigma_rms_m": [one.prediction.rms_m if np.isfinite(one.prediction.rms_m) else np.nan for one in trials],
        "sigma_largest_m": [
            one.prediction.largest_m if np.isfinite(one.prediction.largest_m) else np.nan for one in trials
        ],
        "least_rays": [int(one.prediction.rays.min()) for one in trials],
        "chosen": [int(one is plan.best) for one in trials],
        "reason": [one.prediction.reason for one in trials],
    }


def headline_text(summary: Summary) -> str:
    """Say the plan in a few lines for the terminal."""
    numbers = summary.numbers

    def mm(key: str) -> str:
        value = numbers[key]
        return "not determined" if value is None else f"{1e3 * float(value):.4f}"

    lines = [
        f"{summary.name}: {summary.texts['answer']}",
        f"  distance         {numbers['distance_m']:.2f} m",
        f"  sigma of points  {mm('point_sigma_rms_m')} mm RMS, largest {mm('point_sigma_largest_m')}; "
        f"wanted {mm('wanted_sigma_m')} ({summary.texts['compared']})",
        f"  by direction     x {mm('point_sigma_x_rms_m')}   y {mm('point_sigma_y_rms_m')}"
        f"   z {mm('point_sigma_z_rms_m')} mm",
        f"  planning rule    q = {numbers['q_ratio']:.2f} (0.4 to 0.8 for strong convergent networks)",
        f"  tried            {numbers['networks_tried_count']} networks, see trials.csv; what to do: stations.csv",
    ]
    return "\n".join(lines)
