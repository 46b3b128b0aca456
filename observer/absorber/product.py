"""What is exported of the absorber: table, numbers, doubts."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from heliogauge.doubts import Doubt, Severity
from heliogauge.flags import SampleFlag
from heliogauge.validate import BoolArray, FloatArray
from observer.absorber.forgotten_glass import glass_doubt
from observer.absorber.position import STATION_TEXTS, AbsorberSolution, StationFate
from observer.absorber.shape import Span, alignment, spans, supports_of
from observer.photo_edges.tube_bearings import beside_support
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

#: A tube that looks thicker or thinner by this share is not the one of the collector's data.
_DIAMETER_SHARE = 0.03
#: ... and by so many pixels: blur, and the background through the glass, change the width of tubes 5 to 7 px wide by up
#: to 0.21 px either way in ray-traced photos.
_DIAMETER_PX = 0.3
#: A place that is less certain than this is reported: it puts 0.5 mrad into the slopes of an LS-2 [m].
_WARN_SIGMA_M = 1.5e-3
#: With less than this share of the stations measured the missing part is reported.
_WARN_SHARE = 0.7

#: What has at most this probability is not of chance: three sigmas.
_BY_CHANCE = 0.0027

_SUPPORT_TEXT = "hidden by a receiver support"


def measured_stations(path: AbsorberPath, solution: AbsorberSolution | None) -> BoolArray:
    """Return which stations of the tube were measured, or given.

    Shapes: result (n,).
    solution: Its measurement; None where the axis was given.
    """
    return np.ones(path.n, dtype=bool) if solution is None else solution.fate == StationFate.MEASURED


def absorber_columns(path: AbsorberPath, solution: AbsorberSolution | None, collector: Collector) -> dict[str, Any]:
    """Return the columns of ``absorber.csv``.

    solution: Its measurement; None where the axis was given.
    Returns: Columns; stations that were not measured have no value but a flag and a reason.
    """
    sigma_x, sigma_z = path.sigma_at(path.y_m)
    without = ~measured_stations(path, solution)
    reasons = np.full(path.n, "", dtype=object)
    photos = np.zeros(path.n, dtype=np.intp)
    if solution is not None:
        photos = solution.n_photos
        reasons = np.array([STATION_TEXTS[StationFate(fate)] for fate in solution.fate], dtype=object)
        behind = beside_support(path.y_m, collector.support_y_m, collector.support_width_m)
        reasons[behind & (solution.fate == StationFate.HIDDEN)] = _SUPPORT_TEXT
    columns = {"x_a_m": path.x_m, "z_a_m": path.z_m, "sigma_x_a_m": sigma_x, "sigma_z_a_m": sigma_z}
    return {
        "y_m": path.y_m,
        **{name: np.where(without, np.nan, values) for name, values in columns.items()},
        "n_photos": photos,
        "flag": np.where(without, int(SampleFlag.NOT_SEEN), 0),
        "reason": reasons.tolist(),
    }


def tube_spans(
    path: AbsorberPath, solution: AbsorberSolution | None, collector: Collector, orientation_rad: float
) -> tuple[Span, ...]:
    """Return the sag between the supports.

    solution: Its measurement; None where the axis was given.
    orientation_rad: Turn of the collector from zenith, by the right hand about +y [rad].
    """
    measured = measured_stations(path, solution)
    return spans(path, measured, supports_of(path, measured, collector), orientation_rad)


def span_columns(found: tuple[Span, ...]) -> dict[str, Any]:
    """Return the columns of ``absorber_spans.csv``."""
    rows = [asdict(span) for span in found]
    return {name: [row[name] for row in rows] for name in Span.__slots__}


def shape_numbers(
    path: AbsorberPath, solution: AbsorberSolution | None, collector: Collector, orientation_rad: float
) -> dict[str, float | int | None]:
    """Return the numbers of the tube's tilt and sag.

    solution: Its measurement; None where the axis was given.
    orientation_rad: Turn of the collector from zenith, by the right hand about +y [rad].
    Returns: Numbers with units in their names; the sag is that of the span where it is largest.
    """
    measured = measured_stations(path, solution)
    line = alignment(path, measured, collector.focal_length_m)
    numbers: dict[str, float | int | None] = {
        "absorber_tilt_x_rad": line.tilt_x_rad,
        "sigma_absorber_tilt_x_rad": line.sigma_tilt_x_rad,
        "absorber_tilt_z_rad": line.tilt_z_rad,
        "sigma_absorber_tilt_z_rad": line.sigma_tilt_z_rad,
        "absorber_stations_measured_count": int(np.count_nonzero(measured)),
        "absorber_stations_count": path.n,
    }
    seen = [span for span in tube_spans(path, solution, collector, orientation_rad) if np.isfinite(span.sag_down_m)]
    if seen:
        worst = max(seen, key=lambda span: abs(span.sag_down_m))
        numbers |= {
            "absorber_sag_down_m": worst.sag_down_m,
            "sigma_absorber_sag_down_m": worst.sigma_sag_down_m,
            "absorber_spans_measured_count": len(seen),
        }
    if solution is not None:
        numbers["absorber_diameter_seen_m"] = solution.diameter_m
    return {name: value for name, value in numbers.items() if value is not None and np.isfinite(value)}


def _hidden_by_chance(path: AbsorberPath, solution: AbsorberSolution, hidden_m: FloatArray) -> float:
    """Return how probable it is that a stretch of the tube is hidden by no thing at its place, at most 1.

    hidden_m (k,): Places between measured stations about which the tube is hidden [m].

    Clouds behind the tube hide it here in one photo and there in another: the number of photos that show a station
    then is one of Poisson's about that of the stations beside it. Hidden is what fewer than two show; each station may
    be so by chance.
    """
    measured = measured_stations(path, solution)
    after = np.searchsorted(path.y_m[measured], hidden_m)
    photos = solution.n_photos[measured]
    beside = float(np.minimum(photos[after - 1], photos[after]).min())
    return min(1.0, path.n * float(np.exp(-beside)) * (1 + beside))


def absorber_doubts(
    path: AbsorberPath, solution: AbsorberSolution | None, collector: Collector, *, is_design: bool
) -> Iterator[Doubt]:
    """Yield what is doubtful about the absorber's place.

    solution: Its measurement; None where the axis was given.
    is_design: Whether the design's place was taken for want of a measured one.
    """
    if is_design:
        per_mm = 1e3 * 1e-3 / (2 * collector.focal_length_m)
        yield Doubt(
            "absorber_not_measured",
            "absorber: its place was not measured, it is taken where the design has it; each millimetre of "
            f"misalignment across stands in theta_r as {per_mm:.2f} mrad",
            {"effect_of_a_millimetre_mrad": per_mm},
        )
        return
    if solution is None:
        return
    glass = glass_doubt(solution.widening, collector)
    if glass is not None:
        yield glass
    off = abs(solution.diameter_m - collector.absorber_diameter_m)
    if off > max(_DIAMETER_SHARE * collector.absorber_diameter_m, _DIAMETER_PX * solution.pixel_m):
        yield Doubt(
            "absorber_diameter_contradicts_photos",
            f"absorber: the tube looks {1e3 * solution.diameter_m:.1f} mm thick, absorber_diameter_mm says "
            f"{1e3 * collector.absorber_diameter_m:.1f}; are the diameter, the targets and the camera right, and is "
            "the tube much darker than what is seen behind it?",
            {"seen_m": solution.diameter_m, "stated_m": collector.absorber_diameter_m},
        )
    measured = measured_stations(path, solution)
    inner = supports_of(path, measured, collector)[1:-1]
    if collector.support_y_m.size == 0 and inner.size:
        places = ", ".join(f"{y:.2f}" for y in inner)
        chance = _hidden_by_chance(path, solution, inner)
        or_sky = "" if chance < _BY_CHANCE else ", or by clouds behind it that look like it: too few photos tell"
        yield Doubt(
            "absorber_supports_not_stated",
            f"absorber: hidden about y = {places} m, as by supports, of which support_y_m says nothing{or_sky}: it is "
            "taken to bend there as anywhere; state the supports, those at the ends too, if these are some",
            {"supports_count": int(inner.size), "by_chance_probability": chance},
            Severity.NOTE,
        )
    if measured.mean() < _WARN_SHARE:
        seen = path.y_m[measured]
        yield Doubt(
            "absorber_measured_in_parts",
            f"absorber: measured at {measured.sum()} of {path.n} stations between y = {seen.min():.2f} and "
            f"{seen.max():.2f} m; the rest is bridged, see absorber.csv",
            {"measured_count": int(measured.sum()), "stations_count": path.n},
        )
    sigma = float(np.median(np.maximum(*path.sigma_at(path.y_m))[measured]))
    if sigma > _WARN_SIGMA_M:
        yield Doubt(
            "absorber_uncertain",
            f"absorber: its place is uncertain by {1e3 * sigma:.1f} mm; photos from both sides at about 45 degrees, "
            "or better known targets, make it certain",
            {"sigma_m": sigma},
        )
