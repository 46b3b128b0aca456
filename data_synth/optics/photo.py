"""Photographs of printed sheets, integrated over each pixel's area and the lens blur."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, sqrt

import cv2
import numpy as np

from data_synth.optics.coverage import Footprint
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.prints import paper_share
from data_synth.optics.sheets import Sheet
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import Float32Array, FloatArray

#: Side of a tile [px]: its finest cells (16 per pixel) then need 17 MB an array.
_TILE_PX = 128
#: Directions of the lines of sight, and where they meet a sheet, are interpolated between this many exact ones a side:
#: over a tile that spans 0.2 rad of a lens with k1 = -0.2 the polynomial of degree 9 is wrong by less than 1e-9 rad.
_NODES = 10
#: Edges are straight within a cell; the sagitta of the sharpest one may be so much of a pixel.
LARGEST_SAGITTA_PX = 5e-4
_MOST_CELLS = 16
#: A Gaussian is represented by its samples within 1e-4 from this many cells per standard deviation on.
_CELLS_PER_SIGMA = 1.2
_BLUR_REACH_SIGMA = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera in its place.

    name: Name of the photo.
    cam_from_world: World frame to camera frame.
    """

    name: str
    camera: PinholeCamera
    cam_from_world: RigidTransform

    def project(self, points_world_m: FloatArray) -> FloatArray:
        """Return image points, shape (..., 2); NaN behind the camera [px]."""
        return self.camera.project(self.cam_from_world.apply(points_world_m))

    def tilt_rad(self, world_from_sheet: RigidTransform) -> float:
        """Return the angle between a sheet's normal and the direction from it to the camera [rad]."""
        center = self.cam_from_world.apply(world_from_sheet.translation_m)
        normal = self.cam_from_world.rotation @ world_from_sheet.rotation[:, 2]
        return float(np.arccos(np.clip(-normal @ center / np.linalg.norm(center), -1, 1)))


@dataclass(frozen=True, slots=True)
class _Tile:
    left: int
    top: int
    width: int
    height: int
    cells: int
    border: int

    def positions_px(self) -> tuple[FloatArray, FloatArray]:
        """Cell centres along x and along y, the border included [px]."""
        step = 1 / self.cells
        wide, high = ((side + 2 * self.border) * self.cells for side in (self.width, self.height))
        x = self.left - self.border - 0.5 + (np.arange(wide) + 0.5) * step
        y = self.top - self.border - 0.5 + (np.arange(high) + 0.5) * step
        return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Focus:
    """What a lens blurs, as a Gaussian.

    blur_sigma_px: Blur of what is in focus [px].
    distance_m: Depth that is in focus [m].
    defocus_px_m: Standard deviation of the disc of confusion, per difference of 1 / depth; 0: all is in focus [px m].
    """

    blur_sigma_px: float = 0.0
    distance_m: float = 1.0
    defocus_px_m: float = 0.0

    def sigma_px(self, depth_m: float) -> float:
        """Return the blur of what lies at a depth [px]."""
        return float(np.hypot(self.blur_sigma_px, self.defocus_px_m * (1 / depth_m - 1 / self.distance_m)))


def draw_sheets(
    light: Float32Array,
    view: View,
    sheets: Sequence[Sheet],
    blur: float | Focus = 0.0,
    sagitta_px: float = LARGEST_SAGITTA_PX,
) -> None:
    """Draw printed sheets over what is already in the image.

    light (height_px, width_px): Light on the pixels, changed in place; what it holds lies behind the sheets.
    view: Camera and pose.
    sheets: The sheets; nearer ones hide farther ones.
    blur: Gaussian blur of the lens, one for all sheets or by their depth [px].
    sagitta_px: So much of a pixel may the sharpest curve be off a straight line within a cell.
    """
    focus = blur if isinstance(blur, Focus) else Focus(blur)
    depth = [view.cam_from_world.apply(sheet.world_from_sheet.translation_m)[2] for sheet in sheets]
    for index in np.argsort(depth)[::-1]:
        sheet = sheets[index]
        blur_sigma_px = focus.sigma_px(float(depth[index])) if depth[index] > 0 else 0.0
        for tile in _tiles(view, sheet, blur_sigma_px, sagitta_px):
            share, bright = _render(view, sheet, tile, blur_sigma_px)
            part = light[tile.top : tile.top + tile.height, tile.left : tile.left + tile.width]
            part *= 1 - share
            part += bright


def _tiles(view: View, sheet: Sheet, blur_sigma_px: float, sagitta_px: float) -> Iterator[_Tile]:
    """Cut the part of the image where the sheet may be seen into tiles."""
    if np.any(view.cam_from_world.apply(sheet.outline_m)[:, 2] <= 0) or view.tilt_rad(sheet.world_from_sheet) > 1.57:
        return
    outline = view.project(sheet.outline_m)
    border = ceil(_BLUR_REACH_SIGMA * blur_sigma_px)
    size = np.array([view.camera.width_px, view.camera.height_px])
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int) - border - 1, 0)
    high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + border + 2, size)
    cells = _cells_per_pixel(view, sheet, blur_sigma_px, sagitta_px)
    for top in range(low[1], high[1], _TILE_PX):
        for left in range(low[0], high[0], _TILE_PX):
            width, height = min(_TILE_PX, high[0] - left), min(_TILE_PX, high[1] - top)
            yield _Tile(left, top, width, height, cells, border)


def _cells_per_pixel(view: View, sheet: Sheet, blur_sigma_px: float, sagitta_px: float) -> int:
    center = view.cam_from_world.apply(sheet.world_from_sheet.translation_m)
    radius_px = sheet.figure.bends_m * view.camera.focal_x_px / center[2]
    # Foreshortening sharpens the curve: the radius of curvature at the ends of an ellipse is b^2 / a.
    radius_px *= max(np.cos(view.tilt_rad(sheet.world_from_sheet)), 0.2) ** 2
    needed = sqrt(1 / (8 * sagitta_px * max(radius_px, 0.5)))
    if blur_sigma_px:
        needed = max(needed, _CELLS_PER_SIGMA / blur_sigma_px)
    return min(max(ceil(needed), 4), _MOST_CELLS)


def _render(view: View, sheet: Sheet, tile: _Tile, blur_sigma_px: float) -> tuple[Float32Array, Float32Array]:
    """Return, for the tile's pixels, the share that the sheet hides and the light that comes from it."""
    sheet_from_cam = (view.cam_from_world @ sheet.world_from_sheet).inverse()
    x, y = _met(view.camera, sheet, sheet_from_cam, tile)
    cell = _footprint(x, y)
    ink = sheet.figure.ink(x, y, cell)
    paper = ink if sheet.transparent else paper_share(sheet.figure, x, y, cell)
    bright = ink * np.float32(sheet.ink)
    if not sheet.transparent:
        bright += (paper - ink) * np.float32(sheet.paper)
    share, light = (_gather(image, tile, blur_sigma_px) for image in (paper, bright))
    return share, light


def _met(
    camera: PinholeCamera, sheet: Sheet, sheet_from_cam: RigidTransform, tile: _Tile
) -> tuple[Float32Array, Float32Array]:
    """Return which point of the drawing the line of sight of each cell meets.

    Exact at nodes and a polynomial in between; where lines pass far beside the sheet or leave its front, which no
    polynomial follows, the directions alone are interpolated.
    """
    x_px, y_px = tile.positions_px()
    node = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    along_x, node_x = _interpolation(x_px, node)
    along_y, node_y = _interpolation(y_px, node)
    rays = camera.rays(*np.meshgrid(node_x, node_y))
    directions = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    at_nodes = sheet.hit(sheet_from_cam, *directions)
    if sheet.is_near(*at_nodes):
        x, y = (along_y @ one @ along_x.T for one in at_nodes)
    else:
        x, y = sheet.hit(sheet_from_cam, *(along_y @ one @ along_x.T for one in directions))
    return x.astype(np.float32), y.astype(np.float32)


def _interpolation(positions: FloatArray, node: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the matrix that interpolates from Chebyshev nodes to positions, and where the nodes are."""
    middle, half = (positions[0] + positions[-1]) / 2, max((positions[-1] - positions[0]) / 2, 0.5)
    chebyshev = np.polynomial.chebyshev.chebvander
    matrix = chebyshev((positions - middle) / half, node.size - 1) @ np.linalg.inv(chebyshev(node, node.size - 1))
    return matrix, middle + half * node


def _footprint(x: Float32Array, y: Float32Array) -> Footprint:
    """Return the mean footprint of the cells of a tile that meet the sheet."""
    row, column = x.shape[0] // 2, x.shape[1] // 2
    steps = [
        [
            float(part[row, column + 1] - part[row, column - 1]) / 2,
            float(part[row + 1, column] - part[row - 1, column]) / 2,
        ]
        for part in (x.astype(np.float64), y.astype(np.float64))
    ]
    return Footprint(np.array(steps))


def _gather(image: Float32Array, tile: _Tile, blur_sigma_px: float) -> Float32Array:
    """Blur, leave the border out and average the cells of each pixel."""
    if blur_sigma_px:
        sigma = blur_sigma_px * tile.cells
        taps = 2 * ceil(_BLUR_REACH_SIGMA * sigma) + 1
        image = cv2.GaussianBlur(image, (taps, taps), sigma, borderType=cv2.BORDER_REPLICATE).astype(np.float32)
    edge = tile.border * tile.cells
    inner = image[edge : edge + tile.height * tile.cells, edge : edge + tile.width * tile.cells]
    shape = (tile.height, tile.cells, tile.width, tile.cells)
    return np.asarray(inner.reshape(shape).mean(axis=(1, 3), dtype=np.float32))
