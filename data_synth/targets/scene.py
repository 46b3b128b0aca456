"""Photographs of targets: what stands where, under which light, and where each point really appears."""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from data_synth.optics.photo import Focus, View, draw_sheets
from data_synth.optics.prints import DotGridPrint, DotPrint, RingPrint
from data_synth.optics.sensor import Sensor, UnsignedArray
from data_synth.optics.sheets import Sheet
from heliogauge.errors import InputError
from heliogauge.validate import Float32Array, FloatArray

#: Steeper than this nothing can be made out, and the truth says nothing.
STEEPEST_RAD = np.radians(80.0)


@dataclass(frozen=True, slots=True)
class Glare:
    """A bright reflection: a Gaussian spot.

    place: Its middle, in shares of the image's width and height.
    size: Its standard deviation, in shares of the image's width.
    light: Its brightness in the middle; paper has about 0.85.
    """

    place: tuple[float, float]
    size: float
    light: float


@dataclass(frozen=True, slots=True)
class Cover:
    """Something in front of the targets: a dark bar across the image.

    start, end: Its ends, in shares of the image's width and height.
    width: Its width, in shares of the image's width.
    light: Its brightness.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    width: float
    light: float = 0.12


@dataclass(frozen=True, slots=True)
class Sharpening:
    """What a camera's program adds to a photo: its difference from a blurred copy.

    amount: Share of the difference that is added; 1 to 2 is usual, and gives halos of a tenth to a third of an edge.
    sigma_px: Blur of the copy [px].
    """

    amount: float
    sigma_px: float = 1.5


@dataclass(frozen=True, slots=True)
class ScreenPixels:
    """The pixels of a display, as far as a photo resolves them: with the photo's own they beat, which is moire.

    pitch_px: Distance of the display's pixels in the photo; near 1 or below, they are seen as their beat [px].
    modulation: Amplitude of their brightness, as a share of the light.
    turn_rad: Turn of their rows against the photo's [rad].
    """

    pitch_px: float
    modulation: float
    turn_rad: float = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """Light, lens and sensor of all photos.

    blur_sigma_px: Gaussian blur of the lens [px].
    focus: What lies at other depths is blurred more; None: the same blur at all depths.
    sharpening: What the camera's program adds; None: nothing.
    screen: The targets are shown on a display; None: they are printed.
    ground: Brightness of what is behind the sheets.
    clutter: Contrast of a busy background, 0 for a plain one.
    vignetting: Loss of light in the corners.
    gradient: Relative change of the light over the image's width and height.
    glares: Reflections.
    covers: Things in front.
    """

    blur_sigma_px: float = 0.5
    sensor: Sensor = field(default_factory=lambda: Sensor(exposure=1.0, read_noise_dn=0.8, shot_gain_dn=0.01))
    ground: float = 0.3
    clutter: float = 0.0
    vignetting: float = 0.15
    gradient: tuple[float, float] = (0.1, -0.06)
    glares: tuple[Glare, ...] = ()
    covers: tuple[Cover, ...] = ()
    focus: Focus | None = None
    sharpening: Sharpening | None = None
    screen: ScreenPixels | None = None


@dataclass(frozen=True, slots=True)
class KnownLength:
    """A scale bar: two points and what its certificate says.

    length_m: True distance [m].
    stated_m: Distance as calibrated [m].
    sigma_m: Its standard deviation [m].
    """

    a: str
    b: str
    length_m: float
    stated_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class TargetScene:
    """Targets, photos and conditions.

    name: Name of the measurement.
    sheets: What is printed, and where it is.
    conditions: Light, lens and sensor.
    lengths: Scale bars.
    dictionary: Name of the ring codes' dictionary.
    """

    name: str
    sheets: tuple[Sheet, ...]
    views: tuple[View, ...]
    conditions: Conditions = field(default_factory=Conditions)
    lengths: tuple[KnownLength, ...] = ()
    dictionary: str = ""

    def scaled(self, factor: float) -> "TargetScene":
        """Return the same scene with finer or coarser pixels.

        factor: Pixels per old pixel.
        Returns: The scene; the blur stays the same in metres on the sensor.
        """
        views = tuple(replace(view, camera=view.camera.scaled(factor)) for view in self.views)
        blur = replace(self.conditions, blur_sigma_px=self.conditions.blur_sigma_px * factor)
        return replace(self, views=views, conditions=blur)

    def with_sensor(
        self, *, bits: int = 8, read_noise_dn: float | None = None, blur_sigma_px: float | None = None
    ) -> "TargetScene":
        """Return the scene with another sensor or lens.

        bits: Bit depth of the photos.
        read_noise_dn: Noise of each pixel, in the numbers of these photos; the scene's own if absent [DN].
        blur_sigma_px: Gaussian blur of the lens; the scene's own if absent [px].
        """
        old = self.conditions
        # The same light on the sensor: noise and gain grow with the numbers.
        factor = (2**bits - 1) / old.sensor.saturation_dn
        sensor = replace(
            old.sensor,
            bits=bits,
            offset_dn=old.sensor.offset_dn * factor,
            read_noise_dn=old.sensor.read_noise_dn * factor if read_noise_dn is None else read_noise_dn,
            shot_gain_dn=old.sensor.shot_gain_dn * factor,
        )
        blur = old.blur_sigma_px if blur_sigma_px is None else blur_sigma_px
        return replace(self, conditions=replace(old, sensor=sensor, blur_sigma_px=blur))

    def as_photographed(
        self, *, sharpening: float = 0.0, moire_pitch_px: float | None = None, defocus_px_m: float = 0.0
    ) -> "TargetScene":
        """Return the scene as a camera's program sharpens it, on a display, or with a shallow depth of field.

        sharpening: Share of the difference from a blurred copy that is added; 0: none.
        moire_pitch_px: Distance of the pixels of the display that shows the targets; None: they are printed [px].
        defocus_px_m: Blur per difference of 1 / depth from the scene's middle in the first photo [px m].
        """
        old = self.conditions
        screen = None if moire_pitch_px is None else ScreenPixels(moire_pitch_px, 0.25)
        sharpened = Sharpening(sharpening) if sharpening else None
        focus = None
        if defocus_px_m:
            pose = self.views[0].cam_from_world
            depths = [float(pose.apply(sheet.world_from_sheet.translation_m)[2]) for sheet in self.sheets]
            focus = Focus(old.blur_sigma_px, float(np.median(depths)), defocus_px_m)
        return replace(self, conditions=replace(old, sharpening=sharpened, screen=screen, focus=focus))

    def points_m(self) -> dict[str, FloatArray]:
        """Return all points that can be measured, by name, in the world [m].

        Returns: Name to coordinates, shape (3,).
        InputError: Two sheets have the same name.
        """
        points: dict[str, FloatArray] = {}
        for sheet in self.sheets:
            for name, place in sheet_points(sheet).items():
                if name in points:
                    raise InputError(f"scene {self.name}: two points are called {name}")
                points[name] = place
        return points


@dataclass(frozen=True, slots=True, eq=False)
class ImageTruth:
    """Where the points appear in one photo: the projections of the points, not the centres of their images.

    photo: Name of the photo.
    names: The points that lie in the image and face the camera.
    pixels_px (n, 2): Image points (x, y) [px].
    diameter_px (n,): Largest diameter of the dot's image; NaN for corners [px].
    tilt_rad (n,): Angle between the sheet's normal and the line of sight [rad].
    covered (n,): Whether something in front may hide part of the sheet.
    """

    photo: str
    names: tuple[str, ...]
    pixels_px: FloatArray
    diameter_px: FloatArray
    tilt_rad: FloatArray
    covered: npt.NDArray[np.bool_]


def sheet_points(sheet: Sheet) -> dict[str, FloatArray]:
    """Return the points of a sheet that can be measured, by name, in the world [m].

    Returns: Name to coordinates, shape (3,).
    """
    places = sheet.figure.points_m
    points = sheet.world_from_sheet.apply(sheet.shape.points_m(np.array(list(places.values())).reshape(-1, 2)))
    return {sheet.name + suffix: point for suffix, point in zip(places, points, strict=True)}


def image_truth(scene: TargetScene, view: View) -> ImageTruth:
    """Project all points exactly, without drawing anything."""
    size = np.array([view.camera.width_px, view.camera.height_px])
    names: list[str] = []
    rows: list[tuple[float, ...]] = []
    for sheet in scene.sheets:
        tilt = view.tilt_rad(sheet.world_from_sheet)
        if tilt > STEEPEST_RAD or not sheet.figure.points_m:
            continue
        points = sheet_points(sheet)
        pixels = view.project(np.array(list(points.values())))
        depth = view.cam_from_world.apply(sheet.world_from_sheet.translation_m)[2]
        diameter = _dot_diameter_m(sheet) * view.camera.focal_x_px / depth
        for name, pixel in zip(points, pixels, strict=True):
            if np.all(pixel > -0.5) and np.all(pixel < size - 0.5):
                hidden = any(_hides(cover, pixel, view, _paper_px(sheet, view)) for cover in scene.conditions.covers)
                names.append(name)
                rows.append((*pixel, diameter, tilt, hidden))
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    return ImageTruth(view.name, tuple(names), table[:, :2], table[:, 2], table[:, 3], table[:, 4] > 0)


def render_photo(scene: TargetScene, view: View, rng: np.random.Generator) -> UnsignedArray:
    """Take one photo.

    Returns (height_px, width_px): The photo as a file holds it [DN].

    The shading is taken at the pixel's centre: over one pixel it changes by less than 1e-3 in every scene here.
    """
    conditions, camera = scene.conditions, view.camera
    light = np.full((camera.height_px, camera.width_px), conditions.ground, dtype=np.float32)
    if conditions.clutter:
        _add_clutter(light, conditions.clutter, rng)
    draw_sheets(light, view, scene.sheets, conditions.focus or conditions.blur_sigma_px)
    if conditions.screen is not None:
        _add_screen(light, conditions.screen)
    _shade(light, conditions)
    for cover in conditions.covers:
        _add_cover(light, cover)
    for glare in conditions.glares:
        _add_glare(light, glare)
    if conditions.sharpening is not None:
        _sharpen(light, conditions.sharpening)
    return conditions.sensor.expose(light, rng)


def _dot_diameter_m(sheet: Sheet) -> float:
    figure = sheet.figure
    return figure.diameter_m if isinstance(figure, RingPrint | DotPrint | DotGridPrint) else float("nan")


def _paper_px(sheet: Sheet, view: View) -> float:
    depth = view.cam_from_world.apply(sheet.world_from_sheet.translation_m)[2]
    return float(np.hypot(*sheet.figure.half_size_m) * view.camera.focal_x_px / depth)


def _hides(cover: Cover, pixel: FloatArray, view: View, reach_px: float) -> bool:
    size = np.array([view.camera.width_px, view.camera.height_px])
    start, end = np.multiply(cover.start, size), np.multiply(cover.end, size)
    share = np.clip((pixel - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    distance = np.linalg.norm(pixel - start - share * (end - start))
    return bool(distance < reach_px + cover.width * size[0] / 2)


def _shade(light: Float32Array, conditions: Conditions) -> None:
    height, width = light.shape
    x = np.linspace(-1, 1, width, dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)
    along, down = (np.float32(0.5 * change) for change in conditions.gradient)
    # Corners are sqrt(2) from the middle, in half widths and half heights.
    loss = np.float32(conditions.vignetting / 2)
    light *= (1 + along * x - loss * x * x)[None, :] + (down * y - loss * y * y)[:, None]


def _add_cover(light: Float32Array, cover: Cover) -> None:
    start, end = (np.rint(np.multiply(p, light.shape[::-1])).astype(int).tolist() for p in (cover.start, cover.end))
    mask = np.zeros(light.shape, dtype=np.uint8)
    cv2.line(mask, start, end, 255, max(round(cover.width * light.shape[1]), 1), cv2.LINE_AA)
    share = mask.astype(np.float32) / np.float32(255)
    light += share * (np.float32(cover.light) - light)


def _add_glare(light: Float32Array, glare: Glare) -> None:
    height, width = light.shape
    sigma = glare.size * width
    x = np.exp(-0.5 * ((np.arange(width) - glare.place[0] * width) / sigma) ** 2).astype(np.float32)
    y = np.exp(-0.5 * ((np.arange(height) - glare.place[1] * height) / sigma) ** 2).astype(np.float32)
    light += np.float32(glare.light) * y[:, None] * x[None, :]


def _add_screen(light: Float32Array, screen: ScreenPixels) -> None:
    """Multiply by the display's pixels at the middles of the photo's: what is finer than these is aliased."""
    height, width = light.shape
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    wave = 2 * np.pi / screen.pitch_px
    c, s = np.float32(wave * np.cos(screen.turn_rad)), np.float32(wave * np.sin(screen.turn_rad))
    light *= 1 + np.float32(screen.modulation / 2) * (np.cos(c * x + s * y) + np.cos(c * y - s * x))


def _sharpen(light: Float32Array, sharpening: Sharpening) -> None:
    light += np.float32(sharpening.amount) * (light - cv2.GaussianBlur(light, (0, 0), sharpening.sigma_px))


def _add_clutter(light: Float32Array, contrast: float, rng: np.random.Generator) -> None:
    """Draw things that lie about: boxes, discs, bars, rings, in the sizes of targets."""
    height, width = light.shape
    base = float(light[0, 0])
    for _ in range(400):
        x, y = int(rng.integers(width)), int(rng.integers(height))
        size = max(int(width * 10 ** rng.uniform(-2.8, -1.2)), 2)
        grey = float(np.clip(base + contrast * rng.uniform(-1, 1), 0.02, 1))
        kind = int(rng.integers(4))
        if kind == 0:
            corners = cv2.boxPoints(((x, y), (size, size * rng.uniform(0.2, 1)), rng.uniform(0, 90)))
            cv2.fillPoly(light, [np.rint(corners).astype(np.int32)], grey, cv2.LINE_AA)
        elif kind == 1:
            axes = (size // 2, max(int(size * rng.uniform(0.2, 0.5)), 1))
            cv2.ellipse(light, (x, y), axes, rng.uniform(0, 180), 0, 360, grey, -1, cv2.LINE_AA)
        elif kind == 2:
            cv2.circle(light, (x, y), size // 2, grey, max(size // 6, 1), cv2.LINE_AA)
        else:
            end = (x + int(rng.integers(-3 * size, 3 * size)), y + int(rng.integers(-3 * size, 3 * size)))
            cv2.line(light, (x, y), end, grey, max(size // 10, 1), cv2.LINE_AA)
    light[:] = cv2.GaussianBlur(light, (0, 0), 0.8)
