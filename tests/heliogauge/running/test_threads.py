"""Work side by side: results in order, the first error ends it."""

import pytest

from heliogauge.running.threads import side_by_side


def test_results_are_in_order_and_the_first_error_ends_it() -> None:
    assert side_by_side(lambda number: number**2, range(50), jobs=4) == [number**2 for number in range(50)]

    def work(number: int) -> int:
        if number == 3:
            raise ValueError("three")
        return number

    with pytest.raises(ValueError, match="three"):
        side_by_side(work, range(1000), jobs=2)
