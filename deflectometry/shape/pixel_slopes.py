"""Slopes of every pixel of a facet, with the random share of their uncertainty."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.smooth_shape import FittedSurface, slope_sensitivity, slopes_at
from deflectometry.sources.sample_grid import PixelGrid, SampleGrid
from deflectometry.sources.screen_map import ScreenMap
from heliogauge.flags import REJECTED, SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import AnyFloatArray, BoolArray, FlagArray, Float32Array, FloatArray, IntArray

#: Pixels worked on at a time: a dozen float64 buffers of this size stay in a 2 MiB second-level cache.
BLOCK_PIXELS = 16384
#: Pixels kept around a facet: an edge blurred over 8 pixels is flagged as edge, not as unseen.
BORDER_PIXELS = 4
#: Pixels whose median spacing is taken.
_SPACED_PIXELS = 50_000


@dataclass(frozen=True, slots=True, eq=False)
class SlopeImage:
    """Slopes of one facet on the pixels of its bounding box.

    row, column: Place of the first sample in the grid of all samples.
    x_m, y_m (h, w): Where the pixel's line of sight meets the surface, facet frame [m]; NaN outside the facet.
    slope_x, slope_y (h, w): Measured dz/dx and dz/dy; NaN where rejected.
    sigma_x, sigma_y (h, w): Random standard deviation of the slopes from the noise of the frames [rad].
    flags (h, w): Bits of `heliogauge.flags.SampleFlag`.
    grid: Where the samples lie in the image.
    """

    row: int
    column: int
    x_m: FloatArray
    y_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    sigma_x: Float32Array
    sigma_y: Float32Array
    flags: FlagArray
    grid: SampleGrid = field(default_factory=PixelGrid)

    @property
    def footprint_m(self) -> float:
        """Mean spacing of the pixels on the mirror, of large images in some of their rows [m]."""
        step = max(1, self.x_m.size // _SPACED_PIXELS)
        low, high = slice(0, self.x_m.shape[0] - 1, step), slice(1, None, step)
        across = np.hypot(np.diff(self.x_m[::step], axis=1), np.diff(self.y_m[::step], axis=1))
        down = np.hypot(self.x_m[high] - self.x_m[low], self.y_m[high] - self.y_m[low])
        return float(np.sqrt(np.nanmedian(across) * np.nanmedian(down)))


def bounding_box(region: BoolArray) -> tuple[slice, slice]:
    """Return the rows and columns that hold all true pixels, with the edge pixels around them that have flags."""
    rows, columns = np.flatnonzero(region.any(axis=1)), np.flatnonzero(region.any(axis=0))
    return (
        slice(max(int(rows[0]) - BORDER_PIXELS, 0), min(int(rows[-1]) + 1 + BORDER_PIXELS, region.shape[0])),
        slice(max(int(columns[0]) - BORDER_PIXELS, 0), min(int(columns[-1]) + 1 + BORDER_PIXELS, region.shape[1])),
    )


def pixel_blocks(region: BoolArray) -> Iterator[IntArray]:
    """Yield the flat indices of true pixels, some rows at a time."""
    indices = np.flatnonzero(region)
    for start in range(0, indices.size, BLOCK_PIXELS):
        yield indices[start : start + BLOCK_PIXELS]


def screen_directions(setup: Setup) -> FloatArray:
    """Return how a screen point moves with u and with v, in the camera frame, shape (2, 3) [m]."""
    around = np.array([0.25, 0.75, 0.5, 0.5]), np.array([0.5, 0.5, 0.25, 0.75])
    left, right, top, bottom = setup.screen.points_m(*around)
    return setup.cam_from_screen.rotate(np.stack([right - left, bottom - top]) * 2.0)


def measure_slopes(
    setup: Setup, screen_map: ScreenMap, region: BoolArray, cam_from_facet: RigidTransform, surface: FittedSurface
) -> SlopeImage:
    """Compute the slopes of all pixels of a facet.

    Shapes: region (h, w).
    setup: Camera and screen.
    screen_map: Screen point of each pixel with its sigma and flags.
    surface: Shape of the facet, from `deflectometry.shape.smooth_shape.solve_shape`.
    Returns: Slopes with the random share of their sigma; the share common to all pixels is in `CommonModes`.
    """
    rows, columns = bounding_box(region)
    shape = (rows.stop - rows.start, columns.stop - columns.start)
    x_m, y_m, slope_x, slope_y = (np.full(shape, np.nan) for _ in range(4))
    sigma_x, sigma_y = (np.full(shape, np.nan, dtype=np.float32) for _ in range(2))
    flags = screen_map.flags[rows, columns].copy()
    flags[~region[rows, columns] & (flags == 0)] = np.uint32(SampleFlag.OUTSIDE_MIRROR)
    # Flat and contiguous: an index through ``.flat`` takes three times as long.
    u, v, sigma_u, sigma_v = (
        image[rows, columns].reshape(-1)
        for image in (screen_map.u, screen_map.v, screen_map.sigma_u, screen_map.sigma_v)
    )
    results = [image.reshape(-1) for image in (x_m, y_m, slope_x, slope_y, sigma_x, sigma_y)]
    facet_from_cam = cam_from_facet.inverse()
    camera = facet_from_cam.translation_m
    facet_from_screen = facet_from_cam @ setup.cam_from_screen
    along_u, along_v = facet_from_cam.rotate(screen_directions(setup))
    for index in pixel_blocks(region[rows, columns]):
        row, column = np.divmod(index, shape[1])
        pixels = screen_map.grid.pixels_px(row + rows.start, column + columns.start)
        points = surface.intersect(camera, facet_from_cam.rotation @ setup.camera.cast_rays(pixels).T)
        local = setup.screen.points_m(u[index], v[index])
        screen = facet_from_screen.rotation @ local.T + facet_from_screen.translation_m[:, None]
        slopes = slopes_at(points, camera, screen)
        by_u = slope_sensitivity(points, camera, screen, along_u) * sigma_u[index]
        by_v = slope_sensitivity(points, camera, screen, along_v) * sigma_v[index]
        sigmas = np.sqrt(by_u * by_u + by_v * by_v)
        for image, values in zip(results, (points[0], points[1], *slopes, *sigmas), strict=True):
            image[index] = values
    _reject(flags, (slope_x, slope_y, sigma_x, sigma_y), region[rows, columns], x_m)
    return SlopeImage(rows.start, columns.start, x_m, y_m, slope_x, slope_y, sigma_x, sigma_y, flags, screen_map.grid)


def _reject(flags: FlagArray, values: Sequence[AnyFloatArray], region: BoolArray, x_m: FloatArray) -> None:
    """Flag pixels whose ray misses, and blank slopes and sigmas where the flags reject; the slope in x comes first."""
    flags[region & np.isnan(x_m)] |= np.uint32(SampleFlag.NO_INTERSECTION)
    missing = region & np.isnan(values[0]) & ((flags & np.uint32(REJECTED)) == 0)
    flags[missing] |= np.uint32(SampleFlag.OFF_SCREEN)
    rejected = (flags & np.uint32(REJECTED)) != 0
    for image in values:
        image[rejected] = np.nan
