"""Own code beside OpenCV and scikit-image on the same drawn inputs, as a table: what is kept, and what serves instead.

Run: OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/libraries.py
Prints the table of docs/explanation/libraries.md. Errors are RMS against the drawn truth; times are CPU times, best of
three. What was own code and is scikit-image's now (contours, lines of zero, unwrapping) is measured in the commit that
changed it.
"""

import sys
import time
from collections.abc import Callable

import cv2
import numpy as np
import skimage
from skimage.feature import corner_subpix
from skimage.measure import label, regionprops
from skimage.morphology import dilation, footprint_rectangle
from skimage.registration import phase_cross_correlation
from skimage.restoration import unwrap_phase
from skimage.transform import warp

from calibration.camera import Chessboard, find_chessboard
from calibration.camera.corners import CharucoBoard, find_charuco
from data_synth.targets import IsolatedTarget, board_scene, draw_isolated, image_truth, render_photo
from deflectometry.frames import sets_shifts
from deflectometry.fringes import GrayCodeObservation, KnownDisplayPoint, Observation
from deflectometry.setup import Axis, GrayCode, make_pattern
from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from photogrammetry.centers import Ellipse, measure_center

TURN = 2 * np.pi
TRIALS = 60


def row(what: str, own: str, opencv: str, scikit: str, taken: str) -> None:
    print(f"| {what} | {own} | {opencv} | {scikit} | {taken} |", flush=True)


def cpu_s(work: Callable[[], object], repeats: int = 3) -> float:
    """Least processor time of a few runs [s]."""
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return best


def rms(errors: list[np.ndarray]) -> float:
    """Root mean square of the distances in lists of errors (n, 2)."""
    return float(np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1)) / 2))


def times(own: float, *others: float) -> str:
    """Say how many times as large the errors of libraries are."""
    return ", ".join(f"{other:.4f} ({other / own:.1f} times)" for other in others)


def centers(diameter_px: float, slope_dn_per_px: float) -> None:
    rng = np.random.default_rng(11)
    target = IsolatedTarget(diameter_px, slope_dn_per_px=(slope_dn_per_px, 0.0))
    errors: dict[str, list[np.ndarray]] = {"own": [], "ellipse": [], "moments": [], "region": []}
    for _ in range(TRIALS):
        drawn = draw_isolated(target, rng)
        image = np.rint(drawn.image_dn).clip(0, 255).astype(np.uint8)
        start = Ellipse(drawn.center_px + rng.normal(0, 0.2, 2), np.eye(2) * (0.5 * diameter_px) ** 2)
        errors["own"].append(measure_center(image.astype(np.float64), start).center_px - drawn.center_px)
        _, mask = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU)
        lines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        line = max(lines, key=cv2.contourArea)
        ellipse = cv2.fitEllipse(line)[0] if len(line) >= 5 else line.mean(axis=(0, 1))
        errors["ellipse"].append(np.array(ellipse) - drawn.center_px)
        # All of the dot's light above the level of the ground, within the outline grown by the blur.
        grown = cv2.dilate(mask, np.ones((7, 7), np.uint8)) > 0
        dark = np.where(grown, float(np.median(image[~grown])) - image, 0.0)
        moments = cv2.moments(dark.astype(np.float32))
        errors["moments"].append(np.array([moments["m10"], moments["m01"]]) / moments["m00"] - drawn.center_px)
        part = max(regionprops(label(grown), dark), key=lambda one: one.area)
        errors["region"].append(np.array(part.centroid_weighted[::-1]) - drawn.center_px)
    found = {name: rms([one[None] for one in all_]) for name, all_ in errors.items()}
    ground = f", ground sloping by {slope_dn_per_px:g} DN/px" if slope_dn_per_px else ""
    row(
        f"centre of a disc of {diameter_px:g} px{ground} [px]",
        f"{found['own']:.4f}",
        times(found["own"], found["ellipse"], found["moments"]) + ": ellipse of the outline, moments",
        times(found["own"], found["region"]) + ": weighted centroid",
        "own: it has a covariance",
    )


def board(kind: str) -> None:
    """Corners of eight photos of a bent board, by the same rough places."""
    scene = board_scene(kind, 0, n_photos=8)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
    errors: dict[str, list[np.ndarray]] = {"own": [], "opencv": [], "narrow": [], "scikit": []}
    for number, view in enumerate(scene.views):
        image = render_photo(scene, view, np.random.default_rng(number))
        image = image if image.dtype == np.uint8 else (image // 257).astype(np.uint8)
        truth = image_truth(scene, view).pixels_px
        if kind == "chessboard":
            columns, rows = chessboard_size(scene)
            found, rough = cv2.findChessboardCorners(image, (columns, rows))
            if not found:
                continue
            try:
                own = find_chessboard(view.name, image, Chessboard(columns, rows)).pixels_px
            except EstimationError:
                continue
            places = {
                "own": own,
                "opencv": cv2.cornerSubPix(image, rough.copy(), (11, 11), (-1, -1), stop).reshape(-1, 2),
                "narrow": cv2.cornerSubPix(image, rough.copy(), (5, 5), (-1, -1), stop).reshape(-1, 2),
                "scikit": corner_subpix(image, np.rint(rough.reshape(-1, 2)[:, ::-1]), window_size=11)[:, ::-1],
            }
        else:
            dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
            detector = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard((10, 7), 0.03, 0.022, dictionary))
            corners = detector.detectBoard(image)[0]
            if corners is None:
                continue
            own = find_charuco(view.name, image, CharucoBoard(10, 7, "DICT_5X5_100", 22 / 30)).pixels_px
            places = {"own": own, "opencv": corners.reshape(-1, 2)}
        for name, one in places.items():
            apart = np.linalg.norm(one[:, None] - truth[None], axis=2)
            near = apart.min(axis=1) < 1.5
            errors[name].append((one - truth[apart.argmin(axis=1)])[near])
    found_px = {name: rms(one) for name, one in errors.items() if one}
    row(
        f"corners of a {'ChArUco board' if kind == 'charuco' else 'chessboard'} [px]",
        f"{found_px['own']:.4f}",
        times(found_px["own"], *(found_px[name] for name in ("opencv", "narrow") if name in found_px))
        + (": windows of 11, of 5" if "narrow" in found_px else ": CharucoDetector"),
        times(found_px["own"], found_px["scikit"]) + ": corner_subpix" if "scikit" in found_px else "has none",
        "own, after OpenCV's rough places",
    )


def chessboard_size(scene) -> tuple[int, int]:
    """Inner corners across and down, by the numbers of the points' names."""
    points = np.array([*scene.sheets[0].figure.points_m.values()])
    return tuple(int(np.unique(np.round(points[:, axis], 6)).size) for axis in (0, 1))


def unwrapping() -> None:
    """Fringes of one period: some that can be counted, and some so steep that neighbours differ by half a period."""
    height, width, pattern = 240, 320, make_pattern((80.0,), (3.0,))
    y, x = np.mgrid[:height, :width].astype(float)
    rng = np.random.default_rng(0)
    region = np.ones((height, width), dtype=bool)
    for words, reach in (("that can be counted", 0.5), ("too steep to be counted", 2.6)):
        u = 0.5 + reach * (x / width - 0.5) * (0.6 + 0.8 * y / height) / 1.4
        v = 0.02 + 0.96 * y / height
        frames = []
        for one in pattern.sets:
            place = u if one.axis is Axis.X else v
            frames += [110 + 60 * np.cos(TURN * one.periods * place - step) for step in one.steps_rad]
        images = np.rint(np.array(frames) + 6 * rng.standard_normal((len(frames), height, width))).clip(0, 255)
        images = images.astype(np.uint8)
        middle = (slice(height // 2 - 1, height // 2 + 2), slice(width // 2 - 1, width // 2 + 2))
        known = np.array([u[middle].mean(), v[middle].mean()])
        point = KnownDisplayPoint(np.array([width // 2, height // 2]), known, np.array([1e-3, 1e-3]))
        set_x = next(k for k, one in enumerate(pattern.sets) if one.axis is Axis.X)
        part = images[pattern.frame_slices[set_x]].astype(float)
        phase = np.arctan2(part[1] - part[3], part[0] - part[2])

        def wrong(turns: np.ndarray, u=u) -> str:
            off = turns - 80.0 * u
            share = np.mean(np.abs(off - np.median(off)) > 0.5)
            return f"{share:.1%} of the pixels wrong, silently" if share else "right everywhere"

        try:
            found = Observation(images, pattern, known_point=point).screen_map(region)
            good = found.flags == 0
            far = np.mean(np.abs(found.u - u)[good] > 0.5 / 80)
            own = "right everywhere" if far == 0 else f"{far:.1%} of the pixels wrong"
        except EstimationError:
            own = "refused, with the reason"
        parameters = cv2.phase_unwrapping.HistogramPhaseUnwrapping.Params()
        parameters.height, parameters.width = height, width
        histogram = cv2.phase_unwrapping.HistogramPhaseUnwrapping.create(parameters)
        by_opencv = histogram.unwrapPhaseMap(phase.astype(np.float32)) / TURN
        row(
            f"unwrapping fringes {words}",
            own,
            wrong(by_opencv),
            wrong(unwrap_phase(phase, rng=0) / TURN),
            "scikit-image, with the own count of contradictions",
        )


def shifts(least_px: float, most_px: float, taken: str) -> None:
    """Find by the edges of the mirror how far a set of frames has moved."""
    pattern = make_pattern((0.9, 7.9), (0.9, 7.9))
    own, scikit, opencv = [], [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        moved = rng.uniform(least_px, most_px, 2)
        frames = []
        for number, one in enumerate(pattern.sets):
            off = moved if number == 2 else np.zeros(2)
            y, x = np.mgrid[:240, :320].astype(float)
            x, y = x - off[0], y - off[1]
            mirror = 1.0
            for edge in (x - 40, 280 - x, y - 30, 210 - y):
                mirror = mirror * 0.5 * (1 + np.tanh(edge))
            place = x / 320 if one.axis is Axis.X else y / 240
            for step in one.steps_rad:
                light = 20 + mirror * (80 + 60 * np.cos(TURN * one.periods * place - step))
                frames.append(np.rint(light + rng.standard_normal(light.shape)))
        images = np.array(frames).astype(np.uint8)
        found, _ = sets_shifts(images, pattern)
        own.append((found[2] - moved)[None])
        means = [images[where].mean(axis=0) for where in pattern.frame_slices]
        usual = np.median(means, axis=0)
        scikit.append(
            (-phase_cross_correlation(usual, means[2], upsample_factor=100, normalization=None)[0][::-1] - moved)[None]
        )
        opencv.append((np.array(cv2.phaseCorrelate(usual, means[2])[0]) - moved)[None])
    row(
        f"shift of a set of frames by {least_px:g} to {most_px:g} px [px]",
        f"{rms(own):.4f}",
        times(rms(own), rms(opencv)) + ": phaseCorrelate",
        times(rms(own), rms(scikit)) + ": phase_cross_correlation",
        taken,
    )


def gray_codes() -> None:
    code = GrayCode(320, 240)
    pattern = cv2.structured_light.GrayCodePattern.create(320, 240)
    pattern.setWhiteThreshold(5)
    shown = list(pattern.generate()[1])
    images = np.array(shown)
    own = cpu_s(lambda: GrayCodeObservation(images, code).screen_map(np.ones((240, 320), dtype=bool)))
    some = [(x, y) for x in range(5, 320, 40) for y in range(5, 240, 40)]
    peer = cpu_s(lambda: [pattern.getProjPixel(shown, x, y) for x, y in some]) * 320 * 240 / len(some)
    found = GrayCodeObservation(images, code).screen_map(np.ones((240, 320), dtype=bool))
    right = np.mean(np.abs(found.u - (np.arange(320) + 0.5) / 320)[(found.flags & SampleFlag.OFF_SCREEN) == 0] < 1e-6)
    row(
        "Gray code of 320 x 240 px",
        f"{own:.3f} s, {right:.0%} right, with sigma",
        f"{peer:.2f} s, column and row alone: getProjPixel",
        "has none",
        "own; OpenCV's order and its drawn frames (tests)",
    )


def image_operations() -> None:
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.standard_normal((1200, 1600)).astype(np.float32), (0, 0), 3)
    mask = image > 0.1
    bytes_ = mask.astype(np.uint8)
    row(
        "labelling of 1600 x 1200 px [s]",
        "none",
        f"{cpu_s(lambda: cv2.connectedComponents(bytes_, connectivity=4)):.4f}",
        f"{cpu_s(lambda: label(mask, connectivity=1)):.4f}",
        "OpenCV; scikit-image where its properties of regions serve",
    )
    square = np.ones((7, 7), np.uint8)
    row(
        "largest of 7 x 7 px [s]",
        "none",
        f"{cpu_s(lambda: cv2.dilate(image, square)):.4f}",
        f"{cpu_s(lambda: dilation(image, footprint_rectangle((7, 7)))):.4f}",
        "OpenCV",
    )
    homography = np.array([[1.02, 0.01, -3.0], [0.005, 0.99, 2.0], [1e-6, 2e-6, 1.0]])
    row(
        "warp by a homography, bilinear [s]",
        "none",
        f"{cpu_s(lambda: cv2.warpPerspective(image, homography, (1600, 1200))):.4f}",
        f"{cpu_s(lambda: warp(image, np.linalg.inv(homography), order=1)):.4f}",
        "OpenCV",
    )


if __name__ == "__main__":
    if not hasattr(cv2, "structured_light"):
        sys.exit("this build of OpenCV has no contributed modules: pip install opencv-contrib-python-headless")
    cv2.setNumThreads(1)
    print(f"OpenCV {cv2.__version__}, scikit-image {skimage.__version__}\n")
    print("| what | own code | OpenCV | scikit-image | taken |\n|---|---|---|---|---|")
    for diameter in (6.0, 12.0, 30.0):
        centers(diameter, 0.0)
    centers(12.0, 1.0)
    board("chessboard")
    board("charuco")
    unwrapping()
    shifts(0.02, 0.08, "own: it has a sigma, which decides whether a set has moved")
    shifts(0.2, 0.5, "own, repeated from where it has put the set: each round leaves a tenth")
    gray_codes()
    image_operations()
