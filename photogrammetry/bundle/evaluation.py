"""A bundle adjustment evaluated at one state: its cost, and its normal equations where the descent goes on."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.bundle.rows import BundleModel, CameraRows, ExtraRows
from photogrammetry.bundle.state import BundleState
from photogrammetry.bundle.system import SchurSystem


@dataclass(frozen=True, eq=False)
class BundleRows:
    """Everything evaluated at one state."""

    model: BundleModel
    state: BundleState
    rows: tuple[CameraRows, ...]
    extra: ExtraRows
    _linearised: list[SchurSystem] = field(default_factory=list, init=False, repr=False)

    @cached_property
    def lengths(self) -> FloatArray:
        """Length of each whitened image residual, shape (m,) [sigma]."""
        return np.sqrt(self.squares)

    @cached_property
    def squares(self) -> FloatArray:
        """Squared length of each whitened image residual, shape (m,)."""
        return np.concatenate([np.einsum("rm,rm->m", one.residuals, one.residuals) for one in self.rows])

    @cached_property
    def whitened_residuals(self) -> FloatArray:
        """Predicted minus observed over sigma, in the order of the observations, shape (m, 2)."""
        result = np.empty((self.model.photo.size, 2))
        result[self.model.order] = np.concatenate([one.residuals for one in self.rows], axis=1).T
        return result

    @cached_property
    def cost(self) -> float:
        """Half the sum of the loss; infinite where a target is behind a camera or outside its lens model."""
        known = self.extra.all_residuals
        own = self.squares if self.model.plain else self.model.loss.rho(self.lengths)
        total = 0.5 * float(own.sum() + known @ known)
        return total if np.isfinite(total) else float("inf")

    @property
    def n_residuals(self) -> int:
        """Number of residuals."""
        return 2 * self.model.photo.size + self.extra.all_residuals.size

    @cached_property
    def root(self) -> FloatArray | None:
        """Roots of the weights that the loss leaves, shape (m,); None for all ones."""
        return None if self.model.plain else np.sqrt(self.model.loss.weight(self.lengths))

    def system(self, scale_floor: FloatArray | None) -> SchurSystem:
        """Linearise here."""
        self._linearised[:] = [self.weighted(self.root, scale_floor)]
        return self._linearised[0]

    @property
    def redundancy(self) -> int:
        """Residuals less rank, with the weights that the loss leaves."""
        system = self._linearised[0] if self._linearised else self.weighted(self.root)
        return self.n_residuals - system.rank

    def final_system(self, root: FloatArray | None) -> SchurSystem:
        """Linearise for the covariance, with the factors that the descent ended with where they serve.

        With 1000 photos of 2000 targets each elimination takes ten seconds. Column scales never shrink during the
        descent; larger ones than the own norms make directions look lost, so only those within a factor of two serve.
        """
        if root is None and self.root is None and self._linearised and self._linearised[0].largest_scale_ratio < 2:
            return self._linearised[0]
        return self.weighted(root)

    def weighted(self, root: FloatArray | None, scale_floor: FloatArray | None = None) -> SchurSystem:
        """Linearise here with other roots of weights, shape (m,)."""
        return SchurSystem(self.model, self.state, self.rows, self.extra, root=root, scale_floor=scale_floor)

    def invisible(self) -> BoolArray:
        """Mark image points whose target cannot be seen from its photo, shape (m,), in the model's order."""
        return ~np.isfinite(self.squares)


def evaluate(model: BundleModel, state: BundleState) -> BundleRows:
    """Evaluate residuals and derivatives at a state."""
    return BundleRows(model, state, model.camera_rows(state), model.extra_rows(state))
