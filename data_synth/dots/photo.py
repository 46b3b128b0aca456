"""One photo of a field of dots seen in a mirror with known slope errors."""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from data_synth.fringes.presets import FULL_CAMERA, ensemble_scene, preset_scene
from data_synth.fringes.scene import FringeScene
from data_synth.optics.mirror import SyntheticFacet
from deflectometry.setup import marked_radii
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import Float32Array, FloatArray

#: What tells the dots of a field apart.
ToldBy = Literal["light", "marked", "unmarked"]
#: Rays along each side of a pixel: a dot of 4 px is then crossed by 300 of them, each standing for its own area. Traced
#: are those through the corners of pixels; in between what rays meet is linear: photos of `small` and `ensemble` differ
#: by 3e-4 of the light or less, a fifteenth of the noise, from those with all rays traced.
_RAYS = 6
#: Light beside the mirror.
_BESIDE = 0.02
#: Rows of pixels that are looked at at once.
_ROWS = 24


@dataclass(frozen=True, slots=True, eq=False)
class DotScene(ShortRepr):
    """A field of dots before a mirror.

    scene: Camera, mirror and wall; its pattern is not shown.
    pitch_m, radius_m: Distance of the dots along the wall, and their size where they are all alike [m].
    count: Columns and rows.
    origin: Column and row, from the left and from the top, of dot (0, 0).
    told_by: What tells the dots apart: a point light beside dot (0, 0), dots of two sizes, or nothing.
    scatter_m: Standard deviation of the dots about a regular field [m].
    blur_sigma_px: Gaussian blur of the lens [px].
    hidden: Share of the field that is covered, from its left edge.
    """

    scene: FringeScene
    pitch_m: float = 0.062
    radius_m: float = 0.015
    count: tuple[int, int] = (75, 55)
    origin: tuple[int, int] = (36, 29)
    told_by: ToldBy = "light"
    scatter_m: float = 4e-4
    blur_sigma_px: float = 0.6
    hidden: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class DotTruth:
    """Where the dots are.

    column, row (n,): Their numbers, to the right and upwards.
    u, v (n,): Their display coordinates on the wall.
    places_m (n, 3): Their places in the wall's frame [m].
    radius_m (n,): Their radii [m].
    """

    column: FloatArray
    row: FloatArray
    u: FloatArray
    v: FloatArray
    places_m: FloatArray
    radius_m: FloatArray


def dot_scene(preset: str, told_by: ToldBy) -> DotScene:
    """Return a ready scene by the name of its fringe scene, with a camera that resolves dots.

    InputError: No such preset.
    """
    if preset == "ensemble":
        return _ensemble(told_by)
    scene = preset_scene(preset)
    scene = replace(scene, bench=replace(scene.bench, camera=FULL_CAMERA.scaled(0.5)))
    return DotScene(scene, told_by=told_by)


def _ensemble(told_by: ToldBy) -> DotScene:
    """Return six facets of 0.4 m and dots so near to each other that each shows 18 x 18 of them."""
    scene = ensemble_scene(columns=3, rows=2, camera=FULL_CAMERA)
    wall, pitch_m = scene.bench.wall, 0.045
    columns, rows = (int(one / pitch_m) - 1 for one in (wall.width_m, wall.height_m))
    # The middle of the wall may be seen between facets: the light is where one of them shows it.
    center = scene.bench.project_outline(scene.facets[-2]).mean(axis=0)
    seen = scene.bench.trace(scene.facets[-2], center[:1], center[1:])
    column = (seen.u.item() - 0.5) * wall.width_m / pitch_m + 0.5 * (columns - 1)
    row = (seen.v.item() - 0.5) * wall.height_m / pitch_m + 0.5 * (rows - 1)
    return DotScene(
        scene,
        pitch_m,
        radius_m=0.011,
        count=(columns, rows),
        origin=(round(column), round(row)),
        told_by=told_by,
        blur_sigma_px=0.8,
    )


def place_dots(dots: DotScene, rng: np.random.Generator) -> DotTruth:
    """Put the dots on the wall, each a little off its regular place."""
    wall = dots.scene.bench.wall
    columns, rows = dots.count
    column, row = (one.ravel().astype(np.float64) for one in np.meshgrid(np.arange(columns), np.arange(rows)))
    off = dots.scatter_m * rng.standard_normal((2, column.size))
    across = dots.pitch_m * (column - 0.5 * (columns - 1)) + off[0]
    down = dots.pitch_m * (row - 0.5 * (rows - 1)) + off[1]
    u, v = 0.5 + across / wall.width_m, 0.5 + down / wall.height_m
    radius_m = np.full(column.size, dots.radius_m)
    if dots.told_by == "marked":
        radius_m = marked_radii(columns, rows, dots.pitch_m).ravel()
    return DotTruth(column - dots.origin[0], dots.origin[1] - row, u, v, wall.points_m(u, v), radius_m)


def photo_light(dots: DotScene, truth: DotTruth) -> Float32Array:
    """Integrate the light on every pixel: rays over its area, then the blur of the lens.

    Returns (h, w): Light on the pixels, 1 for a fully reflected white wall.
    """
    camera = dots.scene.bench.camera
    image = np.full((camera.height_px, camera.width_px), _BESIDE, dtype=np.float32)
    for facet in dots.scene.facets:
        at, seen = _facet_light(dots, truth, facet)
        # Gaps are wider than the blur: what is beside a facet is as dark as the rest.
        image[at] = np.maximum(image[at], seen)
    return image


def _facet_light(dots: DotScene, truth: DotTruth, facet: SyntheticFacet) -> tuple[tuple[slice, slice], Float32Array]:
    """Return the part of the photo that one facet is in: its rows and columns, and the light on them."""
    scene, camera = dots.scene, dots.scene.bench.camera
    outline = scene.bench.project_outline(facet)
    low = np.maximum(np.floor(outline.min(axis=0)) - 4, 0).astype(int)
    high = np.minimum(np.ceil(outline.max(axis=0)) + 5, (camera.width_px, camera.height_px)).astype(int)
    height, width = high[1] - low[1], high[0] - low[0]
    seen = scene.bench.trace(facet, *np.meshgrid(*(np.arange(a, b + 1) - 0.5 for a, b in zip(low, high, strict=True))))
    at_corners = (seen.u, seen.v, seen.points_m[..., 0], seen.points_m[..., 1])
    parts = []
    for top in range(0, height, _ROWS):
        u, v, x, y = (_between_corners(one[top : top + _ROWS + 1]) for one in at_corners)
        parts.append(np.where(facet.contains(x, y), _wall_light(dots, truth, u, v), _BESIDE).astype(np.float32))
    window = cv2.GaussianBlur(np.concatenate(parts), (0, 0), dots.blur_sigma_px * _RAYS)
    at = slice(low[1], high[1]), slice(low[0], high[0])
    return at, np.asarray(window.reshape(height, _RAYS, width, _RAYS).mean(axis=(1, 3)), dtype=np.float32)


def _between_corners(corner: FloatArray) -> FloatArray:
    """Return what all rays of pixels meet, from what rays through the corners of the pixels meet."""
    share = (np.arange(_RAYS) + 0.5) / _RAYS
    rows = corner[:-1, None] + share[:, None] * np.diff(corner, axis=0)[:, None]
    rows = rows.reshape(-1, corner.shape[1], 1)
    return np.asarray((rows[:, :-1] + share * np.diff(rows, axis=1)).reshape(len(rows), -1))


def _wall_light(dots: DotScene, truth: DotTruth, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return the light of the wall at display coordinates: ground, dots, and the light beside dot (0, 0)."""
    wall = dots.scene.bench.wall
    columns, rows = dots.count
    with np.errstate(invalid="ignore"):
        across, down = (u - 0.5) * wall.width_m, (v - 0.5) * wall.height_m
        column = np.rint(across / dots.pitch_m + 0.5 * (columns - 1))
        row = np.rint(down / dots.pitch_m + 0.5 * (rows - 1))
        there = (column >= dots.hidden * columns) & (column < columns) & (row >= 0) & (row < rows)
    number = np.where(there, row * columns + column, 0).astype(np.intp)
    near_across, near_down = (truth.u - 0.5) * wall.width_m, (truth.v - 0.5) * wall.height_m
    apart = np.hypot(across - near_across[number], down - near_down[number])
    # Brighter on one side, as a wall under one lamp is.
    ground = 0.45 + 0.1 * np.nan_to_num(u)
    # Each ray stands for its own small area: how much of that a dot covers, its edge taken as straight.
    step_m = float(np.nanmedian(np.hypot(np.diff(across, axis=1), np.diff(down, axis=1))))
    cover = np.clip((truth.radius_m[number] - apart) / step_m + 0.5, 0.0, 1.0)
    light = np.where(there, ground * (1.0 - 0.7 * cover), ground)
    if dots.told_by == "light":
        first = dots.origin[1] * columns + dots.origin[0]
        beside = np.hypot(
            across - near_across[first] - 0.3 * dots.pitch_m, down - near_down[first] + 0.2 * dots.pitch_m
        )
        light = np.where(beside < 0.008, 3.0, light)
    return np.asarray(np.where(np.isfinite(u), light, 0.0))
