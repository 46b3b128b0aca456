"""From a trial of a beam to the suns and frames that give a wanted sigma of the canting."""

import datetime
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from calibration.beam.files.comparison import Comparison
from calibration.beam.files.result import LEFT_OUT_FILE
from calibration.beam.keys import BeamsMeasurement
from calibration.beam.mirror.flux_fit import FluxFit, flux_information
from calibration.beam.pipeline import compare
from calibration.beam.planning.sun_choice import ChosenSun, Trial, choose_suns, photo_of_sun, trial_of
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.sun import Site, sun_angles, sun_directions
from heliogauge.results.folder import Summary, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, positive

__all__ = ["BeamPlan", "BeamPlanOptions", "promised_rad", "run"]

#: Times of a day that are compared: the sun moves by its own diameter on a mirror's target in minutes, but what a
#: photo tells changes over hours.
_PER_DAY = 9
#: Lowest sun: below, the air's refraction and its dimming change within a photo's disc of the sun.
_LOWEST_RAD = np.radians(10.0)

#: Equinox and solstices: the sun of all other days stands between theirs.
_SEASONS = tuple(datetime.date(2026, month, 21) for month in (3, 6, 12))


@dataclass(frozen=True, slots=True, eq=False)
class BeamPlanOptions(ShortRepr):
    """What is wanted.

    wanted_rad: Sigma of a facet's canting, RMS over the facets [rad].
    days: Days on which photos can be taken; none: the equinox and both solstices.
    most: Suns at most.
    trial: How the trial is compared: surface, place and mount of the mirror.
    """

    wanted_rad: float = 1e-4
    days: tuple[datetime.date, ...] = ()
    most: int = 20
    trial: compare.CompareOptions = field(default_factory=compare.CompareOptions)


@dataclass(frozen=True, slots=True, eq=False)
class BeamPlan(InstrumentResult):
    """Suns in the order of what they add.

    trial: The comparison of the trial.
    worth: What it says of a unit of information.
    suns: The suns, each with the information of all up to it.
    times (n,): Instants, UTC.
    angles_rad (n, 2): Azimuth from the north over east, and elevation, of each [rad].
    wanted_rad: What is wanted [rad].
    left_out: Suns, or days, that cannot be used: instant or day, and the reason.
    """

    kind: ClassVar[str] = "beam-plan"
    trial: Comparison
    worth: Trial
    suns: tuple[ChosenSun, ...]
    times: tuple[str, ...]
    angles_rad: FloatArray
    wanted_rad: float
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def sigmas_rad(self) -> FloatArray:
        """Sigma of a canting with one frame at each sun up to it, shape (n,) [rad]."""
        return np.array([self.worth.sigma_rad(one.information) for one in self.suns])

    @property
    def frames(self) -> list[int | None]:
        """Frames at each sun up to it that give what is wanted; None where no number does."""
        return [self.worth.frames_for(one.information, self.wanted_rad) for one in self.suns]

    @property
    def cheapest(self) -> tuple[int, int] | None:
        """Suns and frames at each with the fewest photos that give what is wanted; None where none do."""
        plans = [(number, frames) for number, frames in enumerate(self.frames, start=1) if frames is not None]
        return min(plans, key=lambda one: (one[0] * one[1], one[0])) if plans else None

    def summarise(self) -> Summary:
        """Collect the headline numbers of the plan."""
        best, after = self.cheapest, self.trial.after
        numbers: dict[str, float | int | None] = {
            "wanted_sigma_canting_rad": self.wanted_rad,
            "suns_count": None if best is None else best[0],
            "frames_count": None if best is None else best[1],
            "trial_photos_count": len(self.trial.photos),
            "trial_sigma_canting_rad": None if after is None else float(np.sqrt(np.mean(after.sigma_canting_rad**2))),
            "least_planned_sigma_canting_rad": float(self.sigmas_rad[-1]) if np.isfinite(self.sigmas_rad[-1]) else None,
            "noise_share": self.worth.noise / self.worth.variance,
        }
        texts = {
            "sigma": "1 standard deviation of a facet's canting, RMS over facets and directions, for a mirror as the "
            "trial shows it and photos like those of the trial",
            "noise_share": "share of the variance that is the pixels' noise, which more frames average; the rest is "
            "what the model lacks",
        }
        why = "no number of frames and suns gives what is wanted: what the model lacks is more than that"
        if not np.isfinite(self.sigmas_rad[-1]):
            why = self.told_words()
        names = () if best is not None else ("suns_count", "frames_count", "least_planned_sigma_canting_rad")
        missing = {name: why for name in names if numbers[name] is None}
        return self._summary(numbers, texts, missing)

    def told_words(self) -> str:
        """Say what all suns together tell of the canting."""
        count, facets, sigma_mrad = len(self.suns), self.worth.facets, 1e3 * float(self.sigmas_rad[-1])
        if not np.isfinite(sigma_mrad):
            return f"{count} sun{'s do' if count > 1 else ' does'} not tell the canting of {facets} facets apart"
        many_mrad = 1e3 * self.worth.sigma_rad(self.suns[-1].information, 10**9)
        left = f"{count} sun{'s leave' if count > 1 else ' leaves'} the canting at {sigma_mrad:.2g} mrad"
        return f"{left}, with any number of frames at {many_mrad:.2g} mrad"

    def write_files(self, folder: Path) -> None:
        """Write plan.csv, and left_out.csv where suns or days cannot be used."""
        sigmas = 1e3 * self.sigmas_rad
        write_table_csv(
            folder / "plan.csv",
            {
                "suns": list(range(1, len(self.suns) + 1)),
                "time_utc": list(self.times),
                "sun_azimuth_deg": np.degrees(self.angles_rad[:, 0]),
                "sun_elevation_deg": np.degrees(self.angles_rad[:, 1]),
                "sigma_canting_mrad": np.where(np.isfinite(sigmas), sigmas, np.nan),
                "sigma_canting_many_frames_mrad": [
                    value if np.isfinite(value) else np.nan
                    for value in (1e3 * self.worth.sigma_rad(one.information, 10**9) for one in self.suns)
                ],
                "frames": ["" if one is None else str(one) for one in self.frames],
            },
        )
        if self.left_out:
            columns = {"time_utc": list(self.left_out), "reason": list(self.left_out.values())}
            write_table_csv(folder / LEFT_OUT_FILE, columns)

    def headline(self) -> str:
        """Return the plan in a few lines."""
        best, wanted = self.cheapest, 1e3 * self.wanted_rad
        lines = [f"{self.name}: suns for a canting of \u00b1 {wanted:.3g} mrad, {self.worth.facets} facets"]
        shown = range(len(self.suns) if best is None else best[0])
        for number in shown:
            sigma = 1e3 * float(self.sigmas_rad[number])
            said = f"\u00b1 {sigma:.2g} mrad with it" if np.isfinite(sigma) else "not determined yet"
            azimuth, elevation = np.degrees(self.angles_rad[number])
            lines.append(
                f"  {number + 1:2d}  {self.times[number]}  sun at {azimuth:.0f} deg, {elevation:.0f} deg high  {said}"
            )
        if best is None:
            lines.append("  wanted sigma not reached: fewer facets in the light at a time (cover the others)")
        else:
            lines.append(f"  enough: {best[0]} suns, frames at each: {best[1]}")
        return "\n".join(lines)


def run(
    measurement: BeamsMeasurement, options: BeamPlanOptions | None = None, progress: Progress | None = None
) -> BeamPlan:
    """Plan photos of a beam that tell the canting of its mirror.

    measurement: A folder with a trial: photos of the beam at two or three suns.
    InputError: Files that cannot be used, no site, or no sun on these days.
    EstimationError: The trial does not determine the canting at all.
    """
    options, progress = options or BeamPlanOptions(), progress or SilentProgress()
    positive("wanted sigma", options.wanted_rad, "rad")
    site = measurement.model.site
    if site is None:
        raise InputError(f"{measurement.folder}: [site] is needed in measurement.toml: latitude and longitude")
    trial = compare.run(measurement, options.trial, progress)
    if trial.after is None or len(trial.mirror.facets) < 2:
        raise EstimationError(
            "the trial gives no canting to start from: it needs a mirror of two or more facets and photos at two or "
            f"three suns ({'; '.join(one.text for one in trial.doubts) or 'no fit'})"
        )
    worth = trial_of(trial.after, trial.photos, trial.mirror, trial.stand)
    place = Site(site.latitude_deg, site.longitude_deg, site.altitude_m)
    days = {day: _times(day, place) for day in options.days or _SEASONS}
    left_out = {
        day.isoformat(): f"the sun stays below {np.degrees(_LOWEST_RAD):.0f} degrees"
        for day, times in days.items()
        if not times.size
    }
    times = np.concatenate(list(days.values()))
    to_sun = sun_directions(times, place) if times.size else np.zeros((0, 3))
    informations, numbers = [], []
    with progress.stage("suns", len(times)) as stage:
        for number in range(len(times)):
            try:
                informations.append(_told(trial, trial.after, to_sun[number]))
                numbers.append(number)
            except (InputError, EstimationError) as error:
                left_out[_minute(times[number])] = str(error)
            stage.advance()
    if not informations:
        when, why = next(iter(left_out.items()))
        raise InputError(f"suns: there is none at which the mirror can light the target ({when}: {why})")
    chosen = choose_suns(informations, worth.facets, options.most)
    kept = [numbers[one.number] for one in chosen]
    plan = BeamPlan(
        name=trial.name,
        trial=trial,
        worth=worth,
        suns=tuple(chosen),
        times=tuple(_minute(times[one]) for one in kept),
        angles_rad=np.stack(sun_angles(times[kept], place), axis=1),
        wanted_rad=options.wanted_rad,
        left_out=left_out,
        doubts=gather_doubts(_doubts_of_trial(trial), _suns_left_out(left_out, len(times))),
        durations_s=dict(progress.durations_s),
        input_sha256=trial.input_sha256,
    )
    if plan.cheapest is not None:
        return plan
    doubt = Doubt(
        "wanted_sigma_not_reached",
        f"{plan.told_words()}; wanted are {1e3 * options.wanted_rad:.2g} mrad: cover facets, so that fewer are in the "
        "light at a time, or allow more days and suns",
        {"sigma_canting_rad": float(plan.sigmas_rad[-1])},
        Severity.SERIOUS,
    )
    return replace(plan, doubts=gather_doubts(plan.doubts, [doubt]))


def _doubts_of_trial(trial: Comparison) -> list[Doubt]:
    """Return the doubts of the trial; what a plan is the remedy for is said without that remedy."""
    said = []
    for one in trial.doubts:
        if one.code == "canting_not_determined":
            facets, why = len(trial.mirror.facets), trial.why_canting_is_open()
            one = replace(one, text=f"the trial alone does not determine the canting of {facets} facets: {why}")
        said.append(one)
    return said


def promised_rad(plan: BeamPlan, to_sun: FloatArray, frames: int = 1) -> float:
    """Return the sigma of the canting that a plan promises of any suns; infinite where not determined [rad].

    to_sun (n, 3): The suns.
    frames: Photos at each.
    InputError: One at which the mirror cannot light the target, or a trial without a fit.
    """
    after = plan.trial.after
    if after is None:
        raise InputError("trial: nothing was fitted to it")
    told = np.sum([_told(plan.trial, after, one) for one in to_sun], axis=0)
    return plan.worth.sigma_rad(told, frames)


def _told(trial: Comparison, after: FluxFit, to_sun: FloatArray) -> FloatArray:
    """Return what a photo of a sun tells.

    InputError: The mirror cannot light the target.
    EstimationError: It sends no light to it.
    """
    photo = photo_of_sun(trial.photos[0], to_sun, trial.mirror, trial.stand, after)
    return flux_information(photo, trial.mirror, trial.stand, after)


def _suns_left_out(left_out: Mapping[str, str], count: int) -> list[Doubt]:
    """Say which suns cannot be used, with the commonest reason."""
    if not left_out:
        return []
    (reason, times), *_ = Counter(left_out.values()).most_common(1)
    first = next(when for when, why in left_out.items() if why == reason)
    return [
        Doubt(
            "suns_left_out",
            f"{len(left_out)} suns or days of {count} suns cannot be used; {times} x {reason} ({first}); left_out.csv "
            "has all",
            {"left_out_count": len(left_out), "suns_count": count},
            Severity.NOTE,
        )
    ]


def _minute(time: np.datetime64) -> str:
    """Return an instant in words, to the minute."""
    return f"{np.datetime_as_string(time, unit='m')}Z"


def _times(day: datetime.date, site: Site) -> np.ndarray[tuple[int], np.dtype[np.datetime64]]:
    """Return instants spread evenly over the hours of a day with the sun high enough."""
    # Solar noon is in the middle of 24 hours about it, wherever the zone.
    start = np.datetime64(day.isoformat(), "m") - np.timedelta64(round(4 * site.longitude_deg), "m")
    minutes = start + np.arange(0, 24 * 60, 5).astype("timedelta64[m]")
    _, elevation = sun_angles(minutes.astype("datetime64[ms]"), site)
    up = minutes[elevation > _LOWEST_RAD]
    spread = np.linspace(0, up.size - 1, _PER_DAY).round().astype(int) if up.size else np.zeros(0, dtype=int)
    return np.asarray(up[spread].astype("datetime64[ms]"))
