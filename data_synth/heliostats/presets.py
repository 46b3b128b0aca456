"""Plants, heliostats and campaigns for `heliogauge heliostat synth`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.heliostat.kinematic_model import PlaneTarget
from data_synth.heliostats.campaign import Campaign, Disturbances, Plant, Schedule
from data_synth.heliostats.drone import Flight
from data_synth.heliostats.faults import Unit, spoiled
from data_synth.heliostats.flux import FacetErrors
from data_synth.heliostats.mechanics import DriveFlaws, TrueHeliostat, Values
from data_synth.heliostats.photo import Light
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.sensor import Sensor
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site

#: Where each kind's errors are drawn from, and what measurement.toml says of them: one standard deviation [rad, m].
ERROR_SIZES: Mapping[str, Mapping[str, float]] = {
    "azimuth-elevation": {
        "tilt_north": 3e-3,
        "tilt_east": 3e-3,
        "azimuth_offset": 5e-3,
        "elevation_offset": 5e-3,
        "non_orthogonality": 1e-3,
        "position_e": 0.03,
        "position_n": 0.03,
        "position_u": 0.03,
    },
    "six-error": {
        "tilt_north": 3e-3,
        "tilt_east": 3e-3,
        "azimuth_offset": 5e-3,
        "elevation_offset": 5e-3,
        "non_orthogonality": 1e-3,
        "canting": 1e-3,
        "position_e": 0.03,
        "position_n": 0.03,
        "position_u": 0.03,
    },
    "drone": {
        "tilt_about_east": 5e-3,
        "tilt_about_north": 5e-3,
        "azimuth_offset": 0.02,
        "elevation_offset": 0.02,
        "arm_normal": 5e-3,
        "arm_up": 0.02,
        "position_e": 0.02,
        "position_n": 0.02,
        "position_u": 0.02,
    },
    "linear-actuators": {
        "tilt_1_n": 5e-3,
        "tilt_1_u": 5e-3,
        "tilt_2_e": 5e-3,
        "tilt_2_n": 5e-3,
        "initial_angle_1": 2e-3,
        "initial_angle_2": 2e-3,
        "initial_stroke_1": 1e-4,
        "initial_stroke_2": 1e-4,
        "offset_1": 1e-4,
        "offset_2": 1e-4,
        "pivot_radius_1": 1e-4,
        "pivot_radius_2": 1e-4,
        "position_e": 0.02,
        "position_n": 0.02,
        "position_u": 0.02,
    },
}
FREE_SETS = {"azimuth-elevation": "8", "six-error": "6", "drone": "9", "linear-actuators": "15"}
#: Usual numbers of a unit at Juelich.
JUELICH_ACTUATORS: Values = {
    "initial_angle_1": 0.0153,
    "initial_stroke_1": 0.0765,
    "offset_1": 0.3353,
    "pivot_radius_1": 0.3381,
    "increment_1": 154166.6667,
    "initial_angle_2": 0.9359,
    "initial_stroke_2": 0.0764,
    "offset_2": 0.3408,
    "pivot_radius_2": 0.3191,
    "increment_2": 154166.6667,
}
#: Faults of beams, clocks and times, which sightings of a drone have not; and of spots, which photos show themselves.
NOT_OF_SIGHTINGS = ("change-point", "drift", "backlash", "outliers", "south-azimuth", "local-time", "duplicates")
NOT_OF_PHOTOS = ("outliers",)
_JUELICH_LIMITS = ((0.0, 69171.0), (0.0, 75641.0))
_ALMERIA = Site(37.094, -2.358, 500.0)
_JUELICH = Site(50.9134, 6.3878, 90.0)
_STELLENBOSCH = Site(-33.9281, 18.8654, 120.0)


@dataclass(frozen=True, slots=True, eq=False)
class PhotoPlan:
    """Photos of the beams instead of spots in the table.

    camera: Lens.
    place_m: Where the camera stands [m].
    mirror_m: Width and height of each heliostat's mirror of 2 by 2 facets [m].
    light: Ambient light and exposure.
    sensor: Noise and bits.
    empty: Photos of the empty target.
    corner_sigma_px: With which the target's corners in the photos are stated [px].
    """

    camera: PinholeCamera
    place_m: tuple[float, float, float]
    mirror_m: tuple[float, float]
    facets: FacetErrors
    light: Light
    sensor: Sensor
    empty: int = 4
    corner_sigma_px: float = 0.1

    @property
    def is_distorted(self) -> bool:
        """Whether the lens needs a calibration."""
        lens = self.camera
        return any((lens.k1, lens.k2, lens.k3, lens.p1, lens.p2))


@dataclass(frozen=True, slots=True, eq=False)
class HeliostatScene:
    """Everything that a synthetic measurement of heliostats is made from.

    name: What measurement.toml calls it.
    plant: Site and targets.
    units: The heliostats, all of one kind.
    schedule: When beams are looked at.
    flight: A drone that looks at the target in the mirrors, instead of beams.
    photos: Photos of the beams, instead of spots in the table.
    priors: Sigmas that measurement.toml states.
    counts_per_turn: Of rotary drives whose readings are counts.
    states_sun: The table holds the sun's azimuth and elevation.
    """

    name: str
    plant: Plant
    units: tuple[Unit, ...]
    schedule: Schedule
    flight: Flight | None = None
    photos: PhotoPlan | None = None
    priors: Mapping[str, float] | None = None
    counts_per_turn: tuple[float, float] | None = None
    states_sun: bool = False

    @property
    def campaign(self) -> Campaign | None:
        """The schedule with the hours of its days; None where a drone looks instead."""
        return None if self.flight is not None else self.schedule.at(self.plant.site)

    @property
    def kind(self) -> str:
        """Kind of the heliostats."""
        return self.units[0].true.kind

    @property
    def reading_unit(self) -> str:
        """Unit of the readings: counts or rad."""
        return "counts" if self.kind == "linear-actuators" or self.counts_per_turn is not None else "rad"

    def with_disturbances(self, **changes: Any) -> "HeliostatScene":
        """Return the scene with other `Disturbances` of all heliostats, by name; None leaves one as it is."""
        given = {name: value for name, value in changes.items() if value is not None}
        units = tuple(replace(unit, disturbances=replace(unit.disturbances, **given)) for unit in self.units)
        return replace(self, units=units)

    def with_faults(self, faults: tuple[str, ...]) -> "HeliostatScene":
        """Return the scene with faults, each ``FAULT`` (of the next heliostat) or ``FAULT:NAME``.

        InputError: An unknown fault or heliostat, or more faults than heliostats.
        """
        units = list(self.units)
        names = [unit.true.name for unit in units]
        if any(":" not in text for text in faults[len(units) :]):
            raise InputError(f"{len(faults)} faults for {len(units)} heliostats; ask for more heliostats")
        for number, text in enumerate(faults):
            fault, _, name = text.partition(":")
            if name and name not in names:
                raise InputError(f"fault={text}: there is no heliostat {name}; the first is {names[0]}")
            index = names.index(name) if name else number
            if (self.flight is not None and fault in NOT_OF_SIGHTINGS) or (self.photos and fault in NOT_OF_PHOTOS):
                raise InputError(f"fault={text}: preset {self.name!r} does not show it: it has no spots in a table")
            units[index] = spoiled(units[index], fault, self.schedule.days)
        has_south = any("south-azimuth" in unit.faults for unit in units)
        return replace(self, units=tuple(units), states_sun=self.states_sun or has_south)


@dataclass(frozen=True, slots=True)
class HeliostatChoice:
    """What a person may change about a preset; None leaves it.

    seed: Of the heliostats' errors and places.
    observations: Of each heliostat.
    """

    seed: int = 0
    heliostats: int | None = None
    observations: int | None = None


def heliostat_scene(preset: str, choice: HeliostatChoice | None = None) -> HeliostatScene:
    """Return a scene by name.

    choice: Seed and sizes.
    InputError: There is no such preset.
    """
    if preset not in PRESETS:
        raise InputError(f"preset {preset!r}: {', '.join(PRESETS)} are known")
    return PRESETS[preset](HeliostatChoice() if choice is None else choice)


def _small(choice: HeliostatChoice) -> HeliostatScene:
    schedule = Schedule(_days("2025-03-04", 10, 25), 6)
    return _azimuth_elevation("small", choice, 4, schedule, Disturbances(wind_rad=2e-4))


def _field(choice: HeliostatChoice) -> HeliostatScene:
    schedule = Schedule(_days("2025-01-10", 25, 14), 4)
    return _azimuth_elevation("field", choice, 100, schedule, Disturbances(wind_rad=2e-4))


def _images(choice: HeliostatChoice) -> HeliostatScene:
    schedule = Schedule(_days("2025-03-04", 4, 45), 4)
    # Seen from within 30 deg of the target's normal: the centroid of a slanting beam is centimetres off its middle ray.
    scene = _azimuth_elevation("images", choice, 2, schedule, Disturbances(spot_m=(0.01, 0.01), aim_m=0.35), 0.5)
    target = scene.plant.targets[0]
    photos = PhotoPlan(
        PinholeCamera(1024, 768, 6400.0, 6400.0, 509.0, 386.0),
        (25.0, 95.0, 2.5),
        (3.2, 2.6),
        FacetErrors(cant_rad=0.8e-3, focus=0.2, slope_rad=1.3e-3),
        Light(ambient_suns=0.8, full_scale_suns=7.0),
        Sensor(bits=8, read_noise_dn=1.0, shot_gain_dn=0.02),
    )
    return replace(scene, photos=photos, plant=replace(scene.plant, targets=(target,)))


def _images_lens(choice: HeliostatChoice) -> HeliostatScene:
    # 2.4 px at the target's corners, more than ten times what is asked of a centroid.
    scene = _images(choice)
    if scene.photos is None:
        raise InputError("these images have no photos")
    return replace(
        scene, name="images-lens", photos=replace(scene.photos, camera=replace(scene.photos.camera, k1=-4.0))
    )


def _juelich(choice: HeliostatChoice) -> HeliostatScene:
    targets = (
        PlaneTarget.facing("upper", [0.0, -3.2, 43.1], 0.0, 8.6, 7.2),
        PlaneTarget.facing("lower", [0.0, -3.2, 35.9], 0.0, 8.6, 7.2),
        PlaneTarget.facing("second tower", [-17.5, -2.7, 52.0], 0.0, 5.4, 6.4),
    )
    rng = np.random.default_rng([choice.seed, 1])
    count = choice.heliostats or 20
    disturbances = Disturbances((0.03, 0.03), wind_rad=3e-4, aim_m=0.5, count=(1.0, 1.0))
    units = []
    for name, place in zip(_names(count), _places(count, rng), strict=True):
        rest = {f"{joint}_{axis}": 0.0 for joint in ("joint_1", "joint_2", "concentrator") for axis in "enu"}
        nominal = {**_position(place), **_zero_angles("linear-actuators"), **JUELICH_ACTUATORS, **rest}
        nominal["concentrator_n"] = 0.175
        true = TrueHeliostat(name, "linear-actuators", nominal, clockwise=(False, True), limits=_JUELICH_LIMITS)
        units.append(_drawn(true, disturbances, rng))
    schedule = _sized(Schedule(_days("2024-02-05", 25, 17), 4), choice)
    sizes = ERROR_SIZES["linear-actuators"]
    return HeliostatScene("juelich", Plant(_JUELICH, targets), tuple(units), schedule, priors=sizes, states_sun=True)


def _faulty(choice: HeliostatChoice) -> HeliostatScene:
    from data_synth.heliostats.faults import FAULTS

    scene = _juelich(replace(choice, heliostats=choice.heliostats or 2 * len(FAULTS)))
    return replace(scene, name="faulty").with_faults(tuple(FAULTS))


def _stellenbosch(choice: HeliostatChoice) -> HeliostatScene:
    # Malan (2014): table 6.1, with the worm gear of section 6.4 and 1/8 steps of 200 through 30:1.
    values = {
        "position_e": 19.2 + 1.02,
        "position_n": -30.8 - 0.53,
        "position_u": 1.2 + 0.11,
        "tilt_north": -13.27e-3,
        "tilt_east": -4.56e-3,
        "azimuth_offset": -3.79e-3,
        "elevation_offset": 1.12e-3,
        "non_orthogonality": -1.92e-3,
    }
    turn = 2 * np.pi / 48000
    flaws = (DriveFlaws(), DriveFlaws(30.0, (1.5e-3, 0.0, 0.0, 0.0)))
    limits = ((-24000.0, 24000.0), (0.0, 12000.0))
    true = TrueHeliostat("SE1", "azimuth-elevation", values, flaws, rad_per_reading=(turn, turn), limits=limits)
    stated = {"position_e": 19.2, "position_n": -30.8, "position_u": 1.2}
    disturbances = Disturbances((7.6e-3, 7.6e-3), aim_m=0.1, hold_s=13.0, count=(1.0, 1.0))
    target = PlaneTarget.facing("lower", [0.0, 0.0, 13.0], np.pi, 2.0, 2.0)
    days = ("2012-09-02", "2012-09-06", "2012-09-07", "2012-09-08")
    if choice.heliostats not in (None, 1):
        raise InputError(f"heliostats={choice.heliostats}: preset 'stellenbosch' is the one that was published")
    schedule = _sized(Schedule(days, 20, whole_day=True), choice)
    priors = dict.fromkeys(stated, 0.3)
    units = (Unit(true, stated, disturbances),)
    plant = Plant(_STELLENBOSCH, (target,))
    return HeliostatScene("stellenbosch", plant, units, schedule, priors=priors, counts_per_turn=(48000.0, 48000.0))


def _drone(choice: HeliostatChoice) -> HeliostatScene:
    # Gouws (2018), heliostat 1: arm 432.5 and 240 mm, target at (11, 27, 4.25) m, offsets +3 and -3 deg.
    nominal = {
        "arm_normal": 0.4325,
        "arm_up": 0.24,
        "pylon_length": 1.5,
        "tilt_about_east": 0.0,
        "tilt_about_north": 0.0,
        "azimuth_offset": np.radians(-3.0),
        "elevation_offset": np.radians(3.0),
    }
    rng = np.random.default_rng([choice.seed, 2])
    units = []
    for k in range(choice.heliostats or 1):
        # Its place first; the others in rows of five behind it.
        place = np.array([-11.0 + 5.5 * (k % 5), -27.0 - 6.0 * (k // 5), 0.0])
        true = TrueHeliostat(f"{k + 1}", "drone", {**_position(place), **nominal})
        units.append(_drawn(true, Disturbances(), rng))
    target = PlaneTarget.facing("tower", [0.0, 0.0, 4.25], np.pi, 2.0, 2.0)
    flight = Flight((32.0, 70.0), choice.observations or 60)
    plant = Plant(_STELLENBOSCH, (target,))
    schedule = Schedule(("2018-01-10",), 2)
    return HeliostatScene("drone", plant, tuple(units), schedule, flight=flight, priors=ERROR_SIZES["drone"])


PRESETS: Mapping[str, Callable[[HeliostatChoice], HeliostatScene]] = {
    "small": _small,
    "field": _field,
    "juelich": _juelich,
    "faulty": _faulty,
    "stellenbosch": _stellenbosch,
    "drone": _drone,
    "images": _images,
    "images-lens": _images_lens,
}


def _azimuth_elevation(
    name: str,
    choice: HeliostatChoice,
    count: int,
    schedule: Schedule,
    disturbances: Disturbances,
    half_angle: float = 1.1,
) -> HeliostatScene:
    rng = np.random.default_rng([choice.seed, 1])
    count = choice.heliostats or count
    targets = (
        PlaneTarget.facing("upper", [0.0, 0.0, 42.0], 0.0, 7.0, 7.0),
        PlaneTarget.facing("lower", [0.0, 0.0, 34.0], 0.0, 7.0, 7.0),
    )
    nominal = [{**_position(place), **_zero_angles("azimuth-elevation")} for place in _places(count, rng, half_angle)]
    units = tuple(
        _drawn(TrueHeliostat(name, "azimuth-elevation", values), disturbances, rng)
        for name, values in zip(_names(count), nominal, strict=True)
    )
    schedule = _sized(schedule, choice)
    sizes = ERROR_SIZES["azimuth-elevation"]
    return HeliostatScene(name, Plant(_ALMERIA, targets), units, schedule, priors=sizes)


def _drawn(nominal: TrueHeliostat, disturbances: Disturbances, rng: np.random.Generator) -> Unit:
    """Draw the errors of a heliostat whose drawing says `nominal`; heliostats.csv says what the drawing says."""
    sizes = ERROR_SIZES[nominal.kind]
    errors = {name: nominal.values[name] + size * rng.standard_normal() for name, size in sizes.items()}
    return Unit(nominal.with_values(errors), nominal.values, disturbances)


def _places(
    count: int, rng: np.random.Generator, half_angle: float = 1.1
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    # Arcs north of the tower, 6 m of each other along and 8 m between: the field grows outwards.
    places: list[tuple[float, float, float]] = []
    radius = 50.0 if half_angle > 1 else 74.0
    while len(places) < max(count, 60):
        along = np.arange(-half_angle, half_angle, 6.5 / radius) + 0.5 * (6.5 / radius) * (len(places) % 2)
        places += [(radius * np.sin(turn), radius * np.cos(turn), 1.8) for turn in along]
        radius += 8.0
    # Spread over all arcs rather than the first: every one of `count` is as likely from near as from far.
    chosen = rng.permutation(len(places))[:count]
    return np.array(places)[np.sort(chosen)]


def _names(count: int) -> list[str]:
    digits = max(2, len(str(count)))
    return [f"H{number:0{digits}d}" for number in range(1, count + 1)]


def _position(place: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> dict[str, float]:
    return dict(zip(("position_e", "position_n", "position_u"), place.tolist(), strict=True))


def _zero_angles(kind: str) -> dict[str, float]:
    lengths = ("position", "initial", "offset_", "pivot_", "arm")
    return {name: 0.0 for name in ERROR_SIZES[kind] if not name.startswith(lengths)}


def _days(first: str, count: int, step: int) -> tuple[str, ...]:
    days = np.datetime64(first) + step * np.arange(count)
    return tuple(str(day) for day in days)


def _sized(schedule: Schedule, choice: HeliostatChoice) -> Schedule:
    """Return the schedule with so many observations in all, spread over its days."""
    if choice.observations is None:
        return schedule
    days = schedule.days[: max(1, choice.observations)]
    return replace(schedule, days=days, per_day=-(-choice.observations // len(days)))
