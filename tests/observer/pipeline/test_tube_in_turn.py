"""In how many photos of a flight each place of the tube is measured."""

import numpy as np

from heliogauge.camera.model import Camera
from observer.photo_edges.views import View
from observer.pipeline.reading.photos import tube_every_of
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.expectation import Expectation
from tests.observer.drawn_tube import looking

CAMERA = Camera(1920, 1080, 2381.0, 2381.0, 959.5, 539.5)
ROWS_M = np.linspace(-3.9, 3.9, 79)
EXPECTED = Expectation(Collector(5.0, 7.89, 1.49, 0.070), AbsorberPath.straight(0.0, 1.49, 3.945), ROWS_M)


def view_of(y_m: float) -> View:
    """Return a camera 15 m above the trough that looks straight down, its longer side along the trough."""
    return View(CAMERA, looking(np.array([0.0, y_m, 15.0]), np.array([0.0, y_m, 0.0]), roll_rad=np.pi / 2))


def test_a_hundred_photos_of_each_place_are_enough() -> None:
    above = [view_of(0.0)] * 3
    shown = np.abs(above[0].project(np.array([[0.0, 3.9, 1.49]])) - [959.5, 539.5])
    assert (shown < [960, 540]).all()
    assert [tube_every_of(count, above, EXPECTED) for count in (31, 61, 199, 200, 400)] == [1, 1, 1, 2, 4]


def test_photos_that_show_little_of_the_tube_count_little() -> None:
    # One photo in five shows the trough, and of a long flight beside it as few as of a short one.
    assert tube_every_of(400, [view_of(0.0), None, None, None, None], EXPECTED) == 1
    assert tube_every_of(1100, [view_of(0.0), None, None, None, None], EXPECTED) == 2
    assert tube_every_of(400, [view_of(40.0)], EXPECTED) == 1
    # Where nothing is known of the photos each measures all.
    assert tube_every_of(400, [], EXPECTED) == 1
