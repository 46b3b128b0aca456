"""Photos of beams to places on the targets: read, find the target, rectify, measure; thousands of them in a stream."""

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from calibration.heliostat.background import TargetSurface, empty_target
from calibration.heliostat.beam_centroids import CENTROID_METHODS
from calibration.heliostat.beam_flags import REJECTED_BEAM, BeamFlag, beam_reason
from calibration.heliostat.beam_image import Beam, BeamSettings, measure_beam, no_beam
from calibration.heliostat.target_marks import (
    CORNERS,
    MarkTemplate,
    TargetCorners,
    dark_corners,
    mark_corner,
    template_corners,
)
from calibration.heliostat.target_view import Rectifier, TargetImage, view_from_points, whole_image
from heliogauge.camera import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.images import Image, read_channel
from heliogauge.progress import Progress, SilentProgress
from heliogauge.store import write_table_csv
from heliogauge.validate import BoolArray, FlagArray, FloatArray, float_array, freeze
from photogrammetry.markers import find_markers

__all__ = [
    "ArucoMarkers",
    "BeamMeasurements",
    "CornerPixels",
    "DarkMarks",
    "MarkerTemplates",
    "TargetFrame",
    "WholeImage",
    "measure_beams",
    "target_image",
    "write_beams",
]

#: Photos that are read ahead for each thread: enough to keep it busy, few enough to keep memory flat.
_AHEAD = 2


@dataclass(frozen=True, slots=True)
class WholeImage:
    """The photo shows exactly the target.

    Parameters
    ----------
    places : {"edge", "index"}
        "edge": the photo's outer edges are the target's. "index": a pixel's index over the number of pixels is its
        place, as in crops of the PAINT data base.
    """

    places: Literal["edge", "index"] = "edge"


@dataclass(frozen=True, slots=True, eq=False)
class CornerPixels:
    """The target's corners are given.

    Parameters
    ----------
    pixels_px : array_like, shape (4, 2)
        Upper left, upper right, lower right, lower left as seen from the field [px].
    sigma_px : float, optional
        Their uncertainty [px].
    """

    pixels_px: FloatArray
    sigma_px: float = 0.0


@dataclass(frozen=True, slots=True)
class MarkerTemplates:
    """The target's corners carry dark marks of which there are pictures.

    Parameters
    ----------
    files : tuple of Path
        Four pictures in the order of the corners.
    anchors_px : tuple of (float, float), optional
        The target's corner in each; the outer corner of the mark if absent [px].
    """

    files: tuple[Path, ...]
    anchors_px: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class ArucoMarkers:
    """The middles of four square markers are the target's corners.

    Parameters
    ----------
    ids : tuple of int
        Numbers of the markers in the order of the corners.
    dictionary : str
        OpenCV's name.
    """

    ids: tuple[int, ...]
    dictionary: str = "DICT_4X4_50"


@dataclass(frozen=True, slots=True)
class DarkMarks:
    """The target's corners carry dark marks: angles (outer corner) or filled rectangles (inner corner).

    Parameters
    ----------
    corner : {"outer", "inner"}
        Which corner of a mark is the target's.
    """

    corner: Literal["outer", "inner"] = "outer"


Source: TypeAlias = WholeImage | CornerPixels | MarkerTemplates | ArucoMarkers | DarkMarks


@dataclass(frozen=True, slots=True, eq=False)
class TargetFrame:
    """Where a target is in the photos of one camera.

    Parameters
    ----------
    corners_m : array_like, shape (4, 2)
        Its corners on its plane: upper left, upper right, lower right, lower left as seen from the field [m].
    source : WholeImage, CornerPixels, MarkerTemplates, ArucoMarkers or DarkMarks
        How they are found in a photo.
    camera : Camera, optional
        The lens.
    empty_files : tuple of Path, optional
        Photos of the target without a beam.
    channel : str, optional
        Colour that is measured: a sum of colours saturates sooner, and its centroid depends on their weights.
    """

    corners_m: FloatArray
    source: Source = WholeImage()
    camera: Camera | None = None
    empty_files: tuple[Path, ...] = ()
    channel: str = "green"

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners_m", float_array("corners_m", self.corners_m, (4, 2)))


@dataclass(frozen=True, slots=True, eq=False)
class BeamMeasurements:
    """Beams of many photos, one row per photo in the order of the files.

    Parameters
    ----------
    files : tuple of Path
        The photos.
    targets : tuple of str
        Target of each.
    x_m, y_m : ndarray, shape (n,)
        Place on the target's plane, x right and y up as seen from the field; NaN where there is none [m].
    covariance_m2 : ndarray, shape (n, 2, 2)
        Its covariance [m^2].
    moments_m2 : ndarray, shape (n, 2, 2)
        Central second moments of the light: the beam's own size [m^2].
    d50_m, d90_m : ndarray, shape (n,)
        Diameters of the circles with 50 and 90 % of the light [m].
    peak_dn, background_dn : ndarray, shape (n,)
        Largest brightness above the target's own, and the target's own [DN].
    methods_m, methods_sigma_m : dict of str to ndarray, shape (n, 2)
        Place and sigma by each method; NaN where it gave none [m].
    flags : ndarray of uint32, shape (n,)
        Bits of `BeamFlag`.
    notes : tuple of str
        What was said of a photo beyond its flags (why the target was not found, what cannot be read).
    """

    files: tuple[Path, ...]
    targets: tuple[str, ...]
    x_m: FloatArray
    y_m: FloatArray
    covariance_m2: FloatArray
    moments_m2: FloatArray
    d50_m: FloatArray
    d90_m: FloatArray
    peak_dn: FloatArray
    background_dn: FloatArray
    methods_m: dict[str, FloatArray]
    methods_sigma_m: dict[str, FloatArray]
    flags: FlagArray
    notes: tuple[str, ...]

    @property
    def sigma_m(self) -> FloatArray:
        """Standard deviations of x and y, shape (n, 2) [m]."""
        return np.sqrt(self.covariance_m2[:, [0, 1], [0, 1]])

    @property
    def rejected(self) -> BoolArray:
        """Which beams a fit must not use, shape (n,)."""
        return np.asarray((self.flags & np.uint32(REJECTED_BEAM)) != 0)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Flags and notes of each photo in words; empty for a good one."""
        flags = [beam_reason(int(flag)) for flag in self.flags]
        return tuple("; ".join(filter(None, pair)) for pair in zip(flags, self.notes, strict=True))


def measure_beams(
    files: Sequence[Path],
    targets: Sequence[str],
    frames: Mapping[str, TargetFrame],
    *,
    settings: BeamSettings | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> BeamMeasurements:
    """Measure the beams of many photos.

    Parameters
    ----------
    files : sequence of Path
        The photos.
    targets : sequence of str
        Target of each photo.
    frames : mapping of str to TargetFrame
        Where each target is.
    settings : BeamSettings, optional
        Method of the centroid, and limits.
    jobs : int, optional
        Threads; as many as there are processors (at most 8) if absent.
    progress : Progress, optional
        Told of each photo.

    Returns
    -------
    BeamMeasurements
        One row per photo. A photo that cannot be read, shows no target or no beam has a flag and no place.

    Raises
    ------
    InputError
        No photo, lengths that differ, a target without a frame, or photos without a beam or templates that cannot be
        used.
    """
    if not files or len(files) != len(targets):
        raise InputError(f"photos: {len(files)} files and {len(targets)} targets are given; one target for each photo")
    unknown = sorted(set(targets) - set(frames))
    if unknown:
        raise InputError(f"photos: target {unknown[0]!r} has no corners; known are {', '.join(sorted(frames))}")
    chosen = settings or BeamSettings()
    finders = {name: _Finder(frames[name]) for name in sorted(set(targets))}
    for name, finder in finders.items():
        finder.look(files[list(targets).index(name)])
    threads = jobs or min(os.cpu_count() or 1, 8)
    rows: list[tuple[Beam, str]] = []
    with (progress or SilentProgress()).stage("beams", len(files)) as stage, ThreadPoolExecutor(threads) as pool:
        work = ((finders[target], file, chosen) for file, target in zip(files, targets, strict=True))
        for future in _streamed(pool, work, threads):
            rows.append(future.result())
            stage.advance()
    return _gathered(tuple(files), tuple(targets), rows)


def target_image(file: Path, frame: TargetFrame) -> TargetImage:
    """Read one photo as `measure_beams` sees it, for a figure.

    Parameters
    ----------
    file : Path
        The photo.
    frame : TargetFrame
        Where the target is.

    Returns
    -------
    TargetImage
        The photo on the target's plane.

    Raises
    ------
    InputError
        The photo cannot be read.
    EstimationError
        The target is not found in it.
    """
    return _Finder(frame).image(file)


def write_beams(path: Path, beams: BeamMeasurements) -> None:
    """Write beams to a table.

    Parameters
    ----------
    path : Path
        File to write (.csv).
    beams : BeamMeasurements
        What to write: one line per photo, also the rejected ones, with the reason.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    sigma = beams.sigma_m
    shapes = np.where(np.isfinite(beams.moments_m2), beams.moments_m2, 0.0)
    minor, major = np.sqrt(np.maximum(np.linalg.eigvalsh(shapes), 0.0)).T
    direction = 0.5 * np.arctan2(2 * shapes[:, 0, 1], shapes[:, 0, 0] - shapes[:, 1, 1])
    seen = np.isfinite(beams.x_m)
    columns: dict[str, Sequence[object] | FloatArray] = {
        "image": [file.name for file in beams.files],
        "target": list(beams.targets),
        "x_m": beams.x_m,
        "y_m": beams.y_m,
        "sigma_x_m": sigma[:, 0],
        "sigma_y_m": sigma[:, 1],
        "width_major_m": np.where(seen, major, np.nan),
        "width_minor_m": np.where(seen, minor, np.nan),
        "direction_deg": np.where(seen, np.degrees(direction), np.nan),
        "d50_m": beams.d50_m,
        "d90_m": beams.d90_m,
        "peak_dn": beams.peak_dn,
        "background_dn": beams.background_dn,
    }
    for name in CENTROID_METHODS:
        columns[f"{name}_x_m"], columns[f"{name}_y_m"] = beams.methods_m[name].T
    columns["rejected"] = [int(each) for each in beams.rejected]
    columns["reason"] = list(beams.reasons)
    write_table_csv(path, columns)


# --- one photo ------------------------------------------------------------------------------------------------------


class _Finder:
    """Rectifies the photos of one target; what does not change from photo to photo is made once."""

    def __init__(self, frame: TargetFrame) -> None:
        self._frame = frame
        left, low = frame.corners_m.min(axis=0)
        right, high = frame.corners_m.max(axis=0)
        self._extent = np.array([left, right, low, high])
        self._templates = _templates(frame.source) if isinstance(frame.source, MarkerTemplates) else ()
        self._shape: tuple[int, int] | None = None
        self._fixed: Rectifier | None = None
        if isinstance(frame.source, CornerPixels):
            self._fixed = self._rectifier(
                TargetCorners(
                    float_array("pixels_px", frame.source.pixels_px, (4, 2)), frame.source.sigma_px, np.ones(4)
                )
            )
        self._near: TargetCorners | None = None
        self._empty = self._empty_target()

    def look(self, file: Path) -> None:
        """Find the marks once, so that all photos start their search from the same place, whatever their order."""
        if isinstance(self._frame.source, MarkerTemplates):
            try:
                self._near = template_corners(read_channel(file, self._frame.channel), self._templates)
            except (EstimationError, InputError):
                return  # Each photo then searches for itself, and says what is wrong with it.

    def measure(self, file: Path, settings: BeamSettings) -> tuple[Beam, str]:
        """Measure one photo; what cannot be measured is said, not raised."""
        try:
            photo = read_channel(file, self._frame.channel)
        except InputError as error:
            return no_beam(BeamFlag.UNREADABLE), str(error)
        try:
            image = self._on_target(photo)
        except (EstimationError, InputError) as error:
            return no_beam(BeamFlag.TARGET_NOT_FOUND), str(error)
        if self._empty is not None and self._empty.values_dn.shape != image.values_dn.shape:
            sizes = f"{image.values_dn.shape[::-1]} px, frames without a beam {self._empty.values_dn.shape[::-1]} px"
            return no_beam(BeamFlag.TARGET_NOT_FOUND), f"the target measures {sizes}"
        return measure_beam(image, empty=self._empty, settings=settings), ""

    def image(self, file: Path) -> TargetImage:
        return self._on_target(read_channel(file, self._frame.channel))

    def _on_target(self, photo: Image) -> TargetImage:
        source = self._frame.source
        if isinstance(source, WholeImage):
            return whole_image(photo, self._frame.corners_m, by_index=source.places == "index")
        if self._fixed is not None:
            return self._fixed.rectify(photo, full_scale_dn=_full_scale(photo))
        return self._rectifier(self._corners(photo)).rectify(photo, full_scale_dn=_full_scale(photo))

    def _rectifier(self, corners: TargetCorners) -> Rectifier:
        frame = self._frame
        view = view_from_points(corners.pixels_px, frame.corners_m, camera=frame.camera, sigma_px=corners.sigma_px)
        made = Rectifier(view, self._extent, self._shape)
        if self._empty_files and self._shape is None:
            # Frames without a beam and photos must come out in the same pixels, wherever the marks are found.
            self._shape = made.size
        return made

    @property
    def _empty_files(self) -> tuple[Path, ...]:
        return self._frame.empty_files

    def _corners(self, photo: Image) -> TargetCorners:
        source = self._frame.source
        if isinstance(source, MarkerTemplates):
            return template_corners(photo, self._templates, near=self._near)
        if isinstance(source, ArucoMarkers):
            return _marker_centers(photo, source)
        outer = isinstance(source, DarkMarks) and source.corner == "outer"
        return dark_corners(photo, outer=outer)

    def _empty_target(self) -> TargetSurface | None:
        if not self._empty_files:
            return None
        return empty_target([self.image(file).values_dn for file in self._empty_files])


def _full_scale(photo: Image) -> float:
    # Luminance of a photo in 16 bit comes as float32 (heliogauge.images).
    return 65535.0 if photo.dtype == np.uint16 or float(photo.max()) > 255.5 else 255.0


def _templates(source: MarkerTemplates) -> tuple[MarkTemplate, ...]:
    if len(source.files) != 4 or len(source.anchors_px) not in (0, 4):
        raise InputError(f"markers: four pictures are needed ({', '.join(CORNERS)}), not {len(source.files)}")
    templates = []
    for k, (file, corner) in enumerate(zip(source.files, CORNERS, strict=True)):
        values = np.asarray(read_channel(file, "luminance"), dtype=np.float64)
        try:
            anchor = source.anchors_px[k] if source.anchors_px else mark_corner(values, corner)[0]
        except EstimationError as error:
            raise InputError(f"{file}: {error}; give anchors_px") from error
        templates.append(MarkTemplate(freeze(values), np.asarray(anchor, dtype=np.float64)))
    return tuple(templates)


def _marker_centers(photo: Image, source: ArucoMarkers) -> TargetCorners:
    found = find_markers(photo, "target", source.dictionary)
    missing = [number for number in source.ids if number not in found.numbers]
    twice = [number for number in source.ids if number in found.duplicated]
    if missing or twice:
        said = f"marker {missing[0]} is not found" if missing else f"marker {twice[0]} is found twice"
        raise EstimationError(f"{said} in the photo; the target carries {', '.join(map(str, source.ids))}")
    squares = dict(zip(found.numbers, found.squares, strict=True))
    centers, sigmas = [], []
    for number in source.ids:
        a, b, c, d = squares[number].corners_px
        # The middle of a square is where its diagonals cross, also in perspective.
        along = np.linalg.solve(np.stack([c - a, b - d], axis=1), b - a)
        centers.append(a + along[0] * (c - a))
        sigmas.append(squares[number].covariance_px2)
    sigma = float(np.sqrt(np.mean([np.trace(each, axis1=-2, axis2=-1) / 2 for each in sigmas])))
    return TargetCorners(freeze(np.array(centers)), sigma, np.ones(4))


# --- many photos ----------------------------------------------------------------------------------------------------


def _streamed(
    pool: ThreadPoolExecutor, work: Iterator[tuple[_Finder, Path, BeamSettings]], threads: int
) -> Iterator["Future[tuple[Beam, str]]"]:
    """Hand out work in order, a few photos ahead of what is taken."""
    waiting = [pool.submit(finder.measure, file, settings) for finder, file, settings in islice(work, _AHEAD * threads)]
    while waiting:
        yield waiting.pop(0)
        for finder, file, settings in islice(work, 1):
            waiting.append(pool.submit(finder.measure, file, settings))


def _gathered(files: tuple[Path, ...], targets: tuple[str, ...], rows: Sequence[tuple[Beam, str]]) -> BeamMeasurements:
    beams = [beam for beam, _ in rows]
    places = np.array([beam.spot.position_m for beam in beams])
    nowhere = np.full(2, np.nan)

    def method(name: str, sigma: bool) -> FloatArray:
        found = [beam.estimates.get(name) for beam in beams]
        return freeze(
            np.array([nowhere if one is None else (one.sigma_m if sigma else one.position_m) for one in found])
        )

    def column(name: str) -> FloatArray:
        return freeze(np.array([getattr(beam, name) for beam in beams], dtype=np.float64))

    return BeamMeasurements(
        files=files,
        targets=targets,
        x_m=freeze(places[:, 0].copy()),
        y_m=freeze(places[:, 1].copy()),
        covariance_m2=freeze(np.array([beam.spot.covariance_m2 for beam in beams])),
        moments_m2=freeze(np.array([beam.moments.covariance_m2 for beam in beams])),
        d50_m=column("d50_m"),
        d90_m=column("d90_m"),
        peak_dn=column("peak_dn"),
        background_dn=column("background_dn"),
        methods_m={name: method(name, sigma=False) for name in CENTROID_METHODS},
        methods_sigma_m={name: method(name, sigma=True) for name in CENTROID_METHODS},
        flags=freeze(np.array([int(beam.flags) for beam in beams], dtype=np.uint32)),
        notes=tuple(note for _, note in rows),
    )
