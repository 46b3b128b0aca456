"""Curl of the slopes, which no surface has, against what their noise makes of it."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deflectometry.pipeline.evaluate import Evaluation
from deflectometry.sources.source import Remedies
from heliogauge.doubts import Doubt, Severity
from heliogauge.slopes.curl_moments import curl_moments
from heliogauge.slopes.grid import curl_rms
from heliogauge.slopes.map import SlopeMap, no_common_modes

Numbers = Mapping[str, float | int | None]

#: Curl against its expectation, and what it adds to the noise: below 0.1 mrad over a metre it spoils nothing. The
#: reference facet has 1.2 times its expectation, a wrong setup 5 times and more.
_CURL_RATIO = 3.0
_CURL_EXCESS_PER_M = 1e-4
#: Sigmas of single points that miss a third of what is there. Facets of drawn measurements of every preset, whose
#: sigmas are true, have 0.98 to 1.04 times the expectation; the public facet has 2.5.
_CURL_ABOVE_NOISE = 1.5


def with_curl_contained(evaluation: Evaluation, curls: Mapping[str, Numbers]) -> Evaluation:
    """Return the evaluation with random sigmas that make as much curl from point to point as there is.

    curls: Curl of each map and its expectation.

    Birge's ratio (The calculation of errors by the method of least squares, 1932), with the curl for residuals. Its
    smooth part is left to the test of the set-up (`deflectometry.pipeline.setup_test`).
    """
    factors = {
        name: _factor(slope_map)
        for name, slope_map in evaluation.fine_maps.items()
        if _ratio(curls[name]) > _CURL_ABOVE_NOISE
    }
    return replace(
        evaluation,
        maps={name: _enlarged(one, factors.get(name, 1.0)) for name, one in evaluation.maps.items()},
        fine_maps={name: _enlarged(one, factors.get(name, 1.0)) for name, one in evaluation.fine_maps.items()},
    )


def _factor(slope_map: SlopeMap) -> float:
    """Return how many times the curl of the random sigmas there is from point to point."""
    found, random = curl_rms(replace(slope_map, common=no_common_modes()))
    moments = curl_moments(slope_map)
    smooth = 0.0 if moments is None else moments.smooth_rms_per_m
    return float(np.sqrt(max(found**2 - smooth**2, 0.0))) / max(random, 1e-300)


def _enlarged(slope_map: SlopeMap, factor: float) -> SlopeMap:
    if not factor > _CURL_ABOVE_NOISE:
        return slope_map
    return replace(
        slope_map,
        sigma_random_x=factor * slope_map.sigma_random_x,
        sigma_random_y=factor * slope_map.sigma_random_y,
    )


def _ratio(numbers: Numbers) -> float:
    expected = _number(numbers, "curl_expected_rms_per_m")
    return _number(numbers, "curl_rms_per_m") / expected if expected > 0 else 0.0


def _number(numbers: Numbers, name: str) -> float:
    value = numbers.get(name)
    return float("nan") if value is None else float(value)


class CurlRemedies(NamedTuple):
    """What follows from too much curl, and what is to be checked: of single points, of the whole."""

    noisy: str
    wrong: str

    @classmethod
    def of_source(cls, remedies: Remedies) -> "CurlRemedies":
        """Return those of slopes whose sigmas contain the curl of single points."""
        return cls(
            f"the sigmas of single points were enlarged to make as much from point to point; {remedies.points}",
            f"check the shape and pose of the screen, {remedies.pattern}, that the images are neither mirrored nor "
            "strongly compressed, and that nothing moved",
        )


def curl_doubt(facets: Mapping[str, Numbers], remedies: CurlRemedies, *, allowance: float = 1.0) -> Iterator[Doubt]:
    """Yield what is wrong with slopes that no surface can have: the curl of a surface's slopes is zero.

    facets: Numbers of each facet.
    remedies: What follows from it, by the source of the slopes.
    allowance: How many times the ratio of a map is allowed, where the curl is not that of a map.
    """
    doubtful, noisy = [], []
    for name, numbers in facets.items():
        curl, expected = _number(numbers, "curl_rms_per_m"), _number(numbers, "curl_expected_rms_per_m")
        excess = np.sqrt(max(curl**2 - expected**2, 0.0))
        if curl > allowance * _CURL_RATIO * expected and excess > _CURL_EXCESS_PER_M:
            doubtful.append((name, curl, expected))
        elif curl > _CURL_ABOVE_NOISE * expected:
            noisy.append((name, curl / expected))
    if noisy and not doubtful:
        name, ratio = max(noisy, key=lambda one: one[1])
        where = f" (facet {name}, one of {len(noisy)})" if name else ""
        yield Doubt(
            "curl_above_noise",
            f"the slopes have {ratio:.1f} times the curl that their noise explains{where}: {remedies.noisy}",
            {"curl_ratio": ratio},
        )
    if doubtful:
        name, curl, expected = max(doubtful, key=lambda one: one[1])
        where = f" (facet {name}, one of {len(doubtful)})" if name else ""
        yield Doubt(
            "slopes_of_no_surface",
            f"no surface has these slopes: their curl is {1e3 * curl:.3g} mrad/m RMS{where}, where noise makes "
            f"{1e3 * expected:.3g}; {remedies.wrong}",
            {"curl_rms_per_m": curl, "curl_expected_rms_per_m": expected},
            Severity.SERIOUS,
        )
