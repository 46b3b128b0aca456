"""Which pixels see which node of a facet: light, noise and place of each node in each camera."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deflectometry.field.placement import OrientedCamera
from deflectometry.gazing.node_slopes import Brightness
from deflectometry.gazing.photometry import Light
from deflectometry.shape.gridding import grid_axis
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, FloatArray

#: Two brightnesses leave two pairs of slopes, mirror images about the line through both cameras: a third decides.
FEWEST_CAMERAS = 3
#: Pixels of a node across: its light is the mean over so many squared.
PIXELS_ACROSS = 4.0
#: A node of fewer pixels has no light of its own.
_FEWEST_PIXELS = 4
#: Pixels nearer to the rim than this share of a pixel's diagonal, and the lens's blur, mix mirror and surroundings.
_RIM_PX = 1.5
#: Places of a node that stand for its pixels: two each way integrate a cubic exactly (Gauss).
_GAUSS = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]]) / np.sqrt(12.0)


@dataclass(frozen=True, slots=True, eq=False)
class FacetPixels:
    """What one camera saw of the nodes of one facet.

    count, saturated (ny, nx): Pixels of each node, and how many of them were saturated.
    light, scatter (ny, nx): Mean light of a node, and the variance of one pixel's light in it [DN/ms].
    x_m, y_m (ny, nx): Mean place of its pixels [m].
    """

    count: FloatArray
    saturated: FloatArray
    light: FloatArray
    scatter: FloatArray
    x_m: FloatArray
    y_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FacetGrid:
    """The nodes of one facet.

    x_m, y_m: Columns and rows in the facet's frame [m].
    aperture (ny, nx): Nodes on the mirror.
    """

    facet: Facet
    x_m: FloatArray
    y_m: FloatArray
    aperture: BoolArray


def footprint_m(camera: OrientedCamera) -> float:
    """Return the size of a pixel on the mirror, seen from the front [m]."""
    return float(np.linalg.norm(camera.eye_m)) / camera.camera.focal_x_px


def grid_of(facet: Facet, step_m: float) -> FacetGrid:
    """Return the nodes of a facet at multiples of a step."""
    low, high = facet.outline_m.min(axis=0), facet.outline_m.max(axis=0)
    x_m, y_m = grid_axis(low[0], high[0], step_m), grid_axis(low[1], high[1], step_m)
    return FacetGrid(facet, x_m, y_m, facet.contains(x_m[None], y_m[:, None]))


def collect_pixels(camera: OrientedCamera, light: Light, grid: FacetGrid) -> FacetPixels:
    """Share the pixels of an image among the nodes of a facet.

    A pixel belongs to the node in whose cell its line of sight meets the design; one that sees the rim to none.
    """
    facet, shape = grid.facet, grid.aperture.shape
    cam_from_facet = camera.cam_from_mirror @ facet.ensemble_from_facet
    corners = camera.camera.project(cam_from_facet.apply(facet.corners_m))
    height, width = light.per_ms.shape
    left, top = np.maximum(np.floor(corners.min(axis=0)) - 1, 0).astype(np.intp)
    right, bottom = np.minimum(np.ceil(corners.max(axis=0)) + 2, [width, height]).astype(np.intp)
    if right - left < 2 or bottom - top < 2:
        return FacetPixels(*(np.zeros(shape) for _ in range(6)))
    rows, columns = np.mgrid[top:bottom, left:right]
    facet_from_cam = cam_from_facet.inverse()
    rays = camera.camera.cast_rays(np.stack([columns, rows], axis=-1).astype(np.float64)) @ facet_from_cam.rotation.T
    eye = facet_from_cam.translation_m
    points = eye + facet.design.intersect(eye, rays)[..., None] * rays
    x, y = points[..., 0], points[..., 1]
    rim = _RIM_PX * footprint_m(camera)
    inside = np.isfinite(x) & np.isfinite(y)
    for step_x, step_y in ((rim, 0.0), (-rim, 0.0), (0.0, rim), (0.0, -rim)):
        inside &= facet.contains(np.where(inside, x, 1e9) + step_x, np.where(inside, y, 1e9) + step_y)
    step_m = grid.x_m[1] - grid.x_m[0]
    column = np.rint((np.where(inside, x, grid.x_m[0]) - grid.x_m[0]) / step_m).astype(np.intp)
    row = np.rint((np.where(inside, y, grid.y_m[0]) - grid.y_m[0]) / step_m).astype(np.intp)
    node = row * shape[1] + column
    part = light.per_ms[top:bottom, left:right]
    full = light.saturated[top:bottom, left:right]

    def sums(values: FloatArray, used: BoolArray) -> FloatArray:
        total = np.bincount(node[used], values[used], minlength=shape[0] * shape[1])
        return np.asarray(total.reshape(shape), dtype=np.float64)

    ones, clean = np.ones(part.shape), inside & ~full
    count = sums(ones, clean)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums(part, clean) / count
        # Differences of neighbours in one node: its slope of light drops out, and half of their variance is a pixel's.
        pair = clean[:, 1:] & clean[:, :-1] & (node[:, 1:] == node[:, :-1])
        step = np.zeros(part.shape)
        step[:, 1:] = part[:, 1:] - part[:, :-1]
        paired = np.zeros(part.shape, dtype=bool)
        paired[:, 1:] = pair
        pairs = sums(ones, paired)
        average = sums(step, paired) / pairs
        scatter = 0.5 * (sums(step**2, paired) / pairs - average**2) * pairs / (pairs - 1)
        scatter = np.where(pairs >= _FEWEST_PIXELS, scatter, np.nan)
        places = sums(x, clean) / count, sums(y, clean) / count
    return FacetPixels(count, sums(ones, inside & full), mean, scatter, *places)


@dataclass(frozen=True, slots=True)
class PixelNoise:
    """Variance of one pixel's light over its light: ``read + shot * light + pattern * light^2`` [(DN/ms)^2]."""

    read: float
    shot: float
    pattern: float

    def variance(self, light: FloatArray) -> FloatArray:
        """Return the variance of pixels of a light, of any shape."""
        bright = np.maximum(light, 0.0)
        return np.asarray(self.read + self.shot * bright + self.pattern * bright**2)


def pixel_noise(seen: Sequence[FacetPixels]) -> PixelNoise:
    """Fit the noise of one camera's pixels to their scatter within nodes."""
    from scipy.optimize import nnls

    light = np.concatenate([one.light[np.isfinite(one.scatter)] for one in seen])
    scatter = np.concatenate([one.scatter[np.isfinite(one.scatter)] for one in seen])
    if light.size < 10:
        usual = float(np.median(scatter)) if light.size else 0.0
        return PixelNoise(max(usual, 1e-12), 0.0, 0.0)
    bright = np.maximum(light, 0.0)
    scale = max(float(bright.max()), 1e-12)
    # A node's scatter scatters by its own size: two rounds with the fitted variance as weight.
    weight = np.full(light.size, 1.0 / max(float(scatter.mean()), 1e-300))
    found = np.zeros(3)
    for _ in range(3):
        terms = np.stack([np.ones(light.size), bright / scale, (bright / scale) ** 2], axis=1)
        found = nnls(terms * weight[:, None], np.maximum(scatter, 0.0) * weight)[0]
        weight = 1.0 / np.maximum(terms @ found, 1e-6 * float(scatter.mean()) + 1e-300)
    return PixelNoise(float(found[0]), float(found[1] / scale), float(found[2] / scale**2))


def brightness_of(
    grid: FacetGrid,
    seen: Sequence[FacetPixels],
    noises: Sequence[PixelNoise],
    levels: Sequence[float],
    cameras: Sequence[OrientedCamera],
    sun: FloatArray,
) -> tuple[Brightness, BoolArray]:
    """Put together what all cameras saw of one facet.

    levels: Light of the sun's middle in each camera, reflected by the mirror [DN/ms].
    sun (3,): Direction to the sun in the mirror's frame.
    Returns: The nodes that at least three cameras measured, and which of the grid's nodes these are.
    """
    facet = grid.facet
    step_m = grid.x_m[1] - grid.x_m[0]
    usable = np.stack([(one.count >= _FEWEST_PIXELS) & (one.saturated == 0) for one in seen])
    nodes = grid.aperture & (np.count_nonzero(usable, axis=0) >= FEWEST_CAMERAS)
    x, y = (values[nodes] for values in np.meshgrid(grid.x_m, grid.y_m))
    own = facet.design.gradient(x, y)
    places, more, value, sigma = [], [], [], []
    for one, noise, level, good in zip(seen, noises, levels, usable, strict=True):
        known = good[nodes]
        at_x = np.where(known, one.x_m[nodes], x)[:, None] + step_m * _GAUSS[:, 0]
        at_y = np.where(known, one.y_m[nodes], y)[:, None] + step_m * _GAUSS[:, 1]
        there = facet.design.height_and_gradient(at_x, at_y)
        places.append(np.stack([at_x, at_y, there.height_m], axis=-1))
        more.append(np.stack([there.slope_x - own[0][:, None], there.slope_y - own[1][:, None]], axis=-1))
        light, count = one.light[nodes], one.count[nodes]
        value.append(np.where(known, light / level, np.nan))
        with np.errstate(invalid="ignore", divide="ignore"):
            # At most the light that is seen, at least none: noise must not make itself small.
            sigma.append(np.where(known, np.sqrt(noise.variance(light) / count) / level, np.nan))
    facet_from_mirror = facet.ensemble_from_facet.inverse()
    eyes = np.stack([facet_from_mirror.apply(camera.eye_m) for camera in cameras])
    bright = Brightness(
        x,
        y,
        *own,
        np.stack(places),
        np.stack(more),
        np.stack(value),
        np.stack(sigma),
        eyes,
        facet_from_mirror.rotate(sun),
    )
    return bright, nodes
