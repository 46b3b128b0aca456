"""From pixels to nodes: a plane stays in place, and the sigma is the scatter, on fine and on coarse grids."""

import numpy as np
import pytest

from deflectometry.shape.gridding import GridPlan, default_step_m, grid_slopes
from deflectometry.shape.pixel_slopes import SlopeImage
from deflectometry.shape.smooth_shape import start_surface
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import Camera
from heliogauge.flags import REJECTED, SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, plane
from heliogauge.slopes.map import no_common_modes

SIZE, PITCH_M, SIGMA_RAD = 101, 0.01, 1e-4
CAMERA = Camera(
    width_px=SIZE,
    height_px=SIZE,
    focal_x_px=1000.0,
    focal_y_px=1000.0,
    center_x_px=50.0,
    center_y_px=50.0,
    distortion=BrownDistortion(direction=DistortionDirection.IDEAL_TO_MEASURED),
)
# Face to face at 10 m: a pixel is 10 mm wide, and facet y is up where image rows go down.
POSE = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 10.0]))
FACET = Facet("flat", np.array([[-0.4, -0.4], [0.4, -0.4], [0.4, 0.4], [-0.4, 0.4]]), plane())


def image_of(slope_x, slope_y, flags=None):
    pixel = np.arange(SIZE) * PITCH_M - 0.5
    x, y = np.meshgrid(pixel, -pixel)
    sigma = np.full((SIZE, SIZE), SIGMA_RAD, dtype=np.float32)
    flags = np.zeros((SIZE, SIZE), dtype=np.uint32) if flags is None else flags
    return SlopeImage(0, 0, x, y, slope_x(x, y), slope_y(x, y), sigma, sigma, flags)


def gridded(image, step_m):
    plan = GridPlan(step_m, "facet frame", "nothing")
    found = grid_slopes(image, start_surface(FACET), CAMERA, POSE, FACET, plan=plan, common=no_common_modes())
    return found.slope_map


@pytest.mark.parametrize("step_m", [0.004, 0.013, 0.02, 0.03, 0.04, 0.08])
def test_slopes_stay_where_they_are(step_m):
    """A slope that rises linearly is read at the node itself, over one pixel or over boxes of even or odd width."""
    result = gridded(image_of(lambda x, y: 1e-3 * x, lambda x, y: 2e-3 * y - 1e-3 * x), step_m)
    x, y = np.meshgrid(result.x_m, result.y_m)
    good = result.valid
    assert good[result.aperture].all()
    assert np.abs(result.slope_x - 1e-3 * x)[good].max() < 1e-12
    assert np.abs(result.slope_y - 2e-3 * y + 1e-3 * x)[good].max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("step_m", [0.0037, 0.0093, 0.0213, 0.031, 0.0523])
def test_sigma_of_a_node_is_its_scatter(step_m):
    rng = np.random.default_rng(5)
    maps = [gridded(image_of(*(lambda x, y: rng.normal(0.0, SIGMA_RAD, x.shape),) * 2), step_m) for _ in range(40)]
    good = maps[0].valid
    scatter = np.sqrt(np.mean([one.slope_x[good] ** 2 for one in maps]))
    # 40 maps of 200 and more independent nodes: 2 % at three sigma.
    assert scatter == pytest.approx(np.sqrt(np.mean(maps[0].sigma_random_x[good] ** 2)), rel=0.03)


def test_every_node_without_a_value_says_why():
    flags = np.zeros((SIZE, SIZE), dtype=np.uint32)
    flags[:, 40:52] = np.uint32(SampleFlag.LOW_MODULATION)
    hole = np.where(flags != 0, np.nan, 0.0)
    for step_m in (0.004, 0.02, 0.05):
        result = gridded(image_of(lambda x, y: hole, lambda x, y: hole, flags), step_m)
        missing = result.aperture & ~np.isfinite(result.slope_x)
        assert missing.any()
        assert np.all(result.flags[missing] & np.uint32(REJECTED))
        assert not np.any(result.flags[result.aperture & ~missing] & np.uint32(REJECTED))


def test_grid_has_at_most_a_million_nodes():
    assert default_step_m(1e-6, 1.44) >= 0.0012
    assert default_step_m(0.01412, 1.44) == 0.0056


def test_slopes_that_cannot_be_integrated_keep_their_map():
    """Torn to single pixels a map loses its heights with a warning, never its slopes."""
    lonely = np.zeros((SIZE, SIZE), dtype=bool)
    lonely[::2, ::2] = True
    image = image_of(
        lambda x, y: np.where(lonely, 1e-3, np.nan),
        lambda x, y: np.where(lonely, 0.0, np.nan),
        np.where(lonely, 0, np.uint32(SampleFlag.LOW_MODULATION)).astype(np.uint32),
    )
    plan = GridPlan(PITCH_M, "facet frame", "nothing")
    found = grid_slopes(image, start_surface(FACET), CAMERA, POSE, FACET, plan=plan, common=no_common_modes())
    slope_map, (doubt,) = found.slope_map, found.doubts
    assert doubt.code == "facet_without_heights"
    assert "facet flat has slopes but no height map: height: no two neighbouring" in doubt.text
    assert np.isnan(slope_map.height_m).all()
    assert slope_map.slope_x[slope_map.valid] == pytest.approx(1e-3)
    assert slope_map.valid.sum() > 1000
