"""Stars in facets from photos to canting: the stages follow each other in `run`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from deflectometry.field.placement import OrientedCamera, field_from_mirror
from deflectometry.frames.image_file_checks import check_size
from deflectometry.gazing.pipeline.inputs import oriented
from deflectometry.gazing.pipeline.result import Pointing
from deflectometry.pipeline.choices import Options
from deflectometry.pipeline.headline import (
    Numbers,
    canting_numbers,
    facet_numbers,
    headline_text,
    numbers_of_maps,
    reasons,
)
from deflectometry.pipeline.inputs import build_facets, build_mounts
from deflectometry.pipeline.result import write_canting
from deflectometry.setup.setup_steps import principal_steps
from deflectometry.shape.assemble import assemble_maps
from deflectometry.shape.facet_canting import CANTING_SIGN, FacetCanting, canting_of_facets, doubt_of_canting
from deflectometry.shape.smooth_shape import Align, alignment_words
from deflectometry.stars.facet_maps import lean_map
from deflectometry.stars.facet_stars import (
    FacetLight,
    Lean,
    SkyOfFacet,
    identify,
    linear_response,
    seen_directions,
    sky_area,
)
from deflectometry.stars.keys import StarsMeasurement
from deflectometry.stars.pipeline.catalogue import read_catalogue
from deflectometry.stars.sky import Catalogue, StarsAbove, stars_above
from deflectometry.stars.spots import Spots, find_spots
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, vector_from_rotation
from heliogauge.geometry.sun import Site, sun_angles, utc_times
from heliogauge.geometry.surfaces import Facet
from heliogauge.images.photos import read_frames
from heliogauge.results.folder import Summary, hash_files, write_slope_map, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import ASSEMBLED
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal, remove
from heliogauge.validate import BoolArray, FloatArray

#: Table of the points of light.
STARS_FILE = "stars.csv"
#: A hypothesis counts where the odds against it are below one in a thousand.
_SURE = 0.999
#: Facets of which so many agree on the mirror's lean determine it.
_FEWEST_FACETS = 1
#: A star's place beside what refraction and the clock move alike [rad].
_SKY_SIGMA_RAD = 1e-5
#: The sky turns by so much in a second of time [rad].
_TURN_PER_S = 7.292e-5
#: With the sun higher than this no photo shows stars.
_DAY_RAD = np.radians(-3.0)
#: Facets on which other hours are tried.
_TRIED, _TRIED_POINTS = 3, 8
#: A count of stars is exceeded by chance by less than so many standard deviations.
_CHANCE_SIGMAS = 5.0
#: Nodes of a map along a facet.
_NODES = 40


@dataclass(frozen=True, slots=True, eq=False)
class StarsResult(InstrumentResult):
    """Canting and curvature of a heliostat's facets from stars.

    facets: All facets. maps: The map of each facet whose stars are known. assembled: Of the whole mirror.
    numbers, facet_numbers: Headline numbers. cantings: Of each facet; empty for a mirror of one.
    lights, leans: Points of light and what they gave, by facet; None where the sky does not determine it.
    """

    kind: ClassVar[str] = "stars"
    facets: tuple[Facet, ...]
    maps: Mapping[str, SlopeMap]
    assembled: SlopeMap
    numbers: Numbers
    facet_numbers: Mapping[str, Numbers]
    cantings: tuple[FacetCanting, ...]
    lights: tuple[FacetLight, ...]
    leans: tuple[Lean | None, ...]

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        texts = {
            "design": self.assembled.design,
            "removed": self.assembled.removed,
            "frame": self.assembled.frame,
            "slopes": "lean, curvatures and twist of each facet: what is finer no star shows",
            "sigma": "1 standard deviation; slopes are those of the normal, a beam turns by twice as much",
        }
        if self.cantings:
            texts["canting"] = CANTING_SIGN
        return self._summary(
            self.numbers,
            texts,
            reasons(self.numbers, self.facet_numbers),
            facets=self.facet_numbers,
            geometry_m={"outlines": [one.ensemble_from_facet.apply(one.corners_m).tolist() for one in self.facets]},
        )

    def write_files(self, folder: Path) -> None:
        """Write maps, canting and the table of stars into an existing folder."""
        maps = dict(self.maps)
        if len(self.facets) > 1:
            maps[ASSEMBLED] = self.assembled
        write_slope_map(folder / "slope_map.nc", maps, {"name": self.name, "input_sha256": self.input_sha256})
        write_canting(folder, self.cantings)
        rows = [
            (
                light.facet.name,
                int(light.photo[n]) + 1,
                *light.places_px[n].tolist(),
                float(light.magnitude[n]),
                star,
                off,
                p,
            )
            for light, lean in zip(self.lights, self.leans, strict=True)
            for n, (star, off, p) in enumerate(_stars_of(light, lean))
        ]
        names = ("facet", "photo", "x_px", "y_px", "magnitude", "hip", "residual_over_sigma", "probability")
        write_table_csv(folder / STARS_FILE, {name: [row[k] for row in rows] for k, name in enumerate(names)})

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return headline_text(self.summarise())


def _stars_of(light: FacetLight, lean: Lean | None) -> Iterator[tuple[str, float, float]]:
    for n in range(light.photo.size):
        if lean is None:
            yield "", np.nan, np.nan
        else:
            yield (str(lean.star[n]) if lean.star[n] >= 0 else ""), float(lean.residual[n]), lean.probability


@dataclass(frozen=True, slots=True, eq=False)
class _Night:
    """What is known before stars are named: facets, points of light, photos' middles, site."""

    facets: tuple[Facet, ...]
    lights: tuple[FacetLight, ...]
    field_from_mirror: RigidTransform
    times: tuple[np.datetime64, ...]
    site: Site
    catalogue: Catalogue
    left_out: int


def run(measurement: StarsMeasurement, options: Options | None = None, progress: Progress | None = None) -> StarsResult:
    """Find how the facets of a heliostat lean from the stars that they show.

    options: Choices that override the file's; strict refuses facets whose stars are not known.
    InputError: Photos that cannot be read; pyerfa or the catalogue is not installed.
    EstimationError: The sky does not determine it: no stars, the ground in the facets, times in another zone.
    """
    options, progress, model = options or Options(), progress or SilentProgress(), measurement.model
    section = model.evaluation
    with progress.stage("catalogue"):
        catalogue = read_catalogue().brighter(float(section.faintest_magnitude))
    with progress.stage("stars in photos"):
        facets = build_facets(model.mirror, model.name)
        if not facets:
            raise InputError(f"{measurement.folder}: mirror.outline_m or [[mirror.facet]] is needed")
        stated = _stated_frame(measurement)
        camera = _first_orientation(measurement, stated)
        spots = _spots(measurement, facets, camera)
        night = _night(measurement, catalogue, facets, spots, stated, camera)
    with progress.stage("name stars"):
        leans = _named(night, section_priors(measurement), 0.0)
        known = [one for one in leans if one is not None]
        if len(known) < max(_FEWEST_FACETS, 0.3 * sum(one.photo.size > 0 for one in night.lights)):
            _refuse(night, section_priors(measurement), leans)
        if options.strict and len(known) < len(night.facets):
            raise EstimationError(f"{len(night.facets) - len(known)} facets without known stars, with --strict")
        # The points that turn the camera lean with the mirror.
        turn = _mirror_turn(facets, leans)
        camera = oriented(model.camera, measurement.folder, (stated @ turn).inverse())
        night = _night(measurement, catalogue, facets, spots, stated @ turn, camera)
        own = _named(night, section_priors(measurement), 0.0)
        leans = [
            None if one is None else _against_stated(one, facet, turn) for one, facet in zip(own, facets, strict=True)
        ]
        known = [one for one in leans if one is not None]
    with progress.stage("maps"):
        align = options.align or Align(section.align)
        frame = "facet frame: x across, y up, seen from the front, z out of the mirror [m]"
        step_mm = options.grid_step_mm or section.grid_step_mm
        size = float(np.mean([np.ptp(one.outline_m, axis=0).max() for one in night.facets]))
        step_m = size / _NODES if step_mm is None else 1e-3 * step_mm
        moved = _moved_leans(measurement, night, camera, own)
        as_nominal = {
            facet.name: lean_map(
                facet,
                lean,
                [(source, values[n]) for source, values in moved],
                step_m,
                frame,
                alignment_words(align, len(night.facets)),
            )
            for n, (facet, lean) in enumerate(zip(night.facets, leans, strict=True))
            if lean is not None
        }
        pointing = _pointing(leans, [values for _, values in moved])
        as_measured = (
            {name: _turned(one, pointing) for name, one in as_nominal.items()} if align is Align.NORMAL else as_nominal
        )
    with progress.stage("statistics"):
        removal = options.remove or Removal(section.remove)
        maps = {name: remove(one, removal) for name, one in as_measured.items()}
        several = len(night.facets) > 1
        cantings = canting_of_facets(night.facets, as_measured, build_mounts(model.mirror)) if several else ()
        assembled = assemble_maps(night.facets, maps, align, removal)
        whole = assemble_maps(night.facets, as_measured, align, Removal.NOTHING)
        numbers = facet_numbers(assembled, whole) | canting_numbers(cantings) | pointing.numbers()
        numbers = _without_curl(numbers)
        numbers["stars_count"] = sum(int(np.count_nonzero(one.star >= 0)) for one in known)
    return StarsResult(
        name=model.name,
        facets=night.facets,
        maps=maps,
        assembled=assembled,
        numbers=numbers,
        facet_numbers={name: _without_curl(one) for name, one in numbers_of_maps(maps, as_measured, cantings).items()}
        if several
        else {},
        cantings=cantings,
        lights=night.lights,
        leans=tuple(leans),
        doubts=gather_doubts(doubt_of_canting(cantings) if several else None, *_doubts(night, leans)),
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(measurement.input_files, measurement.folder),
    )


def _without_curl(numbers: Numbers) -> Numbers:
    """Leave out the curl: lean, curvatures and twist are a surface's by themselves, so that it tests nothing."""
    return {name: one for name, one in numbers.items() if not name.startswith("curl_")}


def section_priors(measurement: StarsMeasurement) -> tuple[FloatArray, FloatArray]:
    """Return standard deviations of the five numbers: before the mirror's lean is known, and of facets against it."""
    section = measurement.model.evaluation
    bow = 1e-3 * section.sigma_bow_mrad_per_m
    single = 1e-3 * section.sigma_canting_mrad
    wide = float(np.hypot(1e-3 * section.sigma_normal_mrad, single))
    return np.array([wide, wide, bow, bow, bow]), np.array([single, single, bow, bow, bow])


def _stated_frame(measurement: StarsMeasurement) -> RigidTransform:
    """Return where the mirror's frame stands by its stated normal."""
    normal = np.asarray(measurement.model.mirror.normal, dtype=np.float64)
    return field_from_mirror(np.asarray(measurement.model.mirror.place_m), normal / np.linalg.norm(normal))


def _mirror_turn(facets: Sequence[Facet], leans: Sequence[Lean | None]) -> RigidTransform:
    """Return how the whole mirror is turned, without a roll, by the mean of its facets' leans."""
    turns = []
    for facet, lean in zip(facets, leans, strict=True):
        if lean is not None:
            axes = facet.ensemble_from_facet.rotation
            turns.append(np.cross(axes[:, 2], axes @ _normal_of(lean)))
    return RigidTransform.from_rotation_vector(np.mean(turns, axis=0), np.zeros(3))


def _normal_of(lean: Lean) -> FloatArray:
    normal = np.array([-lean.values[0], -lean.values[1], 1.0])
    return np.asarray(normal / np.linalg.norm(normal))


def _against_stated(lean: Lean, facet: Facet, turn: RigidTransform) -> Lean:
    """Return the lean of a facet of a turned mirror against where it stands in the mirror as stated."""
    axes = facet.ensemble_from_facet.rotation
    x, y, z = axes.T @ turn.rotation @ axes @ _normal_of(lean)
    return replace(lean, values=np.array([-x / z, -y / z, *lean.values[2:]]))


def _first_orientation(measurement: StarsMeasurement, stated: RigidTransform) -> OrientedCamera:
    """Return the camera by points of a mirror that may lean as far as its normal is uncertain."""
    section = measurement.model.camera
    points = np.array([one.point_m for one in section.point])
    trial = oriented(section, measurement.folder, stated.inverse(), is_trial=True)
    seen = trial.camera.project(trial.cam_from_mirror.apply(points))
    squares = np.zeros(len(points))
    for turn in 1e-3 * measurement.model.evaluation.sigma_normal_mrad * np.eye(3)[:2]:
        leaning = RigidTransform.from_rotation_vector(turn, np.zeros(3)).apply(points)
        off = trial.camera.project(trial.cam_from_mirror.apply(leaning)) - seen
        squares += 0.5 * (off**2).sum(axis=1)
    return oriented(section, measurement.folder, stated.inverse(), moved_px=np.sqrt(squares))


def _spots(measurement: StarsMeasurement, facets: Sequence[Facet], camera: OrientedCamera) -> list[list[Spots]]:
    """Return the points of light of each facet in each photo."""
    frames = read_frames([measurement.folder / one.file for one in measurement.model.photo])
    check_size(frames.images_dn.shape[:0:-1], camera.camera, "photo.file")
    spots = []
    for facet in facets:
        region = _region(camera, facet, frames.images_dn.shape[1:])
        spots.append(
            [find_spots(np.asarray(one, np.float64), region, frames.full_scale_dn) for one in frames.images_dn]
        )
    return spots


def _night(
    measurement: StarsMeasurement,
    catalogue: Catalogue,
    facets: Sequence[Facet],
    spots: Sequence[Sequence[Spots]],
    frame: RigidTransform,
    camera: OrientedCamera,
) -> _Night:
    """Return what is known before stars are named.

    frame, camera: Where the mirror's frame stands in the field, and the camera before it.
    """
    model = measurement.model
    lights = [_light(camera, facet, found) for facet, found in zip(facets, spots, strict=True)]
    found_count = sum(one.photo.size for one in lights)
    lights = [_brightest(one, len(model.photo), catalogue) for one in lights]
    if not sum(one.photo.size for one in lights):
        raise EstimationError(
            "no point of light in any facet: the exposure is too short, the lens is not at infinity, or the facets "
            "show no sky"
        )
    begin = utc_times([one.time for one in model.photo])
    half = np.array([500 * one.exposure_s for one in model.photo]).astype("timedelta64[ms]")
    site = Site(
        model.site.latitude_deg,
        model.site.longitude_deg,
        model.site.altitude_m,
        model.site.pressure_hpa,
        model.site.temperature_c,
    )
    night = _Night(
        tuple(facets),
        tuple(lights),
        frame,
        tuple(begin + half),
        site,
        catalogue,
        found_count - sum(one.photo.size for one in lights),
    )
    return _with_zero_point(night)


def _brightest(light: FacetLight, photos: int, catalogue: Catalogue) -> FacetLight:
    """Return no more points of light than stars of the catalogue can be in the facet, the brightest of each photo."""
    expected = catalogue.number.size / (4 * np.pi) * sky_area(light)
    # Towards the Milky Way there are twice as many.
    most = int(2 * expected + _CHANCE_SIGMAS * np.sqrt(2 * expected)) + 5
    kept = []
    for photo in range(photos):
        own = np.flatnonzero(light.photo == photo)
        kept.append(own[np.argsort(light.magnitude[own], kind="stable")[:most]])
    return light.chosen(np.concatenate(kept))


def _region(camera: OrientedCamera, facet: Facet, shape: tuple[int, ...]) -> BoolArray:
    import cv2

    corners = camera.camera.project((camera.cam_from_mirror @ facet.ensemble_from_facet).apply(facet.corners_m))
    mask = np.zeros(shape, dtype=np.uint8)
    cv2.fillPoly(mask, [np.rint(corners).astype(np.int32)], 1)
    # A star at the rim is cut: its centre would be drawn inwards.
    return np.asarray(cv2.erode(mask, np.ones((9, 9), np.uint8)) > 0)


def _light(camera: OrientedCamera, facet: Facet, found: Sequence[Spots]) -> FacetLight:
    places = np.concatenate([one.places_px for one in found])
    facet_from_cam = (camera.cam_from_mirror @ facet.ensemble_from_facet).inverse()
    sight = camera.camera.cast_rays_with_jacobians(places) if len(places) else None
    rays = np.zeros((0, 3)) if sight is None else sight.rays @ facet_from_cam.rotation.T
    by_px = (
        np.zeros((0, 3, 2)) if sight is None else np.einsum("ij,njk->nik", facet_from_cam.rotation, sight.d_ray_d_pixel)
    )
    flux = np.concatenate([one.flux_dn for one in found])
    return FacetLight(
        facet,
        np.repeat(np.arange(len(found)), [len(one.flux_dn) for one in found]),
        places,
        rays,
        by_px,
        facet_from_cam.translation_m,
        np.concatenate([one.sigma_px for one in found]),
        -2.5 * np.log10(np.maximum(flux, 1e-9)),
    )


def _sky_of(night: _Night, facet: Facet, above: Sequence[StarsAbove]) -> SkyOfFacet:
    facet_from_field = (night.field_from_mirror @ facet.ensemble_from_facet).rotation.T
    return SkyOfFacet(
        [one.directions @ facet_from_field.T for one in above],
        [one.magnitude for one in above],
        [one.number for one in above],
    )


def _above(night: _Night, hours: float) -> list[StarsAbove]:
    shift = np.timedelta64(int(hours * 3_600_000), "ms")
    return [stars_above(night.catalogue, one + shift, night.site) for one in night.times]


def _with_zero_point(night: _Night) -> _Night:
    """Turn light into magnitudes: as many points as the facets show are the brightest stars of so much sky.

    The whole sky over the horizon has the same stars per solid angle within a factor of two: 0.7 magnitudes.
    """
    above = _above(night, 0.0)
    area = sum(sky_area(one) for one in night.lights) * len(night.times)
    magnitudes = np.sort(np.concatenate([one.magnitude for one in above]))
    density = len(magnitudes) / (2 * np.pi * (1 - np.sin(np.radians(10.0))) * len(above))
    found = np.sort(np.concatenate([one.magnitude for one in night.lights]))
    share = min(found.size / max(area * density, 1e-9), 1.0)
    typical = float(np.median(magnitudes[: max(int(share * magnitudes.size), 1)]))
    zero = typical - float(np.median(found))
    return replace(night, lights=tuple(replace(one, magnitude=one.magnitude + zero) for one in night.lights))


def _named(night: _Night, priors: tuple[FloatArray, FloatArray], hours: float) -> list[Lean | None]:
    """Name the stars of all facets: first each by itself, then around the lean that they have in common."""
    above = _above(night, hours)
    skies = [_sky_of(night, one, above) for one in night.facets]
    alone = [
        identify(light, sky, np.zeros(5), priors[0], _SKY_SIGMA_RAD) if light.photo.size else None
        for light, sky in zip(night.lights, skies, strict=True)
    ]
    sure = [one for one in alone if _is_sure(one)]
    if not sure:
        return [None] * len(alone)
    middle = np.append(np.median([one.values[:2] for one in sure if one is not None], axis=0), np.zeros(3))
    again = [
        identify(light, sky, middle, priors[1], _SKY_SIGMA_RAD) if light.photo.size else None
        for light, sky in zip(night.lights, skies, strict=True)
    ]
    return [one if _is_sure(one) else None for one in again]


def _is_sure(one: Lean | None) -> bool:
    return one is not None and one.probability > _SURE and int(np.count_nonzero(one.star >= 0)) >= 1


def _fits(night: _Night, priors: tuple[FloatArray, FloatArray], hours: float, sure: int) -> bool:
    """Return whether the sky of so many hours later names the stars of many more facets.

    Three facets with the most points are tried first: where none of them has a sure name, half of all have not.
    """
    shift = np.timedelta64(int(hours * 3_600_000), "ms")
    if (sun_angles([one + shift for one in night.times], night.site)[1] > _DAY_RAD).any():
        return False
    most = sorted(night.lights, key=lambda one: -one.photo.size)[:_TRIED]
    most = [one.chosen(np.argsort(one.magnitude)[:_TRIED_POINTS]) for one in most]
    above = _above(night, hours)
    tried = [identify(one, _sky_of(night, one.facet, above), np.zeros(5), priors[0], _SKY_SIGMA_RAD) for one in most]
    if not any(_is_sure(one) for one in tried):
        return False
    named = sum(one is not None for one in _named(night, priors, hours))
    return named > max(2 * sure, 0.5 * len(night.facets))


def _refuse(night: _Night, priors: tuple[FloatArray, FloatArray], leans: Sequence[Lean | None]) -> None:
    """Say why stars cannot be named.

    EstimationError: Always.
    """
    up = []
    for light in night.lights:
        if light.photo.size:
            facet = (night.field_from_mirror @ light.facet.ensemble_from_facet).rotation
            mirrored = light.sights * np.array([1.0, 1.0, -1.0])
            up += (mirrored @ facet.T)[:, 2].tolist()
    points = sum(one.photo.size for one in night.lights)
    if np.median(up) < np.sin(np.radians(10.0)):
        raise EstimationError(
            f"the facets show what is {np.degrees(np.arcsin(np.median(up))):.0f} degrees above the horizon: no star "
            "field (10 degrees and more) is in view; check mirror.normal and the camera's place"
        )
    sure = sum(one is not None for one in leans)
    # One point alone fits some star at every hour.
    several = any(one.photo.size > 1 for one in night.lights)
    for hours in sorted(range(-14, 15), key=abs):
        if hours and several and _fits(night, priors, hours, sure):
            raise EstimationError(
                f"the stars in the facets are those of {abs(hours)} h {'later' if hours > 0 else 'earlier'} than "
                "stated: the times are in another zone; append the right offset to photo.time"
            )
    raise EstimationError(
        f"the stars in {len(leans) - sure} of {len(leans)} facets cannot be named ({points} points of light, "
        f"{points / max(len(leans) * len(night.times), 1):.1f} in a facet and photo): the sky does not determine how "
        "they lean; take more photos over the night or longer exposures, or check time, site, mirror.normal and "
        "faintest_magnitude"
    )


def _moved_leans(
    measurement: StarsMeasurement, night: _Night, camera: OrientedCamera, leans: Sequence[Lean | None]
) -> list[tuple[str, FloatArray]]:
    """Return what one sigma of each common input does to lean and bows of each facet, shape (f, 5)."""
    model = measurement.model
    found: list[tuple[str, FloatArray]] = []
    shift = 1e-3 * float(np.hypot(model.camera.sigma_place_mm, model.mirror.sigma_place_mm))
    lights = list(zip(night.lights, leans, strict=True))
    if shift > 0:
        for step in shift * np.eye(3):
            elsewhere = _oriented_beside(measurement, night, step)
            turn = -vector_from_rotation(elsewhere.cam_from_mirror.rotation @ camera.cam_from_mirror.rotation.T)
            # The points of the mirror stay in their pixels: a camera that was elsewhere was turned as well.
            found.append(("places", np.array([_response(one, lean, step, camera, turn) for one, lean in lights])))
    for turn in principal_steps(camera.covariance_turn):
        values = [_response(one, lean, np.zeros(3), camera, turn) for one, lean in lights]
        found.append(("camera orientation", np.array(values)))
    pole = np.array([0.0, np.cos(np.radians(model.site.latitude_deg)), np.sin(np.radians(model.site.latitude_deg))])
    clock = _TURN_PER_S * model.evaluation.sigma_time_s
    if clock > 0:
        # All stars turn about the pole, and every facet's normal follows by half of it across the sight.
        values = [_clock(night, one, lean, clock * pole) for one, lean in lights]
        found.append(("clock", np.array(values)))
    return found


def _oriented_beside(measurement: StarsMeasurement, night: _Night, shift_m: FloatArray) -> OrientedCamera:
    """Return the camera as its points turn it where it stands beside its place by a shift in the mirror's frame."""
    beside = night.field_from_mirror.inverse()
    place = RigidTransform(beside.rotation, beside.translation_m + shift_m)
    return oriented(measurement.model.camera, measurement.folder, place, is_trial=True)


def _response(
    light: FacetLight, lean: Lean | None, shift_m: FloatArray, camera: OrientedCamera, turn: FloatArray
) -> FloatArray:
    """Return how lean and bows follow a camera that was elsewhere and whose sights turned, about its own axes."""
    if lean is None:
        return np.zeros(5)
    own = (camera.cam_from_mirror @ light.facet.ensemble_from_facet).rotation.T @ turn
    moved = replace(
        light,
        eye_m=light.eye_m + light.facet.ensemble_from_facet.rotation.T @ shift_m,
        sights=light.sights + np.cross(own, light.sights),
    )
    return linear_response(light, moved, lean, np.zeros((light.photo.size, 3)), _SKY_SIGMA_RAD)


def _clock(night: _Night, light: FacetLight, lean: Lean | None, turn: FloatArray) -> FloatArray:
    if lean is None:
        return np.zeros(5)
    own = (night.field_from_mirror @ light.facet.ensemble_from_facet).rotation.T @ turn
    return linear_response(light, light, lean, -np.cross(own, seen_directions(light, lean.values)), _SKY_SIGMA_RAD)


def _pointing(leans: Sequence[Lean | None], moved: Sequence[FloatArray]) -> Pointing:
    known = [n for n, one in enumerate(leans) if one is not None]
    each = [one for one in leans if one is not None]
    angle = np.mean([one.values[:2] for one in each], axis=0)
    random = np.sum([np.diag(one.covariance)[:2] for one in each], axis=0) / len(each) ** 2
    modes = np.array([values[known, :2].mean(axis=0) for values in moved]).reshape(-1, 2)
    return Pointing(np.asarray(angle), np.sqrt(random + (modes**2).sum(axis=0)), modes)


def _turned(slope_map: SlopeMap, pointing: Pointing) -> SlopeMap:
    """Return a map whose frame is turned by the mean lean; common sources lose what they do to that mean."""
    common = slope_map.common
    coefficients = common.coefficients.copy()
    if len(pointing.modes):
        coefficients[-len(pointing.modes) :, :, 0] -= pointing.modes
    return replace(
        slope_map,
        slope_x=slope_map.slope_x - pointing.angle_rad[0],
        slope_y=slope_map.slope_y - pointing.angle_rad[1],
        common=replace(common, coefficients=coefficients),
    )


def _doubts(night: _Night, leans: Sequence[Lean | None]) -> Iterator[Doubt]:
    unknown = [facet.name for facet, lean in zip(night.facets, leans, strict=True) if lean is None]
    if unknown:
        yield Doubt(
            "facets_without_stars",
            f"the stars in {len(unknown)} of {len(leans)} facets cannot be named ({', '.join(unknown[:5])}"
            f"{' ...' if len(unknown) > 5 else ''}): too few, or no hypothesis is a thousand times likelier; "
            "more photos over the night move other stars into them",
            {"facets_count": len(unknown)},
        )
    if night.left_out:
        yield Doubt(
            "points_beyond_catalogue",
            f"{night.left_out} points of light are more than the catalogue has stars in the facets: only the brightest "
            "of each facet count; dew, lamps, noise, or an exposure that shows stars fainter than faintest_magnitude",
            {"points_count": night.left_out},
        )
    strange = sum(int(np.count_nonzero(one.star < 0)) for one in leans if one is not None)
    if strange:
        yield Doubt(
            "points_without_star",
            f"{strange} points of light are no star of the catalogue (fainter, aircraft, hot pixels): left out",
            {"points_count": strange},
            Severity.NOTE,
        )
