"""Coupling of eliminated targets: ray by ray, by pairs and as a whole matrix, against the matrix written out."""

import numpy as np
import pytest

from photogrammetry.bundle.coupling import Coupling
from photogrammetry.bundle.factor import DenseFactor
from photogrammetry.bundle.rays import Rays

N_PHOTOS, N_TARGETS, N_INTRINSICS, N_KEPT = 7, 30, 4, 2


def drawn(*, by_pairs):
    """Return a coupling, the same written out, and a factor; the photos are not in the order of their numbers."""
    rng = np.random.default_rng(0)
    seen = rng.uniform(size=(N_PHOTOS, N_TARGETS)) < 0.4
    seen[:, 3] = False  # a target without rays
    seen[2] = False  # a photo without rays
    photos = np.concatenate([np.full(seen[photo].sum(), photo) for photo in (4, 5, 6, 0, 1, 3)])
    slots = np.concatenate([np.nonzero(seen[photo])[0] for photo in (4, 5, 6, 0, 1, 3)])
    rays = Rays(photos, slots, N_PHOTOS, N_TARGETS)
    poses = rng.normal(size=(photos.size, 3, 6))
    intrinsics = rng.normal(size=(N_TARGETS, 3, N_INTRINSICS))
    n_global = 6 * N_PHOTOS + N_INTRINSICS + 3 * N_KEPT
    whole = np.zeros((n_global, N_TARGETS, 3))
    for photo, slot, block in zip(photos, slots, poses, strict=True):
        whole[6 * photo : 6 * photo + 6, slot] = block.T
    whole[6 * N_PHOTOS : 6 * N_PHOTOS + N_INTRINSICS] = np.moveaxis(intrinsics, 2, 0)
    root = rng.normal(size=(n_global, n_global))
    coupling = Coupling(rays, poses, intrinsics, n_global)
    coupling.by_pairs = by_pairs
    return coupling, whole.reshape(n_global, -1), root @ root.T + n_global * np.eye(n_global)


@pytest.mark.parametrize("by_pairs", [False, True])
def test_products_are_those_of_the_matrix(by_pairs, monkeypatch):
    # 17 of the 30 targets at once: the whole matrix is worked on in two pieces.
    monkeypatch.setattr("photogrammetry.bundle.coupling._CHUNK_BYTES", 1.0)
    coupling, whole, _ = drawn(by_pairs=by_pairs)
    rng = np.random.default_rng(1)
    targets, dense = rng.normal(size=(N_TARGETS, 3, 2)), rng.normal(size=(len(whole), 2))
    np.testing.assert_allclose(coupling.gram(), whole @ whole.T, atol=1e-12)
    np.testing.assert_allclose(coupling.times(targets), whole @ targets.reshape(-1, 2), atol=1e-12)
    np.testing.assert_allclose(coupling.turned_times(dense).reshape(-1, 2), whole.T @ dense, atol=1e-12)
    chosen = np.array([7, 0, 29])
    columns = (3 * chosen[:, None] + np.arange(3)).ravel()
    np.testing.assert_array_equal(coupling.columns(chosen), whole[:, columns])


@pytest.mark.parametrize("by_pairs", [False, True])
def test_inverse_at_the_rays_is_that_of_the_matrix(by_pairs, monkeypatch):
    monkeypatch.setattr("photogrammetry.bundle.coupling._CHUNK_BYTES", 1.0)
    coupling, whole, matrix = drawn(by_pairs=by_pairs)
    expected = np.linalg.solve(matrix, whole).reshape(len(matrix), N_TARGETS, 3)
    factor = DenseFactor(matrix.copy())
    solved = coupling.solved(factor)
    rays = coupling.rays
    for place, (photo, slot) in enumerate(zip(rays.photos, rays.slots, strict=True)):
        np.testing.assert_allclose(solved.poses[place].T, expected[6 * photo : 6 * photo + 6, slot], atol=1e-12)
    first = 6 * N_PHOTOS
    np.testing.assert_allclose(np.moveaxis(solved.intrinsics, 2, 0), expected[first : first + N_INTRINSICS], atol=1e-12)
    inner = np.einsum("gei,gej->eij", whole.reshape(expected.shape), expected)
    np.testing.assert_allclose(coupling.inner_of(solved), inner, atol=1e-12)
    np.testing.assert_allclose(coupling.inner(factor), inner, atol=1e-12)


def test_pairs_are_taken_where_few_targets_are_seen_together():
    def chosen(share):
        rng = np.random.default_rng(2)
        photos, slots = np.nonzero(rng.uniform(size=(60, 3000)) < share)
        poses, intrinsics = np.zeros((photos.size, 3, 6)), np.zeros((3000, 3, 0))
        return Coupling(Rays(photos, slots, 60, 3000), poses, intrinsics, 360).by_pairs

    assert chosen(0.05)
    assert not chosen(0.9)
