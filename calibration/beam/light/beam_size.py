"""Size of a beam from all of its light: encircled diameters, second moments, peak; each with sigma.

The outline of a beam (`beam_region`) is where its light stands out of the background: 1 to 10 % of the peak. A size
from the light inside it depends on the exposure: of a Gaussian beam of 30 DN the circle with 90 % of it is 15 % too
small. So the light is added up to where the target is free of the beam, and beyond that its skirts are continued by the
elliptic bell that fits the whole beam; the background, which has taken part of the skirts for its own, is estimated
again without them.
"""

from dataclasses import dataclass

import numpy as np

from calibration.beam.light.aureole import Aureole
from calibration.beam.light.background import area_resized
from calibration.beam.light.beam_centroids import PixelNoise, propagated
from calibration.beam.light.beam_moments import beam_moments
from heliogauge.errors import EstimationError
from heliogauge.validate import BoolArray, FloatArray, freeze

__all__ = ["SHARES", "BeamSize", "LightPicture", "beam_size", "no_size"]

#: Shares of the light whose circles are measured.
SHARES = (0.5, 0.9, 0.95)
#: What panels that reflect 1 % more or less, and the blur of the photo, change diameters of drawn beams by (1 sigma,
#: `beam synth`); twice that for moments and light.
_LIMIT_SHARE = 0.005
#: An aureole that is lower than its sigma counts as none. It is said where it is no chance (3 sigmas, and D90 by 3 of
#: the sigmas that it has without) and would change D90 by more than twice that of a clear sky is found to: a
#: circumsolar ratio of 0.02 at 66 m up to 5 % with frames of the empty target, 16 % without (`beam synth`).
_CHANCE, _SAID, _SAID_SHARE = 1.0, 3.0, 0.3


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
    peak_dn, sigma_peak_dn: Largest brightness, smoothed as the outline [DN].
    skirt_share: Share of the light that the bell continues beyond where it stands out.
    aureole_share: Share of the light that seems to be spread so wide that it counts as background.
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
    seen = _sizes(bare, picture)
    whole, share = seen, 0.0
    if skirts is not None:
        light = np.where(picture.region, picture.values_dn + skirts.taken_dn, skirts.bell_dn)
        whole = _sizes(light, picture)
        share = float(np.clip(1 - seen[0] / whole[0], 0.0, 1.0))
        bare = light
    influences = _influences(bare, picture, whole)
    change = 0.5 * (whole - seen)
    limit = _LIMIT_SHARE * np.array([2.0, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0]) * np.abs(whole)
    limit[2] = 2 * _LIMIT_SHARE * float(np.sqrt(max(whole[1] * whole[3], 0.0)))
    moments = propagated(influences[1:4], noise) + np.outer(change[1:4], change[1:4]) + np.diag(limit[1:4] ** 2)
    sigma = np.array([np.sqrt(float(propagated(one[None], noise)[0, 0])) for one in influences])
    sigma = np.hypot(np.hypot(sigma, change), limit)
    wider, aureole_share = np.zeros(whole.size), 0.0
    if aureole is not None and aureole.sigmas > _CHANCE:
        with_it = _sizes(_with_aureole(picture, skirts, aureole), picture)
        wider, aureole_share = with_it - whole, float(1 - whole[0] / with_it[0])
    least = max(_SAID * float(sigma[5]), _SAID_SHARE * float(whole[5]))
    has_aureole = aureole is not None and aureole.sigmas > _SAID and bool(wider[5] > least)
    moments += np.outer(wider[1:4], wider[1:4])
    sigma = np.hypot(sigma, wider)
    peak = float(smoothed_dn[picture.inside].max()) if picture.inside.any() else float("nan")
    # The smoothed peak averages so many pixels that the background's error is what is left.
    sigma_peak = float(np.sqrt(sum(noise.block_dn2) / len(noise.block_dn2) + np.max(noise.white_dn2) / 9))
    return BeamSize(
        whole[0],
        float(sigma[0]),
        freeze(whole[4:].copy()),
        freeze(sigma[4:].copy()),
        freeze(np.array([[whole[1], whole[2]], [whole[2], whole[3]]])),
        freeze(moments),
        peak,
        sigma_peak,
        share,
        aureole_share,
        has_aureole,
    )


def _with_aureole(picture: LightPicture, skirts: Skirts | None, aureole: Aureole) -> FloatArray:
    """Return the light with an aureole: what the background took of it, and beyond the region the aureole itself."""
    shape = (picture.values_dn.shape[0], picture.values_dn.shape[1])
    taken, beyond = area_resized(aureole.taken_dn, shape), area_resized(aureole.light_dn, shape)
    if skirts is not None:
        taken, beyond = taken + skirts.taken_dn, beyond + skirts.bell_dn
    return np.where(picture.region, picture.values_dn + taken, beyond)


def _sizes(light: FloatArray, picture: LightPicture) -> FloatArray:
    """Return total, xx, xy, yy and the diameters of `SHARES`."""
    moments = beam_moments(light, picture.x_m, picture.y_m)
    (xx, xy), (_, yy) = moments.covariance_m2
    diameters = 2 * _radii(light, picture, moments.centroid_m).radius_m
    return np.array([moments.total, xx, xy, yy, *diameters])


@dataclass(frozen=True, slots=True, eq=False)
class _Radii:
    """Radii that hold `SHARES` of the light, what lies within each, and the light per metre of radius there."""

    radius_m: FloatArray
    per_m: FloatArray
    distance_m: FloatArray


def _radii(light: FloatArray, picture: LightPicture, center_m: FloatArray) -> _Radii:
    distance = np.hypot(picture.x_m[None, :] - center_m[0], picture.y_m[:, None] - center_m[1])
    # A ring as wide as a pixel holds too few of them near the middle; radii that matter are tens of pixels.
    step = 0.5 * float(np.sqrt(picture.pixel_m2))
    rings = np.bincount((distance / step).astype(np.intp).ravel(), weights=light.ravel())
    inside = np.concatenate([[0.0], np.cumsum(rings)]) / float(light.sum())
    outer = np.maximum.accumulate(inside)
    edges = step * np.arange(inside.size)
    radius = np.interp(SHARES, outer, edges)
    # The light between 10 % smaller and larger circles: smooth against pixels.
    near, far = np.interp(0.9 * radius, edges, outer), np.interp(1.1 * radius, edges, outer)
    return _Radii(radius, (far - near) / (0.2 * radius), distance)


def _influences(light: FloatArray, picture: LightPicture, sizes: FloatArray) -> FloatArray:
    """Return the derivatives of all sizes by each pixel's value, shape (7, h, w); 0 where no light is measured."""
    total = float(light.sum())
    if not total > 0:
        raise EstimationError(f"the light of the beam adds up to {total:.4g} DN: it has no size")
    moments = beam_moments(light, picture.x_m, picture.y_m)
    dx = (picture.x_m - moments.centroid_m[0])[None, :]
    dy = (picture.y_m - moments.centroid_m[1])[:, None]
    radii = _radii(light, picture, moments.centroid_m)
    parts = [np.full(light.shape, picture.pixel_m2)]
    for product, mean in ((dx * dx, sizes[1]), (dx * dy, sizes[2]), (dy * dy, sizes[3])):
        parts.append((product - mean) / total)
    for share, radius, per_m in zip(SHARES, radii.radius_m, radii.per_m, strict=True):
        parts.append(2 * (share - (radii.distance_m < radius)) / (total * per_m))
    return np.stack([np.where(picture.region, one, 0.0) for one in parts])
