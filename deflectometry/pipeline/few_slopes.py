"""What the slopes of some pixels say already of a mirror, before all of them are measured."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from deflectometry.pipeline.curl_test import CurlRemedies, curl_doubt
from deflectometry.pipeline.design_check import off_design
from deflectometry.pipeline.evaluate import Reflection
from deflectometry.pipeline.headline import Numbers
from deflectometry.pipeline.source_slopes import slopes_of_facets
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.pixel_slopes import SlopeImage
from deflectometry.sources.source import Remedies
from heliogauge.doubts import Doubt
from heliogauge.slopes.normal_angles import normal_angles
from heliogauge.validate import BoolArray, FloatArray

#: Pixels of all facets that are looked at; harmless: the root mean square of so many is known to a percent.
_FEW_PIXELS = 20_000
#: How many times the ratio of curl to its expectation may be that of the map, which decides: a bad pixel on its own
#: counts in three differences, and the map's grid averages it. With four to eight in the drawn facet it is 1.03 to 1.25
#: times that of the map; exchanged axes make it 230 times what noise makes.
_OF_MAP = 2.0


class PixelCurl(NamedTuple):
    """Root mean square over pixels of the slopes' curl, and of its sigma [1/m]; NaN where no three are neighbours."""

    measured_per_m: float
    expected_per_m: float


def contradicted_by_few(
    reflection: Reflection, setup: Setup, remedies: Remedies, curls: Mapping[str, Numbers]
) -> Iterator[Doubt]:
    """Yield what some pixels say so strongly against a reflection that all of them will say it, too.

    setup: Camera and screen.
    remedies: Those of the source.
    curls: Curl that is to be expected anyhow of each facet (`curl_expected_rms_per_m`): by sigmas of place and set-up.

    Looked at are pairs of neighbouring rows. A bad pixel makes more curl beside its neighbours than on the grid of a
    map, so that slopes of no surface are doubted here only beyond twice the ratio there: the map decides the rest.
    """
    rows = _some_rows(reflection)
    few = np.where(rows[:, None], reflection.facet_index, -1).astype(np.int16)
    images = slopes_of_facets(setup, reflection.screen_map, few, reflection.usable, reflection.solution)
    anyhow = max((one.get("curl_expected_rms_per_m") or 0.0 for one in curls.values()), default=0.0)
    of_facets: dict[str, Numbers] = {}
    angles = []
    for sample in reflection.usable.samples:
        image = images[sample.facet.name]
        found = pixel_curl(image)
        expected = curls.get(sample.facet.name, {}).get("curl_expected_rms_per_m") or anyhow
        of_facets[sample.facet.name] = {
            "curl_rms_per_m": found.measured_per_m,
            "curl_expected_rms_per_m": float(np.hypot(found.expected_per_m, expected)),
        }
        seen = np.isfinite(image.slope_x) & np.isfinite(image.slope_y)
        design = sample.facet.design.gradient(image.x_m[seen], image.y_m[seen])
        off = normal_angles(image.slope_x[seen], image.slope_y[seen], *design)
        # The mean of each facet is at least what the tilt of the mirror takes away.
        angles.append(off - off.mean(axis=1, keepdims=True) if off.size else off)
    yield from curl_doubt(of_facets, CurlRemedies.of_source(remedies), allowance=_OF_MAP)
    every: FloatArray = np.concatenate(angles, axis=1)
    if every.size:
        yield from off_design({"sd_tilt_removed_rad": float(np.sqrt((every**2).sum(axis=0).mean()))}, remedies.pattern)


def _some_rows(reflection: Reflection) -> BoolArray:
    """Return which rows (h,) of the samples are looked at: pairs of neighbours, evenly apart."""
    facet_index = reflection.facet_index
    apart = max(2, 2 * int(np.count_nonzero(facet_index >= 0)) // _FEW_PIXELS)
    return np.asarray(np.arange(len(facet_index)) % apart < 2)


def pixel_curl(image: SlopeImage) -> PixelCurl:
    """Return the curl of slopes by differences of each pixel to the next in its row and in its column."""
    here, right, down = np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, :-1]
    (right_x, down_x), (right_y, down_y) = (
        (place[right] - place[here], place[down] - place[here]) for place in (image.x_m, image.y_m)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        area = right_x * down_y - right_y * down_x
        # d slope_x / dy - d slope_y / dx by the differences along two steps on the mirror.
        shares = {
            "x": ((down_x - right_x) / area, -down_x / area, right_x / area),
            "y": ((down_y - right_y) / area, -down_y / area, right_y / area),
        }
        curl, variance = np.zeros_like(area), np.zeros_like(area)
        for slope, sigma, own in (
            (image.slope_x, image.sigma_x, shares["x"]),
            (image.slope_y, image.sigma_y, shares["y"]),
        ):
            for share, end in zip(own, (here, right, down), strict=True):
                curl += share * slope[end]
                variance += (share * sigma[end]) ** 2
    known = np.isfinite(curl) & np.isfinite(variance)
    if not known.any():
        return PixelCurl(np.nan, np.nan)
    return PixelCurl(*(float(np.sqrt(one[known].mean())) for one in (curl**2, variance)))
