"""Solar-weighted reflectance: the weights, gaps, bad spectra."""

import numpy as np
import pytest
from scipy.stats import chi2

from calibration.heliostat.performance.reflectance import (
    SolarSpectrum,
    air_mass_1_5,
    solar_weighted,
    weights,
)
from calibration.heliostat.performance.solar_spectrum import WAVELENGTH_NM
from heliogauge.errors import InputError

WAVES = np.arange(280.0, 2501.0, 5.0)


def silver(waves):
    return 0.96 / (1 + np.exp(-(waves - 335) / 9)) - 0.035 * np.exp(-0.5 * ((waves - 1050) / 190) ** 2)


def test_weights_sum_to_one():
    """V-08."""
    assert weights(air_mass_1_5()).sum() == pytest.approx(1.0, abs=1e-12)
    assert solar_weighted(WAVES, np.full((1, WAVES.size), 0.937)).value == pytest.approx(0.937, abs=1e-12)


def test_table_is_that_of_the_standard(shared_data):
    """ASTM G173 at its own 2002 wavelengths, by an integral of its own, against the built-in means over 5 nm."""
    rows = np.genfromtxt(shared_data / "opencsp" / "sun" / "astmg173.csv", delimiter=",", skip_header=2)
    waves, direct = rows[:, 0], rows[:, 3]
    inside = waves <= 2500
    power = np.trapezoid(direct[inside] * silver(waves[inside]), waves[inside])
    whole = np.trapezoid(direct[inside], waves[inside])
    # 0.1 % of the weight is beyond 2500 nm or between the steps.
    assert solar_weighted(WAVES, silver(WAVES)[None]).value == pytest.approx(power / whole, abs=2e-4)
    assert whole == pytest.approx(892.3, abs=0.2)
    own = weights(SolarSpectrum(waves, direct, "G173"))
    np.testing.assert_allclose(own, weights(air_mass_1_5()), atol=2e-5)


def test_table_is_that_of_pvlib():
    pvlib = pytest.importorskip("pvlib")
    table = pvlib.spectrum.get_reference_spectra()["direct"]
    own = weights(SolarSpectrum(table.index.to_numpy(float), table.to_numpy(float), "pvlib"))
    np.testing.assert_allclose(own, weights(air_mass_1_5()), atol=2e-5)


def test_gap_is_named_and_its_sigma_covers():
    """A dip hides in a gap in some of the spectra; the gap's sigma is that of an even distribution."""
    keep = (WAVES < 845) | (WAVES > 905)
    scores = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        waved = silver(WAVES) + 0.05 * np.sin(WAVES / rng.uniform(15, 40) + rng.uniform(0, 6))
        waved = np.clip(waved, 0, 1.05)
        found = solar_weighted(WAVES[keep], waved[None, keep], sigma_instrument=0.0)
        scores.append(
            (found.value - float(weights(air_mass_1_5()) @ np.interp(WAVELENGTH_NM, WAVES, waved))) / found.sigma
        )
    (gap,) = found.gaps
    assert (gap.first_nm, gap.last_nm) == (840.0, 910.0)
    assert 0.04 < gap.share < 0.08
    # The bound is an even distribution over all that is seen beside the gap: never too small.
    assert np.sum(np.square(scores)) < chi2.ppf(1 - 1e-3, 40)
    assert np.max(np.abs(scores)) > 0.1


def test_spectrum_without_lines_of_ultraviolet_has_a_gap_of_little_weight():
    found = solar_weighted(
        np.arange(350.0, 2501.0, 5.0), silver(np.arange(350.0, 2501.0, 5.0))[None], sigma_instrument=0.0
    )
    assert found.gaps[0].first_nm == 280.0
    assert found.gaps[0].share < 0.02


def test_scatter_of_samples_is_the_sigma():
    scores = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        samples = np.clip(silver(WAVES) + rng.normal(0, 0.004, (12, 1)), 0, 1)
        found = solar_weighted(WAVES, samples)
        scores.append((found.value - solar_weighted(WAVES, silver(WAVES)[None]).value) / found.sigma)
        assert found.degrees == pytest.approx(11, rel=0.01)
    # Student's t with 11 degrees has a variance of 11 / 9.
    assert chi2.ppf(1e-3, 60) < np.sum(np.square(scores)) * 9 / 11 < chi2.ppf(1 - 1e-3, 60)


@pytest.mark.parametrize(
    ("waves", "values", "said"),
    [
        (WAVES[::-1], silver(WAVES), "ascending"),
        (WAVES / 1000, silver(WAVES), "nanometres"),
        (WAVES, 100 * silver(WAVES), "_percent"),
        (WAVES, np.full(WAVES.size, np.nan), "without any reading"),
    ],
)
def test_bad_spectra(waves, values, said):
    with pytest.raises(InputError, match=said):
        solar_weighted(waves, values[None])


def test_one_spectrum_alone_has_no_sigma():
    assert np.isnan(solar_weighted(WAVES, silver(WAVES)[None]).sigma)
