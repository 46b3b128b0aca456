"""Turns of all facets, places of all cameras and of the source in one adjustment."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.overlay.camera_place import Station
from deflectometry.overlay.facet_fit import FacetFit, Unused
from deflectometry.overlay.source_image import Source
from deflectometry.overlay.turn_fit import ViewTurn, has_foreign_light
from heliogauge.adjust.robust_scale import SIGMA_PER_MAD
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: A direction that a photo shows worse than this says nothing of a facet's turn: the image's edge runs along it.
_WORST_RAD = 2e-3
#: Steps for derivatives by pose (rad, m) and source (m).
_TURN_STEP, _SHIFT_STEP = 1e-6, 1e-4
#: The light is fitted again with the cameras where the adjustment put them.
_ROUNDS = 2
_BISECTIONS = 50
#: With fewer numbers than one that check each other nothing tells the wave; of one photo rounding made it up.
NO_CHECK = 1.0
#: Numbers that check each other; with fewer the wave is known to worse than half of itself, 1 / sqrt(2 n).
FEWEST_CHECKS = 6.0
#: By how much waves turn a facet in one photo, in shares of their RMS slope: drawn facets, 0.06 mrad of 0.1 mrad.
TURN_BY_WAVES = 0.6
#: Student's distribution of fewer has no standard deviation (JCGM 101:2008, 6.4.9.4).
_FEWEST_OF_STUDENT = 3.0
#: Photos of a facet that differ by more sigmas are not by chance: one in a million, and the sigma is one of few.
_CONTRADICTS = 5.0
#: A number of which less is left by the adjustment is not checked by others.
_CHECKED = 0.05
#: Of a photo that shows edges in one direction only.
_WORST_CONDITION = 1e3

#: Returns the turns of a facet as each photo shows it, seen from given stations; from a start where there is one.
Fits = Callable[[Facet, Sequence[Station], Source, FloatArray | None], FacetFit]


@dataclass(frozen=True, slots=True, eq=False)
class JointTurns:
    """What the adjustment found.

    turns_rad (k, 2): Of the facets; NaN where no photo shows the source.
    covariance (2 k, 2 k): Of all together [rad^2]; NaN likewise.
    random_rad (k, 2): What their sigmas are with cameras and source exactly known [rad].
    stations: Cameras where the adjustment put them.
    source: Likewise.
    wave_rad: By how much one photo's turn of a facet is off beyond its pixels, from the photos' differences [rad]; the
        covariance holds besides that it is found from few numbers.
    redundancy: How many numbers of the photos check each other; the wave is as sure as these are many.
    unused: Of each facet, why photos are not used, by their numbers.
    rivals_rad: Of facets whose light two turns explain, by their numbers: both turns (2, 2).
    seen_in: Numbers of the photos that determine the turn of each facet.
    unchecked: Facets whose turn is not determined any more without one of the photos, shape (k,).
    place_misfits: What all facets in one photo are off alike, in sigmas; NaN where its camera was not surveyed.
    """

    turns_rad: FloatArray
    covariance: FloatArray
    random_rad: FloatArray
    stations: tuple[Station, ...]
    source: Source
    wave_rad: float
    redundancy: float
    unused: tuple[Mapping[int, Unused], ...]
    rivals_rad: Mapping[int, FloatArray]
    seen_in: tuple[tuple[int, ...], ...]
    unchecked: BoolArray
    place_misfits: FloatArray

    @property
    def known(self) -> BoolArray:
        """Facets whose turn is known, shape (k,)."""
        return np.asarray(np.isfinite(self.turns_rad).all(axis=1))

    def mean_turn(self) -> tuple[FloatArray, FloatArray]:
        """Return the mean turn of all facets, how the whole heliostat points, and its covariance (2, 2)."""
        mean = self._mean
        return mean @ np.nan_to_num(self.turns_rad).ravel(), mean @ np.nan_to_num(self.covariance) @ mean.T

    def canting(self) -> tuple[FloatArray, FloatArray]:
        """Return the turns against the mean of all facets (k, 2), and their covariance (2 k, 2 k)."""
        count = len(self.turns_rad)
        change = np.eye(2 * count) - np.tile(self._mean, (count, 1))
        values = change @ np.nan_to_num(self.turns_rad).ravel()
        covariance = change @ np.nan_to_num(self.covariance) @ change.T
        missing = ~np.repeat(self.known, 2)
        values[missing] = np.nan
        covariance[missing] = covariance[:, missing] = np.nan
        return values.reshape(-1, 2), covariance

    @property
    def _mean(self) -> FloatArray:
        """The matrix (2, 2 k) that takes the mean of the known turns."""
        return np.asarray(np.kron(self.known / int(self.known.sum()), np.eye(2)))


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Linear equations ``jacobian @ unknown = residual``: prior ones over sigma, those of reflections with variance.

    facets (k,): Facets whose turns are the last unknowns, two each.
    owner (m, 2): Facet and photo of each reflection.
    """

    prior_jacobian: FloatArray
    prior_residual: FloatArray
    jacobian: FloatArray
    residual: FloatArray
    variance: FloatArray
    facets: IntArray
    owner: IntArray

    @property
    def before(self) -> int:
        """Number of unknowns before those of turns."""
        return int(self.jacobian.shape[1]) - 2 * len(self.facets)

    def determined(self, rows: BoolArray) -> BoolArray:
        """Return whether some of the reflections determine the turn of each facet, shape (k,)."""
        found = []
        for number, facet in enumerate(self.facets):
            first = self.before + 2 * number
            part = self.jacobian[rows & (self.owner[:, 0] == facet), first : first + 2]
            # Directions are of unit length: two that differ by 15 degrees leave more than this.
            found.append(len(part) > 0 and np.linalg.eigvalsh(part.T @ part)[0] > 0.03)
        return np.array(found, dtype=bool)

    def only(self, rows: BoolArray) -> "_Equations":
        """Return the equations of some reflections, and of facets that these determine."""
        kept = self.determined(rows)
        columns = np.concatenate([np.ones(self.before, dtype=bool), np.repeat(kept, 2)])
        rows = rows & np.isin(self.owner[:, 0], self.facets[kept])
        return _Equations(
            self.prior_jacobian[:, columns],
            self.prior_residual,
            self.jacobian[rows][:, columns],
            self.residual[rows],
            self.variance[rows],
            self.facets[kept],
            self.owner[rows],
        )

    def solve(self, wave_rad: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return unknowns, their covariance, residuals over sigma and the share of each that is left (all rows)."""
        sigma = np.sqrt(self.variance + wave_rad**2)
        left = np.vstack([self.prior_jacobian, self.jacobian / sigma[:, None]])
        right = np.concatenate([self.prior_residual, self.residual / sigma])
        scale = np.linalg.norm(left, axis=0)
        scale[scale == 0] = 1.0
        q, r = np.linalg.qr(left / scale)
        if np.abs(np.diag(r)).min() < 1e-10:
            raise EstimationError(
                "photos and points do not determine turns and cameras; add points, or surveyed places (place_m)"
            )
        unknown = np.linalg.solve(r, q.T @ right)
        inverse = np.linalg.inv(r) / scale[:, None]
        leftover = right - q @ (q.T @ right)
        return unknown / scale, inverse @ inverse.T, leftover, 1 - np.sum(q**2, axis=1)


def adjust(
    camera: Camera,
    facets: Sequence[Facet],
    stations: Sequence[Station],
    source: Source,
    sigma_m: float,
    fits: Fits,
    wave_rad: float | None = None,
) -> JointTurns:
    """Adjust turns, cameras and source to points, survey and light together.

    sigma_m: Standard deviation of each coordinate of the source's middle [m].
    fits: Fits the light of a facet in each photo.
    wave_rad: As `JointTurns.wave_rad` where it is expected, for a plan; default: found from the photos' differences.
    EstimationError: No facet shows the source, or points and photos leave something open.
    """
    turns: dict[int, FloatArray] = {}
    shift = np.zeros(3)
    moved, moved_source = list(stations), source
    for _ in range(_ROUNDS):
        seen: dict[int, Sequence[ViewTurn]] = {}
        unused: list[dict[int, Unused]] = []
        rivals: dict[int, FloatArray] = {}
        for k, facet in enumerate(facets):
            fitted = fits(facet, moved, moved_source, turns.get(k))
            unused.append(dict(fitted.unused))
            if fitted.rivals_rad is not None:
                rivals[k] = fitted.rivals_rad
            if fitted.turns:
                seen[k] = fitted.turns
        equations = _equations(camera, facets, moved, moved_source, shift, sigma_m, seen)
        equations = equations.only(np.ones(len(equations.residual), dtype=bool))
        if wave_rad is None:
            equations = _consistent(equations, facets, moved_source, seen, unused)
        if not len(equations.facets):
            count_of = Counter(str(why) for own in unused for why in own.values())
            raise EstimationError(
                "no facet shows the source in any photo so that its turn follows: none has an edge of a bright image "
                "on dark. Does the source stand where center_m in [source] says, was it lit, and do the photos show it?"
                f" Facets in photos: {', '.join(f'{why} ({count})' for why, count in count_of.most_common())}"
            )
        wave = _wave(equations) if wave_rad is None else wave_rad
        spread = wave
        if wave_rad is None:
            # The standard deviation of what is scaled by an estimate from few numbers is Student's.
            checks = max(float(equations.solve(wave)[3][len(equations.prior_residual) :].sum()), _FEWEST_OF_STUDENT)
            spread = wave * float(np.sqrt(checks / (checks - 2)))
        unknown, covariance, leftover, share = equations.solve(spread)
        for place, station in enumerate(moved):
            step = unknown[6 * place : 6 * place + 6]
            moved[place] = replace(station, cam_from_heliostat=station.cam_from_heliostat.moved(step))
        count, own = equations.before, equations.facets
        shift = shift + sigma_m * unknown[count - 3 : count]
        moved_source = _shifted(source, shift)
        found = unknown[count:].reshape(-1, 2)
        turns = dict(zip(own.tolist(), found, strict=True))
    rows = np.column_stack([2 * own, 2 * own + 1]).ravel()
    total = np.full((2 * len(facets),) * 2, np.nan)
    total[np.ix_(rows, rows)] = covariance[count:, count:]
    values, random = np.full((len(facets), 2), np.nan), np.full(2 * len(facets), np.nan)
    values[own] = found
    weight = equations.jacobian[:, count:] / np.sqrt(equations.variance + spread**2)[:, None]
    random[rows] = np.sqrt(np.diag(np.linalg.inv(weight.T @ weight)))
    reflections = share[len(equations.prior_residual) :]
    used = {(int(k), int(photo)) for k, photo in equations.owner}
    for k, views in seen.items():
        for one in views:
            if (k, one.view.photo) not in used:
                unused[k].setdefault(one.view.photo, Unused.EDGE_ALONG)
    unchecked = np.zeros(len(facets), dtype=bool)
    for photo in range(len(moved)):
        unchecked[own] |= ~equations.determined(equations.owner[:, 1] != photo)
    rest = leftover[len(equations.prior_residual) :] * np.sqrt(equations.variance + spread**2)
    return JointTurns(
        values,
        total,
        random.reshape(-1, 2),
        tuple(moved),
        moved_source,
        wave,
        float(reflections.sum()),
        tuple(unused),
        rivals,
        tuple(tuple(sorted(photo for number, photo in used if number == k)) for k in range(len(facets))),
        unchecked,
        _misfits(moved, moved_source, equations, rest, float(reflections.sum())),
    )


def _shifted(source: Source, shift_m: FloatArray) -> Source:
    place = source.heliostat_from_source
    return replace(source, heliostat_from_source=RigidTransform(place.rotation, place.translation_m + shift_m))


def _equations(
    camera: Camera,
    facets: Sequence[Facet],
    stations: Sequence[Station],
    source: Source,
    shift_m: FloatArray,
    sigma_m: float,
    seen: Mapping[int, Sequence[ViewTurn]],
) -> _Equations:
    """Form the equations: steps of poses, shift of the source in its sigmas, turns of the facets that are seen."""
    count = 6 * len(stations) + 3
    size = count + 2 * len(seen)
    prior, prior_residual = [], []
    for number, station in enumerate(stations):
        residual, jacobian = station.equations(camera)
        rows = np.zeros((len(residual), size))
        rows[:, 6 * number : 6 * number + 6] = jacobian
        prior.append(rows)
        prior_residual.append(residual)
    rows = np.zeros((3, size))
    rows[:, count - 3 : count] = np.eye(3)
    prior.append(rows)
    prior_residual.append(-shift_m / sigma_m if sigma_m > 0 else np.zeros(3))
    left, right, variance, owner = [], [], [], []
    for place, (k, views) in enumerate(seen.items()):
        for one in views:
            for row, value, own in _reflections(camera, facets[k], stations, source, sigma_m, one):
                full = np.zeros(size)
                full[6 * one.view.photo : 6 * one.view.photo + 6] = -row[:6]
                full[count - 3 : count] = -row[6:9]
                full[count + 2 * place : count + 2 * place + 2] = row[9:]
                left.append(full)
                right.append(value)
                variance.append(own)
                owner.append((k, one.view.photo))
    return _Equations(
        np.concatenate(prior),
        np.concatenate(prior_residual),
        np.array(left).reshape(-1, size),
        np.array(right),
        np.array(variance),
        np.array(list(seen), dtype=int),
        np.array(owner, dtype=int).reshape(-1, 2),
    )


def _reflections(
    camera: Camera, facet: Facet, stations: Sequence[Station], source: Source, sigma_m: float, one: ViewTurn
) -> list[tuple[FloatArray, float, float]]:
    """Return what a photo says of a facet's turn: along each direction that it shows, with its variance."""
    values, vectors = np.linalg.eigh(one.information)
    pose = stations[one.view.photo].cam_from_heliostat
    drives = []
    for axis in range(6):
        size = _TURN_STEP if axis < 3 else _SHIFT_STEP
        both = [
            one.drive(facet, one.view.moved(camera, pose.moved(sign * size * np.eye(6)[axis]), facet), source)
            for sign in (1, -1)
        ]
        drives.append((both[0] - both[1]) / (2 * size))
    for axis in range(3):
        both = [one.drive(facet, one.view, _shifted(source, sign * _SHIFT_STEP * np.eye(3)[axis])) for sign in (1, -1)]
        drives.append(sigma_m * (both[0] - both[1]) / (2 * _SHIFT_STEP))
    found = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value <= 0:
            continue
        variance = max(float(vector @ one.scores @ vector) / value**2, 1 / value)
        if variance < _WORST_RAD**2:
            response = np.array([vector @ drive / value for drive in drives])
            found.append((np.concatenate([response, vector]), float(vector @ one.turn_rad), variance))
    return found


def _consistent(
    equations: _Equations,
    facets: Sequence[Facet],
    source: Source,
    seen: Mapping[int, Sequence[ViewTurn]],
    unused: Sequence[dict[int, Unused]],
) -> _Equations:
    """Leave out photos of facets whose light no image of the source explains, and those that contradict the others.

    What is left out is noted in unused. How far edges and turns scatter is found from all facets, by a median that few
    of them do not move.
    """
    views = {(k, one.view.photo): one for k, own in seen.items() for one in own}
    while len(equations.facets):
        wave, off = _scatter(equations)
        if off is None:
            break
        owners = {(int(k), int(photo)) for k, photo in equations.owner}
        blur_m = float(np.exp(np.median([views[one].state[4] for one in owners])))
        out = {
            (k, photo): Unused.FOREIGN
            for k, photo in owners
            if has_foreign_light(facets[k], views[k, photo], source, wave / TURN_BY_WAVES, blur_m)
        }
        if not out and off.max() > _CONTRADICTS:
            k, photo = (int(one) for one in equations.owner[np.argmax(off)])
            same = [other for other in owners if other[0] == k]
            # Of two that differ neither is known to be wrong.
            out = {(k, photo): Unused.CONTRADICTS} if len(same) > 2 else dict.fromkeys(same, Unused.ALL_CONTRADICT)
        if not out:
            break
        for (k, photo), why in out.items():
            unused[k][photo] = why
        equations = equations.only(np.array([(int(k), int(n)) not in out for k, n in equations.owner]))
    return equations


def _scatter(equations: _Equations) -> tuple[float, FloatArray | None]:
    """Return the wave by the median of the reflections' residuals, and each of them in sigmas; None where too few."""
    rows = slice(len(equations.prior_residual), None)

    def sizes(wave_rad: float) -> FloatArray:
        _, _, leftover, share = equations.solve(wave_rad)
        # What nothing checks has no residual.
        checked = share[rows] > _CHECKED
        return np.where(checked, np.abs(leftover[rows]) / np.sqrt(np.where(checked, share[rows], 1.0)), np.nan)

    if np.sum(equations.solve(0.0)[3][rows]) < FEWEST_CHECKS:
        return 0.0, None

    def excess(wave_rad: float) -> float:
        return SIGMA_PER_MAD * float(np.nanmedian(sizes(wave_rad))) - 1

    wave = _root(excess)
    return wave, np.nan_to_num(sizes(wave))


def _wave(equations: _Equations) -> float:
    """Return the standard deviation that makes residuals of the reflections as large as they should be; 0 if none."""
    rows = slice(len(equations.prior_residual), None)

    def excess(wave_rad: float) -> float:
        _, _, leftover, share = equations.solve(wave_rad)
        return float(np.sum(leftover[rows] ** 2) - np.sum(share[rows]))

    if np.sum(equations.solve(0.0)[3][rows]) < NO_CHECK:
        return 0.0
    return _root(excess)


def _root(excess: Callable[[float], float]) -> float:
    """Return where a falling function of the wave is 0; 0 where it is nowhere above."""
    if excess(0.0) <= 0:
        return 0.0
    low, high = -20.0, 2.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(float(np.exp(middle))) > 0 else (low, middle)
    return float(np.exp(high))


def _misfits(
    stations: Sequence[Station], source: Source, equations: _Equations, rest_rad: FloatArray, redundancy: float
) -> FloatArray:
    """Return what all facets in one photo are off alike, against their scatter and the survey, in sigmas.

    rest_rad: What the adjustment left of each reflection [rad]. A camera that stood elsewhere turns all facets of its
    photo alike, by its shift over twice its distance.
    """
    found, scatter = np.full(len(stations), np.nan), 0.0
    alike = []
    for number in range(len(stations)):
        rows = np.abs(equations.jacobian[:, 6 * number : 6 * number + 6]).sum(axis=1) > 0
        if not rows.any():
            alike.append((np.zeros((0, 2)), np.zeros(2)))
            continue
        directions = equations.jacobian[rows, 6 * len(stations) + 3 :].reshape(int(rows.sum()), -1, 2).sum(axis=1)
        common = np.linalg.lstsq(directions, rest_rad[rows], rcond=None)[0]
        scatter += float(np.sum((rest_rad[rows] - directions @ common) ** 2))
        alike.append((directions, common))
    freedom = redundancy - 2 * len(stations)
    if freedom < 1:
        return found
    for number, ((directions, common), station) in enumerate(zip(alike, stations, strict=True)):
        products = directions.T @ directions
        if station.place_m is None or not len(directions) or np.linalg.cond(products) > _WORST_CONDITION:
            continue
        distance = np.linalg.norm(station.cam_from_heliostat.inverse().translation_m)
        by_survey = (station.sigma_place_m / (2 * distance)) ** 2
        variance = scatter / freedom * np.linalg.inv(products) + by_survey * np.eye(2)
        found[number] = float(np.sqrt(common @ np.linalg.solve(variance, common)))
    return found
