"""Images of Gray-code stripes on a screen seen in a mirror with known slope errors."""

import numpy as np

from data_synth.fringes.scene import FringeScene
from data_synth.optics.raster import EDGE_RAYS, PixelKernel
from data_synth.optics.sensor import UnsignedArray
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: Pixels traced at once: 64k rays.
_PIXELS_PER_BLOCK = (1 << 16) // EDGE_RAYS


def render_gray_code(
    scene: FringeScene, width_px: int, height_px: int, rng: np.random.Generator
) -> tuple[list[UnsignedArray], UnsignedArray, UnsignedArray]:
    """Draw the frames of a Gray code, and a dark and a bright one; every pixel by many rays, for stripes have edges.

    width_px, height_px: Size of the displayed code; its frames are those of OpenCV's `GrayCodePattern`.
    Returns: The frames (a stripe image and its inverse for each bit, columns first), the dark and the bright one.
    """
    kernel = PixelKernel(scene.blur_sigma_px)
    counts = [max(size - 1, 1).bit_length() for size in (width_px, height_px)]
    whole = np.zeros(scene.shape, dtype=np.float32)
    covered, lit = np.zeros_like(whole), np.zeros((sum(counts), *scene.shape), dtype=np.float32)
    for facet in scene.facets:
        outline = scene.bench.project_outline(facet)
        low = np.maximum(np.floor(outline.min(axis=0) - kernel.reach_px), 0).astype(int)
        high = np.minimum(np.ceil(outline.max(axis=0) + kernel.reach_px) + 1, scene.shape[::-1]).astype(int)
        rows, columns = (one.ravel() for one in np.mgrid[low[1] : high[1], low[0] : high[0]])
        for start in range(0, rows.size, _PIXELS_PER_BLOCK):
            row, column = (one[start : start + _PIXELS_PER_BLOCK] for one in (rows, columns))
            offsets = kernel.scattered_offsets(row.size, rng)
            seen = scene.bench.trace(facet, column[:, None] + offsets[..., 0], row[:, None] + offsets[..., 1])
            inside = facet.contains(seen.points_m[..., 0], seen.points_m[..., 1])
            covered[row, column] += inside.mean(axis=1)
            with np.errstate(invalid="ignore"):
                on = inside & (seen.u >= 0) & (seen.u < 1) & (seen.v >= 0) & (seen.v < 1)
            whole[row, column] += on.mean(axis=1)
            stripes = [
                *_stripes(np.where(on, seen.u, 0.0), width_px, counts[0]),
                *_stripes(np.where(on, seen.v, 0.0), height_px, counts[1]),
            ]
            for image, stripe in zip(lit, stripes, strict=True):
                image[row, column] += (on & stripe).mean(axis=1)
    display = np.stack([*(one for part in lit for one in (part, whole - part)), np.zeros_like(whole), whole])
    frames = [_exposed(scene, one, whole, covered, rng) for one in display]
    return frames[:-2], frames[-2], frames[-1]


def _stripes(place: FloatArray, cells: int, bits: int) -> list[BoolArray]:
    """Return where each bit of the reflected binary number of a cell is 1, coarsest first."""
    cell = np.minimum((place * cells).astype(np.int64), cells - 1)
    gray = cell ^ (cell >> 1)
    return [np.asarray((gray >> bit) & 1 == 1) for bit in reversed(range(bits))]


def _exposed(
    scene: FringeScene, bright: Float32Array, whole: Float32Array, covered: Float32Array, rng: np.random.Generator
) -> UnsignedArray:
    """Return the photo of a display that is bright on a part of what each pixel sees."""
    lighting = scene.lighting
    direct = lighting.reflectivity * (lighting.black * whole + (1.0 - lighting.black) * bright)
    beside = lighting.background_albedo * lighting.ambient * (1.0 - covered)
    return scene.sensor.expose((direct + beside).astype(np.float32), rng, 1.0)
