"""The numbers and words that stand for a measurement: what summary.json holds."""

from collections.abc import Mapping, Sequence
from math import isfinite

import numpy as np

from deflectometry.pipeline.evaluate import Evaluation
from deflectometry.pose.find_pose import LocatedMirror
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.facet_canting import FacetCanting
from heliogauge.flags import FLAG_TEXTS, count_flags
from heliogauge.reporting.notation import number_text
from heliogauge.results.facet_frames import facet_geometry
from heliogauge.results.folder import Summary, unit_of
from heliogauge.slopes.grid import curl_rms
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.mounts import LEAST_SHARE
from heliogauge.slopes.removal import MeasuredNodes, Removal, measured_nodes
from heliogauge.slopes.statistics import Canting, SlopeStatistics, common_rms, fit_quadratic, statistics_of_removals

Numbers = dict[str, float | int | None]

#: A curvature within so many sigma of zero is one of a flat mirror: 1 of 20 flat ones is beyond.
FLAT_SIGMAS = 2.0
#: Slopes are solved to 1e-9 rad: a smaller change over a metre is round-off, whatever the sigma.
_FLAT_PER_M = 1e-9
#: What is taken out, and how the numbers that are left are called.
VIEWS: dict[str, Removal] = {
    "": Removal.NOTHING,
    "_tilt_removed": Removal.TILT,
    "_best_focus": Removal.FOCUS,
    "_best_quadratic": Removal.QUADRATIC,
}


def facet_numbers(slope_map: SlopeMap, as_measured: SlopeMap) -> Numbers:
    """Collect the headline numbers of one map.

    slope_map: The map, after what the user wants removed.
    as_measured: The map before that: focal lengths and twist are the mirror's, not those of what is left.
    Returns: Numbers by name with the unit at the end, each sigma beside its number.
    """
    numbers: Numbers = {}
    nodes = measured_nodes(slope_map)
    for view, found in zip(VIEWS, statistics_of_removals(slope_map, list(VIEWS.values()), nodes), strict=True):
        numbers.update(_deviation_numbers(found, view))
    fit = fit_quadratic(as_measured, nodes if as_measured is slope_map else None)
    numbers |= {
        **_focus_numbers("x", fit.curvature_x_per_m, fit.sigma_curvature_x_per_m),
        **_focus_numbers("y", fit.curvature_y_per_m, fit.sigma_curvature_y_per_m),
        "twist_per_m": float(fit.coefficients[4]),
        "sigma_twist_per_m": float(np.sqrt(fit.covariance[4, 4])),
    }
    numbers |= _uncertainty_numbers(slope_map, nodes)
    numbers["measured_share"] = slope_map.measured_share
    numbers["valid_nodes_count"] = int(np.count_nonzero(slope_map.valid))
    return numbers


def _focus_numbers(axis: str, curvature_per_m: float, sigma_per_m: float) -> Numbers:
    """Return curvature and focal length along an axis, this one None where the mirror is flat within its sigma.

    Of a curvature that is not told from zero even the sign of the focal length is chance.
    """
    is_flat = abs(curvature_per_m) <= max(FLAT_SIGMAS * sigma_per_m, _FLAT_PER_M)
    return {
        f"focal_length_{axis}_m": None if is_flat else 0.5 / curvature_per_m,
        f"sigma_focal_length_{axis}_m": None if is_flat else 0.5 * sigma_per_m / curvature_per_m**2,
        f"curvature_{axis}_per_m": curvature_per_m,
        f"sigma_curvature_{axis}_per_m": sigma_per_m,
    }


def reasons(numbers: Numbers, facets: Mapping[str, Numbers] | None = None) -> dict[str, str]:
    """Say why numbers are None, in the mirror or in one of its facets."""
    missing = {key for table in (numbers, *(facets or {}).values()) for key, value in table.items() if value is None}
    found = {}
    for key in missing:
        if "focal_length" in key:
            # One reason for all facets: the number is that of the mirror, where it has one.
            ending = f": curvature {_curvature_words(numbers, key)}" if numbers.get(key) is None else ""
            found[key] = f"flat within its sigma{ending}"
        elif "curl" in key:
            found[key] = "no node of the map is measured with all of its neighbours"
        elif "canting" in key:
            found[key] = f"less than {100 * LEAST_SHARE:.0f} % of the facet is measured"
    return found


def _curvature_words(numbers: Numbers, key: str) -> str:
    """Print the curvature that belongs to a focal length."""
    axis = key.removesuffix("_m")[-1]
    value, sigma = numbers[f"curvature_{axis}_per_m"], numbers[f"sigma_curvature_{axis}_per_m"]
    return number_text(float(value or 0.0), sigma, "1/m")


def numbers_of_maps(
    maps: Mapping[str, SlopeMap], as_measured: Mapping[str, SlopeMap], cantings: Sequence[FacetCanting]
) -> dict[str, Numbers]:
    """Collect the headline numbers of each measured facet of an ensemble; empty for a single facet.

    maps: Map of each facet after what was removed.
    as_measured: The same before that.
    cantings: Of all facets.
    """
    return {
        one.facet.name: _numbers_of_canting(one.canting)
        | facet_numbers(maps[one.facet.name], as_measured[one.facet.name])
        for one in cantings
        if one.facet.name in maps
    }


def _numbers_of_canting(canted: Canting | None) -> Numbers:
    if canted is None:
        return dict.fromkeys(("canting_x_rad", "sigma_canting_x_rad", "canting_y_rad", "sigma_canting_y_rad"))
    sigma = np.sqrt(np.diag(canted.covariance_components_rad2))
    return {
        "canting_x_rad": float(canted.components_rad[0]),
        "sigma_canting_x_rad": float(sigma[0]),
        "canting_y_rad": float(canted.components_rad[1]),
        "sigma_canting_y_rad": float(sigma[1]),
    }


def canting_numbers(cantings: Sequence[FacetCanting]) -> Numbers:
    """Collect the largest canting and the largest move of a mount; empty where there is none."""
    numbers: Numbers = {}
    known = [one.canting for one in cantings if one.canting is not None]
    if known:
        largest = max(known, key=lambda one: one.angle_rad)
        numbers |= {"canting_largest_rad": largest.angle_rad, "sigma_canting_largest_rad": largest.sigma_angle_rad}
    moves = [
        (abs(move), sigma)
        for one in cantings
        for move, sigma in zip(one.moves.move_m.tolist(), one.moves.sigma_m.tolist(), strict=True)
        if isfinite(move)
    ]
    if moves:
        move, sigma = max(moves)
        numbers |= {"largest_move_mm": 1e3 * move, "sigma_largest_move_mm": 1e3 * sigma}
    return numbers


def _deviation_numbers(deviation: SlopeStatistics, view: str) -> Numbers:
    values = {
        "sdx": (deviation.sdx_rad, deviation.sigma_sdx_rad),
        "sdy": (deviation.sdy_rad, deviation.sigma_sdy_rad),
        "sd": (deviation.sd_rad, deviation.sigma_sd_rad),
    }
    numbers: Numbers = {}
    for name, (value, sigma) in values.items():
        numbers[f"{name}{view}_rad"] = value
        numbers[f"sigma_{name}{view}_rad"] = sigma
    return numbers


def _uncertainty_numbers(slope_map: SlopeMap, nodes: MeasuredNodes) -> Numbers:
    """Return the shares of the uncertainty: random, and each common source, as RMS over the map."""
    random = np.sqrt(nodes.variance.mean(axis=1)).tolist()
    shares = common_rms(slope_map, nodes)
    numbers: Numbers = {
        "sigma_slope_x_rms_rad": float(np.linalg.norm([random[0], *(x for x, _ in shares.values())])),
        "sigma_slope_y_rms_rad": float(np.linalg.norm([random[1], *(y for _, y in shares.values())])),
        "sigma_random_x_rms_rad": random[0],
        "sigma_random_y_rms_rad": random[1],
    }
    for source, (share_x, share_y) in shares.items():
        name = source.replace(" ", "_")
        numbers[f"sigma_{name}_x_rms_rad"] = share_x
        numbers[f"sigma_{name}_y_rms_rad"] = share_y
    return numbers | curl_numbers(slope_map)


def curl_numbers(slope_map: SlopeMap) -> Numbers:
    """Return the curl of a map, which no surface has, and what its errors of measurement make of it.

    Returns: None for both where no node is measured with all of its neighbours.
    """
    names = ("curl_rms_per_m", "curl_expected_rms_per_m")
    return {name: value if np.isfinite(value) else None for name, value in zip(names, curl_rms(slope_map), strict=True)}


def joined_curl(maps: Mapping[str, SlopeMap], curls: Mapping[str, Numbers] | None = None) -> Numbers:
    """Return the RMS curl within facets: the steps of the slopes from facet to facet are none.

    maps: Of each facet.
    curls: What `curl_numbers` says of each, where that is known.
    """
    each = {name: curl_numbers(one) for name, one in maps.items()} if curls is None else curls
    names = ("curl_rms_per_m", "curl_expected_rms_per_m")
    values = np.array([[each[facet][name] for name in names] for facet in maps], dtype=np.float64)
    weight = np.array([np.count_nonzero(one.valid) for one in maps.values()], dtype=np.float64)
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        return dict.fromkeys(names)
    mean = weight[known] @ values[known] ** 2 / weight[known].sum()
    return dict(zip(names, np.sqrt(mean).tolist(), strict=True))


def pose_numbers(located: LocatedMirror, evaluation: Evaluation) -> Numbers:
    """Collect the evidence for the pose and the noise of the images."""
    pose = evaluation.solution.cam_from_mirror
    numbers: Numbers = {
        "camera_distance_m": float(np.linalg.norm(pose.translation_m)),
        "noise_dn": float(evaluation.screen_map.noise.sigma_read_dn),
        "alignment_turn_rad": float(
            np.linalg.norm((located.pose.cam_from_mirror.inverse() @ pose).rotation_vector_rad)
        ),
    }
    evidence = located.evidence
    if evidence is not None:
        numbers |= {
            "pose_residual_px": evidence.residual_rms_px,
            "pose_residual_without_distance_px": evidence.image_only_rms_px,
            "pose_points_count": evidence.n_points,
            "pose_rejected_count": evidence.n_rejected,
        }
        for test in evidence.distance_tests:
            numbers |= {
                "distance_measured_m": test.measured_m,
                "distance_from_image_m": test.image_only_m,
                "sigma_distance_from_image_m": test.sigma_image_only_m,
                "distance_residual_m": test.residual_m,
                "distance_agreement_probability": test.probability,
            }
    return numbers


def flag_words(evaluation: Evaluation) -> str:
    """Say how many pixels of the mirror were rejected, and why."""
    on_mirror = evaluation.facet_index >= 0
    total = int(np.count_nonzero(on_mirror))
    counts = count_flags(evaluation.screen_map.flags, on_mirror)
    if not counts:
        return f"none of {total} pixels rejected"
    listed = "; ".join(f"{FLAG_TEXTS[flag]}: {count}" for flag, count in counts.items())
    return f"{listed} (of {total} pixels on the mirror)"


def geometry(setup: Setup, evaluation: Evaluation) -> Mapping[str, object]:
    """Collect points for the sketch of the setup, in the mirror's frame [m]."""
    mirror_from_cam = evaluation.solution.cam_from_mirror.inverse()
    edge = np.array([0.001, 0.25, 0.5, 0.75, 0.999])
    low, high = np.full(5, 0.001), np.full(5, 0.999)
    border = setup.screen.points_m(
        np.concatenate([edge, high, edge[::-1], low]), np.concatenate([low, edge, high, edge[::-1]])
    )
    facets = evaluation.located.facets
    outlines = [facet.ensemble_from_facet.apply(facet.corners_m) for facet in facets]
    return {
        "camera": mirror_from_cam.translation_m.tolist(),
        "camera_axis": mirror_from_cam.rotate([0.0, 0.0, 1.0]).tolist(),
        "screen": (mirror_from_cam @ setup.cam_from_screen).apply(border).tolist(),
        "mirror": np.concatenate(outlines).tolist(),
        **facet_geometry(facets),
    }


def headline_text(summary: Summary) -> str:
    """Say the most important numbers in a few lines for the terminal.

    Returns: Lines with values, sigmas and what they refer to.
    """

    def number(key: str) -> str:
        value, sigma = summary.numbers[key], summary.numbers[f"sigma_{key}"]
        if value is None:
            return f"not determined ({summary.not_determined[key]})"
        said = number_text(float(value), sigma, unit_of(key)[1])
        return f"{said} (convex)" if key.startswith("focal_length") and value < 0 else said

    lines = [
        f"{summary.name}: slope deviation of the normal against {summary.texts['design']}",
        f"  as measured      SDx {number('sdx_rad')}   SDy {number('sdy_rad')}",
        f"  best-fit focus   SDx {number('sdx_best_focus_rad')}   SDy {number('sdy_best_focus_rad')}",
        f"  focal length     x {number('focal_length_x_m')}   y {number('focal_length_y_m')}",
        *_canting_lines(summary),
        *_normal_lines(summary),
        f"  removed          {summary.texts['removed']}",
        f"  measured share   {100 * float(summary.numbers['measured_share'] or 0):.1f} % of {measured_of(summary)}",
    ]
    return "\n".join(lines)


def measured_of(summary: Summary) -> str:
    """Return of what the measured share is: where nobody states the mirror's size, of what was scanned."""
    return summary.texts.get("measured share of", "the mirror")


def _normal_lines(summary: Summary) -> list[str]:
    """Return the line about the mean normal of an ensemble."""
    if not summary.facets or summary.numbers.get("mean_normal_x_rad") is None:
        return []
    said = [
        f"{axis} {number_text(float(summary.numbers[key] or 0.0), summary.numbers[f'sigma_{key}'], 'rad')}"
        for axis, key in (("x", "mean_normal_x_rad"), ("y", "mean_normal_y_rad"))
    ]
    return [f"  mean normal      {'   '.join(said)} from straight into the screen"]


def _canting_lines(summary: Summary) -> list[str]:
    """Return the line about canting and moves of an ensemble."""
    said = [
        f"{words} {number_text(float(value), summary.numbers[f'sigma_{key}'], unit_of(key)[1])}"
        for key, words in (("canting_largest_rad", "largest"), ("largest_move_mm", "largest move of a mount"))
        if (value := summary.numbers.get(key)) is not None
    ]
    return [f"  canting          {'   '.join(said)}"] if said else []
