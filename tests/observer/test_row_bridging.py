"""Values bridged along the trough: against dense algebra, with sigmas that are their scatter, wrong rows found."""

import numpy as np

from observer.row_bridging import _smooth, bridge_rows

STEP = 0.02


def random_walks(rng: np.random.Generator, rows: int, columns: int, roughness: float) -> np.ndarray:
    bend = rng.standard_normal((rows, columns)) * np.sqrt(roughness * STEP**3)
    return np.cumsum(np.cumsum(bend, axis=0), axis=0) + 1e-3 * rng.standard_normal(columns)


def test_smoothing_is_that_of_dense_algebra() -> None:
    rng = np.random.default_rng(0)
    joined = np.ones(10, dtype=bool)
    joined[5] = False
    value, weight = rng.standard_normal((11, 2)), 1e4 * rng.random((11, 2))
    weight[3] = 0
    smooth, spread = _smooth(value, weight, joined, 2.0, 0.1)
    second = np.diff(np.eye(11), 2, axis=0)[joined[:-1] & joined[1:]]
    for column in range(2):
        normal = np.eye(11) / 0.05**2 + second.T @ second / (2.0 * 0.1**3) + np.diag(weight[:, column])
        np.testing.assert_allclose(smooth[:, column], np.linalg.solve(normal, weight[:, column] * value[:, column]))
        np.testing.assert_allclose(spread[:, column], np.diag(np.linalg.inv(normal)))


def test_sigma_of_bridged_values_is_their_scatter() -> None:
    rng = np.random.default_rng(1)
    rows, columns, roughness, noise = 120, 300, 2e-4, 3e-5
    truth = random_walks(rng, rows, columns, roughness)
    panel = np.zeros((rows, columns), dtype=np.intp)
    good = np.ones((rows, columns), dtype=bool)
    good[50:58] = False
    good[-4:] = False
    measured = truth + noise * rng.standard_normal(truth.shape)
    found = bridge_rows(measured, np.full(truth.shape, noise**2), good, panel, STEP)
    for lost in (slice(50, 58), slice(-4, None)):
        ratio = np.mean((found.value - truth)[lost] ** 2 / found.variance[lost])
        # The nearest values' own variance is not averaged down, so the sigma is on the safe side.
        assert 0.5 < ratio < 1.1, ratio


def test_panels_are_not_bridged_and_wrong_rows_are_found() -> None:
    rng = np.random.default_rng(2)
    rows, columns, noise = 120, 40, 3e-5
    truth = random_walks(rng, rows, columns, 2e-4)
    truth[60:] += 4e-3
    panel = np.repeat((np.arange(rows) >= 60).astype(np.intp)[:, None], columns, axis=1)
    measured = truth + noise * rng.standard_normal(truth.shape)
    measured[30, 5:9] += 1.5e-3
    good = np.ones(truth.shape, dtype=bool)
    good[58:60] = False
    found = bridge_rows(measured, np.full(truth.shape, noise**2), good, panel, STEP)
    assert found.contradicted[30, 5:9].all()
    assert found.contradicted.sum() < 4 + 0.002 * truth.size
    assert np.abs(found.value - truth)[30].max() < 5e-4
    assert np.abs(found.value - truth)[58:60].max() < 1e-3
