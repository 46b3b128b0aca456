"""Fringes of one period: orders counted from a point whose place on the display is known."""

import numpy as np
import pytest

from deflectometry.fringes.known_point import KnownDisplayPoint, has_open_orders
from deflectometry.fringes.observation import Observation
from deflectometry.setup.patterns import FringePattern, make_pattern
from heliogauge.doubts import Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.flags import SampleFlag
from tests.deflectometry.fringe_drawing import Scene

DRAWING = Scene(shape=(120, 160), cover=0.8)
ONE_PERIOD = make_pattern((11.3,), (7.7,))


def point_at(row: int, column: int, off: float = 0.0, sigma: float = 0.01) -> KnownDisplayPoint:
    u, v = DRAWING.positions()
    display = np.array([u[row, column] + off, v[row, column] - off])
    return KnownDisplayPoint(np.array([column, row], dtype=float), display, sigma)


def observe(pattern: FringePattern, point: KnownDisplayPoint | None) -> Observation:
    frames = DRAWING.frames(pattern, np.random.default_rng(4))
    return Observation(frames, pattern, known_point=point)


@pytest.mark.parametrize("periods", [(11.3,), (3.9, 15.9), (40.0, 14.1, 5.2)], ids=["one", "two", "three"])
def test_positions_are_those_of_the_display(periods: tuple[float, ...]) -> None:
    pattern = make_pattern(periods, periods)
    found = observe(pattern, point_at(60, 80, off=0.02)).screen_map(DRAWING.mirror())
    u, v = DRAWING.positions()
    good = DRAWING.mirror()
    seen = found.flags[good] == 0
    assert seen.mean() > 0.999
    for place, sigma, truth in ((found.u, found.sigma_u, u), (found.v, found.sigma_v, v)):
        pull = (place[good] - truth[good])[seen] / sigma[good][seen]
        # A wrong order would be tens of sigma off everywhere.
        assert np.std(pull) == pytest.approx(1.0, abs=0.1)
        assert np.abs(np.mean(pull)) < 0.1


def test_parts_that_no_pixels_lead_to_are_left_out() -> None:
    observation = observe(ONE_PERIOD, point_at(60, 40))
    region = DRAWING.mirror()
    region[:, 78:82] = False
    flags = observation.screen_map(region).flags
    assert (flags[region & (np.arange(160) < 78)] == 0).mean() > 0.999
    apart = flags[region & (np.arange(160) > 82)]
    assert ((apart & SampleFlag.FRINGE_ORDER_UNCERTAIN) != 0).all()


def test_a_third_of_a_period_is_the_limit_of_sure_orders() -> None:
    # Half a period in u is 1 / 22.6 = 0.0442, three times 0.01475.
    sure, unsure = point_at(60, 80, sigma=0.0147), point_at(60, 80, sigma=0.0148)
    np.testing.assert_array_equal(sure.sigma_shift(ONE_PERIOD), [0.0, 0.0])
    np.testing.assert_array_equal(unsure.sigma_shift(ONE_PERIOD), [0.0148, 0.0])
    assert sure.doubt(ONE_PERIOD).severity is Severity.NOTE
    assert unsure.doubt(ONE_PERIOD).code == "known_point_uncertain"


def test_orders_of_their_own_need_no_point() -> None:
    assert not has_open_orders(make_pattern((0.9, 15.9), (15.0, 16.0)))
    assert has_open_orders(make_pattern((0.9,), (15.9,)))
    assert has_open_orders(make_pattern((8.0, 16.0), (0.9,)))
    # The same after a third of 4.5 periods, which is a whole period of one set and 4 of the other.
    assert has_open_orders(make_pattern((1.5, 6.0), (0.9,)))
    assert not has_open_orders(make_pattern((1.5, 6.1), (0.9,)))


def test_refused_with_what_to_do() -> None:
    region = DRAWING.mirror()
    with pytest.raises(EstimationError, match=r"not on the mirror.* px away"):
        observe(ONE_PERIOD, KnownDisplayPoint(np.array([2.0, 2.0]), np.array([0.1, 0.1]), 0.01)).screen_map(region)
    with pytest.raises(InputError, match="leave it out"):
        observe(make_pattern((0.9, 5.0), (0.9,)), point_at(60, 80)).screen_map(region)
    # Half a turn from pixel to pixel: noise decides which way.
    noisy = Scene(shape=(120, 160), cover=0.8, noise_dn=40.0, modulation_dn=30.0)
    frames = noisy.frames(make_pattern((80.0,), (7.7,)), np.random.default_rng(1))
    with pytest.raises(EstimationError, match="contradict each other"):
        Observation(frames, make_pattern((80.0,), (7.7,)), known_point=point_at(60, 80)).screen_map(region)
