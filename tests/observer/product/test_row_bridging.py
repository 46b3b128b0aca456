"""Values bridged along the trough: against dense algebra, with sigmas that are their scatter, wrong rows found."""

import numpy as np

from observer.product.row_bridging import _smooth, bridge_rows, lone_values

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


def test_what_rows_have_in_common_does_not_hide_the_roughness() -> None:
    rng = np.random.default_rng(4)
    rows, columns, roughness, common, noise = 120, 300, 2e-4, 4e-4, 2e-5
    truth = random_walks(rng, rows, columns, roughness)
    good = np.ones(truth.shape, dtype=bool)
    good[50:62] = False
    # Poses and the slope along the trough move all rows of a column together, and are most of sigma.
    shared = common * rng.standard_normal(columns)
    measured = truth + shared + noise * rng.standard_normal(truth.shape)
    variance = np.full(truth.shape, common**2 + noise**2)
    found = bridge_rows(measured, variance, good, np.zeros(truth.shape, dtype=np.intp), STEP)
    bridged = (found.value - truth - shared)[50:62]
    assert float(np.sqrt(np.mean(bridged**2))) < 2.5e-4
    assert not found.contradicted.any()


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


def test_a_sure_row_that_all_others_contradict_stands_alone() -> None:
    rng = np.random.default_rng(3)
    rows, columns = 120, 40
    truth = random_walks(rng, rows, columns, 2e-4)
    truth[60:] += 4e-3
    panel = np.repeat((np.arange(rows) >= 60).astype(np.intp)[:, None], columns, axis=1)
    # A false edge makes its row the surest of all.
    sigma = np.full(truth.shape, 3e-4)
    sigma[[0, 30, 59, 60]] = 1e-4
    measured = truth + sigma * rng.standard_normal(truth.shape)
    measured[[0, 30, 59, 60], 5:9] += 4e-3
    usable = np.ones(truth.shape, dtype=bool)
    usable[31:33] = usable[100:] = False
    found = lone_values(measured, sigma**2, usable, panel, STEP)
    # What misleads a row somewhere misleads it on the whole panel.
    assert found[[0, 30, 59, 60]].all()
    assert found.sum() < 4 * columns + 0.001 * truth.size
    assert not found[~usable].any()


def test_steep_and_bent_columns_stand_not_alone() -> None:
    # As far as a panel's slope goes within a step of the rows: 10 mrad / m, bent by 30 mrad / m^2.
    y = STEP * np.arange(100)[:, None]
    value = np.broadcast_to(10e-3 * y + 15e-3 * y**2, (100, 3))
    sigma = np.full(value.shape, 1e-6)
    whole = np.ones(value.shape, dtype=bool)
    assert not lone_values(value, sigma**2, whole, whole.astype(np.intp), STEP).any()
    few = whole.copy()
    few[2:] = False
    assert not lone_values(value, sigma**2, few, whole.astype(np.intp), STEP).any()
    assert not lone_values(value[:1], sigma[:1] ** 2, whole[:1], whole[:1].astype(np.intp), STEP).any()


def test_rows_far_apart_are_not_foretold_along_straight_lines() -> None:
    # Slopes of a panel with waves of 3 m, in rows of 0.2 m as a Monte Carlo has them.
    y = 0.2 * np.arange(40)[:, None]
    value = np.broadcast_to(3e-3 * np.sin(2 * np.pi * y / 3.0), (40, 3))
    sigma, whole = np.full(value.shape, 1e-5), np.ones(value.shape, dtype=bool)
    assert lone_values(value, sigma**2, whole, np.zeros(value.shape, dtype=np.intp), STEP).any()
    assert not lone_values(value, sigma**2, whole, np.zeros(value.shape, dtype=np.intp), 0.2).any()
