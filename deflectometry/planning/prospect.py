"""What a planned measurement will be worth, whatever its source: its own numbers, and what limits them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.map import CommonModes, SlopeMap
from heliogauge.slopes.statistics import canting, common_rms, fit_quadratic
from heliogauge.validate import FloatArray

#: Errors that each sample has by itself.
NOISE = "noise"
#: What is limited: key and words.
LIMITED = {
    "slope_x": "slopes in x",
    "slope_y": "slopes in y",
    "curvature_x": "curvature in x",
    "curvature_y": "curvature in y",
    "canting": "canting",
    "mean_normal": "mean normal",
}
#: Sources with a smaller share of every variance are not worth an alternative.
LEAST_SHARE = 0.05

Numbers = Mapping[str, float | int | None]


@dataclass(frozen=True, slots=True, eq=False)
class FacetProspect:
    """What one facet will give.

    seen_share: Share of its pixels, or beams, that see the pattern.
    hole: Where it does not, in words; empty where all of it does.
    slope_map: Expected map; None where it is not measured.
    """

    name: str
    seen_share: float
    hole: str
    slope_map: SlopeMap | None
    ensemble_from_facet: RigidTransform

    @property
    def sigma_canting_rad(self) -> FloatArray:
        """Standard deviations of both components of its mean normal against the mirror's, shape (2,); NaN if none."""
        if self.slope_map is None:
            return np.full(2, np.nan)
        return np.asarray(np.sqrt(np.diag(canting(self.slope_map).covariance_components_rad2)))


@dataclass(frozen=True, slots=True, eq=False)
class Prospect:
    """What a measurement will be worth.

    slope_map: Expected map of the whole mirror with its sigmas: random, and the modes of what all points share.
    numbers: What the measurement will say of the mirror: sigmas, and a mean normal where there is one.
    facets: Each facet of the mirror, also those that will not be measured.
    normal_shares_rad (k, 2): What one sigma of each error does to the mean normal; k = 0 where there is none.
    normal_sources (k,): Which source each belongs to.
    spacing_m: Of the samples on the mirror.
    samples: How many there are.
    texts: What else is to be said, by its name.
    tables: What the measurement writes beside, by the file's name.
    """

    slope_map: SlopeMap
    numbers: Numbers
    facets: tuple[FacetProspect, ...]
    spacing_m: float
    samples: int
    normal_shares_rad: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    normal_sources: tuple[str, ...] = ()
    texts: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, Mapping[str, Sequence[Any]]] = field(default_factory=dict)
    doubts: tuple[Doubt, ...] = ()

    @property
    def seen_share(self) -> float:
        """Share of the mirror that sees the pattern."""
        areas = [float(np.count_nonzero(one.slope_map.aperture)) if one.slope_map else 1.0 for one in self.facets]
        return float(np.average([one.seen_share for one in self.facets], weights=areas))

    def beside(self) -> dict[str, float]:
        """Return what else an alternative may change."""
        return {"seen_share": self.seen_share, "sample_spacing_m": self.spacing_m}

    def known_facets(self) -> frozenset[str]:
        """Return the names of the facets that will be measured."""
        return frozenset(one.name for one in self.facets if one.slope_map is not None)

    def sigmas(self) -> dict[str, float]:
        """Return what the plan is about, by the names of `LIMITED`: sigmas, RMS over mirror or facets; NaN if none."""
        numbers = self.numbers
        found = {name: float(numbers[f"sigma_{name}_rms_rad"] or 0.0) for name in ("slope_x", "slope_y")}
        found |= {name: float(numbers[f"sigma_{name}_per_m"] or 0.0) for name in ("curvature_x", "curvature_y")}
        if len(self.facets) > 1:
            each = np.array([one.sigma_canting_rad for one in self.facets])
            found["canting"] = float(np.sqrt(np.nanmean(each**2))) if np.isfinite(each).any() else np.nan
        if self.normal_sources:
            found["mean_normal"] = float(np.sqrt(0.5 * (self.normal_shares_rad**2).sum()))
        return found

    def limits(self) -> dict[str, dict[str, float]]:
        """Return the share of each source in each variance: by the names of `LIMITED`, then of the sources."""
        sources = (NOISE, *dict.fromkeys(self.slope_map.common.sources))
        alone = {source: _only(self.slope_map, source) for source in sources}
        squares: dict[str, dict[str, float]] = {name: {} for name in self.sigmas()}
        for source, one in alone.items():
            rms = common_rms(one).get(source, (0.0, 0.0))
            if source == NOISE:
                rms = (_rms(one.sigma_random_x), _rms(one.sigma_random_y))
            fit = fit_quadratic(one).covariance
            squares["slope_x"][source], squares["slope_y"][source] = rms[0] ** 2, rms[1] ** 2
            squares["curvature_x"][source], squares["curvature_y"][source] = 4 * fit[0, 0], 4 * fit[1, 1]
            if "canting" in squares:
                parts = [replace(two, slope_map=two.slope_map and _only(two.slope_map, source)) for two in self.facets]
                squares["canting"][source] = float(np.nanmean([two.sigma_canting_rad**2 for two in parts]))
        for source in dict.fromkeys(self.normal_sources):
            own = self.normal_shares_rad[[one == source for one in self.normal_sources]]
            squares["mean_normal"][source] = 0.5 * float((own**2).sum())
        return {name: _shares(each) for name, each in squares.items()}


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _shares(squares: Mapping[str, float]) -> dict[str, float]:
    total = sum(squares.values())
    return {source: one / total if total > 0 else 0.0 for source, one in squares.items()}


def _only(slope_map: SlopeMap, source: str) -> SlopeMap:
    """Return a map with the errors of one source alone."""
    common = slope_map.common
    own = [one == source for one in common.sources]
    kept = CommonModes(
        tuple(one for one in common.sources if one == source), common.coefficients[own], common.center_m, common.scale_m
    )
    if source == NOISE:
        return replace(slope_map, common=kept)
    silent = np.where(np.isfinite(slope_map.sigma_random_x), 0.0, np.nan)
    return replace(slope_map, common=kept, sigma_random_x=silent, sigma_random_y=silent)


class Promise(Protocol):
    """What a plan promises, with a slope map (`Prospect`) or without one (`SigmaProspect`)."""

    def sigmas(self) -> Mapping[str, float]:
        """Return what the plan is about: standard deviations by their names; NaN where not determined."""

    def beside(self) -> Mapping[str, float]:
        """Return what else an alternative may change, by names with unit."""

    def known_facets(self) -> frozenset[str]:
        """Return the names of the facets of which something will be known."""


class Planned(Protocol):
    """One set-up that can be looked at before it is there, and changed."""

    @property
    def name(self) -> str:
        """Name of what will be measured."""

    def prospect(self) -> Promise:
        """Return what measuring with it will be worth.

        InputError: A set-up that shows nothing.
        EstimationError: One that determines nothing.
        """

    def changes(self) -> Iterable["Change"]:
        """Yield what might be done otherwise."""


class PlannedSource(Planned, Protocol):
    """A set-up whose measurement has a slope map."""

    def prospect(self) -> Prospect:
        """Return what measuring with it will be worth.

        InputError: A set-up that shows the mirror no pattern.
        EstimationError: One that determines no slopes.
        """

    def limits(self, prospect: Prospect) -> Mapping[str, Mapping[str, float]]:
        """Return the share of each source of errors in each variance: by the names of `LIMITED`, then of the sources.

        prospect: As planned.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Something done otherwise.

    words: What is done.
    key: Its key in measurement.toml.
    before, after: Its value.
    planned: The set-up after it.
    betters: Sources of errors that it makes smaller; empty where it changes everything.
    states_sigma: Whether it only says how well something is known that is counted as known by the images, or exactly.
    """

    words: str
    key: str
    before: str
    after: str
    planned: Planned
    betters: tuple[str, ...] = ()
    states_sigma: bool = False

    def is_worth_a_look(self, limits: Mapping[str, Mapping[str, float]]) -> bool:
        """Return whether what it betters has a share of any variance that is worth it."""
        return not self.betters or any(
            sum(shares.get(source, 0.0) for source in self.betters) >= LEAST_SHARE for shares in limits.values()
        )


@dataclass(frozen=True, slots=True, eq=False)
class Alternative:
    """A change with what it brings.

    sigmas, beside: As `Promise`; empty where it is impossible.
    gains: By how much each sigma becomes smaller: before over after. NaN where a facet is lost by it: sigmas are RMS
        over known facets, and canting is against their mean, so that fewer have smaller ones.
    reason: Why it is impossible.
    """

    change: Change
    sigmas: Mapping[str, float]
    gains: Mapping[str, float]
    beside: Mapping[str, float]
    reason: str = ""

    @property
    def best_gain(self) -> float:
        """The largest of its gains."""
        return max((one for one in self.gains.values() if np.isfinite(one)), default=0.0)


def words_of_limits(limits: Mapping[str, Mapping[str, float]], most: int = 2) -> str:
    """Say what each sigma is made of."""
    said = []
    for name, shares in limits.items():
        ranked: Sequence[tuple[str, float]] = sorted(shares.items(), key=lambda one: -one[1])
        named = [f"{source} {share:.0%}" for source, share in ranked[:most] if share >= LEAST_SHARE]
        if named:
            said.append(f"{LIMITED[name]}: {', '.join(named)}")
    return "; ".join(said)
