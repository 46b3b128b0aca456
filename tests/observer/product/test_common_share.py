"""What cameras and absorber do to the whole map is smooth, also beside supports where nothing is measured."""

import numpy as np

from observer.product.common_share import common_share
from observer.slopes.joint_solution import SlopeErrors


def test_rows_without_edges_do_not_bend_the_modes_beside_them() -> None:
    x, y = np.linspace(-2.5, 2.5, 80), np.linspace(-3.9, 3.9, 60)
    rows = np.arange(0, 60, 2)
    measured = (np.abs(y) > 0.3) & (np.abs(y) < 3.5)
    known = np.where(measured, 1.0, 0.0)[:, None]
    # A tube that lies 0.3 mm aside at one end and lower in the middle: nothing of it where no edge is.
    modes = 1e-4 * known * np.stack([np.outer(y / 4, np.ones(80)), np.outer(1 - (y / 4) ** 2, x / 2.5)])
    random = np.zeros((60, 80, 2, 2))
    random[..., 0, 0] = np.where(known > 0, 1e-5, 7e-3) ** 2
    shared = np.zeros((60, 80, 2))
    shared[..., 0] = np.square(modes).sum(axis=0)
    none = np.zeros((0, rows.size, 80))
    nothing = np.zeros((60, 80, 2)), random, shared, np.zeros(0), np.zeros((0, 0)), rows
    common, rest = common_share(SlopeErrors(*nothing, modes[:, rows], none), (x, y))
    found = common.evaluate(*np.meshgrid(x, y))[:, 0]
    assert np.abs(found - modes)[:, measured].max() < 1e-6
    assert rest[measured].max() < (3e-6) ** 2


def test_more_modes_than_polynomials_have_become_these_with_the_same_covariance() -> None:
    rng = np.random.default_rng(0)
    x, y = np.linspace(-2.5, 2.5, 40), np.linspace(-1.5, 1.5, 12)
    u, v = np.meshgrid(x / 2.5, y / 2.5)
    # Sixty unknowns of which each does a smooth bend of its own.
    modes = 1e-5 * np.einsum("kn,nrx->krx", rng.normal(size=(60, 5)), np.stack([u**0, u, v, u * v, u**2]))
    random = np.zeros((12, 40, 2, 2))
    random[..., 0, 0] = 1e-10
    shared = np.zeros((12, 40, 2))
    shared[..., 0] = np.square(modes).sum(axis=0)
    none = np.zeros((0, 12, 40))
    nothing = np.zeros((12, 40, 2)), random, shared, np.zeros(0), np.zeros((0, 0)), np.arange(12)
    common, rest = common_share(SlopeErrors(*nothing, modes, none), (x, y))
    assert len(common.sources) == 28
    found = common.evaluate(*np.meshgrid(x, y))[:, 0].reshape(28, -1)
    own = modes.reshape(60, -1)
    np.testing.assert_allclose(found.T @ found, own.T @ own, atol=1e-6 * shared.max())
    assert rest.max() < 1e-6 * shared.max()
