r"""Least squares over arbitrary matrices, gauge fixed: the paper's MLE (1)."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from fmsync import checks, energy
from fmsync.estimators.base import Callback, Estimate, Recorder, estimator
from fmsync.problem import SyncProblem
from fmsync.so import transpose


@estimator("mle-unconstrained")
@checks.checked(solver=("exact", "iterative"), tolerance=checks.not_negative, max_iterations=">= 0")
def mle_unconstrained(
    problem: SyncProblem,
    *,
    rng: np.random.Generator,
    callback: Callback,
    solver: str = "exact",
    tolerance: float = 1e-6,
    max_iterations: int = 500,
) -> Estimate:
    r"""Minimise :math:`\sum w\,\lVert C_i C_{ij} - C_j\rVert_F^2` over real matrices with C_1 = I.

    Without the gauge the minimiser is C = 0, whatever was observed. With it this is a linear least-squares problem in
    the blocks of C_2..C_N. The ``solver`` is ``"exact"``, one sparse factorisation, or ``"iterative"``, conjugate
    gradients from a random start, to watch a convergence; ``tolerance`` is then the norm of the gradient at which to
    stop, after ``max_iterations`` steps at most. Answers are arbitrary matrices; ``relative()`` is :math:`C_i^{-1}C_j`.
    """
    n_nodes, n, gram = problem.n_nodes, problem.n, energy.gram_blocks(problem)

    def half_gradient(c: np.ndarray) -> np.ndarray:  # (N-1, n, n): it is linear in C_1..C_N
        return (c @ gram - energy.neighbour_sums_unchecked(problem, c))[1:]

    if solver == "exact":
        checks.unused("with solver='exact'", tolerance=(tolerance, 1e-6), max_iterations=(max_iterations, 500))
        k, b = precision(problem)
        factor = splu(k, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0, options={"SymmetricMode": True})
        solved = transpose(factor.solve(b).reshape(n_nodes - 1, n, n))  # C_2..C_N
        absolute = np.concatenate([np.eye(n)[None], solved])
        cost = float(energy.unconstrained_energy_unchecked(problem, absolute))
        callback(0, absolute, cost, float(2 * np.linalg.norm(half_gradient(absolute))))
        return Estimate(problem, "mle-unconstrained", absolute, cost, on_group=False)
    recorder, absolute = Recorder(callback), rng.standard_normal((n_nodes, n, n)) / np.sqrt(n)
    absolute[0] = np.eye(n)
    residual = -half_gradient(absolute)
    direction, slope = residual, np.vdot(residual, residual)
    for iteration in range(max_iterations + 1):
        norm = 2 * np.sqrt(slope)
        recorder(absolute, float(energy.unconstrained_energy_unchecked(problem, absolute)), norm)
        if norm <= tolerance or iteration == max_iterations:
            break
        curved = half_gradient(np.concatenate([np.zeros((1, n, n)), direction]))
        length = slope / np.vdot(direction, curved)
        absolute = np.concatenate([absolute[:1], absolute[1:] + length * direction])
        residual = residual - length * curved
        slope, old_slope = np.vdot(residual, residual), slope
        direction = residual + (slope / old_slope) * direction
    cost, converged = float(energy.unconstrained_energy_unchecked(problem, absolute)), bool(norm <= tolerance)
    return Estimate(problem, "mle-unconstrained", absolute, cost, converged, recorder.trace(), on_group=False)


def precision(problem: SyncProblem) -> tuple[sp.csc_matrix, np.ndarray]:
    r"""The quadratic form of the gauged energy: :math:`\sum_r x_r^\top K x_r - 2\sum_r b_r^\top x_r + const`.

    x_r stacks row r of C_2..C_N. Returns K, sparse ((N-1) n, (N-1) n), positive definite on a connected graph with
    invertible maps, and b ((N-1) n, n), one column for each row r.
    """
    n_nodes, n = problem.n_nodes, problem.n
    weighted = problem.weights[:, None, None] * problem.maps
    i, j = problem.edges.T
    blocks = np.concatenate([energy.gram_blocks(problem), -weighted, -transpose(weighted)])
    rows, columns = np.concatenate([np.arange(n_nodes), i, j]), np.concatenate([np.arange(n_nodes), j, i])
    a, b = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    entry_rows = (n * rows[:, None, None] + a).ravel()
    entry_columns = (n * columns[:, None, None] + b).ravel()
    whole = sp.csc_matrix((blocks.ravel(), (entry_rows, entry_columns)), shape=(n_nodes * n, n_nodes * n))
    return whole[n:, n:].tocsc(), -whole[n:, :n].toarray()
