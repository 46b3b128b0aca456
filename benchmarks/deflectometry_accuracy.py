"""Slopes held against a published result, exact truth and the noise limit; their sigma held against their errors.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/deflectometry_accuracy.py``.
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import h5py
import numpy as np
from _measure import EXPECTED, evaluation_inputs, import_real_facet, row, title

from data_synth.fringes import FringeScene, Knowledge, expected_light, preset_scene
from data_synth.optics import SurfaceErrors
from deflectometry import Options, run
from deflectometry.fringes import Observation, ScreenMapLimits, measure_screen_map
from deflectometry.pipeline import Align, Choices, Evaluation, assemble_maps, evaluate_source
from deflectometry.setup import Axis, make_pattern
from heliogauge.flags import SampleFlag
from heliogauge.measurement.load import load
from heliogauge.results.slope_map_file import read_pixels, read_slope_map
from heliogauge.running.progress import SilentProgress
from heliogauge.slopes.removal import Removal
from heliogauge.slopes.statistics import fit_quadratic

#: Variance of rounding to whole digital numbers [DN^2].
ROUNDING = 1 / 12
#: Two-sided 99 % of the normal distribution.
Z99 = 2.5758
#: Readings' degrees of freedom from which the noise itself is estimated: 8000 pixels, 1 for each of 8 sets of 4 frames.
NOISE_DEGREES = 64_000
#: Effects of the setup are propagated linearly and held by cubics: what that leaves of the strongest mode (1 % of it is
#: allowed here) is more than the sigma of far weaker ones, so those say nothing about the sigma.
WEAKEST_MODE = 0.01
DRAWS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A scene whose light is known, to be photographed again and again."""

    scene: FringeScene
    light: np.ndarray

    @classmethod
    def of(cls, scene):
        """Render once, without noise."""
        return cls(scene, expected_light(scene, np.random.default_rng(1))[0])

    def evaluate(self, knowledge, align, seed=0) -> Evaluation:
        """Photograph with fresh noise, draw what the measurement file says, and measure."""
        rng = np.random.default_rng(seed)
        taken = [self.scene.sensor.expose(one, rng) for one in self.light]
        limits = ScreenMapLimits(saturation_dn=float(self.scene.sensor.saturation_dn))
        lit = taken[-1].astype(np.float32) - taken[-2].astype(np.float32)
        observation = Observation(np.stack(taken[:-2]), self.scene.pattern, lit=lit, limits=limits)
        setup, mirror = evaluation_inputs(self.scene, knowledge, seed)
        return evaluate_source(observation, setup, mirror, Choices(align=align), SilentProgress())


def perfect(scene):
    return replace(scene, facets=tuple(replace(facet, errors=SurfaceErrors()) for facet in scene.facets))


def pixel_errors(stage, evaluation):
    """Return measured minus true slopes and their random sigma, shape (2, n), and where, shape (2, n)."""
    image = next(iter(evaluation.images.values()))
    good = np.isfinite(image.slope_x)
    place = np.stack([image.x_m[good], image.y_m[good]])
    true = np.stack(stage.scene.facets[0].surface(*place)[1:])
    sigma = np.stack([image.sigma_x[good], image.sigma_y[good]]).astype(np.float64)
    return np.stack([image.slope_x[good], image.slope_y[good]]) - true, sigma, place


def bilinear(slope_map, values, x_m, y_m):
    """Read a map between its nodes; NaN beside missing nodes."""
    column = (x_m - slope_map.x_m[0]) / (slope_map.x_m[1] - slope_map.x_m[0])
    row_ = (y_m - slope_map.y_m[0]) / (slope_map.y_m[1] - slope_map.y_m[0])
    left = np.clip(np.floor(column).astype(int), 0, slope_map.x_m.size - 2)
    low = np.clip(np.floor(row_).astype(int), 0, slope_map.y_m.size - 2)
    right, up = column - left, row_ - low
    lower = (1 - right) * values[low, left] + right * values[low, left + 1]
    upper = (1 - right) * values[low + 1, left] + right * values[low + 1, left + 1]
    return (1 - up) * lower + up * upper


def mrad(values):
    return " / ".join(f"{1e3 * value:.4f}" for value in values)


def rms(errors):
    return np.sqrt(np.mean(errors**2, axis=1))


def real_facet():
    title(
        "Real facet, the publisher's pose and screen table given: difference from the published slopes, mrad RMS x / y"
    )
    if not EXPECTED.is_file():
        row("not measured: ../shared/data/opencsp is not on this machine")
        return
    with h5py.File(EXPECTED) as file:
        facet = file["DataSofastCalculation/facet/facet_000"]
        expected = facet["SlopeSolverData/slopes_facet_xy"][()]
        x_m, y_m, _ = facet["SlopeSolverData/v_surf_points_facet"][()]
        mask = facet["CalculationImageProcessingFacet/mask_processed"][()].astype(bool)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        import_real_facet(folder / "in", with_pose=True)
        # Their slopes are in the frame that was turned to the design's normal, as with Align.NORMAL here.
        run(load(folder / "in"), Options(align=Align.NORMAL)).write(folder)
        pixels, slope_map = read_pixels(folder / "pixels.nc"), read_slope_map(folder / "slope_map.nc")
    own = np.stack([pixels["slope_x"][mask], pixels["slope_y"][mask]])
    read = np.stack([bilinear(slope_map, one, x_m, y_m) for one in (slope_map.slope_x, slope_map.slope_y)])
    for what, values in (("pixels (pixels.nc)", own), ("map (slope_map.nc), bilinear at their points", read)):
        difference = values - expected
        both = np.isfinite(difference).all(axis=0)
        found = mrad(rms(difference[:, both]))
        row(f"{what}, {np.count_nonzero(both)} of {mask.sum()} points", found, "<= 0.02 each", "itself")
        row("    without the mean difference", mrad(difference[:, both].std(axis=1)))


def noise_limit(stage, place):
    """Return the least possible RMS of slope_x and slope_y at pixels of the mirror, from light and geometry alone."""
    scene, bench = stage.scene, stage.scene.bench
    facet, sensor = scene.facets[0], scene.sensor
    frames = sensor.expected_dn(stage.light[:-2])
    variance = sensor.read_noise_dn**2 + ROUNDING
    cam_from_facet = bench.cam_from_mirror @ facet.mirror_from_facet
    points = np.stack([*place, facet.surface(*place)[0]], axis=-1)
    pixels = np.rint(bench.camera.project(cam_from_facet.apply(points))).astype(int)
    seen = bench.trace(facet, pixels[:, 0].astype(float), pixels[:, 1].astype(float))
    facet_from_wall = cam_from_facet.inverse() @ bench.cam_from_wall
    camera = cam_from_facet.inverse().translation_m
    limit = np.zeros((2, len(points)))
    for axis, step in ((Axis.X, (1e-4, 0.0)), (Axis.Y, (0.0, 1e-4))):
        information = np.zeros(len(points))
        for fringes, position in scene.pattern.sets_of(axis):
            taken = frames[position][:, pixels[:, 1], pixels[:, 0]]
            # The amplitude that is really there, blur and background included; sigma_phi = sqrt(2 / N) sigma / b.
            turn = np.exp(1j * fringes.steps_rad)
            contrast = np.abs((turn[:, None] * taken).sum(axis=0)) * 2 / len(taken)
            information += (2 * np.pi * fringes.periods * contrast) ** 2 * len(taken) / (2 * variance)
        ends = [
            facet_from_wall.apply(bench.wall.points_m(seen.u + side * step[0], seen.v + side * step[1]))
            for side in (-0.5, 0.5)
        ]
        change = (
            halving_slopes(seen.points_m, camera, ends[1]) - halving_slopes(seen.points_m, camera, ends[0])
        ) / 1e-4
        limit += change**2 / information
    return np.sqrt(np.mean(limit, axis=1))


def halving_slopes(points, camera, screen):
    to_camera, to_screen = camera - points, screen - points
    normal = to_camera / np.linalg.norm(to_camera, axis=1)[:, None]
    normal = normal + to_screen / np.linalg.norm(to_screen, axis=1)[:, None]
    return -normal[:, :2].T / normal[:, 2]


def chi_square_row(what, ratios, photographs):
    # The pixels of a photograph share one estimate of the noise, whose own spread counts too.
    band = Z99 * np.sqrt(2 / ratios.shape[1] + 2 / (NOISE_DEGREES * photographs))
    found = (ratios**2).mean(axis=1)
    inside = "in" if np.all(np.abs(found - 1) <= band) else "OUTSIDE"
    row(what, f"{found[0]:.4f} / {found[1]:.4f}", f"1 +- {band:.4f}", "no sigma", inside)


def synthetic_facet():
    """Return the rows of chi-square, to be shown together with those of the drawn setups."""
    title(
        "Synthetic facet f = 100 m, 1.2 m at 9.65 m, 8 bit, noise 1 DN, pose given: slope error, mrad RMS x / y",
        ("measured", "asked", "incumbent", "noise limit", "over the limit"),
    )
    found = {}
    small, full = preset_scene("small"), preset_scene("full")
    cases = {"small": (small, 20), "small, perfect": (perfect(small), 20), "full": (full, 1)}
    for name, (scene, photographs) in cases.items():
        stage = Stage.of(scene)
        errors, ratios = [], []
        for seed in range(photographs):
            evaluation = stage.evaluate(Knowledge(pose_known=True), Align.OUTLINE, seed)
            error, sigma, place = pixel_errors(stage, evaluation)
            errors.append(error)
            ratios.append(error / sigma)
        limit, found_rms = noise_limit(stage, place), rms(np.concatenate(errors, axis=1))
        label = f"{name}, {place.shape[1]} px, photographed {photographs} x"
        asked = ("0.0074 / 0.0038", "0.0074 / 0.0038") if name == "full" else ("", "")
        ratio = " / ".join(f"{value:.3f}" for value in found_rms / limit)
        row(label, mrad(found_rms), *asked, mrad(limit), ratio)
        found[label] = (np.concatenate(ratios, axis=1), photographs)
    return found


def bias_of_perfect_mirrors():
    title(
        "Perfect mirrors beside the vertex of their optic: mean slope error x / y, mrad",
        ("measured", "asked", "incumbent", "RMS", "predicted RMS"),
    )
    names = {"off-axis": "24.9", "off-axis-20": "6.25", "trough-panel": "wrong"}
    for name, incumbent in names.items():
        stage = Stage.of(perfect(preset_scene(name)))
        for how, knowledge, align in (
            ("pose given", Knowledge(pose_known=True), Align.OUTLINE),
            ("pose from the outline", Knowledge(), Align.NORMAL),
        ):
            evaluation = stage.evaluate(knowledge, align)
            errors, sigma, place = pixel_errors(stage, evaluation)
            modes = next(iter(evaluation.maps.values())).common.evaluate(*place)
            whole = np.sqrt(sigma**2 + (modes**2).sum(axis=0))
            label = f"{stage.scene.name}, {how}"
            row(label, mrad(errors.mean(axis=1)), "< 0.01 each", incumbent, mrad(rms(errors)), mrad(rms(whole)))


def edges_of_the_screen():
    samples, rng = 100_000, np.random.default_rng(5)
    title(
        f"First and last 0.2 % of the screen, noise 1 DN, {samples} pixels each: errors above 0.1 of the screen",
        ("unflagged", "asked", "incumbent", "arctan2 + round", "order flagged"),
    )
    ladders = {"0.9, 3.9, 15.9, 63.9": (0.9, 3.9, 15.9, 63.9), "1, 4, 16, 64": (1.0, 4.0, 16.0, 64.0), "1": (1.0,)}
    for label, periods in ladders.items():
        for low, high in ((0.0, 0.002), (0.998, 1.0)):
            pattern = make_pattern(periods, periods)
            true = rng.uniform(low, high, (2, 250, samples // 250))
            frames = []
            for fringes in pattern.sets:
                position = true[0] if fringes.axis is Axis.X else true[1]
                for step in fringes.steps_rad:
                    wave = 100 + 80 * np.cos(2 * np.pi * fringes.periods * position - step)
                    frames.append(np.rint(wave + rng.standard_normal(wave.shape)))
            found = measure_screen_map(np.array(frames, dtype=np.uint8), pattern)
            # Flagged positions are blank: NaN is no error here.
            wrong = [np.abs(measured - exact) > 0.1 for measured, exact in zip((found.u, found.v), true, strict=True)]
            gross, unflagged = naive_gross(frames, pattern, true), np.count_nonzero(wrong[0] | wrong[1])
            flagged = np.mean((found.flags & np.uint32(SampleFlag.FRINGE_ORDER_UNCERTAIN)) != 0)
            row(
                f"periods {label}, u and v in [{low:g}, {high:g}]",
                f"{unflagged}",
                "0",
                "15 to 41 %",
                f"{100 * gross:.1f} %",
                f"{100 * flagged:.2f} %",
            )


def naive_gross(frames, pattern, true):
    """Return the share of pixels that arctan2 and rounding put elsewhere on the screen, in the same frames."""
    wrong = np.zeros(true.shape[1:], dtype=bool)
    for axis, exact in zip((Axis.X, Axis.Y), true, strict=True):
        fraction = None
        for fringes, place in sorted(pattern.sets_of(axis), key=lambda pair: pair[0].periods):
            first, second, third, fourth = frames[place]
            turns = np.arctan2(second - fourth, first - third) / (2 * np.pi)
            if fraction is None:
                fraction = np.mod(turns, 1.0) / fringes.periods
            else:
                fraction = (turns + np.round(fraction * fringes.periods - turns)) / fringes.periods
        wrong |= np.abs(fraction - exact) > 0.1
    return wrong.mean()


def honesty_of_sigma(random_ratios):
    title(
        "Chi-square per degree of freedom of error / sigma at fixed truths", ("measured", "99 % band", "incumbent", "")
    )
    for label, (ratios, photographs) in random_ratios.items():
        chi_square_row(f"random share x / y, {label}", ratios, photographs)
    knowledge = Knowledge(
        sigma_focal_px=0.3,
        sigma_center_px=0.3,
        sigma_screen_rotation_mrad=0.3,
        sigma_screen_translation_mm=2.0,
        sigma_distance_mm=2.0,
    )
    given = replace(knowledge, pose_known=True, sigma_pose_rotation_mrad=0.5, sigma_pose_translation_mm=1.0)
    for name in ("small", "off-axis"):
        stage = Stage.of(perfect(preset_scene(name)))
        for how, known, align in (
            ("pose from the outline", knowledge, Align.NORMAL),
            ("pose given", given, Align.OUTLINE),
        ):
            drawn_setups(stage, known, align, f"{stage.scene.name}, {how}")


def drawn_setups(stage, knowledge, align, label):
    """Measure with setups that are wrong by draws of their sigmas, and compare errors with the whole sigma."""
    from scipy.stats import chi2

    modes_square, modes_count, pixel_square, shape_square = 0.0, 0, [], []
    for seed in range(DRAWS):
        evaluation = stage.evaluate(knowledge, align, seed)
        slope_map = next(iter(evaluation.maps.values()))
        errors, sigma, place = pixel_errors(stage, evaluation)
        modes = slope_map.common.evaluate(*place)
        # Along the principal modes of the common share, in units of the random sigma, the variance is 1 + s^2.
        white = (modes / sigma).reshape(len(modes), -1)
        values, vectors = np.linalg.eigh(white @ white.T)
        strong = values > max(1.0, values[-1] * WEAKEST_MODE**2)
        along = (vectors[:, strong].T @ white) @ (errors / sigma).ravel() / np.sqrt(values[strong])
        modes_square += float((along**2 / (1 + values[strong])).sum())
        modes_count += int(np.count_nonzero(strong))
        variance = sigma**2 + (modes**2).sum(axis=0)
        pixel_square.append(np.mean(errors**2 / variance))
        if stage.scene.name.endswith("f = 100 m"):
            fit = fit_quadratic(slope_map)
            chosen = [0, 1, 4]
            off = fit.coefficients[chosen] - [1 / 400, 1 / 400, 0.0]
            shape_square.append(off @ np.linalg.solve(fit.covariance[np.ix_(chosen, chosen)], off))
    rows = [("whole sigma, strong modes", modes_square, modes_count)]
    if shape_square:
        rows.append(("whole sigma, focal lengths and twist", sum(shape_square), 3 * len(shape_square)))
    print(
        f"  {label}: {DRAWS} drawn setups; mean of (error / whole sigma)^2 over all pixels {np.mean(pixel_square):.2f}"
    )
    for what, square, count in rows:
        low, high = chi2.ppf([0.005, 0.995], count) / count
        inside = "in" if low <= square / count <= high else "OUTSIDE"
        row(f"  {what}, {count} degrees", f"{square / count:.3f}", f"{low:.3f} to {high:.3f}", "no sigma", inside)


def true_slopes(facet, x_m, y_m):
    """Return a facet's slopes in the ensemble's frame at x and y of that frame, and where it is there."""
    mirror_from_facet = facet.mirror_from_facet
    facet_from_mirror = mirror_from_facet.inverse()
    points = np.stack([x_m, y_m, np.full(x_m.shape, mirror_from_facet.translation_m[2])], axis=-1)
    for _ in range(5):
        local = facet_from_mirror.apply(points)
        local[..., 2] = facet.surface(local[..., 0], local[..., 1])[0]
        points[..., 2] = mirror_from_facet.apply(local)[..., 2]
    slopes = np.stack(facet.surface(local[..., 0], local[..., 1])[1:])
    normal = mirror_from_facet.rotation @ np.stack([-slopes[0], -slopes[1], np.ones_like(slopes[0])])
    return np.stack([-normal[0] / normal[2], -normal[1] / normal[2]]), local


def assembled_ensemble():
    title(
        "One map of 24 facets (f = 60 m, 812 x 616 px, each canted by up to 0.5 mrad): error without each facet's mean",
        ("mrad x / y", "asked", "before", "error / sigma x / y", "asked"),
    )
    stage = Stage.of(preset_scene("ensemble"))
    evaluation = stage.evaluate(Knowledge(), Align.OUTLINE)
    whole = assemble_maps(evaluation.located.facets, evaluation.maps, Align.OUTLINE, Removal.NOTHING)
    grid, errors, ratios, cantings = np.meshgrid(whole.x_m, whole.y_m), [], [], []
    for facet in stage.scene.facets:
        near = (
            np.hypot(
                grid[0] - facet.mirror_from_facet.translation_m[0], grid[1] - facet.mirror_from_facet.translation_m[1]
            )
            < 0.3
        )
        near &= whole.valid
        x_m, y_m = grid[0][near], grid[1][near]
        true, local = true_slopes(facet, x_m, y_m)
        own = np.all(np.abs(local[:, :2]) < 0.5 * np.ptp(facet.outline_m, axis=0), axis=1)
        error = np.stack([whole.slope_x[near], whole.slope_y[near]])[:, own] - true[:, own]
        sigma = np.stack([whole.sigma_random_x[near], whole.sigma_random_y[near]])[:, own]
        cantings.append(error.mean(axis=1))
        errors.append(error - error.mean(axis=1)[:, None])
        ratios.append(errors[-1] / sigma)
    found, ratio = rms(np.concatenate(errors, axis=1)), rms(np.concatenate(ratios, axis=1))
    row("slopes", mrad(found), "0.004", "0.012", f"{ratio[0]:.2f} / {ratio[1]:.2f}", "0.8 to 1.25")
    row("canting of the facets against each other, scatter", mrad(np.std(cantings, axis=0)), "0.004", "0.012")


def main():
    cv2.setNumThreads(1)
    real_facet()
    ratios = synthetic_facet()
    bias_of_perfect_mirrors()
    edges_of_the_screen()
    honesty_of_sigma(ratios)
    assembled_ensemble()


if __name__ == "__main__":
    main()
