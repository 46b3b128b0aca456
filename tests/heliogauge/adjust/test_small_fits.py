from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit

from heliogauge.adjust.small_fits import Descent, SmallFits, descend

X = np.linspace(0, 4, 30)
TRUE = np.array([[3.0, 0.7], [1.0, 2.5], [5.0, 0.2], [2.0, 1.2]])
STARTS = np.array([[1.0, 1.0], [2.0, 1.0], [1.0, 1.0], [6.0, 6.0]])
HOW = Descent(most_steps=60, first=1e-3, down=0.1, up=10.0)


def model(p):
    bell = np.exp(np.minimum(-p[:, 1, None] * X, 50.0))
    return p[:, :1] * bell, np.stack([bell, -p[:, :1] * X * bell], axis=1)


class Decays:
    """Exponential decays with noise, the places where they were evaluated counted."""

    def __init__(self, seed=0, starts=STARTS):
        rng = np.random.default_rng(seed)
        self.values = model(TRUE)[0] + 0.02 * rng.normal(size=(4, X.size))
        self.weights = rng.uniform(0.2, 1.0, self.values.shape)
        self.evaluated = np.zeros(4, dtype=int)
        residuals, jacobian = self.evaluate(np.arange(4), starts)
        nothing = np.zeros_like(starts)
        self.fits = SmallFits(
            starts.copy(), residuals, jacobian, np.sqrt(self.weights), nothing, nothing.copy(), np.zeros(4, dtype=bool)
        )

    def evaluate(self, rows, parameters):
        self.evaluated[rows] += 1
        values, jacobian = model(parameters)
        return self.values[rows] - values, jacobian

    def descend(self, how=HOW, rows=None, enough=1e-10, allow=None):
        rows = np.arange(4) if rows is None else rows
        descend(self.fits, rows, self.evaluate, lambda step: np.abs(step).max(axis=1) < enough, how, allow)
        return self.fits


def test_each_fit_is_that_of_scipy():
    decays = Decays()
    fits = decays.descend()
    assert fits.settled.all()
    for values, weights, found in zip(decays.values, decays.weights, fits.parameters, strict=True):
        wanted = curve_fit(lambda x, a, b: a * np.exp(-b * x), X, values, p0=found + 0.05, sigma=weights**-0.5)[0]
        np.testing.assert_allclose(found, wanted, rtol=1e-6)


def test_together_is_one_by_one_and_each_stops_by_itself():
    together, alone = Decays(), Decays()
    together.descend()
    for row in range(4):
        alone.descend(rows=np.array([row]))
    np.testing.assert_allclose(together.fits.parameters, alone.fits.parameters, rtol=1e-12)
    np.testing.assert_array_equal(together.evaluated, alone.evaluated)
    assert np.unique(together.evaluated).size > 1


def test_a_fit_that_climbs_needs_persistence():
    far = np.array([[0.3, 6.0]] * 4)
    assert Decays(starts=far).descend().settled.all()
    how = replace(HOW, first=0.0, persistent=False)
    assert not Decays(starts=far).descend(how).settled.any()
    assert Decays(starts=TRUE).descend(how, enough=1e-5).settled.all()


def test_too_few_steps_do_not_settle():
    assert not Decays().descend(replace(HOW, most_steps=2)).settled.any()


def test_last_step_without_an_evaluation():
    how = replace(HOW, gone=1e-2, least=1e-3, linear_below=1e-2)
    full, linear = Decays(), Decays()
    full.descend(enough=1e-5)
    linear.descend(how, enough=1e-5)
    np.testing.assert_allclose(linear.fits.parameters, full.fits.parameters, atol=1e-8)
    np.testing.assert_allclose(linear.fits.residuals, full.fits.residuals, atol=1e-8)
    assert linear.evaluated.sum() < full.evaluated.sum()


def test_a_prior_pulls_by_its_weight():
    decays = Decays()
    decays.fits.prior_mean[:], decays.fits.prior_weights[:] = [4.0, 1.0], [1e9, 0.0]
    fits = decays.descend()
    np.testing.assert_allclose(fits.parameters[:, 0], 4.0, atol=1e-6)
    assert np.ptp(fits.parameters[:, 1]) > 0.1


def test_what_is_not_allowed_is_not_tried():
    tried = []

    def allow(rows, trial):
        tried.append(trial.copy())
        return trial[:, 1] < 1.0

    decays = Decays(starts=np.array([[1.0, 0.9]] * 4))
    fits = decays.descend(allow=allow)
    assert (fits.parameters[:, 1] < 1.0).all()
    np.testing.assert_array_equal(fits.settled, [True, False, True, False])
    assert max(one[:, 1].max() for one in tried) >= 1.0


@pytest.mark.parametrize("ridge", [0.0, 1e-9])
def test_a_direction_that_nothing_holds_does_not_stop_the_others(ridge):
    decays = Decays()
    decays.fits.jacobian[1] = 0.0
    fits = decays.descend(replace(HOW, ridge=ridge), rows=np.array([0, 1, 2]))
    assert fits.settled[[0, 2]].all()
    assert not fits.settled[3]
