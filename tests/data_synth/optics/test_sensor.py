"""The synthetic sensor: noise as stated, rounding, saturation."""

import numpy as np
import pytest

from data_synth.optics.sensor import Sensor
from heliogauge.errors import InputError


def _light(value: float) -> np.ndarray:
    return np.full((400, 500), value, dtype=np.float32)


@pytest.mark.parametrize(("read", "gain"), [(1.0, 0.0), (0.7, 0.03), (3.0, 0.1)])
def test_mean_and_variance_of_the_noise(read, gain):
    sensor = Sensor(bits=8, exposure=0.5, offset_dn=10.0, read_noise_dn=read, shot_gain_dn=gain)
    image = sensor.expose(_light(0.8), np.random.default_rng(0)).astype(float)
    signal = 0.5 * 0.8 * 255
    variance = read**2 + gain * signal + 1 / 12
    n = image.size
    assert image.mean() == pytest.approx(10 + signal, abs=5 * np.sqrt(variance / n))
    assert image.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / n))


def test_no_noise_rounds_to_the_nearest_number():
    sensor = Sensor(exposure=1.0, offset_dn=0.0, read_noise_dn=0.0)
    assert set(sensor.expose(_light(100.4 / 255), np.random.default_rng(0)).ravel()) == {100}


def test_saturation_and_depth():
    rng = np.random.default_rng(0)
    eight = Sensor(exposure=1.5).expose(_light(1.0), rng)
    assert eight.dtype == np.uint8
    assert eight.min() == 255
    sixteen = Sensor(bits=16, exposure=1.5).expose(_light(1.0), rng)
    assert sixteen.dtype == np.uint16
    assert sixteen.min() == 65535
    assert Sensor(bits=12, exposure=1.5).expose(_light(1.0), rng).max() == 4095


def test_exposure_factor_scales_the_signal_only():
    sensor = Sensor(exposure=0.5, offset_dn=8.0)
    light = _light(0.5)
    assert sensor.expected_dn(light, 1.1)[0, 0] - 8 == pytest.approx(
        1.1 * (sensor.expected_dn(light)[0, 0] - 8), rel=1e-6
    )


def test_impossible_sensors_are_refused():
    with pytest.raises(InputError, match="bits"):
        Sensor(bits=7)
    with pytest.raises(InputError, match="read_noise_dn"):
        Sensor(read_noise_dn=-1.0)
    with pytest.raises(InputError, match="exposure"):
        Sensor(exposure=0.0)
