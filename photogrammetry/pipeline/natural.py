"""Photos to image points of natural features, alone or beside coded targets."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.images.photos import read_image
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.running.progress import Progress
from heliogauge.validate import FloatArray
from photogrammetry.detection.feature_tracks import PairMatch, TrackChoice, Tracks, follow_tracks
from photogrammetry.detection.natural import Features, all_pairs, find_features, match_features, require_pycolmap
from photogrammetry.image_points import ImagePoints
from photogrammetry.keys.load import PhotogrammetryMeasurement
from photogrammetry.keys.natural import NaturalSection
from photogrammetry.pipeline.cameras import build_cameras
from photogrammetry.pipeline.photos import MeasuredPhotos
from photogrammetry.start_values.network import LeftOut

#: Kinds of features by size; each must have enough redundancy for a sigma of its own.
_SIZE_CLASSES = 4
_DOUBT = Doubt(
    "natural_features_not_independent",
    "natural features are no independent measurements: neighbouring photos see the same texture alike. On rendered "
    "scenes true errors were 1.2 to 1.3 times the sigmas; control them by scale bars kept apart (check_only = true)",
)


def add_features(
    measurement: PhotogrammetryMeasurement, coded: MeasuredPhotos | None, *, jobs: int | None, progress: Progress
) -> MeasuredPhotos:
    """Find the natural features of all photos and follow them from photo to photo.

    coded: Coded targets of the same photos, where there are any.
    jobs: Photos and pairs side by side.
    Returns: Image points of targets and features, of kinds: coded targets, and features by size.
    InputError: pycolmap is not installed, or a photo cannot be read.
    EstimationError: No feature can be followed.
    """
    require_pycolmap()
    section = measurement.model.natural or NaturalSection()
    files = measurement.photo_files
    twice = [name for name, count in Counter(file.name for file in files).items() if count > 1]
    if twice:
        raise InputError(f"images.photos: {twice[0]} occurs in two folders; give photos other names")

    thumbnails: dict[str, bytes] = {}

    def one(file: Path) -> Features:
        image = read_image(file)
        thumbnails[file.name] = make_thumbnail(image)
        return find_features(image, file.name, section.max_features)

    with progress.stage("find features", len(files)) as stage, ThreadPoolExecutor(jobs) as pool:
        found = []
        for features in pool.map(one, files):
            found.append(features)
            stage.advance()
    matches = _match_photos(measurement, found, jobs, progress)
    tracks = follow_tracks(
        [one.keypoints for one in found], matches, TrackChoice(section.min_photos, section.max_points)
    )
    sizes = {one.keypoints.photo: one.keypoints.size_px for one in found}
    return replace(_join_coded(tracks, coded, sizes), thumbnails=thumbnails)


def _match_photos(
    measurement: PhotogrammetryMeasurement, found: list[Features], jobs: int | None, progress: Progress
) -> list[PairMatch]:
    sizes = {one.keypoints.photo: one.keypoints.size_px for one in found}
    cameras = build_cameras(measurement, tuple(sizes), sizes)
    owners = cameras.index(tuple(sizes)).tolist()
    known = not any(model.free for model in cameras.models)
    pairs = all_pairs(len(found))

    def match(pair: tuple[int, int]) -> PairMatch:
        a, b = pair
        both = (cameras.cameras[owners[a]], cameras.cameras[owners[b]])
        return PairMatch(a, b, match_features(found[a], found[b], both, known=known))

    matches = []
    with progress.stage("match features", len(pairs)) as stage, ThreadPoolExecutor(jobs) as pool:
        for one in pool.map(match, pairs):
            matches.append(one)
            stage.advance()
    return matches


def _join_coded(tracks: Tracks, coded: MeasuredPhotos | None, sizes: dict[str, tuple[int, int]]) -> MeasuredPhotos:
    """Put features beside coded targets; kind 0 are the targets where there are any."""
    left = LeftOut(
        "natural features",
        f"{tracks.short} seen in too few photos, {tracks.ambiguous} that show two places of one photo",
    )
    borders = np.quantile(tracks.scale_px, np.arange(1, _SIZE_CLASSES) / _SIZE_CLASSES)
    kinds = np.searchsorted(borders, tracks.scale_px)
    shapes = np.full((tracks.points.n, 2, 2), np.nan)
    if coded is None:
        return MeasuredPhotos(tracks.points, shapes, sizes, (left,), (_DOUBT,), True, kinds=kinds)
    points = _concatenate(coded.points, tracks.points)
    ellipses: FloatArray = np.concatenate([coded.ellipses_px2, shapes])
    kinds = np.concatenate([np.zeros(coded.points.n, dtype=np.intp), kinds + 1])
    refused, doubts = (*coded.refused, left), (*coded.doubts, _DOUBT)
    return MeasuredPhotos(points, ellipses, sizes, refused, doubts, True, coded.loose, kinds)


def _concatenate(first: ImagePoints, second: ImagePoints) -> ImagePoints:
    tables = (first, second)
    return ImagePoints.from_names(
        [table.photos[i] for table in tables for i in table.photo_index],
        [table.targets[i] for table in tables for i in table.target_index],
        np.concatenate([table.pixels_px for table in tables]),
        np.concatenate([table.covariance_px2 for table in tables]),
    )
