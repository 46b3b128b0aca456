"""Adjustment of many parameters of which each observation sees a few, by sparse normal equations."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Generic

import numpy as np

from heliogauge.errors import InputError
from heliogauge.gauss_newton import EPSILON, Options, StateT, minimise
from heliogauge.least_squares import Chart
from heliogauge.precision import Facts, assemble
from heliogauge.robust_loss import Loss, Squares, block_lengths
from heliogauge.solution import CovarianceScale, Solution
from heliogauge.validate import BoolArray, FloatArray

if TYPE_CHECKING:
    from scipy import sparse

# Eigenvalues of the scaled normal matrix below this count as zero: 1e-6 in the Jacobian's singular values.
_EIGENVALUE_TOLERANCE = 1e-12
# Up to here all eigenvalues are computed (20 ms), beyond only the smallest.
_DENSE = 200
# A singular normal matrix cannot be factorised; this damping moves a well-determined step by 1e-11 of itself.
_LEAST_DAMPING = 1e-11


@dataclass(frozen=True, slots=True, eq=False)
class SparseProblem(Generic[StateT]):
    """What is observed and what is sought, with sparse derivatives.

    Parameters
    ----------
    names : tuple of str, length n
        Names of the parameters, with units.
    evaluate : callable
        State to whitened residuals, shape (m,), and their derivatives, a scipy sparse array of shape (m, n). The last
        ``n_extra`` rows are priors and constraints.
    chart : Chart
        How a state moves.
    n_extra : int, optional
        Number of rows at the end that no robust loss weakens.
    held : tuple of str, optional
        Parameters that stay at their start value.
    datum : callable, optional
        State to constraint columns, shape (n, d): steps and covariance obey ``columns.T @ step = 0``.

    Raises
    ------
    InputError
        A name is repeated or unknown.
    """

    names: tuple[str, ...]
    evaluate: Callable[[StateT], tuple[FloatArray, "sparse.sparray"]]
    chart: Chart[StateT]
    n_extra: int = 0
    held: tuple[str, ...] = ()
    datum: Callable[[StateT], FloatArray] | None = None

    def __post_init__(self) -> None:
        known = set(self.names)
        if len(known) != len(self.names):
            raise InputError("names: every parameter needs a name of its own")
        unknown = [name for name in self.held if name not in known]
        if unknown:
            raise InputError(f"held: {', '.join(unknown)}: no such parameter")


class SparseSystem:
    """Sparse normal equations in scaled coordinates, bordered by the datum; satisfies `LinearSystem` and `Factorised`.

    Parameters
    ----------
    jacobian : sparse array, shape (m, n)
        Derivatives of the whitened, weighted residuals.
    residuals : ndarray, shape (m,)
        The whitened, weighted residuals.
    constraints : ndarray, shape (n, d)
        Datum columns; d may be 0.
    values : ndarray, shape (n,)
        Values of the parameters, for the rounding error.
    scale_floor : ndarray, shape (n,), optional
        Smallest column scale.
    """

    def __init__(
        self,
        jacobian: "sparse.sparray",
        residuals: FloatArray,
        constraints: FloatArray,
        *,
        values: FloatArray,
        scale_floor: FloatArray | None = None,
    ) -> None:
        from scipy import sparse

        norms = np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=0)).ravel())
        scale = norms if scale_floor is None else np.maximum(norms, scale_floor)
        self.scale: FloatArray = np.where(scale > 0, scale, 1.0)
        scaled = jacobian @ sparse.diags_array(1.0 / self.scale)
        self._jacobian = sparse.csr_array(scaled)
        self._normal = sparse.csc_array(self._jacobian.T @ self._jacobian)
        self._gradient: FloatArray = np.asarray(self._jacobian.T @ residuals)
        directions = constraints / self.scale[:, None]
        # Orthonormal: the border must not decide about the condition of the whole.
        self._border: FloatArray = np.linalg.qr(directions)[0] if constraints.shape[1] else directions
        self.rounding: float = EPSILON * float(np.linalg.norm(self.scale * values))

    def _factor(self, damping: float, border: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Factorise the bordered, damped matrix; returns the solver for right-hand sides of n rows."""
        from scipy import sparse
        from scipy.sparse.linalg import splu

        size, width = self.scale.size, border.shape[1]
        matrix = self._normal + damping * sparse.eye_array(size) if damping else self._normal
        if width:
            matrix = sparse.block_array([[matrix, sparse.csc_array(border)], [sparse.csc_array(border.T), None]])
        factor = splu(sparse.csc_array(matrix), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})

        def solved(right: FloatArray) -> FloatArray:
            padded = np.concatenate([right, np.zeros((width, *right.shape[1:]))])
            return np.asarray(factor.solve(padded)[:size])

        return solved

    def _solved(self, damping: float) -> FloatArray:
        return -self._factor(max(damping, _LEAST_DAMPING), self._border)(self._gradient)

    @cached_property
    def decrement(self) -> float:
        """Length of the residuals that the undamped step would remove."""
        return float(np.sqrt(max(-float(self._gradient @ self._solved(0.0)), 0.0)))

    @property
    def rank(self) -> int:
        """Number of determined directions; found out only after `null_space` was asked for, full before that."""
        known = self.__dict__.get("_lost")
        return int(self.scale.size - self._border.shape[1] - (0 if known is None else known.shape[1]))

    def step(self, damping: float) -> tuple[FloatArray, float]:
        """Return the damped step and the decrease of the cost it promises."""
        along = self._solved(damping)
        seen = self._jacobian @ along
        return along / self.scale, -float(self._gradient @ along) - 0.5 * float(seen @ seen)

    @cached_property
    def _lost(self) -> FloatArray:
        """Null space beyond the datum, by inverse iteration on the scaled normal matrix."""
        from scipy.sparse.linalg import LinearOperator, eigsh

        size, shift = self.scale.size, 1e-9
        if size <= _DENSE:
            return self._lost_dense()
        inverse = self._factor(shift, self._border)
        operator = LinearOperator((size, size), matvec=lambda v: inverse(np.asarray(v).ravel()), dtype=np.float64)
        for count in (8, 64):
            values, vectors = eigsh(operator, k=count, which="LA", v0=1.0 + np.arange(size) / size)
            small = 1.0 / values - shift < _EIGENVALUE_TOLERANCE
            if not small.all():
                return np.asarray(vectors[:, small])
        return self._lost_dense()

    def _lost_dense(self) -> FloatArray:
        values, vectors = np.linalg.eigh(self._normal.toarray() + self._border @ self._border.T)
        return np.asarray(vectors[:, values < _EIGENVALUE_TOLERANCE])

    def null_space(self) -> FloatArray:
        """Return the directions nothing holds, unit length in scaled coordinates."""
        return self._lost

    def cofactor(self) -> FloatArray:
        """Return the (pseudo-)inverse of the normal matrix, shape (n, n), under the datum."""
        return self._cofactor

    @cached_property
    def _cofactor(self) -> FloatArray:
        inverse = self._factor(0.0, np.column_stack([self._border, self._lost]))
        full = inverse(np.eye(self.scale.size)) / self.scale[:, None] / self.scale
        return np.asarray(0.5 * (full + full.T))


@dataclass(frozen=True, slots=True, eq=False)
class _SparseRows:
    residuals: FloatArray
    jacobian: Any
    n_observations: int
    weights: FloatArray
    cost: float
    values: FloatArray
    constraints: FloatArray

    @property
    def n_residuals(self) -> int:
        return self.residuals.size

    @property
    def extra_jacobian(self) -> FloatArray:
        return np.asarray(self.jacobian[self.n_observations :].toarray())

    def system(self, scale_floor: FloatArray | None) -> SparseSystem:
        return self._weighted(np.sqrt(self.weights), scale_floor)

    def factorised(self, root: FloatArray) -> SparseSystem:
        system = self._weighted(root, None)
        system.null_space()
        return system

    def _weighted(self, root: FloatArray, scale_floor: FloatArray | None) -> SparseSystem:
        from scipy import sparse

        jacobian = self.jacobian if (root == 1).all() else sparse.diags_array(root) @ self.jacobian
        return SparseSystem(
            jacobian, self.residuals * root, self.constraints, values=self.values, scale_floor=scale_floor
        )

    def leverages(self, root: FloatArray, system: SparseSystem) -> FloatArray:
        """Gather the few entries of the cofactor matrix that each row needs."""
        cofactor, matrix = system.cofactor(), self.jacobian
        counts = np.diff(matrix.indptr)
        result = np.zeros(self.n_residuals)
        for count in np.unique(counts[counts > 0]):
            # 4 million entries at a time: 32 MB.
            alike = np.nonzero(counts == count)[0]
            for rows in np.array_split(alike, 1 + alike.size * int(count) ** 2 // 4_000_000):
                places = matrix.indptr[rows][:, None] + np.arange(count)
                columns, values = matrix.indices[places], matrix.data[places]
                block = cofactor[columns[:, :, None], columns[:, None, :]]
                result[rows] = np.einsum("ki,kij,kj->k", values, block, values)
        return np.asarray(result * root**2)


@dataclass(frozen=True, slots=True, eq=False)
class _SparseModel(Generic[StateT]):
    problem: SparseProblem[StateT]
    loss: Loss
    block_size: int
    free: BoolArray

    def retract(self, state: StateT, step: FloatArray) -> StateT:
        full = np.zeros(self.free.size)
        full[self.free] = step
        return self.problem.chart.retract(state, full)

    def rows(self, state: StateT) -> _SparseRows:
        from scipy import sparse

        residuals, derivatives = self.problem.evaluate(state)
        n_observations = residuals.size - self.problem.n_extra
        jacobian = sparse.csr_array(derivatives)
        if jacobian.shape != (residuals.size, self.free.size) or n_observations % self.block_size:
            raise InputError(
                f"least squares: residuals {residuals.shape} with {self.problem.n_extra} extra rows, in blocks of "
                f"{self.block_size}, and derivatives {jacobian.shape} do not fit {self.free.size} parameters"
            )
        weights, known = np.ones(residuals.size), residuals[n_observations:]
        cost = 0.5 * float(residuals @ residuals)
        if not isinstance(self.loss, Squares):
            lengths = block_lengths(residuals[:n_observations], self.block_size)
            weights[:n_observations] = np.repeat(self.loss.weight(lengths), self.block_size)
            cost = 0.5 * float(self.loss.rho(lengths).sum() + known @ known)
        if not np.isfinite(jacobian.data).all():
            cost = float("inf")
        datum = self.problem.datum
        constraints = np.zeros((self.free.size, 0)) if datum is None else datum(state)
        values = self.problem.chart.coordinates(state)[self.free]
        if not self.free.all():
            jacobian = sparse.csr_array(jacobian[:, np.nonzero(self.free)[0]])
        return _SparseRows(residuals, jacobian, n_observations, weights, cost, values, constraints[self.free])


def solve_sparse(
    problem: SparseProblem[StateT],
    start: StateT,
    *,
    loss: Loss | None = None,
    block_size: int = 1,
    covariance_scale: CovarianceScale = CovarianceScale.PRIOR,
    options: Options | None = None,
) -> Solution[StateT]:
    """Adjust many parameters with sparse derivatives.

    Parameters
    ----------
    problem : SparseProblem
        What is observed and what is sought.
    start : object
        Start state.
    loss : Loss, optional
        Robust loss of the observations; plain least squares if not given.
    block_size : int, optional
        Number of consecutive residuals that are weakened together.
    covariance_scale : CovarianceScale, optional
        Whether the stated sigmas are believed, or only their ratios.
    options : Options, optional
        How to iterate; ``rank_tolerance`` is not used, the normal matrix resolves singular values down to 1e-6 only.

    Returns
    -------
    Solution
        As from `heliogauge.least_squares.solve`; the covariance is dense, n squared numbers.

    Raises
    ------
    InputError
        The residuals and derivatives do not fit the parameters.
    EstimationError
        The model cannot be evaluated at the start.

    Notes
    -----
    Normal equations square the condition of the problem: use the dense adjustment where parameters are few. A problem
    with block structure plugs its own `LinearSystem` into `heliogauge.gauss_newton.minimise` and, if it likes, its own
    `Factorised` into `heliogauge.precision.assemble`.
    """
    loss = loss or Squares()
    held = frozenset(problem.held)
    model = _SparseModel(problem, loss, block_size, np.array([name not in held for name in problem.names]))
    descent = minimise(start, model.rows, model.retract, options=options)
    facts = Facts(problem.names, model.free, problem.chart.coordinates(descent.state))
    return assemble(descent, facts, loss=(loss, block_size), covariance_scale=covariance_scale)
