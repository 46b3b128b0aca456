"""Where the absorber tube really is: its silhouette in several photos, by the bisector of the two tangent rays.

Across the trough the outline of a round tube is touched by two lines of sight whose bisector goes through its axis
whatever the distance; the middle between the two edges on a plane does not (0.17 mm off at 7 m and 45 degrees). With
the camera at (X_c, Z_c) the axis (X_a, Z_a) is seen under ``eta = atan2(X_a - X_c, Z_c - Z_a)``; photos from different
sides give both coordinates (Owkes 2012, sections 5.3 and 6.4).
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.camera import Camera
from heliogauge.errors import EstimationError
from heliogauge.rigid import RigidTransform, skew
from heliogauge.surfaces import quadric
from heliogauge.validate import FloatArray
from observer.absorber_path import AbsorberPath
from observer.camera_modes import reduce_to_modes
from observer.edges import Edges, find_edges
from observer.rectify import rectified_strip
from observer.reflection import AnyImage, Expectation
from observer.reflector import Photos
from observer.slope_field import IntArray

#: How far from its design place the tube is searched [m].
_SEARCH_M = 0.06
#: By what share the silhouette's width may differ from the tube's.
_WIDTH_SHARE = 0.12
#: Where the tube may be beside its design, as prior [m].
_PRIOR_M = 0.1
#: How much the tube may bend: scatter of the second difference over stations 1 m apart [m]. A tube that sags by 10 mm
#: between supports 4 m apart has 5 mm.
_BEND_M = 0.01
#: Scatter within a station below this says more of the pixel grid than of the tube [rad].
_FLOOR_RAD = 2e-6


@dataclass(frozen=True, slots=True, eq=False)
class Bearings:
    """Directions across the trough under which photos see the tube's axis.

    Parameters
    ----------
    photo : ndarray of int, shape (m,)
        Photo.
    y_m : ndarray, shape (m,)
        Place along the trough [m].
    angle_rad : ndarray, shape (m,)
        eta of the module's text [rad].
    sigma_rad : ndarray, shape (m,)
        Standard deviation [rad].
    """

    photo: IntArray
    y_m: FloatArray
    angle_rad: FloatArray
    sigma_rad: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class AbsorberSolution:
    """The tube's axis as measured.

    Parameters
    ----------
    path : AbsorberPath
        The axis at its stations, with covariance.
    n_photos : ndarray of int, shape (n,)
        Photos that saw each station.
    used : ndarray of bool, shape (m,)
        Which averaged bearings were used.
    residual_rms_rad : float
        What remains of the bearings used [rad].
    """

    path: AbsorberPath
    n_photos: IntArray
    used: np.ndarray
    residual_rms_rad: float


def bearing(x_m: FloatArray, z_m: FloatArray, eyes_m: FloatArray) -> FloatArray:
    """Return under what angle across the trough a camera sees a point.

    Parameters
    ----------
    x_m, z_m : ndarray, shape (m,)
        Points [m].
    eyes_m : ndarray, shape (m, 3)
        Cameras [m].

    Returns
    -------
    ndarray, shape (m,)
        Angle from straight down, positive towards +x [rad].
    """
    return np.arctan2(x_m - eyes_m[:, 0], eyes_m[:, 2] - z_m)


def tube_bearings(image: AnyImage, photo: int, view: tuple[Camera, RigidTransform], expected: Expectation) -> Bearings:
    """Find the tube itself in one photo.

    Parameters
    ----------
    image : ndarray, shape (height, width)
        The photo, grey [DN].
    photo : int
        Its number.
    view : (Camera, RigidTransform)
        Its camera and ``cam_from_frame``.
    expected : Expectation
        Collector, where the tube should be, and rows along the trough.

    Returns
    -------
    Bearings
        One for each row in which both edges were found.
    """
    camera, pose = view
    eye = pose.inverse().translation_m
    radius = expected.collector.absorber_diameter_m / 2
    level, middle = float(np.mean(expected.absorber.z_m)), float(np.mean(expected.absorber.x_m))
    pixel_m = float(np.hypot(eye[0], eye[2] - level)) / max(camera.focal_x_px, camera.focal_y_px)
    reach = _SEARCH_M + 2.5 * radius
    x = np.arange(middle - reach, middle + reach + pixel_m, pixel_m)
    rows_each = max(1, round(float(expected.y_m[1] - expected.y_m[0]) / pixel_m)) if expected.y_m.size > 1 else 1
    plane = quadric([0, 0, 0, 0, 0, level], name="plane of the focal line")
    strip = rectified_strip(image, view, plane, x, expected.y_m, rows_each=rows_each)
    found = find_edges(strip)
    first, second = _paired_edges(found, eye, level, radius)
    eyes = np.tile(eye, (first.size, 1))
    at = np.full(first.size, level)
    left, right = (bearing(found.x_m[which], at, eyes) for which in (first, second))
    scale = (eye[2] - level) / ((found.x_m[first] - eye[0]) ** 2 + (eye[2] - level) ** 2)
    sigma = 0.5 * scale * np.hypot(found.sigma_x_m[first], found.sigma_x_m[second])
    return Bearings(np.full(first.size, photo), expected.y_m[found.row[first]], 0.5 * (left + right), sigma)


def _paired_edges(found: Edges, eye_m: FloatArray, level_m: float, radius_m: float) -> tuple[IntArray, IntArray]:
    """Return pairs of edges, one for each row, that are as far apart as the tube is wide, contrast both ways alike."""
    height = eye_m[2] - level_m
    centre = np.arctan2(found.x_m - eye_m[0], height)
    width = 2 * radius_m / np.cos(centre) ** 2 * np.cos(centre)
    best: dict[int, tuple[float, int, int]] = {}
    order = np.lexsort((found.x_m, found.row))
    key = found.row[order] * 1e3 + found.x_m[order]
    for darker in (True, False):
        entering = np.nonzero((found.rise_dn < 0) == darker)[0]
        wanted = found.row[entering] * 1e3 + found.x_m[entering] + width[entering]
        low = np.searchsorted(key, wanted - _WIDTH_SHARE * width[entering])
        high = np.searchsorted(key, wanted + _WIDTH_SHARE * width[entering])
        for i in np.nonzero(high > low)[0]:
            one = int(entering[i])
            for other in order[low[i] : high[i]]:
                contrast = min(abs(found.rise_dn[one]), abs(found.rise_dn[other]))
                opposite = (found.rise_dn[one] < 0) != (found.rise_dn[other] < 0)
                row = int(found.row[one])
                if opposite and contrast > best.get(row, (0.0, 0, 0))[0]:
                    best[row] = (float(contrast), one, int(other))
    pairs = np.array([pair[1:] for pair in best.values()], dtype=np.intp).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def solve_absorber(bearings: Bearings, photos: Photos, start: AbsorberPath, stations_m: FloatArray) -> AbsorberSolution:
    """Adjust the tube's axis to all bearings, with the cameras' poses as uncertain as they are.

    Parameters
    ----------
    bearings : Bearings
        Of all photos.
    photos : Photos
        Poses with their covariance.
    start : AbsorberPath
        Where the tube should be.
    stations_m : ndarray, shape (n,)
        Ascending stations along the trough [m].

    Returns
    -------
    AbsorberSolution
        The axis with its covariance.

    Raises
    ------
    EstimationError
        Fewer than two photos see the tube, or all from one side.
    """
    photo, station, value, sigma = _averaged(bearings, photos, start, stations_m)
    if np.unique(photo).size < 2:
        raise EstimationError(
            f"absorber: {np.unique(photo).size} photos show both edges of the tube, two from different sides are "
            "needed; give [absorber] photos, or a file with its position"
        )
    n = stations_m.size
    jacobian, derivatives = _bearing_derivatives(photo, station, photos, start, stations_m)
    modes = reduce_to_modes(derivatives, photo, photos.covariance)
    design = np.zeros((value.size, 2 * n + len(modes.covariance)))
    rows = np.arange(value.size)
    design[rows, station], design[rows, n + station] = jacobian[:, 0], jacobian[:, 1]
    for i in range(modes.index.shape[1]):
        design[rows, 2 * n + modes.index[:, i]] += modes.derivative[:, i]
    prior = np.zeros((design.shape[1], design.shape[1]))
    prior[2 * n :, 2 * n :] = np.linalg.inv(modes.covariance)
    for first in (0, n):
        prior[first : first + n, first : first + n] = _smoothness(stations_m)
    used = np.ones(value.size, dtype=bool)
    for _ in range(6):
        weighted = design[used] / sigma[used, None] ** 2
        covariance = np.linalg.inv(weighted.T @ design[used] + prior)
        solution = covariance @ (weighted.T @ value[used])
        residual = value - design @ solution
        scatter = max(1.4826 * float(np.median(np.abs(residual[used] / sigma[used]))), 1.0)
        kept = np.abs(residual) < 4 * scatter * sigma
        if (kept == used).all():
            break
        used = kept
    x, z = start.at(stations_m)
    block = scatter**2 * covariance[: 2 * n, : 2 * n]
    path = AbsorberPath(stations_m, x + solution[:n], z + solution[n : 2 * n], 0.5 * (block + block.T))
    seen = np.bincount(station[used], minlength=n)
    rms = float(np.sqrt(np.mean(residual[used] ** 2)))
    return AbsorberSolution(path, seen, used, rms)


def _averaged(
    bearings: Bearings, photos: Photos, start: AbsorberPath, stations_m: FloatArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Average the bearings of each photo around each station: photo, station, deviation from the start, sigma."""
    eyes = photos.eyes_m[bearings.photo]
    x, z = start.at(bearings.y_m)
    deviation = bearings.angle_rad - bearing(x, z, eyes)
    borders = 0.5 * (stations_m[1:] + stations_m[:-1])
    station = np.searchsorted(borders, bearings.y_m)
    key = bearings.photo * stations_m.size + station
    order = np.argsort(key, kind="stable")
    names, first = np.unique(key[order], return_index=True)
    found = []
    for name, members in zip(names, np.split(order, first[1:]), strict=True):
        middle = float(np.median(deviation[members]))
        spread = 1.4826 * float(np.median(np.abs(deviation[members] - middle)))
        # Edges of one photo share their error of pixel grid and background along a few rows: three count as one.
        effective = max(1.0, members.size / 3)
        own = max(spread, float(np.median(bearings.sigma_rad[members]))) / np.sqrt(effective)
        found.append((name // stations_m.size, name % stations_m.size, middle, float(np.hypot(own, _FLOOR_RAD))))
    columns = list(zip(*found, strict=True)) if found else [(), (), (), ()]
    return (
        np.array(columns[0], dtype=np.intp), np.array(columns[1], dtype=np.intp), np.array(columns[2], dtype=float),
        np.array(columns[3], dtype=float),
    )  # fmt: skip


def _bearing_derivatives(
    photo: IntArray, station: IntArray, photos: Photos, start: AbsorberPath, stations_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Differentiate bearings with respect to (X_a, Z_a), shape (m, 2), and to the step of the pose, shape (m, 6)."""
    eyes = photos.eyes_m[photo]
    x, z = start.at(stations_m[station])
    to_x, to_z = x - eyes[:, 0], eyes[:, 2] - z
    square = to_x**2 + to_z**2
    place = np.stack([to_z / square, to_x / square], axis=1)
    rotations = np.array([pose.rotation for pose in photos.poses])[photo]
    points = np.stack([x, stations_m[station], z], axis=1)
    turned = np.einsum("mij,mj->mi", rotations, points)
    # The pixel is held: a movement of the pose moves the line of sight at the tube by -R^T (dt + w x R P).
    moved = np.empty((photo.size, 3, 6))
    moved[:, :, 3:] = -np.swapaxes(rotations, 1, 2)
    moved[:, :, :3] = np.swapaxes(rotations, 1, 2) @ skew(turned)
    # The bearing that is computed with the pose as it is minus the true one.
    return place, np.asarray(-(place[:, 0, None] * moved[:, 0] + place[:, 1, None] * moved[:, 2]))


def _smoothness(stations_m: FloatArray) -> FloatArray:
    """Return the prior's precision of a coordinate along the stations."""
    n = stations_m.size
    precision = np.eye(n) / _PRIOR_M**2 / n
    if n >= 3:
        step = float(np.mean(np.diff(stations_m)))
        bend = np.diff(np.eye(n), 2, axis=0) / (_BEND_M * step**1.5)
        precision += bend.T @ bend
    return precision
