"""Screens from photos: the published dot wall with its processor time, and drawn screens against their truth.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/screen_geometry.py``; ``--wall`` stops after the wall.
"""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import h5py
import numpy as np
from _measure import OPENCSP, StageClock, evaluation_inputs, row, title
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from data_synth.fringes import Knowledge, expected_light, preset_scene
from data_synth.screens import ScreenChoice, write_screen_dataset
from deflectometry.fringes import Observation, ScreenMapLimits
from deflectometry.pipeline import Choices, evaluate_source
from deflectometry.screen_geometry import MeasuredScreen, load_screen, read_screen, run
from heliogauge.geometry.alignment import align_points
from heliogauge.running.progress import SilentProgress
from photogrammetry import ImagePoints
from tests.deflectometry.screen_geometry.published_wall import write_published_wall

SEEDS = range(3)
#: From the mirror of the small drawn measurement to its camera and screen [m].
DISTANCE_M = float(np.linalg.norm(preset_scene("small").bench.cam_from_mirror.translation_m))


def command(folder: Path, out: Path) -> float:
    """Run the command and return its processor time [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-m", "heliogauge", "deflectometry", "screen", "geometry", str(folder), "-o", str(out)]
    subprocess.run(words, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (after.ru_utime - before.ru_utime) + (after.ru_stime - before.ru_stime)


def places_by_the_publishers_way(
    folder: Path, table: ImagePoints, published_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the dots as rays intersect whose photos are placed by OpenCV's corners of the markers alone (n, 3) [m].

    table: Dots of the photos.
    published_m (n, 3): Which dots are sought.

    So OpenCSP does it (`CalibrateSofastFixedDots`): corners to a pixel, markers' coordinates and camera taken as exact.
    Also returned is what one sigma along each direction of each photo's pose does to them (m, n, 3), the poses as
    uncertain as the corners scatter about them.
    """
    camera = load_screen(folder).network.model.camera[0]
    focal_x = camera.focal_px / (1 + camera.aspect)
    matrix = np.array([[focal_x, 0, camera.center_x_px], [0, camera.focal_px, camera.center_y_px], [0, 0, 1]])
    lens = np.array([camera.k1, camera.k2, camera.p1, camera.p2])
    known = {one.target: one.xyz_m for one in load_screen(folder).model.control_point}
    finder = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000))
    seen_by: list[tuple[np.ndarray, np.ndarray]] = []
    poses: list[np.ndarray] = []
    steps: list[np.ndarray] = []

    def intersected() -> np.ndarray:
        normal, right = np.zeros((len(published_m), 3, 3)), np.zeros((len(published_m), 3))
        for (rays, there), pose in zip(seen_by, poses, strict=True):
            world = rays @ cv2.Rodrigues(pose[:3])[0]
            across = (np.eye(3) - world[:, :, None] * world[:, None]) * there[:, None, None]
            normal += across
            right += across @ (-cv2.Rodrigues(pose[:3])[0].T @ pose[3:])
        return np.linalg.solve(normal, right[..., None])[..., 0]

    for number, photo in enumerate(table.photos):
        corners, numbers, _ = finder.detectMarkers(cv2.imread(str(folder / photo), cv2.IMREAD_GRAYSCALE))
        names = [f"{marker}.{k}" for marker in np.ravel(numbers) for k in range(4)]
        seen = np.array([one in known for one in names])
        places = np.array([known[one] for one in names if one in known])
        pixels = np.concatenate([np.reshape(one, (4, 2)) for one in corners])[seen].astype(np.float64)
        _, turn, shift = cv2.solvePnP(places, pixels, matrix, lens)
        pose = np.concatenate([turn, shift])[:, 0]
        expected, derivatives = cv2.projectPoints(places, turn, shift, matrix, lens)
        scatter = np.sum((expected[:, 0] - pixels) ** 2) / (pixels.size - 6)
        normal = derivatives[:, :6].T @ derivatives[:, :6]
        steps.append(np.sqrt(scatter) * np.linalg.inv(np.linalg.cholesky(normal)))
        expected = cv2.projectPoints(published_m, turn, shift, matrix, lens)[0][:, 0]
        found = table.pixels_px[table.photo_index == number]
        apart, nearest = cKDTree(found).query(expected)
        rays = cv2.undistortPoints(found[nearest][:, None], matrix, lens)[:, 0]
        rays = np.column_stack([rays, np.ones(len(rays))])
        seen_by.append((rays / np.linalg.norm(rays, axis=1, keepdims=True), apart < 3.0))
        poses.append(pose)
    found_m, modes = intersected(), []
    for number, root in enumerate(steps):
        pose = poses[number]
        for step in root:
            poses[number] = pose + step
            modes.append(intersected() - found_m)
        poses[number] = pose
    return found_m, np.array(modes)


def published_wall(scratch: Path) -> None:
    if not OPENCSP.is_dir():
        print(f"no published data in {OPENCSP}")
        return
    folder = scratch / "wall"
    folder.mkdir()
    write_published_wall(OPENCSP / "screen_dots", folder)
    cpu = command(folder, scratch / "wall_out")
    start = time.process_time()
    for file in folder.glob("*.JPG"):
        cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    decode = time.process_time() - start
    clock = StageClock()
    result = run(load_screen(folder), clock)
    measured = read_screen(scratch / "wall_out")
    with h5py.File(OPENCSP / "screen_dots" / "expected_fixed_pattern_dot_locations.h5") as file:
        published = file["DotLocationsFixedPattern/xyz_dot_loc"][()]
        first = [int(file[f"DotLocationsFixedPattern/{axis}_dot_index"][0]) for axis in "xy"]
    rows, columns = np.mgrid[0:64, 0:64]
    theirs = published[-(31 - rows) - first[1], -(columns - 31) - first[0]]
    away = measured.screen.xyz_m - theirs
    there = np.isfinite(away[..., 0])
    again, modes = places_by_the_publishers_way(folder, result.network.result.measured.points, theirs[there])
    sigma = measured.sigma_points_m(columns / 63, rows / 63)
    own = measured.screen.sigma_at(columns / 63, rows / 63)

    def rms(values: np.ndarray) -> np.ndarray:
        return np.sqrt((values**2).mean(axis=0))

    def three(values: np.ndarray) -> str:
        return " / ".join(f"{1e3 * one:.2f}" for one in values)

    title("Published dot wall: 5 photos of 64 x 64 dots")
    row("dots with a place", f"{np.isfinite(away[..., 0]).sum()}", "4096", "4096")
    row("off the published places, RMS x / y / z [mm]", three(np.sqrt(np.nanmean(away**2, axis=(0, 1)))), "sigma", "")
    row("  their mean x / y / z [mm]", three(np.nanmean(away, axis=(0, 1))), "", "")
    row("  the same of places found in the publisher's way", three(rms(again - theirs[there])), "", "")
    row("  ours off the places found in his way", three(rms(measured.screen.xyz_m[there] - again)), "", "")
    # The noise of the dots is the same in both ways: it counts, though it cancels, so that chi is below 1.
    his = np.sqrt(np.sum(modes**2, axis=0))
    some = np.flatnonzero(there)[::25]
    at = (columns / 63).ravel()[some], (rows / 63).ravel()[some]
    apart = (measured.screen.xyz_m[there] - again)[::25]
    alone = joint_chi_square(measured, *at, apart, has_own=True)
    both = joint_chi_square(measured, *at, apart, has_own=True, more=modes[:, ::25])
    row("  sigma of his places, by how the corners scatter", three(rms(his)), "", "none stated")
    row("  sigma of the difference, of both", three(np.sqrt(rms(his) ** 2 + np.mean(sigma**2, axis=(0, 1)))), "", "")
    row("  chi of the difference, jointly, by our sigmas alone", f"{np.sqrt(alone):.2f}", "", "")
    row("  the same by those of both", f"{np.sqrt(both):.2f}", "1 at most", "")
    row("sigma x / y / z [mm]", three(np.sqrt(np.mean(sigma**2, axis=(0, 1)))), "", "none stated")
    row("of it each dot's own [mm]", three(np.sqrt(np.mean(own**2, axis=(0, 1)))), "", "")
    row("processor time of the command [s]", f"{cpu:.1f}", "1", "21")
    row("decoding the photos alone [s]", f"{decode:.2f}", "", "")
    for name, seconds in clock.cpu_s.items():
        row(f"  {name} [s]", f"{seconds:.2f}", "", "")


def joint_chi_square(
    measured: MeasuredScreen,
    u: np.ndarray,
    v: np.ndarray,
    error_m: np.ndarray,
    *,
    has_own: bool,
    more: np.ndarray | None = None,
) -> float:
    """Return the chi-square of errors of points by their joint covariance, over its degrees of freedom.

    has_own: Each point has errors of its own.
    more (m, n, 3): Further errors that points share [m].

    What a scale bar does to all points is one error: squared ratios of single points count it hundreds of times.
    """
    shared = np.array([one.warp.shifts_m(u, v).ravel() for one in measured.shared])
    if more is not None:
        shared = np.concatenate([shared, more.reshape(len(more), -1)])
    covariance = shared.T @ shared
    if has_own:
        covariance += np.diag(measured.screen.sigma_at(u, v).ravel() ** 2)
    values, vectors = np.linalg.eigh(covariance)
    keep = values > 1e-9 * values[-1]
    return float(np.mean((vectors[:, keep].T @ error_m.ravel()) ** 2 / values[keep]))


def drawn_screens(scratch: Path, show: str, noise_rad: float) -> None:
    """Compare points and measuring camera of drawn photos with the truth."""
    u, v = (one.ravel() for one in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)))
    ratios, errors, poses, slopes, joint = [], [], [], [], []
    for seed in SEEDS:
        folder = scratch / f"{show}{seed}"
        drawn = write_screen_dataset(folder, ScreenChoice(show, seed))
        measured = run(load_screen(folder)).measured
        screen = measured.screen
        if show == "dots":
            line, column = np.nonzero(np.isfinite(screen.xyz_m[..., 0]))
            lines, columns = screen.shape
            u, v, found = column / (columns - 1), line / (lines - 1), screen.xyz_m[line, column]
            low, high = drawn.dots_m.min(axis=0), drawn.dots_m.max(axis=0)
            truth = drawn.shape.points_m(low + np.stack([u, 1 - v], axis=1) * (high - low))
        else:
            found = screen.points_m(u, v)
            truth = drawn.shape.points_m(np.stack([(u - 0.5) * drawn.size_m[0], (0.5 - v) * drawn.size_m[1]], axis=1))
        place = align_points(truth, found, with_scale=False).b_from_a
        error = found - place.apply(truth)
        bench = drawn.scene.views[-1].cam_from_world @ place.inverse()
        turn = measured.cam_from_screen @ bench.inverse()
        off = np.concatenate([turn.rotation_vector_rad, measured.cam_from_screen.translation_m - bench.translation_m])
        poses.append(off @ np.linalg.solve(measured.covariance_pose, off) / 6)
        errors.append(error)
        ratios.append(error / measured.sigma_points_m(u, v))
        joint.append(joint_chi_square(measured, u, v, error, has_own=show == "dots"))
        # A source point that is off by e across turns a normal by half the angle under which the mirror sees it.
        slopes.append(error[:, :2] / (2 * DISTANCE_M))
    title(f"Drawn photos of a bent screen, {show}, {len(SEEDS)} sets", ("measured", "asked", "fringe noise"))
    row("error of points over sigma, RMS", f"{np.sqrt(np.mean(np.concatenate(ratios) ** 2)):.2f}", "0.8 to 1.25", "")
    row("the same whitened by their joint covariance", f"{np.sqrt(np.mean(joint)):.2f}", "0.8 to 1.25", "")
    row("pose of the measuring camera, chi-square over 6", f"{np.mean(poses):.2f}", "about 1", "")
    row("error of points, RMS [um]", f"{1e6 * np.sqrt(np.mean(np.concatenate(errors) ** 2)):.1f}", "", "")
    slope = np.sqrt(np.mean(np.concatenate(slopes) ** 2))
    row("slope error it causes [urad]", f"{1e6 * slope:.2f}", "below noise", f"{1e6 * noise_rad:.1f}")


def fringe_noise_rad() -> float:
    """Return the random sigma of a pixel's slope in the small drawn measurement."""
    scene = preset_scene("small")
    rng = np.random.default_rng(1)
    taken = [scene.sensor.expose(one, rng) for one in expected_light(scene, np.random.default_rng(1))[0]]
    limits = ScreenMapLimits(saturation_dn=float(scene.sensor.saturation_dn))
    lit = taken[-1].astype(np.float32) - taken[-2].astype(np.float32)
    observation = Observation(np.stack(taken[:-2]), scene.pattern, lit=lit, limits=limits)
    setup, mirror = evaluation_inputs(scene, Knowledge(), 0)
    (image,) = evaluate_source(observation, setup, mirror, Choices(), SilentProgress()).images.values()
    return float(np.nanmedian(image.sigma_x))


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        published_wall(scratch)
        if "--wall" in sys.argv:
            return
        noise = fringe_noise_rad()
        for show in ("dots", "rims"):
            drawn_screens(scratch, show, noise)


if __name__ == "__main__":
    main()
