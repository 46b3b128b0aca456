"""Optical quality from results of other instruments: slopes, focus, canting, shape of the beam."""

from pathlib import Path

import numpy as np

from calibration.heliostat.performance.beam_series import Estimate
from calibration.heliostat.performance.entries import Entry
from calibration.heliostat.performance.extremes import largest_of
from calibration.heliostat.performance.keys import HeliostatTests, QualitySection, files_of
from calibration.heliostat.performance.pipeline.outcome import Maker, Outcome
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.results.folder import SUMMARY_FILE, Summary, read_slope_map, read_summary
from heliogauge.slopes.removal import Removal
from heliogauge.slopes.statistics import statistics
from heliogauge.validate import FloatArray

SLOPE_MAP_FILE = "slope_map.nc"


def quality_test(tests: HeliostatTests, section: QualitySection) -> Outcome:
    """Slopes, canting and shape of the beam from results."""
    model = tests.model
    distance = None
    if model.target is not None:
        from calibration.heliostat.performance.pipeline.beam_tests import line_of_sight

        distance = line_of_sight(tests).slant_range_m
    entries: list[Entry] = []
    doubts: list[Doubt] = []
    for name in files_of(section.results):
        found, more = entries_of_result(tests.path(name), model.name, distance, tests.date, section.conditions)
        taken = {one.key for one in entries}
        twice = [one.key for one in found if one.key in taken]
        if twice:
            raise InputError(f"quality.results: {name} says {twice[0]} as a result before it does; keep one of them")
        entries += found
        doubts += more
    return Outcome(tuple(entries), tuple(doubts))


def entries_of_result(
    folder: Path, heliostat: str, distance_m: float | None, date: str, conditions: str = ""
) -> tuple[list[Entry], list[Doubt]]:
    """Return entries of a result of another instrument.

    heliostat: Its name; a result of another name is doubted.
    distance_m: To the target, for the focus deviation; None: not known [m].
    InputError: No results, or of a kind that says nothing of a mirror.
    """
    summary = read_summary(folder / SUMMARY_FILE)
    doubts = [one.prefixed(folder.name) for one in summary.doubts if one.severity is not Severity.NOTE]
    if summary.name != heliostat and heliostat not in summary.name.split():
        doubts.append(
            Doubt(
                "result_of_another_name",
                f"quality: {folder.name} is a result of {summary.name!r}, taken as one of {heliostat!r}; look "
                "whether it is "
                "this heliostat's",
            )
        )
    if (folder / SLOPE_MAP_FILE).is_file():
        return _of_slopes(folder, summary, distance_m, date, conditions), doubts
    if summary.kind == "beam":
        return _of_beams(summary, date, conditions), doubts
    raise InputError(
        f"{folder}: results of the kind {summary.kind!r} say nothing of a mirror's quality; a slope map or "
        "measured beams "
        "are needed"
    )


def _of_slopes(folder: Path, summary: Summary, distance_m: float | None, date: str, conditions: str) -> list[Entry]:
    slope_map = read_slope_map(folder / SLOPE_MAP_FILE)
    said = "; ".join(
        text
        for text in (
            conditions,
            f"design {slope_map.design}",
            f"{100 * slope_map.measured_share:.1f} % measured",
            summary.texts.get("mounting", ""),
        )
        if text
    )
    make = Maker("quality", date, said, f"{summary.kind}, {folder.name}")
    entries = []
    for removal, key, words in (
        (Removal.NOTHING, "", "from the design"),
        (Removal.FOCUS, "_best_focus", "from the best-fit focal length, tilt removed"),
    ):
        found = statistics(slope_map, removed=removal)
        values = {
            "x": (found.sdx_rad, found.sigma_sdx_rad, "slope deviation SDx"),
            "y": (found.sdy_rad, found.sigma_sdy_rad, "slope deviation SDy"),
            "": (found.sd_rad, found.sigma_sd_rad, "slope deviation SD"),
        }
        for axis, (value, sigma, label) in values.items():
            note = f"removed: {found.removed}"
            entries.append(
                make.entry(f"sd{axis}{key}_rad", f"Normal's {label} {words}, RMS", Estimate(value, sigma), note)
            )
        if distance_m is not None:
            entries.append(
                make.entry(
                    f"focus_deviation{key}_m",
                    f"Focus deviation FD at {distance_m:.1f} m {words}",
                    Estimate(2 * distance_m * found.sd_rad, 2 * distance_m * found.sigma_sd_rad),
                )
            )
    known = [
        (
            name,
            (facet["canting_x_rad"], facet["canting_y_rad"]),
            (facet.get("sigma_canting_x_rad"), facet.get("sigma_canting_y_rad")),
        )
        for name, facet in summary.facets.items()
        if facet.get("canting_x_rad") is not None and facet.get("canting_y_rad") is not None
    ]
    if known:
        angles = np.array([[float(v or 0.0) for v in values] for _, values, _ in known])
        sigmas = np.array([[float(v or np.nan) for v in values] for _, _, values in known])
        rms = float(np.sqrt((angles**2).sum(axis=1).mean()))
        # d rms / d angle = angle / (n rms).
        sigma = float(np.sqrt(((angles * sigmas) ** 2).sum())) / (len(known) * max(rms, 1e-300))
        entries.append(
            make.entry("canting_rms_rad", f"Canting error of {len(known)} facets' normals, RMS", Estimate(rms, sigma))
        )
        entries.append(_largest_canting(make, [name for name, _, _ in known], angles, sigmas))
    return entries


def _largest_canting(make: Maker, names: list[str], angles: FloatArray, sigmas: FloatArray) -> Entry:
    """Return the largest canting error, or that none is larger than the noise of so many facets."""
    key, label = "canting_largest_rad", "Largest canting error of a facet's normal"
    if not np.isfinite(sigmas).all():
        worst = int(np.argmax((angles**2).sum(axis=1)))
        return make.entry(key, f"{label} ({names[worst]})", Estimate(float(np.hypot(*angles[worst])), float("nan")))
    found = largest_of(angles, sigmas, np.zeros(2))
    if not found.is_seen:
        return make.none_seen(key, label, found.below, f"{len(names)} facets: noise alone gives the largest of them")
    return make.entry(key, f"{label} ({names[found.index]})", found.found)


def _of_beams(summary: Summary, date: str, conditions: str) -> list[Entry]:
    make = Maker("quality", date, conditions, f"moments and encircled light of beams, {summary.name}")
    words = {
        "median_d50_m": "Diameter of the beam that holds 50 % of its light, median",
        "median_d90_m": "Diameter of the beam that holds 90 % of its light, median",
        "median_d95_m": "Diameter of the beam that holds 95 % of its light, median",
        "median_width_major_m": "Standard deviation of the light along the beam's longer axis, median",
        "median_width_minor_m": "Standard deviation of the light along the beam's shorter axis, median",
    }
    entries = []
    for key, label in words.items():
        value, sigma = summary.numbers.get(key), summary.numbers.get(f"sigma_{key}")
        if value is None:
            entries.append(
                make.missing(
                    key.replace("median_", "beam_"), label, summary.not_determined.get(key, "not in the result")
                )
            )
        else:
            entries.append(
                make.entry(
                    key.replace("median_", "beam_"),
                    label,
                    Estimate(float(value), float("nan") if sigma is None else float(sigma)),
                )
            )
    return entries
