"""Turns of all facets, places of all cameras and of the source in one adjustment."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.overlay.camera_place import Station
from deflectometry.overlay.source_image import Source
from deflectometry.overlay.turn_fit import ViewTurn
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, FloatArray

#: A direction that a photo shows worse than this says nothing of a facet's turn: the image's edge runs along it.
_WORST_RAD = 2e-3
#: Steps for derivatives by pose (rad, m) and source (m).
_TURN_STEP, _SHIFT_STEP = 1e-6, 1e-4
#: The light is fitted again with the cameras where the adjustment put them.
_ROUNDS = 2
_BISECTIONS = 50
#: With fewer numbers than one that check each other nothing tells the wave; of one photo rounding made it up.
NO_CHECK = 1.0
#: Of a photo that shows edges in one direction only.
_WORST_CONDITION = 1e3

#: Returns the turns of a facet as each photo shows it, seen from given stations; from a start where there is one.
Fits = Callable[[Facet, Sequence[Station], Source, FloatArray | None], Sequence[ViewTurn]]


@dataclass(frozen=True, slots=True, eq=False)
class JointTurns:
    """What the adjustment found.

    turns_rad (k, 2): Of the facets; NaN where no photo shows the source.
    covariance (2 k, 2 k): Of all together [rad^2]; NaN likewise.
    random_rad (k, 2): What their sigmas are with cameras and source exactly known [rad].
    stations: Cameras where the adjustment put them.
    source: Likewise.
    wave_rad: By how much one photo's turn of a facet is off beyond its pixels, from the photos' differences [rad].
    redundancy: How many numbers of the photos check each other; the wave is as sure as these are many.
    seen_in: Numbers of the photos that show the source in each facet.
    left_out: Numbers of the photos that show light in each facet which no turn makes the source's image.
    place_misfits: What all facets in one photo are off alike, in sigmas; NaN where its camera was not surveyed.
    """

    turns_rad: FloatArray
    covariance: FloatArray
    random_rad: FloatArray
    stations: tuple[Station, ...]
    source: Source
    wave_rad: float
    redundancy: float
    seen_in: tuple[tuple[int, ...], ...]
    left_out: tuple[tuple[int, ...], ...]
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
    """Linear equations ``jacobian @ unknown = residual``: prior ones over sigma, those of reflections with variance."""

    prior_jacobian: FloatArray
    prior_residual: FloatArray
    jacobian: FloatArray
    residual: FloatArray
    variance: FloatArray

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
        seen: dict[int, list[ViewTurn]] = {}
        for k, facet in enumerate(facets):
            if fitted := fits(facet, moved, moved_source, turns.get(k)):
                seen[k] = list(fitted)
        equations = _equations(camera, facets, moved, moved_source, shift, sigma_m, seen)
        own = list(seen)
        count = 6 * len(moved) + 3
        known = np.isin(np.arange(len(own)), _determined(equations, count))
        if not known.any():
            raise EstimationError(
                "no facet shows the source in any photo so that its turn follows: none has an edge of a bright image "
                "on dark. Does the source stand where center_m in [source] says, was it lit, and do the photos show it?"
            )
        equations = _only(equations, count, known)
        wave = _wave(equations) if wave_rad is None else wave_rad
        unknown, covariance, leftover, share = equations.solve(wave)
        for place, station in enumerate(moved):
            step = unknown[6 * place : 6 * place + 6]
            moved[place] = replace(station, cam_from_heliostat=station.cam_from_heliostat.moved(step))
        shift = shift + sigma_m * unknown[count - 3 : count]
        moved_source = _shifted(source, shift)
        found = unknown[count:].reshape(-1, 2)
        own = [k for k, good in zip(own, known, strict=True) if good]
        turns = dict(zip(own, found, strict=True))
    rows = np.concatenate([[2 * k, 2 * k + 1] for k in own]).astype(int)
    total = np.full((2 * len(facets),) * 2, np.nan)
    total[np.ix_(rows, rows)] = covariance[count:, count:]
    values, random = np.full((len(facets), 2), np.nan), np.full(2 * len(facets), np.nan)
    values[own] = found
    weight = equations.jacobian[:, count:] / np.sqrt(equations.variance + wave**2)[:, None]
    random[rows] = np.sqrt(np.diag(np.linalg.inv(weight.T @ weight)))
    reflections = share[len(equations.prior_residual) :]
    photos_of = {
        k: tuple(
            one.view.photo
            for one in seen[k]
            if np.any(
                np.abs(equations.jacobian[:, count + 2 * n : count + 2 * n + 2]).sum(axis=1)
                * np.abs(equations.jacobian[:, 6 * one.view.photo : 6 * one.view.photo + 6]).sum(axis=1)
            )
        )
        for n, k in enumerate(own)
    }
    rest = leftover[len(equations.prior_residual) :] * np.sqrt(equations.variance + wave**2)
    return JointTurns(
        values,
        total,
        random.reshape(-1, 2),
        tuple(moved),
        moved_source,
        wave,
        float(reflections.sum()),
        tuple(photos_of.get(k, ()) for k in range(len(facets))),
        tuple(
            tuple(one.view.photo for one in seen.get(k, ()) if one.view.photo not in photos_of.get(k, ()))
            for k in range(len(facets))
        ),
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
    left, right, variance = [], [], []
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
    return _Equations(
        np.concatenate(prior),
        np.concatenate(prior_residual),
        np.array(left).reshape(-1, size),
        np.array(right),
        np.array(variance),
    )


def _reflections(
    camera: Camera, facet: Facet, stations: Sequence[Station], source: Source, sigma_m: float, one: ViewTurn
) -> list[tuple[FloatArray, float, float]]:
    """Return what a photo says of a facet's turn: along each direction that it shows, with its variance."""
    if one.gain_dn <= 0:
        # A source that is darker than what is beside it is a fit that went astray.
        return []
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


def _determined(equations: _Equations, count: int) -> list[int]:
    """Return the facets whose turn has both components."""
    found = []
    for number in range((equations.jacobian.shape[1] - count) // 2):
        part = equations.jacobian[:, count + 2 * number : count + 2 * number + 2]
        # Directions are of unit length: two that differ by 15 degrees leave more than this.
        if len(part) and np.linalg.eigvalsh(part.T @ part)[0] > 0.03:
            found.append(number)
    return found


def _only(equations: _Equations, count: int, known: BoolArray) -> _Equations:
    columns = np.concatenate([np.ones(count, dtype=bool), np.repeat(known, 2)])
    other = np.abs(equations.jacobian[:, ~columns]).sum(axis=1)
    rows = other == 0
    return _Equations(
        equations.prior_jacobian[:, columns],
        equations.prior_residual,
        equations.jacobian[rows][:, columns],
        equations.residual[rows],
        equations.variance[rows],
    )


def _wave(equations: _Equations) -> float:
    """Return the standard deviation that makes residuals of the reflections as large as they should be; 0 if none."""
    rows = slice(len(equations.prior_residual), None)

    def excess(wave_rad: float) -> float:
        _, _, leftover, share = equations.solve(wave_rad)
        return float(np.sum(leftover[rows] ** 2) - np.sum(share[rows]))

    if np.sum(equations.solve(0.0)[3][rows]) < NO_CHECK or excess(0.0) <= 0:
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
