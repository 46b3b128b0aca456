"""A folder of tests of one heliostat: measurement.toml, a table for each test, limits.toml, the truth."""

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from data_synth.acceptance.plant import TestPlant, daylight, slow_motion
from data_synth.fringes.dataset import SYNTHETIC, TRUTH_FILE
from heliogauge.geometry.sun import sun_directions
from heliogauge.measurement.writer import write_measurement, write_text
from heliogauge.results.json_file import write_json
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.validate import FloatArray, TimeArray

_SECOND = np.timedelta64(1, "s")
_DAYS = ("2026-03-20", "2026-06-21", "2026-09-23")
_LIMITS = """\
# What the heliostat must keep: an entry of the data sheet for each section, in its unit.
# 3 mrad and 5 mrad: Stage-STE 12.6, table 1; the others are examples of an order.
confidence = 0.95

[day_beam_rms_mrad]
most = 2.0
source = "order 2026-017"

[wind_w1_1_beam_rms_mrad]
most = 3.0
source = "Stage-STE 12.6, W1.1"

[wind_w1_2_beam_rms_mrad]
most = 5.0
source = "Stage-STE 12.6, W1.2"

[backlash_azimuth_axis_mrad]
most = 1.7
source = "order 2026-017"

[reflectance_solar_weighted_percent]
least = 93.0
source = "order 2026-017"

[control_faults_answered_percent]
least = 95.0
source = "order 2026-017"

[quality_sd_mrad]
most = 1.5
source = "order 2026-017"
"""


def write_tests_folder(folder: Path, plant: TestPlant | None = None, seed: int = 0, *, force: bool = False) -> None:
    """Draw tests of a heliostat and write the measurement folder, with truth.json.

    force: Replace an earlier synthetic measurement.
    InputError: The folder holds something or cannot be written to.
    """
    plant = plant or TestPlant()
    rng = np.random.default_rng(seed)
    truth: dict[str, Any] = {"seed": seed}
    with WholeFolder(folder, SYNTHETIC, force=force) as working:
        for number, day in enumerate(_DAYS):
            _day(working, plant, rng, truth, f"day_{number + 1}.csv", day)
        _drift(working, plant, rng, truth)
        _repeat(working, plant, rng, truth)
        _wind(working, plant, rng, truth)
        _marks(working, plant, rng, truth)
        _spectra(working, rng, truth)
        _sun_camera(working, plant, rng, truth)
        _control(working)
        hours = np.arange(0, 12.01, 0.5)
        times = np.datetime64("2026-06-21T06:00", "ms") + (hours * 3_600_000).astype(np.int64) * np.timedelta64(1, "ms")
        used = 18.0 * hours + 4.0 * np.cumsum(rng.random(hours.size))
        truth["power_energy_wh"] = float(used[-1] - used[0])
        energy = 40_000 + np.round(used + rng.normal(0, 0.1, hours.size))
        write_table_csv(working / "power.csv", {"time_utc": _texts(times), "energy_wh": np.maximum.accumulate(energy)})
        write_text(working / "limits.toml", _LIMITS)
        write_json(working / TRUTH_FILE, truth)
        write_measurement(working, _content(plant), comment=f"Synthetic tests, seed {seed}; see truth.json.")


def _content(plant: TestPlant) -> Mapping[str, Any]:
    site = plant.site
    return {
        "kind": "heliostat-tests",
        "date": datetime.date(2026, 6, 25),
        "name": "AB12",
        "notes": "Synthetic: drawn by heliogauge heliostat synth --preset tests.",
        "laboratory": {
            "laboratory": "Example laboratory, Solar Street 1, Sun Town",
            "operator": "A. Person",
            "approved_by": "B. Person",
            "order": "2026-017",
            "conditions": "clear sky, DNI above 850 W/m2, 24 to 31 degrees Celsius",
        },
        "site": {"latitude_deg": site.latitude_deg, "longitude_deg": site.longitude_deg, "altitude_m": site.altitude_m},
        "heliostat": {
            "position_m": list(plant.heliostat_m),
            "manufacturer": "Example maker",
            "model": "E-8",
            "year": 2025,
            "width_m": 3.2,
            "height_m": 2.5,
            "facets": 4,
            "focal_length_m": 126.0,
            "drive": "slew drive in azimuth, linear actuator in elevation",
            "controller": f"open loop, update every {plant.update_s:g} s",
        },
        "target": {
            "center_m": list(plant.target_m),
            "facing_azimuth_deg": float(np.degrees(plant.facing_rad)),
            "sigma_aim_m": 0.01,
            "sigma_place_m": plant.place_sigma_m,
        },
        "day": {"file": [f"day_{number + 1}.csv" for number in range(len(_DAYS))]},
        "drift": {"file": "drift.csv", "update_s": plant.update_s},
        "repeat": {"file": "repeat.csv"},
        "wind": {"file": "wind.csv"},
        "backlash": {"marks": "marks.csv", "distance_m": 25.0, "sigma_distance_m": 0.02},
        "sun_camera": {"file": "sun_camera.csv", "sigma_mrad": 0.02},
        "reflectance": {
            "spectra": "spectra.csv",
            "sigma_instrument": 0.004,
            "readings": [0.931, 0.934, 0.929],
            "sigma_reading": 0.005,
        },
        "control": {"file": "control.csv"},
        "power": {"file": "power.csv"},
        "year": {
            "center_m": [0.0, 0.0, 46.0],
            "facing_azimuth_deg": 0.0,
            "tilt_deg": -12.0,
            "width_m": 2.2,
            "height_m": 2.2,
            "slope_mrad": 1.3,
            "canting_mrad": 0.6,
        },
    }


def _texts(times: TimeArray) -> list[str]:
    return [f"{one}Z" for one in times.astype("datetime64[ms]")]


def _seconds(times: TimeArray) -> FloatArray:
    return np.asarray((times - times[0]) / _SECOND, dtype=np.float64)


def _written(
    path: Path,
    plant: TestPlant,
    rng: np.random.Generator,
    times: TimeArray,
    places: FloatArray,
    more: Mapping[str, Any],
) -> None:
    measured = places + rng.normal(0, plant.place_sigma_m, places.shape)
    sigma = np.full(len(times), plant.place_sigma_m)
    columns: dict[str, Sequence[Any] | FloatArray] = {
        "time_utc": _texts(times),
        "x_m": measured[:, 0],
        "y_m": measured[:, 1],
    }
    write_table_csv(path, columns | {"sigma_x_m": sigma, "sigma_y_m": sigma} | dict(more))


def _moved(plant: TestPlant, suns: FloatArray, motion: FloatArray) -> FloatArray:
    """Return places of beams whose normals are on a leaning pedestal and move."""
    normals = plant.leaned(plant.aimed_normals(suns))
    side = np.cross(normals, [0.0, 0.0, 1.0])
    side = side / np.linalg.norm(side, axis=1, keepdims=True)
    moved = normals + motion[:, :1] * side + motion[:, 1:] * np.cross(side, normals)
    return plant.places(moved, suns)


def _day(working: Path, plant: TestPlant, rng: np.random.Generator, truth: dict[str, Any], name: str, day: str) -> None:
    times = daylight(plant.site, day, 240.0, np.radians(12.0))
    suns = sun_directions(times, plant.site)
    places = _moved(plant, suns, slow_motion(rng, _seconds(times), plant.wobble_rad, plant.memory_s))
    _written(working / name, plant, rng, times, places, {})
    truth.setdefault("day_beam_rad", []).append(float(np.sqrt((plant.angles(places) ** 2).mean())))
    truth.setdefault("day_beams", []).append(len(times))
    counts, squares = np.array(truth["day_beams"]), np.array(truth["day_beam_rad"]) ** 2
    truth["day_beam_rms_rad"] = float(np.sqrt(counts @ squares / counts.sum()))


def _drift(working: Path, plant: TestPlant, rng: np.random.Generator, truth: dict[str, Any]) -> None:
    times = np.datetime64("2026-06-22T11:10", "ms") + np.arange(0, 5400, 10) * np.timedelta64(1000, "ms")
    seconds = _seconds(times)
    along = 2 * seconds / seconds[-1] - 1
    drift = 1e-3 * np.stack([1.6 * along**3 - 0.9 * along + 0.3, -0.8 * along**2 + 1.1 * along], axis=1)
    teeth = np.array([1.2e-3, 0.3e-3]) * (((seconds - 17.0) / plant.update_s) % 1.0 - 0.5)[:, None]
    angles = drift + teeth + slow_motion(rng, seconds, 0.25e-3, 120.0)
    _written(working / "drift.csv", plant, rng, times, plant.places_of_angles(angles), {})
    fine = np.linspace(-1, 1, 4001)
    truth["drift_right_beam_rad"] = float(1e-3 * np.ptp(1.6 * fine**3 - 0.9 * fine))
    truth["drift_up_beam_rad"] = float(1e-3 * np.ptp(-0.8 * fine**2 + 1.1 * fine))
    truth["drift_sawtooth_right_beam_rad"], truth["drift_sawtooth_up_beam_rad"] = 1.2e-3, 0.3e-3


def _repeat(working: Path, plant: TestPlant, rng: np.random.Generator, truth: dict[str, Any]) -> None:
    times = np.datetime64("2026-06-22T13:30", "ms") + np.arange(0, 3600, 120) * np.timedelta64(1000, "ms")
    sides = ["east", "west"] * (len(times) // 2)
    shift = np.where([side == "east" for side in sides], 0.4e-3, -0.4e-3)
    angles = np.stack([shift, np.zeros(len(times))], axis=1) + rng.normal(0, [0.2e-3, 0.12e-3], (len(times), 2))
    _written(working / "repeat.csv", plant, rng, times, plant.places_of_angles(angles), {"approach": sides})
    truth |= {"repeat_right_beam_rad": 0.2e-3, "repeat_up_beam_rad": 0.12e-3, "repeat_sides_right_beam_rad": 0.8e-3}


def _wind(working: Path, plant: TestPlant, rng: np.random.Generator, truth: dict[str, Any]) -> None:
    times = np.datetime64("2026-06-23T09:00", "ms") + np.arange(0, 10_800, 60) * np.timedelta64(1000, "ms")
    wind = 3.0 + 9.5 * np.arange(len(times)) / len(times) + rng.normal(0, 0.8, len(times))
    wind = np.clip(wind, 0.5, 13.9)
    motion = plant.gust_rad_s_m * wind[:, None] * rng.normal(0, 1, (len(times), 2))
    places = _moved(plant, sun_directions(times, plant.site), motion)
    _written(working / "wind.csv", plant, rng, times, places, {"wind_m_s": np.round(wind, 2)})
    size = plant.angles(places)
    rounded = np.round(wind, 2)
    truth["wind_w1_1_beam_rms_rad"] = float(np.sqrt((size[rounded <= 8] ** 2).mean()))
    truth["wind_w1_2_beam_rms_rad"] = float(np.sqrt((size[rounded > 8] ** 2).mean()))


def _marks(working: Path, plant: TestPlant, rng: np.random.Generator, truth: dict[str, Any]) -> None:
    axes, ones, others = [], [], []
    for axis, play in zip(("azimuth", "elevation"), plant.play_rad, strict=True):
        begin = 0.3 + 0.2 * rng.random(6)
        axes += [axis] * 6
        ones += (begin + rng.normal(0, 1.5e-3, 6)).tolist()
        others += (begin + 25.0 * np.tan(play) + rng.normal(0, 1.5e-3, 6)).tolist()
        truth[f"backlash_{axis}_axis_rad"] = play
    write_table_csv(working / "marks.csv", {"axis": axes, "mark_1_m": ones, "mark_2_m": others})


def _spectra(working: Path, rng: np.random.Generator, truth: dict[str, Any]) -> None:
    waves = np.arange(300.0, 2501.0, 5.0)
    # Silver behind glass: nothing in the ultraviolet, iron's dip near 1000 nm.
    silver = 0.96 / (1 + np.exp(-(waves - 335) / 9)) - 0.035 * np.exp(-0.5 * ((waves - 1050) / 190) ** 2)
    samples = {
        f"sample_{k + 1}": np.round(silver + rng.normal(0, 0.003) + rng.normal(0, 0.001, waves.size), 4)
        for k in range(4)
    }
    keep = (waves < 845) | (waves > 880)
    truth["mirror_reflectance"] = "0.96 / (1 + exp(-(w - 335) / 9)) - 0.035 exp(-((w - 1050) / 190)^2 / 2)"
    table: dict[str, FloatArray] = {"wavelength_nm": waves[keep]}
    table |= {name: values[keep] for name, values in samples.items()}
    write_table_csv(working / "spectra.csv", table)


def _sun_camera(working: Path, plant: TestPlant, rng: np.random.Generator, truth: dict[str, Any]) -> None:
    times = np.datetime64("2026-06-24T08:00", "ms") + np.arange(0, 14_400, 120) * np.timedelta64(1000, "ms")
    motion = slow_motion(rng, _seconds(times), plant.wobble_rad, plant.memory_s)
    truth["sun_camera_normal_rms_rad"] = float(np.sqrt(((motion - motion[0]) ** 2).sum(axis=1).mean()))
    seen = 1e3 * motion + rng.normal(0, 0.02, motion.shape)
    columns: dict[str, Sequence[Any] | FloatArray] = {"time_utc": _texts(times)}
    columns |= {"azimuth_mrad": seen[:, 0], "elevation_mrad": seen[:, 1]}
    write_table_csv(working / "sun_camera.csv", columns)


def _control(working: Path) -> None:
    begin = np.datetime64("2026-06-25T07:00", "ms")
    rows: list[tuple[int, str, str]] = []
    now = 0
    for event, state, delay in (
        ("reference_search", "initialisation", 20),
        ("tracking", "tracking", 95),
        ("defocus", "standby", 15),
        ("stow", "stow", 240),
        ("communication_loss", "stow", 300),
        ("power_loss", "stow", 280),
        ("component_fault", "fault_message", 2),
    ):
        for number in range(3):
            rows.append((now, event, ""))
            # Once the loss of communication is not answered.
            reached = "standby" if (event, number) == ("communication_loss", 2) else state
            rows.append((now + delay + number, "", reached))
            now += 900
    times = begin + np.array([second for second, _, _ in rows]) * np.timedelta64(1000, "ms")
    columns: dict[str, list[str]] = {
        "time_utc": _texts(times),
        "event": [row[1] for row in rows],
        "state": [row[2] for row in rows],
    }
    write_table_csv(working / "control.csv", columns)
