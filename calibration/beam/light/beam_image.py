"""Measure the beam of one heliostat in a rectified picture of the target: place, size, shape, what to trust."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from calibration.beam.light.aureole import Aureole, find_aureole
from calibration.beam.light.background import TargetSurface, area_resized, seams_of, taken_by_background
from calibration.beam.light.beam_centroids import (
    CENTROID_METHODS,
    Bell,
    Centroid,
    PixelNoise,
    Spot,
    bell_again,
    gaussian_centroid,
    intensity_centroid,
    pixel_noise,
    propagated,
    super_gaussian_centroid,
    threshold_centroid,
)
from calibration.beam.light.beam_flags import REJECTED_BEAM, BeamFlag, beam_reason
from calibration.beam.light.beam_lumps import count_lumps
from calibration.beam.light.beam_moments import BeamMoments, beam_moments
from calibration.beam.light.beam_region import BeamRegion, find_beam_region
from calibration.beam.light.beam_size import BeamSize, LightPicture, Skirts, beam_size, no_size
from calibration.beam.light.target_details import compare_details
from calibration.beam.target.view import TargetImage
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, FloatArray, freeze

__all__ = ["Beam", "BeamSettings", "SpotEstimate", "measure_beam", "no_beam"]

_METHODS = {
    "intensity": intensity_centroid,
    "threshold": threshold_centroid,
    "gaussian": gaussian_centroid,
    "super_gaussian": super_gaussian_centroid,
}
#: Longer side of the picture in which the light is added up; finer pictures are averaged to it.
_ANALYSIS_PX = 256
#: Brightness below this share of the target's own is a mark, not the target.
_MARK_SHARE = 0.75
#: A pixel this near to the end of the scale counts as saturated.
_SATURATION = 0.998
#: How far the centre of the light is from the mirror's middle ray, as a share of the beam's RMS width: 0.7 % in 180
#: drawn beams of 60 heliostats with canting errors and slanting sun (coma; `tests/recovery/test_beam_middle.py`),
#: rounded up for vignetting, which moves the beams of `tests/recovery/test_beam_photos.py` by at most 3 mm.
_MIDDLE_SHARE = 0.008
#: How far panels of other reflectance pull the centre, over their scatter and the beam's RMS width: of a beam that a
#: seam halves, sqrt(2 / pi) / sqrt(2).
_PANEL_PULL = 0.56
#: Scatter of panels around a beam beyond which it is said where no frame without a beam shows those under it. Of 131
#: real photos of one heliostat two have more, and none of another's five; of 36 drawn targets each, panels of 1, 3 and
#: 6 % are said in 2, 27 and 36, and pull the centre by up to 4, 6 and 6 sigma.
_UNEVEN = 0.015
#: Strength of the empty target's details in a photo, and sigmas that it must be below: 0.8 and more in drawn photos
#: with shadows, clouds and haze, about 0 where the camera has moved by more than twice a seam's width.
_LEAST_DETAILS, _SURE = 0.45, 2.0
#: Rounds in which a beam's skirts and the background are told apart, and the change that ends them, of the peak.
_SKIRT_ROUNDS, _SKIRT_SETTLED = 6, 0.002
#: Of what reflects less than this share of the target around it, the beam's light is not known.
_LEAST_REFLECTANCE = 0.3
_LIMITS = ("least_peak_to_scatter", "least_contrast", "most_edge_share", "most_saturated_share", "sunlit_share")


@dataclass(frozen=True, slots=True)
class BeamSettings:
    """What decides whether there is a beam, and which centroid is taken.

    method: One of `CENTROID_METHODS`: "intensity" (recommended), "threshold", "gaussian", "super_gaussian".
    least_peak_to_scatter: Peak of a beam over the scatter of the target around it.
    least_contrast: Peak of a beam over the target's own brightness.
    most_edge_share: Brightness at the target's edge over the peak, above which the beam is called cut off.
    most_saturated_share: Share of the beam's pixels at the end of the grey scale, above which it is called
        saturated.
    sunlit_share: Peak over the target's own brightness, below which the target is called sunlit.
    InputError: An unknown method or a number that is not positive.
    """

    method: str = "intensity"
    least_peak_to_scatter: float = 6.0
    least_contrast: float = 0.02
    most_edge_share: float = 0.2
    most_saturated_share: float = 0.005
    sunlit_share: float = 0.1

    def __post_init__(self) -> None:
        if self.method not in CENTROID_METHODS:
            raise InputError(f"method: one of {', '.join(CENTROID_METHODS)} is needed, not {self.method!r}")
        for name in _LIMITS:
            if not getattr(self, name) > 0:
                raise InputError(f"{name}: a positive number is needed, not {getattr(self, name)}")


@dataclass(frozen=True, slots=True, eq=False)
class SpotEstimate:
    """Place of a beam by one method.

    position_m (2,): x (right) and y (up) on the target [m].
    covariance_m2 (2, 2): Its covariance: noise, background, homography [m^2].
    exponent: Exponent of a super-Gaussian; NaN for other methods.
    """

    position_m: FloatArray
    covariance_m2: FloatArray
    exponent: float = float("nan")

    @property
    def sigma_m(self) -> FloatArray:
        """Standard deviations of x and y, shape (2,) [m]."""
        return np.sqrt(np.diag(self.covariance_m2))


@dataclass(frozen=True, slots=True, eq=False)
class Beam:
    """A beam on the target.

    spot: Place by the method that the settings choose; NaN where there is none.
    estimates: Place by every method that gave one.
    moments: Size and shape of the light inside the outline.
    peak_dn, background_dn: Largest brightness above the target's own; the target's own under the beam [DN].
    saturated_share: Share of the beam's pixels at the end of the grey scale.
    edge_share: Brightness at the target's edge over the peak.
    flags: Why it is doubtful or useless.
    size: Sizes from all of its light, with sigma.
    light: Its light without background; None where there is no beam.
    """

    spot: SpotEstimate
    estimates: dict[str, SpotEstimate]
    moments: BeamMoments
    peak_dn: float
    background_dn: float
    saturated_share: float
    edge_share: float
    flags: BeamFlag
    size: BeamSize
    light: LightPicture | None = None

    @property
    def rejected(self) -> bool:
        """Whether the place must not be used."""
        return bool(self.flags & REJECTED_BEAM)

    @property
    def reason(self) -> str:
        """The flags in words; empty where there are none."""
        return beam_reason(self.flags)


def no_beam(flags: BeamFlag) -> Beam:
    """Return the beam of a picture that shows none."""
    nan, nowhere, square = float("nan"), np.full(2, np.nan), np.full((2, 2), np.nan)
    empty = BeamMoments(nan, nowhere, square)
    return Beam(SpotEstimate(nowhere, square), {}, empty, nan, nan, nan, nan, flags, no_size())


def measure_beam(
    image: TargetImage,
    *,
    empty: TargetSurface | None = None,
    reflectance: FloatArray | None = None,
    settings: BeamSettings | None = None,
) -> Beam:
    """Measure the beam on a target.

    image: The rectified picture.
    empty: The same target without a beam, rectified alike.
    reflectance (h, w): Relative reflectance of the target; without, that of the seams is taken from the frame without a
        beam.
    settings: Method and limits.
    Returns: Place by all methods, size, shape, flags. A picture without a beam gives NaN and its flag.
    InputError: The frame without a beam is of another size.

    Beam and background are found in turn (`find_beam_region`). The intensity centroid is recommended: it makes no
    assumption about the shape, its outline at 10 % of the peak keeps errors of the background from the far target
    out, and on real beams the threshold at 50 % and the fits follow single bright streaks. Its sigma contains the
    pixels' noise, what the background has beyond it, the homography, the scatter of the methods' places beyond all
    that, and 0.8 % of the beam's RMS width: no centroid is the mirror's middle ray.
    """
    chosen = settings or BeamSettings()
    if empty is not None and empty.values_dn.shape != image.values_dn.shape:
        raise InputError(
            f"frame without a beam: {empty.values_dn.shape} pixels, the picture has {image.values_dn.shape}"
        )
    valid = np.isfinite(image.values_dn)
    if valid.mean() < 0.75:
        return no_beam(BeamFlag.NOT_FINITE)
    picture = _prepared(image, valid, empty, reflectance)
    try:
        beam, scatter = _attempt(image, picture, chosen, edges_first=False)
        if beam.rejected:
            again, other = _attempt(image, picture, chosen, edges_first=True)
            beam = again if not again.rejected or other < scatter else beam
    except EstimationError:
        return no_beam(BeamFlag.NOT_FINITE)
    return beam


def _attempt(
    image: TargetImage, picture: "_Picture", settings: BeamSettings, *, edges_first: bool
) -> tuple[Beam, float]:
    """Measure once; return the beam and the scatter of the background that goes with it."""
    region = find_beam_region(
        picture.values_dn,
        picture.valid,
        empty=picture.empty,
        full_scale_dn=image.full_scale_dn,
        edges_first=edges_first,
    )
    scatter = region.background.scatter_dn
    if not region.inside.any() or region.peak_dn < _least_peak_dn(region, settings):
        return no_beam(BeamFlag.NO_BEAM), scatter
    beam = _measured(image, picture, region, settings)
    # What is faint and no whole single lump is a panel, a shadow or a cloud's light rather than a beam.
    return (no_beam(BeamFlag.NO_BEAM) if beam.rejected and beam.flags & BeamFlag.SUNLIT_TARGET else beam), scatter


def _least_peak_dn(region: BeamRegion, settings: BeamSettings) -> float:
    own = max(0.0, float(np.median(region.background.values_dn)))
    return max(settings.least_peak_to_scatter * region.scatter_dn, settings.least_contrast * own)


# --- the picture in which light is added up -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    """Picture averaged to the analysis grid: values (finite), what is valid, saturated share, frame without a beam.

    uneven_share: By how much panels differ; None where neither a map nor a frame without a beam says it.
    """

    values_dn: FloatArray
    valid: BoolArray
    saturated: FloatArray
    empty: FloatArray | None
    stretch: FloatArray
    reflectance: FloatArray | None
    uneven_share: float | None = None


def _prepared(
    image: TargetImage, valid: BoolArray, empty: TargetSurface | None, reflectance: FloatArray | None
) -> _Picture:
    height, width = image.values_dn.shape
    scale = max(1, -(-max(height, width) // _ANALYSIS_PX))
    shape = (round(height / scale), round(width / scale))
    values = image.values_dn
    if not valid.all():
        values = np.where(valid, values, float(np.median(values[valid])))
    saturated = (values >= _SATURATION * image.full_scale_dn).astype(np.float32)
    pattern = None
    if empty is not None:
        known = np.isfinite(empty.values_dn)
        valid = valid & known
        pattern = area_resized(np.where(known, empty.values_dn, float(np.median(empty.values_dn[known]))), shape)
    return _Picture(
        area_resized(values, shape),
        area_resized(valid.astype(np.float32), shape) > 0.999,
        area_resized(saturated, shape),
        pattern,
        np.array([width / shape[1], height / shape[0]]),
        _relative(reflectance, pattern, shape),
        # A map has the panels' reflectance.
        0.0 if reflectance is not None else empty.uneven_share if empty is not None else None,
    )


def _relative(reflectance: FloatArray | None, pattern: FloatArray | None, shape: tuple[int, int]) -> FloatArray | None:
    """Return what the beam's light is divided by: a measured map, else the seams in the frame without a beam."""
    if reflectance is not None:
        return area_resized(reflectance / float(np.median(reflectance)), shape)
    return None if pattern is None else seams_of(pattern)


class _OnGrid(NamedTuple):
    """The beam on the analysis grid, the background there, and the pixels free of a beam."""

    spot: Spot
    ground_dn: FloatArray
    free: BoolArray


def _spot(picture: _Picture, region: BeamRegion) -> _OnGrid:
    shape = (picture.values_dn.shape[0], picture.values_dn.shape[1])
    ground = area_resized(region.background.values_dn, shape)
    if picture.empty is not None:
        # The pattern is known finer than the coarse grid resolves it.
        coarse = (region.values_dn.shape[0], region.values_dn.shape[1])
        detail = picture.empty / area_resized(area_resized(picture.empty, coarse), shape)
        ground = ground * detail
    difference = picture.values_dn - ground
    marks = picture.valid & (picture.values_dn < _MARK_SHARE * ground) & (difference < -3 * region.scatter_dn)
    smoothed = area_resized(region.smoothed_dn, shape)
    if picture.reflectance is not None:
        difference = difference / np.maximum(picture.reflectance, _LEAST_REFLECTANCE)
        marks &= picture.reflectance < _LEAST_REFLECTANCE
    if marks.any():
        difference = _bridged(difference, marks | ~picture.valid, marks)
    labelled = area_resized(region.inside.astype(np.float32), shape) > 0.5
    others = area_resized(region.others.astype(np.float32), shape) > 0.5
    free = area_resized(region.free.astype(np.float32), shape) > 0.999
    spot = Spot(
        difference,
        smoothed,
        labelled & picture.valid,
        picture.valid & ~others,
        region.peak_dn,
        region.outline_dn,
        region.smoothing * max(shape),
    )
    return _OnGrid(spot, ground, free & picture.valid & ~marks)


def _bridged(difference: FloatArray, unknown: BoolArray, marks: BoolArray) -> FloatArray:
    """Replace marks by what surrounds them: they are darker than the beam that falls on them."""
    grown = cv2.dilate(marks.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    known = (~(unknown | grown)).astype(np.float64)
    sigma = 0.015 * max(difference.shape)
    share = cv2.GaussianBlur(known, (0, 0), sigma)
    around = cv2.GaussianBlur(np.where(known > 0, difference, 0.0), (0, 0), sigma) / np.maximum(share, 1e-3)
    return np.where(grown, around, difference)


# --- the result -----------------------------------------------------------------------------------------------------


def _measured(image: TargetImage, picture: _Picture, region: BeamRegion, settings: BeamSettings) -> Beam:
    spot, ground, free = _spot(picture, region)
    background = region.background
    noise = pixel_noise(
        picture.values_dn, spot.inside, free, (background.basis, background.cofactor, background.residuals_dn)
    )
    centroids = {}
    for name, method in _METHODS.items():
        try:
            centroids[name] = method(spot)
        except (EstimationError, np.linalg.LinAlgError):
            continue
    estimates = _estimates(image, picture, centroids, noise)
    if settings.method not in estimates or "intensity" not in estimates:
        return no_beam(BeamFlag.NO_BEAM)
    axes = _axes(image, picture, spot, centroids["intensity"].position_px)
    moments = beam_moments(np.where(spot.inside, spot.values_dn, 0.0), *axes)
    uneven = _uneven_around(noise, ground[free], image.full_scale_dn) if picture.uneven_share is None else 0.0
    chosen = _with_shape(settings.method, estimates, moments, picture.uneven_share or uneven)
    saturated = float(picture.saturated[spot.inside].mean())
    edge = _edge_share(region)
    flags = _flags(region, settings, saturated, edge)
    under = float(np.average(ground[spot.inside], weights=np.maximum(spot.smoothed_dn[spot.inside], 1e-12)))
    if region.peak_dn < settings.sunlit_share * under:
        flags |= BeamFlag.SUNLIT_TARGET
    if uneven > _UNEVEN:
        flags |= BeamFlag.UNEVEN_TARGET
    if picture.empty is not None:
        details = compare_details(picture.values_dn, picture.empty, free, image.full_scale_dn)
        if any(one.strength + _SURE * one.sigma < _LEAST_DETAILS for one in details):
            flags |= BeamFlag.TARGET_MOVED
    if _disagree(estimates, moments):
        flags |= BeamFlag.METHODS_DISAGREE
    light = LightPicture(
        freeze(spot.values_dn), spot.inside, spot.usable & ~free, picture.saturated > 0, axes[0], axes[1]
    )
    skirts = _skirts(centroids["super_gaussian"].bell if "super_gaussian" in centroids else None, region, spot)
    try:
        size = beam_size(light, spot.smoothed_dn, skirts, noise, _aureole(region, skirts))
    except EstimationError:
        size = no_size()
    if size.has_aureole:
        flags |= BeamFlag.BACKGROUND_MAY_HOLD_LIGHT
    return Beam(
        chosen,
        estimates,
        moments,
        region.peak_dn,
        under,
        saturated,
        edge,
        flags,
        size,
        light,
    )


def _skirts(bell: Bell | None, region: BeamRegion, spot: Spot) -> Skirts | None:
    """Continue the beam by its bell; the background is estimated without it, and the bell again above that."""
    shape = (spot.values_dn.shape[0], spot.values_dn.shape[1])
    coarse = (region.free.shape[0], region.free.shape[1])
    found: Skirts | None = None
    taken = taken_by_background(region.free, region.background)
    for _ in range(_SKIRT_ROUNDS):
        if bell is None:
            break
        fine = area_resized(bell.values_dn, shape)
        own = taken(area_resized(bell.values_dn, coarse))
        before, found = found, Skirts(fine, area_resized(own, shape))
        moved = found.taken_dn if before is None else found.taken_dn - before.taken_dn
        if np.abs(moved).max() < _SKIRT_SETTLED * spot.peak_dn:
            break
        try:
            bell = bell_again(replace(spot, values_dn=spot.values_dn + found.taken_dn), bell)
        except EstimationError:
            break
    return found


def _aureole(region: BeamRegion, skirts: Skirts | None) -> Aureole | None:
    """Look for light around the beam that falls slower than its skirts."""
    light = np.where(region.inside, np.maximum(region.smoothed_dn, 0.0), 0.0)
    coarse = (light.shape[0], light.shape[1])
    beyond = np.zeros(coarse) if skirts is None else area_resized(skirts.bell_dn, coarse)
    return find_aureole(region.background, region.free, light, beyond) if light.any() else None


def _uneven_around(noise: PixelNoise, ground_dn: FloatArray, full_scale_dn: float) -> float:
    """Return by how much panels around the beam differ, as a share: those under it are taken to differ as much.

    Daylight that its functions do not follow is in it, too. It is no less than it should be then, and in real photos a
    per cent.
    """
    level = max(float(np.median(ground_dn)), full_scale_dn / 255) if ground_dn.size else full_scale_dn
    return float(np.sqrt(max(noise.block_dn2))) / level


def _estimates(
    image: TargetImage, picture: _Picture, centroids: dict[str, Centroid], noise: PixelNoise
) -> dict[str, SpotEstimate]:
    if not centroids:
        return {}
    errors = propagated(np.concatenate([one.influence for one in centroids.values()]), noise)
    found = {}
    for number, (name, centroid) in enumerate(centroids.items()):
        pixel = (centroid.position_px + 0.5) * picture.stretch - 0.5
        jacobian = image.jacobian(pixel) * picture.stretch
        covariance = jacobian @ errors.of(slice(2 * number, 2 * number + 2)) @ jacobian.T
        place = image.points_m(pixel)
        found[name] = SpotEstimate(freeze(place), freeze(covariance + image.covariance_m2(place)), centroid.exponent)
    return found


def _with_shape(
    method: str, estimates: dict[str, SpotEstimate], moments: BeamMoments, uneven_share: float
) -> SpotEstimate:
    """Add to the covariance what a lopsided beam's centre depends on the method, and what any centroid leaves open.

    Panels that reflect more or less than others are among what it leaves open.

    One difference of two places is often near zero by chance; both directions of all methods know the scatter better.
    """
    chosen = estimates[method]
    places = np.array([one.position_m for one in estimates.values()])
    noise = float(np.mean([np.trace(one.covariance_m2) / 2 for one in estimates.values()]))
    scatter = float(places.var(axis=0, ddof=1).mean()) if len(places) > 1 else 0.0
    covariance = chosen.covariance_m2 + max(0.0, scatter - noise) * np.eye(2)
    share = _MIDDLE_SHARE**2 + (_PANEL_PULL * uneven_share) ** 2
    return replace(chosen, covariance_m2=freeze(covariance + share * moments.covariance_m2))


def _axes(image: TargetImage, picture: _Picture, spot: Spot, centroid: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places of columns and rows on the target [m]."""
    rows, columns = spot.values_dn.shape
    pixel = (centroid + 0.5) * picture.stretch - 0.5
    jacobian, place = image.jacobian(pixel) * picture.stretch, image.points_m(pixel)
    # Perspective within a rectified picture is millimetres: straight axes through the centroid do.
    x_m = place[0] + jacobian[0, 0] * (np.arange(columns) - centroid[0])
    y_m = place[1] + jacobian[1, 1] * (np.arange(rows) - centroid[1])
    return freeze(x_m), freeze(y_m)


def _edge_share(region: BeamRegion) -> float:
    edge = np.zeros(region.inside.shape, dtype=bool)
    edge[[0, -1], :] = edge[:, [0, -1]] = True
    touching = edge & region.inside
    return float(region.smoothed_dn[touching].max() / region.peak_dn) if touching.any() else 0.0


def _flags(region: BeamRegion, settings: BeamSettings, saturated: float, edge: float) -> BeamFlag:
    flags = BeamFlag(0)
    if edge > settings.most_edge_share:
        flags |= BeamFlag.CUT_BY_EDGE
    if count_lumps(region.smoothed_dn, region.inside, region.others) > 1:
        flags |= BeamFlag.TWO_BEAMS
    if saturated > settings.most_saturated_share:
        flags |= BeamFlag.SATURATED
    if region.little_background:
        flags |= BeamFlag.LITTLE_BACKGROUND
    return flags


def _disagree(estimates: dict[str, SpotEstimate], moments: BeamMoments) -> bool:
    """Whether methods differ by more than half the beam's minor width: it is then no single lump."""
    places = np.array([estimate.position_m for estimate in estimates.values()])
    return bool(np.ptp(places, axis=0).max() > 0.5 * moments.widths_m[1])
