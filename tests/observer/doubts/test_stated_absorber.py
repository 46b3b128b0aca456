"""A tube that photos show elsewhere than a table states it."""

import numpy as np
import pytest

from heliogauge.doubts import Doubt, Severity
from observer.absorber.position import AbsorberSolution, StationFate
from observer.doubts.stated_absorber import stated_absorber_doubt
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

STATIONS_M = np.linspace(-2.0, 2.0, 17)
SEEN_M, STATED_M = 0.4e-3, 0.3e-3


def path(x_m: float, z_m: float, covariance: np.ndarray) -> AbsorberPath:
    return AbsorberPath(STATIONS_M, np.full(17, x_m), np.full(17, 1.49 + z_m), covariance)


def said(
    x_m: float, z_m: float, *, sigma_rad: float = 2e-4, n_modules: int = 1, aperture_m: float = 5.0
) -> Doubt | None:
    """Return the doubt of a tube that is stated beside where it is seen; photos err for all stations alike."""
    alike = np.kron(np.eye(2), np.full((17, 17), SEEN_M**2)) + 1e-12 * np.eye(34)
    fate = np.full(17, StationFate.MEASURED)
    fate[:4] = StationFate.HIDDEN
    seen = AbsorberSolution(path(0.0, 0.0, alike), np.full(17, 9), fate, np.ones(3, bool), 1e-4, 0.07)
    stated = path(x_m, z_m, STATED_M**2 * np.eye(34))
    return stated_absorber_doubt(stated, seen, Collector(aperture_m, 4.4, 1.49, 0.07), sigma_rad, n_modules)


def test_what_chance_explains_is_not_said() -> None:
    # 0.5 mm is the sigma of the difference; of two numbers one in 370 is 3.2 sigma.
    assert said(1.5e-3, -1.5e-3) is None
    assert said(0.0, 1.7e-3) is not None
    assert said(0.0, 1.7e-3, n_modules=100) is None


def test_a_wrong_place_is_named_with_how_far_the_tube_is() -> None:
    found = said(0.005, 0.0)
    assert found is not None
    assert "show the tube -5.0 +- 0.5 mm in x beside where it is stated" in found.text
    assert " in z" not in found.text
    both = said(-0.005, 0.004)
    assert both is not None
    assert "+5.0 +- 0.5 mm in x and -4.0 +- 0.5 mm in z" in both.text


@pytest.mark.parametrize(("x_m", "z_m"), [(0.005, 0.0), (0.0, 0.005)])
def test_slopes_move_as_the_bisector_does(x_m: float, z_m: float) -> None:
    found = said(x_m, z_m, sigma_rad=1e-6)
    x = np.linspace(-2.5, 2.5, 101)
    to = np.stack([-x, 1.49 - x**2 / (4 * 1.49)])
    moved = to + np.array([[x_m], [z_m]])
    # A light comes from straight above: the normal is halfway to the tube.
    before, after = (0.5 * np.arctan2(one[0], one[1]) for one in (to, moved))
    expected = np.sqrt(np.mean((np.tan(after) - np.tan(before)) ** 2))
    assert found is not None
    assert found.numbers["slopes_moved_rad"] == pytest.approx(expected, rel=0.02)


def test_it_is_serious_beyond_the_sigma_of_slopes() -> None:
    found = [said(0.005, 0.0, sigma_rad=sigma) for sigma in (0.5e-3, 5e-3)]
    assert [one.severity for one in found if one] == [Severity.SERIOUS, Severity.DOUBT]
