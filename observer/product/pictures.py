"""Pictures that a report needs the pixels for: slices of the mirror through all photos, and one photo with outlines."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import Float32Array, FloatArray
from observer.photo_edges.views import AnyImage, Shot
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.observation_equation import Sights, misfit

#: Slices along the trough, and samples across it.
_SLICES = 5
_COLUMNS = 641
#: So many of these are projected, evenly; between them linearly: on a mirror of 5 m within 0.02 px.
_PROJECTED = 81
#: A slice keeps away from panel edges and supports by this much [m].
_CLEAR_M = 0.06
#: So far from the ends the mirror shows what is beyond the absorber in some photos or in all [m].
_BLIND_END_M = 0.75
#: Nodes of the photo with outlines along each axis; the reflection is then some ten nodes wide at least.
_NODES = 240
#: Longest side of that photo [px].
_LONGEST_PX = 1500
#: Margin around the mirror as a share of its size in the photo.
_MARGIN_SHARE = 0.04


@dataclass(frozen=True, slots=True, eq=False)
class Slices:
    """Brightness of a few rows of the mirror in all photos (Owkes 2012, 6.3.2).

    y_m (s,): Rows [m].
    x_m (n,): Columns [m].
    n_photos: Number of photos.
    shown: Brightness by slice and column, shape (s, n), NaN where the photo does not show the point, of each photo
        that was taken, by its number: of a flight over a hundred troughs one is in few photos [DN].
    """

    y_m: FloatArray
    x_m: FloatArray
    n_photos: int
    shown: dict[int, Float32Array] = field(default_factory=dict)

    @property
    def brightness_dn(self) -> Float32Array:
        """Brightness by slice, photo and column, shape (s, k, n) [DN]."""
        whole = np.full((self.y_m.size, self.n_photos, self.x_m.size), np.nan, dtype=np.float32)
        for number, values in self.shown.items():
            whole[:, number] = values
        return whole

    def of_photos(self, numbers: Sequence[int]) -> "Slices":
        """Return what some photos show, numbered anew."""
        shown = {k: self.shown[number] for k, number in enumerate(numbers) if number in self.shown}
        return Slices(self.y_m, self.x_m, len(numbers), shown)

    def take(self, shots: Sequence[Shot], collector: Collector) -> None:
        """Fill in what some photos show; photos may be taken side by side."""
        x = np.linspace(self.x_m[0], self.x_m[-1], _PROJECTED)
        points = np.empty((self.y_m.size, x.size, 3))
        points[..., 0], points[..., 1] = x, self.y_m[:, None]
        points[..., 2] = collector.surface.height(x, self.y_m[:, None])
        share = np.linspace(0, 1, (_COLUMNS - 1) // (_PROJECTED - 1), endpoint=False)[:, None]
        for one in shots:
            exact = np.nan_to_num(one.view.project(points), nan=-1.0)
            between = exact[:, :-1, None] + share * np.diff(exact, axis=1)[:, :, None]
            places = np.concatenate([between.reshape(len(exact), -1, 2), exact[:, -1:]], axis=1).astype(np.float32)
            values = cv2.remap(one.image, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
            last = np.array(one.image.shape[::-1]) - 1
            inside = ((places >= 0) & (places <= last)).all(axis=-1)
            self.shown[one.number] = np.where(inside, values, np.float32(np.nan)).astype(np.float32)


def empty_slices(collector: Collector, rows_m: FloatArray, n_photos: int) -> Slices:
    """Choose slices that are well apart, on panels and away from supports.

    rows_m (r,): Rows of the map, of which some are chosen [m].
    """
    away = np.abs(rows_m[:, None] - collector.panel_edges_y_m).min(axis=1) - collector.panel_gap_m / 2
    clear = away > _CLEAR_M
    for support in collector.support_y_m:
        clear &= np.abs(rows_m - support) > collector.support_width_m / 2 + _CLEAR_M
    free = rows_m[clear] if clear.any() else rows_m
    reach = max(collector.length_m / 2 - _BLIND_END_M, collector.length_m / 4)
    wanted = np.linspace(-reach, reach, _SLICES)
    chosen = np.unique([free[np.argmin(np.abs(free - y))] for y in wanted])
    half = collector.aperture_width_m / 2
    x = np.linspace(-half, half, _COLUMNS)
    return Slices(chosen, x, n_photos)


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """One photo of the mirror, and by what angle each point's reflected line of sight passes beside the tube.

    image_dn (height, width): The part of the photo that shows the mirror, reduced in size [DN].
    pixels (ny, nx, 2): Where the nodes are in this image [px].
    beside_design_rad, beside_measured_rad (ny, nx): Angle by which the line passes beside the tube's surface,
        negative where it meets the tube: with the design's mirror and absorber, and with the measured ones; NaN
        where that was not measured [rad].
    """

    photo: int
    image_dn: Float32Array
    pixels: FloatArray
    beside_design_rad: FloatArray
    beside_measured_rad: FloatArray


def draw_overlay(
    shot: Shot,
    slope_map: SlopeMap,
    design: AbsorberPath,
    absorber: AbsorberPath,
    collector: Collector,
) -> Overlay:
    """Predict the absorber's reflection in one photo.

    slope_map: The measured mirror.
    design, absorber: The tube by design and as measured.
    Returns: The photo, nodes of the mirror in it and the predictions.
    """
    rows, columns = (
        np.unique(np.linspace(0, size - 1, min(size, _NODES)).round().astype(int)) for size in slope_map.shape
    )
    chosen = np.ix_(rows, columns)
    x, y = np.meshgrid(slope_map.x_m[columns], slope_map.y_m[rows])
    points = np.stack([x, y, collector.surface.height(x, y)], axis=-1)
    design_slopes = (slope_map.design_slope_x[chosen], slope_map.design_slope_y[chosen])
    along = slope_map.slope_y[chosen]
    measured = (slope_map.slope_x[chosen], np.where(np.isfinite(along), along, design_slopes[1]))
    pixels = shot.view.project(points)
    eyes = shot.view.eyes_at(np.nan_to_num(pixels)).reshape(-1, 3)
    part, pixels = _cut_out(shot.image, pixels)
    return Overlay(
        shot.number,
        part,
        pixels,
        _beside(points, eyes, design_slopes, design, collector),
        _beside(points, eyes, measured, absorber, collector),
    )


def _beside(
    points_m: FloatArray,
    eyes_m: FloatArray,
    slopes: tuple[FloatArray, FloatArray],
    tube: AbsorberPath,
    collector: Collector,
) -> FloatArray:
    """Return by what angle reflected lines pass beside the tube's surface."""
    shape = points_m.shape[:2]
    flat = points_m.reshape(-1, 3)
    sights = Sights(flat, eyes_m, np.ones(len(flat)))
    slope_x, slope_y = (part.reshape(-1) for part in slopes)
    radius = collector.absorber_diameter_m / 2
    upper = misfit(sights, (slope_x, slope_y), tube, radius).angle_rad
    lower = misfit(Sights(flat, sights.eyes_m, -sights.side), (slope_x, slope_y), tube, radius).angle_rad
    # e(+1) = d + w and e(-1) = d - w: beside the tube by |d| - w.
    return np.asarray((0.5 * np.abs(upper + lower) - 0.5 * (upper - lower)).reshape(shape))


def _cut_out(image: AnyImage, pixels: FloatArray) -> tuple[Float32Array, FloatArray]:
    """Cut out what shows the mirror, reduce it, and move the nodes along."""
    import cv2

    height, width = image.shape
    finite = np.isfinite(pixels).all(axis=-1)
    low, high = pixels[finite].min(axis=0), pixels[finite].max(axis=0)
    margin = _MARGIN_SHARE * (high - low)
    left, top = np.maximum(np.floor(low - margin), 0).astype(int)
    right, bottom = np.minimum(np.ceil(high + margin) + 1, (width, height)).astype(int)
    part = np.asarray(image[top:bottom, left:right], dtype=np.float32)
    shrink = min(1.0, _LONGEST_PX / max(part.shape))
    if shrink < 1.0:
        part = np.asarray(cv2.resize(part, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), dtype=np.float32)
    # Pixel centres: the middle of the first pixel is at 0 in both images.
    moved = (pixels - (left, top) + 0.5) * shrink - 0.5
    return part, moved
