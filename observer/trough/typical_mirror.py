"""Slope errors of mirrors, as they usually are or as an earlier measurement found them: for simulated flights."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from heliogauge.short_repr import ShortRepr
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.trough.collector import Collector

#: Waves of a typical mirror, and the range of their periods [m].
_WAVES = 7
_PERIODS_M = (0.5, 3.0)
#: Shares of a typical mirror's variance: panels that are turned, panels that are bent, waves.
_SHARES = np.array([0.15, 0.15, 0.7])


class Mirror(Protocol):
    """Slope errors anywhere on a mirror."""

    def errors(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the errors of dz/dx and dz/dy, shape (m,) each [rad].

        Shapes: x_m, y_m (m,).
        Returns (m,): Errors of both slopes [rad].
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _Waves:
    """Waves in all directions: sum of ``amplitude sin(k . P + phase)``."""

    amplitude_rad: FloatArray
    wave_x: FloatArray
    wave_y: FloatArray
    phase_rad: FloatArray

    @classmethod
    def drawn(cls, rng: np.random.Generator, rms_rad: float) -> "_Waves":
        low, high = np.log(_PERIODS_M)
        period = np.exp(rng.uniform(low, high, _WAVES))
        direction = rng.uniform(0, np.pi, _WAVES)
        amplitude = np.sqrt(period)
        amplitude *= rms_rad / np.sqrt(0.5 * (amplitude**2).sum())
        wave = 2 * np.pi / period
        phase = rng.uniform(0, 2 * np.pi, _WAVES)
        return cls(amplitude, wave * np.cos(direction), wave * np.sin(direction), phase)

    def at(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        total: FloatArray = np.zeros(x_m.shape)
        for amplitude, wave_x, wave_y, phase in zip(
            self.amplitude_rad, self.wave_x, self.wave_y, self.phase_rad, strict=True
        ):
            total = total + amplitude * np.sin(wave_x * x_m + wave_y * y_m + phase)
        return total


@dataclass(frozen=True, slots=True, eq=False)
class TypicalMirror(ShortRepr):
    """A mirror whose panels are turned and bent, with waves over all of them.

    collector: The design with its panels.
    tilts_rad (2, n): Turn of each panel: error of dz/dx and of dz/dy [rad].
    bends_rad (2, n): Slope error at the panel's edge from its bending, across and along [rad].
    waves: Waves of both slopes.
    """

    collector: Collector
    tilts_rad: FloatArray
    bends_rad: FloatArray
    waves: tuple[_Waves, _Waves]

    @classmethod
    def drawn(
        cls, collector: Collector, rng: np.random.Generator, across_rad: float, along_rad: float
    ) -> "TypicalMirror":
        """Draw a mirror.

        collector: The design with its panels.
        across_rad, along_rad: Expected RMS of the errors of dz/dx and dz/dy [rad].
        """
        n = (collector.panel_edges_x_m.size - 1) * (collector.panel_edges_y_m.size - 1)
        rms = np.array([[across_rad], [along_rad]])
        tilts = rng.standard_normal((2, n)) * rms * np.sqrt(_SHARES[0])
        # A slope that grows evenly to its value at the edge has a third of that value's square as mean square.
        bends = rng.standard_normal((2, n)) * rms * np.sqrt(3 * _SHARES[1])
        share = float(np.sqrt(_SHARES[2]))
        waves = (_Waves.drawn(rng, share * across_rad), _Waves.drawn(rng, share * along_rad))
        return cls(collector, tilts, bends, waves)

    def errors(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the errors of dz/dx and dz/dy, shape (m,) each [rad]; those in gaps are of the panel beside."""
        edges_x, edges_y = self.collector.panel_edges_x_m, self.collector.panel_edges_y_m
        column = np.clip(np.searchsorted(edges_x, x_m, side="right") - 1, 0, edges_x.size - 2)
        row = np.clip(np.searchsorted(edges_y, y_m, side="right") - 1, 0, edges_y.size - 2)
        panel = row * (edges_x.size - 1) + column
        found = []
        for axis, (edges, index, place) in enumerate(((edges_x, column, x_m), (edges_y, row, y_m))):
            low, high = edges[index], edges[index + 1]
            inside = (place - 0.5 * (low + high)) / (0.5 * (high - low))
            waves = self.waves[axis].at(x_m, y_m)
            found.append(self.tilts_rad[axis][panel] + self.bends_rad[axis][panel] * inside + waves)
        return found[0], found[1]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMirror:
    """A mirror as an earlier measurement found it; what was not measured is interpolated from what is beside it.

    x_m, y_m: Nodes [m].
    error_x, error_y (ny, nx): Errors of dz/dx and dz/dy at the nodes, all finite [rad].
    """

    x_m: FloatArray
    y_m: FloatArray
    error_x: FloatArray
    error_y: FloatArray

    @classmethod
    def of(cls, slope_map: SlopeMap) -> "MeasuredMirror":
        """Return the mirror of a slope map.

        Returns: The mirror; slopes along the trough that were not measured are taken as the design's.
        """
        return cls(slope_map.x_m, slope_map.y_m, _filled(slope_map.slope_error_x), _filled(slope_map.slope_error_y))

    def errors(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the errors of dz/dx and dz/dy by linear interpolation, shape (m,) each [rad]."""
        column, share_x = _between(self.x_m, x_m)
        row, share_y = _between(self.y_m, y_m)
        found = []
        for values in (self.error_x, self.error_y):
            lower = (1 - share_x) * values[row, column] + share_x * values[row, column + 1]
            upper = (1 - share_x) * values[row + 1, column] + share_x * values[row + 1, column + 1]
            found.append(np.asarray((1 - share_y) * lower + share_y * upper))
        return found[0], found[1]


def _between(nodes: FloatArray, place: FloatArray) -> tuple[np.ndarray, FloatArray]:
    before = np.clip(np.searchsorted(nodes, place, side="right") - 1, 0, nodes.size - 2)
    share = (place - nodes[before]) / (nodes[before + 1] - nodes[before])
    return before, np.clip(share, 0.0, 1.0)


def _filled(values: FloatArray) -> FloatArray:
    """Fill what is missing along each row, then from the next row that has values; zero where nothing is known."""
    filled = np.array(values, dtype=np.float64)
    place = np.arange(filled.shape[1])
    known = np.isfinite(filled)
    rows = np.nonzero(known.any(axis=1))[0]
    if rows.size == 0:
        return np.zeros_like(filled)
    for row in rows:
        own = known[row]
        filled[row] = np.interp(place, place[own], filled[row, own])
    for row in np.nonzero(~known.any(axis=1))[0]:
        filled[row] = filled[rows[np.argmin(np.abs(rows - row))]]
    return filled
