"""Stars in a heliostat at night: each star's light is traced from the sky to the pixel."""

from dataclasses import dataclass

import numpy as np

from data_synth.sky.gazing_scene import look_at
from data_synth.sky.heliostat import DrawnHeliostat
from data_synth.stars.celestial import apparent_places, over_place
from heliogauge.validate import FloatArray, IntArray

#: Hipparcos places are of this date.
_EPOCH_JD = 2448349.0625


def heliostat_at_night(seed: int) -> DrawnHeliostat:
    """Return six facets of 1.2 m that are canted for 150 m, with leans of 1.5 mrad and bows of 0.1 mrad/m."""
    rng = np.random.default_rng([seed, 10])
    tilts, bows = 1.5e-3 * rng.standard_normal((6, 2)), 1e-4 * rng.standard_normal((6, 3))
    return DrawnHeliostat(3, 2, 1.2, 1.2, 0.05, 300.0, 300.0, tilts, bows)


@dataclass(frozen=True, slots=True, eq=False)
class NightScene:
    """Heliostat, camera and night.

    times: Beginnings of the exposures, ISO 8601 in UTC. exposure_s: Of each.
    latitude_deg, longitude_deg, altitude_m: Site.
    distance_m: From the camera to the heliostat. eye_height_m: Of the camera over it.
    normal_up_deg: Elevation of the heliostat's normal. normal_error_rad: By what it departs from the stated one.
    width_px, height_px, focal_px: Of the camera. blur_px: Of the lens.
    zero_magnitude_dn: Light of a star of magnitude 0 in a second. sky_dn, noise_dn: Of each pixel.
    faintest: Faintest star that is drawn. seeing_rad: By what the air moves each star in each photo, each way.
    sigma_place_m, sigma_point_px: How well camera and corners are stated.
    """

    heliostat: DrawnHeliostat
    times: tuple[str, ...] = ("2026-03-14T21:30:00",)
    exposure_s: float = 2.0
    latitude_deg: float = 37.094
    longitude_deg: float = -2.358
    altitude_m: float = 500.0
    distance_m: float = 30.0
    eye_height_m: float = 6.0
    normal_up_deg: float = 35.0
    normal_error_rad: float = 5e-3
    width_px: int = 1900
    height_px: int = 1300
    focal_px: float = 12000.0
    blur_px: float = 1.2
    zero_magnitude_dn: float = 2.5e6
    sky_dn: float = 60.0
    noise_dn: float = 4.0
    faintest: float = 10.0
    seeing_rad: float = 1e-5
    sigma_place_m: float = 3e-3
    sigma_point_px: float = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class NightPlaces:
    """Where all is, the mirror at the origin: eye_m (3,) and camera_axes (3, 3), true mirror_axes (3, 3) as columns."""

    eye_m: FloatArray
    camera_axes: FloatArray
    stated_normal: FloatArray
    mirror_axes: FloatArray


def night_places(scene: NightScene, rng: np.random.Generator) -> NightPlaces:
    """Return the true places: the camera south of the heliostat, whose normal departs from the stated one."""
    eye = np.array([0.0, -scene.distance_m, scene.eye_height_m])
    up = np.radians(scene.normal_up_deg)
    stated = np.array([0.1, -np.cos(up), np.sin(up)])
    stated /= np.linalg.norm(stated)
    frame = mirror_axes(stated)
    lean = scene.normal_error_rad * rng.standard_normal(2)
    turned = frame @ np.array([-lean[0], -lean[1], 1.0])
    turned /= np.linalg.norm(turned)
    # A turn about an axis across both, so that the mirror does not roll.
    axis = np.cross(stated, turned)
    sine, cosine = float(np.linalg.norm(axis)), float(stated @ turned)
    unit = axis / max(sine, 1e-300)
    cross = np.array([[0, -unit[2], unit[1]], [unit[2], 0, -unit[0]], [-unit[1], unit[0], 0]])
    turn = np.eye(3) + sine * cross + (1 - cosine) * cross @ cross
    return NightPlaces(eye, look_at(eye, np.zeros(3)), stated, turn @ frame)


def mirror_axes(normal: FloatArray) -> FloatArray:
    """Return a level mirror's axes as columns: right and up seen from the front, out of it."""
    across = np.cross([0.0, 0.0, 1.0], normal)
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(normal, across), normal], axis=1)


def stars_over(scene: NightScene, catalogue: FloatArray, julian_date: float) -> tuple[FloatArray, FloatArray]:
    """Return directions (n, 3) and magnitudes (n,) of the stars above 12 degrees.

    catalogue (5, m): Right ascension, declination [rad], motions in both [rad/year], magnitude.
    """
    right, declination, motion_right, motion_up, magnitude = catalogue[:, catalogue[4] < scene.faintest]
    years = (julian_date - _EPOCH_JD) / 365.25
    of_date = apparent_places(right + years * motion_right, declination + years * motion_up, julian_date)
    pressure = 1013.25 * (1 - 2.25577e-5 * scene.altitude_m) ** 5.25588
    seen = over_place(of_date, julian_date, np.radians(scene.latitude_deg), np.radians(scene.longitude_deg), pressure)
    up = seen[:, 2] > np.sin(np.radians(12.0))
    return seen[up], magnitude[up]


def draw_photo(
    scene: NightScene, places: NightPlaces, catalogue: FloatArray, time: str, rng: np.random.Generator
) -> FloatArray:
    """Return one photo: the stars in the facets and those that are seen directly, shape (h, w) [DN]."""
    light = np.zeros((scene.height_px, scene.width_px))
    begin = np.datetime64(time, "ms")
    seeing = scene.seeing_rad * rng.standard_normal((2, catalogue.shape[1]))
    seen = catalogue.copy()
    seen[:2] += seeing / np.stack([np.cos(catalogue[1]), np.ones(catalogue.shape[1])])
    eye_mirror = places.eye_m @ places.mirror_axes
    steps = 6
    for step in range(steps):
        instant = begin + np.timedelta64(int(1000 * scene.exposure_s * (step + 0.5) / steps), "ms")
        julian = 2440587.5 + float(instant.astype(np.int64)) / 86_400_000
        stars, magnitude = stars_over(scene, seen, julian)
        flux = scene.zero_magnitude_dn * scene.exposure_s / steps * 10 ** (-0.4 * magnitude)
        for facet in range(scene.heliostat.count):
            shown, sights = _shown_by(scene, stars @ places.mirror_axes, eye_mirror, facet)
            _splat(scene, light, sights @ places.mirror_axes.T @ places.camera_axes, flux[shown] * 0.9)
    light += scene.sky_dn
    return np.asarray(
        light + np.sqrt(scene.noise_dn**2 + np.maximum(light, 0) * 0.3) * rng.standard_normal(light.shape)
    )


def _shown_by(scene: NightScene, stars: FloatArray, eye: FloatArray, facet: int) -> tuple[IntArray, FloatArray]:
    """Return which stars a facet shows, (k,), and the sights under which they are seen, (k, 3), in the mirror's frame.

    The point of the facet whose normal halves eye and star is found by Newton steps on the height above the facet.
    """
    helio = scene.heliostat
    axes, middle = helio.axes(facet), helio.place_m(facet)
    own_eye, own = (eye - middle) @ axes, stars @ axes
    a, b, c = helio.bows_per_m[facet]
    radius = helio.facet_radius_m
    # A corner shows what is aside of what the middle shows by the angle to it and twice its slope: doubled, to be sure.
    corner_m, away_m = 0.5 * np.hypot(helio.width_m, helio.height_m), np.linalg.norm(own_eye)
    aside = 2 * corner_m * (1 / away_m + 2 * (1 / radius + np.abs([a, b, c]).sum()))
    near = np.flatnonzero((own[:, 2] > 0) & (own @ (own_eye * [-1, -1, 1]) > np.cos(aside) * away_m))
    own = own[near]
    x, y = np.zeros(len(own)), np.zeros(len(own))
    for _ in range(25):
        bow = 0.5 * (a * x**2 + b * y**2) + c * x * y
        height = radius - np.sqrt(radius**2 - x**2 - y**2) + bow
        to_eye = own_eye - np.stack([x, y, height], axis=1)
        distance = np.linalg.norm(to_eye, axis=1)
        half = to_eye / distance[:, None] + own
        slope_x, slope_y = helio.slopes(facet, x, y)
        miss_x, miss_y = -half[:, 0] / half[:, 2] - slope_x, -half[:, 1] / half[:, 2] - slope_y
        # The halved direction follows the point by 1 / (2 distance cos), the slope by its curvature.
        gain = 1 / np.maximum(1 / (distance * half[:, 2]) - 1 / radius, 1e-6)
        x, y = np.clip(x - gain * miss_x, -60, 60), np.clip(y - gain * miss_y, -60, 60)
    shown = (np.abs(x) <= 0.5 * helio.width_m) & (np.abs(y) <= 0.5 * helio.height_m)
    shown &= np.hypot(miss_x, miss_y) < 1e-7
    return near[shown], -to_eye[shown] @ axes.T


def _splat(scene: NightScene, light: FloatArray, sights: FloatArray, flux: FloatArray) -> None:
    """Add blurred stars at where sights in the camera's frame (n, 3) meet the image."""
    if not len(sights):
        return
    column = 0.5 * (scene.width_px - 1) + scene.focal_px * sights[:, 0] / sights[:, 2]
    row = 0.5 * (scene.height_px - 1) + scene.focal_px * sights[:, 1] / sights[:, 2]
    reach = 7
    for x, y, amount in zip(column.tolist(), row.tolist(), flux.tolist(), strict=True):
        left, top = round(x) - reach, round(y) - reach
        if left < 0 or top < 0 or left + 2 * reach >= scene.width_px or top + 2 * reach >= scene.height_px:
            continue
        along = np.arange(2 * reach + 1)
        spread_x = np.exp(-0.5 * ((along + left - x) / scene.blur_px) ** 2)
        spread_y = np.exp(-0.5 * ((along + top - y) / scene.blur_px) ** 2)
        norm = amount / (2 * np.pi * scene.blur_px**2)
        light[top : top + 2 * reach + 1, left : left + 2 * reach + 1] += norm * np.outer(spread_y, spread_x)
