"""Natural targets: features of photos without any targets, found and matched through pycolmap."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
import numpy.typing as npt

from heliogauge.camera.formats import to_colmap
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, Float32Array, IntArray
from photogrammetry.detection.feature_tracks import Keypoints

#: Matches between two photos that make them a pair.
LEAST_MATCHES = 15
#: The scale space begins with the photo doubled in size; with 24 megapixels that would take 5 GB a photo.
_LARGEST_DOUBLED_PX = 6_000_000
_DESCRIPTOR = 128
#: COLMAP's own limits: angle between descriptors, and that angle over the one to the next best.
_FARTHEST_RAD, _RATIO = 0.7, 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features of one photo with their descriptors.

    descriptors (n, 128): Descriptors of unit length.
    """

    keypoints: Keypoints
    descriptors: Float32Array


def require_pycolmap() -> None:
    """Say what to install where pycolmap is missing.

    InputError: It is not installed.
    """
    if find_spec("pycolmap") is None:
        raise InputError(
            "natural: features of photos without targets are found through pycolmap, which is not installed: "
            "pip install heliogauge[natural]"
        )


def _pycolmap() -> Any:
    require_pycolmap()
    import pycolmap

    # It writes a line for each extractor to the terminal; warnings stay.
    pycolmap.logging.minloglevel = pycolmap.logging.Level.WARNING.value
    return pycolmap


def find_features(image: npt.NDArray[Any], photo: str, max_features: int) -> Features:
    """Find the features of one photo.

    Shapes: image (h, w).
    max_features: Most features, the largest first.
    Returns: SIFT features with one orientation each: with two, one point would count as two independent ones.
    InputError: pycolmap is not installed.

    COLMAP's origin is the outer corner of the first pixel: half a pixel is taken off.
    """
    pycolmap = _pycolmap()
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu, options.num_threads = False, 1
    if image.size > _LARGEST_DOUBLED_PX:
        options.sift.first_octave = 0
    options.sift.max_num_features, options.sift.max_num_orientations = max_features, 1
    keypoints, descriptors = pycolmap.FeatureExtractor.create(options).extract_from_uint8_array(_eight_bits(image))
    table = np.array([(one.x, one.y, one.compute_scale()) for one in keypoints], dtype=np.float64).reshape(-1, 3)
    size = (int(image.shape[1]), int(image.shape[0]))
    vectors = np.asarray(descriptors.data, dtype=np.float32).reshape(-1, _DESCRIPTOR)
    vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1.0)
    return Features(Keypoints(photo, size, table[:, :2] - 0.5, table[:, 2]), vectors)


def _eight_bits(image: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return the photo in the range that features are defined for."""
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image, dtype=np.uint8)
    largest = 65535.0 if image.dtype == np.uint16 else max(float(image.max()), 1.0)
    return np.asarray(np.clip(np.rint(image * (255.0 / largest)), 0, 255), dtype=np.uint8)


def match_features(first: Features, second: Features, cameras: tuple[Camera, Camera], *, known: bool) -> IntArray:
    """Match the features of two photos, as far as one relative pose of the cameras explains them.

    cameras: Their cameras, known or guessed.
    known: Whether the lens is known; else any fundamental matrix does.
    Returns (k, 2): Places of keypoints that show the same; none where fewer than `LEAST_MATCHES` agree.
    InputError: pycolmap is not installed.
    """
    pycolmap = _pycolmap()
    found = _mutual_matches(first.descriptors, second.descriptors)
    if len(found) < LEAST_MATCHES:
        return np.zeros((0, 2), dtype=np.intp)
    check = pycolmap.TwoViewGeometryOptions()
    check.min_num_inliers = LEAST_MATCHES
    # The same photos give the same result.
    check.ransac.random_seed = 0
    lenses = [_camera(pycolmap, camera, known) for camera in cameras]
    places = [one.keypoints.pixels_px + 0.5 for one in (first, second)]
    pair = pycolmap.estimate_two_view_geometry(lenses[0], places[0], lenses[1], places[1], found, check)
    return np.asarray(pair.inlier_matches, dtype=np.intp).reshape(-1, 2)


def _mutual_matches(first: Float32Array, second: Float32Array) -> IntArray:
    """Return pairs that are each other's nearest, by far, as COLMAP's own matcher has it, shape (k, 2).

    One matrix product instead: 3200 x 2900 features take 0.09 s here and 0.77 s there, with the same pairs.
    """
    if min(len(first), len(second)) < 2:
        return np.zeros((0, 2), dtype=np.intp)
    cosine = first @ second.T
    best, back = cosine.argmax(axis=1), cosine.argmax(axis=0)
    own = np.arange(len(first))
    fine = (back[best] == own) & _is_distinct(cosine) & _is_distinct(cosine.T)[best]
    return np.column_stack([own[fine], best[fine]])


def _is_distinct(cosine: Float32Array) -> BoolArray:
    """Mark rows whose best partner is near and clearly nearer than the next."""
    two = np.partition(cosine, cosine.shape[1] - 2, axis=1)[:, -2:]
    following, nearest = np.arccos(np.clip(two, -1, 1)).T
    return np.asarray((nearest <= _FARTHEST_RAD) & (nearest <= _RATIO * following))


def _camera(pycolmap: Any, camera: Camera, known: bool) -> Any:
    """Return pycolmap's camera; a lens it cannot hold is left out, for matches that are checked to 4 px."""
    try:
        model, parameters = to_colmap(camera)
    except InputError:
        focal, center = (camera.focal_x_px, camera.focal_y_px), (camera.center_x_px, camera.center_y_px)
        model, parameters = "PINHOLE", np.array([*focal, center[0] + 0.5, center[1] + 0.5])
    own = pycolmap.Camera(model=model, width=camera.width_px, height=camera.height_px, params=parameters.tolist())
    own.has_prior_focal_length = known
    return own


def all_pairs(count: int) -> Sequence[tuple[int, int]]:
    """List all pairs of photos."""
    return [(a, b) for a in range(count) for b in range(a + 1, count)]
