"""Slopes of a trough from photos of an independent path tracer against their truth, beside what is asked of them.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/observer_rendered.py FOLDER [KEY=VALUE ..]`` with
Mitsuba 3 installed (``pip install 'heliogauge[bench]'``). One pass of 61 photos is drawn; all of them and every second
one (31) are measured as by the command of a user. FOLDER keeps the light of each photo by the content of its scene:
some 6 s of CPU each. KEY=VALUE changes the scene (``sky=clear``, ``has_glass=0``, ``heights_mm=0``, see `Scene`) or the
measurement (``photos=61,31``, ``stated_height_mm=1``).
"""

import sys
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
from _measure import row, title
from _rendered_trough import (
    DICTIONARY,
    GAP_M,
    SUPPORT_WIDTH_M,
    Mirror,
    Receiver,
    Renderer,
    Scene,
    View,
    glass_in_even_light,
    project,
    targets_of,
    views_of,
)

from heliogauge.flags import SampleFlag
from heliogauge.measurement.load import load
from heliogauge.measurement.writer import dump_toml
from observer import Options, Result, run
from observer.trough import seeable_shares

#: Lens and sensor: blur of the lens, full scale, noise.
BLUR_PX, EXPOSURE, NOISE_DN = 0.5, 0.9, 1.0
#: Rows and columns of the map from one node that is whitened to the next; with less certainty nodes are bridged [rad].
NODES, KNOWN_RAD = (50, 15), 0.25e-3
#: The list of targets is good for this [m].
LISTED_M = 1e-3


def rendered(folder: Path, scene: Scene, numbers: list[int]) -> Path:
    """Draw photos of a scene unless they are there."""
    place = folder / scene.key
    missing = [number for number in numbers if not (place / f"{number:03d}.npy").exists()]
    if missing:
        renderer, views = Renderer(scene, place / "meshes"), views_of(scene)
        for number in missing:
            light = renderer.take(views[number], number + 1000 * scene.seed)
            part = place / f"{number:03d}.part.npy"
            np.save(part, light.astype(np.float16))
            part.rename(place / f"{number:03d}.npy")
    return place


def written(folder: Path, scene: Scene, n_photos: int, stated_height_mm: float | None = None) -> Path:
    """Write the measurement folder of evenly spread photos of the pass."""
    numbers = chosen_photos(scene, n_photos)
    lights = rendered(folder, scene, numbers)
    place = folder / f"{scene.key}_{n_photos}_{stated_height_mm or 'usual'}"
    place.mkdir(exist_ok=True)
    for number in numbers:
        rng = np.random.default_rng([scene.seed, 6, number])
        light = cv2.GaussianBlur(np.load(lights / f"{number:03d}.npy").astype(np.float32), (0, 0), BLUR_PX)
        light = np.clip(EXPOSURE * light, 0, 1)
        encoded = np.where(light < 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
        noisy = 255 * encoded + NOISE_DN * rng.normal(size=light.shape)
        cv2.imwrite(str(place / f"photo_{number:03d}.png"), np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    (place / "measurement.toml").write_text(dump_toml(content(scene, stated_height_mm)))
    rng = np.random.default_rng([scene.seed, 7])
    lines = ["target,x_m,y_m,z_m,sigma_x_mm,sigma_y_mm,sigma_z_mm"]
    for target in targets_of(scene):
        x, y, z = target.place_m + LISTED_M * rng.normal(size=3)
        lines.append(f"{target.code.name},{x:.6f},{y:.6f},{z:.6f},1,1,1")
    (place / "targets.csv").write_text("\n".join(lines) + "\n")
    return place


def chosen_photos(scene: Scene, n_photos: int) -> list[int]:
    """Return the numbers of evenly spread photos of the pass."""
    return np.linspace(0, scene.n_photos - 1, n_photos).round().astype(int).tolist()


def content(scene: Scene, stated_height_mm: float | None) -> dict[str, object]:
    """Return what measurement.toml says: what the person who measures knows."""
    across, along = scene.panel_edges_m
    collector: dict[str, object] = {
        "aperture_width_m": scene.aperture_m,
        "length_m": scene.length_m,
        "focal_length_m": scene.focal_length_m,
        "absorber_diameter_mm": 2e3 * scene.absorber_radius_m,
        "panel_edges_x_m": across.round(6).tolist(),
        "panel_edges_y_m": along.round(6).tolist(),
        "panel_gap_mm": 1e3 * GAP_M,
        "support_y_m": scene.supports_m.round(6).tolist(),
        "support_width_m": SUPPORT_WIDTH_M,
    }
    if scene.has_glass:
        collector["glass_outer_diameter_mm"] = 1e3 * scene.glass_outer_m
        collector["glass_inner_diameter_mm"] = 1e3 * scene.glass_inner_m
        collector["glass_index"] = scene.glass_index
    if stated_height_mm is not None:
        collector["panel_height_sigma_mm"] = stated_height_mm
    return {
        "kind": "observer",
        "name": "rendered trough",
        "collector": collector,
        "camera": {
            "width_px": scene.width_px,
            "height_px": scene.height_px,
            "focal_px": scene.focal_px,
            "center_x_px": (scene.width_px - 1) / 2,
            "center_y_px": (scene.height_px - 1) / 2,
        },
        "images": {"photos": "photo_*.png"},
        "targets": {
            "dictionary": DICTIONARY,
            "diameter_mm": 1e3 * scene.target_diameter_m,
            "polarity": "black-on-white",
            "file": "targets.csv",
        },
    }


def drawn_beside(light: np.ndarray, scene: Scene, view: View) -> np.ndarray:
    """Return by how much the targets' dots are drawn beside their projection, shape (n, 2) [px].

    Centre of darkness of each dot within its white gap, which needs nothing of the program that is measured.
    """
    found = []
    for target in targets_of(scene):
        centre = project(scene, view, target.place_m[None])[0]
        radius = 1.5 * scene.target_diameter_m / 2 * scene.focal_px / (scene.height_m - target.place_m[2])
        x, y = np.meshgrid(np.arange(scene.width_px), np.arange(scene.height_px))
        inside = np.hypot(x - centre[0], y - centre[1]) < radius
        if np.hypot(*np.minimum(centre, [scene.width_px, scene.height_px] - centre)) < radius or inside.sum() < 20:
            continue
        dark = np.maximum(np.quantile(light[inside], 0.85) - light[inside], 0)
        found.append([np.average(x[inside], weights=dark) - centre[0], np.average(y[inside], weights=dark) - centre[1]])
    return np.array(found)


def check_geometry(folder: Path, scene: Scene, n_photos: int) -> None:
    """Compare the renderer's camera with the projection that the truth is stated by."""
    views, numbers = views_of(scene), chosen_photos(scene, n_photos)[:: max(1, n_photos // 6)]
    lights = rendered(folder, scene, numbers)
    beside = np.concatenate(
        [drawn_beside(np.load(lights / f"{k:03d}.npy").astype(float), scene, views[k]) for k in numbers]
    )
    title("the renderer's geometry", ("measured", "asked"))
    row("targets beside their projection, mean x, y [px]", ", ".join(f"{one:.3f}" for one in beside.mean(0)), "<= 0.02")
    row("  scatter x, y [px]", ", ".join(f"{one:.3f}" for one in beside.std(0)), "")
    if scene.has_glass:
        light = glass_in_even_light(scene)
        row("light across empty glass where all around is 1", f"{light.min():.3f} to {light.max():.3f}", "1 +- 0.01")


class Truth:
    """What a result is held against."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.mirror, self.receiver = scene, Mirror(scene), Receiver(scene)

    def slope_errors(self, result: Result) -> tuple[np.ndarray, np.ndarray]:
        """Return error and sigma of slopes across at all nodes, NaN without a value, shape (ny, nx)."""
        found = result.slope_map
        true = self.mirror.deviation(*np.meshgrid(found.x_m, found.y_m))[1]
        return np.where(found.valid, found.slope_error_x - true, np.nan), found.sigma_slope()[0]

    def whitened(self, result: Result) -> tuple[np.ndarray, float]:
        """Return errors of slopes across at some nodes, whitened by their joint covariance, shape (n,).

        Beside them the standard deviation that the mean of (error / sigma)^2 of these nodes has by chance: all share
        the errors of targets and tube, so that it is near 0.6, not ``sqrt(2 / n)``.
        """
        found, reflector = result.slope_map, result.reflector
        chosen = np.zeros(found.valid.shape, dtype=bool)
        chosen[NODES[0] // 2 :: NODES[0], NODES[1] // 2 :: NODES[1]] = True
        own = (found.flags & np.uint32(SampleFlag.SMOOTHED_GAP)) == 0
        chosen &= found.valid & own & (reflector.errors.random[..., 0, 0] < KNOWN_RAD**2)
        row, column = np.nonzero(chosen)
        single = np.zeros((row.size, *chosen.shape))
        single[np.arange(row.size), row, column] = 1.0
        at = np.arange(chosen.shape[0])
        places = [
            np.stack([np.interp(at, reflector.errors.mode_rows, line) for line in mode.T], axis=1)
            for mode in reflector.errors.modes_apart
        ]
        shown = np.array([place[chosen] for place in places]).reshape(-1, row.size)
        covariance = reflector.sums(single) + shown.T @ shown
        error = self.slope_errors(result)[0][chosen]
        sigma = np.sqrt(np.diagonal(covariance))
        chance = np.sqrt(2 * np.square(covariance / np.outer(sigma, sigma)).sum()) / row.size
        return np.linalg.solve(np.linalg.cholesky(covariance), error), float(chance)

    def theta_ra_rad(self, result: Result) -> np.ndarray:
        """Return the error of theta_ra at all nodes [rad]."""
        found = result.slope_map
        x, y = np.meshgrid(found.x_m, found.y_m)
        focal = self.scene.focal_length_m
        design = x / (2 * focal)
        turned = np.arctan(design) - np.arctan(design + self.mirror.deviation(x, y)[1])
        axis = self.receiver.axis(y)
        z = x**2 / (4 * focal)
        seen = 0.5 * (np.arctan2(-x, focal - z) - np.arctan2(axis[..., 0] - x, axis[..., 1] - z))
        return np.asarray(result.angles.theta_ra_rad - turned - seen)

    def absorber_mm(self, result: Result) -> tuple[np.ndarray, np.ndarray]:
        """Return errors and sigmas of the stations that two photos saw, shape (n, 2) [mm]."""
        path = result.absorber
        seen = np.ones(path.n, dtype=bool)
        if result.absorber_solution is not None:
            seen = result.absorber_solution.n_photos >= 2
        error = np.stack([path.x_m, path.z_m], axis=1) - self.receiver.axis(path.y_m)
        return 1e3 * error[seen], 1e3 * np.stack(path.sigma_at(path.y_m), axis=1)[seen]

    def eyes_mm(self, result: Result) -> np.ndarray:
        """Return the errors of the cameras' places, shape (n, 3) [mm]."""
        views = views_of(self.scene)
        places = np.array([views[int(name.split("_")[1].split(".")[0])].place_m for name in result.network.photo_poses])
        return np.asarray(1e3 * ([pose.inverse().translation_m for pose in result.poses] - places))


def report(folder: Path, scene: Scene, n_photos: int, stated_height_mm: float | None) -> None:
    """Measure and print."""
    place = written(folder, scene, n_photos, stated_height_mm)
    result = run(load(place), Options(jobs=1))
    show(result, scene, n_photos)


def show(result: Result, scene: Scene, n_photos: int) -> None:
    truth, glass = Truth(scene), "in glass" if scene.has_glass else "bare"
    error, sigma = truth.slope_errors(result)
    known = np.isfinite(error)
    error, sigma = error[known], sigma[known]
    bare = error - error.mean()
    beam = truth.theta_ra_rad(result)[known]
    seeable, measured = seeable_shares(result.visible, result.slope_map.aperture, result.slope_map.valid)
    axis, axis_sigma = truth.absorber_mm(result)
    eyes = truth.eyes_mm(result)
    few = "<= 0.2" if n_photos < 40 else "<= 0.15"
    title(f"rendered, {n_photos} photos, {scene.sky}, {glass}, heights {scene.heights_mm:g} mm", ("measured", "asked"))
    row("error of slopes across without mean, RMS [mrad]", f"{1e3 * bare.std():.3f}", few)
    row("  95 % within [mrad]", f"{1e3 * np.quantile(np.abs(bare), 0.95):.3f}", "<= 0.3")
    row("  mean [mrad]", f"{1e3 * error.mean():+.3f}", "")
    row(
        "error of theta_ra, RMS; 95 % [mrad]",
        f"{1e3 * beam.std():.3f}; {1e3 * np.quantile(np.abs(beam), 0.95):.3f}",
        "",
    )
    row("mean of (error / sigma)^2", f"{np.mean((error / sigma) ** 2):.2f}", "0.8 to 1.3")
    row("  without mean", f"{np.mean((bare / sigma) ** 2):.2f}", "")
    whitened, chance = truth.whitened(result)
    row(f"  whitened together, {whitened.size} nodes", f"{np.mean(whitened**2):.2f}", "0.8 to 1.3")
    row("  scatter of the mean by chance, whitening aside", f"{chance:.2f}", "")
    row("beyond 3 sigma", f"{100 * np.mean(np.abs(error) > 3 * sigma):.2f} %", "<= 0.5 %")
    row("absorber x, z, RMS error [mm]", ", ".join(f"{one:.2f}" for one in np.sqrt((axis**2).mean(0))), "0.3, 0.5")
    row("  mean [mm]", ", ".join(f"{one:+.2f}" for one in axis.mean(0)), "")
    row("  sigma, median [mm]", ", ".join(f"{one:.2f}" for one in np.median(axis_sigma, axis=0)), "")
    row("places of cameras x, y, z, RMS error [mm]", ", ".join(f"{one:.2f}" for one in np.sqrt((eyes**2).mean(0))), "")
    row("  scatter [mm]", ", ".join(f"{one:.2f}" for one in eyes.std(0)), "")
    row("share of the mirror measured", f"{seeable * measured:.3f}", "0.85")
    row("  of what can show the tube", f"{measured:.3f}", "0.97")
    row("tube looks thick, directly [mm]", f"{1e3 * getattr(result.absorber_solution, 'diameter_m', np.nan):.2f}", "")
    row("photos used", f"{len(eyes)}", f"{n_photos}")
    row("noise of edges / stated", f"{result.reflector.noise_factor:.2f}", "")
    for text in result.doubts:
        print(f"  warning: {text}")


def main() -> None:
    folder, *words = sys.argv[1:]
    given = dict(word.split("=", 1) for word in words)
    counts = [int(one) for one in given.pop("photos", "31,61").split(",")]
    stated = given.pop("stated_height_mm", None)
    kinds = {one.name: type(one.default) for one in fields(Scene)}
    values = {name: kinds[name](int(text) if kinds[name] is bool else text) for name, text in given.items()}
    scene = replace(Scene(), **values)
    place = Path(folder)
    check_geometry(place, scene, counts[0])
    for n_photos in counts:
        report(place, scene, n_photos, None if stated is None else float(stated))


if __name__ == "__main__":
    main()
