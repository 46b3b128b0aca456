"""Dimensions of the collector as stated beside what the measurement shows: where they differ, a number is wrong."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from heliogauge.doubts import Doubt, Severity
from heliogauge.slopes.map import SlopeMap
from observer.doubts.by_chance import contradicting_sigmas
from observer.photo_edges.outline import Span
from observer.selection.solve_and_refuse import Reflector
from observer.slopes.row_spline import Roughness
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

#: Slopes of a parabola whose focal length is wrong by this share are 4 mrad off at the rim of an LS-2: no mirror that
#: anybody would measure has its panels all tilted like that.
_FOCAL_SHARE = 5e-3
#: With the absorber found at the focal length that the slopes have, less suffices.
_FOCAL_SHARE_WITH_ABSORBER = 3e-3
#: ... or where both are off the same way, this much on average: panels that were mounted with care leave up to 0.4 % in
#: the mirror alone, and tubes hang up to 6 mm, 0.4 %, beside the focal line.
_FOCAL_SHARE_TOGETHER = 4.5e-3
#: Rows determine the focal length where they are measured out to this share of both halves of the aperture.
_REACH_SHARE = 0.7
#: ... and on this share of their nodes.
_ROW_SHARE = 0.4
#: What the diameter may be wrong by before the measurement, as a standard deviation.
_DIAMETER_PRIOR_SHARE = 0.03
#: A number of the design contradicts the photos from so many sigmas on.
_TIMES_SIGMA = 5.0
#: The tube's diameter: more than this share of it and than `contradicting_sigmas`; its sigma holds what all edges may
#: have in common (0.2 mm from 24 photos of VGA), so that three are a third of a percent.
_DIAMETER_SHARE = 5e-3
#: How much thicker or thinner the tube looks in the other encoding, in photos of half a megapixel.
_OTHER_ENCODING_SHARE = 0.014
#: What is reported of width and length: more than this share, and more than so many sigmas.
_SPAN_SHARE = 4e-3
#: Slopes that vary along a row as much as this jump at panel edges: mirrors of one piece have 1e-4 to 3e-3, a mirror of
#: four panels that was stated to be one 0.15 [rad^2 / m^3].
_JUMPING = 0.02
#: Heights of panels whose sigma is less than this share of the prior's come from the reflection; from so many on
#: their mean square over what is expected says something.
_MEASURED_SHARE, _FEWEST_HEIGHTS, _HEIGHTS_EXCESS = 0.95, 4, 4.0


@dataclass(frozen=True, slots=True)
class Found:
    """A dimension as the measurement has it.

    value_m, sigma_m: The dimension and its standard deviation [m].
    """

    value_m: float
    sigma_m: float


def focal_length_of_mirror(slope_map: SlopeMap, collector: Collector) -> Found:
    """Return the focal length of the parabola whose slopes across the trough are nearest to the measured ones.

    Returns: The focal length; its sigma takes each of the mirror's rows for one sample.
    """
    x = np.broadcast_to(slope_map.x_m, slope_map.shape)
    used = slope_map.valid & np.isfinite(slope_map.slope_x)
    # From a part of the aperture a panel's own curvature or tilt looks like another focal length.
    far = _REACH_SHARE * collector.aperture_width_m / 2
    enough = used.sum(axis=1) > _ROW_SHARE * slope_map.aperture.sum(axis=1)
    rows = np.nonzero((used & (x < -far)).any(axis=1) & (used & (x > far)).any(axis=1) & enough)[0]
    # Slopes of z = x^2 / (4 f) are x / (2 f).
    fits = np.array([np.polyfit(x[row, used[row]], slope_map.slope_x[row, used[row]], 1)[0] for row in rows])
    if fits.size == 0 or np.median(fits) <= 0:
        return Found(collector.focal_length_m, np.inf)
    value = 1 / (2 * float(np.median(fits)))
    scatter = float(np.std(1 / (2 * fits))) if fits.size > 1 else np.inf
    return Found(value, scatter / np.sqrt(max(fits.size, 1)))


def focal_length_doubt(mirror: Found, absorber: AbsorberPath, collector: Collector) -> Doubt | None:
    """Say whether the stated focal length contradicts mirror and absorber.

    absorber: The tube as it was found.
    Returns: None where it does not.
    """
    stated = collector.focal_length_m
    off = mirror.value_m - stated
    if abs(off) < _TIMES_SIGMA * mirror.sigma_m:
        return None
    height = float(np.mean(absorber.z_m))
    agrees = abs(height - mirror.value_m) < 0.4 * abs(off)
    together = min(0.5 * (off + height - stated) * np.sign(off), 2 * abs(off))
    least = _FOCAL_SHARE_WITH_ABSORBER if agrees else _FOCAL_SHARE
    if abs(off) < least * stated and together < _FOCAL_SHARE_TOGETHER * stated:
        return None
    where = "the absorber is at that height too" if agrees else f"the absorber is at a height of {height:.4f} m"
    return Doubt(
        "focal_length_contradicts_photos",
        f"collector.focal_length_m = {stated:g} m does not fit: the mirror has the slopes of a parabola of "
        f"{mirror.value_m:.4f} m ({100 * off / stated:+.2f} %), and {where}; check the number, and that the targets' "
        "coordinates are from the vertex",
        {"stated_m": stated, "mirror_m": mirror.value_m, "sigma_mirror_m": mirror.sigma_m, "absorber_height_m": height},
        Severity.SERIOUS,
    )


def diameter_of_absorber(reflector: Reflector, collector: Collector) -> Found:
    """Estimate the tube's diameter from the width of its reflection, together with slopes and camera positions.

    reflector: The solution with the stated diameter.
    Returns: The diameter. Slopes cannot take its part: each mirror point is seen by both edges of the reflection,
        in photos that are some ten apart.
    """
    unknowns, errors = reflector.unknowns, reflector.errors
    number, radius, unit = unknowns.radius, collector.absorber_diameter_m / 2, float(unknowns.units[0])
    prior = (_DIAMETER_PRIOR_SHARE * radius / unit) ** 2
    # The solution knows the radius beforehand, apart from all else: with a wider prior its information is less.
    stated, found = float(unknowns.covariance[number, number]), float(errors.covariance_common[number, number])
    wider = 1 / (1 + found * (1 / prior - 1 / stated))
    variance, value = wider * found, wider * float(errors.common[number])
    # Undo the pull of the prior: the value by the photos alone.
    own = max(1 - variance / prior, 1e-3)
    return Found(2 * (radius + unit * value / own), 2 * unit * np.sqrt(variance / own))


def diameter_doubt(
    found: Found, collector: Collector, *, encoding_is_clear: bool = True, n_modules: int = 1
) -> Doubt | None:
    """Say whether the stated diameter of the tube contradicts the width of its reflection.

    encoding_is_clear: Whether it is known how the photos are encoded.
    n_modules: Modules of the flight, each of which is asked.
    Returns: None where it does not.
    """
    stated = collector.absorber_diameter_m
    off = found.value_m - stated
    sigma = found.sigma_m if encoding_is_clear else float(np.hypot(found.sigma_m, _OTHER_ENCODING_SHARE * stated))
    if abs(off) < max(contradicting_sigmas(n_modules) * sigma, _DIAMETER_SHARE * stated):
        return None
    return Doubt(
        "absorber_diameter_contradicts_reflection",
        f"collector.absorber_diameter_mm = {1e3 * stated:g} mm does not fit: the reflection has the width of a tube of "
        f"{1e3 * found.value_m:.2f} +- {1e3 * found.sigma_m:.2f} mm ({100 * off / stated:+.1f} %); it is the diameter "
        "of the metal tube, without the glass",
        {"stated_m": stated, "seen_m": found.value_m, "sigma_seen_m": found.sigma_m},
        Severity.SERIOUS,
    )


def outline_doubts(across: Span, along: Span, collector: Collector) -> Iterator[Doubt]:
    """Yield where the stated width or length contradicts the rims in the photos.

    across, along: From `observer.photo_edges.outline.spans_of`.
    """
    for span, key, axis in ((across, "aperture_width_m", "x"), (along, "length_m", "y")):
        if not np.isfinite(span.value_m):
            continue
        stated = float(getattr(collector, key))
        least = max(_TIMES_SIGMA * span.sigma_m, _SPAN_SHARE * stated)
        off = span.value_m - stated
        if abs(off) > least:
            yield Doubt(
                "mirror_size_contradicts_photos",
                f"collector.{key} = {stated:g} m does not fit: in the photos the mirror ends at {axis} = "
                f"{span.middle_m - span.value_m / 2:.3f} and {span.middle_m + span.value_m / 2:.3f} m, which makes "
                f"{span.value_m:.3f} m ({100 * off / stated:+.1f} %)",
                {"stated_m": stated, "seen_m": span.value_m, "sigma_seen_m": span.sigma_m},
                Severity.SERIOUS,
            )
        elif abs(span.middle_m) > least:
            yield Doubt(
                "mirror_not_at_origin",
                f"the mirror's middle is at {axis} = {span.middle_m:.3f} m of the targets' coordinates instead of 0; "
                "the origin belongs at the vertex, in the middle of the length",
                {"middle_m": span.middle_m, "sigma_seen_m": span.sigma_m},
                Severity.SERIOUS,
            )


def panels_doubt(roughness: Roughness, collector: Collector) -> Doubt | None:
    """Say whether the mirror looks like several panels where none were stated.

    roughness: Of the slopes along the rows, as found.
    Returns: None where panels are stated, or slopes do not jump.
    """
    if collector.panel_edges_x_m.size > 2 or roughness.order > 2 or roughness.across < _JUMPING:
        return None
    return Doubt(
        "panel_edges_not_stated",
        "slopes jump along x as at edges of panels, but the mirror is stated to be one piece across: without "
        "collector.panel_edges_x_m slopes are smeared over the edges, and sigma is large everywhere",
    )


def heights_doubt(reflector: Reflector) -> Doubt | None:
    """Say whether panels are higher or lower than their stated accuracy lets expect.

    reflector: The solution, of which their heights are unknowns.
    Returns: None where they fit, or are held.
    """
    height, sigma = reflector.unknowns.panel_heights_m(reflector.errors.common, reflector.errors.covariance_common)
    unit = reflector.unknowns.height_unit_m
    measured = sigma < _MEASURED_SHARE * unit if unit else np.zeros(height.size, dtype=bool)
    if np.count_nonzero(measured) < _FEWEST_HEIGHTS:
        return None
    # Before the measurement an estimate is expected to have the variance that it took from the prior.
    excess = float(np.mean(height[measured] ** 2 / (unit**2 - sigma[measured] ** 2)))
    if excess < _HEIGHTS_EXCESS:
        return None
    remedy = f"state {1e3 * unit * np.sqrt(excess):.1g} mm"
    mean, scatter = float(height[measured].mean()), float(height[measured].std(ddof=1))
    # Panels that are mounted each for itself have a mean within three times this, those of a shifted list do not.
    if abs(mean) > 3.0 * scatter / np.sqrt(np.count_nonzero(measured)):
        remedy = (
            f"all are {1e3 * abs(mean):.1f} mm too {'high' if mean > 0 else 'low'} on average, as wrong heights in the "
            f"list of targets or a wrong focal_length_m make it: check these first; of panels alone {remedy}"
        )
    return Doubt(
        "panel_heights_contradict_reflection",
        f"collector.panel_height_sigma_mm = {1e3 * unit:g} does not fit: the reflection's width says that panels are "
        f"{np.sqrt(excess):.1f} times as far from the design's height; {remedy}; until then slopes are less certain "
        "than their sigma says",
        {"stated_sigma_m": unit, "seen_sigma_m": unit * float(np.sqrt(excess))},
    )
