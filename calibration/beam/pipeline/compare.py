"""Photos of a beam against the mirror that made it: measured and expected flux, what they tell of the mirror."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from calibration.beam.exchange.surfaces import (
    artist_heliostats,
    design_mirror,
    read_artist_mirror,
    read_point_mirror,
    read_slope_map_mirror,
)
from calibration.beam.files.comparison import Comparison, PhotoComparison
from calibration.beam.images.target_finder import TargetFinder
from calibration.beam.keys import BeamMirrorSection, BeamsMeasurement
from calibration.beam.light.beam_flags import BeamFlag
from calibration.beam.light.beam_image import BeamSettings
from calibration.beam.light.beam_moments import encircled_diameters_m
from calibration.beam.light.beam_size import LightPicture
from calibration.beam.mirror.expected_flux import FluxGrid
from calibration.beam.mirror.facets import Mirror, Mount
from calibration.beam.mirror.flux_fit import (
    FluxFit,
    FluxPhoto,
    MirrorStand,
    aureole_ratio,
    compare_as_it_is,
    fit_flux,
)
from calibration.beam.pipeline.reading import BeamPhotos, read_photos
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.results.folder import hash_files
from heliogauge.results.sun_tables import read_sun
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.short_repr import ShortRepr
from heliogauge.sunlight.sun_shapes import SOLAR_DISC_RAD, BuieSun, SunShape
from heliogauge.validate import FloatArray

__all__ = ["CompareOptions", "run"]

#: Pixels across the sun's radius on the target: its edge is then followed to a few percent.
_PIXELS_PER_RADIUS = 5
#: Correlation below which measured and expected flux are not those of one mirror: the published mean of such work is
#: 0.958, and a wrong facet order or time zone gives less than 0.9.
_LEAST_CORRELATION = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class CompareOptions(ShortRepr):
    """Choices of the comparison.

    surface: File of the mirror's surface, in place of measurement.toml's.
    heliostat: Its name in a file of ARTIST.
    position_m: Its middle in the field: east, north, up [m].
    mount: How it turns about its normal.
    fit: Whether canting, focus and scatter are fitted.
    """

    surface: Path | None = None
    heliostat: str | None = None
    position_m: tuple[float, float, float] | None = None
    mount: Literal["azimuth-elevation", "east-axis"] | None = None
    fit: bool = True


def run(
    measurement: BeamsMeasurement, options: CompareOptions | None = None, progress: Progress | None = None
) -> Comparison:
    """Compare the beams of a folder with the mirror that made them.

    InputError: Files that cannot be used; no mirror, or no place of it; no photo with sun and place of its target.
    EstimationError: No photo has a beam that can be compared.
    """
    options, progress = options or CompareOptions(), progress or SilentProgress()
    photos = read_photos(measurement)
    section = measurement.model.mirror
    with progress.stage("mirror"):
        mirror, stand, surface = _mirror(measurement, section, options)
        sun = _sun(measurement, section)
    scatter = 1e-3 * section.scatter_mrad
    with progress.stage("photos", len(photos.files)) as stage:
        flux, left_out = [], dict(photos.left_out)
        finders: dict[str, TargetFinder] = {}
        settings = BeamSettings(method=measurement.model.evaluation.method)
        for row, file in enumerate(photos.files):
            one = _flux_photo(photos, row, stand, finders, settings)
            if isinstance(one, FluxPhoto):
                one = _in_its_sun(one, sun, mirror, stand, scatter)
            if isinstance(one, str):
                left_out[file.name] = one
            else:
                flux.append(one)
            stage.advance()
    if not flux:
        name, reason = next(iter(left_out.items()), ("", "no photo"))
        raise EstimationError(f"no photo can be compared with the mirror ({name}: {reason})")
    with progress.stage("expected flux"):
        before = compare_as_it_is(flux, mirror, stand, scatter)
    after: FluxFit | None = None
    doubts: list[Doubt] = []
    if options.fit:
        with progress.stage("fit"):
            after, doubt = _fitted(flux, mirror, stand, scatter)
            doubts += [] if doubt is None else [doubt]
    rows = tuple(_row(one, number, before, after) for number, one in enumerate(flux))
    with progress.stage("hash inputs"):
        files = (*measurement.input_files, *photos.shared_files, *photos.files, *([] if surface is None else [surface]))
        hashes = hash_files(tuple(dict.fromkeys(files)), measurement.folder)
    result = Comparison(
        mirror=mirror,
        stand=stand,
        sun=_sun_words(flux, sun),
        photos=tuple(flux),
        rows=rows,
        before=before,
        after=after,
        left_out=left_out,
        name=measurement.model.name,
    )
    doubts += _doubts(result)
    return replace(
        result,
        doubts=gather_doubts(photos.doubts, doubts),
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def _fitted(
    flux: Sequence[FluxPhoto], mirror: Mirror, stand: MirrorStand, scatter: float
) -> tuple[FluxFit | None, Doubt | None]:
    try:
        return fit_flux(flux, mirror, stand, max(scatter, 1e-3)), None
    except EstimationError as error:
        return None, Doubt("mirror_not_fitted", f"canting, focus and scatter were not estimated: {error}")


# --- what is compared -------------------------------------------------------------------------------------------------


def _mirror(
    measurement: BeamsMeasurement, section: BeamMirrorSection, options: CompareOptions
) -> tuple[Mirror, MirrorStand, Path | None]:
    surface = options.surface
    if surface is None and section.surface is not None:
        surface = measurement.path(section.surface)
    place = options.position_m or section.position_m
    mount: Mount | None = options.mount or section.mount
    if surface is None:
        if not section.facet:
            raise InputError(
                f"{measurement.folder}: which mirror made the beams? Give --surface FILE, or [mirror] surface or "
                f"[[mirror.facet]] "
                "in measurement.toml"
            )
        mirror = design_mirror(section.facet)
    elif surface.suffix.casefold() in (".h5", ".hdf5"):
        name = options.heliostat or section.heliostat or _name_in(surface, measurement.folder)
        found = read_artist_mirror(surface, name)
        mirror, place, mount = found.mirror, place or tuple(found.position_m.tolist()), mount or "east-axis"
    elif surface.suffix.casefold() == ".csv":
        mirror = read_point_mirror(surface)
    else:
        mirror = read_slope_map_mirror(surface)
    if place is None:
        raise InputError("[mirror] position_m (or --position E N U) is needed: where the mirror stands in the field")
    mount = mount or ("east-axis" if measurement.model.paint is not None else "azimuth-elevation")
    return mirror, MirrorStand(np.array(place, dtype=np.float64), mount), surface


def _name_in(surface: Path, folder: Path) -> str:
    """Return the heliostat of a file that the folder or one above is named after."""
    known = artist_heliostats(surface)
    for name in (folder.resolve().name, *(one.name for one in list(folder.resolve().parents)[:3])):
        if name in known:
            return name
    if len(known) == 1:
        return known[0]
    raise InputError(f"{surface}: which heliostat is it? Give --heliostat, one of {', '.join(known)}")


def _sun(measurement: BeamsMeasurement, section: BeamMirrorSection) -> SunShape | None:
    """Return the sun shape that is given; None: its aureole is estimated from each photo."""
    if section.sun_file is None:
        return None if section.circumsolar_ratio is None else BuieSun(section.circumsolar_ratio)
    return read_sun(measurement.path(section.sun_file))


def _in_its_sun(
    photo: FluxPhoto, sun: SunShape | None, mirror: Mirror, stand: MirrorStand, scatter: float
) -> FluxPhoto | str:
    """Give a photo its sun shape; return why it cannot be compared where the mirror does not light the target."""
    try:
        return replace(photo, sun=sun or BuieSun(aureole_ratio(photo, mirror, stand, scatter)))
    except (EstimationError, InputError) as error:
        return str(error)


def _sun_words(flux: Sequence[FluxPhoto], sun: SunShape | None) -> str:
    if sun is not None:
        return sun.describe()
    ratios = [one.sun.circumsolar_ratio for one in flux if isinstance(one.sun, BuieSun)]
    return (
        f"Buie sun, circumsolar ratio {min(ratios):.3f} to {max(ratios):.3f}: estimated from the skirts of each "
        f"photo (haze, dirt "
        "and the camera's halo count as aureole)"
    )


def _flux_photo(
    photos: BeamPhotos,
    row: int,
    stand: MirrorStand,
    finders: dict[str, TargetFinder],
    settings: BeamSettings,
) -> FluxPhoto | str:
    """Return the measured flux of a photo, or why it cannot be compared."""
    name, file, sun = photos.targets[row], photos.files[row], photos.to_sun[row]
    if name not in photos.planes:
        return f"the place of target {name!r} in the field is not known ([[target]] center_m, facing_azimuth_deg)"
    if not np.isfinite(sun).all():
        return "the sun is not known (sun_azimuth_deg and sun_elevation_deg, or time_utc and [site])"
    if sun[2] <= 0:
        return "the sun is below the horizon; check time_utc (is it UTC?) and [site]"
    if name not in finders:
        finders[name] = TargetFinder(photos.frames[name])
    beam, note = finders[name].measure(file, settings)
    if beam.rejected or beam.light is None:
        return "; ".join(filter(None, (beam.reason, note)))
    target = photos.planes[name]
    grid = _grid(beam.light, stand, photos, row)
    return FluxPhoto(
        file.name,
        target,
        sun,
        grid,
        _sampled(beam.light, grid, hide_full=bool(beam.flags & BeamFlag.SATURATED)),
        beam.spot.position_m,
        BuieSun(0.02),
    )


def _grid(light: LightPicture, stand: MirrorStand, photos: BeamPhotos, row: int) -> FluxGrid:
    distance = float(np.linalg.norm(photos.planes[photos.targets[row]].center_m - stand.position_m))
    step = max(SOLAR_DISC_RAD * distance / _PIXELS_PER_RADIUS, abs(float(light.x_m[1] - light.x_m[0])))
    # What the beam and its skirts light, and a sun's disc around it.
    margin = 2 * SOLAR_DISC_RAD * distance
    x, y = light.x_m[light.region.any(axis=0)], light.y_m[light.region.any(axis=1)]
    low_x, high_x = max(float(light.x_m.min()), x.min() - margin), min(float(light.x_m.max()), x.max() + margin)
    low_y, high_y = max(float(light.y_m.min()), y.min() - margin), min(float(light.y_m.max()), y.max() + margin)
    return FluxGrid(np.arange(low_x, high_x, step), np.arange(low_y, high_y, step))


def _sampled(light: LightPicture, grid: FluxGrid, *, hide_full: bool) -> FloatArray:
    """Return the light on a grid, averaged over its pixels."""
    column = (grid.x_m - light.x_m[0]) / (light.x_m[1] - light.x_m[0])
    line = (grid.y_m - light.y_m[0]) / (light.y_m[1] - light.y_m[0])
    finer = grid.step_m / abs(float(light.x_m[1] - light.x_m[0]))
    values = np.asarray(light.values_dn, dtype=np.float32)
    if finer > 1.2:
        values = np.asarray(cv2.GaussianBlur(values, (0, 0), 0.29 * finer), dtype=np.float32)
    maps = np.meshgrid(column.astype(np.float32), line.astype(np.float32))
    # The peak alone at the end of the scale is that of a picture stretched to it.
    full = cv2.dilate(light.saturated.astype(np.float32), np.ones((3, 3)))
    shown = cv2.remap(full, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    hidden = hide_full & (np.asarray(shown) > 0)
    sampled = cv2.remap(values, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    # Light beyond the grey scale is not known.
    return np.where(hidden, np.nan, np.asarray(sampled, dtype=np.float64))


# --- what comes out ---------------------------------------------------------------------------------------------------


def _row(photo: FluxPhoto, number: int, before: FluxFit, after: FluxFit | None) -> PhotoComparison:
    expected = before.expected_dn[number]
    measured, traced = photo.flux_dn, expected - before.levels_dn[number]
    fitted = None if after is None else after.expected_dn[number] - after.levels_dn[number]
    d90 = [_d90(one, photo.grid) for one in (measured, traced)]
    centers = [_center(one, photo.grid) for one in (measured, traced)]
    return PhotoComparison(
        float(before.correlations[number]),
        float("nan") if after is None else float(after.correlations[number]),
        d90[0],
        d90[1],
        float("nan") if fitted is None else _d90(fitted, photo.grid),
        float(np.hypot(*(centers[0] - centers[1]))),
    )


def _d90(flux: FloatArray, grid: FluxGrid) -> float:
    if not np.isfinite(flux).all():
        return float("nan")  # Saturated: the light in the middle is not known.
    known = flux
    return float(encircled_diameters_m(known, grid.x_m, grid.y_m, _center(known, grid), (0.9,))[0])


def _center(flux: FloatArray, grid: FluxGrid) -> FloatArray:
    known = np.where(np.isfinite(flux), flux, 0.0)
    total = float(known.sum())
    return np.array([known.sum(axis=0) @ grid.x_m, known.sum(axis=1) @ grid.y_m]) / total


def _doubts(result: Comparison) -> list[Doubt]:
    doubts = []
    correlations = result.before.correlations if result.after is None else result.after.correlations
    least, worst = float(np.min(correlations)), result.photos[int(np.argmin(correlations))].name
    if least < _LEAST_CORRELATION:
        doubts.append(
            Doubt(
                "flux_does_not_match",
                f"measured and expected flux correlate by {least:.3f} in {worst}: is it the beam of this mirror, is "
                f"the time UTC, is the "
                "surface seen from the front (x right, y up), how does the mirror turn (mount)?",
                {"correlation_ratio": least},
                Severity.SERIOUS,
            )
        )
    after = result.after
    if after is not None and not after.is_canting_told:
        facets, sigma_rad = result.mirror.facets, after.sigma_canting_rms_rad
        doubts.append(
            Doubt(
                "canting_not_determined",
                f"the canting of {len(facets)} facets is not determined: "
                f"{result.why_canting_is_open()}; more suns far apart (`beam plan` says which), or "
                "fewer facets in the light at a time (cover the others)",
                {"sigma_canting_rad": sigma_rad, "facets_count": len(facets)},
            )
        )
    if result.left_out:
        name, reason = next(iter(result.left_out.items()))
        doubts.append(
            Doubt(
                "photos_not_compared",
                f"{len(result.left_out)} photos were not compared ({name}: {reason})",
                {"left_out_count": len(result.left_out)},
            )
        )
    return doubts
