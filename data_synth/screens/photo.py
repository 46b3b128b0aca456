"""One photo of a screen: its markers, and its dots each by the light on its own few pixels."""

import cv2
import numpy as np

from data_synth.optics.photo import View, draw_sheets
from data_synth.optics.sensor import UnsignedArray
from data_synth.optics.sheets import SheetShape
from data_synth.targets.scene import TargetScene
from heliogauge.validate import Float32Array, FloatArray

#: Light of the paper and of the dots.
_PAPER, _INK = 0.8, 0.1
#: Half the side of a dot's window, in radii of its image, and samples along a pixel's side.
_WINDOW, _SAMPLES = 2.2, 6


def take_photo(
    scene: TargetScene, view: View, dots_m: FloatArray, radii_m: FloatArray, shape: SheetShape, rng: np.random.Generator
) -> UnsignedArray:
    """Take one photo of markers and dots.

    dots_m (n, 2), radii_m (n,): Centres of the dots as drawn on the screen, and their radii [m].
    shape: How the screen is bent; its frame is the world.
    """
    camera, conditions = view.camera, scene.conditions
    light = np.full((camera.height_px, camera.width_px), _PAPER, dtype=np.float32)
    draw_sheets(light, view, scene.sheets, conditions.blur_sigma_px)
    if len(dots_m):
        light -= np.float32(_PAPER - _INK) * _dot_shares(view, dots_m, radii_m, shape, conditions.blur_sigma_px)
    x = np.linspace(-1.0, 1.0, camera.width_px, dtype=np.float32)
    light *= 1 + np.float32(0.5 * conditions.gradient[0]) * x[None, :]
    return conditions.sensor.expose(light, rng)


def _dot_shares(
    view: View, dots_m: FloatArray, radii_m: FloatArray, shape: SheetShape, blur_sigma_px: float
) -> Float32Array:
    """Return the share of each pixel that dots cover, after the blur of the lens, shape (h, w).

    The screen within a dot's window is mapped to pixels by the exact projection of 7 x 7 of its points, and back by a
    polynomial of third order through them (left out: 1e-4 px).
    """
    camera = view.camera
    size = (camera.height_px, camera.width_px)
    fine = np.zeros((size[0] * _SAMPLES, size[1] * _SAMPLES), dtype=np.float32)
    share = np.linspace(-1.0, 1.0, 7)
    grid = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)
    for (x, y), radius in zip(dots_m, radii_m.tolist(), strict=True):
        around = np.array([x, y]) + _WINDOW * radius * grid
        seen = view.project(shape.points_m(around))
        if not np.isfinite(seen).all() or (seen < 2).any() or (seen > np.array(size[::-1]) - 3).any():
            continue
        low = np.floor(seen.min(axis=0)).astype(int)
        high = np.ceil(seen.max(axis=0)).astype(int) + 1
        middle, scale = seen.mean(axis=0), 0.5 * float(np.ptp(seen, axis=0).max())
        to_screen = np.linalg.lstsq(_terms((seen - middle) / scale), grid * _WINDOW, rcond=None)[0]
        offsets = (np.arange((high[0] - low[0]) * _SAMPLES) + 0.5) / _SAMPLES - 0.5 + low[0]
        down = (np.arange((high[1] - low[1]) * _SAMPLES) + 0.5) / _SAMPLES - 0.5 + low[1]
        places = np.stack(np.meshgrid(offsets, down), axis=-1)
        at = _terms((places - middle) / scale) @ to_screen
        inside = (at[..., 0] ** 2 + at[..., 1] ** 2 < 1.0).astype(np.float32)
        window = fine[low[1] * _SAMPLES : high[1] * _SAMPLES, low[0] * _SAMPLES : high[0] * _SAMPLES]
        np.maximum(window, inside, out=window)
    whole = fine.reshape(size[0], _SAMPLES, size[1], _SAMPLES).mean(axis=(1, 3))
    return np.asarray(cv2.GaussianBlur(whole, (0, 0), blur_sigma_px), dtype=np.float32)


def _terms(places: FloatArray) -> FloatArray:
    """Return the monomials of third order, shape (..., 10)."""
    x, y = places[..., 0], places[..., 1]
    one = np.ones_like(x)
    return np.stack([one, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], axis=-1)
