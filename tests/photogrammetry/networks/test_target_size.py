"""Targets of one size: eccentricity from two photos, and a stated diameter against the photos."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from photogrammetry.bundle.adjustment import adjust
from photogrammetry.bundle.constraints import Distance
from photogrammetry.bundle.eccentricity import eccentricities_px, estimate_discs
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.networks.target_size import check_sizes, measured_diameters_m
from tests.photogrammetry.bundle_networks import network

RADIUS_M, SHARE = 0.02, 0.01


def scene(seed: int = 0):
    """A network with discs of one size, tilted by up to 20 degrees, and ellipses measured to a percent."""
    rng = np.random.default_rng(seed)
    truth, table = network(rng, 8, 24, sigma_px=0.02)
    normals = rng.normal(0, 0.2, (24, 3)) + (0, 0, 1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shapes = RADIUS_M**2 * (np.eye(3) - normals[:, :, None] * normals[:, None, :])
    ellipses = np.empty((table.n, 2, 2))
    for row, (photo, target) in enumerate(zip(table.photo_index, table.target_index, strict=True)):
        seen = truth.cameras[0].project_posed(truth.points_m[target], truth.cam_from_world(photo))
        exact = seen.d_pixel_d_point @ shapes[target] @ seen.d_pixel_d_point.T
        noise = rng.normal(0, SHARE, (2, 2))
        ellipses[row] = exact + 0.5 * (noise + noise.T) * np.trace(exact)
    return truth, table, ellipses, shapes


def exact_shift(truth, table, shapes):
    """Centre of the ellipse minus image of the centre, from the disc's contour."""
    angles = np.arange(720) * np.pi / 360
    shift = np.empty((table.n, 2))
    for row, (photo, target) in enumerate(zip(table.photo_index, table.target_index, strict=True)):
        values, vectors = np.linalg.eigh(shapes[target])
        axes = vectors[:, 1:] * np.sqrt(values[1:])
        rim = truth.points_m[target] + np.cos(angles)[:, None] * axes[:, 0] + np.sin(angles)[:, None] * axes[:, 1]
        pose, camera = truth.cam_from_world(photo), truth.cameras[0]
        rays = camera.cast_rays(camera.project(pose.apply(rim)))
        x, y = (rays[:, :2] / rays[:, 2:]).T
        conic = np.linalg.svd(np.column_stack([x * x, x * y, y * y, x, y, np.ones_like(x)]))[2][-1]
        a, b, c, d, e, _ = conic
        middle = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
        shift[row] = camera.project(np.append(middle, 1.0)) - camera.project(pose.apply(truth.points_m[target]))
    return shift


def test_two_photos_are_enough_for_targets_of_one_size() -> None:
    truth, table, ellipses, shapes = scene()
    cameras = np.zeros(8, dtype=np.intp)
    first = {}
    keep = []
    for target in table.target_index.tolist():
        first[target] = first.get(target, 0) + 1
        # Targets 0 to 7 in two photos only.
        keep.append(target >= 8 or first[target] <= 2)
    keep = np.array(keep)
    few, own = table.subset(keep), ellipses[keep]
    two = np.isin(few.target_index, np.arange(8))
    wanted = exact_shift(truth, few, shapes)
    free = estimate_discs(few, own, truth, cameras)
    assert not free.known[:8].any()
    sized = estimate_discs(few, own, truth, cameras, one_size=True)
    assert sized.known[:8].sum() >= 6
    np.testing.assert_allclose(sized.radius_m[sized.known], RADIUS_M, rtol=0.01)
    known = two & sized.known[few.target_index]
    left = (eccentricities_px(few, sized, truth, cameras) - wanted)[known]
    assert np.sqrt((left**2).mean()) < 0.35 * np.sqrt((wanted[known] ** 2).mean())
    # The others gain, too.
    many = ~two
    before, after = (
        np.sqrt((((eccentricities_px(few, discs, truth, cameras) - wanted)[many]) ** 2).mean())
        for discs in (free, sized)
    )
    assert after < before


def test_another_size_keeps_its_own() -> None:
    truth, table, ellipses, _ = scene(1)
    large = table.target_index == 3
    ellipses = np.where(large[:, None, None], 4 * ellipses, ellipses)
    discs = estimate_discs(table, ellipses, truth, np.zeros(8, dtype=np.intp), one_size=True)
    assert discs.radius_m[3] == pytest.approx(2 * RADIUS_M, rel=0.02)
    assert np.delete(discs.radius_m, 3) == pytest.approx(RADIUS_M, rel=0.01)


def test_stated_diameter_is_checked() -> None:
    truth, table, ellipses, _ = scene(2)
    length = float(np.linalg.norm(truth.points_m[0] - truth.points_m[9]))
    problem = BundleProblem(table, (CameraModel("camera"),), constraints=(Distance("t0", "t9", length, 1e-4),))
    solved = SimpleNamespace(bundle=adjust(problem, truth))
    measured = (table, ellipses)
    assert measured_diameters_m(solved, *measured) == pytest.approx(2 * RADIUS_M, rel=0.03)
    assert list(check_sizes(solved, *measured, 40.0)) == []
    assert list(check_sizes(solved, *measured, None)) == []
    wrong, *_ = check_sizes(solved, *measured, 20.0)
    assert wrong.code == "target_diameter_contradicts_photos"
    assert wrong.numbers["measured_mm"] == pytest.approx(40, abs=2)
    assert wrong.numbers["stated_mm"] == 20
    large = np.where((table.target_index == 3)[:, None, None], 4 * ellipses, ellipses)
    (odd,) = check_sizes(solved, table, large, 40.0)
    assert (odd.code, odd.numbers["odd_count"]) == ("targets_of_several_sizes", 1)
    # Without a scale nothing can be said.
    free = SimpleNamespace(bundle=adjust(replace(problem, constraints=()), truth))
    assert list(check_sizes(free, *measured, 20.0)) == []
