"""Whether a plan keeps its promise: errors of drawn measurements against the covariance that was promised before.

The measurements are drawn by `data_synth`, which shares no equation with estimator or plan.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data_synth.dots import dot_scene, write_dot_dataset
from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene, standard_errors
from data_synth.fringes.scene import FringeScene
from data_synth.fringes.tower import SIGMA_PLACE_MM, tower_knowledge, tower_scene
from data_synth.optics.mirror import SyntheticFacet
from data_synth.optics.surface_errors import Polynomial, SurfaceErrors
from deflectometry.dots.keys import load_dots
from deflectometry.dots.pipeline.measure import run as run_dots
from deflectometry.dots.planning.plan import PlannedDots, load_dots_plan
from deflectometry.fringes.planning.plan import PlannedFringes, load_fringes_plan
from deflectometry.keys import load_deflectometry
from deflectometry.pipeline.measure import run
from deflectometry.pipeline.result import Result
from deflectometry.planning.prospect import Prospect
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.slopes.statistics import fit_quadratic
from heliogauge.validate import FloatArray

#: What a careful survey of a laboratory leaves open.
KNOWLEDGE = Knowledge(
    sigma_distance_mm=2.0,
    sigma_screen_rotation_mrad=0.3,
    sigma_screen_translation_mm=2.0,
    sigma_width_mm=1.0,
    sigma_height_mm=1.0,
    sigma_focal_px=0.3,
    sigma_center_px=0.3,
)
#: As if there were one: the camera of a plan is known as that of a scene is.
PLAN = "\n[plan]\nmirror_m = {place}\ncontrast_dn = {contrast}\nnoise_dn = {noise}\nblur_px = {blur}\n"


@dataclass(frozen=True)
class Drawn:
    """A source whose measurements can be drawn.

    contrast_dn, noise_dn: What a look at the first image tells.
    """

    scene: FringeScene
    knowledge: Knowledge
    contrast_dn: float
    noise_dn: float
    is_dots: bool = False

    def write(self, folder: Path, seed: int) -> None:
        """Draw one measurement, with [plan] in its file."""
        options = DatasetOptions(seed=seed, knowledge=self.knowledge)
        blur = self.scene.blur_sigma_px
        if self.is_dots:
            dots = dot_scene("small", "marked")
            blur = dots.blur_sigma_px
            write_dot_dataset(folder, dots, options)
        else:
            write_dataset(folder, self.scene, options)
        place = self.scene.bench.cam_from_mirror.translation_m.tolist()
        text = PLAN.format(place=place, contrast=self.contrast_dn, noise=self.noise_dn, blur=blur)
        file = folder / "measurement.toml"
        file.write_text(file.read_text() + text)

    def promise(self, folder: Path) -> Prospect:
        """Return what the plan says of a folder."""
        if self.is_dots:
            return PlannedDots(load_dots_plan(folder)).prospect()
        return PlannedFringes(load_fringes_plan(folder)).prospect()

    def measure(self, folder: Path) -> Result:
        """Measure it."""
        return run_dots(load_dots(folder)) if self.is_dots else run(load_deflectometry(folder))


def drawn_fringes() -> Drawn:
    """Return a facet before a screen, off its design by long waves: a plan knows nothing of short ones."""
    scene = preset_scene("small")
    errors = SurfaceErrors((Polynomial([(2, 0, 4e-4), (0, 2, -3e-4), (1, 1, 3e-4), (3, 0, 2e-4)]),))
    facets = tuple(replace(one, errors=errors) for one in scene.facets)
    return Drawn(replace(scene, facets=facets), KNOWLEDGE, 103.0, 1.05)


def drawn_dots() -> Drawn:
    """Return a facet before a field of dots."""
    scene = dot_scene("small", "marked").scene
    known = replace(KNOWLEDGE, sigma_width_mm=0.0, sigma_height_mm=0.0, sigma_focal_px=1.0, sigma_center_px=1.0)
    return Drawn(scene, known, 190.0, 1.05, is_dots=True)


def drawn_tower(scale: float = 0.25, facets: tuple[int, ...] = (0, 1, 5)) -> Drawn:
    """Return some facets of a heliostat seen at night from its tower, canted as designed, each place known to 1 mm.

    The sigma of a curvature follows the curvature itself. The scene's own canting, 1 mrad, makes these three facets a
    mirror of f = 377 m in y where the design has 200 m: no plan knows that.
    """
    scene = tower_scene(scale=scale)
    errors = standard_errors(1.5, 1.0)
    scene = replace(scene, facets=tuple(replace(scene.facets[k], errors=errors) for k in facets))
    known = tower_knowledge(scale, sigma_place_mm=SIGMA_PLACE_MM)
    known = replace(known, sigma_facet_mm=(1.0, 1.0, 1.0))
    return Drawn(scene, known, 260.0, 5.0)


@dataclass(frozen=True)
class Outcome:
    """One drawn measurement beside its promise.

    errors (n,): Curvatures and mean normal, measured minus true; of several facets the mean normal.
    canting_rad (f, 2): Errors of the facets' canting; f = 0 for a single facet.
    stated: Sigmas that the measurement then states, by the names of the plan.
    """

    errors: FloatArray
    canting_rad: FloatArray
    stated: dict[str, float]


def outcomes(drawn: Drawn, folder: Path, seeds: int) -> Iterator[Outcome]:
    """Draw and measure one after the other."""
    for seed in range(seeds):
        here = folder / str(seed)
        drawn.write(here, seed)
        result = drawn.measure(here)
        yield _outcome(result, drawn.scene)


def _outcome(result: Result, scene: FringeScene) -> Outcome:
    numbers = result.numbers
    stated = {axis: float(numbers[f"sigma_{axis}_rms_rad"] or 0.0) for axis in ("slope_x", "slope_y")}
    stated |= {axis: float(numbers[f"sigma_{axis}_per_m"] or 0.0) for axis in ("curvature_x", "curvature_y")}
    normal = [float(numbers[f"sigma_mean_normal_{axis}_rad"] or 0.0) for axis in "xy"]
    stated["mean_normal"] = float(np.sqrt(0.5 * np.sum(np.square(normal))))
    facets, normals, means, shape = scene.facets, [], [], np.zeros(2)
    for facet, slope_map in zip(facets, result.evaluation.maps.values(), strict=True):
        x, y, found, true = _slopes(slope_map, facet)
        for pose, slopes in ((result.evaluation.solution.cam_from_mirror, found), (scene.bench.cam_from_mirror, true)):
            mean = facet.mirror_from_facet.rotate(np.array([*-slopes.mean(axis=1), 1.0]))
            normals.append(pose.rotate(mean))
        means.append((found - true).mean(axis=1))
        shape = _solver(x, y) @ (found - true).ravel()
    in_screen = []
    for frame, which in ((result.setup.cam_from_screen, normals[::2]), (scene.bench.cam_from_wall, normals[1::2])):
        one = frame.inverse().rotate(np.mean(which, axis=0))
        in_screen.append(np.arctan2(one[:2], -one[2]))
    turned = in_screen[0] - in_screen[1]
    if len(facets) == 1:
        return Outcome(np.concatenate([shape, turned]), np.zeros((0, 2)), stated)
    each = np.array(
        [np.sqrt(np.diag(one.canting.covariance_components_rad2)) for one in result.cantings if one.canting]
    )
    stated["canting"] = float(np.sqrt(np.mean(each**2)))
    return Outcome(turned, np.array(means), stated)


def _slopes(slope_map: SlopeMap, facet: SyntheticFacet) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    valid = slope_map.valid
    x, y = (one[valid] for one in np.meshgrid(slope_map.x_m, slope_map.y_m))
    _, true_x, true_y = facet.surface(x, y)
    found = np.stack([slope_map.slope_x[valid], slope_map.slope_y[valid]])
    return x, y, found, np.stack([true_x, true_y])


def _solver(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return what takes slopes (2 n,) to both curvatures, beside twist and tilts."""
    one, none = np.ones_like(x), np.zeros_like(x)
    along_x = np.column_stack([x, none, y, one, none])
    along_y = np.column_stack([none, y, x, none, one])
    return np.asarray(np.linalg.pinv(np.concatenate([along_x, along_y]))[:2])


def promised_covariance(prospect: Prospect) -> FloatArray:
    """Return the joint covariance that a plan promises, of `Outcome.errors`."""
    normal = prospect.normal_shares_rad
    if len(prospect.facets) > 1:
        return np.asarray(normal.T @ normal)
    slope_map = prospect.slope_map
    x, y = (one[slope_map.valid] for one in np.meshgrid(slope_map.x_m, slope_map.y_m))
    modes = slope_map.common.evaluate(x, y).reshape(-1, 2 * x.size)
    effects = np.zeros((len(modes), 4))
    effects[:, :2] = modes @ _solver(x, y).T
    # Errors of pose, camera and screen come first, in both; what nobody states turns no normal.
    effects[: len(normal), 2:] = normal
    covariance = effects.T @ effects
    noise = fit_quadratic(replace(slope_map, common=no_common_modes())).covariance[:2, :2]
    # Curvatures are twice the coefficients of the squares.
    covariance[:2, :2] += 4.0 * noise
    return np.asarray(covariance)


def joint_ratio(errors: list[FloatArray], covariance: FloatArray) -> float:
    """Return the root of the mean chi-square over its degrees of freedom: 1 where the scatter is as promised."""
    inverse = np.linalg.inv(covariance)
    return float(np.sqrt(np.mean([one @ inverse @ one for one in errors]) / len(covariance)))


def canting_ratio(cantings: list[FloatArray], prospect: Prospect) -> float:
    """Return errors of canting beside the mean of all facets over their promised sigmas, RMS."""
    sigma = np.array([one.sigma_canting_rad for one in prospect.facets])
    off = [one - one.mean(axis=0) for one in cantings]
    return float(np.sqrt(np.mean([(one / sigma) ** 2 for one in off])))
