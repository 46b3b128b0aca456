"""Which dots of the pattern a mirror shows: every place and turn of the lattice is a hypothesis with its odds."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from deflectometry.dots.found_dots import FoundDots
from deflectometry.dots.mark_evidence import MarkEvidence
from deflectometry.dots.turns import TURNS
from deflectometry.pose.facet_places import MOUNTING_RAD
from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.dot_screen import DotScreen
from deflectometry.shape.facet_pixels import spread_indices
from deflectometry.shape.smooth_shape import slopes_at
from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, Float32Array, FloatArray, IntArray

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
#: How much brighter one facet may show the light than another: dust, blur and the place between pixels make less.
_SAME_LIGHT = 3.0
#: Dots that give the mean slopes of a hypothesis: 500 give them twenty times better than one.
_SPREAD = 500
#: Odds of marks against chance, as logarithm, that decide whatever the tilt: 5e8 (of some 3e4 places and turns).
_TELLING = 20.0
#: Dots in the middle of a facet that tell its tilt in advance, and sigmas of the tilt beyond which a place is none
#: (at 8 its odds are 1e-14), or adds nothing to the odds of a turn (a hundredth at 3).
_MIDDLE, _EXCLUDED, _ROUGHLY = 5, 8.0, 3.0
#: Gradient of slopes by which facets may be off their design all alike, 1 sigma [rad/m] (those of f = 150 m for 100 m),
#: and how much larger than the curl the gradients of a set-up that is off may be, 1 sigma.
_SHAPE_PER_M, _SETUP_OF_CURL = 2e-3, 3.0


#: Numbers of a dot in the table (2,), and its place in the photo (2,) [px].
KnownDot = tuple[IntArray, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class PlacedDots(ShortRepr):
    """The dots with their numbers in the table, and how sure these are.

    dots: The dots as numbered in the table.
    probability: Of the place that was chosen.
    sigma_shift (2,): Standard deviations of column and row that all dots share, over all hypotheses.
    own_shift (2,): The part of them that this lattice does not share with the one that was placed first.
    turn (2, 2): Numbers in the table are turn @ numbers in the photo, but for a shift.
    """

    dots: FoundDots
    probability: float
    sigma_shift: FloatArray
    own_shift: FloatArray
    turn: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Sight(ShortRepr):
    """One lattice of dots and what it is seen with: camera and field, the mirror's pose and its facet.

    dots: Numbered by the photo's lattice.
    known: Numbers (2,) of one dot in the table and its place in the photo [px]; None where nobody says it.
    on_facet (n,): Which of the dots the facet shows; None for all.
    name: What the lattice is called in words.
    marks: Which of the dots are large, where the pattern has dots of two sizes.
    mounting_rad: How far the mirror's normal may be off that of its pose, beside the pose's own sigma [rad].
    """

    dots: FoundDots
    setup: Setup
    screen: DotScreen
    pose: UncertainPose
    facet: Facet
    known: KnownDot | None = None
    on_facet: BoolArray | None = None
    name: str = ""
    marks: MarkEvidence | None = None
    mounting_rad: float = MOUNTING_RAD


def place_dots(sights: Sequence[Sight], turns: Sequence[IntArray] = TURNS) -> tuple[PlacedDots, ...]:
    """Decide which dots of the pattern these are, lattice by lattice.

    sights: The lattices; facets may show one of their own each.
    turns: Those that the lattices may have.
    Returns: The dots, numbered as in the table. An open place is a doubt with a share in the sigmas, not an error: it
        turns the mirror's normal, which the alignment takes out.
    EstimationError: No hypothesis shows dots that there are, two turns of the lattice are equally likely, or marks
        contradict all that the slopes allow.

    The odds of a hypothesis (a turn or mirror image of the lattice, 8 in all, and a whole number of columns and rows)
    are those of the slopes that it gives: their mean tilt against the design within the sigma of the pose and 3 mrad of
    mounting; curvatures, twist and curl within 10 mrad at the rim, which no solar mirror exceeds; of each dot that
    would not be in the table; and of the sizes of the dots, where these are marks. All lattices have the same turn.
    Facets are judged against those that are placed already (3 mrad of canting each), the surest first; a known dot
    leaves no hypothesis but its own.
    """
    found = [[_of_turn(one, turn, _ROUGHLY) for turn in turns] for one in sights]
    for one, by_turn in zip(sights, found, strict=True):
        if not any(by_turn):
            raise EstimationError(
                f"{one.name + ': ' if one.name else ''}no place in the table of the dots fits what is seen: the mirror "
                "shows more columns or rows than it has, or [pattern.known_dot] is none of them; check screen.file"
            )
    frames = [_TiltFrame.of(one) for one in sights]
    of_turn = np.zeros(len(turns))
    for frame, by_turn in zip(frames, found, strict=True):
        of_turn += [np.logaddexp.reduce(frame.log_odds(one)) if one else -np.inf for one in by_turn]
    if not np.isfinite(of_turn).any():
        raise EstimationError("the facets show the dots in different turns; check the places of the facets")
    share = _shares(of_turn)
    if share.max() < _SURE:
        first, second = np.argsort(share)[:-3:-1]
        raise EstimationError(
            f"two turns of the field of dots fit equally well ({share[first]:.2f} : {share[second]:.2f}); give "
            "[pattern.known_dot], outline_m and the pose of the screen"
        )
    _refuse_contradicting_marks(found, frames, of_turn, turns)
    turn = turns[int(np.argmax(share))]
    hypotheses = [_of_turn(one, turn, _EXCLUDED) for one in sights]
    gradient = np.mean(
        [frame.gradient(max(one, key=lambda k: k.log_odds).fit) for frame, one in zip(frames, hypotheses, strict=True)],
        axis=0,
    )
    surest = [float(_shares(frame.log_odds(one)).max()) for frame, one in zip(frames, hypotheses, strict=True)]
    placed: dict[int, PlacedDots] = {}
    before: list[tuple[FloatArray, FloatArray]] = []
    shared = np.zeros(2)
    for k in sorted(range(len(sights)), key=lambda k: (sights[k].known is None, -surest[k])):
        weight = _shares(frames[k].log_odds(hypotheses[k], before, gradient))
        best = hypotheses[k][int(np.argmax(weight))]
        off = np.array([one.shift - best.shift for one in hypotheses[k]], dtype=np.float64)
        own = np.sqrt(np.einsum("n,ni->i", weight * (weight > _LEAST_ODDS), off**2))
        # What the first lattice leaves open, those placed after it share.
        sigma = own if sights[k].known is not None else np.hypot(own, shared)
        is_first = not before
        shared = own if is_first else shared
        before.append((frames[k].place_m, frames[k].tilt(best.fit)))
        numbers = sights[k].dots.number @ turn.T + best.shift
        apart = np.zeros(2) if is_first else own
        placed[k] = PlacedDots(sights[k].dots.renumbered(numbers), float(weight.max()), sigma, apart, turn)
    return tuple(placed[k] for k in range(len(sights)))


def _refuse_contradicting_marks(
    found: Sequence[Sequence[Sequence["_Hypothesis"]]],
    frames: Sequence["_TiltFrame"],
    of_turn: FloatArray,
    turns: Sequence[IntArray],
) -> None:
    """Refuse sizes of dots that fit no place, or only one that no mirror can show.

    found: Hypotheses of each lattice and turn.
    of_turn: Log odds of the turns.
    turns: What they are.
    EstimationError: They do.
    """
    told = np.array(
        [sum(max((k.mark_odds for k in one[turn]), default=0.0) for one in found) for turn in range(len(turns))]
    )
    by_marks = int(np.argmax(told))
    if told[by_marks] < _TELLING:
        chosen = [by_turn[int(np.argmax(of_turn))] for by_turn in found]
        here = [one[int(np.argmax(frame.log_odds(one)))].mark_odds for frame, one in zip(frames, chosen, strict=True)]
        if sum(here) < -_TELLING:
            raise EstimationError(
                "the sizes of the dots fit no place in pattern.marks_file: it is the table of another pattern, or the "
                "dots are not of its two sizes"
            )
        return
    # The mirror may hang anyhow, but its shape does not turn over: what the slopes' gradients say is sure.
    by_shape = np.array(
        [
            sum(max((k.log_odds - k.mark_odds for k in one[turn]), default=-np.inf) for one in found)
            for turn in range(len(turns))
        ]
    )
    if by_shape.max() - by_shape[by_marks] < -np.log(1.0 - _SURE):
        return
    apart = turns[by_marks] @ np.linalg.inv(turns[int(np.argmax(by_shape))])
    if np.linalg.det(apart) < 0:
        raise EstimationError(
            "by the sizes of its dots the pattern is seen mirrored: it is printed or projected the wrong way round, or "
            "the photo is; mirror the one that is, or write the table (column, x_m) as the wall shows it"
        )
    angle = round(np.degrees(np.arctan2(apart[1, 0], apart[0, 0]))) % 360
    raise EstimationError(
        f"by the sizes of its dots the pattern is seen turned by {angle} deg in its plane against what [screen] and "
        "[mirror] say: correct rotation_vector_rad of [screen], mirror.roll_deg or the table"
    )


def doubt_of_places(placed: Sequence[PlacedDots], sights: Sequence[Sight]) -> Doubt | None:
    """Return a doubt where the place of dots in the pattern is open."""
    opened = [k for k, one in enumerate(placed) if one.probability < _SURE]
    if not opened:
        return None
    worst = min(opened, key=lambda k: placed[k].probability)
    probability, sigma = placed[worst].probability, placed[worst].sigma_shift
    several = len(placed) > 1
    where = f" in {', '.join(sights[k].name for k in opened)}" if several else ""
    apart_m = float(
        np.linalg.norm((sights[0].setup.cam_from_screen.inverse() @ sights[0].pose.cam_from_mirror).translation_m)
    )
    off_mrad = 500.0 * float(np.linalg.norm(sigma * sights[worst].screen.spacing_m)) / apart_m
    turned = "its shape hardly"
    if several:
        turned = f"and the canting of these facets with it ({off_mrad:.2g} mrad beyond its sigma), their shape hardly"
    remedy = "use dots of two sizes (pattern.marks_file), a light at dot (0, 0) (pattern.origin) or [pattern.known_dot]"
    if sights[worst].marks is not None:
        remedy = (
            "the sizes of the dots are hardly told apart: check focus and whether the wall shows the pattern of "
            "pattern.marks_file, or give [pattern.known_dot]"
        )
    return Doubt(
        "dot_origin_open",
        f"which dots are seen{where} is not decided: the likeliest place has a probability of {probability:.2g}, the "
        f"others are {sigma[0]:.1f} columns and {sigma[1]:.1f} rows off it (RMS); the orientation of the mirror is "
        f"as uncertain as that, {turned}; {remedy}{' for each facet' if several else ''}",
        {"place_probability": probability, "columns_off_count": float(sigma[0]), "rows_off_count": float(sigma[1])},
    )


def _shares(log_odds: FloatArray) -> FloatArray:
    weight = np.exp(log_odds - log_odds.max())
    return np.asarray(weight / weight.sum())


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    """Numbers in the table = turn @ numbers in the photo + shift; the slopes that it gives, linear over the facet.

    log_odds: Of their gradients and of the sizes of dots.
    fit (3, 2): Mean tilt off the design, and its change along x and y, in the facet's frame [rad, rad/m].
    mark_odds: The part of the odds that the sizes of dots give, against chance.
    """

    shift: IntArray
    log_odds: float
    fit: FloatArray
    mark_odds: float


@dataclass(frozen=True, slots=True, eq=False)
class _TiltFrame:
    """How a facet stands in the mirror, and what is known of its tilt before it is measured.

    place_m (2,): Its middle in the mirror's frame [m].
    turn (2, 2): Turns slopes of the facet into those of the mirror.
    covariance (2, 2): Of its tilt, by the pose and the mounting, in the mirror's frame [rad^2].
    is_known: Whether a dot is known: then the tilt follows, whatever it is.
    mounting_rad: How far one facet may be off the others [rad].
    """

    place_m: FloatArray
    turn: FloatArray
    covariance: FloatArray
    is_known: bool
    mounting_rad: float

    @classmethod
    def of(cls, sight: Sight) -> "_TiltFrame":
        own = sight.facet.ensemble_from_facet
        # A turn of the mirror about its y axis by a changes dz/dx by -a, about its x axis dz/dy by a.
        by_turn = np.array([[0.0, -1.0], [1.0, 0.0]]) @ sight.pose.cam_from_mirror.rotation.T[:2]
        covariance = by_turn @ sight.pose.covariance[:3, :3] @ by_turn.T + sight.mounting_rad**2 * np.eye(2)
        middle = own.apply(np.append(sight.facet.reference_point_m, 0.0))[:2]
        return cls(middle, own.rotation[:2, :2], covariance, sight.known is not None, sight.mounting_rad)

    def tilt(self, fit: FloatArray) -> FloatArray:
        """Return a mean tilt (2,) in the mirror's frame."""
        return np.asarray(self.turn @ fit[0])

    def gradient(self, fit: FloatArray) -> FloatArray:
        """Return how slopes change from place to place (2, 2), in the mirror's frame: d slope / d place."""
        return np.asarray(self.turn @ fit[1:].T @ self.turn.T)

    def log_odds(
        self,
        hypotheses: Sequence[_Hypothesis],
        before: Sequence[tuple[FloatArray, FloatArray]] = (),
        gradient: FloatArray | None = None,
    ) -> FloatArray:
        """Return the log odds of hypotheses (n,), up to a constant.

        before: Places and tilts of the facets that are placed already.
        gradient (2, 2): How slopes change from place to place within the facets. A pose of the field that is off
            changes them from facet to facet likewise, curvatures that are not the design's do not. No surface has
            curl: what there is of it tells how large the share of the set-up may be.
        """
        odds = np.array([one.log_odds for one in hypotheses])
        if self.is_known:
            return odds
        mean, covariance = np.zeros(2), self.covariance
        if before and gradient is not None:
            apart = np.array([self.place_m - place for place, _ in before])
            setup = (_SETUP_OF_CURL * 0.5 * (gradient[0, 1] - gradient[1, 0])) ** 2
            share = setup / (setup + _SHAPE_PER_M**2)
            told = np.array([tilt for _, tilt in before]) + share * apart @ gradient.T
            weight = 1.0 / (self.mounting_rad**2 + share * _SHAPE_PER_M**2 * np.sum(apart**2, axis=1))
            mean = weight @ told / weight.sum()
            covariance = (1.0 / weight.sum() + self.mounting_rad**2) * np.eye(2)
        off = np.array([self.tilt(one.fit) for one in hypotheses]) - mean
        tilted = 0.5 * np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off.T).T)
        # A mirror that hangs anyhow is rare, and there: sure marks outweigh its tilt.
        return np.asarray(odds - np.minimum(tilted, _TELLING))


def _of_turn(sight: Sight, turn: IntArray, within: float) -> list[_Hypothesis]:
    """Return the hypotheses of one turn of a lattice that are within so many sigmas of tilt of the best one."""
    dots = sight.dots
    number = dots.number @ turn.T
    low, high = number.min(axis=0), number.max(axis=0)
    rows, columns = sight.screen.shape
    first = np.array([sight.screen.first[0], sight.screen.first[1] - rows + 1])
    last = np.array([sight.screen.first[0] + columns - 1, sight.screen.first[1]])
    on_facet = np.flatnonzero(np.ones(len(number), dtype=np.bool_) if sight.on_facet is None else sight.on_facet)
    chosen = on_facet[spread_indices(len(on_facet), _SPREAD)]
    slopes = _Slopes.of(dots.centers_px[chosen], sight)
    if sight.known is not None:
        shifts = np.array([sight.known[0] - turn @ number_at(dots, sight.known[1])])
        told = _told_by_marks(sight, turn, shifts[0], shifts[0])
    else:
        # A line of the lattice that is beyond the table is of specks; more than a few are none.
        slack = 2
        lowest, highest = first - low - slack, last - high + slack
        ranges = [np.arange(lowest[k], highest[k] + 1) for k in range(2)]
        shifts = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 2)
        if not len(shifts):
            return []
        told = _told_by_marks(sight, turn, lowest, highest)
        may_be = slopes.may_be(sight, number[chosen], shifts, within)
        # What the marks say for certain no tilt excludes.
        may_be |= told > max(_TELLING, told.max() - _TELLING)
        shifts, told = shifts[may_be], told[may_be]
    found = []
    for shift, mark_odds in zip(shifts, told.tolist(), strict=True):
        there = sight.screen.has(*(number + shift).T)
        if np.count_nonzero(there) > 0.5 * len(number):
            odds, fit = slopes.judged(sight.screen.places_m(*(number[chosen] + shift).T))
            odds += np.count_nonzero(~there) * float(np.log(_FALSE_DOT)) + mark_odds
            found.append(_Hypothesis(shift, odds, fit, mark_odds))
    return found


def _told_by_marks(sight: Sight, turn: IntArray, low: IntArray, high: IntArray) -> FloatArray:
    """Return the log odds that the sizes of dots give to the shifts from low to high, flat; 0 without marks."""
    if sight.marks is None:
        return np.zeros(int(np.prod(high - low + 1)))
    return sight.marks.of_shifts(turn, low, high).ravel()


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
    """The slopes that dots give at their places on the mirror.

    points_m (3, n), camera_m (3,): Where the dots are seen on the design, and the camera, in the facet's frame [m].
    facet_from_screen: Place of the field in that frame.
    design (2, n): Slopes of the design there.
    terms (n, 3): 1 and the position about the reference point.
    sigma_per_m: Of curvatures, twist and curl.
    """

    points_m: FloatArray
    camera_m: FloatArray
    facet_from_screen: RigidTransform
    design: FloatArray
    terms: FloatArray
    sigma_per_m: float

    @classmethod
    def of(cls, places_px: FloatArray, sight: Sight) -> "_Slopes":
        facet_from_cam = (sight.pose.cam_from_mirror @ sight.facet.ensemble_from_facet).inverse()
        camera = facet_from_cam.translation_m
        rays = facet_from_cam.rotate(sight.setup.camera.cast_rays(places_px))
        points = camera + sight.facet.design.intersect(camera, rays)[:, None] * rays
        place = points[:, :2] - sight.facet.reference_point_m
        half_m = 0.5 * float(np.ptp(sight.facet.outline_m, axis=0).max())
        design = np.stack(sight.facet.design.gradient(points[:, 0], points[:, 1]))
        terms = np.column_stack([np.ones(len(place)), place])
        facet_from_screen = facet_from_cam @ sight.setup.cam_from_screen
        return cls(points.T, camera, facet_from_screen, design, terms, _GROSS_RAD / half_m)

    def may_be(self, sight: Sight, number: IntArray, shifts: IntArray, within: float) -> BoolArray:
        """Return which shifts (k, 2) the dots in the middle do not exclude by their tilt."""
        middle = np.argsort(np.linalg.norm(self.terms[:, 1:], axis=1))[:_MIDDLE]
        tilts = []
        for k in middle:
            screen = self.facet_from_screen.apply(sight.screen.places_m(*(number[k] + shifts).T)).T
            points = np.repeat(self.points_m[:, k : k + 1], len(shifts), axis=1)
            tilts.append(np.stack(slopes_at(points, self.camera_m, screen), axis=1) - self.design[:, k])
        known = np.isfinite(np.array(tilts)[..., 0]).any(axis=0)
        tilt = np.full((len(shifts), 2), np.inf)
        tilt[known] = np.nanmedian(np.array(tilts)[:, known], axis=0)
        size = np.linalg.norm(tilt, axis=1)
        turn_rad = float(np.sqrt(sight.mounting_rad**2 + np.linalg.eigvalsh(sight.pose.covariance[:3, :3]).max()))
        return np.asarray(size < size.min() + within * turn_rad)

    def judged(self, places_m: FloatArray) -> tuple[float, FloatArray]:
        """Return the log odds of the gradients that these places of the dots give, and mean tilt and gradients."""
        screen = self.facet_from_screen.apply(places_m).T
        error = np.stack(slopes_at(self.points_m, self.camera_m, screen)) - self.design
        usable = np.isfinite(error).all(axis=0)
        fit = np.linalg.lstsq(self.terms[usable], error[:, usable].T, rcond=None)[0]
        return -0.5 * float(np.sum(fit[1:] ** 2)) / self.sigma_per_m**2, np.asarray(fit, dtype=np.float64)


def find_light(image_dn: npt.NDArray[np.generic], ground_dn: Float32Array, region: BoolArray) -> FloatArray:
    """Find the one point light that the mirror shows.

    image_dn, ground_dn (h, w): The photo, and the mirror in it without dots [DN].
    region (h, w): Pixels that see the mirror.
    Returns (2,): Its centre in the photo [px].
    EstimationError: No spot stands out, or several do.
    """
    return next(place for place in find_lights(image_dn, ground_dn, (region,)) if place is not None)


def find_lights(
    image_dn: npt.NDArray[np.generic], ground_dn: Float32Array, regions: Sequence[BoolArray]
) -> list[FloatArray | None]:
    """Find the light in each facet that shows it, one in each at most.

    regions: Pixels (h, w) that see one facet, or several of one surface.
    Returns: Its centre (2,) in each region [px], None where a region shows none: a spot of less than a third of the
        brightest region's is another one.
    EstimationError: No spot stands out anywhere, or several do in one region.
    """
    of_each = []
    for region in regions:
        part, corner = _around(region)
        seen = region[part]
        above = np.where(seen, image_dn[part].astype(np.float32) - ground_dn[part], np.float32(0.0))
        sigma = robust_scale(above[seen], centred=False)
        spots = [(light, place + corner) for light, place in _spots(above, seen, _LIGHT_SIGMAS * sigma)]
        of_each.append(sorted(spots, key=lambda one: -one[0]))
    brightest = max((spots[0][0] for spots in of_each if spots), default=0.0)
    if not brightest:
        raise EstimationError(
            "no spot brighter than the ground is seen in the mirror: is there a light at dot (0, 0)? If not, origin = "
            '"unmarked"'
        )
    places: list[FloatArray | None] = []
    for spots in of_each:
        bright = [one for one in spots if one[0] * _SAME_LIGHT > brightest]
        if len(bright) > 1 and bright[1][0] * _LIGHT_RATIO > bright[0][0]:
            first, second = (one[1] for one in bright[:2])
            raise EstimationError(
                f"{len(spots)} spots in the mirror may be the light at dot (0, 0), such as at ({first[0]:.0f}, "
                f"{first[1]:.0f}) and ({second[0]:.0f}, {second[1]:.0f}) px; cover the others, or give "
                "[pattern.known_dot]"
            )
        places.append(bright[0][1] if bright else None)
    return places


def _around(region: BoolArray) -> tuple[tuple[slice, slice], FloatArray]:
    """Return the part of the photo that holds a region, one pixel beyond it, and the part's first pixel (x, y) [px]."""
    first, last = [], []
    for axis in (1, 0):
        seen = np.flatnonzero(region.any(axis=axis))
        first.append(max(int(seen[0]) - 1, 0) if seen.size else 0)
        last.append(int(seen[-1]) + 2 if seen.size else 1)
    return (slice(first[0], last[0]), slice(first[1], last[1])), np.array([first[1], first[0]], dtype=np.float64)


def _spots(above_dn: Float32Array, region: BoolArray, limit_dn: float) -> Sequence[tuple[float, FloatArray]]:
    """Return light (sum above the ground) and centre of each connected spot above a limit, within a region (h, w)."""
    import cv2

    count, label = cv2.connectedComponents((above_dn > limit_dn).astype(np.uint8), connectivity=8)
    inner = cv2.erode(region.astype(np.uint8), np.ones((3, 3), dtype=np.uint8), borderValue=0)
    found = []
    rows, columns = np.nonzero(label)
    of_spot = label[rows, columns]
    order = np.argsort(of_spot, kind="stable")
    bounds = np.searchsorted(of_spot[order], np.arange(1, count + 1))
    for first, last in pairwise(bounds.tolist()):
        row, column = rows[order[first:last]], columns[order[first:last]]
        # The ground is not known in the corners of a mirror, which therefore look bright.
        if not inner[row, column].all():
            continue
        light = above_dn[row, column].astype(np.float64)
        place = np.array([column @ light, row @ light]) / light.sum()
        found.append((float(light.sum()), place))
    return found
