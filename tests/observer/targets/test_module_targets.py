"""Which targets belong to a collector, and where they are in its own frame."""

import numpy as np

from observer.targets.module_targets import ListedPlaces, beside, in_frame
from observer.trough.collector import ls2


def listed(places: list[list[float]], sigma_m: float = 1e-3) -> ListedPlaces:
    points = np.array(places)
    return ListedPlaces(tuple(str(k) for k in range(len(points))), points, np.full(points.shape, sigma_m))


def test_a_collector_turned_by_ninety_degrees_looks_along_x() -> None:
    # By the right hand about +y, z goes to x: the focus of a collector turned so is at +x of its place.
    own = in_frame(listed([[5.0 + 1.49, 2.0, 1.0]]), np.array([5.0, 2.0, 1.0]), np.pi / 2)
    np.testing.assert_allclose(own.places_m, [[0.0, 0.0, 1.49]], atol=1e-12)
    np.testing.assert_allclose(own.sigma_m, 1e-3)


def test_sigmas_are_turned_too_and_half_known_places_are_unknown() -> None:
    points = ListedPlaces(("a", "b"), np.zeros((2, 3)), np.array([[1e-3, 2e-3, 3e-3], [np.nan, 2e-3, 3e-3]]))
    own = in_frame(points, np.zeros(3), np.pi / 2)
    np.testing.assert_allclose(own.sigma_m[0], [3e-3, 2e-3, 1e-3])
    assert np.isnan(own.sigma_m[1]).tolist() == [True, False, True]


def test_targets_on_the_rims_belong_to_it_and_those_of_the_next_row_do_not() -> None:
    design = ls2()
    rim = design.aperture_width_m / 2
    points = listed([[rim + 0.1, 0, 1], [-rim - 0.1, 3.9, 1], [7 - rim - 0.1, 0, 1], [0, design.length_m / 2 + 1, 0]])
    assert beside(points, design) == [0, 1]
    unknown = ListedPlaces(points.names, points.places_m, np.full((4, 3), np.nan))
    assert beside(unknown, design) == [0, 1, 2, 3]
