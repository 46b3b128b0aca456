"""Photographs of a trough, integrated over each pixel's area: few rays where it is even, many where edges cross."""

from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import cv2
import numpy as np

from data_synth.optics.photo import LARGEST_SAGITTA_PX, draw_sheets
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.sensor import UnsignedArray
from data_synth.optics.sheets import Sheet
from data_synth.targets.scene import STEEPEST_RAD, sheet_points
from data_synth.troughs.field import FieldTracer
from data_synth.troughs.mirror import RayArray, Rays
from data_synth.troughs.scene import TroughScene, TroughView
from data_synth.troughs.trace import Labels, Seen, Tracer
from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray

#: Rays of one block: its arrays stay in a second-level cache of 2 MiB.
_BLOCK_RAYS = 16384
#: Light that differs more than this between the corners of a pixel is looked at closely; below, the mean of straight
#: lines between the corners is right within some hundredths of that.
_STEEP = 0.06
#: Rays for each cell by cells a side: Fibonacci lattices (n, step), shifted at random for each cell. Against the
#: closed form of a half plane a pixel is wrong by 0.010 RMS or less, without bias and independently of the next pixel.
_LATTICES = {1: (89, 55), 2: (21, 13), 3: (13, 8), 4: (8, 5)}
#: A Gaussian is represented by its samples within 1e-4 from this many cells per standard deviation on.
_CELLS_PER_SIGMA = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class PhotoPoints:
    """Where targets appear in one photo: projections of their middles, not the middles of their images.

    names: The points in the image that face the camera and are not hidden.
    pixels_px (n, 2): Image points (x, y) [px].
    """

    names: tuple[str, ...]
    pixels_px: FloatArray


class _Cells(NamedTuple):
    """Cells of pixels: row and column of the pixel, and how far down and right in it."""

    row: IntArray
    down: IntArray
    column: IntArray
    right: IntArray


class Photographer:
    """Takes the photos of a scene; may be shared by threads.

    dtype: Float type of the geometry; float64 is the reference in tests.
    """

    #: How finely targets are drawn, as `data_synth.optics.photo.draw_sheets`.
    sagitta_px = LARGEST_SAGITTA_PX

    def __init__(self, scene: TroughScene, dtype: type[np.float32] | type[np.float64] = np.float32) -> None:
        self._scene = scene
        self._dtype = dtype
        blur = scene.optics.blur_sigma_px
        self._cells = min(ceil(_CELLS_PER_SIGMA / blur), max(_LATTICES)) if blur else 1
        n, step = _LATTICES[self._cells]
        lattice = np.stack([(np.arange(n) + 0.5) / n, np.arange(n) * step / n % 1.0])
        self._lattice: RayArray = lattice.astype(dtype)
        self._corners = _corner_directions(scene.camera, dtype)
        tracer = FieldTracer(scene.troughs, dtype) if scene.troughs else Tracer(scene.world, dtype)
        self._tracers = {
            view.orientation_deg: tracer.turned(scene.surroundings_of(view))
            for view in {view.orientation_deg: view for view in scene.views}.values()
        }

    def take(self, view: TroughView, rng: np.random.Generator) -> UnsignedArray:
        """Take one photo.

        rng: Noise, and the shifts of the ray lattices.
        Returns (height_px, width_px): The photo as a file holds it [DN].
        """
        light = self.light(view, rng)
        optics = self._scene.optics
        for sheet in self._scene.sheets:
            if self._is_seen(view, sheet):
                row = float(view.project(sheet.world_from_sheet.translation_m[None])[0, 1])
                draw_sheets(light, view.at_row(row), (sheet,), optics.blur_sigma_px, self.sagitta_px)
        _shade(light, optics.vignetting)
        return optics.sensor.expose(light, rng, view.exposure)

    def light(self, view: TroughView, rng: np.random.Generator) -> Float32Array:
        """Return the light of a trough without targets, noise and exposure, shape (height_px, width_px).

        Shapes: result (height_px, width_px).
        """
        tracer, rows = self._tracers[view.orientation_deg], _RowPoses(view, self._dtype)
        corner, label = self._look_at_corners(tracer, rows)
        row, column = np.nonzero(_needs_more(corner, label))
        fine = _between_corners(corner, self._cells)
        cells = fine.reshape(view.camera.height_px, self._cells, view.camera.width_px, self._cells)
        zero = np.zeros_like(row)
        where = _Cells(row, zero, column, zero)
        if self._cells > 1:
            where = self._crossed_cells(tracer, rows, cells, (row, column))
        step = _BLOCK_RAYS // self._lattice.shape[1]
        for start in range(0, where[0].size, step):
            part = _Cells(*(axis[start : start + step] for axis in where))
            cells[part] = self._look_into(tracer, rows, part, rng)
        return _gather(fine, self._cells, self._scene.optics.blur_sigma_px)

    def points(self, view: TroughView) -> PhotoPoints:
        """Project the targets exactly, without drawing anything."""
        size = np.array([view.camera.width_px, view.camera.height_px])
        names: list[str] = []
        places: list[FloatArray] = []
        for sheet in self._scene.sheets:
            if not self._is_seen(view, sheet):
                continue
            points = sheet_points(sheet)
            pixels = view.project(np.array(list(points.values())))
            inside = np.all((pixels > -0.5) & (pixels < size - 0.5), axis=1)
            names += [name for name, within in zip(points, inside, strict=True) if within]
            places += list(pixels[inside])
        return PhotoPoints(tuple(names), np.array(places, dtype=np.float64).reshape(-1, 2))

    def _is_seen(self, view: TroughView, sheet: Sheet) -> bool:
        pose = view.at_row((view.camera.height_px - 1) / 2)
        middle = pose.cam_from_world.apply(sheet.world_from_sheet.translation_m)
        if middle[2] <= 0 or pose.tilt_rad(sheet.world_from_sheet) > STEEPEST_RAD:
            return False
        tracer = self._tracers[view.orientation_deg]
        return not bool(tracer.hides(view.position_m, sheet.outline_m).any())

    def _look_at_corners(self, tracer: Tracer | FieldTracer, rows: "_RowPoses") -> tuple[Float32Array, Labels]:
        x, y = self._corners
        light, label = np.empty(x.shape, dtype=np.float32), np.empty(x.shape, dtype=np.int32)
        step = max(_BLOCK_RAYS // x.shape[1], 1)
        for start in range(0, x.shape[0], step):
            part = slice(start, min(start + step, x.shape[0]))
            index = np.repeat(np.arange(part.start, part.stop), x.shape[1])
            seen: Seen = tracer.look(rows.rays(x[part].ravel(), y[part].ravel(), index))
            light[part] = seen.light.reshape(-1, x.shape[1])
            label[part] = seen.label.reshape(-1, x.shape[1])
        return light, label

    def _crossed_cells(
        self, tracer: Tracer | FieldTracer, rows: "_RowPoses", cells: Float32Array, pixels: tuple[IntArray, IntArray]
    ) -> "_Cells":
        """Look at the corners of all cells of some pixels, fill in even cells and return where the others are."""
        n = self._cells + 1
        share: RayArray = np.linspace(0, 1, n, dtype=self._dtype)
        found: list[tuple[IntArray, ...]] = []
        step = _BLOCK_RAYS // n**2
        for start in range(0, pixels[0].size, step):
            row, column = (axis[start : start + step] for axis in pixels)
            x, y = (_within(part, row, column, share[None, None, :], share[None, :, None]) for part in self._corners)
            seen = tracer.look(rows.rays(x.ravel(), y.ravel(), np.repeat(row, n * n)))
            light, label = seen.light.reshape(-1, n, n), seen.label.reshape(-1, n, n)
            mean = (light[:, :-1, :-1] + light[:, :-1, 1:] + light[:, 1:, :-1] + light[:, 1:, 1:]) / 4
            cells[row, :, column, :] = mean
            pixel, down, right = np.nonzero(_needs_more(light, label))
            found.append((row[pixel], down, column[pixel], right))
        if not found:
            none = np.zeros(0, dtype=np.intp)
            return _Cells(none, none, none, none)
        return _Cells(*(np.concatenate(axes) for axes in zip(*found, strict=True)))

    def _look_into(
        self, tracer: Tracer | FieldTracer, rows: "_RowPoses", where: "_Cells", rng: np.random.Generator
    ) -> Float32Array:
        """Return the mean light of cells, by row of the pixel, row within it, column, column within it, shape (n,)."""
        row, down, column, right = where
        shift = rng.random((2, row.size, 1), dtype=np.float32).astype(self._dtype)
        share = [axis + shift[k] for k, axis in enumerate(self._lattice)]
        for k, cell in enumerate((right, down)):
            share[k] -= share[k] >= 1
            share[k] += cell[:, None].astype(self._dtype)
            share[k] *= self._dtype(1 / self._cells)
        x, y = (_within(part, row, column, *share) for part in self._corners)
        seen = tracer.look(rows.rays(x.ravel(), y.ravel(), np.repeat(row, self._lattice.shape[1])))
        return np.asarray(seen.light.reshape(row.size, -1).mean(axis=-1))


class _RowPoses:
    """Where the camera is and how it is turned while each row of corners is read."""

    def __init__(self, view: TroughView, dtype: type[np.float32] | type[np.float64]) -> None:
        height = view.camera.height_px
        poses = [view.pose_at((height - 1) / 2)]
        self._still = view.shutter is None
        if not self._still:
            poses = [view.pose_at(corner - 0.5) for corner in range(height + 1)]
        self._rotation: RayArray = np.array([pose.rotation for pose in poses]).astype(dtype)
        self._position: RayArray = np.array([pose.inverse().translation_m for pose in poses]).astype(dtype)

    def rays(self, x: RayArray, y: RayArray, row: IntArray) -> Rays:
        """Return rays in the trough's frame for directions (x, y, 1) of the camera."""
        if self._still:
            r, position = self._rotation[0], self._position[0]
            parts = [r[0, k] * x + r[1, k] * y + r[2, k] for k in range(3)]
            return Rays(*(np.full_like(x, place) for place in position), *parts)
        turned = self._rotation[row]
        parts = [turned[:, 0, k] * x + turned[:, 1, k] * y + turned[:, 2, k] for k in range(3)]
        return Rays(*(np.ascontiguousarray(place) for place in self._position[row].T), *parts)


def _corner_directions(camera: PinholeCamera, dtype: type[np.float32] | type[np.float64]) -> tuple[RayArray, RayArray]:
    """Return x/z and y/z of the lines of sight through all corners of pixels, shape (height + 1, width + 1)."""
    columns = np.arange(camera.width_px + 1, dtype=np.float64) - 0.5
    x, y = (np.empty((camera.height_px + 1, camera.width_px + 1), dtype=dtype) for _ in range(2))
    for row in range(camera.height_px + 1):
        rays = camera.rays(columns, np.full_like(columns, row - 0.5))
        x[row], y[row] = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
    return x, y


def _needs_more(corner: Float32Array, label: Labels) -> BoolArray:
    """Return the pixels or cells that an edge crosses, that are marked, or over which the light changes much."""
    near, far = slice(None, -1), slice(1, None)
    first = label[..., near, near]
    more: BoolArray = first < 0
    low, high = corner[..., near, near].copy(), corner[..., near, near].copy()
    for down, right in ((near, far), (far, near), (far, far)):
        other, light = label[..., down, right], corner[..., down, right]
        more |= (other != first) | (other < 0)
        np.minimum(low, light, out=low)
        np.maximum(high, light, out=high)
    return np.asarray(more | (high - low > _STEEP))


def _between_corners(corner: Float32Array, cells: int) -> Float32Array:
    """Return the light at the middle of each cell by straight lines between corners."""
    height, width = corner.shape[0] - 1, corner.shape[1] - 1
    fine = np.empty((height, cells, width, cells), dtype=np.float32)
    for down in range(cells):
        share = np.float32((down + 0.5) / cells)
        line = corner[:-1] * (1 - share) + corner[1:] * share
        for right in range(cells):
            across = np.float32((right + 0.5) / cells)
            fine[:, down, :, right] = line[:, :-1] * (1 - across) + line[:, 1:] * across
    return fine.reshape(height * cells, width * cells)


def _within(corners: RayArray, row: IntArray, column: IntArray, across: RayArray, down: RayArray) -> RayArray:
    """Return directions at shares of pixels: over one pixel the lens is straight within 1e-9 rad."""
    extra = (slice(None), *(None for _ in range(np.broadcast(across, down).ndim - 1)))
    a, b, c, d = (corners[row + below, column + right][extra] for below in (0, 1) for right in (0, 1))
    upper, lower = a + (b - a) * across, c + (d - c) * across
    return np.asarray(upper + (lower - upper) * down)


def _gather(fine: Float32Array, cells: int, blur_sigma_px: float) -> Float32Array:
    """Blur and average the cells of each pixel."""
    if blur_sigma_px:
        sigma = blur_sigma_px * cells
        taps = 2 * ceil(4 * sigma) + 1
        fine = cv2.GaussianBlur(fine, (taps, taps), sigma, borderType=cv2.BORDER_REPLICATE).astype(np.float32)
    if cells == 1:
        return fine
    total = fine[::cells, ::cells].copy()
    for down in range(cells):
        for right in range(cells):
            if down or right:
                total += fine[down::cells, right::cells]
    return np.asarray(total / np.float32(cells**2))


def _shade(light: Float32Array, vignetting: float) -> None:
    height, width = light.shape
    x = np.linspace(-1, 1, width, dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)
    loss = np.float32(vignetting / 2)
    light *= np.float32(1) - loss * (x * x)[None, :] - loss * (y * y)[:, None]
