"""One mirror in several poses before the same camera and screen, whose errors all poses have in common."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE, DatasetOptions, write_dataset
from data_synth.fringes.knowledge import Knowledge, camera_section, screen_section
from data_synth.fringes.presets import aim, check_screen_covers
from data_synth.fringes.scene import FringeScene, scene_to_json
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.json_file import write_json
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.running.progress import Progress
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray

#: How the mirror stands: turned by a quarter each time, two by two at another distance (share of the first) and
#: aimed at another place of the screen.
_DISTANCES = (1.0, 1.0, 0.75, 0.75, 0.88, 0.88, 0.8, 0.8)
_AIMED_AT = (0.5, 0.5, 0.4, 0.6, 0.35, 0.65, 0.55, 0.45)
MOST_POSES = len(_DISTANCES)
#: Sigmas of camera and screen as a tape, a level and a calibration leave them; of the camera in focal lengths.
_SIGMA_CAMERA = 5e-4
_SIGMA_SAG_MM = 5.0
STANDARD_KNOWLEDGE = Knowledge(
    sigma_distance_mm=2.0,
    sigma_screen_rotation_mrad=1.0,
    sigma_screen_translation_mm=3.0,
    sigma_width_mm=20.0,
    sigma_height_mm=10.0,
)


@dataclass(frozen=True, slots=True)
class PoseOptions(ShortRepr):
    """How a scene becomes a measurement in several poses.

    poses: Number of poses.
    seed: Seed of all errors and noise.
    width_error: Share by which the stated width of the screen is off, beyond what its sigma says.
    force: Replace an earlier synthetic measurement.
    InputError: A number of poses that is not drawn, or a width that is no error.
    """

    poses: int
    seed: int = 0
    width_error: float = 0.0
    force: bool = False

    def __post_init__(self) -> None:
        if not 2 <= self.poses <= MOST_POSES:
            raise InputError(f"poses: 2 to {MOST_POSES} are drawn, not {self.poses}")
        if not abs(self.width_error) < 0.5:
            raise InputError(f"width error: less than 50 % is needed, not {100 * self.width_error:g} %")


def write_poses(folder: Path, scene: FringeScene, options: PoseOptions, progress: Progress | None = None) -> None:
    """Draw a mirror in several poses and write a folder of measurement folders.

    scene: The first pose; its screen must be flat, for its sag is one of the errors that are drawn.
    InputError: The folder holds something, the screen is not flat, or a pose does not see the screen.

    measurement.toml states camera and screen as they are in the scene, with errors of the stated sigmas that are the
    same in all poses; the screen that is drawn has a sag of which the file knows nothing but its sigma.
    """
    if not scene.bench.wall.is_plain:
        raise InputError(f"{scene.name}: its screen is curved; several poses are drawn before a flat one")
    common_rng, *rngs = np.random.default_rng(options.seed).spawn(1 + options.poses)
    sigma_px = _SIGMA_CAMERA * scene.bench.camera.focal_x_px
    knowledge = replace(STANDARD_KNOWLEDGE, sigma_focal_px=sigma_px, sigma_center_px=sigma_px)
    stated = {
        "camera": camera_section(scene, knowledge, common_rng),
        "screen": _stated_screen(scene, knowledge, common_rng, options.width_error),
    }
    scene = _with_sag(scene, 1e-3 * _SIGMA_SAG_MM * common_rng.standard_normal(2))
    names = [f"pose_{number}" for number in range(1, options.poses + 1)]
    with WholeFolder(folder, SYNTHETIC, force=options.force) as working:
        for number, (name, rng) in enumerate(zip(names, rngs, strict=True)):
            seed = int(rng.integers(2**31))
            known = replace(knowledge, roll_deg=90.0 * (number % 4))
            write_dataset(working / name, posed_scene(scene, number), DatasetOptions(seed, known, stated), progress)
        content = {
            "kind": "deflectometry-poses",
            "name": scene.name,
            "notes": "Synthetic: drawn by heliogauge deflectometry synth.",
            "pose": [{"folder": name} for name in names],
        }
        write_measurement(working, content, comment=f"Synthetic measurement, seed {options.seed}; see truth.json.")
        write_json(working / TRUTH_FILE, {**scene_to_json(scene), "seed": options.seed, "poses": names})


def posed_scene(scene: FringeScene, number: int) -> FringeScene:
    """Return a scene with its mirror in the pose of a number, 0 as it is but for the aim.

    InputError: The mirror does not see the screen from there.
    """
    bench, facets = scene.bench, scene.facets
    normal = np.array([0.0, 0.0, 1.0])
    if len(facets) == 1:
        _, slope_x, slope_y = facets[0].design.evaluate(np.array(0.0), np.array(0.0))
        normal = np.array([-float(slope_x), -float(slope_y), 1.0])
    place_x, place_y, place_z = (_DISTANCES[number] * bench.cam_from_mirror.translation_m).tolist()
    seen = bench.wall.points_m(np.array(_AIMED_AT[number]), np.array(0.5))
    pose = aim(
        (place_x, place_y, place_z),
        bench.cam_from_wall.apply(seen),
        normal,
        roll_rad=0.02 + 0.5 * np.pi * (number % 4),
    )
    posed = replace(scene, bench=replace(bench, cam_from_mirror=pose))
    check_screen_covers(posed)
    return posed


def _stated_screen(
    scene: FringeScene, knowledge: Knowledge, rng: np.random.Generator, width_error: float
) -> dict[str, Any]:
    section = screen_section(scene, knowledge, rng)
    return {**section, "width_m": section["width_m"] * (1 + width_error), "sigma_sag_mm": _SIGMA_SAG_MM}


def _with_sag(scene: FringeScene, sag_m: FloatArray) -> FringeScene:
    """Bend the screen; its frame moves so that the mean plane stays where the file has it."""
    wall = replace(scene.bench.wall, sag_x_m=float(sag_m[0]), sag_y_m=float(sag_m[1]))
    back = RigidTransform.from_rotation_vector([0.0, 0.0, 0.0], [0.0, 0.0, -float(sag_m.sum()) / 3.0])
    return replace(scene, bench=replace(scene.bench, wall=wall, cam_from_wall=scene.bench.cam_from_wall @ back))
