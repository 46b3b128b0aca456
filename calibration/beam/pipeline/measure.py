"""Photos of beams to places, sizes and flux: list, measure in a stream, scale, judge."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.beam.files.flux_store import FluxStore
from calibration.beam.files.result import Result
from calibration.beam.images.target_finder import TargetFinder
from calibration.beam.keys import BeamFluxSection, BeamsMeasurement
from calibration.beam.light.beam_image import Beam, BeamSettings
from calibration.beam.light.contours import Contour, beam_contours
from calibration.beam.light.flux_scale import (
    FluxScale,
    Gauge,
    absolute_by_gauge,
    absolute_by_power,
    relative_flux,
    unknown_flux,
)
from calibration.beam.light.vignetting import LightFall
from calibration.beam.pipeline.beams import measure_beams
from calibration.beam.pipeline.judgement import doubts_of_beams
from calibration.beam.pipeline.reading import BeamPhotos, read_photos
from heliogauge.errors import EstimationError, InputError
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.images.video_names import video_of
from heliogauge.results.folder import hash_files
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import BoolArray

__all__ = ["Options", "Result", "run"]

#: Pictures in the report.
_MOST_PICTURES = 12


@dataclass(frozen=True, slots=True)
class Options:
    """Choices of the evaluation.

    Parameters
    ----------
    jobs : int or None
        Photos that are measured side by side; None: as many as there are processors, at most 8.
    """

    jobs: int | None = None


def run(measurement: BeamsMeasurement, options: Options | None = None, progress: Progress | None = None) -> Result:
    """Measure the beams of a folder.

    Parameters
    ----------
    measurement : BeamsMeasurement
        From `heliogauge.load`.
    options : Options, optional
        Choices.
    progress : Progress, optional
        Notified of each stage.

    Returns
    -------
    Result
        Places, sizes, contours and flux of all beams; a photo without a usable beam has a flag and its reason.

    Raises
    ------
    InputError
        Files that cannot be used, or a calorimeter that is not on the target.
    EstimationError
        The target is not found in a photo without a beam, or no beam lights the calorimeter.
    """
    options, progress = options or Options(), progress or SilentProgress()
    photos = read_photos(measurement)
    evaluation = measurement.model.evaluation
    stores = {name: FluxStore(photos.frames[name].corners_m) for name in dict.fromkeys(photos.targets)}
    scales: list[FluxScale] = []
    contours: list[tuple[Contour, ...]] = []

    def keep(row: int, beam: Beam) -> None:
        scales.append(_scale(measurement.model.flux, photos, row, beam))
        lines: tuple[Contour, ...] = ()
        if beam.light is not None:
            stores[photos.targets[row]].add(row, beam.light)
            lines = beam_contours(beam.light, 0.01 * max(beam.light.values_dn.shape), evaluation.contours)
        contours.append(lines)

    beams = measure_beams(
        photos.files,
        photos.targets,
        photos.frames,
        settings=BeamSettings(method=evaluation.method),
        jobs=options.jobs,
        progress=progress,
        keep=keep,
    )
    _refuse_dark_gauge(measurement.model.flux, beams.rejected, scales)
    with progress.stage("pictures"):
        thumbnails = _pictures(photos)
        falls = _light_falls(photos)
    with progress.stage("hash inputs"):
        files = dict.fromkeys(video_of(file) for file in photos.files)
        hashes = hash_files((*measurement.input_files, *photos.shared_files, *files), measurement.folder)
    result = Result(
        photos, beams, tuple(scales), tuple(contours), stores, thumbnails, falls, name=measurement.model.name
    )
    return replace(
        result,
        doubts=doubts_of_beams(result),
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def _scale(flux: BeamFluxSection, photos: BeamPhotos, row: int, beam: Beam) -> FluxScale:
    own, sigma = (
        float(photos.numbers[name][row]) if name in photos.numbers else float("nan")
        for name in ("power_w", "sigma_power_w")
    )
    if np.isfinite(own):
        return absolute_by_power(beam.size, own, sigma if np.isfinite(sigma) else 0.0)
    if flux.power_w is not None:
        return absolute_by_power(beam.size, flux.power_w, flux.sigma_power_w)
    if flux.gauge_flux_w_m2 is not None and flux.gauge_center_m is not None and flux.gauge_diameter_m is not None:
        gauge = Gauge(
            flux.gauge_flux_w_m2, flux.sigma_gauge_flux_w_m2, np.array(flux.gauge_center_m), flux.gauge_diameter_m
        )
        if beam.light is not None and not beam.rejected:
            try:
                return absolute_by_gauge(beam.size, beam.light, gauge)
            except EstimationError:
                return unknown_flux()  # The judgement names these photos.
    return relative_flux(beam.size)


def _refuse_dark_gauge(flux: BeamFluxSection, rejected: BoolArray, scales: Sequence[FluxScale]) -> None:
    if flux.gauge_flux_w_m2 is None or flux.gauge_center_m is None or rejected.all():
        return
    lit = [one for one, bad in zip(scales, rejected, strict=True) if not bad and np.isfinite(one.per_dn)]
    if not lit:
        raise EstimationError(
            f"flux.gauge_center_m = {list(flux.gauge_center_m)}: none of {len(scales)} beams lights the calorimeter; "
            "aim at it, or give power_w"
        )


def _light_falls(photos: BeamPhotos) -> dict[str, LightFall]:
    """Estimate what the lens takes from the light, by target, where frames without a beam show it."""
    found = {}
    for name in dict.fromkeys(photos.targets):
        if not photos.frames[name].empty_files:
            continue
        try:
            fall = TargetFinder(photos.frames[name]).lens_fall()
        except (EstimationError, InputError):
            continue  # The photos' rows have the reason.
        if fall is not None:
            found[name] = fall
    return found


def _pictures(photos: BeamPhotos) -> dict[str, bytes]:
    """Pictures of some photos on their targets, spread evenly over the series."""
    chosen = np.unique(np.linspace(0, len(photos.files) - 1, _MOST_PICTURES).round().astype(int))
    finders: dict[str, TargetFinder] = {}
    found = {}
    for row in chosen.tolist():
        target = photos.targets[row]
        try:
            if target not in finders:
                finders[target] = TargetFinder(photos.frames[target])
            image = finders[target].image(photos.files[row]).values_dn
        except (EstimationError, InputError):
            continue  # Its row has the reason.
        known = np.where(np.isfinite(image), image, float(np.nanmin(image)) if np.isfinite(image).any() else 0.0)
        found[f"beam_{row + 1:04d}"] = make_thumbnail(known.astype(np.float32))
    return found
