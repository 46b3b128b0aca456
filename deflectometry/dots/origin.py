"""Which dots of the pattern a mirror shows: every place and turn of the lattice is a hypothesis with its odds."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from deflectometry.dots.found_dots import FoundDots
from deflectometry.dots.turns import TURNS
from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.dot_screen import DotScreen
from deflectometry.shape.facet_pixels import spread_indices
from deflectometry.shape.smooth_shape import slopes_at
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.geometry.surfaces import Facet
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray

#: How far the normal of a good mirror may be off that of its outline [rad] (as in `deflectometry.pipeline`).
_MOUNTING_RAD = 3e-3
#: Slope at the rim by which a solar mirror may be off its design, 1 sigma [rad]: a beam 40 mrad wide is none.
_GROSS_RAD = 10e-3
#: Chance that a dot of the lattice is none of the pattern: a speck between its rows and columns.
_FALSE_DOT = 1e-3
#: Hypotheses that are less likely than the best one by this are left out of sigmas and sums.
_LEAST_ODDS = 1e-6
#: An origin with less probability than this is open; a turn of the lattice with more than the rest is not decided.
_SURE = 0.99
#: Sigmas of the photo's ground from which a spot is a light, and how far a light must stand out of the next spot.
_LIGHT_SIGMAS, _LIGHT_RATIO = 10.0, 1.5
#: Dots that give the mean slopes of a hypothesis: 500 give them twenty times better than one.
_SPREAD = 500


@dataclass(frozen=True, slots=True, eq=False)
class PlacedDots(ShortRepr):
    """The dots with their numbers in the table, and how sure these are.

    dots: The dots as numbered in the table.
    probability: Of the place that was chosen.
    sigma_shift (2,): Standard deviations of column and row that all dots share, over all hypotheses.
    doubt: Where the place is open.
    """

    dots: FoundDots
    probability: float
    sigma_shift: FloatArray
    doubt: Doubt | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What the dots are seen with: camera and field, the mirror's pose and its facet."""

    setup: Setup
    screen: DotScreen
    pose: UncertainPose
    facet: Facet


def place_dots(dots: FoundDots, sight: Sight, known: tuple[IntArray, FloatArray] | None) -> PlacedDots:
    """Decide which dots of the pattern these are.

    dots: Numbered by the photo's lattice.
    known: Numbers (2,) of one dot in the table and its place in the photo [px]; None where nobody says it.
    Returns: The dots, numbered as in the table. An open place is a doubt with a share in the sigmas, not an error: it
        turns the mirror's normal, which the alignment takes out.
    EstimationError: No hypothesis shows dots that there are, or two turns of the lattice are equally likely.

    The odds of a hypothesis (a turn or mirror image of the lattice, 8 in all, and a whole number of columns and rows)
    are those of the slopes that it gives: their mean tilt against the design within the sigma of the pose and 3 mrad of
    mounting; curvatures, twist and curl within 10 mrad at the rim, which no solar mirror exceeds; and of each dot that
    would not be in the table.
    """
    found = [one for turn in TURNS for one in _of_turn(dots, sight, turn, known)]
    if not found:
        raise EstimationError(
            "no place in the table of the dots fits what is seen: the mirror shows more columns or rows than it has, "
            "or [pattern.known_dot] is none of them; check screen.file"
        )
    weight = np.array([one.log_odds for one in found])
    weight = np.exp(weight - weight.max())
    weight /= weight.sum()
    best = found[int(np.argmax(weight))]
    of_turn = np.array([weight[[one.turn is turn for one in found]].sum() for turn in TURNS])
    if of_turn.max() < _SURE:
        first, second = np.argsort(of_turn)[:-3:-1]
        raise EstimationError(
            f"two turns of the field of dots fit equally well ({of_turn[first]:.2f} : {of_turn[second]:.2f}); give "
            "[pattern.known_dot], outline_m and the pose of the screen"
        )
    shifts = np.array([one.shift for one in found])
    off = shifts - best.shift
    sigma = np.sqrt(np.einsum("n,ni->i", weight * (weight > _LEAST_ODDS), off.astype(np.float64) ** 2))
    probability = float(weight.max())
    doubt = None
    if probability < _SURE:
        doubt = Doubt(
            "dot_origin_open",
            f"which dots are seen is not decided: the likeliest place has a probability of {probability:.2g}, the "
            f"others are {sigma[0]:.1f} columns and {sigma[1]:.1f} rows off it (RMS); the orientation of the mirror is "
            "as uncertain as that, its shape hardly; mark dot (0, 0) (origin of [pattern]) or give [pattern.known_dot]",
            {"place_probability": probability, "columns_off_count": float(sigma[0]), "rows_off_count": float(sigma[1])},
        )
    return PlacedDots(dots.renumbered(dots.number @ best.turn.T + best.shift), probability, sigma, doubt)


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    """Numbers in the table = turn @ numbers in the photo + shift."""

    turn: IntArray
    shift: IntArray
    log_odds: float


def _of_turn(
    dots: FoundDots, sight: Sight, turn: IntArray, known: tuple[IntArray, FloatArray] | None
) -> list[_Hypothesis]:
    """Return the hypotheses of one turn of the lattice."""
    number = dots.number @ turn.T
    low, high = number.min(axis=0), number.max(axis=0)
    rows, columns = sight.screen.shape
    first = np.array([sight.screen.first[0], sight.screen.first[1] - rows + 1])
    last = np.array([sight.screen.first[0] + columns - 1, sight.screen.first[1]])
    if known is not None:
        shifts = [known[0] - turn @ number_at(dots, known[1])]
    else:
        # A line of the lattice that is beyond the table is of specks; more than a few are none.
        slack = 2
        ranges = [range(first[k] - low[k] - slack, last[k] - high[k] + slack + 1) for k in range(2)]
        shifts = [np.array(one) for one in product(*ranges)]
    chosen = spread_indices(len(number), _SPREAD)
    slopes = _Slopes.of(dots.centers_px[chosen], sight)
    found = []
    for shift in shifts:
        there = sight.screen.has(*(number + shift).T)
        if np.count_nonzero(there) > 0.5 * len(number):
            odds = slopes.log_odds(sight.screen.places_m(*(number[chosen] + shift).T))
            odds += np.count_nonzero(~there) * float(np.log(_FALSE_DOT))
            found.append(_Hypothesis(turn, np.asarray(shift), odds))
    return found


def number_at(dots: FoundDots, place_px: FloatArray) -> IntArray:
    """Return the number in the lattice that belongs to a place in the photo, whether its dot was found or not.

    EstimationError: The place is beside the lattice, or between two of its dots.
    """
    apart = np.linalg.norm(dots.centers_px - place_px, axis=1)
    near = np.argsort(apart)[:12]
    matrix = np.column_stack([dots.centers_px[near] - place_px, np.ones(len(near))])
    number = np.linalg.lstsq(matrix, dots.number[near].astype(np.float64), rcond=None)[0][2]
    whole = np.rint(number)
    if np.abs(whole - dots.number[near]).max() > 4:
        raise EstimationError(
            f"({place_px[0]:.1f}, {place_px[1]:.1f}) px: a dot should be here, but there are none around"
        )
    return np.asarray(whole.astype(np.intp))


@dataclass(frozen=True, slots=True, eq=False)
class _Slopes:
    """Odds of the slopes that dots give at their places on the mirror.

    points_m (3, n), camera_m (3,): Where the dots are seen on the design, and the camera, in the facet's frame [m].
    design (2, n): Slopes of the design there.
    terms (n, 3): 1 and the position about the reference point.
    covariance_tilt (2, 2): Of the mean slopes, by the pose and the mounting.
    sigma_per_m: Of curvatures, twist and curl.
    """

    sight: Sight
    points_m: FloatArray
    camera_m: FloatArray
    design: FloatArray
    terms: FloatArray
    covariance_tilt: FloatArray
    sigma_per_m: float

    @classmethod
    def of(cls, places_px: FloatArray, sight: Sight) -> "_Slopes":
        cam_from_facet = sight.pose.cam_from_mirror @ sight.facet.ensemble_from_facet
        facet_from_cam = cam_from_facet.inverse()
        camera = facet_from_cam.translation_m
        rays = facet_from_cam.rotate(sight.setup.camera.cast_rays(places_px))
        points = camera + sight.facet.design.intersect(camera, rays)[:, None] * rays
        place = points[:, :2] - sight.facet.reference_point_m
        # A turn of the mirror about its y axis by a changes dz/dx by -a, about its x axis dz/dy by a.
        by_turn = np.array([[0.0, -1.0], [1.0, 0.0]]) @ cam_from_facet.rotation.T[:2]
        covariance = by_turn @ sight.pose.covariance[:3, :3] @ by_turn.T + _MOUNTING_RAD**2 * np.eye(2)
        half_m = 0.5 * float(np.ptp(sight.facet.outline_m, axis=0).max())
        design = np.stack(sight.facet.design.gradient(points[:, 0], points[:, 1]))
        terms = np.column_stack([np.ones(len(place)), place])
        return cls(sight, points.T, camera, design, terms, covariance, _GROSS_RAD / half_m)

    def log_odds(self, places_m: FloatArray) -> float:
        """Return the log of the probability density of what these places of the dots give."""
        facet_from_cam = (self.sight.pose.cam_from_mirror @ self.sight.facet.ensemble_from_facet).inverse()
        screen = facet_from_cam.apply(self.sight.setup.cam_from_screen.apply(places_m)).T
        error = np.stack(slopes_at(self.points_m, self.camera_m, screen)) - self.design
        usable = np.isfinite(error).all(axis=0)
        fit = np.linalg.lstsq(self.terms[usable], error[:, usable].T, rcond=None)[0]
        tilt, gradient = fit[0], fit[1:]
        by_tilt = float(tilt @ np.linalg.solve(self.covariance_tilt, tilt))
        return -0.5 * (by_tilt + float(np.sum(gradient**2)) / self.sigma_per_m**2)


def find_light(image_dn: npt.NDArray[np.generic], ground_dn: Float32Array, region: BoolArray) -> FloatArray:
    """Find the one point light that the mirror shows.

    image_dn, ground_dn (h, w): The photo, and the mirror in it without dots [DN].
    region (h, w): Pixels that see the mirror.
    Returns (2,): Its centre in the photo [px].
    EstimationError: No spot stands out, or several do.
    """
    above = np.where(region, image_dn.astype(np.float32) - ground_dn, 0.0)
    sigma = robust_scale(above[region], centred=False)
    spots = _spots(above, _LIGHT_SIGMAS * sigma)
    if not spots:
        raise EstimationError(
            "no spot brighter than the ground is seen in the mirror: is there a light at dot (0, 0)? If not, origin = "
            '"unmarked"'
        )
    (brightest, place), *others = sorted(spots, key=lambda one: -one[0])
    if others and others[0][0] * _LIGHT_RATIO > brightest:
        raise EstimationError(
            f"{len(spots)} spots in the mirror may be the light at dot (0, 0), such as at ({place[0]:.0f}, "
            f"{place[1]:.0f}) and ({others[0][1][0]:.0f}, {others[0][1][1]:.0f}) px; cover the others, or give "
            "[pattern.known_dot]"
        )
    return place


def _spots(above_dn: Float32Array, limit_dn: float) -> Sequence[tuple[float, FloatArray]]:
    """Return light (sum above the ground) and centre of each connected spot above a limit."""
    import cv2

    count, label = cv2.connectedComponents((above_dn > limit_dn).astype(np.uint8), connectivity=8)
    found = []
    for spot in range(1, count):
        row, column = np.nonzero(label == spot)
        light = above_dn[row, column].astype(np.float64)
        place = np.array([column @ light, row @ light]) / light.sum()
        found.append((float(light.sum()), place))
    return found
