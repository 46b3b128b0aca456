"""What the absorber's axis says to the person who aligns it: offset, tilt, and the sag between supports."""

import itertools
from dataclasses import dataclass

import numpy as np

from heliogauge.validate import BoolArray, FloatArray
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

#: A beam of even weight bends as a polynomial of this degree, however it is held at its supports.
_BEAM_DEGREE = 4
#: Two more measured stations than a polynomial has coefficients, so that noise does not make the sag.
_SPARE_STATIONS = 2
#: Unmeasured pieces between measured ones, longer than this, are taken for supports where none are known [m].
_SUPPORT_GAP_M = 0.15


@dataclass(frozen=True, slots=True)
class Alignment:
    """The straight line that fits the tube best, beside the design's focal line.

    offset_x_m, offset_z_m: Offset in the middle of the length [m].
    tilt_x_rad, tilt_z_rad: Change of the offsets along the trough [rad].
    sigma_offset_x_m, sigma_offset_z_m: Standard deviations [m].
    sigma_tilt_x_rad, sigma_tilt_z_rad: Standard deviations [rad].
    """

    offset_x_m: float
    offset_z_m: float
    tilt_x_rad: float
    tilt_z_rad: float
    sigma_offset_x_m: float
    sigma_offset_z_m: float
    sigma_tilt_x_rad: float
    sigma_tilt_z_rad: float


@dataclass(frozen=True, slots=True)
class Span:
    """The tube between two supports.

    sag_x_m, sag_z_m: How far the middle of the span is from the middle between its ends; NaN where too little was
        seen [m].
    sag_down_m: The same along gravity, positive where the tube hangs down [m].
    sigma_sag_x_m, sigma_sag_z_m, sigma_sag_down_m: Standard deviations [m].
    """

    from_y_m: float
    to_y_m: float
    sag_x_m: float
    sag_z_m: float
    sag_down_m: float
    sigma_sag_x_m: float
    sigma_sag_z_m: float
    sigma_sag_down_m: float


def alignment(path: AbsorberPath, measured: BoolArray, focal_length_m: float) -> Alignment:
    """Fit a straight line to the tube.

    measured (n,): Stations that count; at least two.
    focal_length_m: Height of the design's focal line [m].
    Returns: Offset and tilt; tilts are NaN with one station.
    """
    degree = 1 if np.count_nonzero(measured) >= 2 else 0
    rows = _polynomial_rows(path.y_m, measured, degree)
    offset = rows[0]
    tilt = rows[1] if degree else np.full(path.n, np.nan)
    z = path.z_m - focal_length_m
    zero = np.zeros(path.n)
    sigmas = [
        _sigma(path, np.concatenate(parts)) for parts in ((offset, zero), (zero, offset), (tilt, zero), (zero, tilt))
    ]
    return Alignment(float(offset @ path.x_m), float(offset @ z), float(tilt @ path.x_m), float(tilt @ z), *sigmas)


def supports_of(path: AbsorberPath, measured: BoolArray, collector: Collector) -> FloatArray:
    """Return where the tube is held: as the collector's data say, else where it was hidden; and its ends.

    measured (n,): Stations that were measured.
    collector: Length and supports.
    Returns (k,): Ascending places, at least two [m].
    """
    held = collector.held_y_m
    if held.size >= 2:
        return held
    half = collector.length_m / 2
    inner = held.tolist()
    if not inner:
        seen = path.y_m[measured]
        wide = np.flatnonzero(np.diff(seen) > _SUPPORT_GAP_M + float(np.max(np.diff(path.y_m), initial=0.0)))
        inner = [float(seen[k] + seen[k + 1]) / 2 for k in wide]
    return np.array([-half, *inner, half])


def spans(path: AbsorberPath, measured: BoolArray, supports_m: FloatArray, orientation_rad: float) -> tuple[Span, ...]:
    """Return the sag of the tube between each two supports.

    measured (n,): Stations that count.
    supports_m (k,): Ascending places where the tube is held [m].
    orientation_rad: Turn of the collector from zenith, by the right hand about +y: says where down is [rad].

    Under its own even weight a beam takes the shape of a polynomial of fourth degree, whatever moments its supports
    put on it. That polynomial, fitted to the stations seen, says where the tube is at the supports, which hide it:
    the sag is the middle's distance from the middle between both ends. With few stations the degree is two.
    """
    down = np.array([np.sin(orientation_rad), -np.cos(orientation_rad)])
    return tuple(
        _span(path, measured, (float(one), float(other)), down) for one, other in itertools.pairwise(supports_m)
    )


def _span(path: AbsorberPath, measured: BoolArray, ends: tuple[float, float], down: FloatArray) -> Span:
    inside = measured & (path.y_m > ends[0]) & (path.y_m < ends[1])
    count = int(np.count_nonzero(inside))
    degree = next((k for k in (_BEAM_DEGREE, 2) if count >= k + 1 + _SPARE_STATIONS), 0)
    if not degree:
        return Span(*ends, *np.full(6, np.nan).tolist())
    middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
    rows = _polynomial_rows((path.y_m - middle) / half, inside, degree)
    # Odd terms are the same for the middle and the mean of both ends.
    row = -rows[2::2].sum(axis=0)
    zero = np.zeros(path.n)
    both = (np.concatenate([row, zero]), np.concatenate([zero, row]))
    sag = np.array([row @ path.x_m, row @ path.z_m])
    sigmas = [_sigma(path, one) for one in (*both, down[0] * both[0] + down[1] * both[1])]
    return Span(*ends, float(sag[0]), float(sag[1]), float(down @ sag), *sigmas)


def _polynomial_rows(y: FloatArray, chosen: BoolArray, degree: int) -> FloatArray:
    """Return what turns values at all stations into coefficients of a polynomial, shape (degree + 1, n)."""
    rows = np.zeros((degree + 1, y.size))
    rows[:, chosen] = np.linalg.pinv(np.vander(y[chosen], degree + 1, increasing=True))
    return rows


def _sigma(path: AbsorberPath, row: FloatArray) -> float:
    """Return the standard deviation of a weighted sum of all coordinates."""
    return float(np.sqrt(max(float(row @ path.covariance_m2 @ row), 0.0))) if np.isfinite(row).all() else float("nan")
