"""What residuals say where rows scatter less than was stated of them."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.heliostat.diagnosis.linear_model import LinearFit


def _model(stated: float) -> tuple[LinearFit, np.ndarray]:
    """Forty rows that scatter by 0.3 of their sigma, with a term of a third of it in them."""
    rng = np.random.default_rng(4)
    term = rng.standard_normal((80, 1))
    residual = 0.3 * rng.standard_normal(80) + 0.3 * term[:, 0]
    return LinearFit(residual, rng.standard_normal((80, 3)), np.repeat(np.arange(40), 2), 40, 0.3, stated), term


def test_rows_that_scatter_less_than_stated_are_judged_by_the_stated_sigma() -> None:
    model, term = _model(1.0)
    free, freedom = replace(model, stated=0.0).scores(term[None])
    held, _ = model.scores(term[None])
    assert freedom[0] == 1
    # Beyond doubt by their own scatter, nothing unusual by what was stated.
    assert free[0] > 25
    assert held[0] == pytest.approx(0.3**2 * free[0])
    assert model.extended(term).sigmas[0] > 2 * replace(model, stated=0.0).extended(term).sigmas[0]


def test_rows_that_scatter_more_than_stated_are_judged_by_their_scatter() -> None:
    model, term = _model(0.2)
    assert model.scores(term[None])[0] == pytest.approx(replace(model, stated=0.0).scores(term[None])[0])
