"""Where heliostats stand: those of another plant are refused, with what would bring them to theirs."""

import numpy as np
import pytest

from calibration.heliostat.observations.plant import Plant
from heliogauge.errors import InputError
from heliogauge.geometry.sun import Site

PLANT = Plant((50.9134, 6.3878, 87.0), Site(50.9134, 6.3878, 87.0), {})


def test_a_place_in_the_field() -> None:
    """A thousandth of a degree to the north: 111.2 m (a quarter meridian is 10,002 km; 0.1 % for the flattening)."""
    np.testing.assert_allclose(PLANT.place_of(50.9144, 6.3878, 88.0, "H1"), [0.0, 111.2, 1.0], atol=0.12)


@pytest.mark.parametrize(
    ("place", "wanted"),
    [
        ((-50.9144, 6.3878), "with the latitude's sign turned it would stand 0.11 km from it"),
        ((50.9144, -6.3878), "with the longitude's sign turned it would stand 0.11 km"),
        ((-50.9144, -6.3878), "with both signs turned it would stand 0.11 km"),
        ((6.3878, 50.9144), "with latitude and longitude exchanged it would stand 0.11 km"),
        (tuple(np.radians([50.9144, 6.3878]).tolist()), "taken for radians it would stand 0.11 km"),
        ((48.1, 11.6), "it stands 490 km from the plant at 50.9134, 6.3878 deg; nor is it near with the latitude"),
    ],
)
def test_a_place_far_from_it_is_refused(place: tuple[float, float], wanted: str) -> None:
    with pytest.raises(InputError, match=wanted):
        PLANT.place_of(*place, 88.0, "H1")
