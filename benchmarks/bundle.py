"""Bundle adjustment with joint covariance, against Ceres through pycolmap in the same run, and its growth.

Run: OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/bundle.py [--large] [--plot FILE.svg]
Prints CPU seconds; pycolmap (the extra ``natural``) is left out where it is not installed. ``--large`` adds 1000 photos
of 2000 targets (a minute, 2.9 GB).
"""

import importlib.util
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from photogrammetry import ImagePoints
from photogrammetry.bundle import BundleProblem, BundleResult, BundleState, CameraModel, adjust, statistics

# The eight intrinsics of COLMAP's model OPENCV.
FREE = ("focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "p1", "p2")
SIGMA_PX = 0.05
WIDTH, HEIGHT = 6000, 4000


def look_at(center: np.ndarray, target: np.ndarray, roll_rad: float) -> RigidTransform:
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross(forward, [0.1, 0.9, 0.2])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])
    turn = RigidTransform.from_rotation_vector([0, 0, roll_rad], [0, 0, 0]).rotation
    return RigidTransform(turn @ axes, -turn @ axes @ center)


def network(n_photos: int, n_targets: int) -> tuple[BundleState, BundleState, ImagePoints]:
    """Draw photos all round an 8 m panel; returns truth, disturbed start and image points with noise."""
    rng = np.random.default_rng(0)
    targets = np.column_stack([rng.uniform(-4, 4, (n_targets, 2)), rng.uniform(-0.6, 0.6, n_targets)])
    camera = Camera(
        WIDTH, HEIGHT, 5600.0, 5603.0, 3010.0, 1990.0, distortion=BrownDistortion(k1=-0.1, k2=0.05, p1=3e-4)
    )
    angles = 6 * np.pi * np.arange(n_photos) / n_photos
    poses = [
        look_at(
            np.array([7 * np.cos(a), 7 * np.sin(a), 5 + 2 * (i % 3)]), rng.uniform(-0.5, 0.5, 3), (i % 4) * np.pi / 2
        )
        for i, a in enumerate(angles)
    ]
    truth = BundleState.from_poses([camera], poses, targets)
    rows = []
    for i, pose in enumerate(poses):
        seen = camera.project(pose.apply(targets))
        inside = np.nonzero(((seen > 0) & (seen < [WIDTH - 1, HEIGHT - 1])).all(axis=1))[0]
        rows.append((np.full(inside.size, i), inside, seen[inside] + rng.normal(0, SIGMA_PX, (inside.size, 2))))
    photo, target, pixels = (np.concatenate(part) for part in zip(*rows, strict=True))
    names = tuple(str(i) for i in range(n_photos)), tuple(str(i) for i in range(n_targets))
    covariance = np.broadcast_to(np.eye(2) * SIGMA_PX**2, (len(pixels), 2, 2))
    aspect = camera.focal_y_px / camera.focal_x_px + 1e-3
    values = np.zeros(10)
    values[:4] = camera.parameters[:4] + [0.0, 20.0, 5.0, -5.0]
    values[0] = values[1] / aspect
    moved = [pose.moved(rng.normal(0, 1, 6) * [2e-3, 2e-3, 2e-3, 1e-2, 1e-2, 1e-2]) for pose in poses]
    start = BundleState.from_poses(
        [camera.with_parameters(values)], moved, targets + rng.normal(0, 0.01, targets.shape)
    )
    return truth, start, ImagePoints(*names, photo, target, pixels, covariance)


def own(start: BundleState, points: ImagePoints, *, redundancy: bool = True) -> tuple[BundleResult, list[float]]:
    """Adjust; return CPU times of adjustment, joint covariance of all blocks, redundancy numbers."""
    clock = [time.process_time()]
    result = adjust(BundleProblem(points, (CameraModel("camera", FREE),)), start)
    clock.append(time.process_time())
    _ = result.covariance.points, result.covariance.poses, result.covariance.intrinsics
    clock.append(time.process_time())
    if redundancy and points.n < 500_000:
        statistics.examine_image_points(result)
    clock.append(time.process_time())
    return result, np.diff(clock).tolist()


def ceres_scene(start: BundleState, points: ImagePoints) -> Any:
    """Return the network as pycolmap has it; image i + 1 is photo i, point j + 1 is target j."""
    import pycolmap

    scene, camera = pycolmap.Reconstruction(), start.cameras[0]
    lens = camera.distortion
    numbers = [camera.focal_x_px, camera.focal_y_px, camera.center_x_px + 0.5, camera.center_y_px + 0.5]
    numbers += [lens.k1, lens.k2, lens.p1, lens.p2]
    own = pycolmap.Camera(model="OPENCV", width=WIDTH, height=HEIGHT, params=numbers, camera_id=1)
    scene.add_camera_with_trivial_rig(own)
    tracks: list[list[tuple[int, int]]] = [[] for _ in points.targets]
    for i in range(len(points.photos)):
        rows = np.nonzero(points.photo_index == i)[0]
        keypoints = points.pixels_px[rows] + 0.5
        image = pycolmap.Image(name=str(i), keypoints=keypoints, camera_id=1, image_id=i + 1)
        pose = np.column_stack([start.rotations[i], start.translations_m[i]])
        scene.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
        for place, target in enumerate(points.target_index[rows].tolist()):
            tracks[target].append((i + 1, place))
    for xyz, track in zip(start.points_m, tracks, strict=True):
        elements = [pycolmap.TrackElement(image, place) for image, place in track]
        scene.add_point3D(xyz, pycolmap.Track(elements=elements))
    return scene


def ceres_adjuster(scene: Any, gradient_tolerance: float | None = None) -> Any:
    """Return an adjuster of the scene with two cameras held, to be solved; iterates longer where asked."""
    import pycolmap

    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = True
    options.print_summary = False
    options.ceres.solver_options.num_threads = 1
    if gradient_tolerance is not None:
        options.ceres.solver_options.gradient_tolerance = gradient_tolerance
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in scene.images:
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    return pycolmap.create_default_ceres_bundle_adjuster(options, config, scene)


def ceres(start: BundleState, points: ImagePoints) -> tuple[float, float, float]:
    """Adjust with pycolmap; return CPU times of adjustment and of its covariance, and the RMS of the residuals."""
    import pycolmap

    scene = ceres_scene(start, points)
    begin = time.process_time()
    adjuster = ceres_adjuster(scene)
    adjuster.solve()
    middle = time.process_time()
    pycolmap.estimate_ba_covariance(pycolmap.BACovarianceOptions(), scene, adjuster)
    end = time.process_time()
    scene.update_point_3d_errors()
    return middle - begin, end - middle, scene.compute_mean_reprojection_error()


def plot(path: Path, measured: list[tuple[int, float, float | None]]) -> None:
    """Draw adjustment with covariance against the number of image points."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    mpl.rcParams["svg.hashsalt"] = "bundle"
    figure, axes = pyplot.subplots(figsize=(5.5, 3.6), layout="constrained")
    axes.loglog([n for n, _, _ in measured], [own for _, own, _ in measured], "o-", label="heliogauge")
    rivals = [(n, other) for n, _, other in measured if other is not None]
    if rivals:
        axes.loglog(*zip(*rivals, strict=True), "s--", label="Ceres through pycolmap")
    axes.set(xlabel="image points", ylabel="CPU time with covariance [s]")
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    sizes = [(10, 100), (20, 200), (40, 300), (100, 1000), (200, 1000)] + [(1000, 2000)] * ("--large" in sys.argv)
    with_ceres = importlib.util.find_spec("pycolmap") is not None
    print("CPU seconds, one thread" + ("" if with_ceres else "; pycolmap is not installed, no comparison with Ceres"))
    print(f"{'photos':>7}{'targets':>9}{'points':>9}{'adjust':>9}{'covar.':>9}{'redund.':>9}{'Ceres':>9}{'covar.':>9}")
    own(*network(6, 30)[1:])  # imports and first calls
    measured: list[tuple[int, float, float | None]] = []
    for n_photos, n_targets in sizes:
        _, start, points = network(n_photos, n_targets)
        result, times = own(start, points)
        text = "".join(f"{value:9.2f}" for value in times)
        rival = None
        if with_ceres and n_photos <= 200:
            solve, covariance, error = ceres(start, points)
            rival = solve + covariance
            text += f"{solve:9.2f}{covariance:9.2f}   mean residual {error:.4f} px, ours "
            text += f"{np.linalg.norm(result.residuals_px, axis=1).mean():.4f} px"
        measured.append((points.n, times[0] + times[1], rival))
        print(f"{n_photos:7}{n_targets:9}{points.n:9}{text}", flush=True)
    if "--plot" in sys.argv:
        plot(Path(sys.argv[sys.argv.index("--plot") + 1]), measured)
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    main()
