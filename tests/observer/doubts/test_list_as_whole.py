"""What is said of a list of targets that lies beside the mirror as a whole."""

import numpy as np

from heliogauge.doubts import Severity
from observer.corners.list_beside import ListBeside
from observer.doubts.list_as_whole import list_doubt

SIGMA = np.array([0.6e-3, 0.4e-3, 0.2e-3])


def listed(aside_m: float, up_m: float, lean_rad: float) -> ListBeside:
    return ListBeside(np.array([aside_m, up_m, lean_rad]), SIGMA)


def test_only_what_is_none_of_chance_is_named() -> None:
    assert list_doubt(listed(1.2e-3, -1.2e-3, 0.6e-3), 1e-3, 2e-4) is None
    high = list_doubt(listed(1e-3, 0.0193, 0.3e-3), 1.2e-3, 2.7e-4)
    assert high is not None
    assert "lies 19.3 +- 0.4 mm too high (z); put right, slopes change by 1.2 mrad" in high.text
    both = list_doubt(listed(-0.02, 0.0, -1e-3), 1.2e-3, 2.7e-4)
    assert both is not None
    assert "20.0 +- 0.6 mm too far towards -x and leaning by 1.00 +- 0.20 mrad, too high at -x" in both.text


def test_many_modules_are_not_named_by_chance() -> None:
    beside = listed(0.0, 3.5 * SIGMA[1], 0.0)
    assert list_doubt(beside, 1e-3, 2e-4) is not None
    assert list_doubt(beside, 1e-3, 2e-4, n_modules=100) is None


def test_it_is_serious_where_slopes_are_moved_beyond_their_sigma() -> None:
    found = [list_doubt(listed(0.0, 5e-3, 0.0), moved, 2e-4) for moved in (1.9e-4, 2.1e-4)]
    assert [one.severity for one in found if one] == [Severity.DOUBT, Severity.SERIOUS]


def test_it_is_serious_where_slopes_cannot_be_compared() -> None:
    found = list_doubt(listed(0.0, 5e-3, 0.0), np.nan, 2e-4)
    assert found is not None
    assert found.severity is Severity.SERIOUS
    assert "nan" not in found.text
    assert "slopes_moved_rad" not in found.numbers
