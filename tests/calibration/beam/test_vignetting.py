"""Fall of the light towards the photo's corners, from an empty target."""

import numpy as np
import pytest

from calibration.beam.light.vignetting import LightFall, light_fall


def drawn(loss: float, seed: int, *, marks: bool = True) -> LightFall:
    """A target of 7 m: panels differ by 1 %, daylight tilts, corners have dark marks; noise of 1 DN of 80."""
    rng = np.random.default_rng(seed)
    axis = np.linspace(-3.5, 3.5, 120)
    x, y = np.meshgrid(axis, axis)
    radius2 = ((x - 0.8) ** 2 + (y + 0.4) ** 2) / 9.0**2
    panels = 1 + 0.01 * rng.standard_normal((6, 6))
    light = 80 * np.repeat(np.repeat(panels, 20, 0), 20, 1) * np.exp(0.02 * x - 0.03 * y - loss * radius2)
    if marks:
        corner = np.maximum(np.abs(x), np.abs(y)) > 3.2
        light = np.where(corner & (np.minimum(np.abs(x), np.abs(y)) > 2.4), 6.0, light)
    found = light_fall(np.rint(light + rng.standard_normal(light.shape)), radius2, axis, axis)
    assert found is not None
    return found


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_loss_is_within_its_sigma(loss: float) -> None:
    scores = np.array([((one := drawn(loss, seed)).per_radius2 - loss) / one.sigma_per_radius2 for seed in range(40)])
    # chi-square of 40: 99.8 % band of its root over the count, wider by t of 5 degrees of freedom (variance 5/3).
    assert 0.55 < np.sqrt(np.mean(scores**2)) < 1.75
    seen = np.mean([drawn(loss, seed).is_seen for seed in range(40)])
    assert seen < 0.1 if loss == 0 else seen > 0.5


def test_marks_are_no_lens() -> None:
    """Dark corners of the target, about 9 % of the corner blocks' light, would be a loss of a third."""
    with_marks, without = (
        np.mean([drawn(0.1, seed, marks=m).per_radius2 for seed in range(10)]) for m in (True, False)
    )
    assert with_marks == pytest.approx(without, abs=0.03)


def test_a_beam_moves_to_where_more_light_passes() -> None:
    """ln V = -k r^2: a Gaussian of variance s^2 moves by s^2 times the gradient."""
    found = drawn(0.3, 1)
    shift = found.shift_m(np.array([2.8, -0.4]), 0.25 * np.eye(2))
    assert shift == pytest.approx([-0.25 * found.per_radius2 * 2 * 2.0 / 81, 0.0], abs=3e-4)


def test_too_little_of_a_target() -> None:
    axis = np.linspace(-1, 1, 60)
    dark = np.zeros((60, 60))
    assert light_fall(dark, dark, axis, axis) is None
