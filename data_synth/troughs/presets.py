"""Ready scenes of troughs: an LS-2 from a drone with slope errors, displaced or sagging absorber, clouds, ground."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from data_synth.optics.markers import marker_print
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.prints import DotPrint, Print, RingPrint
from data_synth.optics.sheets import Sheet
from data_synth.targets.scene import sheet_points
from data_synth.troughs.errors import random_mirror, with_mounting, with_panel_heights, with_panel_tilts
from data_synth.troughs.field import NeighbourScene, field_of
from data_synth.troughs.mirror import TroughMirror
from data_synth.troughs.paths import (
    absorber_pair,
    level_pass,
    look_at_trough,
    mast_pass,
    numbered,
    several_passes,
    straight_pass,
    turning_collector,
    wobbling,
)
from data_synth.troughs.receiver import Receiver, TubeAxis
from data_synth.troughs.scene import ListedTarget, Optics, TroughScene, TroughView, world_of
from data_synth.troughs.surroundings import Ground, Sky, Surroundings
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.validate import FloatArray
from observer.trough import Collector, ls2
from photogrammetry.targets import ring_dictionary

#: GE1910C: 1920 x 1080, pixel pitch over focal length 4.2e-4 (Owkes 2012, Table 7.2).
VIDEO_CAMERA = PinholeCamera(1920, 1080, 1 / 4.2e-4, 1 / 4.2e-4, 959.5, 539.5)
#: Nikon D300 with 20 mm: 4288 x 2848, 5.5 um (Owkes 2012, sec. 7.4).
D300_CAMERA = PinholeCamera(4288, 2848, 20e-3 / 5.5e-6, 20e-3 / 5.5e-6, 2143.5, 1423.5)
SMALL_CAMERA = PinholeCamera(480, 640, 1030.0, 1030.0, 241.0, 318.0, -0.06, 0.03)
#: It looks straight down and sees 11 m across from 12 m.
FLIGHT_CAMERA = PinholeCamera(480, 960, 1030.0, 1030.0, 241.0, 477.0, -0.06, 0.03)
#: It sees 9 m along from 149 m: a pixel is 4.5 mm.
FAR_CAMERA = PinholeCamera(2000, 1240, 33000.0, 33000.0, 999.5, 619.5)
#: It sees 14 m along from 12 m: a pixel is 6.6 mm.
FIXTURE_CAMERA = PinholeCamera(2144, 1424, 1818.0, 1818.0, 1071.5, 711.5, -0.05, 0.02)
#: Height of the axis of rotation over the vertex of a trough before it [m].
FAR_PIVOT_Z_M = 0.3
#: Distance of the rows of a field that is photographed in one flight [m].
ROW_STEP_M = 7.0

#: Stands for plain dots in the place of a dictionary.
UNCODED = "circles"

#: Stands for no targets at all.
NO_TARGETS = "none"
#: Stands before the number of a square marker that is one of several kinds.
_SQUARE = "square-"

#: What the list of targets is good for [m].
TARGET_SIGMA_M = 1e-3
#: What a tape along the rim is good for (Owkes 2012, sec. 7.3) [m].
DISTANCE_SIGMA_M = 3e-3


@dataclass(frozen=True, slots=True)
class TroughChoice:
    """What may be chosen of a preset.

    seed: Draws errors, targets and wind.
    n_photos: Number of photos; default: from the preset.
    dictionary: Targets: ``aicon-N``, ``metashape-N``, a dictionary of square markers as ``DICT_4X4_100``, or
        ``circles``; several in turn, joined by ``+``, as ``aicon-12+circles+DICT_4X4_100``; ``none``: no targets.
    orientation_deg: Turn of the collector from zenith, by the right hand about +y; default: from the preset [deg].
    n_ground_targets: Targets on the ground beside both rims, of unknown coordinates.
    is_shaped: Whether the mirror's surface itself deviates, as a real one's, instead of its normals alone.
    panel_height_m: How well its panels are mounted in height, as a standard deviation; for a mirror that is shaped
        [m].
    mounting_m: How far panels lie off their places along the mirror and along the trough, as a standard deviation
        [m].
    """

    seed: int = 0
    n_photos: int | None = None
    dictionary: str = "aicon-12"
    orientation_deg: float | None = None
    n_ground_targets: int = 0
    is_shaped: bool = False
    panel_height_m: float = 0.0
    mounting_m: float = 0.0


def trough_scene(preset: str, choice: TroughChoice | None = None) -> TroughScene:
    """Return a ready scene.

    preset: A name of `TROUGH_PRESETS`.
    choice: Seed, number of photos, targets.
    InputError: No such preset, an orientation for a collector that turns, or heights of panels for a mirror without
        a shape.
    """
    if preset not in _PRESETS:
        raise InputError(f"preset {preset!r}: one of {', '.join(_PRESETS)} is needed")
    chosen = TroughChoice() if choice is None else choice
    scene = _PRESETS[preset](chosen, np.random.default_rng([chosen.seed, 5]))
    if scene.troughs and (chosen.orientation_deg is not None or chosen.n_ground_targets):
        raise InputError(f"preset {preset!r}: several troughs; leave orientation and ground targets out")
    wants_orientation = chosen.orientation_deg is not None or chosen.n_ground_targets > 0
    if wants_orientation and any(view.orientation_deg is not None for view in scene.views):
        raise InputError(
            f"preset {preset!r}: its collector turns from photo to photo; leave orientation and ground targets out"
        )
    if chosen.orientation_deg is not None:
        around = scene.world.surroundings.turned(chosen.orientation_deg)
        scene = replace(scene, world=replace(scene.world, surroundings=around))
    if chosen.panel_height_m:
        mirror = with_panel_heights(scene.world.mirror, chosen.panel_height_m, np.random.default_rng([chosen.seed, 7]))
        scene = replace(scene, world=replace(scene.world, mirror=mirror))
    if chosen.mounting_m:
        mirror = with_mounting(scene.world.mirror, chosen.mounting_m, np.random.default_rng([chosen.seed, 8]))
        scene = replace(scene, world=replace(scene.world, mirror=mirror))
    return with_ground_targets(scene, chosen.n_ground_targets, np.random.default_rng([chosen.seed, 6]))


def with_ground_targets(scene: TroughScene, n: int, rng: np.random.Generator) -> TroughScene:
    """Put targets on the ground, 1 m beside both rims.

    Returns: The scene with targets of which the list knows the place only roughly.
    """
    design, around = scene.collector, scene.world.surroundings
    prints = target_prints(scene.dictionary, scene.target_diameter_m, n, first=len(scene.sheets))
    side = np.where(np.arange(n) % 2, 1.0, -1.0) * (design.aperture_width_m / 2 + 1.0)
    along = np.linspace(-0.5, 0.5, max(n // 2, 2))[np.arange(n) // 2 % max(n // 2, 2)] * (design.length_m + 1.0)
    places = side[:, None] * around.horizontal + along[:, None] * [0.0, 1.0, 0.0] - around.ground.below_m * around.up
    sheets, targets = placed_targets(prints, places, rng, facing=around.up, on_collector=False)
    return replace(scene, sheets=scene.sheets + sheets, targets=scene.targets + targets)


def ls2_panelled() -> Collector:
    """Return the LS-2 with 4 by 5 panels of equal arc, gaps of 10 mm and a support at both ends and in the middle."""
    design = ls2()
    half_y = design.length_m / 2
    return replace(
        design,
        panel_edges_x_m=equal_arcs(design, 4),
        panel_edges_y_m=np.linspace(-half_y, half_y, 6),
        panel_gap_m=0.01,
        support_y_m=np.array([-half_y, 0.0, half_y]),
    )


def equal_arcs(collector: Collector, n: int) -> FloatArray:
    """Return edges of panels of equal arc length across the aperture, shape (n + 1,) [m]."""
    half = collector.aperture_width_m / 2
    x = np.linspace(-half, half, 20001)
    slope = x / (2 * collector.focal_length_m)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(1, (slope[1:] + slope[:-1]) / 2) * np.diff(x))])
    edges = np.interp(np.linspace(0, arc[-1], n + 1), arc, x)
    edges[0], edges[-1] = -half, half
    return np.asarray((edges - edges[::-1]) / 2)


def rim_targets(
    collector: Collector, dictionary: str, diameter_m: float, rng: np.random.Generator, *, n: int = 12, first: int = 0
) -> tuple[tuple[Sheet, ...], tuple[ListedTarget, ...]]:
    """Put targets along both rims, facing up, about where the list says.

    dictionary: Kind of targets, as in `TroughChoice`.
    diameter_m: Diameter of the dots; square markers are three times as wide [m].
    rng: Draws how far each is from its listed place, its turn and tilt.
    """
    places = []
    prints = target_prints(dictionary, diameter_m, n, first)
    if not prints:
        return (), ()
    reach = max(figure.half_size_m[0] for figure in prints.values())
    across = collector.aperture_width_m / 2 + reach + 0.03
    along = collector.length_m / 2 - reach
    step = 2 * along / (n // 2 - 1)
    for k in range(n):
        y = -along + step * (k % (n // 2))
        if dictionary == UNCODED and abs(y) < 0.99 * along:
            # Even spacing would look the same from the other end: only their places tell dots without a code apart.
            y += float(rng.uniform(-0.3, 0.3)) * step
        places.append(np.array([across if k >= n // 2 else -across, y, collector.rim_height_m]))
    return placed_targets(prints, np.array(places), rng)


def placed_targets(
    prints: Mapping[str, Print],
    stated_m: FloatArray,
    rng: np.random.Generator,
    *,
    facing: FloatArray | None = None,
    on_collector: bool = True,
) -> tuple[tuple[Sheet, ...], tuple[ListedTarget, ...]]:
    """Put targets within a millimetre of where the list says.

    Shapes: stated_m (n, 3).
    prints: Figure of each by its name.
    facing (3,): Where they look; +z without.
    on_collector: Whether the coordinates are listed; those of others are unknown.
    """
    upright = np.eye(3)
    if facing is not None:
        upright = np.stack([np.cross([0.0, 1.0, 0.0], facing), [0.0, 1.0, 0.0], facing], axis=1)
    sheets, targets = [], []
    for (name, figure), stated in zip(prints.items(), stated_m, strict=True):
        turn = rotation_from_vector(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]))
        tilt = rotation_from_vector(np.array([*rng.uniform(-0.05, 0.05, 2), 0.0]))
        true = stated + TARGET_SIGMA_M * rng.standard_normal(3)
        sheet = Sheet(name, figure, RigidTransform(upright @ tilt @ turn, true))
        sheets.append(sheet)
        sigma = np.full(3, TARGET_SIGMA_M if on_collector else np.nan)
        # Corners of a square marker are listed one by one, with the error of the whole marker.
        for point, place in sheet_points(sheet).items():
            kind, code, diameter_m = _looks(name, point, figure)
            targets.append(ListedTarget(point, place + stated - true, sigma, on_collector, kind, code, diameter_m))
    return tuple(sheets), tuple(targets)


def _looks(sheet: str, point: str, figure: Print) -> tuple[str, str, float | None]:
    """Return the kind of a target, what photos show it as, and the diameter of its dot."""
    if isinstance(figure, RingPrint):
        return "coded", figure.code.name, figure.diameter_m
    if isinstance(figure, DotPrint):
        return "plain", "", figure.diameter_m
    return "square", sheet.removeprefix(_SQUARE) + point.removeprefix(sheet), None


def target_prints(dictionary: str, diameter_m: float, n: int, first: int = 0) -> dict[str, Print]:
    """Return names and figures of targets.

    dictionary: Kind of targets, as in `TroughChoice`.
    diameter_m: Diameter of the dots; square markers are three times as wide [m].
    InputError: The dictionary has too few codes, or does not exist.
    """
    numbers = range(first, first + n)
    if dictionary == NO_TARGETS:
        return {}
    if "+" in dictionary:
        kinds = dictionary.split("+")
        mixed: dict[str, Print] = {}
        for number in numbers:
            [(name, figure)] = target_prints(kinds[number % len(kinds)], diameter_m, 1, number).items()
            # The list's name of a marker: its number is that of a ring code, too.
            mixed[_SQUARE + name if kinds[number % len(kinds)].startswith("DICT_") else name] = figure
        return mixed
    if dictionary == UNCODED:
        return {f"dot{number + 1}": DotPrint(diameter_m) for number in numbers}
    if dictionary.startswith("DICT_"):
        return {str(number): marker_print(dictionary, number, 3 * diameter_m) for number in numbers}
    codes = ring_dictionary(dictionary).codes
    if len(codes) < first + n:
        raise InputError(f"dictionary {dictionary} has {len(codes)} codes, {first + n} targets need one each")
    return {code.name: RingPrint(code, diameter_m) for code in codes[first : first + n]}


def _drone(choice: TroughChoice, rng: np.random.Generator, usual: int = 100) -> tuple[TroughView, ...]:
    n = usual if choice.n_photos is None else choice.n_photos
    return wobbling(straight_pass(VIDEO_CAMERA, n_photos=n), rng)


def _scene(
    name: str, mirror: TroughMirror, views: tuple[TroughView, ...], choice: TroughChoice, rng: np.random.Generator
) -> TroughScene:
    sheets, targets = rim_targets(mirror.collector, choice.dictionary, 0.06, rng)
    return TroughScene(name, world_of(mirror), views, sheets, targets, dictionary=choice.dictionary)


def _small(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw 24 photos of a short piece of an LS-2 with 2 by 4 panels, for quick tests."""
    n = 24 if choice.n_photos is None else choice.n_photos
    views = wobbling(straight_pass(SMALL_CAMERA, n_photos=n, height_m=12.0, reach_m=2.9), rng, position_m=0.05)
    return _short_ls2(views, choice, rng)


def _short_ls2(
    views: tuple[TroughView, ...], choice: TroughChoice, rng: np.random.Generator, first: int = 0
) -> TroughScene:
    ends = np.array([-1.58, 0.0, 1.58])
    collector = replace(ls2_panelled(), length_m=3.16, panel_edges_y_m=ends, support_y_m=ends[::2])
    mirror = random_mirror(collector, rng, is_shaped=choice.is_shaped)
    sheets, targets = rim_targets(collector, choice.dictionary, 0.09, rng, first=first)
    return TroughScene(
        "short LS-2", world_of(mirror), views, sheets, targets, dictionary=choice.dictionary, target_diameter_m=0.09
    )


def _flight(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw one flight over two short pieces of LS-2 in rows 7 m apart, the second one with its tube too low."""
    n = 64 if choice.n_photos is None else choice.n_photos
    views = wobbling(
        level_pass(FLIGHT_CAMERA, n_photos=n, from_x_m=-2.9, to_x_m=ROW_STEP_M + 2.9), rng, position_m=0.05
    )
    rows = []
    for number, name in enumerate(("row-1", "row-2")):
        scene = _short_ls2(views, choice, rng, first=12 * number)
        world = scene.world
        if number == 1:
            world = replace(world, receiver=Receiver(scene.collector, TubeAxis.straight(2e-3, -4e-3)))
        # The pattern of the ground goes on from row to row.
        around = replace(world.surroundings, ground=Ground(size_m=ROW_STEP_M))
        scene = replace(scene, world=replace(world, surroundings=around))
        rows.append(NeighbourScene(name, np.array([number * ROW_STEP_M, 0.0, 0.0]), scene))
    return field_of("two rows in one flight", rows, views)


def _ls2(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw 100 photos from 15 m of an LS-2 with 3 mrad of transverse slope error and no longitudinal one."""
    mirror = random_mirror(ls2_panelled(), rng, is_shaped=choice.is_shaped)
    return _scene("LS-2 from 15 m", mirror, _drone(choice, rng), choice, rng)


def _ls2_long(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw the LS-2 with 1.8 mrad of longitudinal slope error in addition."""
    mirror = random_mirror(ls2_panelled(), rng, longitudinal_rad=1.8e-3, is_shaped=choice.is_shaped)
    return _scene("LS-2 with longitudinal errors", mirror, _drone(choice, rng), choice, rng)


def _ls2_two_passes(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw the LS-2 with longitudinal slope errors in two passes at y = -2.5 m and +2.5 m."""
    mirror = random_mirror(ls2_panelled(), rng, longitudinal_rad=1.8e-3, is_shaped=choice.is_shaped)
    n = 200 if choice.n_photos is None else choice.n_photos
    views = wobbling(several_passes(VIDEO_CAMERA, (-2.5, 2.5), n_photos=n), rng)
    return _scene("LS-2 in two passes", mirror, views, choice, rng)


def _displaced(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw a perfect LS-2 whose absorber is 3 mm to +x and 5 mm too near the vertex, the glass in its place."""
    mirror = TroughMirror(ls2_panelled())
    scene = _scene("perfect LS-2, displaced absorber", mirror, _drone(choice, rng), choice, rng)
    receiver = Receiver(mirror.collector, TubeAxis.straight(3e-3, -5e-3), TubeAxis.straight())
    return replace(scene, world=replace(scene.world, receiver=receiver))


def _sag(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw the LS-2 with a receiver that sags by 6 mm between its supports, 2 mm to the side and tilted."""
    mirror = random_mirror(ls2_panelled(), rng, is_shaped=choice.is_shaped)
    scene = _scene("LS-2 with sagging absorber", mirror, _drone(choice, rng), choice, rng)
    turn = np.radians(choice.orientation_deg or 0.0)
    axis = TubeAxis.straight(2e-3, 1e-3, 4e-4, -3e-4)
    axis = axis.sagging(mirror.collector.support_y_m, 6e-3 * float(np.sin(turn)), -6e-3 * float(np.cos(turn)))
    return replace(scene, world=replace(scene.world, receiver=Receiver(mirror.collector, axis)))


def _clouds(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw the LS-2 under broken clouds, with glint of the sun and changing exposure."""
    scene = _ls2(choice, rng)
    sky = Sky(clouds=0.8, sun_elevation_deg=72.0, sun_azimuth_deg=35.0)
    views = tuple(replace(view, exposure=float(np.exp(rng.normal(0, 0.08)))) for view in scene.views)
    world = replace(scene.world, surroundings=Surroundings(sky, Ground(), seed=choice.seed))
    return replace(scene, name="LS-2 under clouds", world=world, views=views)


def _ground(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw the LS-2 turned to the horizon: ground, shadows and things that lie about in the reflection."""
    scene = _ls2(choice, rng)
    ground = Ground(contrast=0.25)
    around = Surroundings(Sky(sun_elevation_deg=38.0, sun_azimuth_deg=160.0), ground, 60.0, seed=choice.seed)
    return replace(scene, name="LS-2 with ground in it", world=replace(scene.world, surroundings=around))


def _mast(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw the LS-2 turned to the horizon, photographed from a mast that is raised 15 m before it."""
    n = 100 if choice.n_photos is None else choice.n_photos
    scene = _scene(
        "LS-2 from a mast",
        random_mirror(ls2_panelled(), rng, is_shaped=choice.is_shaped),
        mast_pass(VIDEO_CAMERA, rng, n_photos=n, distance_m=15.0),
        choice,
        rng,
    )
    around = Surroundings(Sky(sun_elevation_deg=50.0, sun_azimuth_deg=60.0), Ground(), 90.0, seed=choice.seed)
    return replace(scene, world=replace(scene.world, surroundings=around))


def _turning(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw the LS-2 turning before a fixed camera 20 m away on the ground (the geometry of TARMES)."""
    n = 100 if choice.n_photos is None else choice.n_photos
    views = turning_collector(VIDEO_CAMERA, np.array([20.0, 0.0, 0.3]), np.linspace(80.5, 99.5, n))
    return _scene(
        "LS-2 turning before a camera",
        random_mirror(ls2_panelled(), rng, is_shaped=choice.is_shaped),
        views,
        choice,
        rng,
    )


def _far(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw the LS-2 turning by 5 degrees before a camera 100 focal lengths away that resolves no targets (TARMES)."""
    n = 41 if choice.n_photos is None else choice.n_photos
    # A metre lower than the axis of rotation: the collector faces it at 90.4 deg.
    place = np.array([100 * ls2().focal_length_m, 0.5, -0.7])
    views = turning_collector(FAR_CAMERA, place, np.linspace(87.9, 92.9, n), pivot_z_m=FAR_PIVOT_Z_M)
    mirror = random_mirror(ls2_panelled(), rng, is_shaped=choice.is_shaped)
    scene = _scene("LS-2 turning far from a camera", mirror, views, replace(choice, dictionary=NO_TARGETS), rng)
    around = Surroundings(Sky(sun_elevation_deg=50.0, sun_azimuth_deg=150.0), Ground(), 90.0, seed=choice.seed)
    receiver = Receiver(mirror.collector, TubeAxis.straight(2e-3, 3e-3))
    return replace(scene, world=replace(scene.world, surroundings=around, receiver=receiver))


def _fixture(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw an LS-2 that nobody aligned before five cameras: one for each row of panels, one on the axis (TOPCAT)."""
    mirror = random_mirror(ls2_panelled(), rng, transverse_rad=1.5e-3, is_shaped=choice.is_shaped)
    mirror = with_panel_tilts(mirror, 4e-3, rng)
    edges = mirror.collector.panel_edges_x_m
    across = np.sort(np.append((edges[1:] + edges[:-1]) / 2, 0.0))
    views = numbered(
        TroughView("", FIXTURE_CAMERA, look_at_trough(np.array([x, 0.0, 12.0]), np.array([0.3 * x, 0.0, 0.0])))
        for x in across
    )
    # Nobody sets a fixture up to the millimetre.
    scene = _scene("LS-2 before a fixture", mirror, wobbling(views, rng, position_m=0.03, aim_rad=0.005), choice, rng)
    around = Surroundings(Sky(sun_elevation_deg=50.0, sun_azimuth_deg=150.0), Ground(), 90.0, seed=choice.seed)
    return replace(scene, world=replace(scene.world, surroundings=around), has_tube_beside=False)


def _absorber(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw two photos by a D300 from 7 m beside and 7 m above, for the absorber's position."""
    scene = _scene(
        "absorber of an LS-2",
        random_mirror(ls2_panelled(), rng, is_shaped=choice.is_shaped),
        absorber_pair(D300_CAMERA),
        choice,
        rng,
    )
    axis = TubeAxis.straight(3e-3, -5e-3).sagging(scene.collector.support_y_m, 0.0, -4e-3)
    return replace(scene, world=replace(scene.world, receiver=Receiver(scene.collector, axis)), optics=Optics(0.7))


def _panel(choice: TroughChoice, rng: np.random.Generator) -> TroughScene:
    """Draw one panel of an LS-2 in the laboratory, before a dummy absorber, under a bright even ceiling."""
    edges = ls2_panelled().panel_edges_x_m
    design = replace(ls2(), length_m=1.6, glass=None, panel_edges_x_m=edges[2:4], panel_edges_y_m=np.array([-0.8, 0.8]))
    mirror = random_mirror(design, rng, is_shaped=choice.is_shaped)
    n = 20 if choice.n_photos is None else choice.n_photos
    path = level_pass(SMALL_CAMERA, n_photos=n, from_x_m=-0.5, to_x_m=edges[3] + 0.5, height_m=6.5)
    prints = target_prints(choice.dictionary, 0.05, 12)
    x, y = edges[2:4] + np.array([-0.16, 0.16]), 0.96
    across = np.repeat([x[0], x[1], x.mean()], (4, 4, 4))
    along = np.concatenate([np.tile(np.linspace(-y, y, 4), 2), [-y - 0.1, y + 0.1, -y - 0.3, y + 0.3]])
    places = np.stack([across, along, np.maximum(across, 0.0) ** 2 / (4 * design.focal_length_m)], axis=1)
    sheets, targets = placed_targets(prints, places, rng)
    around = Surroundings(Sky(zenith=0.75, horizon=0.75, aureole=0.0, sun_elevation_deg=-60.0), Ground())
    world = world_of(mirror, surroundings=around)
    return TroughScene(
        "panel in the laboratory",
        world,
        wobbling(path, rng, position_m=0.02),
        sheets,
        targets,
        dictionary=choice.dictionary,
        target_diameter_m=0.05,
    )


_PRESETS: dict[str, Callable[[TroughChoice, np.random.Generator], TroughScene]] = {
    "small": _small,
    "flight": _flight,
    "ls2": _ls2,
    "ls2-long": _ls2_long,
    "ls2-two-passes": _ls2_two_passes,
    "displaced": _displaced,
    "sag": _sag,
    "clouds": _clouds,
    "ground": _ground,
    "mast": _mast,
    "turning": _turning,
    "far": _far,
    "fixture": _fixture,
    "absorber": _absorber,
    "panel": _panel,
}

#: Names of the presets.
TROUGH_PRESETS = tuple(_PRESETS)
