"""Photos to points of the board: read, find, measure, several photos at a time."""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from calibration.camera.boards import Board, CharucoBoard, Chessboard, CircleGrid, TargetField, UnknownField
from calibration.camera.corners.detection import BoardPoints, FoundBoards, find_charuco, find_chessboard, find_circles
from calibration.camera.keys import CalibratedCameraSection
from calibration.camera.start_values.intrinsics import homography
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError, FailurePicture, InputError
from heliogauge.images.photos import read_image
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.running.progress import Progress
from photogrammetry.centers import Ellipse, TargetCenter, measure_centers
from photogrammetry.detection import TargetSearch, measure_targets
from photogrammetry.targets import RingDictionary


@dataclass(frozen=True, slots=True, eq=False)
class _Searched:
    """One photo.

    points: The board's points, or why there are none.
    codes: Of targets whose numbers are not known yet.
    size_px: Width and height [px].
    thumbnail: The photo as a small JPEG.
    """

    points: BoardPoints | EstimationError
    codes: tuple[str, ...]
    size_px: tuple[int, int]
    thumbnail: bytes


def search_photos(
    files: Sequence[Path],
    board: Board | UnknownField,
    asked: CalibratedCameraSection,
    *,
    known: RingDictionary | None,
    jobs: int | None,
    progress: Progress,
) -> FoundBoards:
    """Find the board in all photos.

    asked: The size that photos should have.
    known: Codes of the board's targets; None for boards without.
    jobs: Photos searched side by side.
    Returns: Points with covariances, and the reasons where there are none.
    InputError: A photo cannot be read, or its size is not that of the others or the one asked for.
    """
    found: list[BoardPoints] = []
    failures: dict[str, str] = {}
    thumbnails: dict[str, bytes] = {}
    names: dict[str, int] = {}
    size: tuple[int, int] | None = None

    def one(file: Path) -> _Searched:
        image = read_image(file)
        own, small = (int(image.shape[1]), int(image.shape[0])), make_thumbnail(image)
        try:
            points, codes = _measured(file.name, image, board, known)
            return _Searched(replace(points, saturated_share=_saturated_share(image, points)), codes, own, small)
        except EstimationError as error:
            return _Searched(error, (), own, small)

    with progress.stage("find the board", len(files)) as stage, ThreadPoolExecutor(jobs) as pool:
        waiting = [pool.submit(one, file) for file in files]
        try:
            for file, future in zip(files, waiting, strict=True):
                seen = future.result()
                size = size or seen.size_px
                thumbnails[file.name] = seen.thumbnail
                _check_size(file, seen.size_px, files[0], size, asked)
                if isinstance(seen.points, EstimationError):
                    failures[file.name] = str(seen.points)
                elif seen.codes:
                    index = np.array([names.setdefault(code, len(names)) for code in seen.codes], dtype=np.intp)
                    found.append(replace(seen.points, index=index))
                else:
                    found.append(seen.points)
                stage.advance()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return FoundBoards(tuple(found), failures, size or (0, 0), tuple(names), thumbnails)


def _check_size(
    file: Path, own: tuple[int, int], first: Path, size: tuple[int, int], asked: CalibratedCameraSection
) -> None:
    if own != size:
        raise InputError(
            f"{file.name} has {own[0]} x {own[1]} px, but {first.name} {size[0]} x {size[1]}; photos of one "
            "camera at one resolution, all upright or all on their side in the file, are needed"
        )
    wanted = (asked.width_px, asked.height_px)
    if any(want is not None and want != got for want, got in zip(wanted, own, strict=True)):
        raise InputError(
            f"{file.name} has {own[0]} x {own[1]} px, but measurement.toml has camera.width_px = {wanted[0]}, "
            f"camera.height_px = {wanted[1]}"
        )


def _saturated_share(image: npt.NDArray[Any], points: BoardPoints) -> float:
    """Share of the pixels around the board at the image's largest value."""
    low, high = points.pixels_px.min(axis=0).astype(int), points.pixels_px.max(axis=0).astype(int) + 1
    part = image[max(low[1], 0) : high[1], max(low[0], 0) : high[0]]
    return float(np.mean(part == image.max())) if part.size else 0.0


def _measured(
    photo: str, image: npt.NDArray[Any], board: Board | UnknownField, known: RingDictionary | None
) -> tuple[BoardPoints, tuple[str, ...]]:
    """Measure the board; codes of targets are returned where their numbers are not known yet."""
    if isinstance(board, Chessboard):
        return find_chessboard(photo, image, board), ()
    if isinstance(board, CharucoBoard):
        return find_charuco(photo, image, board), ()
    if isinstance(board, CircleGrid):
        return _with_centers(image, find_circles(photo, image, board), board), ()
    if known is not None and isinstance(board, TargetField | UnknownField):
        return _target_points(photo, image, board, known)
    raise InputError(f"{photo}: boards of the kind {type(board).__name__} are not known")


def _with_centers(image: npt.NDArray[Any], rough: BoardPoints, board: CircleGrid) -> BoardPoints:
    """Measure the centres of dots that were found roughly."""
    shape = homography(rough, board.points_m)
    radius = 0.5 * board.diameter_share * board.pitch_m
    starts = []
    for place, rough_px in zip(rough.index.tolist(), rough.pixels_px, strict=True):
        plane = board.points_m[place, :2]
        ends = np.column_stack([np.vstack([plane, plane + radius * np.eye(2)]), np.ones(3)]) @ shape.T
        ends = ends[:, :2] / ends[:, 2:]
        frame = (ends[1:] - ends[0]).T
        starts.append(Ellipse(rough_px, frame @ frame.T))
    centers = measure_centers(image, starts)
    found = [(place, one) for place, one in zip(rough.index, centers, strict=True) if isinstance(one, TargetCenter)]
    if len(found) < 0.5 * rough.n:
        raise EstimationError(f"{rough.photo}: only {len(found)} of {rough.n} dots can be measured as blurred discs")
    covariances = np.array([one.covariance_px2 for _, one in found])
    return BoardPoints(
        rough.photo,
        np.array([place for place, _ in found], dtype=np.intp),
        np.array([one.center_px for _, one in found]),
        0.5 * (covariances + covariances.swapaxes(1, 2)),
    )


def _target_points(
    photo: str, image: npt.NDArray[Any], board: TargetField | UnknownField, known: RingDictionary
) -> tuple[BoardPoints, tuple[str, ...]]:
    measured = measure_targets(image, photo, TargetSearch(dictionary=known, with_uncoded=False))
    found = measured.detections
    twice = set(found.duplicated)
    place = {name: i for i, name in enumerate(board.names)} if isinstance(board, TargetField) else None
    chosen = [
        k
        for k, name in enumerate(found.names)
        if (place is None or name in place) and name not in twice and found.usable[k]
    ]
    if not chosen:
        if measured.mirrored:
            raise EstimationError(
                f"{photo}: {len(measured.mirrored)} targets were found as mirror images: print or photo is the wrong "
                "way round"
            )
        raise EstimationError(f"{photo}: no target of {board.dictionary} was found (is it the right dictionary?)")
    index = np.arange(len(chosen)) if place is None else np.array([place[found.names[k]] for k in chosen])
    covariance = found.covariance_px2[chosen]
    points = BoardPoints(
        photo,
        index.astype(np.intp),
        found.pixels_px[chosen],
        0.5 * (covariance + np.swapaxes(covariance, 1, 2)),
        ellipses_px2=np.array([measured.centers[k].ellipse.shape_px2 for k in chosen]),
    )
    return points, tuple(found.names[k] for k in chosen) if place is None else ()


def left_out_doubts(reasons: Iterable[str], severity: Severity = Severity.NOTE) -> Iterator[Doubt]:
    """Yield which photos were left out, and why.

    severity: A note where a photo shows no board or is a copy; more where it was measured and is not believed.
    """
    for reason in reasons:
        yield Doubt("photo_left_out", f"photo left out: {reason}", severity=severity)


def put_aside(found: FoundBoards, patterns: str | None) -> tuple[FoundBoards, tuple[BoardPoints, ...]]:
    """Put photos to check with aside: those whose names fit one of the patterns, which commas separate."""
    if patterns is None:
        return found, ()
    texts = [text.strip() for text in patterns.split(",")]
    for text in texts:
        if not any(fnmatch(one.photo, text) for one in found.points):
            raise InputError(f"hold_out={text}: no photo of that name shows the board; names as in [images] photos")
    aside = [any(fnmatch(one.photo, text) for text in texts) for one in found.points]
    used = tuple(one for one, away in zip(found.points, aside, strict=True) if not away)
    return replace(found, points=used), tuple(one for one, away in zip(found.points, aside, strict=True) if away)


def pictures_of_boards(found: FoundBoards) -> Iterator[FailurePicture]:
    """Yield the photos with the corners that were found in them; those in which the board was not found first."""
    for photo, reason in found.failures.items():
        if photo in found.thumbnails:
            yield FailurePicture(photo, found.thumbnails[photo], reason, found.size_px)
    for one in found.points:
        if one.photo in found.thumbnails:
            thumbnail = found.thumbnails[one.photo]
            yield FailurePicture(one.photo, thumbnail, f"{one.n} points of the board", found.size_px, one.pixels_px)
