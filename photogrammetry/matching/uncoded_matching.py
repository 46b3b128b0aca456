"""Targets without a code: found again in other photos through the known poses, as far as these are certain.

Every decision is a test against a covariance: of the dots, of the poses and of the lens, jointly, as the adjustment
gave it. What agrees by chance is counted (a-contrario: expected number of accidental agreements of all that were
tried), so that no limit in pixels is needed and a photo full of false dots makes the test stricter by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, lgamma, log

import numpy as np

from heliogauge.adjust.chi_square import chi_square_limit
from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.matching.uncertain_rays import Dots, KnownViews, UncertainRays, widened
from photogrammetry.start_values.network import ImagePlace, LeftOut
from photogrammetry.start_values.triangulation import LEAST_ANGLE_RAD

#: Accidents among points of two rays, which the result names as weak, in terms of those among all others.
_TWO_RAYS = 5.0

#: More agreements by chance than any limit allows.
_LARGEST_EXPONENT = 700.0


@dataclass(frozen=True, slots=True)
class MatchLimits:
    """When dots belong together.

    significance: Probability of losing a ray, or a point, that is right.
    most_accidents: Expected number of points, of all, that agree by accident.
    most_missing: Photos that should show a point seen in two photos only, and do not.
    reach: How far from the middle of the known targets points are looked for, in distances of the farthest known
        one.
    InputError: Probabilities or numbers that make no sense.
    """

    significance: float = 1e-4
    most_accidents: float = 0.01
    most_missing: int = 2
    reach: float = 2.0

    def __post_init__(self) -> None:
        if not (0 < self.significance < 0.5 and self.most_accidents > 0 and self.most_missing >= 0 and self.reach > 0):
            raise InputError(
                "match limits: 0 < significance < 0.5, most_accidents > 0, most_missing >= 0, reach > 0 are needed"
            )


@dataclass(frozen=True, slots=True, eq=False)
class MatchedDots:
    """Points found from dots.

    points_m (n, 3): The points; in the order of their first dot [m].
    covariance_m2 (n, 3, 3): Their covariance, uncertainty of the poses included [m^2].
    point_of_dot (m,): The point of each dot, -1 for none.
    accidents (n,): Expected number of such agreements by accident.
    rejected: What looked like a point and was not taken, with the reason; photos by their number.
    """

    points_m: FloatArray
    covariance_m2: FloatArray
    point_of_dot: IntArray
    accidents: FloatArray
    rejected: tuple[LeftOut, ...]


def match_dots(dots: Dots, views: KnownViews, limits: MatchLimits | None = None) -> MatchedDots:
    """Find the points that dots of several photos are images of.

    views: Cameras and poses with their joint covariance.
    limits: When dots belong together.
    Returns: Points with at least three rays, or two that nothing else explains.
    InputError: A dot of a photo that is not among the views.

    Pairs of photos by their parallax: dots on each other's epipolar lines give points, which are looked for in all
    other photos. A point stands if its rays meet within the joint covariance of dots, poses and intrinsics
    (chi-square of generalised least squares, 2 n - 3 degrees of freedom) and the expected number of accidents is
    small: number of pairs tried, times the probability that so many of the photos that should show the point have a
    dot there by chance. Two rays alone stand only where no dot of either photo has another partner, no more than a
    few photos should show the point too, and chance partners are rare. Covariances of dots are widened by the largest
    eccentricity their ellipse can have, a^2 / (2 f).
    """
    asked = limits or MatchLimits()
    if len(dots) and int(dots.photo_index.max()) >= len(views.poses):
        raise InputError(f"dots: photo {int(dots.photo_index.max())} is not among the {len(views.poses)} views")
    search = _Search(widened(dots, views), views, asked)
    for first, second in _pairs(search):
        search.try_pair(first, second)
    left = _pairs(search)
    for first, second in left:
        search.try_two_rays(first, second, len(left))
    return search.result()


def _pairs(search: "_Search") -> list[tuple[int, int]]:
    """Return pairs of photos with free dots, those with the wider parallax (up to a right angle) first."""
    centers = np.stack([pose.inverse().translation_m for pose in search.views.poses])
    arms = search.views.middle_m - centers
    arms /= np.linalg.norm(arms, axis=1, keepdims=True)
    sine = np.linalg.norm(np.cross(arms[:, None], arms[None]), axis=2)
    filled = np.bincount(search.dots.photo_index[search.free], minlength=len(centers))
    first, second = np.nonzero(np.triu(sine > np.sin(LEAST_ANGLE_RAD), 1) & (np.outer(filled, filled) > 0))
    # Very wide pairs see the dots too differently: 45 degrees fix a point almost as well as 90.
    order = np.argsort(-np.minimum(sine[first, second], 0.7), kind="stable")
    return list(zip(first[order].tolist(), second[order].tolist(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    dots: tuple[int, ...]
    point_m: FloatArray
    covariance_m2: FloatArray
    accidents: float
    should_see: int


class _Search:
    """The search while it goes on: which dots are free, which points were found."""

    def __init__(self, dots: Dots, views: KnownViews, limits: MatchLimits) -> None:
        self.dots, self.views, self.limits = dots, views, limits
        self.free: BoolArray = np.ones(len(dots), dtype=np.bool_)
        self.rows = [np.nonzero(dots.photo_index == photo)[0] for photo in range(len(views.poses))]
        self.found: list[_Hypothesis] = []
        self.doubtful: dict[tuple[int, ...], str] = {}
        self.tried = 0
        self._gate = {n: chi_square_limit(limits.significance, n) for n in (1, 2)}
        self.rays = UncertainRays(dots, views)

    # --- three rays and more ---------------------------------------------------------------------------------------

    def try_pair(self, first: int, second: int) -> None:
        """Take the points that start from a pair of photos and are seen in a third."""
        rows, points = self._candidates(first, second)
        self.tried += len(rows)
        hypotheses = self._support(rows, points)
        hypotheses.sort(key=lambda one: one.accidents)
        for place, one in enumerate(hypotheses):
            if not self.free[list(one.dots)].all():
                continue
            rivals = [other for other in hypotheses[place + 1 :] if _contradict(one, other)]
            if any(_comparable(one, other) for other in rivals):
                self.doubtful[one.dots] = "two points explain its dots equally well"
                continue
            self._take(one)

    def _take(self, one: _Hypothesis) -> None:
        self.found.append(one)
        self.free[list(one.dots)] = False

    def _candidates(self, first: int, second: int) -> tuple[IntArray, FloatArray]:
        """Dots of two photos that are on each other's epipolar line, (h, 2), and their points, (h, 3)."""
        one, two = (rows[self.free[rows]] for rows in (self.rows[first], self.rows[second]))
        pairs = self._rough_pairs(one, two)
        if not len(pairs):
            return pairs, np.zeros((0, 3))
        fit = self.rays.fitted((first, second), pairs, self.rays.crossing(pairs))
        near = np.linalg.norm(fit.points_m - self.views.middle_m, axis=1) < self.limits.reach * self.views.reach_m
        good = (fit.chi_square < self._gate[1]) & near & self._in_front((first, second), fit.points_m)
        return pairs[good], fit.points_m[good]

    def _rough_pairs(self, one: IntArray, two: IntArray) -> IntArray:
        """Pairs whose rays miss each other by less than ten sigma, poses taken as uncertain as one by one."""
        origins, directions, sigma = self.rays.lines
        if not (one.size and two.size):
            return np.zeros((0, 2), dtype=np.intp)
        base = origins[two[0]] - origins[one[0]]
        normal = np.cross(directions[one][:, None], directions[two][None])
        sine = np.maximum(np.linalg.norm(normal, axis=2), 1e-9)
        miss = np.abs(normal @ base) / sine
        # Distances to where the rays pass each other.
        along_one = np.einsum("abi,abi->ab", np.cross(base, directions[two])[None], normal) / sine**2
        along_two = np.einsum("abi,abi->ab", np.cross(base, directions[one])[:, None], normal) / sine**2
        reach = np.hypot(sigma[one][:, None] * along_one, sigma[two][None] * along_two)
        first, second = np.nonzero((miss < 10 * reach) & (along_one > 0) & (along_two > 0))
        return np.stack([one[first], two[second]], axis=1)

    def _in_front(self, photos: Sequence[int], points_m: FloatArray) -> BoolArray:
        seen = [
            np.isfinite(self.views.camera(p).project(self.views.poses[p].apply(points_m))).all(axis=1) for p in photos
        ]
        return np.asarray(np.logical_and.reduce(seen))

    def _support(self, rows: IntArray, points: FloatArray) -> list[_Hypothesis]:
        """Look for points in all other photos; keep those with a third ray."""
        if not len(rows):
            return []
        first, second = (int(self.dots.photo_index[rows[0, k]]) for k in (0, 1))
        helpers: list[list[int]] = [[] for _ in rows]
        chances: list[list[float]] = [[] for _ in rows]
        for photo in range(len(self.rows)):
            if photo in (first, second):
                continue
            self._look_into(photo, rows, points, helpers, chances)
        found = []
        for k, own in enumerate(helpers):
            if own:
                one = self._confirm((*rows[k].tolist(), *own), points[k], chances[k])
                if one is not None:
                    found.append(one)
        return list({tuple(sorted(one.dots)): one for one in found}.values())

    def _look_into(
        self,
        photo: int,
        rows: IntArray,
        points: FloatArray,
        helpers: list[list[int]],
        chances: list[list[float]],
    ) -> None:
        """Look for points in one photo: nearest dot within the gate, and its probability by chance."""
        camera = self.views.camera(photo)
        predicted, covariance = self.rays.predicted(photo, rows, points)
        size = np.array([camera.width_px, camera.height_px])
        inside = np.isfinite(predicted).all(axis=1) & ((predicted > 0) & (predicted < size - 1)).all(axis=1)
        own = self.rows[photo][self.free[self.rows[photo]]]
        for k in np.nonzero(inside)[0].tolist():
            area = np.pi * self._gate[2] * float(np.sqrt(np.linalg.det(covariance[k]))) * own.size
            chances[k].append(min(area / float(size.prod()), 1.0))
            if not own.size:
                continue
            off = self.dots.pixels_px[own] - predicted[k]
            whole = covariance[k] + self.dots.covariance_px2[own]
            squares = np.einsum("mi,mi->m", off, np.linalg.solve(whole, off[:, :, None])[:, :, 0])
            best = int(np.argmin(squares))
            if squares[best] < self._gate[2]:
                helpers[k].append(int(own[best]))

    def _confirm(self, members: tuple[int, ...], start: FloatArray, chances: list[float]) -> _Hypothesis | None:
        """Adjust a point with all its rays; leave out rays that do not agree; count accidents."""
        members = tuple(sorted(members))
        while len(members) >= 3:
            photos = [int(self.dots.photo_index[k]) for k in members]
            fit = self.rays.fitted(photos, np.array([members]), start[None])
            freedom = 2 * len(members) - 3
            if fit.chi_square[0] < chi_square_limit(self.limits.significance, freedom):
                break
            worst = int(np.argmax(fit.misses[0]))
            members = members[:worst] + members[worst + 1 :]
        else:
            return None
        extra = len(members) - 2
        # As if all photos had the chance of the mean: at most as improbable as it is.
        chance = float(np.mean(chances))
        accidents = self.tried * chance_agreements(len(chances), extra, chance)
        if accidents > self.limits.most_accidents:
            self.doubtful[members] = f"{accidents:.2g} such agreements of {len(members)} rays are expected by accident"
            return None
        return _Hypothesis(members, fit.points_m[0], fit.covariance_m2[0], accidents, len(chances) + 2)

    # --- two rays --------------------------------------------------------------------------------------------------

    def try_two_rays(self, first: int, second: int, n_pairs: int) -> None:
        """Take points of two rays that nothing else explains, in one of so many pairs of photos."""
        rows, points = self._candidates(first, second)
        if not len(rows):
            return
        expected = n_pairs * self._expected_pairs(first, second, rows, points)
        for row, point in zip(rows, points, strict=True):
            pair = tuple(sorted(row.tolist()))
            others = self._partners(pair)
            missing = self._should_see(point) - 2
            if others:
                self.doubtful[pair] = "its dots have other partners along their epipolar lines"
            elif missing > self.limits.most_missing:
                self.doubtful[pair] = f"{missing} other photos should show it and do not"
            elif expected > _TWO_RAYS * self.limits.most_accidents:
                self.doubtful[pair] = f"{expected:.2g} such agreements of two rays are expected by accident"
            elif self.free[list(pair)].all():
                fit = self.rays.fitted([int(self.dots.photo_index[k]) for k in pair], np.array([pair]), point[None])
                self._take(_Hypothesis(pair, fit.points_m[0], fit.covariance_m2[0], expected, missing + 2))

    def _expected_pairs(self, first: int, second: int, rows: IntArray, points: FloatArray) -> float:
        """Return the expected number of chance pairs of free dots: share of the image near a line, times pairs."""
        one, two = (int(np.count_nonzero(self.free[self.rows[photo]])) for photo in (first, second))
        camera = self.views.camera(second)
        _, covariance = self.rays.across_line(first, second, rows, points)
        length = float(np.hypot(camera.width_px, camera.height_px))
        width = 2 * np.sqrt(self._gate[1]) * float(np.sqrt(covariance.max()))
        return float(one * two * length * width) / (camera.width_px * camera.height_px)

    def _partners(self, pair: tuple[int, ...]) -> bool:
        """Whether a dot of a pair has another free partner anywhere."""
        for dot in pair:
            photo = int(self.dots.photo_index[dot])
            for other in range(len(self.rows)):
                if other == photo:
                    continue
                rest = self.rows[other][self.free[self.rows[other]]]
                rest = rest[~np.isin(rest, pair)]
                rough = self._rough_pairs(np.array([dot]), rest)
                if len(rough):
                    order = (photo, other)
                    fit = self.rays.fitted(order, rough, self.rays.crossing(rough))
                    near = np.linalg.norm(fit.points_m - self.views.middle_m, axis=1)
                    if ((fit.chi_square < self._gate[1]) & (near < self.limits.reach * self.views.reach_m)).any():
                        return True
        return False

    def _should_see(self, point: FloatArray) -> int:
        count = 0
        for photo, pose in enumerate(self.views.poses):
            camera = self.views.camera(photo)
            pixel = camera.project(pose.apply(point))
            size = np.array([camera.width_px, camera.height_px])
            count += bool(np.isfinite(pixel).all() and (pixel > 0).all() and (pixel < size - 1).all())
        return count

    # --- end -------------------------------------------------------------------------------------------------------

    def result(self) -> MatchedDots:
        """Collect what was found, in the order of the first dots."""
        found = sorted(self.found, key=lambda one: min(one.dots))
        point_of_dot = np.full(len(self.dots), -1, dtype=np.intp)
        for place, one in enumerate(found):
            point_of_dot[list(one.dots)] = place
        texts = []
        for dots, reason in self.doubtful.items():
            if (point_of_dot[list(dots)] < 0).all():
                x, y = self.dots.pixels_px[dots[0]]
                photo = int(self.dots.photo_index[dots[0]])
                where = ImagePlace(str(photo), float(x), float(y))
                texts.append(LeftOut(f"dot at ({x:.0f}, {y:.0f}) in photo {photo}", reason, place=where))
        return MatchedDots(
            np.array([one.point_m for one in found]).reshape(-1, 3),
            np.array([one.covariance_m2 for one in found]).reshape(-1, 3, 3),
            point_of_dot,
            np.array([one.accidents for one in found]),
            tuple(texts),
        )


def chance_agreements(among: int, extra: int, chance: float) -> float:
    """Return how many sets of some of so many photos agree by chance: their number times the chance that all do.

    By logarithms: of a thousand photos there are more sets than numbers of double precision reach.
    """
    if chance <= 0 or extra > among:
        return float(extra == 0)
    sets = lgamma(among + 1) - lgamma(extra + 1) - lgamma(among - extra + 1)
    return exp(min(sets + extra * log(chance), _LARGEST_EXPONENT))


def _contradict(one: _Hypothesis, other: _Hypothesis) -> bool:
    """Whether two points claim the same dot and are not the same with a ray more or less."""
    shared = set(one.dots) & set(other.dots)
    return bool(shared) and len(shared) < min(len(one.dots), len(other.dots))


def _comparable(one: _Hypothesis, other: _Hypothesis) -> bool:
    """Whether the other point is almost as well founded: no more than one ray less, which could be a false one."""
    return len(other.dots) >= len(one.dots) - 1
