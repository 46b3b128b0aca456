"""From measurement.toml without photos to the time of the night: all times in a table, the best one named."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from deflectometry.pipeline.inputs import build_facets
from deflectometry.stars.keys import StarsMeasurement, load_stars_plan
from deflectometry.stars.pipeline.catalogue import read_catalogue
from deflectometry.stars.pipeline.night import first_orientation, site_of, stated_frame
from deflectometry.stars.planning.predicted_night import PlannedTime, predicted_time
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.sun import sun_angles, utc_times
from heliogauge.results.folder import Summary, hash_files, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import BoolArray

#: Tables of a plan.
TIMES_FILE, FACETS_FILE = "times.csv", "facets.csv"
#: End of nautical twilight: lower, stars of the sixth magnitude and fainter stand out of the sky.
_DARK_RAD = np.radians(-12.0)
_HALF_HOUR = np.timedelta64(30, "m")


@dataclass(frozen=True, slots=True, eq=False)
class StarsPlanResult(InstrumentResult):
    """What each time of the night will give, and the best.

    facets: Names. together: Times whose photos determine all facets, the best first.
    """

    kind: ClassVar[str] = "stars-plan"
    facets: tuple[str, ...]
    times: tuple[PlannedTime, ...]
    together: tuple[PlannedTime, ...]

    @property
    def best(self) -> PlannedTime:
        """The time with the fewest unknown facets and the smallest sigma of canting, whichever way the mirror leans."""
        return self.together[0]

    def summarise(self) -> Summary:
        """Collect the numbers of the best time."""
        best = self.best
        numbers: dict[str, float | int | None] = {
            "stars_count": int(best.stars.sum()),
            "fewest_stars_count": int(best.stars.min()),
            "unknown_facets_count": best.unknown,
            "sigma_canting_rms_rad": best.sigma_rms_rad,
            "sigma_canting_rms_low_rad": best.sigma_range_rad[0],
            "sigma_canting_rms_high_rad": best.sigma_range_rad[1],
            "sigma_canting_largest_rad": float(np.nanmax(best.sigma_canting_rad)),
            "sigma_pointing_x_rad": float(best.sigma_pointing_rad[0]),
            "sigma_pointing_y_rad": float(best.sigma_pointing_rad[1]),
        }
        texts = {
            "best_time": _text(best.time),
            "times_together": ", ".join(_text(one.time) for one in self.together),
            "stars": "of the catalogue down to faintest_magnitude, in facets as designed and stated: one that leans "
            "shows the sky beside, by twice as much",
            "low_high": "sigma of the mirror as stated and of mirrors that lean by sigma_normal_mrad four ways: they "
            "show other stars; the best time is that of the fewest unknown facets and the smallest sigma over all five",
            "sigma": "1 standard deviation of one photo's canting of each facet (a mirror of one facet: of its lean)",
        }
        each = {
            name: {
                "stars_count": int(stars),
                "sigma_canting_x_rad": _or_none(x),
                "sigma_canting_y_rad": _or_none(y),
            }
            for name, stars, (x, y) in zip(
                self.facets, best.stars.tolist(), best.sigma_canting_rad.tolist(), strict=True
            )
        }
        unknown = "the facet's stars cannot be named at the best time"
        keys = ("sigma_canting_x_rad", "sigma_canting_y_rad")
        reasons = dict.fromkeys(keys, unknown) if best.unknown else {}
        return self._summary(numbers, texts, reasons, facets=each)

    def write_files(self, folder: Path) -> None:
        """Write the tables of all times, and of each facet at each, into an existing folder."""
        times = self.times
        write_table_csv(
            folder / TIMES_FILE,
            {
                "time": [_text(one.time) for one in times],
                "sun_elevation_deg": [float(np.degrees(one.sun_elevation_rad)) for one in times],
                "stars": [int(one.stars.sum()) for one in times],
                "fewest_stars": [int(one.stars.min()) for one in times],
                "unknown_facets": [one.unknown for one in times],
                "unknown_facets_mean": [one.unknown_mean for one in times],
                "sigma_canting_rms_rad": [one.sigma_rms_rad for one in times],
                "sigma_canting_rms_low_rad": [one.sigma_range_rad[0] for one in times],
                "sigma_canting_rms_high_rad": [one.sigma_range_rad[1] for one in times],
                "sigma_pointing_x_rad": [float(one.sigma_pointing_rad[0]) for one in times],
                "sigma_pointing_y_rad": [float(one.sigma_pointing_rad[1]) for one in times],
            },
        )
        rows = [
            (_text(one.time), name, int(stars), *sigma)
            for one in times
            for name, stars, sigma in zip(self.facets, one.stars.tolist(), one.sigma_canting_rad.tolist(), strict=True)
        ]
        names = ("time", "facet", "stars", "sigma_canting_x_rad", "sigma_canting_y_rad")
        write_table_csv(folder / FACETS_FILE, {name: [row[k] for row in rows] for k, name in enumerate(names)})

    def headline(self) -> str:
        """Return the best time in a few lines for the terminal."""
        best = self.best
        x, y = (1e3 * best.sigma_pointing_rad).tolist()
        low, high = best.sigma_range_rad
        return (
            f"{self.name}: best photo at {_text(best.time)}\n"
            f"  stars            {best.stars.sum()} in {len(self.facets)} facets, {best.stars.min()} in the poorest\n"
            f"  canting          sigma {1e3 * best.sigma_rms_rad:.4f} mrad RMS, "
            f"{1e3 * low:.4f} to {1e3 * high:.4f} if the mirror leans\n"
            f"  mirror's lean    sigma {x:.4f} mrad in x, {y:.4f} mrad in y"
        )


def _text(time: np.datetime64) -> str:
    return f"{np.datetime_as_string(time, unit='s')}Z"


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def run_folder(folder: Path, progress: Progress | None = None) -> StarsPlanResult:
    """Read a folder whose photos need not be there yet, and plan as `run`."""
    return run(load_stars_plan(folder), progress)


def run(measurement: StarsMeasurement, progress: Progress | None = None) -> StarsPlanResult:
    """Compare times of a night and name the best.

    InputError: Times that cannot be read or are in daylight; pyerfa or the catalogue is not installed.
    EstimationError: There is no darkness, no time shows stars in every facet, or corners contradict the camera's place.
    """
    progress, model = progress or SilentProgress(), measurement.model
    facets = build_facets(model.mirror, model.name)
    if not facets:
        raise InputError(f"{measurement.folder}: mirror.outline_m or [[mirror.facet]] is needed")
    times = _times(measurement)
    # Refuses what the measurement will refuse.
    first_orientation(measurement, stated_frame(measurement))
    with progress.stage("catalogue"):
        catalogue = read_catalogue().brighter(float(model.evaluation.faintest_magnitude))
    found = []
    with progress.stage("times", steps=len(times)) as stage:
        for time in times:
            found.append(predicted_time(measurement, catalogue, facets, time))
            stage.advance()
    names = tuple(one.name for one in facets)
    together = _together(found, names)
    return StarsPlanResult(
        name=model.name,
        facets=names,
        times=tuple(found),
        together=together,
        doubts=tuple(_doubts(together)),
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(measurement.files_before, measurement.folder),
    )


def _times(measurement: StarsMeasurement) -> list[np.datetime64]:
    """Return the stated times, or every half hour of darkness around the first photo's.

    InputError: A stated time is in daylight.
    EstimationError: It does not get dark.
    """
    stated, site = measurement.model.plan.times, site_of(measurement)
    if stated:
        times = utc_times(stated)
        elevations = sun_angles(times, site)[1]
        if (elevations > _DARK_RAD).any():
            n = int(np.argmax(elevations))
            raise InputError(
                f"plan.times: at {stated[n]} the sun stands at {np.degrees(elevations[n]):.0f} degrees; stars need it "
                "12 degrees below the horizon: check the zone"
            )
        return list(times)
    (first,) = utc_times([measurement.model.photo[0].time])
    middle = first.astype("datetime64[h]").astype("datetime64[ms]")
    day = middle + np.arange(-24, 25) * _HALF_HOUR
    dark = sun_angles(day, site)[1] <= _DARK_RAD
    if not dark.any():
        raise EstimationError(
            f"the sun does not get 12 degrees below the horizon within 12 h of {measurement.model.photo[0].time}: "
            "it is too light for stars; name another night in photo.time"
        )
    # The night that the photo is in, or the nearest.
    inside = int(np.flatnonzero(dark)[np.argmin(np.abs(day[dark] - first))])
    low, high = inside, inside
    while low > 0 and dark[low - 1]:
        low -= 1
    while high + 1 < dark.size and dark[high + 1]:
        high += 1
    return list(day[low : high + 1])


def _together(times: Sequence[PlannedTime], facets: Sequence[str]) -> tuple[PlannedTime, ...]:
    """Return the best time, and after it those that add the facets which it leaves unknown.

    EstimationError: A facet shows at no time stars that can be named.
    """
    ever = np.any([one.is_known for one in times], axis=0)
    if not ever.all():
        never = [name for name, known in zip(facets, ever.tolist(), strict=True) if not known]
        most = int(max(one.stars[~ever].max() for one in times))
        raise EstimationError(
            f"the sky does not determine the canting: {len(never)} of {len(facets)} facets ({', '.join(never[:5])}"
            f"{' ...' if len(never) > 5 else ''}) show no stars that can be named at any of {len(times)} times (at "
            f"most {most} in a facet); turn the mirror to a higher or richer part of the sky, or expose for fainter "
            "stars (evaluation.faintest_magnitude)"
        )
    chosen: list[PlannedTime] = []
    open_facets = np.ones(len(facets), dtype=bool)
    while open_facets.any():
        useful = [one for one in times if (one.is_known & open_facets).any()]
        best = min(useful, key=lambda one: _rank(one, open_facets))
        chosen.append(best)
        open_facets = open_facets & ~best.is_known
    return tuple(chosen)


def _rank(one: PlannedTime, open_facets: BoolArray) -> tuple[float, float]:
    """Return what is to be small: unknown facets, whichever way the mirror leans; sigmas of those leans."""
    added = int(np.count_nonzero(one.is_known & open_facets))
    each = [photo.sigma_rms_rad for photo in (one, *one.leaning)]
    return one.unknown_mean - added, float(np.sqrt(np.nanmean(np.square(each))))


def _doubts(together: Sequence[PlannedTime]) -> Iterator[Doubt]:
    best = together[0]
    if len(together) > 1:
        yield Doubt(
            "plan_needs_several_photos",
            f"{best.unknown} facets stay unknown at the best time; photos at "
            f"{', '.join(_text(one.time) for one in together)} together determine all",
            {"facets_count": best.unknown, "photos_count": len(together)},
        )
    elif best.unknown_mean:
        yield Doubt(
            "plan_depends_on_lean",
            f"if the mirror leans by sigma_normal_mrad, {best.unknown_mean:.1f} facets of {len(best.stars)} stay "
            "unknown on average at the best time: take several photos over the night",
            {"unknown_share": best.unknown_mean / len(best.stars)},
        )
