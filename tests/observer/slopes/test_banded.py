"""Banded systems against dense algebra."""

import numpy as np
import pytest

from observer.slopes.banded_cholesky import factorise


@pytest.fixture(params=[(3, 12, 4), (2, 10, 2), (2, 16, 6)])
def systems(request: pytest.FixtureRequest) -> tuple[np.ndarray, np.ndarray]:
    """Return bands and dense matrices of some positive definite systems."""
    count, size, width = request.param
    bands = np.random.default_rng(0).normal(0, 0.3, (count, size, width + 1))
    bands[:, :, 0] = 6.0
    dense = np.zeros((count, size, size))
    for column in range(size):
        bands[:, column, size - column :] = 0.0
        for reach in range(min(width + 1, size - column)):
            dense[:, column + reach, column] = dense[:, column, column + reach] = bands[:, column, reach]
    return bands, dense


def test_solutions_and_determinants(systems: tuple[np.ndarray, np.ndarray]) -> None:
    bands, dense = systems
    factor, rng = factorise(bands), np.random.default_rng(1)
    right = rng.normal(0, 1, (5, *dense.shape[:2]))
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(dense, right[..., None])[..., 0], rtol=1e-10)
    squares = np.einsum("ri,ri->r", right[0], np.linalg.solve(dense, right[0, ..., None])[..., 0])
    np.testing.assert_allclose(factor.squares(right[0]), squares, rtol=1e-10)
    own = rng.normal(0, 1, (*dense.shape[:2], 7))
    np.testing.assert_allclose(factor.solve_many(own.copy()), np.linalg.solve(dense, own), rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(factor.log_determinant, np.linalg.slogdet(dense)[1], rtol=1e-12)


def test_blocks_of_the_inverse(systems: tuple[np.ndarray, np.ndarray]) -> None:
    bands, dense = systems
    width = bands.shape[2] - 1
    blocks, inverse = factorise(bands).inverse_blocks(), np.linalg.inv(dense)
    for i in range(blocks.shape[1]):
        some = slice(i * width, min((i + 1) * width, len(inverse[0])))
        own = some.stop - some.start
        np.testing.assert_allclose(blocks[:, i, :own, :own], inverse[:, some, some], rtol=1e-10, atol=1e-14)


def test_bands_of_the_inverse(systems: tuple[np.ndarray, np.ndarray]) -> None:
    bands, dense = systems
    found, inverse = factorise(bands).inverse_bands(), np.linalg.inv(dense)
    assert found.shape == bands.shape
    for i in range(bands.shape[2]):
        true = np.diagonal(inverse, -i, axis1=1, axis2=2)
        np.testing.assert_allclose(found[:, : true.shape[1], i], true, rtol=1e-10, atol=1e-14)


def test_a_matrix_that_is_not_positive_definite_is_refused() -> None:
    bands = np.ones((2, 4, 3))
    bands[:, :, 0] = 6.0
    bands[1, 0, 0] = -1.0
    with pytest.raises(np.linalg.LinAlgError, match="matrix 1 is not positive definite"):
        factorise(bands)
