"""What a photo at one time of the night will show, and what measuring it will say."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deflectometry.field.placement import OrientedCamera
from deflectometry.gazing.pipeline.inputs import oriented
from deflectometry.shape.smooth_shape import Align
from deflectometry.stars.keys import StarsMeasurement
from deflectometry.stars.pipeline.night import (
    Night,
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
from deflectometry.stars.spots import FLOOR_PX, Spots
from deflectometry.stars.star_images import star_images
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.sun import sun_angles
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Step of maps of which only the means are used: as many nodes a facet.
_NODES = 8


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPhoto:
    """What one photo of a mirror of known lean gives.

    stars (f,): How many stars of the catalogue each facet shows.
    sigma_canting_rad (f, 2): In x and y of each facet; NaN where its stars cannot be named. Of a mirror of one facet,
        that of its lean.
    sigma_pointing_rad (2,): Of the mirror's lean; NaN where no facet is determined.
    """

    stars: IntArray
    sigma_canting_rad: FloatArray
    sigma_pointing_rad: FloatArray

    @property
    def is_known(self) -> BoolArray:
        """Which facets are determined, shape (f,)."""
        return np.asarray(np.isfinite(self.sigma_canting_rad).all(axis=1))

    @property
    def unknown(self) -> int:
        """How many facets are not."""
        return int(np.count_nonzero(~self.is_known))

    @property
    def sigma_rms_rad(self) -> float:
        """RMS over both axes of all facets that are determined; NaN where none is."""
        known = self.sigma_canting_rad[self.is_known]
        return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class PlannedTime(PlannedPhoto):
    """What one time of the night gives, of the mirror as stated.

    time: Begin of the exposure in UTC. sun_elevation_rad: Of the sun's centre.
    leaning: Of mirrors that lean by one sigma of their normal, up, down, left and right: they show other stars.
    """

    time: np.datetime64
    sun_elevation_rad: float
    leaning: tuple[PlannedPhoto, ...]

    @property
    def unknown_mean(self) -> float:
        """How many facets stay unknown, mean over the leans that the mirror may have."""
        return float(np.mean([one.unknown for one in (self, *self.leaning)]))

    @property
    def sigma_range_rad(self) -> tuple[float, float]:
        """Smallest and largest of `sigma_rms_rad` over the leans that the mirror may have; NaN where none is known."""
        each = [one.sigma_rms_rad for one in (self, *self.leaning)]
        known = [one for one in each if np.isfinite(one)]
        return (min(known), max(known)) if known else (float("nan"), float("nan"))


def predicted_time(
    measurement: StarsMeasurement, catalogue: Catalogue, facets: Sequence[Facet], time: np.datetime64
) -> PlannedTime:
    """Adjust the images that the catalogue's stars will have in facets as designed."""
    lean = 1e-3 * measurement.model.evaluation.sigma_normal_mrad
    turns = lean * np.array([[0.0, 0.0, 0.0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    stated, *leaning = (_leaning(measurement, catalogue, facets, time, turn) for turn in turns)
    return PlannedTime(
        stated.stars,
        stated.sigma_canting_rad,
        stated.sigma_pointing_rad,
        time,
        float(sun_angles([time], site_of(measurement))[1][0]),
        tuple(leaning),
    )


def _leaning(
    measurement: StarsMeasurement,
    catalogue: Catalogue,
    facets: Sequence[Facet],
    time: np.datetime64,
    turn: FloatArray,
) -> PlannedPhoto:
    frame = stated_frame(measurement) @ RigidTransform.from_rotation_vector(turn, np.zeros(3))
    # Its corners lean with the mirror, so that the camera is known as well as by corners that fit.
    camera = oriented(measurement.model.camera, measurement.folder, frame.inverse(), is_trial=True)
    half = np.timedelta64(int(500 * measurement.model.photo[0].exposure_s), "ms")
    site = site_of(measurement)
    night = _predicted(measurement, camera, Night(tuple(facets), (), frame, (time + half,), site, catalogue, 0))
    leans = named(night, section_priors(measurement), 0.0)
    sigma, pointing = np.full((len(facets), 2), np.nan), np.full(2, np.nan)
    if any(one is not None for one in leans):
        step_mm = 1e3 * float(np.mean([np.ptp(one.outline_m, axis=0).max() for one in facets])) / _NODES
        align = Align(measurement.model.evaluation.align)
        slopes = slopes_of_night(measurement, night, camera, leans, leans, align, step_mm)
        pointing = slopes.pointing.sigma_rad
        if len(facets) == 1:
            sigma[0] = pointing
        for n, one in enumerate(slopes.cantings):
            if one.canting is not None:
                sigma[n] = np.sqrt(np.diag(one.canting.covariance_components_rad2))
    return PlannedPhoto(np.array([one.photo.size for one in night.lights]), sigma, pointing)


def _predicted(measurement: StarsMeasurement, camera: OrientedCamera, night: Night) -> Night:
    """Return the night with the points of light that the facets will show."""
    section, lights = measurement.model, []
    (above,) = stars_of_night(night, 0.0)
    for facet in night.facets:
        sky = sky_of(night, facet, [above])
        empty = light_of(camera, facet, [Spots(np.zeros((0, 2)), np.zeros(0), np.zeros(0))])
        which, points_m = star_images(empty, sky.directions[0])
        places = camera.camera.project((camera.cam_from_mirror @ facet.ensemble_from_facet).apply(points_m))
        shape = (camera.camera.height_px, camera.camera.width_px)
        column, row = np.rint(places).astype(np.intp).T
        inside = (column >= 0) & (row >= 0) & (column < shape[1]) & (row < shape[0])
        inside[inside] = region_of(camera, facet, shape)[row[inside], column[inside]]
        magnitude = above.magnitude[which][inside]
        # Of stars that are all brighter than the faintest, noise of their own light is the part that is left.
        fainter = 10 ** (0.2 * (magnitude - section.evaluation.faintest_magnitude))
        sigma = np.hypot(section.plan.sigma_faintest_px * np.minimum(fainter, 1.0), FLOOR_PX)
        lights.append(light_of(camera, facet, [Spots(places[inside], sigma, 10 ** (-0.4 * magnitude))]))
    return Night(
        night.facets, tuple(lights), night.field_from_mirror, night.times, night.site, night.catalogue, night.left_out
    )
