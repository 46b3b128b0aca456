"""Where the absorber tube really is: its axis from the directions under which several photos see it.

Photos from different sides give both coordinates of the axis along its whole length (Owkes 2012, sections 5.3 and 6.4).
The cameras' poses are unknowns with their joint covariance, so that the tube's covariance is that of the photo network.
"""

from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from heliogauge.adjust.robust_scale import robust_scale, robust_scale_of_rows
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import skew
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.absorber.forgotten_glass import Widening, widening
from observer.photo_edges.tube_bearings import PULLED_SHARE, ROWS_ALIKE, SEARCH_M, Bearings, bearing
from observer.slopes.common_elimination import inverse_of, root_of, solve_with
from observer.slopes.pose_modes import MODES_PER_PHOTO, CameraModes, Photos, reduce_to_modes
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

#: Where the tube may be beside its design, as prior [m].
_PRIOR_M = 0.1
#: How much the tube may bend: scatter of the second difference over stations 1 m apart [m]. A tube that sags by 10 mm
#: between supports 4 m apart has 5 mm. Which of these it is, the bearings decide: a straight tube's stations help each
#: other, and clouds or the glass beside one of them do not bend it.
_BENDS_M = (0.01, 0.005, 0.0025)
#: The tube's wall [m]; Young's modulus of its steel [Pa]; densities of steel, glass and oil at 20 degrees C [kg/m^3].
#: Receivers of LS-2 and later: 70 mm outside, 66 inside, glass of 115 and 109 mm (Forristall 2003, NREL/TP-550-34169);
#: austenitic steel, borosilicate glass; diphenyl with its oxide.
_WALL_M, _STEEL_PA, _STEEL_KG_M3, _GLASS_KG_M3, _OIL_KG_M3 = 2e-3, 1.95e11, 7.9e3, 2.23e3, 1.06e3
#: A tube may hang so many times as far as its weight bends it. What the sun heats from below bends as well, by
#: ``alpha dT L^2 / (8 D)``, 6 mm over 4 m where its two sides differ by 13 K: as much again as by the weight where it
#: lies loose; some of either may have set at 400 degrees C.
_SET_TIMES = 2.0
_GRAVITY_M_S2 = 9.81
#: The most that is nearly as probable as the most probable one, by exp(-2), is believed.
_EVIDENCE_LOSS = 2.0
#: What the background does to the bisector is for this part of it alike along the whole tube; the rest stays alike over
#: this length, so that stations do not average it out [m].
_UNEVEN_SHARE, _ALIKE_M = 0.5, 1.0
#: Of the error that rows of one photo share, this part may be alike in all photos from one side, besides what single
#: photos have: what the glass throws back, and what it shows of the mirror, differ towards the trough's middle and away
#: from it.
_ONE_SIDED_SHARE = 0.5
#: Times the standard deviation beyond which a bearing is not the tube's.
_REJECT_TIMES = 4.0
#: A photo that the others move by more than so many standard deviations of its pose shows something else.
_FURTHEST_MODE = 5.0
#: Rounds of rejection; each may leave out one photo.
_MOST_ROUNDS = 12
#: With less than this share of the stations measured, what was found is by chance as wide as the tube.
_LEAST_SHARE = 0.15
#: A station whose place is less certain than this in its worst direction is not measured [m].
_LARGEST_SIGMA_M = 0.01


class StationFate(IntEnum):
    """What became of a station along the tube."""

    MEASURED = 0
    HIDDEN = 1
    ONE_SIDE = 2


STATION_TEXTS = {
    StationFate.MEASURED: "",
    StationFate.HIDDEN: "fewer than two photos show both edges of the tube here and tell where: behind a support, "
    "beyond the photo, or as bright as what is beside it",
    StationFate.ONE_SIDE: "seen from one side only: its place along the line of sight is uncertain by more than 10 mm",
}


@dataclass(frozen=True, slots=True, eq=False)
class AbsorberSolution:
    """The tube's axis as measured.

    path: The axis at its stations, with covariance; stations that were not measured are bridged.
    n_photos (n,): Photos that saw each station.
    fate (n,): `StationFate` of each station.
    used (m,): Which averaged bearings were used.
    residual_rms_rad: What remains of the bearings used [rad].
    diameter_m: How thick the tube looks: to be held against the collector's data [m].
    with_poses (2 n, 6 p): Covariance of the axis (x of all stations, then z) with the steps of all poses: both err
        together with the coordinates of the targets [m rad, m^2].
    pixel_m: What a pixel covers at the tube, in the median; 0 where that is not known [m].
    widening: How much wider the tube looks near its own reflection; None where there are too few photos.
    """

    path: AbsorberPath
    n_photos: IntArray
    fate: IntArray
    used: BoolArray
    residual_rms_rad: float
    diameter_m: float
    with_poses: FloatArray | None = None
    pixel_m: float = 0.0
    widening: Widening | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Directions:
    """Bearings averaged around stations: photo, station, place along the trough, deviation from a path, sigma.

    `one_sided_rad` is what the deviation changes by for one standard deviation of the error that photos from one side
    have in common, with the sign of that side.
    """

    photo: IntArray
    station: IntArray
    y_m: FloatArray
    deviation_rad: FloatArray
    sigma_rad: FloatArray
    one_sided_rad: FloatArray


def solve_absorber(
    bearings: Bearings, photos: Photos, start: AbsorberPath, stations_m: FloatArray, collector: Collector
) -> AbsorberSolution:
    """Adjust the tube's axis to all bearings, with the cameras' poses as uncertain as they are.

    stations_m (n,): Ascending stations along the trough [m].
    collector: How thick the tube is: where all photos show it thicker or thinner, something displaces its edges; where
        it is held.
    EstimationError: Fewer than two photos see the tube, or all see it from one side.
    """
    count = np.unique(bearings.photo).size
    if count < 2:
        raise EstimationError(
            f"absorber: {count} photos show both edges of the tube within {1e3 * SEARCH_M:.0f} mm of where it should "
            "be, two from different sides are needed. Is the tube as bright as what is seen behind it, or lit by the "
            "sun on one side? Photograph it in shade or before another sky. Are absorber_diameter_mm and "
            'focal_length_m right? Else give [absorber] photos of its own, a file, or source = "design"'
        )
    x, z = start.at(stations_m)
    path = AbsorberPath(stations_m, x, z, np.zeros((2 * stations_m.size, 2 * stations_m.size)))
    beams = _beams(stations_m, collector)
    # The second round averages around the tube as found, so that its slope does not count as scatter.
    for _ in range(2):
        directions = _averaged(bearings, photos, path, collector.absorber_diameter_m)
        path, used, residuals, with_poses = _adjust(directions, photos, path, beams)
    n_photos = np.bincount(directions.station[used], minlength=stations_m.size)
    fate = _fates(path, n_photos)
    if np.count_nonzero(fate == StationFate.MEASURED) < max(1.0, _LEAST_SHARE * path.n):
        raise EstimationError(_why_nothing(path, n_photos, bearings))
    rms = float(np.sqrt(np.mean(residuals[used] ** 2)))
    diameter, pixel = (float(np.median(one)) for one in (bearings.diameter_m, bearings.pixel_m))
    return AbsorberSolution(path, n_photos, fate, used, rms, diameter, with_poses, pixel, widening(bearings))


def _averaged(bearings: Bearings, photos: Photos, path: AbsorberPath, diameter_m: float) -> _Directions:
    """Average the bearings of each photo around each station, as deviations from a path."""
    x, z = path.at(bearings.y_m)
    deviation = bearings.angle_rad - bearing(x, z, photos.eyes_m[bearings.photo])
    station = np.searchsorted(0.5 * (path.y_m[1:] + path.y_m[:-1]), bearings.y_m)
    key = bearings.photo * path.n + station
    order = np.argsort(key, kind="stable")
    names, first, count = np.unique(key[order], return_index=True, return_counts=True)
    cell = np.repeat(np.arange(names.size), count)
    slot = np.arange(order.size) - first[cell]

    def table(values: FloatArray) -> FloatArray:
        cells = np.full((names.size, int(count.max())), np.nan)
        cells[cell, slot] = values[order]
        return cells

    deviations = table(deviation)
    middle = np.nanmedian(deviations, axis=1)
    spread = robust_scale_of_rows(deviations - middle[:, None])
    single = np.maximum(spread, np.nanmedian(table(bearings.sigma_rad), axis=1))
    inside = np.abs(deviations - middle[:, None]) <= 3 * single[:, None]
    mean = np.nanmean(np.where(inside, deviations, np.nan), axis=1)
    place = np.nanmean(np.where(inside, table(bearings.y_m), np.nan), axis=1)
    alike = max(1.0, _ALIKE_M * (path.n - 1) / float(path.y_m[-1] - path.y_m[0]))
    shared = np.nanmedian(table(bearings.shared_rad), axis=1)
    # A tube that looks wider than in the other photos has something dark beside one edge.
    wide = np.nanmedian(table(bearings.diameter_m), axis=1)
    away = photos.eyes_m[names // path.n] - np.stack([*path.at(place), place], axis=1)[:, [0, 2, 1]]
    distance = np.hypot(away[:, 0], away[:, 2])
    shared = np.hypot(shared, PULLED_SHARE * np.abs(wide - np.median(wide)) / distance)
    side, share = _one_sided_share(np.nanmedian(table(bearings.angle_rad), axis=1), names // path.n)
    # What displaces the edges of all photos does so to both of them, but for a share that has the side's sign. How it
    # changes with the angle is not known; as a height's does, so that photos from several angles do not tell it.
    slant = np.abs(away[:, 0]) / distance
    pulled = PULLED_SHARE * abs(float(np.median(wide)) - diameter_m) / distance
    one_sided = side * np.hypot(share * shared, pulled * slant / np.sqrt(np.mean(slant**2)))
    own = single / np.sqrt(np.maximum(1.0, inside.sum(axis=1) / ROWS_ALIKE))
    sigma = np.hypot(own, _UNEVEN_SHARE * np.sqrt(alike) * shared)
    return _Directions(names // path.n, names % path.n, place, mean, sigma, one_sided)


def _one_sided_share(angle_rad: FloatArray, photo: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the side of each bearing, and which part of its shared error all from that side have in common.

    What single photos have all along the tube counts as common, as much of it as the mean of one side's photos has.
    """
    side = np.sign(angle_rad)
    share = np.zeros(side.size)
    for way in (-1.0, 1.0):
        here = side == way
        share[here] = np.sqrt(_ONE_SIDED_SHARE**2 + 1 / max(np.unique(photo[here]).size, 1))
    return side, share


class _Adjusted(NamedTuple):
    """A path adjusted to averaged bearings: which of them were used, what remains, and its covariance with poses."""

    path: AbsorberPath
    used: BoolArray
    residuals_rad: FloatArray
    with_poses: FloatArray


def _adjust(directions: _Directions, photos: Photos, start: AbsorberPath, beams_m: FloatArray) -> _Adjusted:
    """Adjust a path to averaged bearings.

    beams_m (n, k): Shapes that the tube may take between its supports.
    """
    place, derivatives = _bearing_derivatives(directions, photos, start)
    modes = reduce_to_modes(derivatives, directions.photo, photos.covariance)
    index, value, size = _sparse_rows(directions, place, modes, start)
    prior = np.zeros((size, size))
    poses_known = inverse_of(root_of(modes.covariance)[0])
    prior[2 * start.n : -1, 2 * start.n : -1] = poses_known
    prior[-1, -1] = 1.0
    # The prior wants the tube, not the step from a path that was found already, near the design and straight.
    bent = np.concatenate([start.x_m - np.mean(start.x_m), start.z_m - np.mean(start.z_m)])
    used = np.ones(directions.photo.size, dtype=bool)
    for _ in range(_MOST_ROUNDS):
        normal, right = _normal_equations(index[used], value[used], directions, used, size)
        normal_left, wanted, following = _reduce_to_stations(normal + prior, right, 2 * start.n)
        smooth = _probable_smoothness(normal_left, wanted, bent, start.y_m, beams_m)
        inverse = np.linalg.inv(normal_left + smooth)
        stations = inverse @ (wanted - smooth @ bent)
        step = np.concatenate([stations, following[:, -1] - following[:, :-1] @ stations])
        residuals = directions.deviation_rad - (value * step[index]).sum(axis=1)
        scatter = max(robust_scale(residuals[used] / directions.sigma_rad[used]), 1.0)
        kept = np.abs(residuals) < _REJECT_TIMES * scatter * directions.sigma_rad
        kept &= ~_out_of_place(np.asarray(step[2 * start.n : -1]), directions.photo, used)
        if (kept == used).all():
            break
        used = kept
    n = start.n
    covariance = scatter**2 * inverse
    # The poses as the bundle left them; what the tube adds to them is left out.
    with_poses = -(following[:-1, :-1] @ inverse).T @ poses_known @ modes.with_steps(photos.covariance)
    path = AbsorberPath(start.y_m, start.x_m + step[:n], start.z_m + step[n : 2 * n], 0.5 * (covariance + covariance.T))
    return _Adjusted(path, used, residuals, with_poses)


def _out_of_place(modes: FloatArray, photo: IntArray, used: BoolArray) -> BoolArray:
    """Return the bearings not to be used because their photo is already out or has to be moved too far to fit.

    One photo a round: a wrong one pulls the others with it.
    """
    size = np.abs(modes.reshape(-1, MODES_PER_PHOTO)).max(axis=1)
    left_out = np.bincount(photo[used], minlength=size.size) == 0
    worst = int(np.argmax(np.where(left_out, 0.0, size)))
    left_out[worst] |= size[worst] > _FURTHEST_MODE
    return np.asarray(left_out[photo])


class _SparseRows(NamedTuple):
    """Unknowns of each averaged bearing and its derivatives, shape (m, 5 + modes), and how many unknowns there are."""

    unknown: IntArray
    value: FloatArray
    size: int


def _sparse_rows(directions: _Directions, place: FloatArray, modes: CameraModes, path: AbsorberPath) -> _SparseRows:
    """Set up the rows of the averaged bearings.

    Unknowns are x at all stations, z at all stations, modes, and what one side has in common; between stations the
    axis is straight.
    """
    before, share = path.shares(directions.y_m)
    after = np.minimum(before + 1, path.n - 1)
    last = 2 * path.n + len(modes.covariance)
    places = [before, after, path.n + before, path.n + after, 2 * path.n + modes.index, np.full_like(before, last)]
    weights = np.column_stack([1 - share, share])
    value = [weights * place[:, :1], weights * place[:, 1:], modes.derivative, directions.one_sided_rad]
    return _SparseRows(np.column_stack(places), np.column_stack(value), last + 1)


def _normal_equations(
    index: IntArray, value: FloatArray, directions: _Directions, used: BoolArray, size: int
) -> tuple[FloatArray, FloatArray]:
    """Return normal matrix and right side of rows that touch a few unknowns each."""
    weighted = value / directions.sigma_rad[used, None] ** 2
    pair = index[:, :, None] * size + index[:, None, :]
    products = weighted[:, :, None] * value[:, None, :]
    normal = np.bincount(pair.ravel(), products.ravel(), size * size).reshape(size, size)
    right = np.bincount(index.ravel(), (weighted * directions.deviation_rad[used, None]).ravel(), size)
    return np.asarray(normal, dtype=np.float64), np.asarray(right, dtype=np.float64)


def _bearing_derivatives(directions: _Directions, photos: Photos, path: AbsorberPath) -> tuple[FloatArray, FloatArray]:
    """Differentiate bearings with respect to (X_a, Z_a), shape (m, 2), and to the step of the pose, shape (m, 6)."""
    x, z = path.at(directions.y_m)
    return bearing_derivatives(np.stack([x, directions.y_m, z], axis=1), photos, directions.photo)


def bearing_derivatives(points_m: FloatArray, photos: Photos, photo: IntArray) -> tuple[FloatArray, FloatArray]:
    """Differentiate bearings of points.

    Shapes: photo (m,).
    points_m (m, 3): Points on the tube's axis [m].
    place (m, 2): Derivatives with respect to x and z of the point [rad/m].
    pose (m, 6): Derivatives of the bearing that a pixel gives, less that of the point, with respect to the step of
        the pose (`RigidTransform.moved`), pixel and point held: minus what a movement of the pose by mistake puts
        in [rad/rad, rad/m].
    """
    eyes = photos.eyes_m[photo]
    to_x, to_z = points_m[:, 0] - eyes[:, 0], eyes[:, 2] - points_m[:, 2]
    square = to_x**2 + to_z**2
    place = np.stack([to_z / square, to_x / square], axis=1)
    rotations = np.array([pose.rotation for pose in photos.poses])[photo]
    turned = np.einsum("mij,mj->mi", rotations, points_m)
    # The pixel is held: a movement of the pose moves the line of sight at the tube by -R^T (dt + w x R P).
    moved = np.empty((photo.size, 3, 6))
    moved[:, :, 3:] = -np.swapaxes(rotations, 1, 2)
    moved[:, :, :3] = np.swapaxes(rotations, 1, 2) @ skew(turned)
    return place, np.asarray(-(place[:, 0, None] * moved[:, 0] + place[:, 1, None] * moved[:, 2]))


class _ForStations(NamedTuple):
    """Normal matrix and right side that are left for the first n unknowns, and how the others follow.

    following: Minus its first n columns times the step of the first n unknowns, plus its last column.
    """

    normal: FloatArray
    right: FloatArray
    following: FloatArray


def _reduce_to_stations(normal: FloatArray, right: FloatArray, n: int) -> _ForStations:
    """Eliminate what follows the first n unknowns."""
    following = solve_with(root_of(normal[n:, n:])[0], np.column_stack([normal[n:, :n], right[n:]]))
    left = normal[:n, :n] - normal[:n, n:] @ following[:, :n]
    return _ForStations(left, right[:n] - normal[:n, n:] @ following[:, n], following)


def _probable_smoothness(
    normal: FloatArray, wanted: FloatArray, bent_m: FloatArray, stations_m: FloatArray, beams_m: FloatArray
) -> FloatArray:
    """Return the prior's precision of both coordinates along the stations, as smooth as the bearings show.

    By the marginal likelihood of what poses and sides leave of what the bearings say, with the stations integrated out.
    """
    evidence, priors = [], []
    for bend in _BENDS_M:
        smooth = np.asarray(np.kron(np.eye(2), _smoothness(stations_m, bend, beams_m)), dtype=np.float64)
        pulled = wanted - smooth @ bent_m
        misfit = bent_m @ smooth @ bent_m - pulled @ np.linalg.solve(normal + smooth, pulled)
        determinants = np.linalg.slogdet(smooth)[1] - np.linalg.slogdet(normal + smooth)[1]
        evidence.append(0.5 * float(determinants - misfit))
        priors.append(smooth)
    return priors[int(np.argmax(np.array(evidence) > max(evidence) - _EVIDENCE_LOSS))]


def _smoothness(stations_m: FloatArray, bend_m: float, beams_m: FloatArray) -> FloatArray:
    """Return the prior's precision of a coordinate along the stations."""
    n = stations_m.size
    precision = np.eye(n) / _PRIOR_M**2 / n
    if n >= 3:
        step = float(np.mean(np.diff(stations_m)))
        beams = np.diff(beams_m, 2, axis=0)
        covariance = bend_m**2 * step**3 * np.eye(n - 2) + beams @ beams.T
        second = np.diff(np.eye(n), 2, axis=0)
        precision += second.T @ np.linalg.solve(covariance, second)
    return np.asarray(0.5 * (precision + precision.T))


def sag_of_tube_m(collector: Collector, span_m: float) -> float:
    """Return how far the tube may hang between two supports, as a standard deviation [m].

    ``5 w L^4 / (384 E I)`` of a beam of even weight w that lies loose in them, filled with oil and with its glass, and
    some set. In clamps it bends a fifth of that, but which it is, and what set there, is not known.
    """
    outer = collector.absorber_diameter_m
    inner = outer - 2 * min(_WALL_M, outer / 4)
    ring, oil = outer**2 - inner**2, inner**2
    around = collector.glass
    glass = 0.0 if around is None else around.outer_diameter_m**2 - around.inner_diameter_m**2
    weight = _GRAVITY_M_S2 * np.pi / 4 * (_STEEL_KG_M3 * ring + _GLASS_KG_M3 * glass + _OIL_KG_M3 * oil)
    stiffness = _STEEL_PA * np.pi / 64 * (outer**4 - inner**4)
    return float(_SET_TIMES * 5 * weight * span_m**4 / (384 * stiffness))


def _beams(stations_m: FloatArray, collector: Collector) -> FloatArray:
    """Return the shapes of beams between supports, straight beyond them.

    stations_m (n,): Places along the tube [m].
    collector: The tube, and the k places where it is held.
    Returns (n, 3 (k - 1)): For one standard deviation of each of three shapes between two supports [m].

    ``E I d^4 w / d y^4 = q`` under an even weight q: the curvature is a parabola, whatever moments the supports put on
    the tube's ends. With t from -1 to 1 between supports, a sag s makes ``d^2 w / d t^2`` ``1.6 s (P0 - P2)(t)``
    where the ends are loose and ``8 s P2(t)`` in clamps, P the Legendre polynomials; P1 is of ends held differently.
    The curvature need not go on evenly at a support, which hides the place where a tube in clamps bends most.
    """
    found = [np.zeros((stations_m.size, 0))]
    slope, place = (np.polynomial.legendre.legint(np.diag([1.6, 1.6, 8.0]), m, lbnd=-1) for m in (1, 2))
    for first, last in pairwise(collector.held_y_m.tolist()):
        t = (2 * stations_m - first - last) / (last - first)
        inside = np.clip(t, -1, 1)
        bent, leaning = (np.polynomial.legendre.legval(inside, one) for one in (place, slope))
        found.append(sag_of_tube_m(collector, last - first) * (bent + leaning * (t - inside)).T)
    return np.concatenate(found, axis=1)


def _fates(path: AbsorberPath, n_photos: IntArray) -> IntArray:
    """Say of each station whether it was measured."""
    xx, zz = (np.diagonal(path.covariance_m2)[first : first + path.n] for first in (0, path.n))
    xz = np.diagonal(path.covariance_m2[: path.n, path.n :])
    worst = 0.5 * (xx + zz) + np.hypot(0.5 * (xx - zz), xz)
    fate = np.where(worst > _LARGEST_SIGMA_M**2, int(StationFate.ONE_SIDE), int(StationFate.MEASURED))
    return np.where(n_photos < 2, int(StationFate.HIDDEN), fate)


def _why_nothing(path: AbsorberPath, n_photos: IntArray, bearings: Bearings) -> str:
    found = int(np.count_nonzero(n_photos >= 2))
    if found < max(1.0, _LEAST_SHARE * path.n):
        return (
            f"absorber: only {found} of {path.n} places along the tube are seen with both edges by two photos that "
            "agree; are absorber_diameter_mm, focal_length_m and the targets right?"
        )
    spread = np.degrees(np.ptp(bearings.angle_rad))
    sigma = 1e3 * float(np.median(np.hypot(*path.sigma_at(path.y_m))))
    return (
        f"absorber: all photos see the tube from one side, within {spread:.1f} degrees, which leaves its place "
        f"uncertain by {sigma:.0f} mm; add photos from the other side, 60 to 90 degrees apart"
    )
