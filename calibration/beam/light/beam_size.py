"""Size of a beam from all of its light: encircled diameters, second moments, peak; each with sigma.

The outline of a beam (`beam_region`) is where its light stands out of the background: 1 to 10 % of the peak. A size
from the light inside it depends on the exposure: of a Gaussian beam of 30 DN the circle with 90 % of it is 15 % too
small. So the light is added up to where the target is free of the beam, and beyond that its skirts are continued by the
elliptic bell that fits the whole beam; the background, which has taken part of the skirts for its own, is estimated
again without them.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from calibration.beam.light.aureole import Aureole
from calibration.beam.light.background import area_resized
from calibration.beam.light.beam_centroids import PixelNoise, coarse_shape, propagated
from calibration.beam.light.beam_moments import beam_moments, light_within
from heliogauge.validate import BoolArray, FloatArray, freeze

__all__ = ["SHARES", "BeamSize", "LightPicture", "beam_size", "no_size"]

#: Shares of the light whose circles are measured.
SHARES = (0.5, 0.9, 0.95)
#: What panels that reflect 1 % more or less, and the blur of the photo, change diameters of drawn beams by (1 sigma,
#: `beam synth`); twice that for moments and light.
_LIMIT_SHARE = 0.005
#: Light above so much of the smoothed peak is a paraboloid: of a Gaussian the fit is off by 0.3 %, and by 0.9 %.
_TOPS = (0.85, 0.75)
#: An aureole is said where it is seen and would change D90 by 3 of the sigmas that it has without, and by more than
#: twice what that of a clear sky is found to: a circumsolar ratio of 0.02 at 66 m up to 5 % with frames of the empty
#: target, 16 % without (`beam synth`).
_SAID, _SAID_SHARE = 3.0, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class LightPicture:
    """Light of one beam on its target, without background.

    values_dn (h, w): Brightness above the background; rows from the top [DN].
    inside (h, w): Pixels inside the beam's outline.
    region (h, w): Pixels that the beam and its skirts light, as far as they stand out.
    saturated (h, w): Pixels at the end of the grey scale: the light is more there.
    x_m (w,), y_m (h,): Places of columns and rows on the target [m].
    """

    values_dn: FloatArray
    inside: BoolArray
    region: BoolArray
    saturated: BoolArray
    x_m: FloatArray
    y_m: FloatArray

    @property
    def pixel_m2(self) -> float:
        """Area of a pixel [m^2]."""
        return abs(float((self.x_m[1] - self.x_m[0]) * (self.y_m[1] - self.y_m[0])))


@dataclass(frozen=True, slots=True, eq=False)
class BeamSize:
    """Sizes of a beam.

    total_dn_m2, sigma_total_dn_m2: Brightness added up over the target [DN m^2].
    diameters_m, sigma_diameters_m (3,): Circles about the centre of the light that hold `SHARES` of it [m].
    moments_m2 (2, 2): Central second moments [m^2].
    covariance_moments_m4 (3, 3): Covariance of their xx, xy, yy [m^4].
    peak_dn, sigma_peak_dn: Largest brightness: top of the paraboloid that fits the light around it [DN].
    background_dn, white_dn: Standard deviations of a pixel: of the background, which neighbours share; of noise [DN].
    skirt_share: Share of the light that the bell continues beyond where it stands out.
    aureole_share: Share of the light that seems to be spread so wide that it counts as background; 0 where the photo
        shows no such light.
    has_aureole: Whether that changes D90 beyond what the sigma without it and a clear sky allow.
    """

    total_dn_m2: float
    sigma_total_dn_m2: float
    diameters_m: FloatArray
    sigma_diameters_m: FloatArray
    moments_m2: FloatArray
    covariance_moments_m4: FloatArray
    peak_dn: float
    sigma_peak_dn: float
    background_dn: float
    white_dn: float
    skirt_share: float
    aureole_share: float
    has_aureole: bool


def no_size() -> BeamSize:
    """Return the sizes of a picture without a beam: NaN."""
    nan = float("nan")
    return BeamSize(
        nan,
        nan,
        np.full(3, nan),
        np.full(3, nan),
        np.full((2, 2), nan),
        np.full((3, 3), nan),
        nan,
        nan,
        nan,
        nan,
        nan,
        nan,
        False,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Skirts:
    """The skirts of a beam where they do not stand out of the background.

    bell_dn (h, w): The bell that fits the whole beam [DN].
    taken_dn (h, w): What the background has taken of it under the beam [DN].
    """

    bell_dn: FloatArray
    taken_dn: FloatArray


def beam_size(
    picture: LightPicture,
    smoothed_dn: FloatArray,
    skirts: Skirts | None,
    noise: PixelNoise,
    aureole: Aureole | None = None,
) -> BeamSize:
    """Measure the size of a beam from all of its light.

    picture: Its light.
    smoothed_dn (h, w): The light, smoothed as for its outline [DN].
    skirts: How it goes on where it does not stand out; None: not at all.
    noise: Errors of the pixels and of the background.
    aureole: Light around the beam that the background may have taken.
    Returns: Sizes of what is no aureole. Their sigma has the errors of the pixels, of the background, half of what the
        skirts change (whether a beam's skirts follow the bell of its core is not seen in the photo), and what the
        aureole would change.
    EstimationError: The light does not add up to a positive sum.
    """
    bare = np.where(picture.region, picture.values_dn, 0.0)
    sizes = _sizes(bare, picture)
    seen, share = sizes.values, 0.0
    if skirts is not None:
        light = np.where(picture.region, picture.values_dn + skirts.taken_dn, skirts.bell_dn)
        sizes = _sizes(light, picture)
        share = float(np.clip(1 - seen[0] / sizes.values[0], 0.0, 1.0))
        bare = light
    whole = sizes.values
    influences = _influences(bare, picture, sizes)
    change = 0.5 * (whole - seen)
    limit = _LIMIT_SHARE * np.array([2.0, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0]) * np.abs(whole)
    limit[2] = 2 * _LIMIT_SHARE * float(np.sqrt(max(whole[1] * whole[3], 0.0)))
    errors = propagated(influences, noise)
    moments = errors.of(slice(1, 4)) + np.outer(change[1:4], change[1:4]) + np.diag(limit[1:4] ** 2)
    sigma = np.sqrt([float(errors.of(slice(k, k + 1))[0, 0]) for k in range(whole.size)])
    sigma = np.hypot(np.hypot(sigma, change), limit)
    wider, aureole_share = np.zeros(whole.size), 0.0
    if aureole is not None:
        with_it = _sizes(_with_aureole(picture, skirts, aureole), picture).values
        wider = with_it - whole
        aureole_share = float(1 - whole[0] / with_it[0]) if aureole.is_seen else 0.0
    least = max(_SAID * float(sigma[5]), _SAID_SHARE * float(whole[5]))
    has_aureole = aureole is not None and aureole.is_seen and bool(wider[5] > least)
    moments += np.outer(wider[1:4], wider[1:4])
    sigma = np.hypot(sigma, wider)
    peak, sigma_peak = _peak(bare, picture, smoothed_dn)
    background = float(np.sqrt(sum(noise.block_dn2) / len(noise.block_dn2)))
    return BeamSize(
        whole[0],
        float(sigma[0]),
        freeze(whole[4:].copy()),
        freeze(sigma[4:].copy()),
        freeze(np.array([[whole[1], whole[2]], [whole[2], whole[3]]])),
        freeze(moments),
        peak,
        float(np.hypot(sigma_peak, background)),
        background,
        float(np.sqrt(np.max(noise.white_dn2))),
        share,
        aureole_share,
        has_aureole,
    )


def _peak(light: FloatArray, picture: LightPicture, smoothed_dn: FloatArray) -> tuple[float, float]:
    """Return the largest brightness and its standard deviation, the background's error apart [DN].

    Smoothing that finds the peak lowers it (by 8 % where it is half as wide as the beam), so a paraboloid is fitted to
    the light itself around it. What a narrower and a wider surrounding differ by, and panels of 1 %, are in the sigma.
    """
    if not picture.inside.any():
        return float("nan"), float("nan")
    smoothed = np.where(picture.inside, smoothed_dn, 0.0)
    top = np.unravel_index(int(np.argmax(smoothed)), smoothed.shape)
    highest = float(smoothed[top])
    left, low, width, height = cv2.boundingRect((smoothed > min(_TOPS) * highest).astype(np.uint8))
    part = (slice(low, low + height), slice(left, left + width))
    place = (int(top[0]) - low, int(top[1]) - left)
    (peak, scatter), (wider, _) = (_top(light[part], smoothed[part], place, share) for share in _TOPS)
    if not np.isfinite(peak):
        return highest, 0.1 * highest
    apart = peak - wider if np.isfinite(wider) else 0.0
    return peak, float(np.sqrt(scatter**2 + apart**2 + (2 * _LIMIT_SHARE * peak) ** 2))


def _top(light: FloatArray, smoothed: FloatArray, top: tuple[int, int], share: float) -> tuple[float, float]:
    """Return the top of the paraboloid through the light above a share of the smoothed peak, and its sigma from noise.

    NaN where too few pixels are so bright, or where the paraboloid has no top among them.
    """
    nothing = (float("nan"), float("nan"))
    _, labels = cv2.connectedComponents((smoothed > share * smoothed[top]).astype(np.uint8), connectivity=4)
    rows, columns = np.nonzero(labels == labels[top])
    if rows.size < 12:
        return nothing
    scale = max(int(np.ptp(rows)), int(np.ptp(columns)), 1) / 2
    y, x = (rows - rows.mean()) / scale, (columns - columns.mean()) / scale
    design = np.column_stack([np.ones(x.size), x, y, x * x, x * y, y * y])
    values = light[rows, columns]
    normal = design.T @ design
    if np.linalg.cond(normal) > 1e12:
        return nothing
    inverse = np.linalg.inv(normal)
    found = inverse @ (design.T @ values)
    bend = np.array([[2 * found[3], found[4]], [found[4], 2 * found[5]]])
    if not (np.linalg.eigvalsh(bend) < 0).all():
        return nothing
    place = np.clip(-np.linalg.solve(bend, found[1:3]), -1.0, 1.0)
    at = np.array([1.0, place[0], place[1], place[0] ** 2, place[0] * place[1], place[1] ** 2])
    residuals = values - design @ found
    variance = float(residuals @ residuals) / max(values.size - 6, 1)
    return float(at @ found), float(np.sqrt(variance * (at @ inverse @ at)))


def _with_aureole(picture: LightPicture, skirts: Skirts | None, aureole: Aureole) -> FloatArray:
    """Return the light with an aureole: what the background took of it, and beyond the region the aureole itself."""
    shape = (picture.values_dn.shape[0], picture.values_dn.shape[1])
    taken, beyond = area_resized(aureole.taken_dn, shape), area_resized(aureole.light_dn, shape)
    if skirts is not None:
        taken, beyond = taken + skirts.taken_dn, beyond + skirts.bell_dn
    return np.where(picture.region, picture.values_dn + taken, beyond)


def _sizes(light: FloatArray, picture: LightPicture) -> "_Sizes":
    moments = beam_moments(light, picture.x_m, picture.y_m)
    (xx, xy), (_, yy) = moments.covariance_m2
    radii = _radii(light, picture, moments.centroid_m)
    values = np.array([moments.total, xx, xy, yy, *(2 * radii.radius_m)])
    return _Sizes(values, moments.centroid_m, radii)


@dataclass(frozen=True, slots=True, eq=False)
class _Radii:
    """Radii that hold `SHARES` of the light, and the share per metre of radius there."""

    radius_m: FloatArray
    per_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Sizes:
    """Total, xx, xy, yy and the diameters of `SHARES`, (7,); the centre; the radii."""

    values: FloatArray
    center_m: FloatArray
    radii: _Radii


def _radii(light: FloatArray, picture: LightPicture, center_m: FloatArray) -> _Radii:
    within = light_within(light, picture.x_m, picture.y_m, center_m)
    edges, outer = within.radius_m, within.light_dn / float(light.sum())
    radius = np.interp(SHARES, outer, edges)
    # The light between 10 % smaller and larger circles: smooth against pixels.
    near, far = np.interp(0.9 * radius, edges, outer), np.interp(1.1 * radius, edges, outer)
    return _Radii(radius, (far - near) / (0.2 * radius))


def _influences(light: FloatArray, picture: LightPicture, sizes: _Sizes) -> FloatArray:
    """Return the derivatives of all sizes by each pixel's value, shape (7, h, w); 0 where no light is measured.

    They vary little from pixel to pixel, so the grid is coarse: each of its pixels is a mean of finer ones.
    """
    shape = coarse_shape(light.shape)
    finer = light.size / (shape[0] * shape[1])
    # Light adds up to as much over fewer pixels.
    total = float(light.sum()) / finer
    x, y = (
        _means(axis, count) - middle
        for axis, count, middle in zip((picture.x_m, picture.y_m), shape[::-1], sizes.center_m, strict=True)
    )
    dx, dy = x[None, :], y[:, None]
    parts = [np.full(shape, picture.pixel_m2 * finer)]
    for product, mean in ((dx * dx, sizes.values[1]), (dx * dy, sizes.values[2]), (dy * dy, sizes.values[3])):
        parts.append((product - mean) / total)
    distance, width = np.hypot(dx, dy), float(np.sqrt(picture.pixel_m2 * finer))
    for share, radius, per_m in zip(SHARES, sizes.radii.radius_m, sizes.radii.per_m, strict=True):
        within = np.clip(0.5 + (radius - distance) / width, 0.0, 1.0)
        parts.append(2 * (share - within) / (total * per_m))
    return np.stack(np.broadcast_arrays(*parts)) * area_resized(picture.region.astype(np.float32), shape)


def _means(axis_m: FloatArray, count: int) -> FloatArray:
    """Return the middles of so many equal parts of an axis [m]."""
    step = float(axis_m[1] - axis_m[0])
    return np.asarray(axis_m[0] + step * ((np.arange(count) + 0.5) * (axis_m.size / count) - 0.5))
