"""A trough drawn by Mitsuba 3, a path tracer that is not ours, from its own description of the scene and its own truth.

Nothing here is of data_synth: mirror, receiver, sky and targets are described anew, and all rays are Mitsuba's. The
mirror is a mesh with its real heights and the analytic normals at its vertices, the absorber a bent tube, the glass two
straight dielectric cylinders between bellows.

Frame as everywhere: x across the aperture, y along the trough, z to the absorber [m].
"""

import hashlib
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from photogrammetry.targets import RingCode, ring_dictionary

MISSING = (
    "Mitsuba 3 draws these scenes and is not installed: pip install 'heliogauge[bench]'. Its fast variant needs LLVM "
    "19 (Debian: libllvm19; DRJIT_LIBLLVM_PATH names the library; 14 aborts); MITSUBA_VARIANT=scalar_rgb needs none."
)
#: Between vertices of the mirror: waves of 1 mrad and 0.5 m are right within 0.0006 mrad across.
MESH_STEP_X_M, MESH_STEP_Y_M = 5e-3, 1e-2
#: Sides of the absorber's mesh; its flats lie 3 um inside the circle.
TUBE_SIDES, TUBE_STEP_M = 256, 0.02
DICTIONARY = "aicon-12"
#: Surfaces that a path may meet; how far along its own direction it starts from each, and from how near to a surface it
#: is intersected with it [m].
MOST_SURFACES, STEP_OFF_M, NEAR_M = 13, 1e-4, 0.1
#: Counts changes of the paths, so that photos of former ones are not taken for those of now.
PATHS = 3


@dataclass(frozen=True)
class Scene:
    """What is drawn; each switch takes one property of a real receiver or mirror away.

    exact_rays: Whether rays go on exactly where they met a surface, see `exact_paths`.
    heights_mm: Standard deviation of the panels' heights.
    sag_mm: Sag of the absorber between its supports; bend_mm, what it is bent across.
    has_glass: Whether the absorber is in glass.
    glass_off_mm: Where each glass is beside the chord of its absorber, standard deviation across and in height.
    sky: `clear`, `overcast` or `clouds`.
    has_heights: Whether the mesh has its heights; without them its normals alone are turned.
    """

    seed: int = 1
    exact_rays: bool = True
    length_m: float = 6.86
    n_along: int = 4
    slope_scale: float = 1.0
    heights_mm: float = 0.8
    has_heights: bool = True
    sag_mm: float = 7.0
    bend_mm: float = 3.0
    has_glass: bool = True
    glass_off_mm: float = 1.5
    absorber_brightness: float = 0.06
    sky: str = "clouds"
    n_photos: int = 61
    reach_m: float = 3.5
    height_m: float = 15.0
    wind_m: float = 0.15
    focal_px: float = 1750.0
    width_px: int = 940
    height_px: int = 940
    samples: int = 8
    focal_length_m: float = 1.71
    aperture_m: float = 5.76
    absorber_radius_m: float = 0.035
    glass_outer_m: float = 0.115
    glass_inner_m: float = 0.109
    glass_index: float = 1.5
    target_diameter_m: float = 0.075

    @property
    def key(self) -> str:
        """Name of the scene by its content."""
        return hashlib.sha256(json.dumps([asdict(self), PATHS], sort_keys=True).encode()).hexdigest()[:12]

    @property
    def panel_edges_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Edges of the panels across and along."""
        half = self.aperture_m / 2
        return np.array([-half, -half / 2 - 0.02, 0.0, half / 2 + 0.02, half]), self.length_m * np.linspace(
            -0.5, 0.5, self.n_along + 1
        )

    @property
    def supports_m(self) -> np.ndarray:
        """Where the receiver is held: each receiver is some 4 m long."""
        return self.length_m * np.linspace(-0.5, 0.5, max(2, round(self.length_m / 4)) + 1)


GAP_M, SUPPORT_WIDTH_M = 0.012, 0.3


class Mirror:
    """Heights over the design parabola and their analytic slopes."""

    def __init__(self, scene: Scene) -> None:
        rng = np.random.default_rng([scene.seed, 1])
        self._scene = scene
        self.edges_x, self.edges_y = scene.panel_edges_m
        shape = (self.edges_y.size - 1, self.edges_x.size - 1)
        self.tilt_x, self.tilt_y = 1e-3 * scene.slope_scale * rng.normal(0, [[[1.0]], [[0.7]]], (2, *shape))
        # The slope's change over a panel, and its twist.
        self.bend_x = 1e-3 * scene.slope_scale * rng.normal(0, 1.2, shape)
        self.bend_y = 1e-3 * scene.slope_scale * rng.normal(0, 0.4, shape)
        self.lift = 1e-3 * scene.heights_mm * rng.normal(0, 1.0, shape)
        periods = np.exp(rng.uniform(np.log(0.6), np.log(3.0), 7))
        turn = rng.normal(0, 0.5, 7)
        amplitude = 1e-3 * scene.slope_scale * rng.uniform(0.4, 0.8, 7) * np.sqrt(periods)
        self._waves = np.stack([2 * np.pi / periods, turn, amplitude, rng.uniform(0, 2 * np.pi, 7)], axis=1)

    def deviation(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return height over the design and both slopes that it adds."""
        column = np.clip(np.searchsorted(self.edges_x, x, side="right") - 1, 0, self.edges_x.size - 2)
        row = np.clip(np.searchsorted(self.edges_y, y, side="right") - 1, 0, self.edges_y.size - 2)
        wide, long = np.diff(self.edges_x)[column], np.diff(self.edges_y)[row]
        u, v = x - self.edges_x[column] - wide / 2, y - self.edges_y[row] - long / 2
        tilt_x, tilt_y, bend_x, bend_y = (
            one[row, column] for one in (self.tilt_x, self.tilt_y, self.bend_x, self.bend_y)
        )
        height = self.lift[row, column] + tilt_x * u + tilt_y * v
        height = height + bend_x * (u**2 / wide - wide / 12) + bend_y * (v**2 / long - long / 12)
        slope_x, slope_y = tilt_x + 2 * bend_x * u / wide, tilt_y + 2 * bend_y * v / long
        for number, turn, amplitude, phase in self._waves:
            along = number * (np.cos(turn) * x + np.sin(turn) * y) + phase
            height = height + amplitude / number * np.sin(along)
            slope_x = slope_x + amplitude * np.cos(turn) * np.cos(along)
            slope_y = slope_y + amplitude * np.sin(turn) * np.cos(along)
        return height, slope_x, slope_y

    def mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return vertices, normals and triangles of all panels."""
        focal, vertices, normals, faces, first = self._scene.focal_length_m, [], [], [], 0
        for row in range(self.edges_y.size - 1):
            for column in range(self.edges_x.size - 1):
                x0, x1 = self.edges_x[column : column + 2] + [
                    GAP_M / 2 * (column > 0),
                    -GAP_M / 2 * (column < self.edges_x.size - 2),
                ]
                y0, y1 = self.edges_y[row : row + 2] + [
                    GAP_M / 2 * (row > 0),
                    -GAP_M / 2 * (row < self.edges_y.size - 2),
                ]
                nx, ny = int((x1 - x0) / MESH_STEP_X_M) + 2, int((y1 - y0) / MESH_STEP_Y_M) + 2
                x, y = np.meshgrid(np.linspace(x0, x1, nx), np.linspace(y0, y1, ny))
                height, slope_x, slope_y = self.deviation(x, y)
                z = x**2 / (4 * focal) + (height if self._scene.has_heights else 0)
                normal = np.stack([-x / (2 * focal) - slope_x, -slope_y, np.ones_like(x)], axis=-1)
                vertices.append(np.stack([x, y, z], axis=-1).reshape(-1, 3))
                normals.append((normal / np.linalg.norm(normal, axis=-1, keepdims=True)).reshape(-1, 3))
                faces.append(first + _grid_faces(ny, nx))
                first += nx * ny
        return np.concatenate(vertices), np.concatenate(normals), np.concatenate(faces)


class Receiver:
    """The absorber's axis, and the glass of each receiver: straight between its bellows."""

    def __init__(self, scene: Scene) -> None:
        rng = np.random.default_rng([scene.seed, 2])
        self._scene, self.supports = scene, scene.supports_m
        n = self.supports.size
        self._held = 1e-3 * rng.normal(0, 2.0, (n, 2)) + [1.5e-3, -2e-3]
        self._bend = 1e-3 * np.stack(
            [scene.bend_mm * rng.normal(0, 0.7, n - 1), -scene.sag_mm * rng.uniform(0.7, 1.2, n - 1)], axis=1
        )
        self.glass_off = 1e-3 * scene.glass_off_mm * rng.normal(0, 1.0, (n - 1, 2))

    def chord(self, y: np.ndarray) -> np.ndarray:
        """Return the line between the supports, offsets from the focal line across and up, shape (..., 2)."""
        return np.stack([np.interp(y, self.supports, one) for one in self._held.T], axis=-1)

    def axis(self, y: np.ndarray) -> np.ndarray:
        """Return the absorber's axis, x and z, shape (..., 2)."""
        place = np.clip(np.interp(y, self.supports, np.arange(self.supports.size)), 0, self.supports.size - 1 - 1e-9)
        span, u = place.astype(int), place % 1.0
        shape = 16 * (u * (1 - u)) ** 2
        return self.chord(y) + shape[..., None] * self._bend[span] + [0.0, self._scene.focal_length_m]

    def mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return vertices, normals and triangles of the absorber."""
        half = self._scene.length_m / 2
        y = np.linspace(-half, half, int(2 * half / TUBE_STEP_M) + 1)
        angle = 2 * np.pi * np.arange(TUBE_SIDES + 1) / TUBE_SIDES
        round_ = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=1)
        axis = self.axis(y)
        middle = np.stack([axis[:, 0], y, axis[:, 1]], axis=1)
        points = middle[:, None] + self._scene.absorber_radius_m * round_
        faces = _grid_faces(y.size, TUBE_SIDES + 1)[:, ::-1]
        return points.reshape(-1, 3), np.tile(round_, (y.size, 1)), faces


def _grid_faces(rows: int, columns: int) -> np.ndarray:
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


@dataclass(frozen=True)
class Target:
    """A printed target: where it is and how it is turned (columns: right, up, out of the print)."""

    code: RingCode
    place_m: np.ndarray
    turned: np.ndarray


def targets_of(scene: Scene) -> list[Target]:
    """Return targets along both rims."""
    rng = np.random.default_rng([scene.seed, 3])
    codes = ring_dictionary(DICTIONARY).codes
    half = 2.0 * scene.target_diameter_m
    each = max(6, scene.n_along)
    y = np.linspace(-0.5, 0.5, each) * (scene.length_m - 2 * half)
    found = []
    for k in range(2 * each):
        side = 1 if k >= each else -1
        place = np.array(
            [
                side * (scene.aperture_m / 2 + half + 0.03),
                y[k % each],
                scene.aperture_m**2 / (16 * scene.focal_length_m),
            ]
        )
        turn, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(-0.05, 0.05, 2)
        out = np.array([*tilt, 1.0]) / np.hypot(1, np.hypot(*tilt))
        right = np.cross([-np.sin(turn), np.cos(turn), 0.0], out)
        right /= np.linalg.norm(right)
        found.append(
            Target(codes[k], place + 1e-3 * rng.normal(0, 1, 3), np.stack([right, np.cross(out, right), out], 1))
        )
    return found


def drawn_code(code: RingCode, side: int = 256, fine: int = 4) -> np.ndarray:
    """Draw a ring code by its definition, the first row on top: brightness 0.05 where inked, 0.85 elsewhere."""
    n = side * fine
    at = (np.arange(n) + 0.5) / n * 2 - 1
    x, y = np.meshgrid(at * code.radii.quiet, -at * code.radii.quiet)
    distance = np.hypot(x, y)
    sector = (np.arctan2(-y, x) % (2 * np.pi) * code.n_bits / (2 * np.pi)).astype(int) % code.n_bits
    ink = (distance < 1) | (
        (distance > code.radii.inner) & (distance < code.radii.outer) & np.array(code.sectors)[sector]
    )
    share = ink.reshape(side, fine, side, fine).mean(axis=(1, 3))
    return np.asarray(0.85 - 0.80 * share, dtype=np.float32)


@dataclass(frozen=True)
class View:
    """A photo: ``cam_from_trough`` as rotation and the camera's place."""

    rotation: np.ndarray
    place_m: np.ndarray


def views_of(scene: Scene) -> list[View]:
    """Return a pass across the trough as the documentation says: level, beyond both rims, aimed at the middle.

    The drone is off its line by the wind, and its gimbal by some tenths of a degree.
    """
    rng = np.random.default_rng([scene.seed, 4])
    found = []
    for x in np.linspace(-scene.reach_m, scene.reach_m, scene.n_photos):
        place = np.array([x, 0.0, scene.height_m]) + scene.wind_m * rng.normal(0, [0.15, 1.0, 0.5])
        aim = np.array([0.1 * x, 0.0, 0.6]) + rng.normal(0, [0.05, 0.05, 0.0])
        forward = (aim - place) / np.linalg.norm(aim - place)
        right = np.array([0.0, 1.0, 0.0]) + rng.normal(0, [0.006, 0.0, 0.006])
        right -= forward * (right @ forward)
        right /= np.linalg.norm(right)
        found.append(View(np.stack([right, np.cross(forward, right), forward]), place))
    return found


def project(scene: Scene, view: View, points_m: np.ndarray) -> np.ndarray:
    """Return image points of an ideal camera; the middle of the first pixel is (0, 0)."""
    seen = (points_m - view.place_m) @ view.rotation.T
    middle = np.array([scene.width_px - 1, scene.height_px - 1]) / 2
    return scene.focal_px * seen[:, :2] / seen[:, 2:] + middle


def mitsuba() -> Any:
    """Return Mitsuba with its variant chosen, or end with what to install."""
    import os

    try:
        import mitsuba as mi
    except ImportError:
        sys.exit(MISSING)
    mi.set_variant(os.environ.get("MITSUBA_VARIANT", "llvm_ad_mono"))
    mi.set_log_level(mi.LogLevel.Error)
    return mi


def exact_paths() -> Any:
    """Return an integrator whose rays go on from the very line on which they met a surface.

    Mitsuba's own lift each ray off the surface along its normal by ``9e-5 (1 + the largest coordinate)``, 0.2 to 0.4 mm
    in single precision and a scene of this size. On a mirror that counts as its height; four faces of glass make an
    absorber of 35.00 mm look like one of 35.35 mm in the reflection, more towards the ends. These go on 0.1 mm further
    along their own direction instead, which displaces nothing. Directions are drawn as surfaces scatter.

    Seen from 13 m, a cylinder of 0.1 m is met 0.2 mm beside its surface in single precision: rays that start there are
    inside where they were thrown back outside, and a mirror of that shape loses 10 to 20 % of its light. So each
    surface is met once more from 0.1 m before it.
    """
    import drjit as dr
    import mitsuba as mi

    class ExactPaths(mi.SamplingIntegrator):  # type: ignore[misc]
        """Paths from the camera to the sky."""

        def sample(self, scene, sampler, ray, medium=None, active=True):
            def going(active, ray, light, share, depth, sampler):
                return active

            # The sampler belongs to the loop's state: otherwise each surface draws the same number, and light that the
            # first face of the glass lets through is thrown back by no other one.
            def go_on(active, ray, light, share, depth, sampler):
                far = scene.ray_intersect_preliminary(ray, active=active)
                nearer = mi.Ray3f(ray(dr.select(far.is_valid(), dr.maximum(far.t - NEAR_M, 0.0), 0.0)), ray.d)
                met = scene.ray_intersect(nearer, active)
                light = light + dr.select(active, share * met.emitter(scene).eval(met, active), 0.0)
                inside = active & met.is_valid()
                surface, context = met.bsdf(nearer), mi.BSDFContext()
                onward = inside & (depth < MOST_SURFACES)
                drawn, weight = surface.sample(context, met, sampler.next_1d(onward), sampler.next_2d(onward), onward)
                way = met.to_world(drawn.wo)
                further = mi.Ray3f(met.p + STEP_OFF_M * way, way)
                share = dr.select(onward, share * weight, 0.0)
                return onward & (dr.max(share) > 0), further, light, share, depth + 1, sampler

            start = (mi.Bool(active), mi.Ray3f(ray.o, ray.d), mi.Spectrum(0.0), mi.Spectrum(1.0), mi.UInt32(0), sampler)
            light = dr.while_loop(start, going, go_on)[2]
            return light, mi.Bool(True), []

    return ExactPaths(mi.Properties())


def glass_in_even_light(scene: Scene) -> np.ndarray:
    """Return the light across empty glass of a scene where all around is 1: 1 as well, since glass takes nothing."""
    mi = mitsuba()
    ends = {"p0": [0.0, -3.0, 0.0], "p1": [0.0, 3.0, 0.0]}
    content: dict[str, Any] = {"type": "scene", "around": {"type": "constant", "radiance": _even(1.0)}}
    for name, diameter, inside, outside in _glass_faces(scene):
        bsdf = {"type": "dielectric", "int_ior": inside, "ext_ior": outside}
        content[name] = {"type": "cylinder", "radius": diameter / 2, "bsdf": bsdf} | ends
    eye = mi.ScalarTransform4f().look_at(origin=[0, 0.3, scene.height_m], target=[0, 0, 0], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": 20, "height": 2, "pixel_format": "luminance", "rfilter": {"type": "box"}}
    fov = float(np.degrees(scene.glass_outer_m / scene.height_m))
    sensor = mi.load_dict({"type": "perspective", "fov": fov, "to_world": eye, "film": film})
    image = mi.render(mi.load_dict(content), sensor=sensor, integrator=exact_paths(), spp=4096, seed=1)
    return np.asarray(image)[..., 0].mean(axis=0)


def _glass_faces(scene: Scene) -> list[tuple[str, float, float, float]]:
    """Return name, diameter and index inside and outside of the faces of the glass."""
    return [
        ("outer", scene.glass_outer_m, scene.glass_index, 1.0),
        ("inner", scene.glass_inner_m, 1.0, scene.glass_index),
    ]


class Renderer:
    """A scene as Mitsuba has it."""

    def __init__(self, scene: Scene, scratch: Path) -> None:
        self._mi = mi = mitsuba()
        self._scene = scene
        scratch.mkdir(parents=True, exist_ok=True)
        content: dict[str, Any] = {"type": "scene"}
        mirror = {"type": "conductor", "material": "none", "specular_reflectance": _even(0.93)}
        content["mirror"] = self._mesh(scratch / "mirror.ply", Mirror(scene).mesh(), mirror)
        receiver = Receiver(scene)
        # As bright from everywhere: light that falls into the glass by chance would be noise.
        tube = self._mesh(scratch / "tube.ply", receiver.mesh(), _diffuse(0.0))
        content["tube"] = tube | {"emitter": {"type": "area", "radiance": _even(scene.absorber_brightness)}}
        content |= self._receiver(receiver) | self._surroundings() | self._targets()
        self._loaded = mi.load_dict(content)
        usual = {"type": "path", "max_depth": MOST_SURFACES + 1, "rr_depth": 100}
        self._paths = exact_paths() if scene.exact_rays else mi.load_dict(usual)

    def take(self, view: View, seed: int) -> np.ndarray:
        """Return the light in each pixel, integrated over its area."""
        image = self._mi.render(
            self._loaded, sensor=self._sensor(view), integrator=self._paths, spp=self._scene.samples, seed=seed
        )
        return np.asarray(image, dtype=np.float32)[..., 0]

    def _sensor(self, view: View) -> Any:
        mi, scene = self._mi, self._scene
        # Mitsuba's camera has x to the left and y up.
        to_world = np.eye(4)
        to_world[:3, :3] = view.rotation.T @ np.diag([-1.0, -1.0, 1.0])
        to_world[:3, 3] = view.place_m
        return mi.load_dict(
            {
                "type": "perspective",
                "fov": float(2 * np.degrees(np.arctan(scene.width_px / 2 / scene.focal_px))),
                "fov_axis": "x",
                "near_clip": 0.5,
                "far_clip": 1000.0,
                "to_world": mi.ScalarTransform4f(to_world),
                "sampler": {"type": "multijitter", "sample_count": scene.samples},
                "film": {
                    "type": "hdrfilm",
                    "width": scene.width_px,
                    "height": scene.height_px,
                    "pixel_format": "luminance",
                    "component_format": "float32",
                    "rfilter": {"type": "box"},
                },
            }
        )

    def _mesh(self, path: Path, mesh: tuple[np.ndarray, np.ndarray, np.ndarray], bsdf: dict[str, Any]) -> Any:
        vertices, normals, faces = mesh
        names = ("x", "y", "z", "nx", "ny", "nz")
        header = [f"element vertex {len(vertices)}", *(f"property float {name}" for name in names)]
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        table = np.empty(len(faces), dtype=[("n", "u1"), ("corner", "<i4", 3)])
        table["n"], table["corner"] = 3, faces
        with path.open("wb") as file:
            file.write(("ply\nformat binary_little_endian 1.0\n" + "\n".join(header) + "\nend_header\n").encode())
            file.write(np.hstack([vertices, normals]).astype("<f4").tobytes())
            file.write(table.tobytes())
        return {"type": "ply", "filename": str(path), "bsdf": bsdf}

    def _receiver(self, receiver: Receiver) -> dict[str, Any]:
        scene, found = self._scene, {}
        half = SUPPORT_WIDTH_M / 2
        for k, (first, last) in enumerate(zip(receiver.supports[:-1], receiver.supports[1:], strict=True)):
            if not scene.has_glass:
                continue
            ends = np.array([first + 0.8 * half, last - 0.8 * half])
            middle = receiver.chord(ends) + receiver.glass_off[k] + [0.0, scene.focal_length_m]
            for name, diameter, inside, outside in _glass_faces(scene):
                found[f"glass_{name}_{k}"] = {
                    "type": "cylinder",
                    "p0": [float(middle[0, 0]), float(ends[0]), float(middle[0, 1])],
                    "p1": [float(middle[1, 0]), float(ends[1]), float(middle[1, 1])],
                    "radius": diameter / 2,
                    "bsdf": {"type": "dielectric", "int_ior": inside, "ext_ior": outside},
                }
        sleeve = 1.04 * scene.glass_outer_m / 2 if scene.has_glass else 1.3 * scene.absorber_radius_m
        for k, y in enumerate(receiver.supports):
            x, z = receiver.axis(np.array(y))
            low, high = max(y - half, -scene.length_m / 2), min(y + half, scene.length_m / 2)
            found[f"bellows_{k}"] = {
                "type": "cylinder",
                "p0": [float(x), float(low), float(z)],
                "p1": [float(x), float(high), float(z)],
                "radius": sleeve,
                "bsdf": {"type": "twosided", "inner": _diffuse(0.25)},
            }
            stand = float(np.clip(y, -scene.length_m / 2 + 0.03, scene.length_m / 2 - 0.03))
            found[f"arm_{k}"] = self._box([0.0, stand, z / 2 - 0.02], [0.03, 0.03, z / 2 - 0.04], 0.35)
        return found

    def _box(self, middle: list[float], half: list[float], brightness: float) -> dict[str, Any]:
        t = self._mi.ScalarTransform4f
        to_world = t().translate([float(one) for one in middle]).scale([float(one) for one in half])
        return {"type": "cube", "to_world": to_world, "bsdf": _diffuse(brightness)}

    def _surroundings(self) -> dict[str, Any]:
        mi, scene = self._mi, self._scene
        rng = np.random.default_rng([scene.seed, 5])
        t = mi.ScalarTransform4f
        # Mitsuba's sky has y up.
        sky = {
            "type": "envmap",
            "bitmap": mi.Bitmap(np.repeat(_sky(scene.sky, rng)[..., None], 3, axis=2)),
            "to_world": t().rotate([1, 0, 0], 90),
        }
        soil = (0.30 + 0.12 * _noise((1024, 1024), rng, 1.0)).clip(0.05, 0.8).astype(np.float32)
        ground = {
            "type": "rectangle",
            "to_world": t().translate([0, 0, -2.6]).scale([40, 40, 1]),
            "bsdf": {"type": "diffuse", "reflectance": self._texture(soil)},
        }
        plain = {
            "type": "rectangle",
            "to_world": t().translate([0, 0, -2.65]).scale([400, 400, 1]),
            "bsdf": _diffuse(0.3),
        }
        posts = {
            f"post_{k}": self._box([0.0, side * (scene.length_m / 2 + 0.2), -1.3], [0.15, 0.1, 1.25], 0.4)
            for k, side in enumerate((-1, 1))
        }
        return {"sky": sky, "ground": ground, "plain": plain, **posts}

    def _texture(self, brightness: np.ndarray) -> dict[str, Any]:
        bitmap = self._mi.Bitmap(np.ascontiguousarray(brightness[..., None]))
        return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}

    def _targets(self) -> dict[str, Any]:
        found, scene = {}, self._scene
        for target in targets_of(scene):
            half = target.code.radii.quiet * scene.target_diameter_m / 2
            to_world = np.eye(4)
            to_world[:3, :3] = target.turned @ np.diag([half, half, 1.0])
            to_world[:3, 3] = target.place_m
            # Mitsuba's first row is at the bottom.
            texture = self._texture(np.flipud(drawn_code(target.code)))
            found[f"target_{target.code.name}"] = {
                "type": "rectangle",
                "to_world": self._mi.ScalarTransform4f(to_world),
                "bsdf": {"type": "twosided", "inner": {"type": "diffuse", "reflectance": texture}},
            }
        return found


def _even(value: float) -> dict[str, Any]:
    return {"type": "uniform", "value": value} if "mono" in _variant() else {"type": "rgb", "value": [value] * 3}


def _variant() -> str:
    import mitsuba as mi

    return str(mi.variant())


def _diffuse(brightness: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": _even(brightness)}


def _noise(shape: tuple[int, int], rng: np.random.Generator, power: float) -> np.ndarray:
    """Return noise whose amplitude falls with the frequency's power, of unit variance; it closes around all edges."""
    across, along = np.meshgrid(np.fft.fftfreq(shape[1]) * shape[1], np.fft.fftfreq(shape[0]) * shape[0])
    size = np.hypot(across, along)
    size[0, 0] = 1.0
    spectrum = np.fft.fft2(rng.normal(size=shape)) / size**power
    spectrum[0, 0] = 0.0
    values = np.real(np.fft.ifft2(spectrum))
    return np.asarray(values / values.std())


def _sky(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Return the sky's light over direction, the zenith in the first row."""
    rows, columns = 512, 1024
    up = np.cos((np.arange(rows) + 0.5) / rows * np.pi)[:, None] * np.ones(columns)
    if kind == "overcast":
        light = (1 + 2 * np.maximum(up, 0)) / 3
    else:
        light = 0.45 + 0.35 * (1 - np.maximum(up, 0)) ** 2
    if kind == "clouds":
        light = light + 0.35 / (1 + np.exp(-3.0 * _noise((rows, columns), rng, 1.6)))
    light = np.where(up < 0, 0.2, light)
    return np.asarray(light, dtype=np.float32)
