"""One mirror in several poses before the same camera and a screen that bulges."""

from dataclasses import replace

import numpy as np

from data_synth.fringes.presets import aim, check_screen_covers
from data_synth.fringes.scene import FringeScene
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray

#: How the mirror stands: turned by a quarter each time, two by two at another distance (share of the first) and
#: aimed at another place of the screen.
_DISTANCES = (1.0, 1.0, 0.75, 0.75, 0.88, 0.88, 0.8, 0.8)
_AIMED_AT = (0.5, 0.5, 0.4, 0.6, 0.35, 0.65, 0.55, 0.45)
MOST_POSES = len(_DISTANCES)


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


def with_sag(scene: FringeScene, sag_m: FloatArray) -> FringeScene:
    """Bend the screen; its frame moves so that the mean plane stays where the file has it."""
    wall = replace(scene.bench.wall, sag_x_m=float(sag_m[0]), sag_y_m=float(sag_m[1]))
    back = RigidTransform.from_rotation_vector([0.0, 0.0, 0.0], [0.0, 0.0, -float(sag_m.sum()) / 3.0])
    return replace(scene, bench=replace(scene.bench, wall=wall, cam_from_wall=scene.bench.cam_from_wall @ back))
