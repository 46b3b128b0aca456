"""Targets, dots and cameras of a planned screen, and the image points that its photos will show."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deflectometry.dots.found_dots import FoundDots
from deflectometry.screen_geometry.pipeline.network import Seen
from deflectometry.screen_geometry.planning.keys import ScreenPlanSection
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform, looking_at
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry import ImagePoints
from photogrammetry.pipeline import MeasuredPhotos

#: Markers around a screen where none are listed: on its sides, and how far beyond its edges in shares of its size.
_ACROSS, _UP, _BEYOND = 5, 4, 0.1
#: Places where none are stated: angles from the front, and round it [deg].
_DEFAULT_PLACES = (*((40.0, 30.0 + 60.0 * k) for k in range(6)), (15.0, 0.0), (15.0, 180.0))
#: Beyond the outermost targets this share of the image stays free.
_MARGIN = 0.05
#: What is seen more obliquely, or is smaller in the image, is not measured, as in photogrammetry's plans; of a square
#: marker each of six cells needs two pixels to be read, and dots are half as large as they are apart.
_LARGEST_INCIDENCE_RAD = np.radians(65.0)
_LEAST_PX, _LEAST_MARKER_PX = 6.0, 12.0
#: More dots each way add nothing to what they share, which is what a plan is about.
_MOST_DOTS = 24
#: The predicted dots have the noise of this draw: their sigma is weighed against that of targets by residuals.
_SEED = 1


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPhoto:
    """A photo: its name, its camera and its pose."""

    name: str
    camera: Camera
    cam_from_screen: RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class PlannedSurface:
    """The screen as planned.

    plan: Its size and form.
    targets: Fractions u, v of each coded target, or of a marker's middle.
    has_markers: Whether targets are square markers.
    has_dots: Whether it shows a field of dots.
    """

    plan: ScreenPlanSection
    targets: Mapping[str, tuple[float, float]]
    has_markers: bool
    has_dots: bool

    def point_m(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return points of its surface, shape (..., 3) [m]."""
        z = 1e-3 * self.plan.sag_mm * ((2 * x_m / self.plan.width_m) ** 2 - 1 / 3)
        return np.stack(np.broadcast_arrays(x_m, y_m, z), axis=-1)

    def places_m(self) -> dict[str, FloatArray]:
        """Return the places of all that photos may name: targets, and corners of markers, each (3,) [m]."""
        half = 0.5e-3 * self.plan.target_mm
        # From the upper left corner clockwise, as markers are read.
        corners = half * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
        found = {}
        for name, (u, v) in self.targets.items():
            x, y = (u - 0.5) * self.plan.width_m, (0.5 - v) * self.plan.height_m
            if self.has_markers and "." not in name:
                for k, (dx, dy) in enumerate(corners):
                    found[f"{name}.{k}"] = self.point_m(x + dx, y + dy)
            else:
                found[name] = self.point_m(np.array(x), np.array(y))
        return found

    def dots(self) -> tuple[FloatArray, IntArray]:
        """Return the dots that take part, (n, 3) [m], and their columns and rows downwards (n, 2)."""
        plan = self.plan
        step = int(np.ceil(max(plan.columns, plan.rows) / _MOST_DOTS))
        columns, rows = (int(np.ceil((count - 1) / step)) + 1 for count in (plan.columns, plan.rows))
        column, row = (one.ravel() for one in np.meshgrid(np.arange(columns), np.arange(rows)))
        x, y = (column / (columns - 1) - 0.5) * plan.width_m, (0.5 - row / (rows - 1)) * plan.height_m
        return self.point_m(x, y), np.stack([column, row], axis=1)


def targets_around(height_per_width: float) -> dict[str, tuple[float, float]]:
    """Return names and fractions u, v of markers around a screen, from its lower left corner to the right."""
    beyond_u, beyond_v = _BEYOND, _BEYOND / height_per_width
    u, v = np.linspace(-beyond_u, 1 + beyond_u, _ACROSS), np.linspace(1 + beyond_v, -beyond_v, _UP)
    around = [(one, v[0]) for one in u] + [(u[-1], one) for one in v[1:-1]]
    around += [(one, v[-1]) for one in u[::-1]] + [(u[0], one) for one in v[-2:0:-1]]
    return {str(k): (float(one), float(two)) for k, (one, two) in enumerate(around)}


def twice_as_many(targets: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Return targets with one more between each two that are neighbours around the screen's middle."""
    places = np.array(list(targets.values()))
    order = np.argsort(np.arctan2(places[:, 1] - 0.5, places[:, 0] - 0.5))
    between = 0.5 * (places[order] + places[np.roll(order, -1)])
    taken = [int(name) for name in targets if name.isdecimal()]
    first = max(taken, default=-1) + 1
    return dict(targets) | {str(first + k): (float(u), float(v)) for k, (u, v) in enumerate(between)}


def default_places(surface: PlannedSurface, camera: Camera) -> FloatArray:
    """Return eight places from which all targets are just in the image, shape (8, 3) [m]."""
    points = np.array(list(surface.places_m().values()))
    radius = float(np.linalg.norm(points[:, :2], axis=1).max())
    half_px = (0.5 - _MARGIN) * min(camera.width_px, camera.height_px)
    found = []
    for away, around in np.radians(_DEFAULT_PLACES):
        # What stands obliquely is nearer on one side.
        distance = radius * (camera.focal_y_px / half_px + np.sin(away))
        across = np.sin(away) * np.array([np.cos(around), np.sin(around)])
        found.append(distance * np.array([*across, np.cos(away)]))
    return np.array(found)


def pose_at(place_m: Sequence[float], *, turned: bool) -> RigidTransform:
    """Return the pose of a camera that looks at the screen's middle, upright or turned by 90 degrees."""
    return looking_at(np.array(place_m, dtype=np.float64), np.zeros(3), np.array([0.0, 1.0, 0.0]), np.pi / 2 * turned)


def predicted(surface: PlannedSurface, photos: Sequence[PlannedPhoto]) -> Seen:
    """Return what the photos will show, in the form in which measuring hands it on."""
    plan, rng = surface.plan, np.random.default_rng(_SEED)
    known = surface.places_m()
    names, points = list(known), np.array(list(known.values()))
    places, numbers = surface.dots()
    photo_names: list[str] = []
    target_names: list[str] = []
    pixels: list[FloatArray] = []
    dots = {}
    for photo in photos:
        shown, seen = _shown(
            photo, points, 1e-3 * plan.target_mm, _LEAST_MARKER_PX if surface.has_markers else _LEAST_PX
        )
        if surface.has_markers:
            # A marker of which a corner is missing is not read.
            shown = np.array([all(shown[names.index(one)] for one in _marker(name, names)) for name in names])
        photo_names += [photo.name] * int(shown.sum())
        target_names += [name for name, is_shown in zip(names, shown.tolist(), strict=True) if is_shown]
        noise = plan.sigma_target_px * rng.standard_normal(seen.shape) if surface.has_dots else np.zeros(seen.shape)
        pixels.append((seen + noise)[shown])
        if surface.has_dots:
            pitch_m = min(plan.width_m / (plan.columns - 1), plan.height_m / (plan.rows - 1))
            chosen, centers = _shown(photo, places, pitch_m, _LEAST_PX)
            count = int(chosen.sum())
            if count:
                dots[photo.name] = FoundDots(
                    centers[chosen] + plan.sigma_dot_px * rng.standard_normal((count, 2)),
                    np.tile(plan.sigma_dot_px**2 * np.eye(2), (count, 1, 1)),
                    numbers[chosen],
                    np.full(count, 100.0),
                    1.0,
                )
    covariance = np.tile(plan.sigma_target_px**2 * np.eye(2), (len(target_names), 1, 1))
    table = ImagePoints.from_names(photo_names, target_names, np.concatenate(pixels), covariance)
    sizes = {one.name: (one.camera.width_px, one.camera.height_px) for one in photos}
    shapes = np.full((table.n, 2, 2), np.nan)
    return Seen(MeasuredPhotos(table, shapes, sizes, (), (), sigma_assumed=False), dots, {}, ())


def _marker(name: str, names: Sequence[str]) -> list[str]:
    """Return all corners of the marker that a corner belongs to, as far as they are listed."""
    number = name.partition(".")[0]
    return [one for k in range(4) if (one := f"{number}.{k}") in names] or [name]


def _shown(photo: PlannedPhoto, points_m: FloatArray, size_m: float, least_px: float) -> tuple[BoolArray, FloatArray]:
    """Return which points (n, 3) are in the image and can be measured there, and where they are (n, 2) [px].

    size_m, least_px: Of what is measured, and the least that it must have in the image where it is foreshortened.
    """
    camera = photo.camera
    pixels = camera.project(photo.cam_from_screen.apply(points_m))
    size = np.array([camera.width_px, camera.height_px])
    margin = 0.2 * _MARGIN * size
    with np.errstate(invalid="ignore"):
        inside = ((pixels > margin) & (pixels < size - 1 - margin)).all(axis=1)
    arms = photo.cam_from_screen.inverse().translation_m - points_m
    distance = np.linalg.norm(arms, axis=1)
    cosine = arms[:, 2] / distance
    large = size_m * camera.focal_y_px / distance * cosine >= least_px
    return np.asarray(inside & large & (cosine >= np.cos(_LARGEST_INCIDENCE_RAD))), pixels
