"""Photos of beams to places on the targets: read, find the target, rectify, measure; thousands of them in a stream."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from calibration.heliostat.beam_photos.light.beam_centroids import CENTROID_METHODS
from calibration.heliostat.beam_photos.light.beam_flags import REJECTED_BEAM, beam_reason
from calibration.heliostat.beam_photos.light.beam_image import BeamSettings
from calibration.heliostat.beam_photos.pipeline.target_frames import (
    ArucoMarkers,
    CornerPixels,
    DarkMarks,
    MarkerTemplates,
    PhotoBeam,
    Source,
    TargetFinder,
    TargetFrame,
    WholeImage,
)
from calibration.heliostat.beam_photos.target.view import TargetImage
from heliogauge.errors import FailurePicture, InputError
from heliogauge.images.photos import read_image
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.results.folder import write_table_csv
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FlagArray, FloatArray, freeze

__all__ = [
    "ArucoMarkers",
    "BeamMeasurements",
    "CornerPixels",
    "DarkMarks",
    "MarkerTemplates",
    "Source",
    "TargetFrame",
    "WholeImage",
    "measure_beams",
    "target_image",
    "write_beams",
]

#: Photos that are read ahead for each thread: enough to keep it busy, few enough to keep memory flat.
_AHEAD = 2


@dataclass(frozen=True, slots=True, eq=False)
class BeamMeasurements(ShortRepr):
    """Beams of many photos, one row per photo in the order of the files.

    x_m, y_m (n,): Place on the target's plane, x right and y up as seen from the field; NaN where there is none
        [m].
    covariance_m2 (n, 2, 2): Its covariance [m^2].
    moments_m2 (n, 2, 2): Central second moments of the light: the beam's own size [m^2].
    d50_m, d90_m (n,): Diameters of the circles with 50 and 90 % of the light [m].
    peak_dn, background_dn (n,): Largest brightness above the target's own, and the target's own [DN].
    methods_m, methods_sigma_m (n, 2): Place and sigma by each method; NaN where it gave none [m].
    flags (n,): Bits of `BeamFlag`.
    notes: Notes on a photo beyond its flags (why the target was not found, what cannot be read).
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

    def pictures_of_refused(self) -> Iterator[FailurePicture]:
        """Yield the photos in which no beam was found, each with the reason; one that cannot be read is left out."""
        for file, refused, reason in zip(self.files, self.rejected, self.reasons, strict=True):
            if refused:
                with suppress(InputError):
                    image = read_image(file)
                    size_px = (image.shape[1], image.shape[0])
                    yield FailurePicture(file.name, make_thumbnail(image), reason or "no beam found", size_px)


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

    settings: Method of the centroid, and limits.
    jobs: Threads; as many as there are processors (at most 8) if absent.
    Returns: One row per photo. A photo that cannot be read, shows no target or no beam has a flag and no place.
    InputError: No photo, lengths that differ, a target without a frame, or photos without a beam or templates that
        cannot be used.
    """
    if not files or len(files) != len(targets):
        raise InputError(f"photos: {len(files)} files and {len(targets)} targets are given; one target for each photo")
    unknown = sorted(set(targets) - set(frames))
    if unknown:
        raise InputError(f"photos: target {unknown[0]!r} has no corners; known are {', '.join(sorted(frames))}")
    chosen = settings or BeamSettings()
    finders = {name: TargetFinder(frames[name]) for name in sorted(set(targets))}
    for name, finder in finders.items():
        finder.look(files[list(targets).index(name)])
    threads = jobs or min(os.cpu_count() or 1, 8)
    rows: list[PhotoBeam] = []
    with (progress or SilentProgress()).stage("beams", len(files)) as stage, ThreadPoolExecutor(threads) as pool:
        work = (partial(finders[target].measure, file, chosen) for file, target in zip(files, targets, strict=True))
        for future in _streamed(pool, work, threads):
            rows.append(future.result())
            stage.advance()
    return _gathered(tuple(files), tuple(targets), rows)


def target_image(file: Path, frame: TargetFrame) -> TargetImage:
    """Read one photo as `measure_beams` sees it, for a figure.

    InputError: The photo cannot be read.
    EstimationError: The target is not found in it.
    """
    return TargetFinder(frame).image(file)


def write_beams(path: Path, beams: BeamMeasurements) -> None:
    """Write beams to a table.

    beams: What to write: one line per photo, also the rejected ones, with the reason.
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


# --- many photos ----------------------------------------------------------------------------------------------------


def _streamed(
    pool: ThreadPoolExecutor, work: Iterator[Callable[[], PhotoBeam]], threads: int
) -> Iterator["Future[PhotoBeam]"]:
    """Hand out work in order, a few photos ahead of what is taken."""
    waiting = [pool.submit(one) for one in islice(work, _AHEAD * threads)]
    while waiting:
        yield waiting.pop(0)
        waiting += [pool.submit(one) for one in islice(work, 1)]


def _gathered(files: tuple[Path, ...], targets: tuple[str, ...], rows: Sequence[PhotoBeam]) -> BeamMeasurements:
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
