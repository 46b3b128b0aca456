"""Closed forms of field sizing; light over a year by rays against closed forms."""

import numpy as np
import pytest

from calibration.heliostat.performance.field_sizing import (
    clear_sky_dni,
    control_interval_s,
    intercept_of_discs,
    mirror_area_m2_per_mw,
)
from calibration.heliostat.performance.year import CAUSES, Aperture, Errors, Mirror, SunYear, YearTrace, gather
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.sun import Site, direction_from_angles, sun_directions
from heliogauge.sunlight.sun_shapes import GaussianSun, PillboxSun


@pytest.mark.parametrize(
    ("error_mrad", "thesis", "geometric"),
    [(0.25, 97.41, 95.84), (0.75, 92.24, 87.54), (1.0, 89.66, 83.4), (2.0, 79.39, 67.10), (5.0, 49.71, 23.16)],
)
def test_intercept_of_discs(error_mrad, thesis, geometric):
    """001 C17 and V-2: 92.24 % as the thesis has it, 87.54 % with the geometry right."""
    found = [100 * intercept_of_discs([1e-3 * error_mrad], width)[0] for width in (6.15e-3, 3.825e-3)]
    assert found == pytest.approx([thesis, geometric], abs=0.06)


def test_mirror_area_and_control_interval():
    """001 C17: 10,098 m^2/MW with 7 hours; 13.75 s for 1 mrad."""
    assert mirror_area_m2_per_mw(7.0) == pytest.approx(10_098, abs=1)
    assert control_interval_s(1e-3) == pytest.approx(13.75, abs=0.01)
    with pytest.raises(InputError, match="0 to 15 hours"):
        mirror_area_m2_per_mw(16.0)


def test_discs_agree_with_drawn_points():
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (400_000, 2))
    points = points[(points**2).sum(axis=1) <= 1]
    for apart in (0.2, 0.9, 1.7):
        drawn = np.mean((points[:, 0] - apart) ** 2 + points[:, 1] ** 2 <= 1)
        # Centres are 2 e apart in circles of radius 2 b.
        assert intercept_of_discs([apart], 1.0)[0] == pytest.approx(drawn, abs=4e-3)


def one_sun():
    """A mirror south of an aperture, the sun right behind the aperture: no astigmatism."""
    position, center = np.array([0.0, -100.0, 0.0]), np.array([0.0, 0.0, 30.0])
    along = (center - position) / np.linalg.norm(center - position)
    year = SunYear(along[None], np.array([1000.0]), "one sun")
    mirror = Mirror(position, 1e-6, 1e-6, float(np.linalg.norm(center - position)))
    return mirror, Aperture(center, -along, 1.0, 1.0, True), year


@pytest.mark.parametrize(
    ("errors", "sigma_rad"),
    [
        (Errors(), 2e-3),
        (Errors(scatter_rad=np.sqrt(2) * 3e-3), np.hypot(2e-3, 3e-3)),
        (Errors(slope_rad=np.sqrt(2) * 1e-3), np.hypot(2e-3, 2e-3)),
    ],
)
def test_gaussian_beam_on_a_round_aperture(errors, sigma_rad):
    """The share within a circle of a Gaussian is 1 - exp(-r^2 / 2 s^2); a slope of the normal counts twice."""
    mirror, aperture, year = one_sun()
    _, found = YearTrace(mirror, aperture, GaussianSun(2e-3), year).intercepts(errors)
    expected = 1 - np.exp(-0.5 * (0.5 / np.hypot(100, 30) / sigma_rad) ** 2)
    assert found.mean() == pytest.approx(expected, abs=5e-3)
    assert found.std(ddof=1) / 2 < 5e-3


def test_offset_moves_the_beam_by_its_angle():
    mirror, aperture, year = one_sun()
    trace = YearTrace(mirror, aperture, PillboxSun(0.5e-3), year)
    edge = 0.5 / np.hypot(100, 30)
    for offset, expected in ((edge - 0.6e-3, 1.0), (edge, 0.48), (edge + 0.6e-3, 0.0)):
        assert trace.intercepts(Errors(offset_rad=(0.0, offset)))[1].mean() == pytest.approx(expected, abs=0.06)


def test_a_flat_facet_of_a_year_gathers_all_energy():
    site = Site(37.0, -2.0, 500.0)
    times = np.datetime64("2026-01-01", "ms") + np.arange(0, 365 * 24) * np.timedelta64(3_600_000, "ms")
    suns = sun_directions(times, site)
    energy = clear_sky_dni(suns)
    year = gather(suns, energy, np.radians(37.0), "clear")
    assert year.energy.sum() == pytest.approx(energy.sum())
    # The mean direction of the light is kept.
    assert year.energy @ year.suns == pytest.approx(energy @ suns, rel=0.02, abs=0.02 * energy.sum())
    # About 3000 to 3500 kWh/m^2 under a sky that is always clear.
    assert 2.8e6 < energy.sum() < 3.6e6
    with pytest.raises(EstimationError, match="no moment"):
        gather(suns, 0 * energy, 0.6, "dark")


def test_air_mass_one_and_two():
    """Meinel: 947 W/m^2 under the zenith; at air mass 2 the exponent is 1.6."""
    found = clear_sky_dni(direction_from_angles([0.0, 0.0, 0.0], np.radians([90.0, 30.0, -1.0])))
    assert found[0] == pytest.approx(1353 * 0.7, rel=1e-3)
    assert found[1] == pytest.approx(1353 * 0.7 ** (2**0.678), rel=2e-3)
    assert found[2] == 0


def test_each_cause_costs_and_removing_it_returns_it():
    mirror, aperture, year = one_sun()
    mirror = Mirror(mirror.position_m, 2.0, 2.0, mirror.focal_length_m, 4)
    trace = YearTrace(mirror, aperture, PillboxSun(), year)
    errors = Errors((0.5e-3, -1e-3), 1.5e-3, 1.2e-3, 0.8e-3)
    base = trace.intercepts(errors)[1].mean()
    for cause in CAUSES:
        assert trace.intercepts(errors.without(cause))[1].mean() > base
        assert trace.intercepts(errors.with_size(cause, errors.size(cause) + 2e-3))[1].mean() < base
        assert errors.with_size(cause, 1e-3).size(cause) == pytest.approx(1e-3)
