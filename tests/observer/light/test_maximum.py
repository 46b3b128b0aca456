"""Places of maxima that are known."""

import numpy as np
import pytest

from observer.light.maximum import climb, largest_between


@pytest.mark.parametrize("place", [-0.7, 0.0, 0.31, 0.95])
def test_maximum_between_two_places(place: float) -> None:
    calls = []

    def hill(x: float) -> float:
        calls.append(x)
        return float(np.exp(-((x - place) ** 2)) - 0.1 * (x - place) ** 4)

    assert largest_between(hill, -1.0, 1.0, 1e-6) == pytest.approx(place, abs=1e-5)
    assert all(-1.0 <= x <= 1.0 for x in calls)
    assert len(calls) < 25


def test_maximum_of_a_kink_and_at_a_border() -> None:
    assert largest_between(lambda x: -abs(x - 0.2), -1.0, 1.0, 1e-6) == pytest.approx(0.2, abs=1e-5)
    assert largest_between(lambda x: x, -1.0, 1.0, 1e-6) == pytest.approx(1.0, abs=1e-5)


def test_climb_to_a_crooked_ridge_and_on_a_plateau() -> None:
    def ridge(at: np.ndarray) -> tuple[float, np.ndarray]:
        x, y = at
        off = y - x**2
        return -((1 - x) ** 2) - 20 * off**2, np.array([2 * (1 - x) + 80 * x * off, -40 * off])

    np.testing.assert_allclose(climb(ridge, np.array([-0.5, 1.0]), 1.0), [1.0, 1.0], atol=1e-5)
    start = np.array([0.2, 0.3])
    np.testing.assert_array_equal(climb(lambda at: (1.0, np.zeros(2)), start, 1.0), start)


def test_climb_takes_no_longer_steps() -> None:
    places = []

    def slope(at: np.ndarray) -> tuple[float, np.ndarray]:
        places.append(at)
        return float(-(at @ at)), -2 * at

    np.testing.assert_allclose(climb(slope, np.array([9.0, 0.0]), 0.5), 0.0, atol=1e-6)
    assert np.abs(np.diff([float(np.linalg.norm(one)) for one in places])).max() < 0.5 + 1e-9
