"""How large the targets are by the network, against what was stated: a check of both."""

from collections.abc import Iterator

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.validate import FloatArray
from photogrammetry.bundle.constraints import ControlPoint, Coordinate, Distance
from photogrammetry.bundle.eccentricity import estimate_discs
from photogrammetry.image_points import ImagePoints
from photogrammetry.networks.solve_network import Solved

#: Ink spreads and exposure shifts edges: diameters are right to a few percent only.
_DOUBTFUL = 0.05


def measured_diameters_m(solved: Solved, points: ImagePoints, ellipses_px2: FloatArray) -> FloatArray:
    """Return the diameters of the targets as the photos show them.

    solved: The adjusted network.
    ellipses_px2 (m, 2, 2): Ellipses of all image points [px^2].
    Returns (k,): Diameters of those seen in three photos and more, in the order of the network [m].
    """
    bundle = solved.bundle
    table = bundle.problem.observations
    photo = _places(points.photos, table.photos)[points.photo_index]
    target = _places(points.targets, table.targets)[points.target_index]
    rows = np.nonzero((photo >= 0) & (target >= 0))[0]
    seen = ImagePoints(
        table.photos, table.targets, photo[rows], target[rows], points.pixels_px[rows], points.covariance_px2[rows]
    )
    discs = estimate_discs(seen, ellipses_px2[rows], bundle.state, bundle.problem.camera_index)
    return np.asarray(2 * discs.radius_m[discs.known])


def _places(names: tuple[str, ...], known: tuple[str, ...]) -> np.ndarray:
    place = {name: k for k, name in enumerate(known)}
    return np.array([place.get(name, -1) for name in names], dtype=np.intp)


def check_sizes(
    solved: Solved, points: ImagePoints, ellipses_px2: FloatArray, diameter_mm: float | None
) -> Iterator[Doubt]:
    """Compare the stated diameter with what the photos show.

    solved: The adjusted network.
    ellipses_px2 (m, 2, 2): Ellipses of all image points [px^2].
    diameter_mm: What was stated of all targets [mm].
    Yields: What contradicts it; nothing without a scale.
    """
    if diameter_mm is None or not _has_scale(solved):
        return
    found_mm = 1e3 * measured_diameters_m(solved, points, ellipses_px2)
    if not found_mm.size:
        return
    typical = float(np.median(found_mm))
    if abs(typical / diameter_mm - 1) > _DOUBTFUL:
        yield Doubt(
            "target_diameter_contradicts_photos",
            f"the targets measure {typical:.2f} mm across in the photos (median of {found_mm.size}), not diameter_mm = "
            f"{diameter_mm:g}: that, or the scale of the network, is wrong",
            {"measured_mm": typical, "stated_mm": diameter_mm, "targets_count": found_mm.size},
        )
    odd = np.abs(found_mm / typical - 1) > 3 * _DOUBTFUL
    if odd.any():
        yield Doubt(
            "targets_of_several_sizes",
            f"{int(odd.sum())} of {found_mm.size} targets are not as large as the others ({found_mm.min():.2f} to "
            f"{found_mm.max():.2f} mm): diameter_mm is for targets of one size; these are corrected for their own",
            {"odd_count": int(odd.sum()), "targets_count": found_mm.size},
        )


def _has_scale(solved: Solved) -> bool:
    """Whether something in metres fixed the scale."""
    problem = solved.bundle.problem
    known = any(isinstance(one, Distance | ControlPoint | Coordinate) for one in problem.constraints)
    return known or len(problem.fixed) > 1
