"""Stars in facets from photos to canting: the stages follow each other in `run`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from deflectometry.field.placement import OrientedCamera
from deflectometry.frames.image_file_checks import check_size
from deflectometry.gazing.pipeline.inputs import oriented
from deflectometry.gazing.pipeline.result import Pointing, pointing_line
from deflectometry.pipeline.choices import Options
from deflectometry.pipeline.headline import (
    Numbers,
    canting_numbers,
    facet_numbers,
    headline_text,
    numbers_of_maps,
    reasons,
)
from deflectometry.pipeline.inputs import build_facets
from deflectometry.pipeline.result import write_canting
from deflectometry.shape.assemble import assemble_maps
from deflectometry.shape.facet_canting import CANTING_SIGN, FacetCanting, doubt_of_canting
from deflectometry.shape.smooth_shape import Align
from deflectometry.stars.facet_stars import (
    FacetLight,
    Lean,
    identify,
    sky_area,
)
from deflectometry.stars.keys import StarsMeasurement
from deflectometry.stars.pipeline.catalogue import read_catalogue
from deflectometry.stars.pipeline.night import (
    SKY_SIGMA_RAD,
    TURN_PER_S,
    Night,
    chance_of_points,
    first_orientation,
    is_sure,
    light_of,
    named,
    region_of,
    section_priors,
    site_of,
    sky_of,
    slopes_of_night,
    stars_of_night,
    stated_frame,
)
from deflectometry.stars.sky import Catalogue
from deflectometry.stars.spots import Spots, find_spots
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.sun import sun_angles, utc_times
from heliogauge.geometry.surfaces import Facet
from heliogauge.images.photos import read_frames
from heliogauge.results.facet_frames import facet_geometry
from heliogauge.results.folder import Summary, hash_files, write_slope_map, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import ASSEMBLED
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal, remove
from heliogauge.validate import FloatArray

#: Table of the points of light.
STARS_FILE = "stars.csv"
#: Facets of which so many agree on the mirror's lean determine it.
_FEWEST_FACETS = 1
#: With the sun higher than this no photo shows stars.
_DAY_RAD = np.radians(-3.0)
#: Facets on which other hours are tried.
_TRIED, _TRIED_POINTS = 3, 8
#: A lean beyond so many of its own sigmas is none of its scatter: 1 of 270,000 in two directions.
_SURE_POINTING = 5.0
#: The same chance for points that miss.
_CHANCE_OF_POINTS = 1 / 270_000
#: A lean beyond so many sigmas of the stated normal contradicts it: 1 of 1,000 in two directions.
_BEYOND_STATED = 3.72
#: A count of stars is exceeded by chance by less than so many standard deviations.
_CHANCE_SIGMAS = 5.0


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
            "pointing": "mean slope error against mirror.normal, before alignment",
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
            geometry_m=facet_geometry(self.facets),
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
        return f"{headline_text(self.summarise())}\n{pointing_line(self.numbers)}"


def _stars_of(light: FacetLight, lean: Lean | None) -> Iterator[tuple[str, float, float]]:
    for n in range(light.photo.size):
        if lean is None:
            yield "", np.nan, np.nan
        else:
            yield (str(lean.star[n]) if lean.star[n] >= 0 else ""), float(lean.residual[n]), lean.probability


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
        stated = stated_frame(measurement)
        camera = first_orientation(measurement, stated)
        spots = _spots(measurement, facets, camera)
        night = _night(measurement, catalogue, facets, spots, stated, camera)
    with progress.stage("name stars"):
        leans = named(night, section_priors(measurement), 0.0)
        known = [one for one in leans if one is not None]
        if len(known) < max(_FEWEST_FACETS, 0.3 * sum(one.photo.size > 0 for one in night.lights)):
            _refuse(night, section_priors(measurement), leans)
        if options.strict and len(known) < len(night.facets):
            raise EstimationError(f"{len(night.facets) - len(known)} facets without known stars, with --strict")
        # The points that turn the camera lean with the mirror.
        turn = _mirror_turn(facets, leans)
        camera = oriented(model.camera, measurement.folder, (stated @ turn).inverse())
        night = _night(measurement, catalogue, facets, spots, stated @ turn, camera)
        own = named(night, section_priors(measurement), 0.0)
        leans = [
            None if one is None else _against_stated(one, facet, turn) for one, facet in zip(own, facets, strict=True)
        ]
        known = [one for one in leans if one is not None]
    with progress.stage("maps"):
        align = options.align or Align(section.align)
        step_mm = options.grid_step_mm or section.grid_step_mm
        slopes = slopes_of_night(measurement, night, camera, own, leans, align, step_mm)
    with progress.stage("statistics"):
        removal = options.remove or Removal(section.remove)
        maps = {name: remove(one, removal) for name, one in slopes.maps.items()}
        several = len(night.facets) > 1
        cantings = slopes.cantings
        assembled = assemble_maps(night.facets, maps, align, removal)
        whole = assemble_maps(night.facets, slopes.maps, align, Removal.NOTHING)
        numbers = facet_numbers(assembled, whole) | canting_numbers(cantings) | slopes.pointing.numbers()
        numbers = _without_curl(numbers)
        numbers["stars_count"] = sum(int(np.count_nonzero(one.star >= 0)) for one in known)
    return StarsResult(
        name=model.name,
        facets=night.facets,
        maps=maps,
        assembled=assembled,
        numbers=numbers,
        facet_numbers={name: _without_curl(one) for name, one in numbers_of_maps(maps, slopes.maps, cantings).items()}
        if several
        else {},
        cantings=cantings,
        lights=night.lights,
        leans=tuple(leans),
        doubts=gather_doubts(
            doubt_of_canting(cantings) if several else None,
            _doubt_of_pointing(measurement, night, camera, slopes.pointing),
            *_doubts(night, leans),
        ),
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(measurement.input_files, measurement.folder),
    )


def _without_curl(numbers: Numbers) -> Numbers:
    """Leave out the curl: lean, curvatures and twist are a surface's by themselves, so that it tests nothing."""
    return {name: one for name, one in numbers.items() if not name.startswith("curl_")}


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


def _spots(measurement: StarsMeasurement, facets: Sequence[Facet], camera: OrientedCamera) -> list[list[Spots]]:
    """Return the points of light of each facet in each photo."""
    frames = read_frames([measurement.folder / one.file for one in measurement.model.photo])
    check_size(frames.images_dn.shape[:0:-1], camera.camera, "photo.file")
    spots = []
    for facet in facets:
        region = region_of(camera, facet, frames.images_dn.shape[1:])
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
) -> Night:
    """Return what is known before stars are named.

    frame, camera: Where the mirror's frame stands in the field, and the camera before it.
    """
    model = measurement.model
    lights = [light_of(camera, facet, found) for facet, found in zip(facets, spots, strict=True)]
    found_count = sum(one.photo.size for one in lights)
    lights = [_brightest(one, len(model.photo), catalogue) for one in lights]
    if not sum(one.photo.size for one in lights):
        raise EstimationError(
            "no point of light in any facet: the exposure is too short, the lens is not at infinity, or the facets "
            "show no sky"
        )
    begin = utc_times([one.time for one in model.photo])
    half = np.array([500 * one.exposure_s for one in model.photo]).astype("timedelta64[ms]")
    night = Night(
        tuple(facets),
        tuple(lights),
        frame,
        tuple(begin + half),
        site_of(measurement),
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


def _with_zero_point(night: Night) -> Night:
    """Turn light into magnitudes: as many points as the facets show are the brightest stars of so much sky.

    The whole sky over the horizon has the same stars per solid angle within a factor of two: 0.7 magnitudes.
    """
    above = stars_of_night(night, 0.0)
    area = sum(sky_area(one) for one in night.lights) * len(night.times)
    magnitudes = np.sort(np.concatenate([one.magnitude for one in above]))
    density = len(magnitudes) / (2 * np.pi * (1 - np.sin(np.radians(10.0))) * len(above))
    found = np.sort(np.concatenate([one.magnitude for one in night.lights]))
    share = min(found.size / max(area * density, 1e-9), 1.0)
    typical = float(np.median(magnitudes[: max(int(share * magnitudes.size), 1)]))
    zero = typical - float(np.median(found))
    return replace(night, lights=tuple(replace(one, magnitude=one.magnitude + zero) for one in night.lights))


def _fits(night: Night, priors: tuple[FloatArray, FloatArray], hours: float, sure: int) -> bool:
    """Return whether the sky of so many hours later names the stars of many more facets.

    Three facets with the most points are tried first: where none of them has a sure name, half of all have not.
    """
    shift = np.timedelta64(int(hours * 3_600_000), "ms")
    if (sun_angles([one + shift for one in night.times], night.site)[1] > _DAY_RAD).any():
        return False
    most = sorted(night.lights, key=lambda one: -one.photo.size)[:_TRIED]
    most = [one.chosen(np.argsort(one.magnitude)[:_TRIED_POINTS]) for one in most]
    above = stars_of_night(night, hours)
    tried = [identify(one, sky_of(night, one.facet, above), np.zeros(5), priors[0], SKY_SIGMA_RAD) for one in most]
    if not any(is_sure(one) for one in tried):
        return False
    known = sum(one is not None for one in named(night, priors, hours))
    return known > max(2 * sure, 0.5 * len(night.facets))


def _refuse(night: Night, priors: tuple[FloatArray, FloatArray], leans: Sequence[Lean | None]) -> None:
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
        "faintest_magnitude, and that the camera looks where it did when its points were measured"
    )


def _doubt_of_pointing(
    measurement: StarsMeasurement, night: Night, camera: OrientedCamera, pointing: Pointing
) -> Doubt | None:
    """Say what else than the mirror leans all facets alike: time, date, the camera's place."""
    lean = float(np.hypot(*pointing.angle_rad))
    stated = 1e-3 * measurement.model.evaluation.sigma_normal_mrad
    sigmas = lean / stated
    square, freedom, chance = chance_of_points(measurement, night, camera)
    numbers: dict[str, float | int] = {"lean_rad": lean, "lean_in_sigmas_ratio": sigmas, "points_chi_square": square}
    # A normal turns by half of what the sky does, and by half the angle of the camera's shift.
    shift_m = 2 * lean * float(np.linalg.norm(camera.eye_m))
    leaning = (
        f"{1e3 * lean:.3g} mrad against mirror.normal ({sigmas:.2g} of sigma_normal_mrad = {1e3 * stated:.3g}), as a "
        f"time that is {2 * lean / TURN_PER_S:.0f} s off does (a date one day off: 236 s of stars) or a camera that "
        f"stood {shift_m:.2g} m aside"
    )
    if freedom and chance < _CHANCE_OF_POINTS:
        return Doubt(
            "points_contradict_stars",
            f"the mirror's points in the photos miss by chi-square {square:.0f} of {freedom} where the stars say that "
            f"it leans: {leaning}; check date and time of the photos, site, place_m of camera and mirror, and the "
            "points with their sigma_px: canting is wrong with them",
            numbers,
            Severity.SERIOUS,
        )
    if not np.hypot(*(pointing.angle_rad / pointing.sigma_rad)) > _SURE_POINTING:
        return None
    return Doubt(
        "stars_off_stated_normal",
        f"the mean normal leans by {leaning}; the mirror's points in the photos do not contradict it",
        numbers,
        Severity.DOUBT if sigmas > _BEYOND_STATED else Severity.NOTE,
    )


def _doubts(night: Night, leans: Sequence[Lean | None]) -> Iterator[Doubt]:
    unknown = [facet.name for facet, lean in zip(night.facets, leans, strict=True) if lean is None]
    if unknown:
        yield Doubt(
            "facets_without_stars",
            f"the stars in {len(unknown)} of {len(leans)} facets cannot be named ({', '.join(unknown[:5])}"
            f"{' ...' if len(unknown) > 5 else ''}): too few, or no hypothesis is a thousand times likelier; "
            "more photos over the night move other stars into them. Where the camera or the mirror has turned since "
            "the points of the camera were measured, leans are wrong by as much in those that were named, too",
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
