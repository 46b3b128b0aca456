"""The numbers of a trough measurement: for summary.json and for the terminal."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from heliogauge.reporting.notation import height_text, light_text, number_text
from heliogauge.results.folder import Summary
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal
from heliogauge.slopes.statistics import statistics
from heliogauge.validate import FloatArray
from observer.absorber.position import AbsorberSolution
from observer.doubts.by_chance import contradicting_sigmas
from observer.doubts.halves import halves_limit, halves_words
from observer.light.panel_gains import PanelGains
from observer.product.panel_alignment import move_of_outer_mount, panel_tilts
from observer.product.panel_shapes import panel_shapes
from observer.product.panel_turns import LEAST_GAIN_SHARE
from observer.product.slope_map import AngleMaps
from observer.selection.edge_refusal import EdgeFate
from observer.selection.solve_and_refuse import Reflector
from observer.shutter.readout import RowMotions
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.visibility import Visibility, seeable_shares

Numbers = dict[str, float | int | None]


def slope_numbers(slope_map: SlopeMap, angles: AngleMaps, visible: Visibility) -> Numbers:
    """Return the numbers of the mirror.

    visible: Which nodes can show the tube.
    """
    across = _across_only(slope_map)
    whole = statistics(across)
    untilted = statistics(across, removed=Removal.TILT)
    sigma = slope_map.sigma_slope()[0][slope_map.valid]
    seeable, measured = seeable_shares(visible, slope_map.aperture, slope_map.valid)
    theta_ra = angles.theta_ra_rad[slope_map.valid]
    turn = 1 / (1 + slope_map.slope_x[slope_map.valid] ** 2)
    return {
        "sdx_rad": whole.sdx_rad,
        "sigma_sdx_rad": whole.sigma_sdx_rad,
        "sdx_tilt_removed_rad": untilted.sdx_rad,
        "sigma_sdx_tilt_removed_rad": untilted.sigma_sdx_rad,
        "mean_theta_r_rad": -whole.mean_x_rad,
        "rms_theta_r_rad": whole.sdx_rad,
        "rms_theta_ra_rad": float(np.sqrt((theta_ra**2).mean())),
        "sigma_rms_theta_r_rad": whole.sigma_sdx_rad,
        "sigma_rms_theta_ra_rad": _sigma_rms(angles.theta_ra_rad, angles.to_tube),
        "median_sigma_slope_x_rad": float(np.median(sigma)),
        "median_sigma_theta_r_rad": float(np.median(turn * sigma)),
        "median_sigma_theta_ra_rad": float(np.median(angles.sigma_theta_ra_rad[slope_map.valid])),
        "measured_share": slope_map.measured_share,
        "seeable_share": seeable,
        "seeable_measured_share": measured,
    }


def _sigma_rms(angle_rad: FloatArray, slope_map: SlopeMap) -> float:
    """Return the sigma of the RMS of an angle by the noise and the common modes of a map [rad].

    First order, as `heliogauge.slopes.statistics` has it.
    """
    valid = slope_map.valid
    angle, turn = angle_rad[valid], 1 / (1 + slope_map.slope_x[valid] ** 2)
    pull = angle * turn / max(float(np.linalg.norm(angle)) * np.sqrt(angle.size), 1e-12)
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    moved = slope_map.common.of_sum(x[valid], y[valid], pull)[:, 0]
    noise = slope_map.noise_correlation * float(np.sum((pull * slope_map.sigma_random_x[valid]) ** 2))
    return float(np.sqrt(noise + np.sum(moved**2)))


def _across_only(slope_map: SlopeMap) -> SlopeMap:
    """Return the map with the design's slope along the trough, for statistics of the one across it."""
    zero = np.zeros(slope_map.shape)
    return replace(slope_map, slope_y=slope_map.design_slope_y, sigma_random_y=zero)


def absorber_numbers(absorber: AbsorberPath, collector: Collector, solution: AbsorberSolution | None) -> Numbers:
    """Return the numbers of the absorber."""
    seen = np.ones(absorber.n, dtype=bool) if solution is None else solution.n_photos >= 2
    n = absorber.n
    mean_x, sigma_x = _mean(absorber.x_m, absorber.covariance_m2[:n, :n], seen)
    mean_z, sigma_z = _mean(absorber.z_m - collector.focal_length_m, absorber.covariance_m2[n:, n:], seen)
    return {
        "absorber_mean_x_m": mean_x,
        "sigma_absorber_mean_x_m": sigma_x,
        "absorber_mean_z_offset_m": mean_z,
        "sigma_absorber_mean_z_offset_m": sigma_z,
        "absorber_range_x_m": float(np.ptp(absorber.x_m[seen])),
        "absorber_range_z_m": float(np.ptp(absorber.z_m[seen])),
    }


def _mean(values: FloatArray, covariance: FloatArray, seen: np.ndarray) -> tuple[float, float]:
    weights = seen / seen.sum()
    return float(weights @ values), float(np.sqrt(max(weights @ covariance @ weights, 0.0)))


def edge_numbers(reflector: Reflector) -> Numbers:
    """Return how many edges were used."""
    used = reflector.fate == EdgeFate.USED
    return {
        "edges_used_count": int(used.sum()),
        "edges_rejected_count": int((~used).sum()),
        "edge_residual_rms_rad": float(np.sqrt(np.mean(reflector.residuals_rad[used] ** 2))),
        "edge_noise_factor": reflector.noise_factor,
    }


def halves_numbers(reflector: Reflector, n_modules: int) -> Numbers:
    """Return what every second photo says beside the others; none where they are too far apart to check each other.

    n_modules: Modules of the flight, each of which is judged.
    """
    halves = reflector.halves
    if halves is None:
        return {}
    return {
        "halves_difference_rms_rad": halves.rms_rad,
        "halves_expected_rms_rad": halves.expected_rad,
        "halves_chi_square_ratio": halves.chi_square,
        "halves_chi_square_limit_ratio": halves_limit(halves.difference_rad.size, n_modules),
    }


def shutter_numbers(motions: RowMotions | None) -> Numbers:
    """Return how long a frame takes to read, and how far the camera flies in that; none without a rolling shutter."""
    if motions is None:
        return {}
    flown = float(np.sqrt((motions.motions_m**2).sum(axis=1).mean()))
    numbers: Numbers = {"frame_motion_rms_m": flown}
    if motions.in_seconds:
        numbers |= {"readout_s": motions.readout, "sigma_readout_s": motions.sigma_readout}
    return numbers


def surface_numbers(reflector: Reflector) -> tuple[Numbers, dict[str, str]]:
    """Return what the reflection says of the mirror's heights and of its slopes along the trough.

    Returns: Factor of the heights that the slopes integrate to with its sigma, what they matter, and how large
        slopes along the trough were taken to be, beside what slopes across tell of them where these make a surface;
        why the factor is not determined.
    """
    shape = reflector.shape
    known = np.isfinite(shape.sigma)
    numbers: Numbers = {
        "height_factor_ratio": shape.share if known else None,
        "sigma_height_factor_ratio": shape.sigma if known else None,
        "height_effect_rms_rad": shape.effect_rad,
        "slope_along_assumed_rad": reflector.roughness.along_rad,
    }
    why = "the heights that the slopes integrate to are too small to be seen in the reflection"
    return numbers, {} if known else {"height_factor_ratio": why}


def surface_text(reflector: Reflector) -> str:
    """Say which surface the lines of sight met.

    Returns: A few words for summary.json.
    """
    return "heights from the slopes found" if reflector.height_m.any() else "the design's, with normals as found"


def panel_columns(
    slope_map: SlopeMap,
    angles: AngleMaps,
    collector: Collector,
    gains: PanelGains | None = None,
    reflector: Reflector | None = None,
) -> dict[str, Any]:
    """Return what ``panels.csv`` holds.

    gains: What turning panels gains.
    reflector: The solution, of which the panels' heights are unknowns.
    Returns: Columns: mean angles, gain, focal length and, with the solution, height of each panel with their sigma.
    """
    tilts = panel_tilts(angles.theta_r_rad, slope_map, collector)
    to_tube = panel_tilts(angles.theta_ra_rad, angles.to_tube, collector)
    shapes, moves = panel_shapes(slope_map, collector), move_of_outer_mount(to_tube, collector)
    return {
        "panel": np.arange(1, tilts.tilt_rad.size + 1),
        "centre_x_m": tilts.centre_x_m,
        "centre_y_m": tilts.centre_y_m,
        "mean_theta_r_rad": tilts.tilt_rad,
        "sigma_mean_theta_r_rad": tilts.sigma_rad,
        "mean_theta_ra_rad": to_tube.tilt_rad,
        "sigma_mean_theta_ra_rad": to_tube.sigma_rad,
        **({} if gains is None else _gain_columns(gains)),
        "mount_move_m": moves.move_m,
        "sigma_mount_move_m": moves.sigma_m,
        "focal_length_m": shapes.focal_length_m,
        "sigma_focal_length_m": shapes.sigma_focal_length_m,
        "rest_slope_rad": shapes.rest_rad,
        **({} if reflector is None else _height_columns(reflector, tilts.tilt_rad.size)),
        "measured_share": tilts.measured_share,
        "sigma_unmeasured_theta_r_rad": tilts.sigma_unmeasured_rad,
        "sigma_unmeasured_theta_ra_rad": to_tube.sigma_unmeasured_rad,
    }


def _gain_columns(gains: PanelGains) -> dict[str, Any]:
    return {
        "gain_ratio": gains.gain_ratio,
        "sigma_gain_ratio": gains.sigma_gain_ratio,
        "gain_is_sure": gains.sure.astype(int),
    }


def _height_columns(reflector: Reflector, n_panels: int) -> dict[str, Any]:
    """Return how high each panel sits over its design; NaN where heights are held."""
    errors = reflector.errors
    height, sigma = reflector.unknowns.panel_heights_m(errors.common, errors.covariance_common)
    held = np.full(n_panels, np.nan)
    return {"height_m": height if height.size else held, "sigma_height_m": sigma if sigma.size else held}


def turns_text(summary: Summary) -> str:
    """Say what turning panels gains."""
    numbers = summary.numbers
    sure, count = int(numbers["panels_to_turn_count"] or 0), int(numbers["panels_count"] or 0)
    if not sure:
        return f"turning none of {count} gains anything that is sure"
    key = "intercept_gain_panels_turned_ratio"
    gain = light_text(float(numbers[key] or 0.0), float(numbers[f"sigma_{key}"] or 0.0))
    worth = int(numbers["panels_worth_turning_count"] or 0)
    if not worth:
        least = f"{100 * LEAST_GAIN_SHARE:g} % of its own light"
        return f"no panel is worth a turn: {sure} of {count} surely gain, all together {gain}, each less than {least}"
    which = "" if worth == sure else f", {worth} of them worth a turn"
    return f"turning {sure} of {count} gains {gain}{which}; `heliogauge observer align` gives the moves of their mounts"


def headline_text(summary: Summary) -> str:
    """Say the most important numbers in a few lines for the terminal."""
    numbers = summary.numbers

    def said(key: str) -> str:
        value = numbers[key]
        if value is None:
            return summary.not_determined[key]
        sigma = numbers.get(f"sigma_{key}")
        unit = "rad" if key.endswith("_rad") else "m" if key.endswith("_m") else ""
        return number_text(value, None if sigma is None else float(sigma), unit, key)

    def with_sigma(text: Callable[[float, float | None], str], key: str) -> str:
        sigma = numbers.get(f"sigma_{key}")
        return text(float(numbers[key] or 0.0), None if sigma is None else float(sigma))

    height = with_sigma(height_text, "absorber_mean_z_offset_m") + _sag_text(numbers)
    loses = float(numbers["intercept_gain_absorber_aligned_ratio"] or 0.0) < 0
    aligned = "an absorber on the stated focal line loses" if loses else "an aligned absorber gains"
    return "\n".join(
        [
            f"{summary.name}: {numbers['photos_count']} photos, {numbers['edges_used_count']} edges of the reflection",
            f"  normal, SDx      {said('sdx_rad')} (RMS of theta_r); without mean tilt {said('sdx_tilt_removed_rad')}",
            f"  with the absorber theta_ra {said('rms_theta_ra_rad')} RMS",
            f"  sigma of a point {said('median_sigma_theta_r_rad')} of theta_r, {said('median_sigma_theta_ra_rad')} of "
            "theta_ra (median)",
            f"  absorber         x {said('absorber_mean_x_m')}, {height}",
            f"  intercept factor {said('intercept_ratio')}; {aligned} "
            f"{with_sigma(_size_of_light, 'intercept_gain_absorber_aligned_ratio')}, perfect mirrors gain "
            f"{with_sigma(light_text, 'intercept_gain_mirror_perfect_ratio')}",
            f"  light            {summary.texts['light']}",
            f"  panels           {turns_text(summary)}",
            f"  measured         {said('measured_share')} of the mirror, {said('seeable_measured_share')} of what can "
            "show the tube",
            f"  design           {summary.texts['design']}",
            f"  files            {summary.texts['encoding']}",
            *(f"  halves           {text}" for text in halves_words(numbers)),
            *([f"  rolling shutter  {_shutter_text(summary)}"] if "frame_motion_rms_m" in numbers else []),
        ]
    )


def _size_of_light(gain_ratio: float, sigma_ratio: float | None) -> str:
    return light_text(abs(gain_ratio), sigma_ratio)


def _sag_text(numbers: Mapping[str, float | int | None]) -> str:
    """Say that a mean height hides a tube that surely hangs between its supports; nothing where it does not.

    The sag is the largest one of all spans.
    """
    names = ("absorber_sag_down_m", "sigma_absorber_sag_down_m", "absorber_spans_measured_count")
    sag, sigma, n_spans = (float(numbers.get(key) or 0.0) for key in names)
    if not sigma or not n_spans or abs(sag) <= contradicting_sigmas(int(n_spans)) * sigma:
        return ""
    way = "lower" if sag > 0 else "higher"
    size = number_text(abs(sag), sigma, "m", "absorber_sag_down_m")
    return f" on average; between supports up to {size} {way} than at them"


def _shutter_text(summary: Summary) -> str:
    """Say how far the camera flew while it read a frame, and how long that took."""
    numbers = summary.numbers
    said = f"{number_text(float(numbers['frame_motion_rms_m'] or 0.0), None, 'm')} flown over a frame"
    if "readout_s" not in numbers:
        return said
    readout, sigma = (1e3 * float(numbers[key] or 0.0) for key in ("readout_s", "sigma_readout_s"))
    return f"{readout:.2f} ± {sigma:.2f} ms for a frame; {said}"
