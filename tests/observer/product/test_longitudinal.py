"""Slope errors along the trough: closed form of first order, and Owkes (2012), Fig. 5.14."""

import numpy as np
import pytest

from observer.product.longitudinal import error_of_theta_ra
from observer.trough.collector import ls2


@pytest.mark.parametrize("incidence_deg", [0.0, 8.0, -16.0])
def test_error_is_that_of_the_closed_form(incidence_deg: float) -> None:
    incidence, slope_y = np.radians(incidence_deg), 1e-5
    x, error = error_of_theta_ra(ls2(), incidence, slope_y)
    alpha = np.arctan(x / (2 * 1.49))
    np.testing.assert_allclose(error, -0.5 * np.sin(2 * alpha) * np.tan(incidence) * slope_y, atol=1e-10)


def test_five_milliradian_stay_below_half_a_milliradian_up_to_about_15_degrees() -> None:
    # Two sigma of 5 mrad (V7): RMS over the aperture of an LS-2.
    found = [float(np.sqrt(np.mean(error_of_theta_ra(ls2(), np.radians(deg), 5e-3)[1] ** 2))) for deg in (10, 15, 20)]
    assert found[0] < 0.4e-3
    assert found[1] == pytest.approx(0.5e-3, abs=0.05e-3)
    assert found[2] > 0.6e-3
