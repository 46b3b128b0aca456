"""Slope maps and canting from points: sign and orientation, honesty, gaps."""

import numpy as np
import pytest

from heliogauge.errors import EstimationError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, paraboloid, plane
from heliogauge.slopes.statistics import statistics
from photogrammetry.surface.canting import FacetPoints, facet_canting
from photogrammetry.surface.fit import fit_surface
from photogrammetry.surface.fitted import FitChoices, SurfaceFit, SurfacePoints
from photogrammetry.surface.slopes import Patch, hull_outline, surface_slopes
from tests.photogrammetry.surfaces_synthetic import design, drawn, grid_xy, on_surface

IDENTITY = RigidTransform.identity()
HELD = FitChoices(pose=False)


def exact(points: np.ndarray, surface, choices: FitChoices = HELD, sigma_m: float = 1e-5) -> SurfaceFit:
    count = len(points)
    given = SurfacePoints(tuple(map(str, range(count))), points, sigma_m**2 * np.eye(3 * count))
    return fit_surface(given, surface, IDENTITY, choices)


def everywhere(fit: SurfaceFit, surface, outline=None, name: str = "mirror") -> Patch:
    own = hull_outline(fit.points.points_m[:, :2]) if outline is None else outline
    return Patch(Facet(name, own, surface.quadric), np.ones(len(fit.points.ids), dtype=bool))


@pytest.mark.parametrize("axis", [0, 1])
def test_surface_that_rises_by_one_mrad_has_that_slope_error(axis: int) -> None:
    surface = design(paraboloid, 4.0)
    points = on_surface(surface, grid_xy(), lambda x, y: 1e-3 * (x, y)[axis])
    fit = exact(points, surface)
    found = surface_slopes(fit, [everywhere(fit, surface)]).whole
    errors = [found.slope_error_x[found.valid], found.slope_error_y[found.valid]]
    np.testing.assert_allclose(errors[axis], 1e-3, atol=1e-9)
    np.testing.assert_allclose(errors[1 - axis], 0, atol=1e-9)
    # Heights follow: they are those of the points.
    x, y = np.meshgrid(found.x_m, found.y_m)
    height = surface.quadric.height(x, y) + 1e-3 * (x, y)[axis]
    np.testing.assert_allclose(found.height_m[found.valid], height[found.valid], atol=1e-9)


def test_alignment_takes_the_tilt_out_and_says_so() -> None:
    surface = design(paraboloid, 4.0)
    fit = exact(on_surface(surface, grid_xy(), lambda x, y: 1e-3 * x), surface, FitChoices())
    found = surface_slopes(fit, [everywhere(fit, surface)]).whole
    assert statistics(found).sdx_rad < 2e-5
    assert "best fit" in found.removed


def test_sigma_is_the_scatter_of_noise_and_of_the_local_model() -> None:
    surface, rng = design(paraboloid, 4.0), np.random.default_rng(2)
    truth = on_surface(surface, grid_xy(10), lambda x, y: 2e-4 * np.sin(2 * x) * np.cos(y))
    ratios = []
    for _ in range(12):
        fit = fit_surface(drawn(truth, 2e-5 * np.eye(300), rng), surface, IDENTITY, HELD)
        found = surface_slopes(fit, [everywhere(fit, surface)]).whole
        x, y = np.meshgrid(found.x_m, found.y_m)
        wrong_x = found.slope_error_x - 4e-4 * np.cos(2 * x) * np.cos(y)
        wrong_y = found.slope_error_y + 2e-4 * np.sin(2 * x) * np.sin(y)
        sigma_x, sigma_y = found.sigma_slope()
        ratios += [(wrong_x / sigma_x)[found.valid], (wrong_y / sigma_y)[found.valid]]
    assert np.sqrt(np.mean(np.concatenate(ratios) ** 2)) == pytest.approx(1, abs=0.12)


def test_roughness_between_points_raises_the_sigma() -> None:
    surface, rng = design(plane), np.random.default_rng(3)
    rough = 1e-4 * rng.standard_normal(100)
    fit = exact(on_surface(surface, grid_xy(10), lambda x, y: rough), surface)
    found = surface_slopes(fit, [everywhere(fit, surface)])
    assert found.scatter_m == pytest.approx(1e-4, rel=0.3)
    smooth = exact(on_surface(surface, grid_xy(10)), surface)
    calm = surface_slopes(smooth, [everywhere(smooth, surface)])
    assert np.nanmedian(found.whole.sigma_slope()[0]) > 5 * np.nanmedian(calm.whole.sigma_slope()[0])


def test_nodes_far_from_points_are_not_measured() -> None:
    surface = design(plane)
    xy = grid_xy(12)
    xy = xy[(np.abs(xy) > 0.9).any(axis=1)]
    fit = exact(on_surface(surface, xy), surface)
    outline = np.array([[-3.0, -3], [3, -3], [3, 3], [-3, 3]])
    found = surface_slopes(fit, [everywhere(fit, surface, outline)]).whole
    x, y = np.meshgrid(found.x_m, found.y_m)
    far = (np.maximum(np.abs(x), np.abs(y)) < 0.25) | (np.maximum(np.abs(x), np.abs(y)) > 2.6)
    assert (found.flags[far & found.aperture] == SampleFlag.FAR_FROM_POINTS).all()
    assert not found.valid[far].any()
    ring = (np.maximum(np.abs(x), np.abs(y)) > 1.1) & (np.maximum(np.abs(x), np.abs(y)) < 1.7)
    assert found.valid[ring].all()
    assert 0.3 < found.measured_share < 0.7


def test_slopes_do_not_cross_from_facet_to_facet() -> None:
    surface = design(plane)
    xy = grid_xy(10)
    right = xy[:, 0] > 0
    points = on_surface(surface, xy, lambda x, y: np.where(x > 0, 2e-3 * x, -1e-3 * x + 0.01))
    fit = exact(points, surface)
    halves = [np.array([[0.0, -2], [2, -2], [2, 2], [0, 2]]), np.array([[-2.0, -2], [0, -2], [0, 2], [-2, 2]])]
    patches = [
        Patch(Facet(n, o, surface.quadric), m) for n, o, m in zip(("r", "l"), halves, (right, ~right), strict=True)
    ]
    found = surface_slopes(fit, patches, 0.1)
    for name, slope in (("r", 2e-3), ("l", -1e-3)):
        part = found.patches[name]
        np.testing.assert_allclose(part.slope_error_x[part.valid], slope, atol=1e-9)
    np.testing.assert_array_equal(np.unique(np.sign(found.whole.slope_error_x[found.whole.valid])), [-1, 1])


def test_too_few_points_for_a_map_are_refused() -> None:
    surface = design(plane)
    fit = exact(on_surface(surface, grid_xy(2)), surface)
    with pytest.raises(EstimationError, match="4 points are not enough"):
        surface_slopes(fit, [everywhere(fit, surface)])


@pytest.mark.parametrize("axis", [0, 1])
def test_canting_of_a_facet_that_rises_is_positive(axis: int) -> None:
    surface = design(paraboloid, 50.0).transformed(RigidTransform(np.eye(3), np.array([-3.0, 0, -(3.0**2) / 200])))
    points = on_surface(surface, grid_xy(4, 1.0), lambda x, y: 1e-3 * (x, y)[axis] + 5e-4)
    fit = exact(points, surface)
    facet = Facet("f", np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]), surface.quadric)
    found = facet_canting(fit, FacetPoints(facet, surface, np.ones(16, dtype=bool)))
    assert found.canting[axis] == pytest.approx(1e-3, abs=2e-6)
    assert found.canting[1 - axis] == pytest.approx(0, abs=2e-6)
    assert found.piston_m == pytest.approx(5e-4, abs=5e-6)
    assert found.length_m == pytest.approx(50, rel=2e-3)


def test_canting_of_a_steep_facet_is_the_angle_by_which_it_was_turned() -> None:
    """A facet on a slope of 0.8, turned by 1 mrad about y: its dz/dx changes by 1.64 times as much."""
    steep, turn = (
        RigidTransform.from_rotation_vector([0, angle, 0], np.zeros(3)) for angle in (-np.arctan(0.8), -1e-3)
    )
    surface = design(plane).transformed(steep)
    fit = exact(turn.apply(on_surface(surface, grid_xy(4, 1.0))), surface)
    facet = Facet("f", np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]), surface.quadric)
    found = facet_canting(fit, FacetPoints(facet, surface, np.ones(16, dtype=bool)))
    np.testing.assert_allclose(found.canting, [1e-3, 0.0], rtol=1e-3, atol=1e-9)


@pytest.mark.slow
def test_canting_sigma_is_the_scatter_alignment_included() -> None:
    # Four facets aligned together: an error of one facet's points also turns the frame of the others.
    surface, rng = design(paraboloid, 20.0), np.random.default_rng(8)
    centers = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
    xy = np.concatenate([grid_xy(4, 1.6) + center for center in centers])
    truth = on_surface(surface, xy)
    facets = []
    for k, (x, y) in enumerate(centers):
        outline = np.array([[x - 0.9, y - 0.9], [x + 0.9, y - 0.9], [x + 0.9, y + 0.9], [x - 0.9, y + 0.9]])
        facets.append(FacetPoints(Facet(str(k), outline, surface.quadric), surface, np.arange(64) // 16 == k))
    turns, lengths = [], []
    for _ in range(40):
        fit = fit_surface(drawn(truth, 5e-5 * np.eye(192), rng), surface, IDENTITY, FitChoices(robust=False))
        for facet in facets:
            found = facet_canting(fit, facet)
            turns.append(found.canting / found.sigma_canting_measurement)
            lengths.append((1 / found.length_m - 1 / 20) / (found.sigma_length_m / found.length_m**2))
    assert np.sqrt(np.mean(np.square(turns))) == pytest.approx(1, abs=0.12)
    assert np.sqrt(np.mean(np.square(lengths))) == pytest.approx(0.95, abs=0.15)


def test_facet_with_points_on_a_line_is_refused() -> None:
    surface = design(plane)
    fit = exact(on_surface(surface, np.column_stack([np.arange(5.0), np.zeros(5)])), surface)
    facet = Facet("f", np.array([[0.0, -1], [5, -1], [5, 1]]), surface.quadric)
    with pytest.raises(EstimationError, match="canting of facet f: its 5 points"):
        facet_canting(fit, FacetPoints(facet, surface, np.ones(5, dtype=bool)))
