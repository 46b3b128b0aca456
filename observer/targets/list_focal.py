"""The focal length that photos of a list of targets near one plane show, without start values and poses."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import FloatArray
from photogrammetry.start_values import resect

#: Fewest targets of a photo: four determine the image of a plane, two more contradict a wrong one. Fewest photos.
_FEWEST_TARGETS, _FEWEST_PHOTOS = 6, 3
#: So many photos, evenly over all, are asked.
_MOST_PHOTOS = 8
#: Targets lie near a plane when they are off it by less than this share of their spread.
_PLANE_SHARE = 0.01
#: Image points this far from where most others have them are of exchanged targets [share of the photo's width].
_OFF_SHARE = 0.005
#: Image points farther off a pose than this do not count for more [px].
_CUT_PX = 5.0
#: Focal lengths that are tried, from fisheye lenses to the longest of drones [widths of the photo].
_TRIED = np.geomspace(0.3, 10.0, 12)
#: Errors of the list are the same in all photos, and those of an unknown lens much the same at neighbouring targets: so
#: many independent numbers at most say how well a focal length fits.
_MOST_FREE = 25
#: A focal length that fits worse by so many standard deviations is another one: by chance one in 10^6.
_SIGMAS = 5.0
#: Known is a focal length with a smaller relative sigma.
_KNOWN_SHARE = 0.05
#: Smaller faults the adjustment finds itself and names with their sigma; an unknown lens puts some per cent into this.
_WRONG_SHARE = 0.2
#: What fits no better than this, 2.6 mm in 13 m, is of another lens than the stated one, or of a poor list, either of
#: which makes a wrong focal length fit better than the right one [shares of the focal length, rms].
_FITS = 2e-4
#: Radial distortion of an unknown lens (k1), from barrel to cushion; beyond are fisheye lenses.
_LENS = 0.3


@dataclass(frozen=True, slots=True)
class FocalOfList:
    """A focal length from targets near a plane.

    focal_px, sigma_px: With its standard deviation, from how well the best poses fit [px].
    miss_px: How far image points are from those of the best poses, root mean square [px].
    stated_sigmas: By how many standard deviations that of the stated camera fits worse, whatever its lens does.
    n_photos: Photos it rests on.
    """

    focal_px: float
    sigma_px: float
    miss_px: float
    stated_sigmas: float
    n_photos: int


def focal_of_list(
    photos: Iterable[tuple[FloatArray, FloatArray]], camera: Camera, *, unless_stated_fits: bool = False
) -> FocalOfList | None:
    """Find the focal length with which poses fit the targets best.

    photos: Of each the listed places (n, 3) [m] and image points (n, 2) [px] of its targets.
    camera: Gives size, principal point and lens; the best focal length does not depend on the stated one.
    unless_stated_fits: Whether another one is looked for only where that of the camera does not fit the targets.
    Returns: None where targets are not near one plane, or all photos look straight at it: any focal length fits these.

    Misfits of the best poses over focal lengths, with the listed places: as images of a plane (Zhang 2000) targets
    that are 2 cm off it say a focal length that is 16 % wrong, the same in all photos.
    """
    shown: list[tuple[FloatArray, FloatArray]] = []
    for places, pixels in photos:
        if len(places) < _FEWEST_TARGETS:
            continue
        away = places - places.mean(axis=0)
        _, spread, axes = np.linalg.svd(away, full_matrices=False)
        if spread[2] > _PLANE_SHARE * spread[0]:
            return None
        rays = camera.cast_rays(pixels)
        image = rays[:, :2] / rays[:, 2:] * camera.focal_x_px
        if not np.isfinite(image).all():
            continue
        _, kept = cv2.findHomography(away @ axes[:2].T, image, cv2.RANSAC, _OFF_SHARE * camera.width_px)
        own = np.ravel(kept) > 0
        if np.count_nonzero(own) >= _FEWEST_TARGETS:
            shown.append((places[own], image[own]))
    if len(shown) < _FEWEST_PHOTOS:
        return None
    asked = np.unique(np.linspace(0, len(shown) - 1, _MOST_PHOTOS).round().astype(np.intp))
    shown = [shown[k] for k in asked]
    count = sum(len(places) for places, _ in shown)
    if unless_stated_fits and _misfit(shown, camera.focal_x_px) <= count * (_FITS * camera.focal_x_px) ** 2:
        return None
    # A flight that fits does without: the import takes 0.12 s.
    from scipy.optimize import minimize_scalar

    tried = camera.width_px * _TRIED
    best = int(np.argmin([_misfit(shown, focal) for focal in tried]))
    if best in (0, tried.size - 1):
        return None
    found = minimize_scalar(
        lambda log: _misfit(shown, float(np.exp(log))),
        bounds=np.log(tried[[best - 1, best + 1]]),
        method="bounded",
        options={"xatol": 3e-3},
    )
    focal, least = float(np.exp(found.x)), float(found.fun)
    # Frame and scale take up seven of the coordinates.
    free = min(3 * max(len(places) for places, _ in shown) - 7, _MOST_FREE)

    def sigmas(other: float) -> float:
        return float(np.sqrt(free * max(_misfit(shown, other) / least - 1, 0.0)))

    # Where it is to be excluded, and not by the curvature at the minimum: misfits are cut off.
    away_share = _SIGMAS * _KNOWN_SHARE
    excluded = min(sigmas(focal * float(np.exp(step))) for step in (-away_share, away_share))
    if excluded < _SIGMAS:
        return None
    stated = camera.focal_x_px
    stated_sigmas = sigmas(stated)
    if stated_sigmas >= _SIGMAS:
        # Where the lens is not stated another focal length makes up for it, as targets are all on two rims.
        lens = minimize_scalar(lambda k1: _misfit(shown, stated, k1), bounds=(-_LENS, _LENS), method="bounded")
        stated_sigmas = min(stated_sigmas, float(np.sqrt(free * max(float(lens.fun) / least - 1, 0.0))))
    miss_px = float(np.sqrt(least / count))
    return FocalOfList(focal, focal * away_share / excluded, miss_px, stated_sigmas, len(shown))


def _misfit(shown: Sequence[tuple[FloatArray, FloatArray]], focal_px: float, k1: float = 0.0) -> float:
    """Return the sum of squared distances of image points from those of the best poses [px^2].

    shown: Places [m] and image points about the principal point, of the stated lens without its distortion [px].
    k1: Radial distortion besides.
    """
    camera = Camera(1, 1, focal_px, focal_px, 0.0, 0.0)
    total = 0.0
    for places, distorted in shown:
        image = distorted * (1 - k1 * np.sum((distorted / focal_px) ** 2, axis=1, keepdims=True))
        try:
            misses = resect(camera, places, image, np.tile(np.eye(2), (len(places), 1, 1)), tolerance=_CUT_PX).misses
        except EstimationError:
            misses = np.full(len(places), _CUT_PX)
        total += float(np.sum(np.minimum(misses, _CUT_PX) ** 2))
    return total


def refuse_other_focal(found: FocalOfList | None, camera: Camera) -> None:
    """Refuse a camera whose focal length is another one than the targets have, by more than an adjustment mends.

    InputError: By more than a fifth; the stated one does not fit, and the other one does.
    """
    if found is None or found.miss_px > _FITS * found.focal_px:
        return
    stated, share = camera.focal_x_px, found.focal_px / camera.focal_x_px
    if abs(np.log(share)) < np.log1p(_WRONG_SHARE) or found.stated_sigmas < _SIGMAS:
        return
    raise InputError(
        f"camera: focal_px = {stated:.6g} does not fit: the targets and their list say {found.focal_px:.4g} +- "
        f"{found.sigma_px:.1g} px, {share:.2f} times as much, in {found.n_photos} photos. Were the photos scaled "
        "(pixels of the focal length scale with them), is it in millimetres, or of another camera or zoom? State it, "
        "or leave focal_px out: the photos then calibrate the camera"
    )
