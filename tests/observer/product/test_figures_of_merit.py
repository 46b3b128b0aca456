"""Figures of a pass: all 20 of Owkes (2012), Table 7.2, and the pass that shows the whole aperture."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.errors import InputError
from observer.photo_edges.reflection_edges import design_misfit
from observer.product.figures_of_merit import flight_figures, reach_needed_m
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import ls2

TABLE_7_2 = {
    15.0: (6.3, 8.1, 20.3, 16.0),
    20.0: (8.4, 6.1, 15.0, 11.9),
    25.0: (10.5, 4.9, 11.9, 9.5),
    30.0: (12.6, 4.1, 9.9, 7.9),
    35.0: (14.7, 3.5, 8.4, 6.7),
}


def straight(height_m: float, n: int = 50) -> np.ndarray:
    return np.stack([np.linspace(-3, 3, n), np.zeros(n), np.full(n, height_m)], axis=1)


@pytest.mark.parametrize("height_m", TABLE_7_2)
def test_table_7_2_as_printed(height_m: float) -> None:
    # The thesis's own uncertainty runs take the LS-2 as 8 m long.
    found = flight_figures(replace(ls2(), length_m=8.0, panel_edges_y_m=()), 4.2e-4, straight(height_m))
    ours = (
        1e3 * found.pixel_on_aperture_m,
        1e3 * found.camera_angle_step_rad,
        np.degrees(found.camera_target_angle_rad),
        np.degrees(found.longitudinal_incidence_rad),
    )
    assert tuple(round(float(value), 1) for value in ours) == TABLE_7_2[height_m]


def test_pixel_on_the_absorber_of_one_place() -> None:
    eyes = np.array([[-7.0, 0.0, 7.0], [7.0, 0.0, 7.0]])
    # D300 with 20 mm from (7, 7): 5.5 um / 20 mm times 8.9 m = 2.45 mm.
    assert flight_figures(ls2(), 5.5e-3 / 20, eyes).pixel_on_absorber_m == pytest.approx(2.45e-3, abs=5e-6)


@pytest.mark.parametrize("slope_error_rad", [0.0, 3e-3])
def test_at_the_reach_needed_the_last_line_of_sight_touches_the_tube(slope_error_rad: float) -> None:
    collector = ls2()
    reach = reach_needed_m(collector, 15.0, slope_error_rad)
    x = np.linspace(-2.5, 2.5, 401)
    points = np.stack([x, np.zeros_like(x), x**2 / (4 * collector.focal_length_m)], axis=1)
    absorber = AbsorberPath.straight(0.0, collector.focal_length_m, 4.0)
    for way in (-1.0, 1.0):
        eyes = np.tile([way * reach, 0.0, 15.0], (x.size, 1))
        found = design_misfit(points, eyes, np.full(x.size, way), collector, absorber)
        # The tube's last edge is beside the line of sight everywhere, and just at the slope error's reach somewhere.
        assert (-way * found.angle_rad).min() == pytest.approx(2 * slope_error_rad, abs=2e-6)


def test_a_camera_below_the_rim_is_refused() -> None:
    with pytest.raises(InputError, match="above the rim"):
        flight_figures(ls2(), 4e-4, straight(1.0))
    with pytest.raises(InputError, match="number of photos"):
        flight_figures(ls2(), 4e-4, straight(15.0, 1))
