"""A heliostat seen at night from its tower: the fringes are on the tower's target, 200 m away (C-35, C-23)."""

from dataclasses import replace

import numpy as np

from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import aim, check_screen_covers, rectangle, standard_errors
from data_synth.fringes.scene import FringeScene, Lighting
from data_synth.optics.mirror import Design, SyntheticFacet
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.sensor import Sensor
from data_synth.optics.surface_errors import Kink, Polynomial, SurfaceErrors
from data_synth.optics.trace import Bench
from data_synth.optics.wall import Wall
from deflectometry.setup import make_pattern
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector

#: Where the heliostat stands in the camera's frame [m]: 200 m away, 24 m below a camera that looks down on it.
PLACE_M = (0.1, 0.05, 201.0)
#: The tower's white target (UNAM's of 7 m x 8 m), its middle 5 m below the camera.
TARGET = Wall(7.0, 8.0)
#: A telephoto lens: a heliostat of 4.6 m x 3.1 m fills 10^6 pixels.
CAMERA = PinholeCamera(1500, 1100, 60500.0, 60500.0, 749.0, 551.0)
#: Fringes over the target: the coarsest tells the order, the finest has 1.5 periods a metre.
PERIODS = (0.9, 3.3, 10.5)
#: What a survey of the plant knows: places to 5 mm, the distance to 10 mm, the lens to 0.3 per mille.
KNOWLEDGE = Knowledge(
    sigma_distance_mm=10.0,
    sigma_screen_rotation_mrad=1.0,
    sigma_screen_translation_mm=5.0,
    sigma_width_mm=3.0,
    sigma_height_mm=3.0,
    sigma_focal_px=20.0,
    sigma_center_px=5.0,
)


#: A surveyed pivot of a heliostat [mm].
SIGMA_PLACE_MM = 5.0


def tower_knowledge(scale: float = 1.0, *, sigma_place_mm: float = 0.0) -> Knowledge:
    """Return what a survey knows, the lens in the pixels of a camera that has fewer of them.

    sigma_place_mm: Of the heliostat's own place; 0: not surveyed.
    """
    known = replace(KNOWLEDGE, sigma_focal_px=scale * 20.0, sigma_center_px=scale * 5.0)
    return replace(known, sigma_place_mm=sigma_place_mm)


#: Canting of a facet beyond this looks past the target in part of it [rad].
_CANTING_RAD = 1.0e-3


def tower_scene(*, scale: float = 1.0, turned_away_rad: float = 0.0) -> FringeScene:
    """Return a heliostat of 3 x 3 facets of 1.5 m x 1 m, focused at 200 m, canted to 1 mrad (1 sigma of each axis).

    scale: Pixels per pixel of the full camera.
    turned_away_rad: A further turn of the facet in the upper right corner: it then looks past the target.
    """
    rng = np.random.default_rng(35)
    optic = Design("sphere", {"radius_m": 400.0})
    facets = []
    for row in range(3):
        for column in range(3):
            center = ((column - 1) * 1.53, (row - 1) * 1.03)
            pose = Design.on_optic("sphere", optic.parameters, center).optic_from_facet
            tilt = _CANTING_RAD * np.clip(rng.standard_normal(2), -1.5, 1.5)
            if (row, column) == (2, 2):
                tilt = tilt + (turned_away_rad, 0.0)
            canting = Polynomial([(1, 0, float(tilt[0])), (0, 1, float(tilt[1]))])
            errors = SurfaceErrors((canting, *standard_errors(1.5, 1.0).terms))
            design = Design("sphere", {"radius_m": 400.0})
            facets.append(SyntheticFacet(f"facet_{row}_{column}", rectangle(1.5, 1.0), design, errors, pose))
    scene = _at_night("heliostat from the tower", tuple(facets), scale)
    if turned_away_rad == 0.0:
        check_screen_covers(scene)
    return scene


#: Deviations of UNAM's facet of 1.5 m x 1 m from a plane, horizontally and vertically [rad].
UNAM_SIGMA_RAD = (2.41e-3, 2.18e-3)
#: Width of the bend: a hundredth of the facet's.
_BEND_M = 0.015


def unam_scene(*, scale: float = 1.0) -> FringeScene:
    """Return UNAM's field fringe reflection: one facet, bent about a vertical line, 201 m away (C-23, V-42, V-43).

    The map itself was never published: a bend with the rims back, by which its one facet threw two spots, and a bow
    over its height have the published deviations from a plane, 2.41 and 2.18 mrad.
    """
    half_height = 0.5
    # Over half of the facet, of width w, a slope of a tanh(x / b) has the mean square a^2 (1 - b / w tanh(w / b)).
    bend = UNAM_SIGMA_RAD[0] / float(np.sqrt(1 - _BEND_M / 0.75))
    bow = UNAM_SIGMA_RAD[1] * float(np.sqrt(3.0)) / (2 * half_height)
    errors = SurfaceErrors((Kink(-bend, _BEND_M), Polynomial([(0, 2, bow)])))
    facet = SyntheticFacet("bent facet", rectangle(1.5, 2 * half_height), Design("plane", {}), errors)
    scene = _at_night("bent facet at 201 m", (facet,), scale)
    check_screen_covers(scene)
    return scene


def _at_night(name: str, facets: tuple[SyntheticFacet, ...], scale: float) -> FringeScene:
    """Return facets before camera and target, seen at night."""
    # Haze and stray light take contrast, the light is little: 10 bit, 2 DN of noise and that of the photons.
    lighting = Lighting(black=0.08, ambient=0.05, indirect=0.02, background_albedo=0.15, soiling=0.08)
    sensor = Sensor(bits=10, exposure=0.7, offset_dn=16.0, read_noise_dn=2.0, shot_gain_dn=0.06)
    # The target's middle is 5 m below the camera; it faces the heliostat but for 60 mrad.
    turn = rotation_from_vector([0.06, -0.02, 0.005]) @ np.diag([-1.0, -1.0, 1.0])
    cam_from_wall = RigidTransform(turn, np.array([0.3, 5.0, -0.4]))
    target = cam_from_wall.apply(TARGET.points_m(np.array(0.5), np.array(0.5)))
    bench = Bench(CAMERA.scaled(scale), aim(PLACE_M, target, np.array([0.0, 0.0, 1.0])), TARGET, cam_from_wall)
    return FringeScene(name, bench, facets, make_pattern(PERIODS, PERIODS), lighting, sensor, 1.5 * scale)
