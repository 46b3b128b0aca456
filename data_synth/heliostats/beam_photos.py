"""Photos of one heliostat's beam on a target at several suns, with all that spoils them, and the truth beside them.

Irradiance is that of `flux` (each point of the target looks back at each patch of the mirror), photos are those of
`photo`; nothing here is shared with what measures beams.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.heliostat.kinematic_model import PlaneTarget
from data_synth.fringes.dataset import SYNTHETIC
from data_synth.heliostats.flux import Beam, FacetErrors, Facets, beam_on_target, canted_facets
from data_synth.heliostats.photo import Light, TargetCamera, TargetSurface, look_at
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.sensor import Sensor
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.images.photos import write_image
from heliogauge.instruments import near_match
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.measurement.writer import dump_toml, write_text
from heliogauge.results.folder import write_json, write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.short_repr import ShortRepr
from heliogauge.sunlight.sun_shapes import BuieSun
from heliogauge.validate import Float32Array, FloatArray

#: What can spoil the photos.
FAULTS: Mapping[str, str] = {
    "haze": "a quarter of the sun's light comes from its aureole",
    "shadow": "the tower's shadow lies across the target",
    "moved-shadow": "the shadow has moved between the empty frames and the photos",
    "panels": "panels of the target differ by 6 % and their seams are 6 cm wide",
    "clouds": "thin clouds pass: beam and daylight change from photo to photo",
    "blooming": "the exposure is three times too long, and full pixels spill along their columns",
    "overexposed": "the exposure is three times too long",
    "underexposed": "the exposure is eight times too short",
    "second-beam": "another heliostat's beam is on the target",
    "cut": "the beam is aimed at the target's edge",
    "vignetting": "the lens loses 60 % of the light in the corners of the photo",
    "night": "no sun: an empty target in the dark",
    "local-time": "times are local, six hours from UTC, and stand as UTC",
    "other-target": "the corners that are stated are those of another target",
}
_SITE = Site(37.094, -2.358, 500.0)
_TARGET = ("upper", (0.0, -3.0, 38.0), 7.0)
_PLACE_M = np.array([9.0, 52.0, 2.2])
_CAMERA_M = np.array([25.0, 95.0, 2.5])
_SIZE_M = (3.2, 2.6)
_DAY = "2025-03-20"


@dataclass(frozen=True, slots=True, eq=False)
class BenchOptions(ShortRepr):
    """What is drawn.

    facets: Facets along width and height.
    suns: Times of the day, evenly from 9 to 16 h.
    repeats: Photos at each.
    canting_rad: Canting errors of the facets, 1 sigma of each component [rad].
    slope_rad: Slope errors finer than the facets, 1 sigma of each component [rad].
    faults: What spoils the photos.
    """

    facets: tuple[int, int] = (2, 2)
    suns: int = 3
    repeats: int = 1
    canting_rad: float = 0.8e-3
    slope_rad: float = 0.8e-3
    faults: tuple[str, ...] = ()
    seed: int = 0
    force: bool = False

    def __post_init__(self) -> None:
        for fault in self.faults:
            if fault not in FAULTS:
                raise InputError(f"fault {fault!r} is not known; {near_match(fault, FAULTS)}")
        if min(self.facets) < 1 or self.suns < 1 or self.repeats < 1:
            raise InputError("facets, suns and repeats: at least one of each is needed")


class _Bench:
    """Mirror, target and camera of one dataset."""

    def __init__(self, options: BenchOptions) -> None:
        self.options = options
        self.rng = np.random.default_rng([options.seed, 11])
        name, center, side = _TARGET
        self.target = PlaneTarget.facing(name, np.array(center), 0.0, side, side)
        distance = float(np.linalg.norm(self.target.center_m - _PLACE_M))
        errors = FacetErrors(cant_rad=options.canting_rad, focus=0.0, slope_rad=options.slope_rad)
        self.facets = canted_facets(options.facets, _SIZE_M, distance, errors, self.rng)
        self.distance_m = distance
        spread, seam = (0.06, 0.06) if "panels" in options.faults else (0.01, 0.02)
        surface = TargetSurface(side, side, panel_spread=spread, seam_width_m=seam, seed=options.seed)
        pose = look_at(_CAMERA_M, self.target.center_m + [0.2, 0.0, -0.15], 0.015)
        camera = PinholeCamera(640, 480, 3900.0, 3900.0, 318.0, 241.0)
        sensor = Sensor(bits=8, read_noise_dn=1.0, shot_gain_dn=0.02)
        # The exposure of one who looks at the first beam: its peak at two thirds of the scale.
        noon = sun_directions(np.array([f"{_DAY}T12:00:00"], dtype="datetime64[ms]"), _SITE)[0]
        peak = float(self.beam(noon, np.zeros(2)).suns.max())
        lost = 0.6 if "vignetting" in options.faults else 0.08
        light = Light(ambient_suns=0.8, full_scale_suns=1.5 * peak, gradient=(0.06, -0.10), vignetting=lost)
        self.camera = TargetCamera(camera, pose, self.target, surface, sensor, light)

    @property
    def design_slopes(self) -> FloatArray:
        """Slopes of the facets' middles on the paraboloid, shape (k, 2)."""
        return np.asarray(self.facets.centers_m[:, :2] / (2 * self.distance_m))

    @property
    def canting_rad(self) -> FloatArray:
        """Turn of each facet's normal from the design towards +x and +y, shape (k, 2) [rad]."""
        slopes = -self.facets.normals[:, :2] / self.facets.normals[:, 2:]
        return np.asarray(np.arctan(self.design_slopes) - np.arctan(slopes))

    def beam(self, to_sun: FloatArray, aim_m: FloatArray, facets: Facets | None = None) -> Beam:
        """Return the irradiance on the target."""
        toward = self.target.points(aim_m[None, :])[0] - _PLACE_M
        normal = to_sun + toward / np.linalg.norm(toward)
        normal = normal / np.linalg.norm(normal)
        right = np.cross([0.0, 0.0, 1.0], normal)
        right = right / np.linalg.norm(right)
        rotation = np.stack([right, np.cross(normal, right), normal], axis=1)
        sun = BuieSun.of_share(0.25) if "haze" in self.options.faults else BuieSun(0.02)
        pose = RigidTransform(rotation, _PLACE_M)
        return beam_on_target(facets or self.facets, pose, to_sun, self.target, sun=sun, pixels=96)

    def photo(self, beam: Beam | None, *, empty: bool = False) -> np.ndarray[Any, np.dtype[Any]]:
        """Take a photo."""
        faults = self.options.faults
        ambient = float(np.exp(0.08 * self.rng.standard_normal()))
        passed = 1.0
        if "clouds" in faults and not empty:
            passed, ambient = float(self.rng.uniform(0.35, 1.0)), float(self.rng.uniform(0.6, 1.3))
        if "night" in faults:
            beam, ambient = None, 0.01
        day = self.camera.expected_light(None, ambient)
        light = day * self._shadow(empty=empty)
        if beam is not None:
            light = light + np.float32(passed) * (self.camera.expected_light(beam, ambient) - day)
        factor = 3.0 if {"overexposed", "blooming"} & set(faults) else 0.125 if "underexposed" in faults else 1.0
        if "blooming" in faults:
            light, factor = _spilled(np.asarray(light * np.float32(factor), dtype=np.float32)), 1.0
        return self.camera.sensor.expose(np.asarray(light, dtype=np.float32), self.rng, factor)

    def _shadow(self, *, empty: bool) -> Float32Array:
        """Share of daylight on each pixel: a straight edge, blurred by the sun's disc."""
        faults = self.options.faults
        if not {"shadow", "moved-shadow"} & set(faults):
            return np.ones_like(self.camera.reflectance)
        offset = 1.2 if "moved-shadow" in faults and empty else -1.0
        across = self.camera.x_m * 0.8 + self.camera.y_m * 0.6 - offset
        return np.asarray(1 - 0.45 * np.clip(0.5 + across / 0.3, 0, 1), dtype=np.float32)


def _spilled(light: Float32Array) -> Float32Array:
    """Let what is beyond the full scale run along the columns, half up and half down, until it finds room."""
    spilled = light.copy()
    for _ in range(60):
        excess = np.maximum(spilled - 1, 0)
        if not excess.any():
            break
        spilled -= excess
        spilled[1:] += 0.5 * excess[:-1]
        spilled[:-1] += 0.5 * excess[1:]
    return spilled


def write_beam_dataset(folder: Path, options: BenchOptions | None = None, progress: Progress | None = None) -> None:
    """Photograph a heliostat's beam and write a measurement folder that is whole or not there.

    folder: Where to write; must be absent or empty.
    progress: Notified of each photo.
    InputError: The folder holds something or cannot be written to.
    """
    chosen, progress = options or BenchOptions(), progress or SilentProgress()
    bench = _Bench(chosen)
    hours = np.linspace(9.0, 16.0, chosen.suns) if chosen.suns > 1 else np.array([11.0])
    minutes = np.repeat((60 * hours).round().astype(int), chosen.repeats)
    times = [f"{_DAY}T{minute // 60:02d}:{minute % 60:02d}:00Z" for minute in minutes.tolist()]
    suns = sun_directions(np.array([time.rstrip("Z") for time in times], dtype="datetime64[ms]"), _SITE)
    stated = times
    if "local-time" in chosen.faults:
        stated = [f"{_DAY}T{(minute // 60 + 6) % 24:02d}:{minute % 60:02d}:00Z" for minute in minutes.tolist()]
    records: list[dict[str, Any]] = []
    names = [f"beam_{number:03d}.png" for number in range(len(times))]
    with WholeFolder(folder, SYNTHETIC, force=chosen.force) as working:
        with progress.stage("take photos", len(names)) as stage:
            for number in range(2):
                write_image(working / f"empty_{number}.png", bench.photo(None, empty=True))
            for name, sun in zip(names, suns, strict=True):
                aim = bench.rng.uniform(-0.4, 0.4, 2) + ([3.4, 0.0] if "cut" in chosen.faults else [0.0, 0.0])
                beam = bench.beam(sun, aim)
                photo = bench.photo(_with_second(bench, beam, sun, aim) if "second-beam" in chosen.faults else beam)
                write_image(working / name, photo)
                records.append(
                    {
                        "file": name,
                        "aim_m": aim.tolist(),
                        "centroid_m": beam.centroid_m.tolist(),
                        "power_m2": beam.power_m2,
                        "peak_suns": float(beam.suns.max()),
                        "d50_m": _diameter(beam, 0.5),
                        "d90_m": _diameter(beam, 0.9),
                        "share_on_target": beam.share_inside(bench.target.width_m, bench.target.height_m),
                        "to_sun": sun.tolist(),
                    }
                )
                stage.advance()
        write_table_csv(working / "photos.csv", {"image": names, "time_utc": stated})
        corners = bench.camera.image_points(bench.camera.surface.corners_m)
        said = corners + 0.1 * bench.rng.standard_normal((4, 2))
        if "other-target" in chosen.faults:
            said = said + [0.0, 1.4 * float(np.ptp(corners[:, 1]))]
        content = dump_toml(_content(bench, said))
        comment = f"# Synthetic measurement, seed {chosen.seed}; see truth.json.\n\n"
        write_text(working / MEASUREMENT_FILE, comment + content)
        truth = {
            "kind": "beam",
            "seed": chosen.seed,
            "faults": list(chosen.faults),
            "canting_rad": bench.canting_rad.tolist(),
            "slope_error_rad": chosen.slope_rad,
            "corners_px": corners.tolist(),
            "photos": records,
        }
        write_json(working / "truth.json", truth)


def _with_second(bench: _Bench, beam: Beam, sun: FloatArray, aim: FloatArray) -> Beam:
    """Add the beam of another heliostat: two metres aside, three quarters as strong."""
    other = bench.beam(sun, aim + [2.1, 0.9])
    step = float(beam.x_m[1] - beam.x_m[0])
    x = np.arange(min(beam.x_m[0], other.x_m[0]), max(beam.x_m[-1], other.x_m[-1]), step)
    y = np.arange(min(beam.y_m[0], other.y_m[0]), max(beam.y_m[-1], other.y_m[-1]), step)
    total = np.zeros((y.size, x.size))
    for one, share in ((beam, 1.0), (other, 0.75)):
        rows = np.array([np.interp(x, one.x_m, line, left=0.0, right=0.0) for line in one.suns])
        total += share * np.array([np.interp(y, one.y_m, line, left=0.0, right=0.0) for line in rows.T]).T
    return Beam(x, y, total)


def _diameter(beam: Beam, share: float) -> float:
    """Diameter of the circle about the centroid with a share of the light, by sorting all points [m]."""
    center = beam.centroid_m
    radius = np.hypot(beam.x_m[None, :] - center[0], beam.y_m[:, None] - center[1]).ravel()
    order = np.argsort(radius)
    inside = np.cumsum(beam.suns.ravel()[order])
    return float(2 * np.interp(share, inside / inside[-1], radius[order]))


def _content(bench: _Bench, corners_px: FloatArray) -> dict[str, Any]:
    target, facets = bench.target, bench.facets
    cantings = -1e3 * np.arctan(bench.design_slopes)
    return {
        "kind": "beam",
        "name": "heliostat on the bench",
        "notes": "Synthetic: made by heliogauge beam synth.",
        "site": {
            "latitude_deg": _SITE.latitude_deg,
            "longitude_deg": _SITE.longitude_deg,
            "altitude_m": _SITE.altitude_m,
        },
        "photos": {"table": "photos.csv"},
        "target": [
            {
                "name": target.name,
                "width_m": target.width_m,
                "height_m": target.height_m,
                "distance_m": round(bench.distance_m, 4),
                "center_m": target.center_m.tolist(),
                "facing_azimuth_deg": 0.0,
            }
        ],
        "images": [
            {
                "target": target.name,
                "corners_px": corners_px.round(2).tolist(),
                "corners_sigma_px": 0.1,
                "empty": "empty_*.png",
            }
        ],
        "mirror": {
            "position_m": _PLACE_M.tolist(),
            "mount": "azimuth-elevation",
            "circumsolar_ratio": 0.02,
            "facet": [
                {
                    "center_m": center.tolist(),
                    "width_m": facets.width_m,
                    "height_m": facets.height_m,
                    "focal_length_m": round(bench.distance_m, 4),
                    "canting_mrad": canting.round(6).tolist(),
                }
                for center, canting in zip(facets.centers_m, cantings, strict=True)
            ],
        },
    }
