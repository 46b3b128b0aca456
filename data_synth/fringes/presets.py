"""Ready scenes: the laboratory they stand in, and mirrors from the plain to the awkward, each with slope errors."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from data_synth.fringes.scene import FringeScene
from data_synth.optics.mirror import Design, SyntheticFacet
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.surface_errors import Dimple, EdgeTurnDown, ErrorTerm, Polynomial, Ripple, SurfaceErrors, Zernike
from data_synth.optics.trace import Bench
from data_synth.optics.wall import Wall
from deflectometry.setup import make_pattern
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_between, rotation_from_vector
from heliogauge.validate import FloatArray, float_array

#: Periods over the screen: the coarsest below one is unique, each next one four times finer.
STANDARD_PERIODS = (0.9, 3.9, 15.9, 63.9)

#: A machine camera with a 25 mm lens; the small one is the same with pixels 8 times coarser.
FULL_CAMERA = PinholeCamera(1624, 1232, 5492.0, 5486.0, 812.0, 617.0, -0.144, 1.6, 0.0, 2.5e-5, -1.9e-3)
SMALL_CAMERA = FULL_CAMERA.scaled(1 / 8)

STANDARD_WALL = Wall(8.727, 3.476)
#: The camera stands at the wall's edge and is turned by 20 deg so that wall and mirror face each other.
CAM_FROM_WALL = RigidTransform(
    rotation_from_vector([0.036, -0.355, 0.012]) @ np.diag([-1.0, -1.0, 1.0]), np.array([4.45, 0.06, 0.37])
)

#: Where the mirror stands in the camera's frame, a little off the optical axis [m].
STANDARD_PLACE_M = (0.05, 0.08, 9.65)


def rectangle(width_m: float, height_m: float) -> FloatArray:
    """Return the outline of a rectangle around the origin, counter-clockwise, shape (4, 2) [m]."""
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    return corners * (0.5 * width_m, 0.5 * height_m)


def standard_errors(width_m: float = 1.2, height_m: float = 1.2) -> SurfaceErrors:
    """Return deviations as of a good glass facet: about 0.4 mrad RMS, from the whole facet down to 0.2 m.

    Returns: Twist and astigmatism, coma, a ripple, a dimple over a pad, turned-down edges.
    """
    size = float(np.hypot(width_m, height_m))
    terms: tuple[ErrorTerm, ...] = (
        Polynomial([(2, 0, 6.0e-4 / size), (0, 2, -4.0e-4 / size), (1, 1, 5.0e-4 / size)]),
        Zernike(3, 1, 4.0e-5 * size, 0.5 * size),
        Ripple(2.0e-4, 0.23 * size, 0.6, 0.4),
        Dimple(-3.0e-5 * size, 0.09 * size, 0.18 * width_m, -0.12 * height_m),
        EdgeTurnDown(4.0e-4, 0.05 * size, 0.5 * width_m, 0.5 * height_m),
    )
    return on_design_at_origin(SurfaceErrors(terms))


def on_design_at_origin(errors: SurfaceErrors) -> SurfaceErrors:
    """Lift deviations so that the surface meets its design at the facet's origin.

    Returns: The same with a constant added.

    Slopes do not change, but where the rays meet the surface does. A mirror's pose says where its origin is; a
    surface that stands 20 um in front of it would be seen with a slope bias of 0.4 urad that no slope measurement can
    avoid.
    """
    height = float(errors.evaluate(np.array(0.0), np.array(0.0))[0])
    return SurfaceErrors((*errors.terms, Polynomial([(0, 0, -height)])))


def aim(
    place_m: tuple[float, float, float],
    target_cam_m: FloatArray,
    normal: FloatArray,
    *,
    roll_rad: float = 0.02,
) -> RigidTransform:
    """Turn a mirror so that the camera sees a target in the mirror's origin.

    target_cam_m (3,): The point to be seen, in the camera's frame [m].
    normal (3,): The surface normal at the mirror's origin, in the mirror's frame.
    roll_rad: Turn about the normal; edges parallel to pixel rows would hide errors of the outline [rad].
    Returns: ``cam_from_mirror``; the mirror's x points right and its y up in the image.
    """
    place = float_array("place_m", place_m, (3,))
    to_camera, to_target = -place / np.linalg.norm(place), target_cam_m - place
    z_axis = to_camera + to_target / np.linalg.norm(to_target)
    z_axis /= np.linalg.norm(z_axis)
    x_axis = np.cross([0.0, -1.0, 0.0], z_axis)
    x_axis /= np.linalg.norm(x_axis)
    upright = np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
    straight = rotation_between(normal, [0.0, 0.0, 1.0])
    return RigidTransform(upright @ rotation_from_vector([0.0, 0.0, roll_rad]) @ straight, place)


def facet_scene(
    name: str,
    facets: tuple[SyntheticFacet, ...],
    *,
    camera: PinholeCamera = SMALL_CAMERA,
    wall: Wall = STANDARD_WALL,
    place_m: tuple[float, float, float] = STANDARD_PLACE_M,
    blur_sigma_px: float = 0.1,
) -> FringeScene:
    """Put a mirror into the standard laboratory and aim it at the middle of the screen.

    facets: The mirror; a single facet's pose in the mirror is the identity.
    place_m: The mirror's origin in the camera's frame [m].
    blur_sigma_px: Blur of the lens; 0.1 px of the small camera are 0.8 px of the full one [px].
    InputError: A reflected ray misses the screen: the message says which size is needed.
    """
    normal = np.array([0.0, 0.0, 1.0])
    if len(facets) == 1:
        _, slope_x, slope_y = facets[0].design.evaluate(np.array(0.0), np.array(0.0))
        normal = np.array([-float(slope_x), -float(slope_y), 1.0])
    target = CAM_FROM_WALL.apply(wall.points_m(np.array(0.5), np.array(0.5)))
    bench = Bench(camera, aim(place_m, target, normal), wall, CAM_FROM_WALL)
    pattern = make_pattern(STANDARD_PERIODS, STANDARD_PERIODS)
    scene = FringeScene(name, bench, facets, pattern, blur_sigma_px=blur_sigma_px)
    check_screen_covers(scene)
    return scene


def check_screen_covers(scene: FringeScene) -> None:
    """Refuse a scene in which part of the mirror does not see the display.

    InputError: The display is too small, or in the wrong place; the message names the size that is needed.
    """
    worst = np.zeros(2)
    for facet in scene.facets:
        outline = scene.bench.project_outline(facet)
        seen = scene.bench.trace(facet, outline[:, 0], outline[:, 1])
        if not np.isfinite(seen.u).all():
            raise InputError(f"facet {facet.name}: part of it does not look at the screen; turn the mirror")
        worst = np.maximum(worst, [np.abs(seen.u - 0.5).max(), np.abs(seen.v - 0.5).max()])
    if worst.max() > 0.5:
        wall = scene.bench.wall
        raise InputError(
            f"screen of {wall.width_m:g} m x {wall.height_m:g} m: the mirror sees beyond it; "
            f"{2 * worst[0] * wall.width_m:.2f} m x {2 * worst[1] * wall.height_m:.2f} m are needed"
        )


def _single(name: str, design: Design, size_m: float = 1.2, camera: PinholeCamera = SMALL_CAMERA) -> FringeScene:
    facet = SyntheticFacet("facet", rectangle(size_m, size_m), design, standard_errors(size_m, size_m))
    return facet_scene(name, (facet,), camera=camera, blur_sigma_px=0.1 if camera is SMALL_CAMERA else 0.5)


def small_scene() -> FringeScene:
    """Return the standard measurement: facet f = 100 m, 1.2 m square, 203 x 154 px."""
    return _single("facet f = 100 m", Design("paraboloid", {"focal_length_m": 100.0}))


def full_scene() -> FringeScene:
    """Return the standard measurement with a camera of 1624 x 1232 px."""
    return _single("facet f = 100 m", Design("paraboloid", {"focal_length_m": 100.0}), camera=FULL_CAMERA)


def off_axis_scene(
    focal_length_m: float = 10.0,
    off_axis_m: float = 0.5,
    *,
    orientation: str = "axis",
    camera: PinholeCamera = SMALL_CAMERA,
) -> FringeScene:
    """Return a facet cut from a paraboloid beside its vertex.

    off_axis_m: Distance of the facet's origin from the axis, along x [m].
    orientation: "axis": the facet's axes are the paraboloid's; "normal": its z is the local normal.
    """
    lengths = {"focal_length_m": focal_length_m}
    design = Design.on_optic("paraboloid", lengths, (off_axis_m, 0.0), orientation=orientation)
    return _single(f"facet f = {focal_length_m:g} m, {off_axis_m:g} m off axis", design, 1.0, camera)


def trough_scene(*, orientation: str = "axis", camera: PinholeCamera = SMALL_CAMERA) -> FringeScene:
    """Return a panel of a trough, f = 1.71 m, between 0.5 m and 1.5 m from its vertex line.

    orientation: "axis": the panel's axes are the trough's; "normal": its z is the normal in its middle.
    """
    design = Design.on_optic("trough", {"focal_length_m": 1.71}, (1.0, 0.0), orientation=orientation)
    return _single("panel of a trough f = 1.71 m", design, 1.0, camera)


def sphere_scene() -> FringeScene:
    """Return a spherical facet, radius 40 m."""
    return _single("spherical facet R = 40 m", Design("sphere", {"radius_m": 40.0}))


def plane_scene() -> FringeScene:
    """Return a flat facet."""
    return _single("flat facet", Design("plane"))


def curved_screen_scene() -> FringeScene:
    """Return the standard facet before a bulging wall with a keystoned image (the measurement holds a table)."""
    wall = replace(STANDARD_WALL, sag_x_m=0.12, sag_y_m=0.03, keystone_x=0.02, keystone_y=-0.015)
    design = Design("paraboloid", {"focal_length_m": 100.0})
    return facet_scene(
        "facet before a curved wall",
        (SyntheticFacet("facet", rectangle(1.2, 1.2), design, standard_errors()),),
        wall=wall,
    )


def ensemble_scene(*, columns: int = 6, rows: int = 4, camera: PinholeCamera | None = None) -> FringeScene:
    """Return a mirror of many facets in one image, each with its own canting error of up to 0.5 mrad.

    camera: The camera; 812 x 616 px without.
    """
    pitch, size, focal_length_m = 0.43, 0.40, 60.0
    # Facets lie on the sphere that focuses at 60 m; each is a paraboloid of that focal length about its own centre.
    optic = Design("sphere", {"radius_m": 2 * focal_length_m})
    rng = np.random.default_rng(24)
    facets = []
    for row in range(rows):
        for column in range(columns):
            center = ((column - 0.5 * (columns - 1)) * pitch, (row - 0.5 * (rows - 1)) * pitch)
            pose = Design.on_optic("sphere", optic.parameters, center).optic_from_facet
            tilt_x, tilt_y = rng.uniform(-5e-4, 5e-4, 2)
            canting = Polynomial([(1, 0, float(tilt_x)), (0, 1, float(tilt_y))])
            errors = SurfaceErrors((canting, *standard_errors(size, size).terms))
            design = Design("paraboloid", {"focal_length_m": focal_length_m})
            facets.append(SyntheticFacet(f"facet_{row}_{column}", rectangle(size, size), design, errors, pose))
    chosen = FULL_CAMERA.scaled(0.5) if camera is None else camera
    return facet_scene(f"ensemble of {rows * columns} facets", tuple(facets), camera=chosen, blur_sigma_px=0.3)


def large_scene() -> FringeScene:
    """Return a facet of 2.4 m x 1.8 m before a larger wall; its image fills two thirds of 1624 x 1232 px."""
    design, size = Design("paraboloid", {"focal_length_m": 100.0}), (2.4, 1.8)
    facet = SyntheticFacet("facet", rectangle(*size), design, standard_errors(*size))
    return facet_scene("large facet", (facet,), camera=FULL_CAMERA, wall=Wall(9.0, 6.0), place_m=(0.0, 0.0, 9.65))


PRESETS: Mapping[str, Callable[[], FringeScene]] = {
    "small": small_scene,
    "full": full_scene,
    "large": large_scene,
    "off-axis": off_axis_scene,
    "off-axis-20": lambda: off_axis_scene(20.0, 0.25),
    "trough-panel": trough_scene,
    "sphere": sphere_scene,
    "plane": plane_scene,
    "curved-screen": curved_screen_scene,
    "ensemble": ensemble_scene,
}


def preset_scene(name: str) -> FringeScene:
    """Return a ready scene by name.

    InputError: No such preset.
    """
    if name not in PRESETS:
        raise InputError(f"preset {name!r}: one of {', '.join(PRESETS)} is needed")
    return PRESETS[name]()
