"""One night's stars and facets: what is known before, names of stars, and what is common to all slopes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deflectometry.field.placement import OrientedCamera, field_from_mirror
from deflectometry.gazing.pipeline.inputs import oriented
from deflectometry.gazing.pipeline.result import Pointing
from deflectometry.pipeline.inputs import build_mounts
from deflectometry.setup.setup_steps import principal_steps
from deflectometry.shape.facet_canting import FacetCanting, canting_of_facets
from deflectometry.shape.smooth_shape import Align, alignment_words
from deflectometry.stars.facet_maps import lean_map
from deflectometry.stars.facet_stars import (
    FacetLight,
    Lean,
    SkyOfFacet,
    identify,
    linear_response,
    seen_directions,
)
from deflectometry.stars.keys import StarsMeasurement
from deflectometry.stars.sky import Catalogue, StarsAbove, stars_above
from deflectometry.stars.spots import RIM_PX, Spots
from heliogauge.geometry.rigid import RigidTransform, vector_from_rotation
from heliogauge.geometry.sun import Site
from heliogauge.geometry.surfaces import Facet
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import BoolArray, FloatArray

#: A hypothesis counts where the odds against it are below one in a thousand.
_SURE = 0.999
#: A star's place beside what refraction and the clock move alike [rad].
SKY_SIGMA_RAD = 1e-5
#: The sky turns by so much in a second of time [rad].
TURN_PER_S = 7.292e-5
#: Nodes of a map along a facet.
_NODES = 40


@dataclass(frozen=True, slots=True, eq=False)
class Night:
    """What is known before stars are named: facets, points of light, photos' middles, site."""

    facets: tuple[Facet, ...]
    lights: tuple[FacetLight, ...]
    field_from_mirror: RigidTransform
    times: tuple[np.datetime64, ...]
    site: Site
    catalogue: Catalogue
    left_out: int


def site_of(measurement: StarsMeasurement) -> Site:
    """Return where on earth it is."""
    section = measurement.model.site
    return Site(
        section.latitude_deg, section.longitude_deg, section.altitude_m, section.pressure_hpa, section.temperature_c
    )


def section_priors(measurement: StarsMeasurement) -> tuple[FloatArray, FloatArray]:
    """Return standard deviations of the five numbers: before the mirror's lean is known, and of facets against it."""
    section = measurement.model.evaluation
    bow = 1e-3 * section.sigma_bow_mrad_per_m
    single = 1e-3 * section.sigma_canting_mrad
    wide = float(np.hypot(1e-3 * section.sigma_normal_mrad, single))
    return np.array([wide, wide, bow, bow, bow]), np.array([single, single, bow, bow, bow])


def stated_frame(measurement: StarsMeasurement) -> RigidTransform:
    """Return where the mirror's frame stands by its stated normal."""
    normal = np.asarray(measurement.model.mirror.normal, dtype=np.float64)
    return field_from_mirror(np.asarray(measurement.model.mirror.place_m), normal / np.linalg.norm(normal))


def first_orientation(measurement: StarsMeasurement, stated: RigidTransform) -> OrientedCamera:
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


def region_of(camera: OrientedCamera, facet: Facet, shape: tuple[int, ...]) -> BoolArray:
    """Return the pixels in which a facet shows whole stars, of an image of a shape."""
    import cv2

    corners = camera.camera.project((camera.cam_from_mirror @ facet.ensemble_from_facet).apply(facet.corners_m))
    mask = np.zeros(shape, dtype=np.uint8)
    cv2.fillPoly(mask, [np.rint(corners).astype(np.int32)], 1)
    return np.asarray(cv2.erode(mask, np.ones((2 * RIM_PX + 1,) * 2, np.uint8)) > 0)


def light_of(camera: OrientedCamera, facet: Facet, found: Sequence[Spots]) -> FacetLight:
    """Return the points of light of each photo as the facet reflects them."""
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


def sky_of(night: Night, facet: Facet, above: Sequence[StarsAbove]) -> SkyOfFacet:
    """Return the stars in a facet's frame."""
    facet_from_field = (night.field_from_mirror @ facet.ensemble_from_facet).rotation.T
    return SkyOfFacet(
        [one.directions @ facet_from_field.T for one in above],
        [one.magnitude for one in above],
        [one.number for one in above],
    )


def stars_of_night(night: Night, hours: float) -> list[StarsAbove]:
    """Return the stars above the horizon in each photo, so many hours later."""
    shift = np.timedelta64(int(hours * 3_600_000), "ms")
    return [stars_above(night.catalogue, one + shift, night.site) for one in night.times]


def named(night: Night, priors: tuple[FloatArray, FloatArray], hours: float) -> list[Lean | None]:
    """Name the stars of all facets: first each by itself, then around the lean that they have in common."""
    above = stars_of_night(night, hours)
    skies = [sky_of(night, one, above) for one in night.facets]
    alone = [
        identify(light, sky, np.zeros(5), priors[0], SKY_SIGMA_RAD) if light.photo.size else None
        for light, sky in zip(night.lights, skies, strict=True)
    ]
    sure = [one for one in alone if is_sure(one)]
    if not sure:
        return [None] * len(alone)
    middle = np.append(np.median([one.values[:2] for one in sure if one is not None], axis=0), np.zeros(3))
    again = [
        identify(light, sky, middle, priors[1], SKY_SIGMA_RAD) if light.photo.size else None
        for light, sky in zip(night.lights, skies, strict=True)
    ]
    return [one if is_sure(one) else None for one in again]


def is_sure(one: Lean | None) -> bool:
    """Return whether the stars of a facet are known."""
    return one is not None and one.probability > _SURE and int(np.count_nonzero(one.star >= 0)) >= 1


@dataclass(frozen=True, slots=True, eq=False)
class NightSlopes:
    """What the leans of all facets make: maps with nothing removed, canting of each facet, the mirror's own lean."""

    maps: Mapping[str, SlopeMap]
    cantings: tuple[FacetCanting, ...]
    pointing: Pointing


def slopes_of_night(
    measurement: StarsMeasurement,
    night: Night,
    camera: OrientedCamera,
    own: Sequence[Lean | None],
    leans: Sequence[Lean | None],
    align: Align,
    step_mm: float | None,
) -> NightSlopes:
    """Return maps, canting and the mirror's lean with all that facets have in common.

    own, leans: Of each facet against the mirror's frame of the night, and against the stated one.
    step_mm: Step of the maps; None for 40 nodes a facet.
    """
    frame = "facet frame: x across, y up, seen from the front, z out of the mirror [m]"
    size = float(np.mean([np.ptp(one.outline_m, axis=0).max() for one in night.facets]))
    step_m = size / _NODES if step_mm is None else 1e-3 * step_mm
    moved = moved_leans(measurement, night, camera, own)
    shown = against_mean(leans) if align is Align.NORMAL else leans
    as_nominal = {
        facet.name: lean_map(
            facet,
            lean,
            [(source, values[n]) for source, values in moved],
            step_m,
            frame,
            alignment_words(align, len(night.facets)),
        )
        for n, (facet, lean) in enumerate(zip(night.facets, shown, strict=True))
        if lean is not None
    }
    pointing = _pointing(leans, [values for _, values in moved])
    maps = {name: _turned(one, pointing) for name, one in as_nominal.items()} if align is Align.NORMAL else as_nominal
    several = len(night.facets) > 1
    cantings = canting_of_facets(night.facets, maps, build_mounts(measurement.model.mirror)) if several else ()
    return NightSlopes(maps, cantings, pointing)


def against_mean(leans: Sequence[Lean | None]) -> list[Lean | None]:
    """Return leans with the covariance of their differences from the mean of all; their values stay.

    A facet whose lean is hardly known makes the mean, and with it the canting of every other one, less sure; its own
    lean is a part of the mean.
    """
    known = [one.covariance for one in leans if one is not None]
    rise = np.diag([1.0, 1.0, 0.0, 0.0, 0.0])
    mean = rise @ np.sum(known, axis=0) @ rise / max(len(known), 1) ** 2
    found: list[Lean | None] = []
    for one in leans:
        if one is None:
            found.append(None)
            continue
        shared = one.covariance @ rise / len(known)
        found.append(replace(one, covariance=one.covariance - shared - shared.T + mean))
    return found


def moved_leans(
    measurement: StarsMeasurement, night: Night, camera: OrientedCamera, leans: Sequence[Lean | None]
) -> list[tuple[str, FloatArray]]:
    """Return what one sigma of each common input does to lean and bows of each facet, shape (f, 5)."""
    model = measurement.model
    found: list[tuple[str, FloatArray]] = []
    shift = sigma_place_m(measurement)
    lights = list(zip(night.lights, leans, strict=True))
    if shift > 0:
        for step in shift * np.eye(3):
            elsewhere = oriented_beside(measurement, night, step)
            turn = -vector_from_rotation(elsewhere.cam_from_mirror.rotation @ camera.cam_from_mirror.rotation.T)
            # The points of the mirror stay in their pixels: a camera that was elsewhere was turned as well.
            found.append(("places", np.array([_response(one, lean, step, camera, turn) for one, lean in lights])))
    for turn in principal_steps(camera.covariance_turn):
        values = [_response(one, lean, np.zeros(3), camera, turn) for one, lean in lights]
        found.append(("camera orientation", np.array(values)))
    pole = np.array([0.0, np.cos(np.radians(model.site.latitude_deg)), np.sin(np.radians(model.site.latitude_deg))])
    clock = TURN_PER_S * model.evaluation.sigma_time_s
    if clock > 0:
        # All stars turn about the pole, and every facet's normal follows by half of it across the sight.
        values = [_clock(night, one, lean, clock * pole) for one, lean in lights]
        found.append(("clock", np.array(values)))
    return found


def sigma_place_m(measurement: StarsMeasurement) -> float:
    """Return how well the place of the camera against the mirror is known, each way [m]."""
    return 1e-3 * float(np.hypot(measurement.model.camera.sigma_place_mm, measurement.model.mirror.sigma_place_mm))


def chance_of_points(measurement: StarsMeasurement, night: Night, camera: OrientedCamera) -> tuple[float, int, float]:
    """Test the mirror's points in the photos against the lean by stars: chi-square, its freedom, chance of as much.

    camera: Turned to its points at that lean. How its place is uncertain widens what points may miss.
    """
    from scipy.stats import chi2

    missed = camera.residual_sigmas.ravel()
    steps = sigma_place_m(measurement) * np.eye(3)
    by_place = np.array([oriented_beside(measurement, night, one).residual_sigmas.ravel() for one in steps]) - missed
    square = float(missed @ np.linalg.solve(np.eye(missed.size) + by_place.T @ by_place, missed))
    freedom = missed.size - 3
    return square, freedom, float(chi2.sf(square, freedom))


def oriented_beside(measurement: StarsMeasurement, night: Night, shift_m: FloatArray) -> OrientedCamera:
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
    return linear_response(light, moved, lean, np.zeros((light.photo.size, 3)), SKY_SIGMA_RAD)


def _clock(night: Night, light: FacetLight, lean: Lean | None, turn: FloatArray) -> FloatArray:
    if lean is None:
        return np.zeros(5)
    own = (night.field_from_mirror @ light.facet.ensemble_from_facet).rotation.T @ turn
    return linear_response(light, light, lean, -np.cross(own, seen_directions(light, lean.values)), SKY_SIGMA_RAD)


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
