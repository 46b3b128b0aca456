"""What a measured trough collects and why: as it is, with its absorber aligned, with perfect mirrors; with sigmas.

The intercept factor's sigma is of first order in slopes and absorber, with their covariances, and holds the second
order of the slopes' scatter (a perfect trough has no first order) and what the mirror's unmeasured part may differ by.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.light.beam import BeamProfile
from observer.light.intercept import (
    MirrorNodes,
    TroughOptics,
    acceptance_windows,
    along_path,
    mirror_nodes,
    station_shares,
)
from observer.light.missing import MissingPart, missing_part
from observer.slopes.slope_sums import with_bridged
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Error of the light's table and its interpolation (`observer.light.beam`), the least sigma there is.
_TABLE_ERROR = 1e-6

#: From weights of all slopes dz/dx, shape (k, ny, nx), to the covariance of the k weighted sums, shape (k, k).
SumCovariance = Callable[[FloatArray], FloatArray]


class Case(Enum):
    """Which of the trough's errors are left in."""

    AS_MEASURED = "as measured"
    ABSORBER_ALIGNED = "absorber in the focal line"
    MIRROR_PERFECT = "perfect mirror"


def covariance_from_map(slope_map: SlopeMap, *, absorber_held: bool = False) -> SumCovariance:
    """Return the covariance of weighted sums of slopes that a slope map itself states.

    slope_map: The mirror with its random and common uncertainty.
    absorber_held: Whether to leave out the common share that comes from the absorber.
    Returns: Weights of dz/dx, shape (k, ny, nx), to the covariance of the sums, shape (k, k).
    """
    variance = slope_map.noise_correlation * np.nan_to_num(slope_map.sigma_random_x) ** 2
    modes = slope_map.common.evaluate(*np.meshgrid(slope_map.x_m, slope_map.y_m))[:, 0]
    kept = [not absorber_held or source != "absorber" for source in slope_map.common.sources]
    modes = modes[np.array(kept, dtype=bool)].reshape(-1, slope_map.slope_x.size)

    def covariance(weights: FloatArray) -> FloatArray:
        flat = weights.reshape(len(weights), -1)
        common = flat @ modes.T
        return np.asarray((flat * variance.reshape(-1)) @ flat.T + common @ common.T)

    return covariance


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredTrough:
    """Mirror and absorber as they were measured, and how well.

    absorber: The tube's axis.
    collector: The design.
    slope_covariance: Covariance of weighted sums of the slopes, the absorber held.
    sigma_slope (m,): Standard deviation of each slope across.
    d_slope_d_stations (m, 2 n): What errors of the absorber's place at its stations, all x and all z, did to the
        slopes; zero where both were measured apart [1/m].
    missing: What of the mirror was not measured.
    """

    nodes: MirrorNodes
    absorber: AbsorberPath
    collector: Collector
    slope_covariance: SumCovariance
    sigma_slope: FloatArray
    d_slope_d_stations: "csr_array"
    missing: MissingPart

    @property
    def radius_m(self) -> float:
        """Radius of the tube [m]."""
        return self.collector.absorber_diameter_m / 2

    def covariance(self, weights: "Sensitivity") -> FloatArray:
        """Return the covariance of numbers that hang on slopes and absorber, shape (k, k)."""
        along = weights.d_absorber + (self.d_slope_d_stations.T @ weights.d_slope_x.T).T
        own = self.slope_covariance(self.nodes.as_map(weights.d_slope_x))
        return np.asarray(own + along @ self.absorber.covariance_m2 @ along.T)


def measured_trough(
    slope_map: SlopeMap,
    absorber: AbsorberPath,
    collector: Collector,
    *,
    slope_covariance: SumCovariance | None = None,
    from_reflection: bool = True,
) -> MeasuredTrough:
    """Put mirror and absorber together.

    absorber: The tube's axis with its covariance.
    slope_covariance: Covariance of weighted sums of slopes, the absorber held where they come from its reflection;
        by default what the map states.
    from_reflection: Whether the slopes come from the absorber's reflection. Then theta_ra was measured and an error
        of the absorber's place is in the slopes too, where it cancels; otherwise slopes and absorber err apart.
    Returns: What `intercept_of` and the other functions here take.
    EstimationError: No node was measured.
    """
    from scipy.sparse import hstack

    nodes = mirror_nodes(slope_map, collector.focal_length_m)
    seen = acceptance_windows(nodes, absorber, collector.absorber_diameter_m / 2)
    moves = seen.d_slope_x != 0
    follows = np.zeros((nodes.node.size, 2))
    if from_reflection:
        follows[moves] = -seen.d_middle_d_absorber[moves] / seen.d_slope_x[moves, None]
    shares = station_shares(absorber, seen.passing_y_m)
    if slope_covariance is None:
        sums = covariance_from_map(slope_map, absorber_held=from_reflection)
    else:
        sums = with_bridged(slope_covariance, slope_map)
    stations = hstack([shares.multiply(one[:, None]) for one in follows.T], format="csr")
    return MeasuredTrough(
        nodes,
        absorber,
        collector,
        sums,
        slope_map.sigma_slope()[0].reshape(-1)[nodes.node],
        stations,
        missing_part(slope_map, collector.panel_edges_x_m),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """Derivatives of k numbers.

    d_slope_x (k, m): With respect to the slopes across of the nodes.
    d_absorber (k, 2 n): With respect to the absorber's stations, the slopes held [1/m].
    """

    d_slope_x: FloatArray
    d_absorber: FloatArray

    def mixed(self, shares: FloatArray) -> "Sensitivity":
        """Return the derivatives of sums of the numbers with given shares, shape (l, k)."""
        return Sensitivity(shares @ self.d_slope_x, shares @ self.d_absorber)


def joined(parts: Sequence[Sensitivity]) -> Sensitivity:
    """Return the derivatives of all numbers."""
    return Sensitivity(
        np.concatenate([part.d_slope_x for part in parts]), np.concatenate([part.d_absorber for part in parts])
    )


def optics_of(trough: MeasuredTrough, case: Case, profile: BeamProfile, incidence_rad: float = 0.0) -> TroughOptics:
    """Return the optics of a trough with some of its errors left out.

    profile: The light, for the same incidence.
    incidence_rad: Angle between the sun and the plane across the trough [rad].
    """
    nodes, absorber = trough.nodes, trough.absorber
    if case is Case.MIRROR_PERFECT:
        nodes = replace(nodes, slope_x=nodes.design_slope_x, slope_y=np.zeros_like(nodes.slope_y))
    if case is Case.ABSORBER_ALIGNED:
        absorber = AbsorberPath.straight(0.0, trough.collector.focal_length_m, trough.collector.length_m / 2)
    return TroughOptics.of(nodes, absorber, trough.radius_m, profile, incidence_rad)


def sensitivity(trough: MeasuredTrough, case: Case, optics: TroughOptics, offset_rad: float = 0.0) -> Sensitivity:
    """Differentiate the intercept factor with respect to what was measured.

    offset_rad: Angle by which the sun stands towards +x of the optical axis [rad].
    """
    d_slope, d_absorber = optics.gradients(offset_rad)
    if case is Case.MIRROR_PERFECT:
        d_slope = np.zeros_like(d_slope)
    along = np.zeros(2 * trough.absorber.n)
    if case is not Case.ABSORBER_ALIGNED:
        along = along_path(optics.stations, d_absorber)
    return Sensitivity(d_slope[None], along[None])


@dataclass(frozen=True, slots=True, eq=False)
class Intercept:
    """Intercept factors with their uncertainty.

    ratio, sigma_ratio (k,): Intercept factors and their standard deviations.
    """

    ratio: FloatArray
    sigma_ratio: FloatArray


def intercept_at_offsets(
    trough: MeasuredTrough, case: Case, optics: TroughOptics, offsets_rad: Sequence[float] | FloatArray = (0.0,)
) -> Intercept:
    """Return the intercept factor for a sun beside the optical axis.

    offsets_rad: Angles by which the sun stands towards +x of the optical axis [rad].
    """
    ratio, rest = np.empty(len(offsets_rad)), np.full(len(offsets_rad), _TABLE_ERROR**2)
    for i, offset in enumerate(offsets_rad):
        values = optics.of_nodes(offset)
        ratio[i] = optics.light(offset) @ values
        if case is not Case.MIRROR_PERFECT:
            rest[i] += (optics.scattered_ratio(trough.sigma_slope, offset) - ratio[i]) ** 2
            rest[i] += trough.missing.sigma(values) ** 2
    variance = np.diagonal(
        trough.covariance(joined([sensitivity(trough, case, optics, offset) for offset in offsets_rad]))
    )
    return Intercept(ratio, np.sqrt(np.maximum(variance, 0.0) + rest))


def intercept_gain(trough: MeasuredTrough, optics: Mapping[Case, TroughOptics], case: Case) -> tuple[float, float]:
    """Return what taking errors away would gain, the sun on the optical axis.

    gain, sigma_gain: Change of the intercept factor, and its standard deviation.
    """
    cases = (case, Case.AS_MEASURED)
    change = joined([sensitivity(trough, one, optics[one]) for one in cases]).mixed(np.array([[1.0, -1.0]]))
    shifts, values = [], []
    for one in cases:
        known, light = one is Case.MIRROR_PERFECT, optics[one]
        shifts.append(0.0 if known else light.scattered_ratio(trough.sigma_slope) - light.ratio())
        values.append(np.zeros(trough.nodes.node.size) if known else light.of_nodes())
    rest = (shifts[0] - shifts[1]) ** 2 + trough.missing.sigma(values[0] - values[1]) ** 2 + _TABLE_ERROR**2
    variance = max(float(trough.covariance(change)[0, 0]), 0.0) + rest
    return optics[case].ratio() - optics[Case.AS_MEASURED].ratio(), float(np.sqrt(variance))
