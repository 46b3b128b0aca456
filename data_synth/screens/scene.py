"""A bent screen with markers at its rims, photographed from several sides and by the measuring camera."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from data_synth.optics.markers import marker_print
from data_synth.optics.photo import View
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.prints import DotGridPrint
from data_synth.optics.sheets import Sheet, SheetShape
from data_synth.targets.presets import dome_views, look_at
from data_synth.targets.scene import Conditions, KnownLength, TargetScene
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray

#: Camera that goes around, and the one of the measurement.
SURVEY = PinholeCamera(1600, 1200, 1750.0, 1745.0, 802.0, 597.0, k1=-0.08, k2=0.05)
BENCH = PinholeCamera(1224, 1024, 1800.0, 1800.0, 610.0, 512.0)
BENCH_PHOTO = "photo_bench"
DICTIONARY = "DICT_4X4_50"
_MARKER_M = 0.06
#: Columns and rows of the field of dots, their distance and diameter [m].
_COUNT, _PITCH_M, _DOT_M = (30, 20), 0.04, 0.011
#: Standard deviation of the two scale bars [m].
_BAR_SIGMA_M = 5e-5
#: Height over the plane of its edges to which the screen is bent across and up, and by third order [1/m, 1/m2].
_BENDING, _RIPPLE = np.array([0.02, 0.004, -0.008]), np.array([0.006, 0.0])


@dataclass(frozen=True, slots=True)
class ScreenChoice(ShortRepr):
    """What is drawn.

    show: A field of dots, or a display with markers at its rims alone.
    seed: Of places, photos and noise.
    n_photos: Photos of the survey camera.
    flat: Whether the screen is a plane.
    """

    show: Literal["dots", "rims"] = "dots"
    seed: int = 0
    n_photos: int = 7
    flat: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ScreenScene(ShortRepr):
    """A scene, and what its screen is.

    scene: Markers, photos, scale bars; the last photo is that of the measuring camera.
    size_m: Width and height of the display or of the field of dots.
    dots_m (n, 2): Dots as drawn, x right and y up from the middle; none on a display [m].
    radii_m (n,): Their radii [m].
    shape: How the screen is bent; its frame is the world.
    markers: Name of each marker at the rims with its fractions u, v.
    """

    scene: TargetScene
    size_m: tuple[float, float]
    dots_m: FloatArray
    radii_m: FloatArray
    shape: SheetShape
    markers: dict[str, tuple[float, float]]


def screen_scene(choice: ScreenChoice) -> ScreenScene:
    """Return a bent screen of 1.16 m x 0.76 m with fourteen markers around it."""
    rng = np.random.default_rng([choice.seed, 16])
    shape = SheetShape() if choice.flat else SheetShape(bending_per_m=_BENDING, ripple_per_m2=_RIPPLE)
    field = DotGridPrint(*_COUNT, _PITCH_M, _DOT_M)
    size = ((_COUNT[0] - 1) * _PITCH_M, (_COUNT[1] - 1) * _PITCH_M)
    places = dict(_marker_places(size))
    sheets = [
        Sheet(str(number), marker_print(DICTIONARY, number, _MARKER_M), _on_surface(shape, x, y))
        for number, (x, y) in places.items()
    ]
    views = dome_views(SURVEY, 2.1, choice.n_photos, (18.0, 35.0, 45.0), rng)
    place = np.array([0.25, 0.35, 2.6]) + 0.05 * rng.standard_normal(3)
    views = (*views, View(BENCH_PHOTO, BENCH, look_at(place, 0.02 * rng.standard_normal(3))))
    scene = TargetScene("screen", tuple(sheets), views, Conditions(vignetting=0.05), dictionary=DICTIONARY)
    points = scene.points_m()
    lengths = []
    for a, b in (("0.0", "8.2"), ("4.1", "11.3")):
        length = float(np.linalg.norm(points[a] - points[b]))
        lengths.append(KnownLength(a, b, length, length + _BAR_SIGMA_M * float(rng.standard_normal()), _BAR_SIGMA_M))
    fractions = {str(number): (0.5 + x / size[0], 0.5 - y / size[1]) for number, (x, y) in places.items()}
    dots = field.centers_m if choice.show == "dots" else np.zeros((0, 2))
    radii = np.full(len(dots), 0.5 * _DOT_M)
    return ScreenScene(replace(scene, lengths=tuple(lengths)), size, dots, radii, shape, fractions)


def _marker_places(size_m: tuple[float, float]) -> Iterator[tuple[int, tuple[float, float]]]:
    """Yield the place of each marker around a screen, x right and y up from its middle [m]."""
    half_x, half_y = 0.5 * size_m[0] + 0.1, 0.5 * size_m[1] + 0.1
    across, up = np.linspace(-1.0, 1.0, 5), np.linspace(-1.0, 1.0, 4)[1:-1]
    around = [(x, -1.0) for x in across] + [(1.0, y) for y in up] + [(x, 1.0) for x in across[::-1]]
    around += [(-1.0, y) for y in up[::-1]]
    for number, (x, y) in enumerate(around):
        yield number, (half_x * float(x), half_y * float(y))


def _on_surface(shape: SheetShape, x_m: float, y_m: float) -> RigidTransform:
    """Return the place of a small flat sheet on the bent surface."""
    a, b, c = shape.bending_per_m
    d, e = shape.ripple_per_m2
    slope = np.array([2 * a * x_m + b * y_m + 3 * d * x_m**2, b * x_m + 2 * c * y_m + 3 * e * y_m**2])
    normal = np.array([-slope[0], -slope[1], 1.0])
    normal /= np.linalg.norm(normal)
    right = np.array([1.0, 0.0, slope[0]])
    right -= (right @ normal) * normal
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(normal, right), normal], axis=1)
    height = float(shape.height_m(np.array(x_m), np.array(y_m)))
    return RigidTransform(rotation, np.array([x_m, y_m, height]))
