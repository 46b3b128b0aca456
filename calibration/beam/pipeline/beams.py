"""Photos of beams to places on the targets: read, find the target, rectify, measure; thousands of them in a stream."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from calibration.beam.images.target_finder import PhotoBeam, TargetFinder
from calibration.beam.images.target_frames import TargetFrame
from calibration.beam.light.beam_centroids import CENTROID_METHODS
from calibration.beam.light.beam_flags import REJECTED_BEAM, beam_reason
from calibration.beam.light.beam_image import Beam, BeamSettings
from calibration.beam.light.beam_size import BeamSize
from calibration.beam.target.view import TargetImage
from heliogauge.errors import FailurePicture, InputError
from heliogauge.images.photos import read_image
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.results.folder import write_table_csv
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FlagArray, FloatArray, freeze

__all__ = [
    "BeamMeasurements",
    "beam_columns",
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
    sizes length n: Sizes from all of the light.
    background_dn (n,): Brightness of the target itself under the beam [DN].
    methods_m, methods_sigma_m (n, 2): Place and sigma by each method; NaN where it gave none [m].
    flags (n,): Bits of `BeamFlag`.
    notes: Notes on a photo beyond its flags (why the target was not found, what cannot be read).
    """

    files: tuple[Path, ...]
    targets: tuple[str, ...]
    x_m: FloatArray
    y_m: FloatArray
    covariance_m2: FloatArray
    sizes: tuple[BeamSize, ...]
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
    def moments_m2(self) -> FloatArray:
        """Central second moments of all of the light: the beam's own size, shape (n, 2, 2) [m^2]."""
        return np.array([one.moments_m2 for one in self.sizes])

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
    keep: Callable[[int, Beam], None] | None = None,
) -> BeamMeasurements:
    """Measure the beams of many photos.

    settings: Method of the centroid, and limits.
    jobs: Threads; as many as there are processors (at most 8) if absent.
    keep: Takes what is wanted of each beam's light, in the order of the files; the light itself is then let go.
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
        for number, future in enumerate(_streamed(pool, work, threads)):
            beam, note = future.result()
            if keep is not None:
                keep(number, beam)
            rows.append(PhotoBeam(replace(beam, light=None), note))
            stage.advance()
    return _gathered(tuple(files), tuple(targets), rows)


def target_image(file: Path, frame: TargetFrame) -> TargetImage:
    """Read one photo as `measure_beams` sees it, for a figure.

    InputError: The photo cannot be read.
    EstimationError: The target is not found in it.
    """
    return TargetFinder(frame).image(file)


def write_beams(path: Path, beams: BeamMeasurements, more: Mapping[str, Any] | None = None) -> None:
    """Write beams to a table.

    beams: What to write: one line per photo, also the rejected ones, with the reason.
    more: Further columns, one value for each photo.
    """
    columns = beam_columns(beams)
    for name in CENTROID_METHODS:
        columns[f"{name}_x_m"], columns[f"{name}_y_m"] = beams.methods_m[name].T
    columns["rejected"] = [int(each) for each in beams.rejected]
    columns["reason"] = list(beams.reasons)
    columns |= more or {}
    write_table_csv(path, columns)


def beam_columns(beams: BeamMeasurements) -> dict[str, Sequence[object] | FloatArray]:
    """Return places and sizes as columns of a table, each number followed by its sigma."""
    sigma = beams.sigma_m
    moments = beams.moments_m2
    minor, major = np.sqrt(np.maximum(np.linalg.eigvalsh(np.where(np.isfinite(moments), moments, 0.0)), 0.0)).T
    direction = 0.5 * np.arctan2(2 * moments[:, 0, 1], moments[:, 0, 0] - moments[:, 1, 1])
    seen = np.isfinite(moments).all(axis=(1, 2))
    sigmas = np.array([_ellipse_sigma(one) for one in beams.sizes])
    diameters = np.array([one.diameters_m for one in beams.sizes])
    sigma_diameters = np.array([one.sigma_diameters_m for one in beams.sizes])
    columns: dict[str, Sequence[object] | FloatArray] = {
        "image": [file.name for file in beams.files],
        "target": list(beams.targets),
        "x_m": beams.x_m,
        "y_m": beams.y_m,
        "sigma_x_m": sigma[:, 0],
        "sigma_y_m": sigma[:, 1],
        "width_major_m": np.where(seen, major, np.nan),
        "sigma_width_major_m": sigmas[:, 0],
        "width_minor_m": np.where(seen, minor, np.nan),
        "sigma_width_minor_m": sigmas[:, 1],
        "direction_deg": np.where(seen, np.degrees(direction), np.nan),
        "sigma_direction_deg": np.degrees(sigmas[:, 2]),
    }
    for name, values, errors in zip(("d50", "d90", "d95"), diameters.T, sigma_diameters.T, strict=True):
        columns[f"{name}_m"], columns[f"sigma_{name}_m"] = values, errors
    columns["peak_dn"] = np.array([one.peak_dn for one in beams.sizes])
    columns["sigma_peak_dn"] = np.array([one.sigma_peak_dn for one in beams.sizes])
    columns["background_dn"] = beams.background_dn
    return columns


def _ellipse_sigma(size: BeamSize) -> FloatArray:
    """Sigma of major and minor width [m] and of the direction [rad], shape (3,); NaN where there is none.

    Rates of the eigenvalues and of the eigenvector of the moments by xx, xy, yy.
    """
    moments = size.moments_m2
    if not np.isfinite(moments).all():
        return np.full(3, np.nan)
    values, vectors = np.linalg.eigh(moments)
    rates = []
    for value, vector in ((values[1], vectors[:, 1]), (values[0], vectors[:, 0])):
        rate = np.array([vector[0] ** 2, 2 * vector[0] * vector[1], vector[1] ** 2])
        rates.append(rate / (2 * np.sqrt(max(float(value), 1e-300))))
    half, cross = (moments[0, 0] - moments[1, 1]) / 2, moments[0, 1]
    # A round beam has no direction: its sigma then is that of any angle, pi / sqrt(12).
    rates.append(0.5 * np.array([-0.5 * cross, half, 0.5 * cross]) / max(float(half**2 + cross**2), 1e-300))
    rows = np.array(rates)
    sigma = np.sqrt(np.maximum(np.diag(rows @ size.covariance_moments_m4 @ rows.T), 0.0))
    sigma[2] = min(float(sigma[2]), np.pi / np.sqrt(12))
    return np.asarray(sigma)


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
        sizes=tuple(beam.size for beam in beams),
        background_dn=column("background_dn"),
        methods_m={name: method(name, sigma=False) for name in CENTROID_METHODS},
        methods_sigma_m={name: method(name, sigma=True) for name in CENTROID_METHODS},
        flags=freeze(np.array([int(beam.flags) for beam in beams], dtype=np.uint32)),
        notes=tuple(note for _, note in rows),
    )
