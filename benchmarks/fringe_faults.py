"""Faults put into fringe frames and what stands beside them: what a user sees, and how wrong the result is.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/fringe_faults.py [--seeds N] [--real] [--only WORD]``.

Each fault is put into a measurement that is else good: drawn (exact truth), or the published real facet (its own result
without the fault is the truth). Seed 0 has the amounts written here; further seeds draw frame and amount. What counts
as wrong: curvatures, twist or the deviation from the best quadratic more than 3 sigma off, or single nodes scattering
by more than 3 of their sigmas. Silent: no doubt that the measurement without the fault does not have, and none that
names the faulty input ("warned"). "Told before" is wrong without a doubt, but the note of the good measurement names
this input as one that nothing confirms (`inputs_unconfirmed`), with an amount no smaller than the fault: below it, a
value whose stated sigma is not true cannot be told from a true one.
"""

import argparse
import tempfile
import tomllib
from collections import Counter
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from _measure import EXPECTED, import_real_facet

from data_synth.fringes import FringeScene, Knowledge, expected_light, measurement_content, preset_scene, screen_table
from deflectometry import Options, load_deflectometry, run
from deflectometry.setup import make_pattern
from heliogauge.doubts import Severity
from heliogauge.errors import MetrologyError
from heliogauge.images.photos import read_frames, write_image
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.tables import write_table_csv
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal
from heliogauge.slopes.statistics import fit_quadratic, statistics

#: What a laboratory knows of its set-up: errors are drawn with these sigmas and stated.
LABORATORY = Knowledge(
    sigma_screen_rotation_mrad=0.2, sigma_screen_translation_mm=1.0, sigma_focal_px=0.3, sigma_center_px=0.3
)
PRESETS = ("small", "off-axis", "sphere", "trough-panel", "curved-screen", "plane")


@dataclass
class Folder:
    """A measurement in memory, to be damaged."""

    frames: np.ndarray
    dark: np.ndarray
    bright: np.ndarray
    content: dict[str, Any]
    truth: Callable[[SlopeMap], SlopeMap]
    scene: FringeScene | None = None
    tables: dict[str, Any] = field(default_factory=dict)
    notes: str = ""

    @property
    def sets(self) -> list[slice]:
        """Frames of each set."""
        ends = np.cumsum([len(one["steps_deg"]) for one in self.content["pattern"]["set"]])
        return [
            slice(int(end) - len(one["steps_deg"]), int(end))
            for one, end in zip(self.content["pattern"]["set"], ends, strict=True)
        ]

    def write(self, folder: Path) -> None:
        """Write images, tables and measurement.toml."""
        folder.mkdir()
        names = [f"fringe_{k:02d}.png" for k in range(len(self.frames))]
        for name, image in zip([*names, "dark.png", "bright.png"], [*self.frames, self.dark, self.bright], strict=True):
            write_image(folder / name, np.ascontiguousarray(image))
        content = deepcopy(self.content)
        content["images"] |= {"fringes": names, "dark": "dark.png", "bright": "bright.png"}
        for name, table in self.tables.items():
            write_table_csv(folder / name, table)
        write_measurement(folder, content)


def true_map(scene: FringeScene, slope_map: SlopeMap) -> SlopeMap:
    """Put the true slopes onto the nodes of a map of one facet."""
    x_m, y_m = np.meshgrid(slope_map.x_m, slope_map.y_m)
    _, slope_x, slope_y = scene.facets[0].surface(x_m, y_m)
    return replace(slope_map, slope_x=slope_x, slope_y=slope_y)


def draw(scene: FringeScene, seed: int, knowledge: Knowledge) -> Folder:
    """Photograph a scene and write down what is known of it."""
    rng = np.random.default_rng(seed)
    light = expected_light(scene, np.random.default_rng(1))[0]
    taken = [scene.sensor.expose(one, rng) for one in light]
    content = measurement_content(scene, ["x.png"] * scene.pattern.n_frames, knowledge, rng)
    tables = {} if scene.bench.wall.is_plain else {"screen_points.csv": dict(screen_table(scene.bench.wall))}
    return Folder(
        np.stack(taken[:-2]), taken[-2], taken[-1], plain(content), lambda one: true_map(scene, one), scene, tables
    )


def plain(value: Any) -> Any:
    """Return content as lists and numbers that can be edited."""
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(one) for one in value]
    return value


@dataclass(frozen=True)
class Fault:
    """One fault: its kind, its words, and what it does to a folder (in place, or a new one).

    key_of: The stated input that is made wrong, and what a unit of its amounts is in the file.
    """

    name: str
    kind: str
    apply: Callable[[Folder, "Draw"], Folder | None]
    drawn_only: bool = False
    key_of: tuple[str, float] | None = None


@dataclass
class Draw:
    """Amounts: as written for seed 0, drawn for others."""

    seed: int
    rng: np.random.Generator
    said: list[str] = field(default_factory=list)

    def amount(self, first: float, low: float, high: float) -> float:
        """Return an amount of random sign, log-uniform between two sizes."""
        value = first
        if self.seed:
            value = float(np.exp(self.rng.uniform(np.log(low), np.log(high)))) * self.rng.choice([-1, 1])
        self.said.append(f"{value:.3g}")
        return value

    def size(self, first: float, low: float, high: float) -> float:
        """Return a positive amount."""
        return abs(self.amount(abs(first), low, high))

    def frame(self, folder: Folder, first: int, skip: int = 0) -> int:
        """Return the number of a frame, not among the first and last ones to skip."""
        value = first if not self.seed else int(self.rng.integers(skip, len(folder.frames) - skip))
        self.said.append(f"frame {value}")
        return value

    def set(self, folder: Folder, first: int) -> int:
        """Return the number of a set."""
        value = first if not self.seed else int(self.rng.integers(0, len(folder.sets)))
        self.said.append(f"set {value}")
        return value


# --- faults of frames -----------------------------------------------------------------------------------------------


def noise_again(folder: Folder, frame: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a picture of the same thing with other noise, to a fair degree."""
    return as_readings(frame + rng.standard_normal(frame.shape))


def as_readings(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def moved(image: np.ndarray, x_px: float, y_px: float) -> np.ndarray:
    size = image.shape[::-1]
    matrix = np.array([[1, 0, x_px], [0, 1, y_px]])
    wide = cv2.warpAffine(
        image.astype(np.float32), matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return as_readings(wide)


def repeated(folder, draw):
    k = draw.frame(folder, 5, 1)
    folder.frames[k] = folder.frames[k - 1]


def stale(folder, draw):
    k = draw.frame(folder, 21, 1)
    folder.frames[k] = noise_again(folder, folder.frames[k - 1], draw.rng)


def swapped(folder, draw):
    k = draw.frame(folder, 13, 1)
    folder.frames[[k, k + 1]] = folder.frames[[k + 1, k]]


def swapped_far(folder, draw):
    first, second = (6, 29) if not draw.seed else draw.rng.choice(len(folder.frames), 2, replace=False)
    draw.said.append(f"{first}, {second}")
    folder.frames[[first, second]] = folder.frames[[second, first]]


def sets_exchanged(folder, draw):
    order = list(range(len(folder.sets)))
    first, second = (2, 3) if not draw.seed else draw.rng.choice(len(order), 2, replace=False)
    order[first], order[second] = order[second], order[first]
    draw.said.append(f"sets {first}, {second}")
    folder.frames = np.concatenate([folder.frames[folder.sets[k]] for k in order])


def steps_backwards(folder, draw):
    for one in folder.content["pattern"]["set"]:
        one["steps_deg"] = [-step for step in one["steps_deg"]]


def late(folder, draw):
    folder.frames = np.roll(folder.frames, 1, axis=0)


def torn(folder, draw):
    k = draw.frame(folder, 14)
    folder.frames[k, int(len(folder.dark) * draw.size(0.66, 0.2, 0.9)) :] = 0


def black(folder, draw):
    folder.frames[draw.frame(folder, 30)] = folder.dark


def noise_only(folder, draw):
    k = draw.frame(folder, 17)
    folder.frames[k] = draw.rng.integers(0, 256, folder.frames[k].shape)


def shadow(folder, draw):
    """Hold a hand before a part of the mirror in one frame."""
    k = draw.frame(folder, 9)
    height, width = folder.dark.shape
    y, x = np.mgrid[:height, :width]
    inside = np.hypot(x - 0.5 * width, y - 0.45 * height) < draw.size(0.1, 0.03, 0.2) * width
    folder.frames[k][inside] = folder.dark[inside]


def offset(folder, draw):
    k = draw.frame(folder, 11)
    folder.frames[k] = as_readings(folder.frames[k] + draw.amount(-8.0, 0.5, 20))


def gain(folder, draw):
    k = draw.frame(folder, 27)
    folder.frames[k] = as_readings(folder.frames[k] * (1 - draw.size(0.08, 0.003, 0.3)))


def flicker(folder, draw):
    share = draw.size(0.02, 0.002, 0.05)
    folder.frames = as_readings(folder.frames * (1 - share * draw.rng.uniform(0, 1, len(folder.frames)))[:, None, None])


def drift(folder, draw):
    share = draw.size(0.06, 0.003, 0.1)
    folder.frames = as_readings(folder.frames * (1 - share * np.linspace(0, 1, len(folder.frames)))[:, None, None])


def frame_shift(folder, draw):
    k = draw.frame(folder, 15)
    folder.frames[k] = moved(folder.frames[k], draw.amount(0.7, 0.05, 2), draw.amount(0.2, 0.02, 0.5))


def set_shift(folder, draw):
    """Knock the camera between two sets: frames from there on are moved."""
    k = draw.set(folder, 5) or 1
    by = draw.amount(0.5, 0.05, 2), draw.amount(-0.3, 0.02, 0.5)
    for frame in range(folder.sets[k].start, len(folder.frames)):
        folder.frames[frame] = moved(folder.frames[frame], *by)


def blurred_frame(folder, draw):
    k = draw.frame(folder, 31)
    folder.frames[k] = as_readings(
        cv2.GaussianBlur(folder.frames[k].astype(np.float32), (0, 0), draw.size(1.2, 0.3, 3))
    )


def saturated(folder, draw):
    factor = 1 + draw.size(0.5, 0.05, 1.0)
    folder.frames, folder.bright = as_readings(folder.frames * factor), as_readings(folder.bright * factor)


def jpeg(folder, draw):
    quality = int(draw.size(40, 20, 95))
    for k, frame in enumerate(folder.frames):
        folder.frames[k] = cv2.imdecode(cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 0)


def clipped_dark(folder, draw):
    """Set the camera's black level above the light of dark fringes."""
    level = draw.size(14.0, 4, 40)
    folder.frames, folder.bright = as_readings(folder.frames - level), as_readings(folder.bright - level)
    folder.dark = as_readings(folder.dark - level)


# --- faults of what was displayed -----------------------------------------------------------------------------------


def declared_steps(folder, factor, sets=None):
    for k, one in enumerate(folder.content["pattern"]["set"]):
        if sets is None or k in sets:
            one["steps_deg"] = [step * factor for step in one["steps_deg"]]


def steps_scaled(folder, draw):
    declared_steps(folder, 1 + draw.amount(0.0667, 0.003, 0.15))


def steps_of_one_set(folder, draw):
    declared_steps(folder, 1 + draw.amount(0.05, 0.003, 0.15), [draw.set(folder, 2)])


def steps_of_the_finest(folder, draw):
    declared_steps(folder, 1 + draw.amount(0.02, 0.003, 0.1), [3, 7])


def sixteen_steps(folder, draw):
    """Show steps of 24 deg where 22.5 were planned."""
    new = draw_again(folder, draw, pattern=make_pattern((0.9, 3.9, 15.9), (0.9, 3.9, 15.9), 16))
    declared_steps(new, 22.5 / 24 if not draw.seed else 1 + draw.amount(0.05, 0.003, 0.1))
    return new


def three_steps_gamma(folder, draw):
    gamma = 1 + draw.size(0.2, 0.02, 1.2)
    return draw_again(
        folder, draw, pattern=make_pattern((0.9, 3.9, 15.9, 63.9), (0.9, 3.9, 15.9, 63.9), 3), gamma=gamma
    )


def four_steps_gamma(folder, draw):
    return draw_again(folder, draw, gamma=1 + draw.size(0.5, 0.02, 1.2))


def periods_of_finest(folder, draw):
    share = draw.amount(0.1 / 63.9, 2e-4, 6e-3)
    for one in folder.content["pattern"]["set"]:
        if one["periods"] > 60:
            one["periods"] *= 1 + share


def periods_of_one_set(folder, draw):
    folder.content["pattern"]["set"][draw.set(folder, 6)]["periods"] *= 1 + draw.amount(0.006, 3e-4, 0.03)


def periods_whole(folder, draw):
    for one in folder.content["pattern"]["set"]:
        one["periods"] = round(one["periods"] + 0.1)


def set_offset(folder, draw):
    """Display one set some pixels of the projector beside its place."""
    k = draw.set(folder, 7)
    shift = draw.amount(1.0 / 1920, 1e-4, 5e-3) * folder.content["pattern"]["set"][k]["periods"] * 360
    one = folder.content["pattern"]["set"][k]
    one["steps_deg"] = [step + shift for step in one["steps_deg"]]


def axis_offset(folder, draw):
    """Display all fringes of one direction with another phase: an offset that all sets share."""
    shift = draw.amount(90.0, 3, 120)
    for one in folder.content["pattern"]["set"]:
        if one["axis"] == "x":
            one["steps_deg"] = [step + shift for step in one["steps_deg"]]


def draw_again(folder, draw, *, pattern=None, gamma=None, blur_px=None, wall=None, ambient=None):
    scene = folder.scene
    assert scene is not None
    if pattern is not None:
        scene = replace(scene, pattern=pattern)
    if gamma is not None:
        scene = replace(scene, lighting=replace(scene.lighting, gamma=gamma))
    if blur_px is not None:
        scene = replace(scene, blur_sigma_px=blur_px)
    if wall is not None:
        scene = replace(scene, bench=replace(scene.bench, wall=wall))
    again = globals()["draw"](scene, draw.seed, Knowledge())
    # The same stated values; what was drawn anew is the light.
    again.content |= {key: folder.content[key] for key in ("camera", "screen", "mirror")}
    if wall is not None and wall.is_plain:
        again.content["screen"] = {**folder.content["screen"], "width_m": wall.width_m, "height_m": wall.height_m}
    return again


def blurred(folder, draw):
    return draw_again(folder, draw, blur_px=draw.size(1.4, 0.5, 2.5))


def small_screen(folder, draw):
    """Take a screen past which a part of the mirror looks."""
    wall = folder.scene.bench.wall
    share = draw.size(0.26, 0.2, 0.32)
    return draw_again(folder, draw, wall=replace(wall, width_m=wall.width_m * share))


# --- faults of set-up and measurement.toml --------------------------------------------------------------------------


def every_image(folder, change):
    folder.frames = np.stack([change(one) for one in folder.frames])
    folder.dark, folder.bright = change(folder.dark), change(folder.bright)


def flipped_x(folder, draw):
    every_image(folder, lambda one: one[:, ::-1])


def flipped_y(folder, draw):
    every_image(folder, lambda one: one[::-1])


def half_turn(folder, draw):
    every_image(folder, lambda one: one[::-1, ::-1])


def screen_flipped_x(folder, draw):
    """Show the pattern the wrong way round."""
    for one in folder.content["pattern"]["set"]:
        if one["axis"] == "x":
            # u becomes 1 - u: cos(2 pi p (1 - u) - s) = cos(2 pi p u - (2 pi p - s)).
            one["steps_deg"] = [360 * one["periods"] - step for step in one["steps_deg"]]


def axes_exchanged(folder, draw):
    for one in folder.content["pattern"]["set"]:
        one["axis"] = {"x": "y", "y": "x"}[one["axis"]]


def key(path, first, low, high, *, relative=True):
    def change(folder, draw):
        table = folder.content
        *way, last = path
        for name in way:
            table = table[name]
        by = draw.amount(first, low, high)
        if isinstance(last, tuple):
            last, index = last
            table[last][index] = table[last][index] * (1 + by) if relative else table[last][index] + by
        else:
            table[last] = table[last] * (1 + by) if relative else table[last] + by

    return change


def outline_corner(first):
    def change(folder, draw):
        corner, axis = (1, 0) if not draw.seed else draw.rng.integers(0, [4, 2])
        value = folder.content["mirror"]["outline_m"][corner][axis]
        factors = (first,) if not draw.seed else (10.0, 0.1, -1.0, 1.1, 0.9, 1.02, 1.005)
        factor = float(draw.rng.choice(factors))
        draw.said.append(f"corner {corner} times {factor:g}")
        folder.content["mirror"]["outline_m"][corner][axis] = value * factor

    return change


def outline_scaled(folder, draw):
    share = draw.amount(0.01, 0.001, 0.1)
    outline = folder.content["mirror"]["outline_m"]
    folder.content["mirror"]["outline_m"] = [[x * (1 + share), y * (1 + share)] for x, y in outline]


def outline_clockwise(folder, draw):
    folder.content["mirror"]["outline_m"] = folder.content["mirror"]["outline_m"][::-1]


def distortion_reversed(folder, draw):
    folder.content["camera"]["distortion_direction"] = "measured_to_ideal"


def distortion_left_out(folder, draw):
    for name in ("k1", "k2", "k3", "p1", "p2"):
        folder.content["camera"][name] = 0.0


def screen_in_degrees(folder, draw):
    vector = folder.content["screen"]["rotation_vector_rad"]
    folder.content["screen"]["rotation_vector_rad"] = [float(np.degrees(one)) for one in vector]


def screen_inverse(folder, draw):
    """State the camera's pose in the screen's frame instead of the other way round."""
    from heliogauge.geometry.rigid import RigidTransform

    section = folder.content["screen"]
    other = RigidTransform.from_rotation_vector(section["rotation_vector_rad"], section["translation_m"]).inverse()
    section["rotation_vector_rad"] = other.rotation_vector_rad.tolist()
    section["translation_m"] = other.translation_m.tolist()


def size_unknown(name):
    def change(folder, draw):
        """Measure the screen wrong, and say nothing of how well it was measured."""
        key(("screen", name), 0.01, 5e-4, 0.1)(folder, draw)
        for sigma in ("sigma_width_mm", "sigma_height_mm"):
            folder.content["screen"].pop(sigma, None)

    return change


def size_stated(name):
    def change(folder, draw):
        """Measure the screen wrong by two sigma of what is stated."""
        size = folder.content["screen"][name]
        sigma_mm = draw.size(5.0, 0.2, 50)
        folder.content["screen"][name] = size + 2e-3 * sigma_mm
        folder.content["screen"][f"sigma_{name[:-2]}_mm"] = sigma_mm

    return change


def distance_stated(folder, draw):
    """Measure the distance wrong by two sigma of what is stated."""
    section = folder.content["mirror"]["distance"]
    sigma_mm = draw.size(5.0, 0.2, 50)
    section["distance_m"] += 2e-3 * sigma_mm
    section["sigma_mm"] = sigma_mm


def width_height_exchanged(folder, draw):
    section = folder.content["screen"]
    section["width_m"], section["height_m"] = section["height_m"], section["width_m"]


def sagging_screen(folder, draw):
    wall = replace(folder.scene.bench.wall, sag_x_m=draw.amount(0.02, 0.002, 0.1))
    # What is stated is the screen without sag.
    new = draw_again(folder, draw, wall=wall)
    new.tables, new.content["screen"] = folder.tables, deepcopy(folder.content["screen"])
    new.content["screen"].pop("sigma_sag_mm", None)
    return new


def nothing(folder, draw):
    """Leave it as it is: what a good measurement says."""


FAULTS = (
    Fault("none", "control", nothing),
    Fault("frame repeated", "frame", repeated),
    Fault("frame stale", "frame", stale),
    Fault("neighbours swapped", "order", swapped),
    Fault("two frames swapped", "order", swapped_far),
    Fault("two sets exchanged", "order", sets_exchanged),
    Fault("all frames one late", "order", late),
    Fault("steps backwards", "order", steps_backwards),
    Fault("x and y exchanged", "order", axes_exchanged),
    Fault("frame torn off", "frame", torn),
    Fault("frame black", "frame", black),
    Fault("frame of noise", "frame", noise_only),
    Fault("shadow in one frame", "frame", shadow),
    Fault("frame offset, DN", "light", offset),
    Fault("frame gain", "light", gain),
    Fault("flicker", "light", flicker),
    Fault("drift", "light", drift),
    Fault("frame moved, px", "motion", frame_shift),
    Fault("camera knocked, px", "motion", set_shift),
    Fault("frame blurred, px", "motion", blurred_frame),
    Fault("saturated", "light", saturated),
    Fault("black level clips", "light", clipped_dark),
    Fault("strong JPEG stored as PNG", "light", jpeg),
    Fault("all steps scaled", "steps", steps_scaled),
    Fault("steps of one set scaled", "steps", steps_of_one_set),
    Fault("steps of the finest sets", "steps", steps_of_the_finest),
    Fault("16 steps of 24 deg", "steps", sixteen_steps, True),
    Fault("gamma, 3 steps", "phase", three_steps_gamma, True),
    Fault("gamma, 4 steps", "phase", four_steps_gamma, True),
    Fault("periods of the finest", "phase", periods_of_finest),
    Fault("periods of one set", "phase", periods_of_one_set),
    Fault("periods 1, 4, 16, 64", "phase", periods_whole),
    Fault("offset of one set", "phase", set_offset),
    Fault("offset of one axis, deg", "phase", axis_offset),
    Fault("blur, px", "phase", blurred, True),
    Fault("screen too small", "screen", small_screen, True),
    Fault("images mirrored left-right", "flip", flipped_x),
    Fault("images mirrored top-bottom", "flip", flipped_y),
    Fault("images turned by 180 deg", "flip", half_turn),
    Fault("pattern mirrored", "flip", screen_flipped_x),
    Fault("screen width", "set-up", size_unknown("width_m")),
    Fault("screen height", "set-up", size_unknown("height_m")),
    Fault("width 2 sigma off, mm", "set-up", size_stated("width_m")),
    Fault("height 2 sigma off, mm", "set-up", size_stated("height_m")),
    Fault("width and height exchanged", "set-up", width_height_exchanged),
    Fault("screen sags, m", "set-up", sagging_screen, True),
    Fault("screen moved, m", "set-up", key(("screen", ("translation_m", 0)), 0.1, 0.01, 1, relative=False)),
    Fault(
        "screen turned, rad", "set-up", key(("screen", ("rotation_vector_rad", 1)), 0.02, 0.002, 0.2, relative=False)
    ),
    Fault("screen's pose inverted", "set-up", screen_inverse),
    Fault("screen's pose in degrees", "set-up", screen_in_degrees),
    Fault(
        "distance",
        "set-up",
        key(("mirror", "distance", "distance_m"), 0.01, 5e-4, 0.1),
        key_of=("mirror.distance.distance_m", 1e-3),
    ),
    Fault("distance 2 sigma off, mm", "set-up", distance_stated),
    Fault(
        "camera's focal length",
        "set-up",
        key(("camera", "focal_x_px"), 0.01, 1e-3, 0.1),
        key_of=("camera.focal_x_px", 1.0),
    ),
    Fault(
        "principal point, px",
        "set-up",
        key(("camera", "center_x_px"), 10.0, 1, 40, relative=False),
        key_of=("camera.center_x_px", 1.0),
    ),
    Fault("distortion reversed", "set-up", distortion_reversed),
    Fault("distortion left out", "set-up", distortion_left_out),
    Fault("outline scaled", "outline", outline_scaled),
    Fault("outline corner times 10", "outline", outline_corner(10.0)),
    Fault("outline corner times 0.1", "outline", outline_corner(0.1)),
    Fault("outline corner times -1", "outline", outline_corner(-1.0)),
    Fault("outline corner times 1.02", "outline", outline_corner(1.02)),
    Fault("outline clockwise", "outline", outline_clockwise),
)


# --- judgement ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What a user sees, and how wrong the result is."""

    said: str
    codes: frozenset[str]
    errors: dict[str, float]
    refused: bool = False
    unconfirmed: dict[str, float] = field(default_factory=dict)

    def beside(self, clean: "Outcome") -> dict[str, float]:
        """Return the errors in sigma that the fault has brought: what the good measurement has is no part of it.

        Nor is what another sigma makes of that: a result within its sigma of the truth is not wrong.
        """
        return {name: min(abs(value), abs(value - clean.errors.get(name, 0.0))) for name, value in self.errors.items()}


def measure(folder: Folder, place: Path) -> Outcome:
    folder.write(place)
    try:
        result = run(load_deflectometry(place), Options())
    except MetrologyError as error:
        return Outcome(str(error).replace(str(place) + "/", ""), frozenset(), {}, refused=True)
    except Exception as error:  # A traceback is a bug that the table must show, not hide.
        return Outcome(f"BUG {type(error).__name__}: {error}", frozenset(), {"bug": np.inf})
    heard = [doubt for doubt in result.doubts if doubt.severity is not Severity.NOTE]
    one = result.assembled_as_measured
    return Outcome(
        "; ".join(f"{doubt.code}: {doubt.text}" for doubt in heard),
        frozenset(doubt.code for doubt in heard),
        errors_in_sigma(one, folder.truth(one)),
        unconfirmed={row.key: row.unnoticed for row in result.inputs if row.unnoticed_sigmas > 3},
    )


def errors_in_sigma(found: SlopeMap, true: SlopeMap) -> dict[str, float]:
    """Return how far the numbers are off the truth on the nodes measured, in their own sigmas."""
    nodes = found.valid & np.isfinite(true.slope_x) & np.isfinite(true.slope_y)
    if np.count_nonzero(nodes) < 30:
        return {"nodes": np.inf}
    blank = np.where(nodes, 0.0, np.nan)
    found = replace(found, slope_x=found.slope_x + blank, slope_y=found.slope_y + blank)
    true = replace(true, slope_x=true.slope_x + blank, slope_y=true.slope_y + blank)
    fits = fit_quadratic(found), fit_quadratic(true)
    sigma = np.sqrt(np.diag(fits[0].covariance))
    off = (fits[0].coefficients - fits[1].coefficients) / sigma
    errors = {"focus x": off[0], "focus y": off[1], "twist": off[4]}
    rest = statistics(found, removed=Removal.QUADRATIC), statistics(true, removed=Removal.QUADRATIC)
    for name in ("sdx", "sdy"):
        value, truth = (getattr(one, f"{name}_rad") for one in rest)
        errors[name] = (value - truth) / getattr(rest[0], f"sigma_{name}_rad")
    departure = np.stack([found.slope_x - true.slope_x, found.slope_y - true.slope_y])[:, nodes]
    departure -= departure.mean(axis=1, keepdims=True)
    expected = np.stack(found.sigma_slope())[:, nodes]
    for name, parts, sigmas in zip(("nodes x", "nodes y"), departure, expected, strict=True):
        errors[name] = float(np.sqrt(np.mean(parts**2) / np.mean(sigmas**2)))
    return {name: float(value) for name, value in errors.items()}


def real_folder() -> Folder:
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch) / "in"
        import_real_facet(place, with_pose=False)
        measurement = load_deflectometry(place)
        content = tomllib.loads((place / "measurement.toml").read_text())
        rest = [place / content["images"][name] for name in ("dark", "bright")]
        images = read_frames((*measurement.fringe_files, *rest)).images_dn
        tables = {}
        for file in place.glob("*.csv"):
            head = file.read_text().splitlines()[0].split(",")
            columns = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2).T
            tables[file.name] = dict(zip(head, columns.tolist(), strict=True))
        clean = run(measurement, Options()).assembled_as_measured
    return Folder(
        images[:-2].copy(),
        images[-2].copy(),
        images[-1].copy(),
        content,
        lambda one: same_nodes(clean, one),
        None,
        tables,
    )


def same_nodes(clean: SlopeMap, found: SlopeMap) -> SlopeMap:
    """Read the clean result at the nodes of another one."""
    from scipy.interpolate import RegularGridInterpolator

    x_m, y_m = np.meshgrid(found.x_m, found.y_m)
    places = np.stack([y_m, x_m], axis=-1)
    slopes = [
        RegularGridInterpolator((clean.y_m, clean.x_m), one, bounds_error=False)(places)
        for one in (clean.slope_x, clean.slope_y)
    ]
    return replace(found, slope_x=slopes[0], slope_y=slopes[1])


def amount_of(fault: Fault, base: Folder, damaged: Folder) -> float:
    """Return by how much the stated input is off, in the unit of `StatedInput`; infinite where it is no single one."""
    if fault.key_of is None:
        return np.inf
    name, unit = fault.key_of
    before, after = base.content, damaged.content
    for part in name.split("."):
        before, after = before[part], after[part]
    return abs(after - before) / unit


def verdict(outcome: Outcome, clean: Outcome, fault: Fault, amount: float) -> str:
    if outcome.refused:
        return "refused"
    if outcome.errors.get("bug"):
        return "BUG"
    wrong = max(outcome.beside(clean).values()) > 3
    if outcome.codes - clean.codes:
        return "doubt, wrong" if wrong else "doubt"
    if wrong and fault.key_of is not None and amount <= clean.unconfirmed.get(fault.key_of[0], 0.0):
        return "told before"
    return "SILENT, WRONG" if wrong else "good"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1, help="seed 0 and further ones that draw amounts")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--real", action="store_true", help="the published real facet instead of drawn ones")
    parser.add_argument("--laboratory", action="store_true", help="set-up known with errors that are stated")
    parser.add_argument("--only", default="", help="only faults whose name or kind holds this word")
    parser.add_argument("--words", type=int, default=110, help="length of what a user sees")
    chosen = parser.parse_args()
    counts: Counter[str] = Counter()
    for seed in range(chosen.first, chosen.first + chosen.seeds):
        if chosen.real:
            if not EXPECTED.is_file():
                print("not measured: ../shared/data/opencsp is not on this machine")
                return
            base, place = real_folder(), "real facet"
        else:
            place = PRESETS[seed % len(PRESETS)]
            base = draw(preset_scene(place), seed, LABORATORY if chosen.laboratory else Knowledge())
        print(f"\n{place}, seed {seed}")
        with tempfile.TemporaryDirectory() as scratch:
            usual = measure(base, Path(scratch) / "clean")
            for number, fault in enumerate(FAULTS):
                if chosen.only not in f"{fault.name} {fault.kind}" or (fault.drawn_only and base.scene is None):
                    continue
                amounts = Draw(seed, np.random.default_rng([seed, number]))
                damaged = deepcopy(base)
                damaged.truth, damaged.scene = base.truth, base.scene
                try:
                    damaged = fault.apply(damaged, amounts) or damaged
                except (KeyError, MetrologyError) as error:
                    print(f"  {fault.name:28} not made here: {type(error).__name__} {str(error)[:60]}")
                    continue
                outcome = measure(damaged, Path(scratch) / f"fault-{number}")
                seen = verdict(outcome, usual, fault, amount_of(fault, base, damaged))
                counts[seen] += 1
                errors = outcome.beside(usual)
                worst = max(errors, key=lambda name: errors[name], default="")
                off = f"{errors[worst]:8.1f} {worst:8}" if errors else " " * 17
                print(
                    f"  {fault.name:28} {', '.join(amounts.said):18.18} {seen:14} {off} {outcome.said[: chosen.words]}"
                )
    print("\n" + ", ".join(f"{name}: {count}" for name, count in counts.most_common()))


if __name__ == "__main__":
    main()
