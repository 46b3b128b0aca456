"""What the person who measures knows of a synthetic scene: measurement.toml, exact or with stated uncertainty."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from data_synth.fringes.scene import FringeScene
from data_synth.optics.mirror import SyntheticFacet
from data_synth.optics.wall import Wall
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True)
class Knowledge(ShortRepr):
    """How well the measurement file knows the set-up: stated values are the true ones plus errors of these sigmas.

    pose_known: Give the mirror's pose; otherwise its outline and the measured distance.
    sigma_distance_mm: Error of the distance between the origins of mirror and screen.
    sigma_screen_rotation_mrad, sigma_screen_translation_mm: Errors of the screen's pose.
    sigma_width_mm, sigma_height_mm: Errors of the displayed image's size.
    sigma_focal_px, sigma_center_px: Errors of the camera, independent in x and y as measurement.toml has it.
    sigma_facet_mm: How far each facet of an ensemble is from where the file has it, along each axis; None: exact, and
        the file says nothing of it.
    response: Give the response of camera and display (as measured with grey steps) in response.csv.
    roll_deg: How the mirror is turned in the image.
    sigma_place_mm: Error of each coordinate of the surveyed place of the mirror's origin in the wall's frame; 0: no
        survey of it.
    """

    pose_known: bool = False
    sigma_pose_rotation_mrad: float = 0.0
    sigma_pose_translation_mm: float = 0.0
    sigma_distance_mm: float = 1.0
    sigma_screen_rotation_mrad: float = 0.0
    sigma_screen_translation_mm: float = 0.0
    sigma_width_mm: float = 0.0
    sigma_height_mm: float = 0.0
    sigma_focal_px: float = 0.0
    sigma_center_px: float = 0.0
    sigma_facet_mm: tuple[float, float, float] | None = None
    response: bool = False
    roll_deg: float = 0.0
    sigma_place_mm: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            sigma = getattr(self, name)
            if name.startswith("sigma") and sigma is not None and not np.min(sigma) >= 0:
                raise InputError(f"{name}: 0 or more is needed, not {getattr(self, name)}")
        if self.sigma_distance_mm == 0:
            raise InputError("sigma_distance_mm: more than 0 is needed; no tape is exact")


def measurement_content(
    scene: FringeScene, fringe_files: list[str], knowledge: Knowledge, rng: np.random.Generator
) -> dict[str, Any]:
    """Return the tables of measurement.toml.

    fringe_files: Names of the frames, in order.
    knowledge: How well the set-up is known.
    rng: Draws the errors of what is known.
    Returns: Content for `heliogauge.measurement.writer.write_measurement`.
    """
    return {
        "kind": "deflectometry",
        "name": scene.name,
        "notes": "Synthetic: drawn by heliogauge deflectometry synth.",
        "camera": camera_section(scene, knowledge, rng),
        "screen": screen_section(scene, knowledge, rng),
        "pattern": {
            "set": [
                {
                    "axis": str(one.axis),
                    "periods": one.periods,
                    "steps_deg": np.degrees(one.steps_rad).round(9).tolist(),
                }
                for one in scene.pattern.sets
            ]
        },
        "images": {
            "fringes": fringe_files,
            "dark": "dark.png",
            "bright": "bright.png",
            "saturation_dn": float(scene.sensor.saturation_dn),
        },
        "mirror": _mirror(scene, knowledge, rng),
        "evaluation": {"align": "outline" if knowledge.pose_known else "normal"},
    }


def camera_section(scene: FringeScene, knowledge: Knowledge, rng: np.random.Generator) -> dict[str, Any]:
    """Return [camera] of measurement.toml, with errors of the stated sigmas."""
    camera = scene.bench.camera
    focal_error_x, focal_error_y, center_error_x, center_error_y = rng.standard_normal(4)
    return {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "focal_x_px": camera.focal_x_px + knowledge.sigma_focal_px * focal_error_x,
        "focal_y_px": camera.focal_y_px + knowledge.sigma_focal_px * focal_error_y,
        "center_x_px": camera.center_x_px + knowledge.sigma_center_px * center_error_x,
        "center_y_px": camera.center_y_px + knowledge.sigma_center_px * center_error_y,
        **{name: getattr(camera, name) for name in ("k1", "k2", "k3", "p1", "p2")},
        "distortion_direction": "ideal_to_measured",
        "sigma_focal_px": knowledge.sigma_focal_px,
        "sigma_center_px": knowledge.sigma_center_px,
    }


def screen_section(scene: FringeScene, knowledge: Knowledge, rng: np.random.Generator) -> dict[str, Any]:
    """Return [screen] of measurement.toml, with errors of the stated sigmas; of a table the size has none."""
    wall = scene.bench.wall
    pose = _pose(
        scene.bench.cam_from_wall, knowledge.sigma_screen_rotation_mrad, knowledge.sigma_screen_translation_mm, rng
    )
    shape: dict[str, Any] = {"shape": "table", "file": "screen_points.csv"}
    size = {"sigma_width_mm": 0.0, "sigma_height_mm": 0.0, "sigma_sag_mm": 0.0}
    if wall.is_plain:
        sigmas_mm = {"width": knowledge.sigma_width_mm, "height": knowledge.sigma_height_mm}
        errors_m = {name: 1e-3 * sigma * rng.standard_normal() if sigma else 0.0 for name, sigma in sigmas_mm.items()}
        shape = {
            "shape": "rectangle",
            "width_m": wall.width_m + errors_m["width"],
            "height_m": wall.height_m + errors_m["height"],
        }
        size |= {f"sigma_{name}_mm": sigma for name, sigma in sigmas_mm.items()}
    return {**shape, **pose, **size, "response_file": "response.csv" if knowledge.response else None}


def _pose(
    true: RigidTransform, rotation_mrad: float, translation_mm: float, rng: np.random.Generator
) -> dict[str, Any]:
    step = rng.standard_normal(6) * np.repeat([1e-3 * rotation_mrad, 1e-3 * translation_mm], 3)
    stated = true.moved(step)
    return {
        "rotation_vector_rad": stated.rotation_vector_rad,
        "translation_m": stated.translation_m,
        "sigma_rotation_mrad": rotation_mrad,
        "sigma_translation_mm": translation_mm,
    }


def _mirror(scene: FringeScene, knowledge: Knowledge, rng: np.random.Generator) -> dict[str, Any]:
    bench, facets = scene.bench, scene.facets
    pose = _pose(bench.cam_from_mirror, knowledge.sigma_pose_rotation_mrad, knowledge.sigma_pose_translation_mm, rng)
    true_distance = float(np.linalg.norm(bench.cam_from_wall.translation_m - bench.cam_from_mirror.translation_m))
    distance = {
        "distance_m": true_distance + 1e-3 * knowledge.sigma_distance_mm * rng.standard_normal(),
        "sigma_mm": knowledge.sigma_distance_mm,
    }
    known: dict[str, Any] = {"pose": pose} if knowledge.pose_known else {"distance": distance}
    if knowledge.roll_deg:
        known["roll_deg"] = knowledge.roll_deg
    if knowledge.sigma_place_mm:
        place = bench.cam_from_wall.inverse().apply(bench.cam_from_mirror.translation_m)
        error = 1e-3 * knowledge.sigma_place_mm * rng.standard_normal(3)
        known["place"] = {"place_m": place + error, "sigma_mm": knowledge.sigma_place_mm}
    if len(facets) == 1:
        return {**_design(facets[0]), "outline_m": facets[0].outline_m, **known}
    listed = [
        {
            "name": facet.name,
            **_design(facet),
            "outline_m": facet.outline_m,
            "position_m": facet.mirror_from_facet.translation_m + step,
            "rotation_vector_rad": facet.mirror_from_facet.rotation_vector_rad,
        }
        for facet, step in zip(facets, _steps_of_facets(knowledge, len(facets), rng), strict=True)
    ]
    if knowledge.sigma_facet_mm is not None:
        known["sigma_facet_position_mm"] = list(knowledge.sigma_facet_mm)
    return {**_design(facets[0]), "mounts_m": _mounts(facets[0]), **known, "facet": listed}


def _steps_of_facets(knowledge: Knowledge, count: int, rng: np.random.Generator) -> FloatArray:
    """Return how far the file has each facet from its place, shape (count, 3) [m]."""
    if knowledge.sigma_facet_mm is None:
        return np.zeros((count, 3))
    return 1e-3 * np.array(knowledge.sigma_facet_mm) * rng.standard_normal((count, 3))


def _mounts(facet: SyntheticFacet) -> FloatArray:
    """Return mounts at three quarters of the way from a facet's middle to its corners."""
    middle = facet.outline_m.mean(axis=0)
    return np.asarray(np.round(middle + 0.75 * (facet.outline_m - middle), 4))


def _design(facet: SyntheticFacet) -> dict[str, Any]:
    design = facet.design
    center = design.optic_from_facet.translation_m
    is_turned = bool(np.any(design.optic_from_facet.rotation != np.eye(3)))
    return {
        "design": design.shape,
        **design.parameters,
        "design_center_m": center[:2],
        "design_orientation": "normal" if is_turned else "axis",
    }


def screen_table(wall: Wall, nodes: int = 81) -> dict[str, list[float]]:
    """Return the wall as a table of measured points.

    nodes: Points per side; with 81 the chords of a wall that bulges by 0.12 m are wrong by 0.02 mm.
    Returns: Columns u, v, x_m, y_m, z_m.
    """
    v, u = (values.ravel() for values in np.mgrid[0 : 1 : nodes * 1j, 0 : 1 : nodes * 1j])
    x, y, z = wall.points_m(u, v).T
    columns = {"u": u, "v": v, "x_m": x, "y_m": y, "z_m": z}
    return {name: values.tolist() for name, values in columns.items()}


def response_table(scene: FringeScene, steps: int = 33) -> dict[str, list[float]]:
    """Return what the camera reads for grey steps of the display.

    Returns: Columns camera_dn and display_level (fraction).
    """
    level = np.linspace(0.0, 1.0, steps)
    light = scene.lighting.light(level.astype(np.float32)) + np.float32(scene.lighting.ambient)
    camera = scene.sensor.expected_dn(np.float32(scene.lighting.reflectivity) * light)
    return {"camera_dn": camera.tolist(), "display_level": level.tolist()}
