"""Fringe images of a screen seen in a mirror with known slope errors, integrated over each pixel's area and blur."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from data_synth.fringes.faults import Fault, FaultKind, damage_frames, frame_sources, shown_pattern
from data_synth.fringes.truth import PIXEL_ARRAYS, TRUTH_SCHEMA, FringeTruth, PixelTruth, facet_to_json
from data_synth.optics.mirror import SyntheticFacet, transform_to_json
from data_synth.optics.raster import EDGE_RAYS, PixelKernel
from data_synth.optics.sensor import Sensor, UnsignedArray
from data_synth.optics.trace import Bench, Traced
from deflectometry.setup import Axis, FringePattern
from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array, FloatArray

#: Rays traced at once: their dozen float64 arrays then stay near the processor (64k rays: 0.5 MB an array).
_RAYS_PER_BLOCK = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """What the display and the room send, relative to a white display.

    gamma: Light of the display is its level to this power.
    level_min, level_max: Display levels of the dark and the bright fringe.
    display_bits: The display rounds levels to this depth; None: it does not.
    black: Light of a black display.
    falloff: Loss of light at the corners of the screen (quadratic).
    ambient: Light of the room on screen and walls.
    indirect: Share of the display's mean light that the room throws back on everything.
    background_albedo: Brightness of what stands around the mirror.
    reflectivity: Mean reflectivity of the mirror.
    soiling: Relative amplitude of its smooth variation over the facet.
    """

    gamma: float = 1.0
    level_min: float = 0.0
    level_max: float = 1.0
    display_bits: int | None = None
    black: float = 0.01
    falloff: float = 0.15
    ambient: float = 0.01
    indirect: float = 0.02
    background_albedo: float = 0.5
    reflectivity: float = 0.93
    soiling: float = 0.03

    def light(self, wave: Float32Array) -> Float32Array:
        """Return the display's light for a wanted level fraction 0..1 between the darkest and brightest fringe."""
        level = np.float32(self.level_min) + np.float32(self.level_max - self.level_min) * wave
        if self.display_bits is not None:
            top = np.float32(2**self.display_bits - 1)
            level = np.rint(level * top) / top
        if self.gamma != 1.0:
            level = level ** np.float32(self.gamma)
        return np.asarray(np.float32(self.black) + np.float32(1 - self.black) * level, dtype=np.float32)

    @property
    def is_linear(self) -> bool:
        """Whether the light is proportional to the level."""
        return self.gamma == 1.0 and self.display_bits is None


@dataclass(frozen=True, slots=True, eq=False)
class FringeScene(ShortRepr):
    """Everything that determines a fringe measurement.

    bench: Camera, mirror pose and screen.
    facets: The mirror.
    pattern: The fringes as declared to the evaluation.
    lighting: Display and room.
    sensor: Exposure, noise, bit depth.
    blur_sigma_px: Gaussian blur of the lens [px].
    faults: What goes wrong.
    """

    name: str
    bench: Bench
    facets: tuple[SyntheticFacet, ...]
    pattern: FringePattern
    lighting: Lighting = field(default_factory=Lighting)
    sensor: Sensor = field(default_factory=Sensor)
    blur_sigma_px: float = 0.4
    faults: tuple[Fault, ...] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the images."""
        return self.bench.camera.height_px, self.bench.camera.width_px


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticFringes:
    """A synthetic measurement in memory.

    frames (n, h, w): The fringe frames in the order of the pattern.
    dark, bright (h, w): Black and white display.
    truth: What they show.
    """

    frames: UnsignedArray
    dark: UnsignedArray
    bright: UnsignedArray
    truth: FringeTruth


def render_fringes(scene: FringeScene, rng: np.random.Generator) -> SyntheticFringes:
    """Draw all frames of a scene.

    InputError: The mirror is not in view, or a distortion or surface error cannot be traced.
    """
    n = scene.pattern.n_frames
    sources = [*frame_sources(n, scene.faults), n, n + 1]
    light, pixels = expected_light(scene, rng)
    factors = _exposure_factors(scene, n)
    taken = [
        scene.sensor.expose(light[source], rng, float(factor)) for source, factor in zip(sources, factors, strict=True)
    ]
    frames: UnsignedArray = np.stack(taken[:n])  # type: ignore[assignment]
    damage_frames(frames, scene.faults)
    return SyntheticFringes(frames, taken[n], taken[n + 1], FringeTruth(scene.facets, pixels, scene_to_json(scene)))


def trace_truth(scene: FringeScene) -> FringeTruth:
    """Trace the pixel centres only: the truth of a scene without its images.

    InputError: The mirror is not in view.
    """
    pixels = PixelTruth.empty(scene.shape)
    for index in range(len(scene.facets)):
        _see_centers(scene, index, pixels)
    return FringeTruth(scene.facets, pixels, scene_to_json(scene))


def _exposure_factors(scene: FringeScene, n: int) -> FloatArray:
    factors = np.ones(n + 2)
    for fault in scene.faults:
        if fault.kind is FaultKind.DRIFT:
            factors[:n] *= np.linspace(1.0, 1.0 + fault.amount, n)
        elif fault.kind is FaultKind.SATURATED:
            factors *= fault.amount
    return factors


def expected_light(scene: FringeScene, rng: np.random.Generator) -> tuple[Float32Array, PixelTruth]:
    """Integrate the light on every pixel for every frame, without noise.

    rng: Shifts the sample lattices of pixels that an edge crosses.
    light (n + 2, h, w): Light on the pixels for the fringe frames, the dark and the bright one; 1 for a fully
        reflected white display.
    InputError: The mirror is not in view.
    """
    shader = _Shader.of(scene)
    light = np.zeros((shader.n_images, *scene.shape), dtype=np.float32)
    coverage = np.zeros(scene.shape, dtype=np.float32)
    pixels = PixelTruth.empty(scene.shape)
    for index, facet in enumerate(scene.facets):
        for rows, columns, values in _facet_light(scene, shader, facet, rng, _see_centers(scene, index, pixels)):
            light[:, rows, columns] += values[1:]
            coverage[rows, columns] += values[0]
    # One image at a time: all at once would double the memory of a full-size measurement.
    beside = (np.float32(1) - coverage) * _background_albedo(scene)
    for image, room in zip(light, shader.room(), strict=True):
        image += beside * room
    return light, pixels


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """Pixels of a facet: those fully inside and those its edge may cross."""

    inside: tuple[Any, Any]
    edge: tuple[Any, Any]
    phase_per_px: float


def _see_centers(scene: FringeScene, index: int, pixels: PixelTruth) -> _Pixels:
    """Trace the pixel centres of a facet, note the truth, and sort its pixels into inside and edge."""
    facet, kernel = scene.facets[index], PixelKernel(scene.blur_sigma_px)
    outline = scene.bench.project_outline(facet)
    if not np.isfinite(outline).all():
        raise InputError(f"facet {facet.name}: part of it is behind the camera; move the mirror")
    margin = kernel.reach_px + 2
    first = np.maximum(np.floor(outline.min(axis=0) - margin), 0).astype(int)
    last = np.minimum(np.ceil(outline.max(axis=0) + margin), np.array(scene.shape[::-1]) - 1).astype(int)
    if np.any(last - first < 2):
        raise InputError(f"facet {facet.name}: it is not in view of the camera; move the mirror")
    window = (slice(first[1], last[1] + 1), slice(first[0], last[0] + 1))
    rows, columns = np.mgrid[window]
    seen = scene.bench.trace(facet, columns.astype(np.float64), rows.astype(np.float64))
    x, y = seen.points_m[..., 0], seen.points_m[..., 1]
    distance = facet.distance_inside(x, y)
    _note(pixels, index, facet, seen, window, distance > 0)
    reach = 1.05 * kernel.reach_px * _metres_per_pixel(x, y)
    inside, edge = distance > reach, np.abs(distance) <= reach
    return _Pixels((rows[inside], columns[inside]), (rows[edge], columns[edge]), _phase_per_px(scene, seen, inside))


def _phase_per_px(scene: FringeScene, seen: Traced, inside: BoolArray) -> float:
    """Return the largest change of a fringe's phase from pixel to pixel, 0 where no pixel is fully inside [rad]."""
    largest = 0.0
    for axis, display in ((Axis.X, seen.u), (Axis.Y, seen.v)):
        periods = max(fringes.periods for fringes, _ in scene.pattern.sets_of(axis))
        for change in np.gradient(display):
            steep = np.nanmax(np.abs(np.asarray(change)[inside]), initial=0.0)
            largest = max(largest, float(2 * np.pi * periods * steep))
    return largest


def _metres_per_pixel(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the largest stretch from image to facet (largest singular value of the Jacobian)."""
    (x_row, x_column), (y_row, y_column) = np.gradient(x), np.gradient(y)
    squares = x_row**2 + x_column**2 + y_row**2 + y_column**2
    determinant = x_column * y_row - x_row * y_column
    return np.asarray(np.sqrt(0.5 * (squares + np.sqrt(np.maximum(squares**2 - 4 * determinant**2, 0)))))


def _note(
    pixels: PixelTruth,
    index: int,
    facet: SyntheticFacet,
    seen: Traced,
    window: tuple[slice, slice],
    inside: BoolArray,
) -> None:
    _, error_x, error_y = facet.errors.evaluate(seen.points_m[..., 0], seen.points_m[..., 1])
    pixels.facet_index[window][inside] = index
    x, y, height = np.moveaxis(seen.points_m, -1, 0)
    values = (x, y, height, seen.slope_x, seen.slope_y, error_x, error_y, seen.u, seen.v)
    for name, value in zip(PIXEL_ARRAYS, values, strict=True):
        getattr(pixels, name)[window][inside] = value[inside]


def _facet_light(
    scene: FringeScene, shader: "_Shader", facet: SyntheticFacet, rng: np.random.Generator, chosen: _Pixels
) -> Iterator[tuple[Any, Any, Float32Array]]:
    """Yield blocks of pixels (rows, columns) with their coverage and light, shape (1 + n_images, n)."""
    kernel = PixelKernel(scene.blur_sigma_px)
    rule = kernel.smooth_rule(chosen.phase_per_px)
    mixed_rows, mixed_columns = [chosen.edge[0]], [chosen.edge[1]]
    for rows, columns in _blocks(*chosen.inside, _RAYS_PER_BLOCK // rule.weights.size):
        x_px = columns[:, None] + rule.offsets_px[:, 0]
        y_px = rows[:, None] + rule.offsets_px[:, 1]
        seen = scene.bench.trace(facet, x_px, y_px)
        on_screen = _on_screen(seen)
        # A pixel on which the rim of the display falls needs many rays, like one on the rim of the mirror.
        whole = np.asarray(on_screen.all(axis=1) | ~on_screen.any(axis=1))
        mixed_rows.append(rows[~whole])
        mixed_columns.append(columns[~whole])
        weights = np.broadcast_to(rule.weights, x_px.shape) * whole[:, None]
        yield rows, columns, shader.shade(seen, facet, weights.astype(np.float32))
    for rows, columns in _blocks(
        np.concatenate(mixed_rows), np.concatenate(mixed_columns), _RAYS_PER_BLOCK // EDGE_RAYS
    ):
        offsets = kernel.scattered_offsets(rows.size, rng)
        seen = scene.bench.trace(facet, columns[:, None] + offsets[..., 0], rows[:, None] + offsets[..., 1])
        inside = facet.contains(seen.points_m[..., 0], seen.points_m[..., 1])
        yield rows, columns, shader.shade(seen, facet, (inside / EDGE_RAYS).astype(np.float32))


def _blocks(rows: Any, columns: Any, size: int) -> Iterator[tuple[Any, Any]]:
    for start in range(0, rows.size, size):
        yield rows[start : start + size], columns[start : start + size]


def _on_screen(seen: Traced) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray((seen.u >= 0) & (seen.u <= 1) & (seen.v >= 0) & (seen.v <= 1))


@dataclass(frozen=True, slots=True, eq=False)
class _Shader:
    """Turns display coordinates of rays into the light of every frame."""

    lighting: Lighting
    pattern: FringePattern
    mean_light: Float32Array

    @classmethod
    def of(cls, scene: FringeScene) -> "_Shader":
        lighting, pattern = scene.lighting, shown_pattern(scene.pattern, scene.faults)
        for fault in scene.faults:
            if fault.kind is FaultKind.GAMMA:
                lighting = replace(lighting, gamma=fault.amount)
        position = (np.arange(4096) + 0.5) / 4096
        means = [
            lighting.light(_wave(2 * np.pi * fringes.periods * position, step)).mean()
            for fringes in pattern.sets
            for step in fringes.steps_rad
        ]
        return cls(lighting, pattern, np.array([*means, lighting.black, 1.0], dtype=np.float32))

    @property
    def n_images(self) -> int:
        """Fringe frames plus dark and bright."""
        return self.pattern.n_frames + 2

    def room(self) -> Float32Array:
        """Return the light on walls in each image, shape (n_images,)."""
        return np.asarray(self.lighting.ambient + self.lighting.indirect * self.mean_light, dtype=np.float32)

    def shade(self, seen: Traced, facet: SyntheticFacet, weights: Float32Array) -> Float32Array:
        """Sum the rays of each pixel.

        Shapes: seen (n, m).
        facet: Whose reflectivity applies.
        weights (n, m): Weights of the rays, 0 beside the mirror.
        Returns (1 + n_images, n): Coverage of the pixels by the mirror, then the light it sends them in each image.
        """
        out = np.empty((1 + self.n_images, len(weights)), dtype=np.float32)
        out[0] = weights.sum(axis=1)
        on_screen = _on_screen(seen)
        u, v = np.where(on_screen, seen.u, 0.5), np.where(on_screen, seen.v, 0.5)
        reflected = weights * self._reflectivity(seen, facet)
        radius = (2 * u - 1) ** 2 + (2 * v - 1) ** 2
        direct = reflected * np.where(on_screen, 1 - 0.5 * self.lighting.falloff * radius, 0).astype(np.float32)
        out[1:] = self.room()[:, None] * reflected.sum(axis=1)
        position = {Axis.X: u, Axis.Y: v}
        whole = direct.sum(axis=1)
        k = 1
        for fringes in self.pattern.sets:
            # Whole periods are dropped in float64: float32 would leave 3e-5 rad of rounding at 64 periods.
            phase = (2 * np.pi * np.mod(fringes.periods * position[fringes.axis], 1.0)).astype(np.float32)
            out[k : k + fringes.n_frames] += self._frames(phase, fringes.steps_rad, direct, whole)
            k += fringes.n_frames
        out[k] += np.float32(self.lighting.black) * whole
        out[k + 1] += whole
        return out

    def _frames(
        self, phase: Float32Array, steps: FloatArray, direct: Float32Array, whole: Float32Array
    ) -> Float32Array:
        """Return the display's light in the frames of one set, shape (n_frames, n)."""
        if not self.lighting.is_linear:
            waves = (_wave(phase, step) for step in steps)
            return np.stack([np.einsum("nm,nm->n", direct, self.lighting.light(wave)) for wave in waves])
        cosine = np.einsum("nm,nm->n", direct, np.cos(phase))
        sine = np.einsum("nm,nm->n", direct, np.sin(phase))
        low, high = self.lighting.light(np.array([0.0, 1.0], dtype=np.float32))
        wave = np.cos(steps)[:, None] * cosine + np.sin(steps)[:, None] * sine
        return np.asarray(0.5 * (low + high) * whole + 0.5 * (high - low) * wave, dtype=np.float32)

    def _reflectivity(self, seen: Traced, facet: SyntheticFacet) -> Float32Array:
        size = np.ptp(facet.outline_m, axis=0)
        x, y = (seen.points_m[..., axis].astype(np.float32) / np.float32(size[axis]) for axis in (0, 1))
        stain = np.sin(5 * x + 3 * y) * np.cos(4 * y - 2 * x)
        share = 1 + np.float32(self.lighting.soiling) * stain
        return np.asarray(self.lighting.reflectivity * share, dtype=np.float32)


def _wave(phase: npt.NDArray[Any], step: float) -> Float32Array:
    return np.asarray(0.5 + 0.5 * np.cos(phase - step, dtype=np.float32), dtype=np.float32)


def _background_albedo(scene: FringeScene) -> Float32Array:
    """Return the brightness of what stands around the mirror: dim and smooth, shape (h, w)."""
    height, width = scene.shape
    y, x = np.mgrid[:height, :width].astype(np.float32) / np.float32(max(height, width))
    texture = np.float32(0.2) * np.sin(9 * x + 2 * y) * np.sin(7 * y + 1)
    return np.asarray(np.float32(scene.lighting.background_albedo) * (1 + texture), dtype=np.float32)


def scene_to_json(scene: FringeScene) -> dict[str, Any]:
    """Return all parameters of a scene as plain values: the content of truth.json.

    Returns: Camera, poses, screen, facets with their error terms, pattern, lighting, sensor and faults.
    """
    bench = scene.bench
    return {
        "schema": TRUTH_SCHEMA,
        "kind": "fringes",
        "name": scene.name,
        "camera": asdict(bench.camera),
        "cam_from_mirror": transform_to_json(bench.cam_from_mirror),
        "screen": {**asdict(bench.wall), "cam_from_screen": transform_to_json(bench.cam_from_wall)},
        "facets": [facet_to_json(facet) for facet in scene.facets],
        "pattern": [
            {"axis": str(fringes.axis), "periods": fringes.periods, "steps_rad": fringes.steps_rad.tolist()}
            for fringes in shown_pattern(scene.pattern, scene.faults).sets
        ],
        "lighting": asdict(scene.lighting),
        "sensor": asdict(scene.sensor),
        "blur_sigma_px": scene.blur_sigma_px,
        "faults": [{"kind": str(fault.kind), "amount": fault.amount} for fault in scene.faults],
    }
