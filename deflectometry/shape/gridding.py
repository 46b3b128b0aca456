"""From the pixels of a facet to the regular grid of a slope map."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import cv2
import numpy as np

from deflectometry.shape.kriging import krige
from deflectometry.shape.pixel_slopes import SlopeImage
from deflectometry.shape.smooth_shape import Align, FittedSurface, alignment_words
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import REJECTED, SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.slopes.integration import integrate_slopes
from heliogauge.slopes.map import CommonModes, SlopeMap
from heliogauge.validate import BoolArray, FlagArray, Float32Array, FloatArray, IntArray

#: Larger maps cost more to store and draw than they show.
MOST_NODES = 1_000_000
#: Up to here nodes are set closer than pixels.
DENSE_NODES = 250_000
#: Nodes that are interpolated at once: what belongs to them stays in a 2 MiB second-level cache.
_BLOCK = 16384
#: Samples that are farther apart than this leave room for waves between them [px]: a pixel sees all of its own.
_SPARSE_PX = 2.0
#: A map of so many nodes takes 3 GB; more was hardly meant.
MOST_ASKED_NODES = 2e7


@dataclass(frozen=True, slots=True, eq=False)
class GriddedFacet:
    """The map of a facet, and what is doubtful about it."""

    slope_map: SlopeMap
    doubts: tuple[Doubt, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class GridPlan:
    """The grid of a map, and the words of its attributes.

    frame: The frame of x, y, z.
    removed: What was taken out of the measured slopes.
    """

    step_m: float
    frame: str
    removed: str


def default_step_m(footprint_m: float, area_m2: float) -> float:
    """Return the grid step for a pixel footprint, rounded down to two digits.

    footprint_m: Spacing of the pixels on the mirror [m].
    area_m2: Area of all facets [m^2].
    Returns: Step [m]: 0.4 of the footprint where that makes at most 250 000 nodes, up to one footprint where it makes
        more, and more than that only beyond a million nodes.

    So fine a grid keeps what the pixels show: on a measured facet of 84 x 85 pixels, a bilinear reading of the map at
    the pixels differs from another program's slopes there by 0.016 mrad RMS, by 0.021 with half a footprint and by
    0.047 with a whole one; the pixels themselves differ by 0.009. On a drawn facet of 670 x 670 pixels a whole
    footprint leaves 0.0036 mrad between pixels and map where the pixels' noise is 0.0069.
    >>> default_step_m(0.01412, 1.44)
    0.0056
    """
    dense, least = (float(np.sqrt(area_m2 / count)) for count in (DENSE_NODES, MOST_NODES))
    step = max(0.4 * footprint_m, min(footprint_m, dense), least)
    unit = 10.0 ** (np.floor(np.log10(step)) - 1)
    return float(np.round(np.floor(step / unit + 1e-9) * unit, 12))


def plan_grid(images: Mapping[str, SlopeImage], facets: Sequence[Facet], step_m: float, align: Align) -> GridPlan:
    """Choose one grid step for all facets, and the words of their maps.

    images: Pixels of each measured facet by its name.
    facets: All facets of the mirror, measured or not.
    step_m: The step asked for; 0 takes that of `default_step_m` [m].
    """
    if step_m == 0.0:
        finest = min(image.footprint_m for image in images.values())
        step_m = default_step_m(finest, sum(facet.area_m2 for facet in facets if facet.name in images))
    frame = "facet frame: x across, y up, seen from the front, z out of the mirror [m]"
    if len(facets) > 1:
        frame += "; one frame for each facet, placed by the ensemble's definition"
    return GridPlan(step_m, frame, alignment_words(align, len(facets)))


def grid_axis(low_m: float, high_m: float, step_m: float) -> FloatArray:
    """Return grid positions at whole multiples of the step that cover an interval [m]."""
    first, last = np.floor(low_m / step_m + 1e-9), np.ceil(high_m / step_m - 1e-9)
    return np.asarray(np.arange(first, last + 1) * step_m)


def grid_slopes(
    image: SlopeImage,
    surface: FittedSurface,
    camera: Camera,
    cam_from_facet: RigidTransform,
    facet: Facet,
    *,
    plan: GridPlan,
    common: CommonModes,
) -> GriddedFacet:
    """Read the slopes of a facet at the nodes of a regular grid.

    surface: Smooth shape of the facet.
    facet: Outline and design.
    plan: Grid step and words for the map's attributes.
    common: Common share of the uncertainty, kept with the map.
    Returns: Slopes, sigma, integrated height and flags at the nodes.
    InputError: A grid step that makes more nodes than memory holds.
    EstimationError: No node has a slope.

    Every node is projected into the image, and what the pixels differ from the smooth shape there is interpolated
    (cubic inside, linear beside gaps); the smooth shape itself is added exactly at the node. On grids coarser than
    the pixels the differences are averaged over a node's cell first. ``sigma_random**2 = sum w_i**2 sigma_i**2`` over
    the pixels used.
    """
    low, high, step_m = facet.outline_m.min(axis=0), facet.outline_m.max(axis=0), plan.step_m
    n_nodes = float(np.prod((high - low) / step_m))
    if n_nodes > MOST_ASKED_NODES:
        raise InputError(
            f"grid step: {step_m * 1e3:g} mm makes {n_nodes:.1e} nodes on facet {facet.name}, where "
            f"{MOST_ASKED_NODES:.0e} can be held; choose a step near the {image.footprint_m * 1e3:.3g} mm of the pixels"
        )
    x_m, y_m = grid_axis(low[0], high[0], step_m), grid_axis(low[1], high[1], step_m)
    grid_x, grid_y = np.meshgrid(x_m, y_m)
    aperture = facet.contains(grid_x, grid_y)
    if not aperture.any():
        raise EstimationError(
            f"grid: no node of a {step_m * 1e3:g} mm grid lies on facet {facet.name}; use a finer step"
        )
    nodes = grid_x[aperture], grid_y[aperture]
    height_m = surface.height(*nodes)
    pixels = camera.project(cam_from_facet.apply(np.stack([*nodes, height_m], axis=-1)))
    pixels = image.grid.places(pixels) - np.array([image.column, image.row])
    sample = _sample(image, surface, pixels, np.stack(nodes, axis=-1), int(max(1, round(step_m / image.footprint_m))))
    if not np.isfinite(sample.residual).any():
        raise EstimationError(f"grid: no pixel of facet {facet.name} has a slope; see the flags of pixels.nc")
    design, more = surface.design.gradient(*nodes), surface.correction_gradient(*nodes)

    def on_grid(values: FloatArray | Float32Array) -> FloatArray:
        whole = np.full(aperture.shape, np.nan)
        whole[aperture] = values
        return whole

    flags = np.full(aperture.shape, SampleFlag.OUTSIDE_MIRROR, dtype=np.uint32)
    flags[aperture] = sample.flags
    doubts: tuple[Doubt, ...] = ()
    try:
        height = integrate_slopes(on_grid(sample.residual[0]), on_grid(sample.residual[1]), (step_m, step_m))
        height += on_grid(height_m)
    except EstimationError as error:
        text = f"facet {facet.name} has slopes but no height map: {error}"
        doubts, height = (Doubt("facet_without_heights", text),), np.full(aperture.shape, np.nan)
    slope_map = SlopeMap(
        x_m=x_m,
        y_m=y_m,
        slope_x=on_grid(design[0] + more[0] + sample.residual[0]),
        slope_y=on_grid(design[1] + more[1] + sample.residual[1]),
        design_slope_x=on_grid(design[0]),
        design_slope_y=on_grid(design[1]),
        sigma_random_x=on_grid(sample.sigma[0]),
        sigma_random_y=on_grid(sample.sigma[1]),
        noise_correlation=_noise_correlation(image, sample.sigma),
        common=common,
        height_m=height,
        flags=flags,
        aperture=aperture,
        design=facet.design.describe(),
        frame=plan.frame,
        removed=plan.removed,
    )
    return GriddedFacet(slope_map, doubts)


class _NodeSample(NamedTuple):
    """Slopes minus the smooth shape's (2, n) at nodes, their sigma (2, n), and the flag of the nearest pixel (n,)."""

    residual: FloatArray
    sigma: Float32Array
    flags: FlagArray


_Plane = TypeVar("_Plane", FloatArray, Float32Array)


class _WeightedSums(NamedTuple):
    """Sums over the pixels beside each node: weights (n,), weighted differences and squared-weight variances (2, n)."""

    weight: FloatArray
    residual: FloatArray
    variance: Float32Array


def _sample(
    image: SlopeImage, surface: FittedSurface, pixels: FloatArray, places_m: FloatArray, width: int
) -> _NodeSample:
    """Interpolate the pixels' differences from the smooth shape at positions in the image (n, 2).

    places_m (n, 2): The same positions on the mirror [m].
    """
    smooth_x, smooth_y = surface.gradient(image.x_m, image.y_m)
    usable = np.isfinite(image.slope_x) & np.isfinite(image.slope_y)
    weight = usable.astype(np.float32)
    slopes = [image.slope_x - smooth_x, image.slope_y - smooth_y]
    # Seven digits are enough for a variance.
    variances = [(sigma**2).astype(np.float32, copy=False) for sigma in (image.sigma_x, image.sigma_y)]
    for slope, variance in zip(slopes, variances, strict=True):
        slope[~usable] = variance[~usable] = 0.0
    if width > 1:
        count = _box_sum(weight, width)
        # Half a cell must be seen for its mean to stand for it.
        weight = (count >= 0.5 * width * width).astype(np.float32)
        share = weight / np.maximum(count, 1).astype(np.float64)
        slopes = [_box_sum(plane, width) * share for plane in slopes]
        variances = [_box_sum(plane, width) * (share**2).astype(np.float32) for plane in variances]
    rows, columns = weight.shape
    nearest, inside = _nearest(pixels, (rows, columns))
    # OpenCV anchors an even box half a pixel past its middle.
    at, nearest_box, inside_box = pixels, nearest, inside
    if width % 2 == 0:
        at = pixels + 0.5
        nearest_box, inside_box = _nearest(at, (rows, columns))
    flags = np.where(inside, image.flags.ravel()[nearest], np.uint32(SampleFlag.NOT_SEEN)).astype(np.uint32)
    usable_node = inside & inside_box & (weight.ravel()[nearest_box] > 0)
    # A node whose nearest pixel was rejected has no value, whatever its other neighbours say.
    flags[usable_node] &= ~np.uint32(REJECTED)
    flags[~usable_node & (flags == 0)] = np.uint32(SampleFlag.NOT_SEEN)
    if image.grid.spacing_px > _SPARSE_PX and width == 1:
        return _between_samples(image, slopes, usable, places_m, usable_node, flags)
    sums = _interpolate(at, weight, slopes, variances, width)
    with np.errstate(invalid="ignore", divide="ignore"):
        residual = sums.residual / sums.weight
        sigma: Float32Array = np.divide(np.sqrt(sums.variance), sums.weight, dtype=np.float32)
    residual[:, ~usable_node] = sigma[:, ~usable_node] = np.nan
    return _NodeSample(residual, sigma, flags)


def _between_samples(
    image: SlopeImage,
    slopes: list[FloatArray],
    usable: BoolArray,
    places_m: FloatArray,
    usable_node: BoolArray,
    flags: FlagArray,
) -> _NodeSample:
    """Estimate differences from the smooth shape between samples that are far apart: waves fit between them."""
    points = np.stack([image.x_m[usable], image.y_m[usable]], axis=-1)
    residual, sigma = (np.full((2, len(places_m)), np.nan) for _ in range(2))
    for axis, own in enumerate((image.sigma_x, image.sigma_y)):
        found = krige(points, slopes[axis][usable], own[usable].astype(np.float64), places_m[usable_node])
        residual[axis, usable_node], sigma[axis, usable_node] = found.values, found.sigma
    return _NodeSample(residual, sigma.astype(np.float32), flags)


def _nearest(pixels: FloatArray, shape: tuple[int, int]) -> tuple[IntArray, BoolArray]:
    """Return the flat index of the nearest pixel of an image, and whether there is one."""
    column, row = np.rint(pixels[:, 0]).astype(np.intp), np.rint(pixels[:, 1]).astype(np.intp)
    inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
    return np.where(inside, row * shape[1] + column, 0), np.asarray(inside)


def _box_sum(plane: _Plane, width: int) -> _Plane:
    """Sum the boxes about all pixels, in the plane's own precision."""
    summed = cv2.boxFilter(plane, -1, (width, width), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(summed, dtype=plane.dtype)


def _interpolate(
    pixels: FloatArray, weight: Float32Array, slopes: list[FloatArray], variances: list[Float32Array], width: int
) -> _WeightedSums:
    """Sum the neighbours of each position.

    Cubic where all 16 neighbours are there, linear over the ones of the 4 that are there elsewhere. Neighbours that
    are means over `width` pixels share most of them: their noise adds up, it does not average out.
    """
    rows, columns = weight.shape
    block = _box_sum(weight, 4).ravel()
    apart = np.abs(np.subtract.outer(np.arange(4), np.arange(4)))
    shared = np.maximum(1.0 - apart / width, 0.0).astype(np.float32)
    # A border of two pixels without weight: every tap reads within the image.
    wide = columns + 4
    padded_weight = np.pad(weight, 2).ravel()
    padded = [(np.pad(one, 2).ravel(), np.pad(other, 2).ravel()) for one, other in zip(slopes, variances, strict=True)]
    total, residual = np.ones(len(pixels)), np.zeros((2, len(pixels)))
    variance = np.zeros((2, len(pixels)), dtype=np.float32)
    for start in range(0, len(pixels), _BLOCK):
        part = slice(start, start + _BLOCK)
        place = np.floor(pixels[part])
        left = np.clip(place[:, 0], -1, columns - 1).astype(np.intp)
        top = np.clip(place[:, 1], -1, rows - 1).astype(np.intp)
        to_right, down = pixels[part, 0] - left, pixels[part, 1] - top
        inner = (left >= 1) & (left < columns - 2) & (top >= 1) & (top < rows - 2)
        # OpenCV anchors an even box one pixel past its middle: the 4 x 4 block from (-1, -1) ends at (+2, +2).
        cubic = inner & (block.take(np.where(inner, (top + 1) * columns + left + 1, 0)) > 15.5)
        along_x, along_y = _tap_weights(to_right, cubic), _tap_weights(down, cubic)
        noise_x, noise_y = (one * (shared @ one) for one in (along_x.astype(np.float32), along_y.astype(np.float32)))
        first = (top + 1) * wide + left + 1
        for tap_x, tap_y in np.ndindex(4, 4):
            at = first + (tap_y * wide + tap_x)
            share, noise = along_x[tap_x] * along_y[tap_y], noise_x[tap_x] * noise_y[tap_y]
            for axis, (slope, its_variance) in enumerate(padded):
                residual[axis, part] += share * slope.take(at)
                variance[axis, part] += noise * its_variance.take(at)
        # The weights of a cubic add up to 1; those of the 4 pixels of a linear one do where all of these are there.
        linear = np.flatnonzero(~cubic)
        at = first[linear] + np.add.outer(wide * np.arange(1, 3), np.arange(1, 3))[..., None]
        shares = along_y[1:3, None, linear] * along_x[None, 1:3, linear]
        total[start + linear] = (shares * padded_weight.take(at)).sum(axis=(0, 1))
    return _WeightedSums(total, residual, variance)


def _tap_weights(fraction: FloatArray, cubic: BoolArray) -> FloatArray:
    """Return the weights of the pixels at -1, 0, 1, 2: Catmull and Rom's cubic, or linear, shape (4, n)."""
    t, rest = fraction, 1 - fraction
    weights = np.stack(
        [-0.5 * t * rest * rest, 1 + t * t * (1.5 * t - 2.5), t * (0.5 + t * (2 - 1.5 * t)), -0.5 * t * t * rest]
    )
    if not cubic.all():
        linear = ~cubic
        weights[:, linear] = np.stack([np.zeros_like(t), rest, t, np.zeros_like(t)])[:, linear]
    return weights


def _noise_correlation(image: SlopeImage, sigma: Float32Array) -> float:
    """Compare the variance of the mean over pixels with that over nodes taken as independent."""
    usable = np.isfinite(image.sigma_x)
    pixel_variance = float(np.mean(image.sigma_x[usable].astype(np.float64) ** 2)) / np.count_nonzero(usable)
    finite = np.isfinite(sigma[0])
    node_variance = float(np.mean(sigma[0][finite].astype(np.float64) ** 2)) / np.count_nonzero(finite)
    if image.grid.spacing_px > _SPARSE_PX:
        # Nodes between the same samples err together, by waves as well as by noise.
        return max(1.0, np.count_nonzero(finite) / np.count_nonzero(usable))
    return max(1.0, pixel_variance / node_variance) if node_variance > 0 else 1.0
