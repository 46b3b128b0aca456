"""The canting of single facets in two results of one mirror: differences against the mean of all, and their sigmas."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deflectometry.comparison.moved_map import PlaneMotion, moved_map
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.mounts import LEAST_SHARE
from heliogauge.slopes.statistics import canting
from heliogauge.validate import FloatArray

#: Designs of facets in turned frames are alike up to this share of what curves them: places of facets that differ by
#: millimetres, and lines between nodes. A slope of 1e-6 rad is that of rounding.
_SAME_SHARE, _ROUNDING_RAD = 0.01, 1e-6
#: So many sigmas of the turn may turn the slopes of one design beside those of the other.
_TURN_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class CantingDifference:
    """Canting of facets, first minus second, without the mean of all facets: that is the frames' own.

    names: Of the facets that both have measured.
    first_rad, second_rad, difference_rad (f, 2): Canting in x and y, each without the mean of these facets.
    sigma_rad (f, 2): Standard deviation of the differences.
    probability: How often errors within the sigmas make so large differences; NaN without sigmas.
    """

    names: tuple[str, ...]
    first_rad: FloatArray
    second_rad: FloatArray
    difference_rad: FloatArray
    sigma_rad: FloatArray
    probability: float


@dataclass(frozen=True, slots=True, eq=False)
class FacetPartner:
    """A facet of the first result, and the facet of the second that stands in its place.

    turn (2, 2): From slopes in the second's facet frame to the first's.
    offset_rad (2,): Slopes of the second's facet frame in the first's: both designs may cant it differently.
    by_turn (2,): Derivative of its slopes in the first's frame after the turn of the second's map [rad per rad].
    """

    first: str
    second: str
    turn: FloatArray
    offset_rad: FloatArray
    by_turn: FloatArray

    @classmethod
    def of(cls, name: str) -> "FacetPartner":
        """Return the facet of the same name, in the same frame."""
        return cls(name, name, np.eye(2), np.zeros(2), np.zeros(2))


def partners(
    first: Mapping[str, RigidTransform], second: Mapping[str, RigidTransform], motion: PlaneMotion
) -> tuple[FacetPartner, ...]:
    """Find which facets of a map that was moved stand in the places of which others.

    first, second: ``ensemble_from_facet`` of each facet.
    motion: From the second's frame to the first's.
    Returns: Those that are nearest to each other, and nearer than half of the way to the next facet of the first.
    """
    if len(first) < 2 or not second:
        return ()
    turn = np.eye(3)
    turn[:2, :2] = motion.rotation
    moved = RigidTransform(turn, np.append(motion.shift_m, 0.0))
    names, others = list(first), list(second)
    places = np.array([first[name].translation_m[:2] for name in names])
    poses = [moved @ second[name] for name in others]
    apart = np.linalg.norm(places[:, None] - [one.translation_m[:2] for one in poses], axis=2)
    between = np.linalg.norm(places[:, None] - places, axis=2)
    reach = 0.5 * np.where(between > 0, between, np.inf).min(axis=1)
    found = []
    for row, name in enumerate(names):
        column = int(np.argmin(apart[row]))
        if int(np.argmin(apart[:, column])) != row or not apart[row, column] < reach[row]:
            continue
        rotation = first[name].rotation.T @ poses[column].rotation
        normal, in_ensemble = rotation[:, 2], poses[column].rotation[:, 2]
        # A turn by a small angle moves a slope (s_x, s_y) by (-s_y, s_x).
        across = np.array([in_ensemble[1], -in_ensemble[0]]) / in_ensemble[2]
        found.append(
            FacetPartner(
                name,
                others[column],
                rotation[:2, :2],
                -normal[:2] / normal[2],
                first[name].rotation[:2, :2].T @ across,
            )
        )
    return tuple(found)


def canting_difference(
    first: Mapping[str, SlopeMap],
    second: Mapping[str, SlopeMap],
    left_out: Collection[str],
    pairs: Sequence[FacetPartner] | None = None,
    sigma_turn_rad: float = 0.0,
) -> CantingDifference | None:
    """Compare the canting of facets that two results have measured.

    first, second: The map of each facet, in the facet's own frame.
    left_out: Facets of the first that are not compared, of `facets_left_out`.
    pairs: Which facets belong together; default: those of the same name.
    sigma_turn_rad: Of the turn between both frames [rad].
    Returns: None where fewer than two facets are compared.

    An error that all facets share, of the pose or of a camera, moves them alike and mostly cancels: the covariance is
    that of all facets together, random parts by themselves and each common mode through all of them.
    """
    every = [FacetPartner.of(name) for name in first] if pairs is None else pairs
    used = [one for one in every if one.first in first and one.first not in left_out]
    if len(used) < 2:
        return None
    names, count = tuple(one.first for one in used), len(used)
    values_a, covariance_a = _cantings([first[name] for name in names])
    values_b, covariance_b = _cantings([second[one.second] for one in used])
    turns = np.zeros((2 * count, 2 * count))
    for number, one in enumerate(used):
        turns[2 * number : 2 * number + 2, 2 * number : 2 * number + 2] = one.turn
    in_first = turns @ values_b.ravel() + np.concatenate([one.offset_rad for one in used])
    by_turn = sigma_turn_rad * np.concatenate([one.by_turn for one in used])
    centred = np.kron(np.eye(count) - 1.0 / count, np.eye(2))
    of_all = covariance_a + turns @ covariance_b @ turns.T + np.outer(by_turn, by_turn)
    covariance = centred @ of_all @ centred
    own = [(centred @ values).reshape(-1, 2) for values in (values_a.ravel(), in_first)]
    difference = own[0] - own[1]
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, 2)
    probability = float("nan")
    if (sigma > 0).all():
        size, axes = np.linalg.eigh(covariance)
        # Without the mean of all facets two combinations are none.
        kept = size > 1e-9 * size[-1]
        parts = axes[:, kept].T @ difference.ravel()
        probability = 1.0 - chi_square_cdf(float((parts**2 / size[kept]).sum()), int(kept.sum()))
    return CantingDifference(names, own[0], own[1], difference, sigma, probability)


def facets_left_out(
    first: Mapping[str, SlopeMap],
    second: Mapping[str, SlopeMap],
    pairs: Sequence[FacetPartner] | None = None,
    sigma_turn_rad: float = 0.0,
) -> dict[str, str]:
    """Return why the canting of facets of the first result is not compared, by their names.

    Compared are facets of the same design, measured in both on half of their area; arguments as `canting_difference`.
    """
    found = {}
    partner = {one.first: one for one in pairs or ()}
    for name, one in first.items():
        place = partner.get(name, None if pairs is not None else FacetPartner.of(name))
        other = None if place is None else second.get(place.second)
        if place is None or other is None:
            found[name] = f"the second result has none {'of their name' if pairs is None else 'in their place'}"
        elif not (one.design == other.design if pairs is None else _alike(one, other, place.turn, sigma_turn_rad)):
            found[name] = "both results have other designs of them"
        elif min(one.measured_share, other.measured_share) < LEAST_SHARE:
            found[name] = f"less than {LEAST_SHARE:.0%} of their area is measured in one of both"
    return found


def _alike(one: SlopeMap, other: SlopeMap, turn: FloatArray, sigma_turn_rad: float) -> bool:
    """Return whether the design of a facet is that of another one whose frame is turned.

    turn (2, 2): From the other's frame to the first's.

    Slopes are compared, not words: those of an off-axis facet name slopes in its own frame, and a trough has the same
    words along x and along y.
    """
    angle = float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
    there = moved_map(other, PlaneMotion(angle, np.zeros(2)), one.x_m, one.y_m)
    slopes, moved = (np.stack([each.design_slope_x, each.design_slope_y]) for each in (one, there))
    known = np.isfinite(slopes + moved).all(axis=0)
    if not known.any():
        return False
    slopes, apart = slopes[:, known], slopes[:, known] - moved[:, known]
    curved, whole, off = (
        float(np.sqrt(np.mean(each**2))) for each in (slopes - slopes.mean(axis=1, keepdims=True), slopes, apart)
    )
    return off < _SAME_SHARE * curved + _TURN_SIGMAS * sigma_turn_rad * whole + _ROUNDING_RAD


def _cantings(maps: list[SlopeMap]) -> tuple[FloatArray, FloatArray]:
    """Return the canting of facets (f, 2) and the covariance of all of it (2 f, 2 f)."""
    found = [canting(one) for one in maps]
    modes = []
    for one in maps:
        x, y = (grid[one.valid] for grid in np.meshgrid(one.x_m, one.y_m))
        modes.append(one.common.evaluate(x, y).mean(axis=2))
    size = 2 * len(maps)
    covariance = np.zeros((size, size))
    same = len({one.common.sources for one in maps}) == 1
    for number, (canted, mode) in enumerate(zip(found, modes, strict=True)):
        block = slice(2 * number, 2 * number + 2)
        own = canted.covariance_components_rad2
        # Modes of all facets belong together one by one.
        covariance[block, block] = own - mode.T @ mode if same else own
    if same:
        together = np.concatenate(modes, axis=1)
        covariance += together.T @ together
    return np.array([one.components_rad for one in found]), covariance
