"""Corners in one photo: where its lines of constant x and of constant y cross, with covariance, flag and reason."""

from typing import NamedTuple

import numpy as np

from heliogauge.flags import SampleFlag
from heliogauge.validate import FlagArray, FloatArray
from observer.corners.lattice import PanelLattice
from observer.corners.panel_lines import FittedPose, FoundLine, normal_at
from observer.photo_edges.views import View

#: Both lines must cross under this angle at least (sine): under smaller ones the crossing runs along them.
_LEAST_CROSSING = 0.2

#: A corner is not the drawing's when its distance has this chi-square of two: by chance one of 10^4. What is found
#: instead is an edge of the tube's reflection that runs along a gap.
_FAR = 18.4


class CornerPoints(NamedTuple):
    """Corners of a photo.

    pixels_px (n, 2): Where they are; NaN where flagged [px].
    covariance_px2 (n, 2, 2): Their covariance [px^2].
    flags (n,): Why one is missing: beyond the photo's border, not all of the lines that meet there are seen, or farther
        from the drawing than panels are mounted.
    """

    pixels_px: FloatArray
    covariance_px2: FloatArray
    flags: FlagArray


def corner_points(view: View, lattice: PanelLattice, fitted: FittedPose, motion_sigma_m: float = 0.0) -> CornerPoints:
    """Return the corners of a photo.

    view: Camera and the pose at which the lines were found.
    motion_sigma_m: How far the camera may have flown while it read the photo's rows: the first and the last one show a
        corner from half of that beside the pose, which is no reason to refuse it [m].

    A corner is the mean of the corners of the panels that meet in it. So the lines on both sides of it are carried on
    to it and averaged: panels lie off their places by millimetres, and one side alone would be another point.
    """
    count = len(lattice.corners)
    seen = view.camera.project_posed(lattice.points_m, view.cam_from_frame)
    places = np.arange(count)
    mounted = lattice.covariance_m2.reshape(count, 3, count, 3)[places, :, places]
    mounted_px2 = seen.d_pixel_d_point @ mounted @ np.swapaxes(seen.d_pixel_d_point, 1, 2)
    after = (seen.pixels_px[:, 1] - (view.camera.height_px - 1) / 2) / view.camera.height_px
    moved_px2 = seen.d_pixel_d_point @ np.swapaxes(seen.d_pixel_d_point, 1, 2)
    mounted_px2 = mounted_px2 + np.square(after * motion_sigma_m)[:, None, None] * moved_px2
    pixels = np.full((count, 2), np.nan)
    covariance = np.full((count, 2, 2), np.nan)
    flags = np.zeros(count, dtype=np.uint32)
    sides: dict[tuple[int, int], tuple[list[int], list[int]]] = {corner: ([], []) for corner in lattice.corners}
    for number, line in enumerate(lattice.lines):
        for corner in line.ends:
            if corner in sides:
                sides[corner][line.axis].append(number)
    for k, corner in enumerate(lattice.corners):
        numbers = [number for axis in (0, 1) for number in sides[corner][axis]]
        if not fitted.pieces[numbers].all():
            flags[k] = SampleFlag.CUT_BY_BORDER
            continue
        crossing = _crossing(view, lattice, fitted, corner, sides[corner])
        if crossing is None:
            flags[k] = SampleFlag.PARTLY_COVERED
            continue
        off = crossing[0] - seen.pixels_px[k]
        if float(off @ np.linalg.solve(mounted_px2[k] + crossing[1], off)) > _FAR:
            flags[k] = SampleFlag.OUTLIER
            continue
        pixels[k], covariance[k] = crossing
    return CornerPoints(pixels, covariance, flags)


def _crossing(
    view: View,
    lattice: PanelLattice,
    fitted: FittedPose,
    corner: tuple[int, int],
    sides: tuple[list[int], list[int]],
) -> tuple[FloatArray, FloatArray] | None:
    normals, offsets, variances, place = [], [], [], np.zeros(2)
    for numbers in sides:
        found: list[FoundLine] = [one for number in numbers if (one := fitted.lines[number]) is not None]
        if len(found) < len(numbers):
            return None
        ends = [float(one.line.ends[1] == corner) for one in found]
        # The image of the corner and the line's normal are the same from both sides but for the lens.
        places, normal = normal_at(view, lattice, found[0].line, np.array([ends[0]]))
        place = places[0]
        values = [one.at(share) for one, share in zip(found, ends, strict=True)]
        normals.append(normal[0])
        offsets.append(float(np.mean([value for value, _ in values])))
        variances.append(float(np.sum([variance for _, variance in values])) / len(values) ** 2)
    matrix = np.array(normals)
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < _LEAST_CROSSING:
        return None
    inverse = np.linalg.inv(matrix)
    return place + inverse @ np.array(offsets), inverse @ np.diag(variances) @ inverse.T
