"""The focal length that photos of a list of targets in one plane show, without start values and poses."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray

#: Fewest targets of a photo: four determine the image of a plane, two more contradict a wrong one.
_FEWEST_TARGETS = 6
#: Targets lie in a plane when they are off it by less than this share of their spread; as much it may bend the scale.
_PLANE_SHARE = 0.01
#: Image points this far from where most others have them are of exchanged targets [share of the photo's width].
_OFF_SHARE = 0.005
#: Known is a focal length whose square has a relative sigma below this: 5 % of itself.
_KNOWN_SHARE = 0.1
#: Smaller faults the adjustment finds itself and names with their sigma; an unknown lens puts some per cent into this.
_WRONG_SHARE = 0.2


@dataclass(frozen=True, slots=True)
class FocalOfList:
    """A focal length from planes.

    focal_px, sigma_px: With its standard deviation, from how photos scatter [px].
    n_photos: Photos it rests on.
    """

    focal_px: float
    sigma_px: float
    n_photos: int


def focal_of_list(photos: Iterable[tuple[FloatArray, FloatArray]], camera: Camera) -> FocalOfList | None:
    """Find the focal length with which the images of a plane are those of one whose axes are square and alike.

    photos: Of each the listed places (n, 3) [m] and image points (n, 2) [px] of its targets.
    camera: Gives size, principal point and lens; the result does not depend on its focal length.
    Returns: None where targets are not in one plane, or all photos look straight at it: any focal length fits these.

    With the homography's columns h1, h2 from axes of the plane to the image about the principal point, ``h1' W h2 = 0``
    and ``h1' W h1 = h2' W h2`` with ``W = diag(1/f^2, 1/f^2, 1)`` (Zhang 2000, equations 3 and 4), linear in f^2.
    """
    width = float(camera.width_px)
    flat, deep = [], []
    for places, pixels in photos:
        if len(places) < _FEWEST_TARGETS:
            continue
        away = places - places.mean(axis=0)
        _, spread, axes = np.linalg.svd(away, full_matrices=False)
        if spread[2] > _PLANE_SHARE * spread[0]:
            return None
        rays = camera.cast_rays(pixels)
        image = rays[:, :2] / rays[:, 2:] * (camera.focal_x_px / width)
        if not np.isfinite(image).all():
            continue
        found, kept = cv2.findHomography(away @ axes[:2].T, image, cv2.RANSAC, _OFF_SHARE)
        if np.count_nonzero(kept) < _FEWEST_TARGETS:
            continue
        one, two = found[:, 0], found[:, 1]
        size = 0.5 * (one[:2] @ one[:2] + two[:2] @ two[:2])
        flat += [one[:2] @ two[:2] / size, 0.5 * (one[:2] @ one[:2] - two[:2] @ two[:2]) / size]
        deep += [one[2] * two[2] / size, 0.5 * (one[2] ** 2 - two[2] ** 2) / size]
    if len(flat) < _FEWEST_TARGETS:
        return None
    a, b = np.array(flat), np.array(deep)
    total = float(b @ b)
    square = -float(a @ b) / total if total > 0 else 0.0
    if not square > 0:
        return None
    left = a + square * b
    sigma = float(np.sqrt(left @ left / (a.size - 1) / total))
    if sigma > _KNOWN_SHARE * square:
        return None
    focal = width * float(np.sqrt(square))
    return FocalOfList(focal, 0.5 * focal * sigma / square, a.size // 2)


def refuse_other_focal(found: FocalOfList | None, camera: Camera) -> None:
    """Refuse a camera whose focal length is another one than the targets have, by more than an adjustment mends.

    InputError: By more than a fifth.
    """
    if found is None:
        return
    stated, share = camera.focal_x_px, found.focal_px / camera.focal_x_px
    if abs(np.log(share)) < np.log1p(_WRONG_SHARE) or abs(found.focal_px - stated) < 5 * found.sigma_px:
        return
    raise InputError(
        f"camera: focal_px = {stated:.6g} does not fit: the targets and their list say {found.focal_px:.4g} +- "
        f"{found.sigma_px:.1g} px, {share:.2f} times as much, in {found.n_photos} photos. Were the photos scaled "
        "(pixels of the focal length scale with them), is it in millimetres, or of another camera or zoom? State it, "
        "or leave focal_px out: the photos then calibrate the camera"
    )
