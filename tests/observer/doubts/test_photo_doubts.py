"""Photos that are missing, or encoded otherwise than the others: named, and nothing where all is well."""

import numpy as np
import pytest

from heliogauge.doubts import Severity
from observer.doubts.photos import missing_photos_doubt, other_sizes_doubt
from observer.doubts.stated_dimensions import Found, diameter_doubt
from observer.trough.collector import ls2


def names(numbers: list[int]) -> list[str]:
    return [f"DJI_{number:04d}.JPG" for number in numbers]


def test_lost_photos_are_counted_and_placed() -> None:
    said = missing_photos_doubt(names([1, 2, 3, 4, 11, 12, 13, 15]))
    assert said is not None
    assert said.severity is Severity.DOUBT
    assert said.text.startswith("7 of 15 numbers of photos are missing, 6 of them between DJI_0004.JPG and DJI_0011")
    # One of another flight does not hide them.
    other = missing_photos_doubt([*names([1, 2, 3, 4, 11, 12, 13, 15]), "DJI_0099.JPG"])
    assert other is not None
    assert other.text == said.text
    every_second = missing_photos_doubt(names([1, 3, 5, 7, 9]))
    assert every_second is not None
    assert every_second.severity is Severity.NOTE


@pytest.mark.parametrize(
    "given",
    [
        names([7, 8, 9, 10, 11, 12]),
        # Two sorted out by hand of twelve.
        names([1, 2, 4, 5, 6, 7, 8, 10, 11, 12]),
        # Seconds since some day, and names without numbers.
        names([1000, 2000, 3007, 4000]),
        ["a.png", "b.png", "c.png"],
        # Two cameras, or two flights.
        ["A_1.png", "A_9.png", "B_1.png", "B_20.png"],
    ],
)
def test_other_names_are_none(given: list[str]) -> None:
    assert missing_photos_doubt(given) is None


def sizes(off: dict[int, float], seed: int, scatter: float = 0.004) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return twelve targets of any size in ten photos."""
    rng = np.random.default_rng(seed)
    photo, target = (one.ravel() for one in np.mgrid[:10, :12])
    own = np.exp(rng.normal(0, 0.3, 12))[target] * np.exp(scatter * rng.standard_normal(120))
    return photo, target, own * np.exp([off.get(int(k), 0.0) for k in photo])


def test_two_photos_of_another_encoding_are_named() -> None:
    photos = [f"{k}.png" for k in range(10)]
    said = other_sizes_doubt(photos, *sizes({3: -0.05, 4: -0.06}, 0))
    assert said is not None
    assert said.text.startswith("in 3.png, 4.png targets look")
    assert "smaller than in the others" in said.text
    # Half of what the other encoding does, and the same beside a scatter of flights with wind.
    assert other_sizes_doubt(photos, *sizes({3: -0.015}, 0)) is None
    assert [other_sizes_doubt(photos, *sizes({}, seed)) for seed in range(20)] == [None] * 20
    assert other_sizes_doubt(photos, *sizes({3: -0.03}, 0, scatter=0.05)) is None


def test_a_tube_of_another_width_is_no_contradiction_while_the_encoding_is_not_known() -> None:
    found = Found(0.0692, 0.0002)
    assert diameter_doubt(found, ls2()) is not None
    assert diameter_doubt(found, ls2(), encoding_is_clear=False) is None
    assert diameter_doubt(Found(0.066, 0.0002), ls2(), encoding_is_clear=False) is not None
