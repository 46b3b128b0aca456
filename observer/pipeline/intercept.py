"""What a measured trough collects: numbers, curves over tracking offset and incidence, and where to align to."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.results.folder import write_table_csv
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.light.beam import BeamProfile, beam_profile, sun_profile
from observer.light.best import Best, best_absorber, best_offset
from observer.light.cases import (
    Case,
    Intercept,
    MeasuredTrough,
    SumCovariance,
    intercept_at_offsets,
    intercept_gain,
    measured_trough,
    optics_of,
)
from observer.light.intercept import TroughOptics
from observer.light.panel_gains import PanelGains, panel_gains
from observer.light.spread import BeamSpread, beam_spread, gaussian_short_form
from observer.light.trace import Sunlight, TracedIntercept, trace_intercept
from observer.product.panel_alignment import PanelTilts
from observer.product.panel_turns import is_worth
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

#: Tracking offsets of the curve [rad]: beyond 12 mrad every trough loses most of the light at its rims.
OFFSETS_RAD = 1e-3 * np.arange(-12.0, 13.0)
#: Incidence angles along the trough of the table [rad].
INCIDENCES_RAD = np.radians(np.arange(0.0, 61.0, 15.0))
#: Rays that check the integral: 0.0003 of sampling error at an intercept factor of 0.9.
_RAYS = 1_000_000
#: Every so many points of the beam spread are written: 0.1 mrad apart on an LS-2.
_SPREAD_STEP = 8

Numbers = dict[str, float | int | None]


@dataclass(frozen=True, eq=False)
class InterceptCurves:
    """What the trough collects beside the optical axis and under incidence; thirty sigmas that few ask for.

    trough: Mirror and absorber as they were measured.
    optics: The same in the light, for each case.
    sun: The sun, edge on.
    scatter: Specularity and tracking error, as `observer.light.beam.beam_profile` takes them.
    """

    trough: MeasuredTrough
    optics: dict[Case, TroughOptics]
    sun: BeamProfile
    scatter: dict[str, float]

    @cached_property
    def as_measured(self) -> Intercept:
        """Intercept factors as measured, at `OFFSETS_RAD`."""
        return intercept_at_offsets(self.trough, Case.AS_MEASURED, self.optics[Case.AS_MEASURED], OFFSETS_RAD)

    @cached_property
    def others(self) -> dict[Case, FloatArray]:
        """The same for the other cases, ratios only."""
        cases = [case for case in Case if case is not Case.AS_MEASURED]
        return {case: np.array([self.optics[case].ratio(one) for one in OFFSETS_RAD]) for case in cases}

    @cached_property
    def incidence(self) -> Intercept:
        """Intercept factors as measured, at `INCIDENCES_RAD`."""
        parts = []
        for incidence in INCIDENCES_RAD:
            profile = beam_profile(self.sun, **self.scatter, incidence_rad=float(incidence))
            optics = optics_of(self.trough, Case.AS_MEASURED, profile, float(incidence))
            parts.append(intercept_at_offsets(self.trough, Case.AS_MEASURED, optics))
        ratios, sigmas = zip(*((one.ratio, one.sigma_ratio) for one in parts), strict=True)
        return Intercept(np.concatenate(ratios), np.concatenate(sigmas))


@dataclass(frozen=True, slots=True, eq=False)
class InterceptResult:
    """What the trough collects.

    cases: Intercept factor with and without each contribution, the sun on the optical axis.
    gains: What taking a contribution away gains, with its sigma.
    curves: Over tracking offset and incidence, computed when they are asked for.
    offset: The best tracking offset; None where there is none within the curve.
    shift: The best way of the absorber; None where it is longer than 50 mm.
    panels: What turning panels gains.
    short_form: Intercept factor of Gaussians with the same RMS.
    spread: Light about the direction to the absorber, pooled over the aperture.
    traced: Intercept factor by counting rays.
    measured_share: Share of the mirror that was measured.
    measured_ratio: Intercept factor of that share alone.
    light: Sun and scatter in words.
    doubts: What makes it doubtful.
    """

    cases: dict[Case, Intercept]
    gains: dict[Case, tuple[float, float]]
    curves: "InterceptCurves"
    offset: Best | None
    shift: Best | None
    panels: PanelGains
    short_form: float
    spread: BeamSpread
    traced: TracedIntercept
    measured_share: float
    measured_ratio: float
    light: str
    doubts: tuple[Doubt, ...]

    @property
    def assumption(self) -> str:
        """What the intercept factor stands on, in words."""
        return (
            f"{100 * (1 - self.measured_share):.1f} % of the mirror was not measured and is taken to be as the rest at "
            "the same distance from the vertex; reflectance, absorptance, the tube's shadow and light beyond its ends "
            "are not counted"
        )


def evaluate_intercept(
    light: Sunlight,
    slope_map: SlopeMap,
    absorber: AbsorberPath,
    collector: Collector,
    tilts: PanelTilts,
    slope_covariance: SumCovariance | None = None,
) -> InterceptResult:
    """Compute what the measured trough collects in some light.

    tilts: Mean theta_ra of each panel.
    slope_covariance: Covariance of weighted sums of slopes; by default what the map states.
    Returns: Intercept factors by three ways, with contributions, curves and prescriptions.
    EstimationError: No node of the mirror was measured.
    """
    scatter = {"specularity_rad": light.specularity_rad, "tracking_error_rad": light.tracking_error_rad}
    sun = sun_profile(light.sun)
    profile = beam_profile(sun, **scatter)
    trough = measured_trough(slope_map, absorber, collector, slope_covariance=slope_covariance)
    optics = {case: optics_of(trough, case, profile) for case in Case}
    own = optics[Case.AS_MEASURED]
    doubts: list[Doubt] = []
    traced = trace_intercept(
        slope_map,
        absorber,
        collector.absorber_diameter_m,
        light,
        rays=_RAYS,
        rng=np.random.Generator(np.random.SFC64(0)),
    )
    if abs(traced.ratio - own.ratio()) > 5 * traced.sampling_sigma + 3e-4:
        text = (
            f"intercept factor: {own.ratio():.4f} by integration but {traced.ratio:.4f} by {traced.rays} rays; "
            "either the absorber is far from where the mirror throws the light, or the map's nodes are too far apart"
        )
        numbers = {"integrated_ratio": own.ratio(), "traced_ratio": traced.ratio}
        doubts.append(Doubt("intercept_factors_contradict", text, numbers))
    offset, shift = _best(trough, own, profile, doubts)
    inside = np.full(trough.nodes.node.size, 1.0 / trough.nodes.node.size)
    panel = collector.panel_index(*trough.nodes.points_m[:, :2].T)
    return InterceptResult(
        cases={case: intercept_at_offsets(trough, case, optics[case]) for case in Case},
        gains={case: intercept_gain(trough, optics, case) for case in Case if case is not Case.AS_MEASURED},
        curves=InterceptCurves(trough, optics, sun, scatter),
        offset=offset,
        shift=shift,
        panels=panel_gains(trough, own, panel, tilts.tilt_rad, tilts.sigma_rad),
        short_form=_short_form(trough, optics, sun, scatter),
        spread=beam_spread(own),
        traced=traced,
        measured_share=trough.nodes.measured_share,
        measured_ratio=float(inside @ own.of_nodes()),
        light=_words_of(light, profile),
        doubts=tuple(doubts),
    )


def _words_of(light: Sunlight, profile: BeamProfile) -> str:
    """Say in what light the intercept factor holds, and where nothing beside sun and measured errors spreads it."""
    if light.specularity_rad or light.tracking_error_rad:
        return profile.words
    return f"{profile.words}: the sun and the measured errors alone; [optics] adds specularity and tracking"


def _best(
    trough: MeasuredTrough, own: TroughOptics, profile: BeamProfile, doubts: list[Doubt]
) -> tuple[Best | None, Best | None]:
    """Return the best tracking offset and the best way of the absorber; a doubt where one lies too far away."""
    offset, shift = None, None
    try:
        offset = best_offset(trough, Case.AS_MEASURED, own)
    except EstimationError as error:
        doubts.append(Doubt("best_offset_not_determined", str(error)))
    try:
        shift = best_absorber(trough, own, profile)
    except EstimationError as error:
        doubts.append(Doubt("best_absorber_place_not_determined", str(error)))
    return offset, shift


def _short_form(
    trough: MeasuredTrough, optics: dict[Case, TroughOptics], sun: BeamProfile, scatter: dict[str, float]
) -> float:
    """Return the Gaussian short form with the RMS of theta_r and of theta_a."""
    sigmas = []
    for case in (Case.ABSORBER_ALIGNED, Case.MIRROR_PERFECT):
        windows = optics[case].windows
        twice = 0.5 * (windows.lower_rad + windows.upper_rad)
        sigmas.append(0.5 * float(np.sqrt(trough.nodes.share @ twice**2)))
    return gaussian_short_form(trough.collector, sun, sigma_r_rad=sigmas[0], sigma_a_rad=sigmas[1], **scatter)


def intercept_numbers(result: InterceptResult) -> tuple[Numbers, dict[str, str]]:
    """Return the numbers for summary.json.

    result: What was computed.
    """
    numbers: Numbers = {}

    def put(key: str, value: float, sigma: float) -> None:
        numbers[key], numbers[f"sigma_{key}"] = value, sigma

    for case, key in (
        (Case.AS_MEASURED, "intercept_ratio"),
        (Case.ABSORBER_ALIGNED, "intercept_absorber_aligned_ratio"),
        (Case.MIRROR_PERFECT, "intercept_mirror_perfect_ratio"),
    ):
        put(key, float(result.cases[case].ratio[0]), float(result.cases[case].sigma_ratio[0]))
    put("intercept_gain_absorber_aligned_ratio", *result.gains[Case.ABSORBER_ALIGNED])
    put("intercept_gain_mirror_perfect_ratio", *result.gains[Case.MIRROR_PERFECT])
    put("intercept_gain_panels_turned_ratio", result.panels.together_ratio, result.panels.sigma_together_ratio)
    numbers["panels_count"], numbers["panels_to_turn_count"] = result.panels.sure.size, int(result.panels.sure.sum())
    worth = result.panels.sure & is_worth(result.panels.gain_ratio)
    numbers["panels_worth_turning_count"] = int(worth.sum())
    put("intercept_traced_ratio", result.traced.ratio, result.traced.sampling_sigma)
    numbers["intercept_pooled_ratio"] = result.spread.ratio
    numbers["intercept_short_form_ratio"] = result.short_form
    share = result.measured_share
    numbers["intercept_rest_lost_ratio"] = share * result.measured_ratio
    numbers["intercept_rest_caught_ratio"] = share * result.measured_ratio + 1 - share
    why: dict[str, str] = {}
    _put_best(numbers, why, result.offset, ("best_tracking_offset_rad",), "intercept_best_tracking_ratio")
    _put_best(
        numbers,
        why,
        result.shift,
        ("best_absorber_shift_x_m", "best_absorber_shift_z_m"),
        "intercept_best_absorber_ratio",
    )
    return numbers, why


def _put_best(numbers: Numbers, why: dict[str, str], best: Best | None, keys: tuple[str, ...], ratio_key: str) -> None:
    if best is None:
        for key in (*keys, ratio_key):
            numbers[key], why[key] = None, "it lies too far away, see the warnings"
        return
    if not np.isfinite(best.covariance).all():
        # What it would be at a place that nobody can name helps nobody.
        for key in (*keys, ratio_key):
            numbers[key], why[key] = None, "the intercept factor hardly changes there: the maximum is flat"
        return
    numbers[ratio_key] = best.ratio
    for i, key in enumerate(keys):
        numbers[key], numbers[f"sigma_{key}"] = float(best.place[i]), float(np.sqrt(best.covariance[i, i]))


def write_intercept(result: InterceptResult, folder: Path) -> None:
    """Write the curves.

    result: What was computed.
    folder: An existing folder; gets ``intercept.csv``, ``intercept_incidence.csv`` and ``beam_spread.csv``.
    """
    write_table_csv(
        folder / "intercept.csv",
        {
            "tracking_offset_rad": OFFSETS_RAD,
            "intercept_ratio": result.curves.as_measured.ratio,
            "sigma_intercept_ratio": result.curves.as_measured.sigma_ratio,
            "intercept_absorber_aligned_ratio": result.curves.others[Case.ABSORBER_ALIGNED],
            "intercept_mirror_perfect_ratio": result.curves.others[Case.MIRROR_PERFECT],
        },
    )
    write_table_csv(
        folder / "intercept_incidence.csv",
        {
            "incidence_rad": INCIDENCES_RAD,
            "intercept_ratio": result.curves.incidence.ratio,
            "sigma_intercept_ratio": result.curves.incidence.sigma_ratio,
        },
    )
    thinned: dict[str, Any] = {
        "angle_rad": result.spread.angle_rad,
        "error_density_per_rad": result.spread.error_density,
        "beam_density_per_rad": result.spread.beam_density,
        "acceptance_ratio": result.spread.acceptance,
    }
    means = {name: values.reshape(-1, _SPREAD_STEP).mean(axis=1) for name, values in thinned.items()}
    write_table_csv(folder / "beam_spread.csv", means)
