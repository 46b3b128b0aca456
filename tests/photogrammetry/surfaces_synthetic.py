"""Points on known surfaces, with noise of known covariance."""

from collections.abc import Callable

import numpy as np

from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.geometry.surfaces import Quadric
from photogrammetry.surface.design import DesignSurface
from photogrammetry.surface.fitted import SurfacePoints

#: World frame from design frame: far from any axis.
WORLD_FROM_DESIGN = RigidTransform.from_rotation_vector([0.4, -0.5, 0.3], [0.1, 0.2, 5.0])


def design(make: Callable[..., Quadric], *lengths_m: float) -> DesignSurface:
    """Return a design with its vertex at the origin."""
    names = tuple(f"length_{k}_m" for k in range(len(lengths_m)))
    return DesignSurface(make, 1 / np.array(lengths_m), names, RigidTransform.identity())


def grid_xy(n: int = 8, size_m: float = 4.0) -> np.ndarray:
    """Return n x n places, not quite on a grid, shape (n^2, 2)."""
    axis = (np.arange(n) + 0.5) / n - 0.5
    x, y = np.meshgrid(axis, axis)
    wave = 0.2 / n * np.stack([np.sin(7 * x + 3 * y), np.cos(5 * x - 4 * y)], axis=-1)
    return size_m * (np.stack([x, y], axis=-1) + wave).reshape(-1, 2)


def on_surface(surface: DesignSurface, xy: np.ndarray, bump=None) -> np.ndarray:
    """Return points of a surface, raised by ``bump(x, y)``, in the design frame."""
    z = surface.quadric.height(*xy.T)
    return np.column_stack([xy, z if bump is None else z + bump(*xy.T)])


def correlated(points: np.ndarray, sigma_m: float, rng: np.random.Generator, *, inner: bool) -> np.ndarray:
    """Return a joint covariance with correlations; under the inner datum no rigid motion has a variance."""
    count = points.size
    root = sigma_m * (np.eye(count) + 0.1 * rng.standard_normal((count, count)))
    if inner:
        arms = points - points.mean(axis=0)
        motions = np.concatenate([-skew(arms), np.broadcast_to(np.eye(3), (len(arms), 3, 3))], axis=2).reshape(-1, 6)
        root = root - motions @ np.linalg.solve(motions.T @ motions, motions.T @ root)
    return root


def drawn(points: np.ndarray, root: np.ndarray, rng: np.random.Generator) -> SurfacePoints:
    """Return points with one draw of their errors."""
    noise = (root @ rng.standard_normal(root.shape[1])).reshape(-1, 3)
    covariance = root @ root.T
    return SurfacePoints(tuple(f"T{k}" for k in range(len(points))), points + noise, 0.5 * (covariance + covariance.T))
