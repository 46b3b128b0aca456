"""Photos of many ring codes side by side, as they are printed and photographed: what detection is measured with."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from data_synth.optics.photo import Focus, View
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.sheets import Sheet
from data_synth.targets.presets import PrintChoice, look_at, ring_sheet
from data_synth.targets.scene import Conditions, ScreenPixels, Sharpening, TargetScene
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.short_repr import ShortRepr
from photogrammetry.targets import RingCode, RingRadii

_FOCAL_PX = 2500.0
_DISTANCE_M = 4.0
#: Longer side of a photo of the wall, and the targets in it at most [px].
_SIDE_PX = 3600


@dataclass(frozen=True, slots=True, eq=False)
class WallOfCodes(ShortRepr):
    """How codes on a wall are printed and photographed.

    diameters_px: Smallest and largest diameter of the dots; each photo holds dots of sizes within a factor of 1.5 [px].
    most_tilt_rad: Largest tilt of a target against the line of sight [rad].
    prints: How codes are printed.
    conditions: Light, lens and sensor.
    depth_share: Spread of the targets' depths, as a share of the distance.
    """

    diameters_px: tuple[float, float] = (8.0, 150.0)
    most_tilt_rad: float = 0.8
    prints: PrintChoice = field(default_factory=PrintChoice)
    conditions: Conditions = field(default_factory=Conditions)
    depth_share: float = 0.15


def wall_scenes(codes: Sequence[RingCode], wall: WallOfCodes, rng: np.random.Generator) -> list[TargetScene]:
    """Spread codes over walls, each photographed once: dots of like size on one wall.

    codes: The codes, each of which is shown once.
    rng: Sizes, tilts and turns are drawn with it.
    Returns: One scene with one photo for each wall.
    InputError: A diameter of which not one target fits into a photo.
    """
    low, high = wall.diameters_px
    sizes = np.exp(rng.uniform(np.log(low), np.log(high), len(codes)))
    order = np.argsort(sizes)
    scenes: list[TargetScene] = []
    first = 0
    while first < len(order):
        largest = min(1.5 * sizes[order[first]], high)
        pitch = _pitch_px(float(largest), wall)
        across = _SIDE_PX // pitch
        if not across:
            raise InputError(f"targets of {largest:.0f} px: one takes {pitch} px, a photo has {_SIDE_PX}")
        group = [k for k in order[first : first + across * across].tolist() if sizes[k] <= largest]
        scenes.append(_scene(f"wall {len(scenes) + 1}", [codes[k] for k in group], sizes[group], pitch, wall, rng))
        first += len(group)
    return scenes


def _pitch_px(largest_px: float, wall: WallOfCodes) -> int:
    quiet = 4.0 if wall.prints.radii is None else wall.prints.radii.quiet
    return int(np.ceil(1.45 * quiet * largest_px + 8 * wall.conditions.blur_sigma_px + 4))


def _scene(
    name: str,
    codes: Sequence[RingCode],
    sizes_px: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    pitch: int,
    wall: WallOfCodes,
    rng: np.random.Generator,
) -> TargetScene:
    columns = int(np.ceil(np.sqrt(len(codes))))
    rows = -(-len(codes) // columns)
    width, height = columns * pitch, rows * pitch
    camera = PinholeCamera(width, height, _FOCAL_PX, _FOCAL_PX, (width - 1) / 2, (height - 1) / 2)
    here = np.array([0.0, 0.0, _DISTANCE_M])
    view = View("photo_001", camera, look_at(here, np.zeros(3)))
    sheets: list[Sheet] = []
    for k, (code, size) in enumerate(zip(codes, sizes_px.tolist(), strict=True)):
        row, column = divmod(k, columns)
        pixel = np.array([(column + 0.5) * pitch, (row + 0.5) * pitch]) + rng.uniform(-0.5, 0.5, 2)
        depth = _DISTANCE_M * (1 + wall.depth_share * rng.uniform(-1, 1))
        ray = camera.rays(pixel[0], pixel[1])
        place = view.cam_from_world.inverse().apply(ray / ray[2] * depth)
        to_camera = look_at(here, place).rotation
        facing = np.stack([to_camera[0], -to_camera[1], -to_camera[2]], axis=1)
        azimuth, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(0, wall.most_tilt_rad)
        tilted = rotation_from_vector(np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) * tilt)
        turn = rotation_from_vector(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]))
        at = RigidTransform(facing @ tilted @ turn, place)
        sheets.append(ring_sheet(code, size * depth / _FOCAL_PX, at, wall.prints))
    return TargetScene(name, tuple(sheets), (view,), wall.conditions)


_FAR, _NEAR = RingRadii(2.25, 3.48), RingRadii(1.9, 3.1)
#: Prints and photos as they are met: radii of sheets in use, holes and marks, halos, blur, displays.
PRINT_KINDS: dict[str, WallOfCodes] = {
    "radii 2/3, blur 0.5 px": WallOfCodes(),
    "radii 2.25/3.48": WallOfCodes(prints=PrintChoice(radii=_FAR)),
    "radii 1.9/3.1": WallOfCodes(prints=PrintChoice(radii=_NEAR)),
    "holes of 0.3 radii": WallOfCodes(prints=PrintChoice(radii=_FAR, hole_radii=0.3)),
    "holes of 0.45 radii": WallOfCodes(prints=PrintChoice(hole_radii=0.45)),
    "crosses in the dots": WallOfCodes(prints=PrintChoice(radii=_NEAR, cross_radii=0.5)),
    "halo of sharpening": WallOfCodes(conditions=Conditions(blur_sigma_px=0.8, sharpening=Sharpening(1.5, 1.5))),
    "wide halo, holes": WallOfCodes(
        prints=PrintChoice(radii=_FAR, hole_radii=0.3),
        conditions=Conditions(blur_sigma_px=1.0, sharpening=Sharpening(1.0, 3.0)),
    ),
    "blur 1 px": WallOfCodes(conditions=Conditions(blur_sigma_px=1.0)),
    "blur 2 px": WallOfCodes(conditions=Conditions(blur_sigma_px=2.0)),
    "moire of a display": WallOfCodes(conditions=Conditions(blur_sigma_px=0.6, screen=ScreenPixels(1.13, 0.25))),
    "display, light on dark": WallOfCodes(
        prints=PrintChoice(radii=_NEAR, light_on_dark=True),
        conditions=Conditions(blur_sigma_px=0.6, screen=ScreenPixels(3.3, 0.3)),
    ),
    "shallow depth of field": WallOfCodes(
        diameters_px=(12.0, 150.0), conditions=Conditions(focus=Focus(0.5, 4.0, 60.0)), depth_share=0.12
    ),
}
