"""What errors of the model do to the beam over days, and how an estimate from one day does on others: tables."""

import datetime
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calibration.heliostat.exports.aim_table import Calibrated
from calibration.heliostat.exports.days import SunsOfDay
from calibration.heliostat.files.store_heliostat import read_results, stored_site
from calibration.heliostat.kinematic_model.design import HeliostatDesign, PlaneTarget
from calibration.heliostat.kinematic_model.store_design import design_from
from calibration.heliostat.pipeline.aim import chosen_heliostats
from calibration.heliostat.planning.error_curves import ErrorCurve, error_curve, stability, with_change
from heliogauge.errors import EstimationError, InputError
from heliogauge.files.faults import explain_faults
from heliogauge.geometry.sun import Site, angles_from_direction
from heliogauge.results.folder import write_table_csv
from heliogauge.results.whole_folder import FolderKind, WholeFolder
from heliogauge.validate import FloatArray

CURVES_FILE, DAILY_FILE, STABILITY_FILE, MARK = "curves.csv", "daily.csv", "stability.csv", "curves.txt"
CURVES = FolderKind(content="curves of the error", mark=MARK)
_UNCALIBRATED = "as before the calibration"
_TEXT = """\
Written by heliogauge heliostat curves: the error of the beam over days when the controller has another model than the
heliostat obeys.

daily.csv      a row for each cause and day: RMS of both directions together, least and largest error to the right and
               up, across the line of sight as seen from the heliostat.
curves.csv     the same sun by sun; x_m, y_m on the plane of the target, right and up from its centre.
stability.csv  (with --draws) the model is estimated from beams of the first day with noise, again and again, and
               predicts each day: mean and standard deviation of the daily RMS over the draws.

cause          "as before the calibration": the controller has the numbers from before the calibration, the heliostat
               obeys the calibrated ones. A parameter's name: that parameter alone is off by `change`; "calibration" of
               column `of`: by what the calibration has found, "one": by the size that was asked for.
"""


@dataclass(frozen=True, slots=True)
class CurvesOptions:
    """Choices.

    dates: Days; equinox and solstices of this year if empty.
    step_minutes: Step over each day [min].
    target: Whose centre is aimed at; the first one if None.
    only: Heliostats by name, a text with ``*``; several with commas; all if None.
    change_rad: Error of an angle whose curve is wanted [rad].
    change_m: Error of a length whose curve is wanted [m].
    draws: Draws of the study of stability; 0: none.
    sigma_m: Noise of a measured centre, each axis, in that study [m].
    seed: Of its noise.
    force: Replace earlier curves.
    """

    dates: tuple[datetime.date, ...] = ()
    step_minutes: float = 30.0
    target: str | None = None
    only: str | None = None
    change_rad: float = 1e-3
    change_m: float = 0.01
    draws: int = 0
    sigma_m: float = 0.02
    seed: int = 0
    force: bool = False


class _Cause(NamedTuple):
    """An error of the model: who aims, who obeys."""

    name: str
    of: str
    change: float | str
    unit: str
    truth: HeliostatDesign
    believed: HeliostatDesign


def run(result: Path, out: Path, options: CurvesOptions | None = None) -> list[str]:
    """Write curves of the error of calibrated heliostats.

    result: Folder with ``heliostat.json``, or one with a folder for each heliostat.
    Returns: A sentence for each heliostat.
    InputError: No results there, no such heliostat or target, sizes that cannot be, or the folder cannot be used.
    """
    options = options or CurvesOptions()
    for name in ("change_rad", "change_m", "sigma_m"):
        if not getattr(options, name) > 0:
            raise InputError(f"{name}={getattr(options, name):g}: more than 0 is needed")
    if options.draws < 0:
        raise InputError(f"draws={options.draws}: 0 or more are needed")
    curves: list[dict[str, list[Any]]] = []
    daily: list[dict[str, Any]] = []
    stable: list[dict[str, Any]] = []
    sentences = []
    with explain_faults(result, "a folder of results as heliogauge wrote it"):
        for content in chosen_heliostats(read_results(result), options.only):
            one = _Heliostat.read(content, options)
            rows = [(cause, day, one.curve(cause, day)) for cause in one.causes(options) for day in one.days]
            daily += [one.daily(cause, day, curve) for cause, day, curve in rows]
            curves += [one.columns(cause, day, curve) for cause, day, curve in rows]
            said = one.sentence(rows)
            if options.draws:
                found = one.stability(options)
                stable += found
                said += "; " + _stability_sentence(found)
            sentences.append(said)
    with WholeFolder(out, CURVES, force=options.force) as folder:
        write_table_csv(folder / DAILY_FILE, {key: [row[key] for row in daily] for key in daily[0]})
        write_table_csv(folder / CURVES_FILE, {key: [cell for one in curves for cell in one[key]] for key in curves[0]})
        if stable:
            write_table_csv(folder / STABILITY_FILE, {key: [row[key] for row in stable] for key in stable[0]})
        (folder / MARK).write_text(_TEXT, encoding="utf-8")
    return sentences


class _Day(NamedTuple):
    """A day with its suns."""

    date: datetime.date
    suns: SunsOfDay


@dataclass(frozen=True, slots=True, eq=False)
class _Heliostat:
    """A calibrated heliostat, as it was taken for before, and the days."""

    name: str
    found: HeliostatDesign
    before: HeliostatDesign
    numbers: Mapping[str, Mapping[str, Any]]
    target: PlaneTarget
    days: tuple[_Day, ...]

    @classmethod
    def read(cls, content: Mapping[str, Any], options: CurvesOptions) -> "_Heliostat":
        known = Calibrated.from_content(content)
        before = design_from(content["design"], content["parameters"], key="nominal")
        site = stored_site(content)
        days = tuple(
            _Day(date, SunsOfDay.of(date, options.step_minutes, site)) for date in options.dates or _seasons(site)
        )
        return cls(known.design.name, known.design, before, content["parameters"], known.target(options.target), days)

    def causes(self, options: CurvesOptions) -> Iterator[_Cause]:
        """Yield all that was wrong before together, each parameter that was free alone, and each by a given size."""
        yield _Cause(_UNCALIBRATED, "calibration", "", "", self.found, self.before)
        for name, one in self.numbers.items():
            change = float(one["value"]) - float(one["nominal"])
            if one["state"] != "held" and change != 0:
                believed = with_change(self.found, name, -change)
                yield _Cause(name, "calibration", change, str(one["unit"]), self.found, believed)
        for name, one in self.numbers.items():
            size = {"rad": options.change_rad, "m": options.change_m}.get(str(one["unit"]))
            if one["state"] != "held" and size is not None:
                # The heliostat is off from what the controller has.
                yield _Cause(name, "one", size, str(one["unit"]), with_change(self.found, name, size), self.found)

    def curve(self, cause: _Cause, day: _Day) -> ErrorCurve:
        return error_curve(cause.truth, cause.believed, day.suns.suns, self.target)

    def daily(self, cause: _Cause, day: _Day, curve: ErrorCurve) -> dict[str, Any]:
        right, up = curve.range_rad()
        return {
            "heliostat": self.name,
            "target": self.target.name,
            "cause": cause.name,
            "of": cause.of,
            "change": cause.change,
            "unit": cause.unit,
            "date": str(day.date),
            "suns": len(day.suns.suns),
            "served": curve.served,
            "rms_mrad": _mrad(curve.rms_rad),
            "least_right_mrad": _mrad(right[0]),
            "most_right_mrad": _mrad(right[1]),
            "least_up_mrad": _mrad(up[0]),
            "most_up_mrad": _mrad(up[1]),
        }

    def columns(self, cause: _Cause, day: _Day, curve: ErrorCurve) -> dict[str, list[Any]]:
        count = len(day.suns.suns)
        azimuth, elevation = (np.rad2deg(angle) for angle in angles_from_direction(day.suns.suns))
        return {
            "heliostat": [self.name] * count,
            "cause": [cause.name] * count,
            "of": [cause.of] * count,
            "time_utc": list(day.suns.times_utc),
            "sun_azimuth_deg": azimuth.round(4).tolist(),
            "sun_elevation_deg": elevation.round(4).tolist(),
            "x_m": _cells(curve.places_m[:, 0]),
            "y_m": _cells(curve.places_m[:, 1]),
            "right_mrad": _cells(1e3 * curve.angles_rad[:, 0]),
            "up_mrad": _cells(1e3 * curve.angles_rad[:, 1]),
        }

    def stability(self, options: CurvesOptions) -> list[dict[str, Any]]:
        """Return a row for each day: the estimate from the first day's beams."""
        sigmas = {
            name: float("inf") if one["prior_sigma"] is None else float(one["prior_sigma"])
            for name, one in self.numbers.items()
            if one["state"] != "held"
        }
        # Where the calibration stood before: its numbers, and how well they were known.
        believed = self.found.with_value({name: float(self.numbers[name]["nominal"]) for name in sigmas})
        believed = believed.with_parameters(believed.parameters.with_sigmas(sigmas))
        try:
            found = stability(
                self.found,
                believed,
                self.days[0].suns.suns,
                [day.suns.suns for day in self.days],
                self.target,
                sigma_m=options.sigma_m,
                draws=options.draws,
                seed=options.seed,
            )
        except EstimationError as error:
            raise EstimationError(f"{self.name}: {error}") from error
        mean = found.rms_rad.mean(axis=0)
        spread = found.rms_rad.std(axis=0, ddof=1) if len(found.rms_rad) > 1 else np.full_like(mean, np.nan)
        ratio = mean / mean[0]
        return [
            {
                "heliostat": self.name,
                "estimated_from": str(self.days[0].date),
                "date": str(day.date),
                "sigma_mm": 1e3 * options.sigma_m,
                "draws": len(found.rms_rad),
                "failed": found.failed,
                "rms_mrad": _mrad(float(mean[row])),
                "spread_mrad": _mrad(float(spread[row])),
                "over_first_day_ratio": round(float(ratio[row]), 3) if np.isfinite(ratio[row]) else "",
            }
            for row, day in enumerate(self.days)
        ]

    def sentence(self, rows: list[tuple[_Cause, _Day, ErrorCurve]]) -> str:
        all_together = [curve for cause, _, curve in rows if cause.name == _UNCALIBRATED]
        alone = [(cause.name, curve.rms_rad) for cause, _, curve in rows if cause.of == "calibration" and cause.unit]
        text = f"{self.name}: beam error {_UNCALIBRATED} {_range([one.rms_rad for one in all_together])} mrad a day"
        largest = max(alone, key=lambda one: -1.0 if np.isnan(one[1]) else one[1], default=None)
        if largest is not None and np.isfinite(largest[1]):
            text += f"; most by {largest[0]} ({1e3 * largest[1]:.2f} mrad)"
        return text


def _stability_sentence(rows: list[dict[str, Any]]) -> str:
    first, *others = (one["rms_mrad"] for one in rows)
    known = [one for one in others if one != ""]
    text = f"estimated from {rows[0]['date']} it errs by {_two_digits(first)} mrad on that day"
    if len(others) == 1:
        text += f", {_two_digits(others[0])} mrad on the other"
    elif known:
        text += f", {min(known):.2f} to {max(known):.2f} mrad on the others"
    unknown = [str(one["date"]) for one in rows if one["rms_mrad"] == ""]
    return text + (f"; not known where a draw leaves no beam: {', '.join(unknown)}" if unknown else "")


def _two_digits(value: float | str) -> str:
    return "unknown" if isinstance(value, str) else f"{value:.2f}"


def _seasons(site: Site) -> tuple[datetime.date, ...]:
    year = datetime.datetime.now(datetime.UTC).year
    days = (datetime.date(year, 3, 20), datetime.date(year, 6, 21), datetime.date(year, 12, 21))
    # Beyond the polar circle the sun stays away in winter.
    return tuple(day for day in days if _rises(day, site))


def _rises(day: datetime.date, site: Site) -> bool:
    try:
        SunsOfDay.of(day, 30.0, site)
    except InputError:
        return False
    return True


def _mrad(value: float) -> float | str:
    return round(1e3 * value, 4) if np.isfinite(value) else ""


def _cells(values: FloatArray) -> list[Any]:
    return ["" if not np.isfinite(value) else round(value, 5) for value in values.tolist()]


def _range(values: list[float]) -> str:
    known = [1e3 * one for one in values if np.isfinite(one)]
    return f"{min(known):.2f} to {max(known):.2f}" if known else "unknown"
