"""Ready scenes of targets: a small panel, an 8 m panel, one large photo, retro-reflective dots, square markers."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from data_synth.optics.markers import marker_print
from data_synth.optics.photo import View
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.prints import DotPrint, RingPrint
from data_synth.optics.sensor import Sensor
from data_synth.optics.sheets import Sheet
from data_synth.optics.texture import random_texture
from data_synth.targets.scene import Conditions, Cover, Glare, KnownLength, TargetScene
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.validate import FloatArray
from photogrammetry.targets import RingCode, RingRadii, ring_dictionary

SMALL_CAMERA = PinholeCamera(1600, 1200, 1510.0, 1508.0, 806.0, 593.0, -0.08, 0.06, 0.0, 2e-4, -3e-4)
#: 24 megapixel, full frame, 24 mm.
LARGE_CAMERA = PinholeCamera(6000, 4000, 4030.0, 4028.0, 3012.0, 1985.0, -0.06, 0.05, -0.01, 1e-4, -2e-4)

#: How well a scale bar of carbon fibre is calibrated [m].
BAR_SIGMA_M = 1e-5


@dataclass(frozen=True, slots=True)
class PrintChoice:
    """How ring codes are printed.

    dictionary: Name of the dictionary; the preset's if absent.
    light_on_dark: White ink on black paper.
    mirrored: Printed the wrong way round.
    radii: Where the code rings lie; the dictionary's if absent.
    hole_radii: Radius of a hole in the middle of each dot, in radii of the dot.
    cross_radii: Half length of a cross without ink in the middle of each dot, in radii of the dot.
    """

    dictionary: str | None = None
    light_on_dark: bool = False
    mirrored: bool = False
    radii: RingRadii | None = None
    hole_radii: float = 0.0
    cross_radii: float = 0.0


def target_scene(preset: str, seed: int = 0, prints: PrintChoice | None = None) -> TargetScene:
    """Return a ready scene.

    preset: ``small``, ``panel``, ``single``, ``retro``, ``markers``, ``busy`` or ``natural``.
    seed: Places, tilts and poses are drawn with it.
    prints: How ring codes are printed.
    InputError: No such preset.
    """
    if preset not in _PRESETS:
        raise InputError(f"preset {preset!r}: one of {', '.join(_PRESETS)} is needed")
    return _PRESETS[preset](np.random.default_rng(seed), PrintChoice() if prints is None else prints)


def look_at(position_m: FloatArray, target_m: FloatArray, roll_rad: float = 0.0) -> RigidTransform:
    """Return the pose ``cam_from_world`` of a camera that looks at a point, with world y up before its roll.

    Shapes: position_m, target_m (3,).
    roll_rad: Turn about the line of sight [rad].
    """
    forward = target_m - position_m
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    upright = np.stack([right, np.cross(forward, right), forward])
    rotation = rotation_from_vector(np.array([0.0, 0.0, roll_rad])) @ upright
    return RigidTransform(rotation, -rotation @ position_m)


def dome_views(
    camera: PinholeCamera, distance_m: float, n_photos: int, tilts_deg: tuple[float, ...], rng: np.random.Generator
) -> tuple[View, ...]:
    """Place cameras around the z axis, some of them rolled by a quarter turn, as a surveyor walks.

    tilts_deg: Angles from the z axis that take turns [deg].
    """
    views = []
    for k in range(n_photos):
        tilt = np.radians(tilts_deg[k % len(tilts_deg)] + rng.uniform(-4, 4))
        azimuth = 2 * np.pi * (k + rng.uniform(-0.2, 0.2)) / n_photos
        direction = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
        position = direction * distance_m * rng.uniform(0.95, 1.05)
        roll = (np.pi / 2) * (0, 1, 0, -1)[k % 4] + rng.uniform(-0.1, 0.1)
        pose = look_at(position, rng.uniform(-0.03, 0.03, 3) * distance_m, roll)
        views.append(View(f"photo_{k + 1:03d}", camera, pose))
    return tuple(views)


def ring_sheet(code: RingCode, diameter_m: float, place: RigidTransform, prints: PrintChoice) -> Sheet:
    """Return the sheet of one ring code as it is printed."""
    ink, paper = (0.85, 0.05) if prints.light_on_dark else (0.05, 0.85)
    as_printed = code if prints.radii is None else replace(code, radii=prints.radii)
    figure = RingPrint(as_printed, diameter_m, prints.mirrored, prints.hole_radii, prints.cross_radii)
    return Sheet(code.name, figure, place, ink, paper)


def _panel_places(
    shape: tuple[int, int], size_m: tuple[float, float], focal_length_m: float, rng: np.random.Generator
) -> list[RigidTransform]:
    """Spread places over a parabolic panel, each turned by chance about its normal and tilted by up to 10 deg."""
    columns, rows = shape
    places = []
    for k in range(columns * rows):
        row, column = divmod(k, columns)
        jitter = rng.uniform(-0.12, 0.12, 2)
        x = ((column + 0.5 + jitter[0]) / columns - 0.5) * size_m[0]
        y = ((row + 0.5 + jitter[1]) / rows - 0.5) * size_m[1]
        z = x * x / (4 * focal_length_m) + rng.uniform(0, 0.02) * size_m[1]
        slope = np.array([rng.uniform(-0.1, 0.1), -x / (2 * focal_length_m) + rng.uniform(-0.1, 0.1), 0.0])
        turn = np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)])
        places.append(RigidTransform(rotation_from_vector(slope) @ rotation_from_vector(turn), np.array([x, y, z])))
    return places


def _with_bars(scene: TargetScene, bars: tuple[tuple[int, int], ...], rng: np.random.Generator) -> TargetScene:
    """Call pairs of sheets scale bars."""
    lengths = []
    for one, other in bars:
        a, b = scene.sheets[one], scene.sheets[other]
        length = float(np.linalg.norm(a.world_from_sheet.translation_m - b.world_from_sheet.translation_m))
        stated = length + BAR_SIGMA_M * float(rng.standard_normal())
        lengths.append(KnownLength(a.name, b.name, length, stated, BAR_SIGMA_M))
    return replace(scene, lengths=tuple(lengths))


def _small(rng: np.random.Generator, prints: PrintChoice) -> TargetScene:
    """Draw 8 photos of 40 coded targets and 12 plain dots on a panel of 1.6 m by 1.2 m."""
    name = prints.dictionary or "aicon-12"
    codes = ring_dictionary(name).codes
    places = _panel_places((8, 5), (1.6, 1.2), 1.5, rng)
    if len(codes) < len(places):
        raise InputError(f"dictionary {name} has {len(codes)} codes, {len(places)} targets need one each")
    sheets = [ring_sheet(code, 0.014, place, prints) for code, place in zip(codes, places, strict=False)]
    # Between four coded targets each, so that no paper hides another.
    dots = (i for i in range(32) if i % 8 in (1, 4, 6))
    for number, k in enumerate(dots):
        middle = np.mean([places[j].translation_m for j in (k, k + 1, k + 8, k + 9)], axis=0)
        sheets.append(Sheet(f"dot{number + 1}", DotPrint(0.014), RigidTransform(np.eye(3), middle)))
    scene = TargetScene("small panel", tuple(sheets), dome_views(SMALL_CAMERA, 2.2, 8, (28.0, 42.0), rng))
    return _with_bars(replace(scene, dictionary=name), ((0, 7), (32, 39), (2, 35)), rng)


def _panel(rng: np.random.Generator, prints: PrintChoice) -> TargetScene:
    """Draw 40 photos of 300 coded targets on a trough panel of 8 m by 6 m."""
    name = prints.dictionary or "aicon-14"
    codes = ring_dictionary(name).codes
    places = _panel_places((20, 15), (8.0, 6.0), 2.5, rng)
    if len(codes) < len(places):
        raise InputError(f"dictionary {name} has {len(codes)} codes, {len(places)} targets need one each")
    sheets = tuple(ring_sheet(code, 0.02, place, prints) for code, place in zip(codes, places, strict=False))
    scene = TargetScene("8 m panel", sheets, dome_views(LARGE_CAMERA, 9.5, 40, (20.0, 38.0, 50.0), rng))
    return _with_bars(replace(scene, dictionary=name), ((124, 132), (164, 172), (90, 210)), rng)


def _single(rng: np.random.Generator, prints: PrintChoice) -> TargetScene:
    """Draw one photo of 24 megapixel with 100 coded targets, 6 to 60 px across and tilted up to 65 deg."""
    name = prints.dictionary or "aicon-12"
    codes = ring_dictionary(name).codes
    view = View("photo_001", LARGE_CAMERA, look_at(np.array([0.0, 0.0, 4.0]), np.zeros(3)))
    sheets = []
    for k, code in enumerate(codes[:100]):
        row, column = divmod(k, 10)
        pixel = np.array([(column + 0.5) * 600, (row + 0.5) * 400]) + rng.uniform(-20, 20, 2)
        depth = rng.uniform(3, 6)
        ray = LARGE_CAMERA.rays(pixel[0], pixel[1])
        place = view.cam_from_world.inverse().apply(ray / ray[2] * depth)
        diameter = np.exp(rng.uniform(np.log(6), np.log(60))) * depth / LARGE_CAMERA.focal_x_px
        to_camera = look_at(np.array([0.0, 0.0, 4.0]), place).rotation
        # Columns: right, up and towards the camera.
        facing = np.stack([to_camera[0], -to_camera[1], -to_camera[2]], axis=1)
        azimuth, tilt = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(0, 65))
        tilted = rotation_from_vector(np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) * tilt)
        turn = rotation_from_vector(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]))
        sheets.append(ring_sheet(code, diameter, RigidTransform(facing @ tilted @ turn, place), prints))
    return TargetScene("one photo", tuple(sheets), (view,), dictionary=name)


def _retro(rng: np.random.Generator, prints: PrintChoice) -> TargetScene:
    """Draw the small panel with a flash: bright codes and dots on an almost black panel."""
    scene = _small(rng, replace(prints, light_on_dark=True))
    sheets = tuple(replace(sheet, ink=0.8, transparent=True) for sheet in scene.sheets)
    return replace(scene, name="retro-reflective panel", sheets=sheets, conditions=Conditions(ground=0.02))


def _busy(rng: np.random.Generator, prints: PrintChoice) -> TargetScene:
    """Draw the small panel on busy ground, shaded, with glare and something in front."""
    conditions = Conditions(
        blur_sigma_px=0.8,
        sensor=Sensor(exposure=1.0, read_noise_dn=2.0, shot_gain_dn=0.03),
        clutter=0.6,
        vignetting=0.4,
        gradient=(0.5, -0.3),
        glares=(Glare((0.35, 0.4), 0.05, 0.9), Glare((0.7, 0.65), 0.03, 0.6)),
        covers=(Cover((0.1, 0.9), (0.9, 0.3), 0.01),),
    )
    return replace(_small(rng, prints), name="busy panel", conditions=conditions)


def _markers(rng: np.random.Generator, prints: PrintChoice) -> TargetScene:
    """Draw 8 photos of 24 square markers on the small panel."""
    places = _panel_places((6, 4), (1.6, 1.2), 1.5, rng)
    sheets = tuple(
        Sheet(str(number), marker_print("DICT_4X4_100", number, 0.08), place) for number, place in enumerate(places)
    )
    scene = TargetScene("square markers", sheets, dome_views(SMALL_CAMERA, 2.2, 8, (28.0, 42.0), rng))
    points = scene.points_m()
    ends = (("0.0", "5.1"), ("18.3", "23.2"))
    truth = [float(np.linalg.norm(points[a] - points[b])) for a, b in ends]
    lengths = (
        KnownLength(a, b, length, length + BAR_SIGMA_M * float(rng.standard_normal()), BAR_SIGMA_M)
        for (a, b), length in zip(ends, truth, strict=True)
    )
    return replace(scene, lengths=tuple(lengths), dictionary=prints.dictionary or "DICT_4X4_100")


def _natural(rng: np.random.Generator, prints: PrintChoice) -> TargetScene:
    """Draw 8 photos of 12 textured tiles at different heights, with 6 coded targets in the gaps between them."""
    name = prints.dictionary or "aicon-12"
    sheets = []
    for k in range(12):
        row, column = divmod(k, 4)
        place = np.array([(column - 1.5) * 0.5, (row - 1) * 0.5, rng.uniform(-0.08, 0.08)])
        tilt = rotation_from_vector(np.array([*rng.uniform(-0.15, 0.15, 2), 0.0]))
        figure = random_texture((0.36, 0.36), 0.003, rng)
        sheets.append(Sheet(f"tile{k + 1}", figure, RigidTransform(tilt, place)))
    for k, code in enumerate(ring_dictionary(name).codes[:6]):
        row, column = divmod(k, 3)
        place = np.array([(column - 1) * 0.5, (row - 0.5) * 0.5, rng.uniform(-0.02, 0.02)])
        sheets.append(ring_sheet(code, 0.028, RigidTransform(np.eye(3), place), prints))
    views = dome_views(SMALL_CAMERA.scaled(0.5), 2.3, 8, (24.0, 36.0), rng)
    return _with_bars(TargetScene("textured tiles", tuple(sheets), views, dictionary=name), ((12, 17), (14, 15)), rng)


_PRESETS: dict[str, Callable[[np.random.Generator, PrintChoice], TargetScene]] = {
    "small": _small,
    "panel": _panel,
    "single": _single,
    "retro": _retro,
    "busy": _busy,
    "markers": _markers,
    "natural": _natural,
}
