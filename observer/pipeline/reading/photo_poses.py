"""A photo's pose from the targets of the list, with codes or without: where the list predicts them, dots get names."""

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from photogrammetry.matching import KnownTargets, ListedTargets, assign_near, assign_targets, provisional_pose
from photogrammetry.pipeline import OnePhoto

#: Fewest targets that name each other: the pose of four fits many a wrong dot.
_LEAST = 5


class PlacedPhoto(NamedTuple):
    """What a photo shows, its dots named as far as the list knows them, and its pose.

    pose: ``cam_from_frame``; None where its targets determine none.
    by_list: Whether too few codes determine it, but the places of other dots do.
    """

    photo: OnePhoto
    pose: RigidTransform | None
    by_list: bool = False


def place_photo(one: OnePhoto, known: KnownTargets, plain: frozenset[str], camera: Camera) -> PlacedPhoto:
    """Find a photo's pose, and which of its dots are listed targets, coded ones that cannot be read among them.

    one: Targets with names by their codes, and all dots.
    known: Listed coordinates.
    plain: Names of listed dots without a code.

    The places of dots alone determine no pose where all listed targets have codes, or several codes are read that are
    not in the list: the next trough of a field has targets in the same places.
    """
    pose = provisional_pose(one.detections, known, camera)
    row = {name: number for number, name in enumerate(known.names)}
    round_ones = np.isfinite(one.ellipses_px2).all(axis=(1, 2))
    strange = np.array([name not in row for name in one.detections.names], dtype=np.bool_) & round_ones
    # Plain dots in what looks like an empty ring all read like one code; several codes belong to something else, unless
    # a pose says which of them stand where a plain dot is listed.
    codes = {name for name, one_is in zip(one.detections.names, strange.tolist(), strict=True) if one_is}
    may_be_plain = bool(plain) and (len(codes) <= 1 or pose is not None)
    strange &= may_be_plain
    nameless = one.detections.chosen(strange).joined(one.dots)
    shapes = np.concatenate([one.ellipses_px2[strange], one.dot_ellipses_px2])
    free = np.flatnonzero(nameless.usable)
    if not free.size or len(row) < _LEAST:
        return PlacedPhoto(one, pose)
    listed = ListedTargets(known.names, known.points_m, np.repeat(known.sigma_m[:, None], 3, axis=1))
    read = [k for k, name in enumerate(one.detections.names) if name in row and one.detections.usable[k]]
    pixels = np.concatenate([one.detections.pixels_px[read], nameless.pixels_px[free]])
    covariance = np.concatenate([one.detections.covariance_px2[read], nameless.covariance_px2[free]])
    target = np.full(len(pixels), -1, dtype=np.intp)
    target[: len(read)] = [row[one.detections.names[k]] for k in read]
    by_list = pose is None
    found = None if pose is None else assign_near(camera, pixels, covariance, listed, pose, read=target)
    if pose is None and (read or may_be_plain):
        with suppress(EstimationError):
            found = assign_targets(camera, pixels, covariance, listed, read=target)
            pose = found.cam_from_list
    if found is None:
        return PlacedPhoto(one, pose)
    which = found.target_of_dot[len(read) :].copy()
    is_plain = np.array([name in plain for name in known.names], dtype=np.bool_)
    which[(free < np.count_nonzero(strange)) & ~is_plain[which]] = -1
    own, left = free[which >= 0], np.setdiff1d(np.arange(len(nameless)), free[which >= 0])
    named = nameless.chosen(own).renamed([known.names[number] for number in which[which >= 0].tolist()])
    # Codes that are not listed stay what they were read as.
    coded, dots = left[left < np.count_nonzero(strange)], left[left >= np.count_nonzero(strange)]
    placed = replace(
        one,
        detections=one.detections.chosen(~strange).joined(named).joined(nameless.chosen(coded)),
        ellipses_px2=np.concatenate([one.ellipses_px2[~strange], shapes[own], shapes[coded]]),
        dots=nameless.chosen(dots),
        dot_ellipses_px2=shapes[dots],
    )
    return PlacedPhoto(placed, pose, by_list)
