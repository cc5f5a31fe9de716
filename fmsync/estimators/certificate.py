"""Was the optimum global? A sufficient test after the fact, and a bound on what could still be gained."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigvalsh
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from fmsync import checks
from fmsync.block_products import products
from fmsync.energy import energy_unchecked as energy
from fmsync.energy import neighbour_sums_unchecked as neighbour_sums
from fmsync.energy import transposed_sums_unchecked as transposed_sums
from fmsync.estimators.base import Estimate
from fmsync.problem import SyncProblem
from fmsync.so import sym, transpose
from fmsync.threads import single_threaded_blas

_TOLERANCE = 1e-8  # of the least eigenvalue of D^(-1/2) Q D^(-1/2), D the degrees
_RELATIVE_GAP = 1e-6  # of the energy
_DENSE_UP_TO = 1200  # matrix size; there the dense eigensolver takes about as long as Lanczos


@dataclass(frozen=True)
class Certificate:
    """What :func:`fmsync.certify` found.

    ``certified``: the energy is that of the global minimum over all orthogonal maps, up to a millionth of it and
    rounding; if False the answer may still be right. ``min_eigenvalue``, the least of the certificate matrix, is at
    most 0 at a critical point, up to rounding. The energy is always at most ``gap_bound`` above the global minimum.
    """

    certified: bool
    min_eigenvalue: float
    gap_bound: float


@checks.checked()
def certify(problem: SyncProblem, estimate: Estimate | np.ndarray) -> Certificate:
    r"""Certificate of global optimality of the Euclidean energy over :math:`O(n)^N`, hence over :math:`SO(n)^N`.

    With B the block matrix of the observations and :math:`\Lambda_i = \operatorname{sym}(C_i^\top S_i)`, the matrix
    :math:`Q = \operatorname{blkdiag}(\Lambda) - B` is positive semidefinite only at a global minimum, and always
    :math:`U_E(C) - U_E^\star \le n N \max(0, -\lambda_{\min}(Q))`: orthogonal maps X with the same block sizes have
    :math:`U_E(C) - U_E(X) = -\operatorname{tr}(X^\top Q X)` (Bandeira, Boumal & Singer 2017; Rosen et al. 2019).

    For an estimate on the group, or orthogonal maps (N, n, n). ``certified`` when
    :math:`\lambda_{\min}(D^{-1/2} Q D^{-1/2}) \ge -10^{-8}`, D the degrees, and the gap bound is at most
    :math:`10^{-6}\,U_E + 100\,\varepsilon\, n N d_{\max}`: a tolerance relative to the largest degree alone
    would certify local minima of graphs whose weights differ much.

    >>> import numpy as np, fmsync
    >>> p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
    >>> fmsync.certify(p, fmsync.solve(p)).certified
    True
    """
    absolute = estimate.absolute if isinstance(estimate, Estimate) else np.asarray(estimate, dtype=float)
    n_nodes, n = problem.n_nodes, problem.n
    if absolute.shape != (n_nodes, n, n):
        raise ValueError(f"estimate: expected {(n_nodes, n, n)} for this problem, got {absolute.shape}")
    rest = np.abs(transpose(absolute) @ absolute - np.eye(n)).max((1, 2))
    if not rest.max() < 1e-6:
        raise ValueError(f"estimate: node {np.nanargmax(rest)} is not orthogonal; only estimates on the group qualify")
    with single_threaded_blas():
        least, cost = least_eigenvalue(problem, absolute), float(energy(problem, absolute))
        gap_bound = n * n_nodes * max(0.0, -least)
        if isinstance(estimate, Estimate) and estimate.problem is problem and estimate.lower_bound is not None:
            gap_bound = min(gap_bound, max(0.0, cost - estimate.lower_bound))
        rounding = 100 * np.finfo(float).eps * n * n_nodes * problem.degrees.max()
        certified = gap_bound <= _RELATIVE_GAP * cost + rounding
        # the scaled eigenvalue lies between least / d_min and least / d_max: mostly that decides
        if certified and least < -_TOLERANCE * problem.degrees.min():
            certified = least_eigenvalue(problem, absolute, problem.degrees**-0.5) >= -_TOLERANCE
    return Certificate(bool(certified), least, gap_bound)


def least_eigenvalue(problem: SyncProblem, absolute: np.ndarray, scales: np.ndarray | None = None) -> float:
    r"""Least eigenvalue of S Q S at maps (N, r, n) with orthonormal columns, S of ``scales`` (N,), ones by default.

    With r >= n rows, too, no orthogonal maps cost less than those by more than :math:`n N \max(0, -\lambda_{\min}(Q))`.
    """
    multipliers = sym(transpose(absolute) @ neighbour_sums(problem, absolute))
    scales = np.ones(problem.n_nodes) if scales is None else scales
    multipliers = scales[:, None, None] ** 2 * multipliers
    size = problem.n_nodes * problem.n
    if size <= _DENSE_UP_TO:
        rows = np.repeat(scales, problem.n)
        matrix = -problem.connection * rows * rows[:, None]
        blocks = matrix.reshape(problem.n_nodes, problem.n, problem.n_nodes, problem.n)
        node = np.arange(problem.n_nodes)
        blocks[node, :, node, :] += multipliers
        return float(eigvalsh(matrix, subset_by_index=[0, 0], overwrite_a=True)[0])
    # Lanczos on s I - S Q S: near s a relative tolerance is an absolute one. A start of fixed seed keeps the answer
    # reproducible; eigenvalue 0 has multiplicity n at an optimum, which does no harm to the extreme value.
    shift, apply = shifted_certificate(problem, multipliers, scales)
    operator = LinearOperator((size, size), matvec=lambda x: apply(x.reshape(-1, 1)).ravel(), dtype=float)
    start = np.random.default_rng(0).standard_normal(size)
    try:
        largest = eigsh(operator, k=1, which="LA", tol=1e-12, v0=start, ncv=40, return_eigenvectors=False)[0]
    except ArpackNoConvergence as error:
        raise RuntimeError(f"certify: Lanczos did not converge on a problem of size {size}") from error
    return float(shift - largest)


def shifted_certificate(
    problem: SyncProblem, multipliers: np.ndarray, scales: np.ndarray
) -> tuple[float, Callable[[np.ndarray], np.ndarray]]:
    """A bound s on the norm of S Q S, and the product of s I - S Q S with columns (N n, b)."""
    n_nodes, n = problem.n_nodes, problem.n
    observed = np.sqrt((problem.maps**2).sum((1, 2)).max())  # bounds every operator norm
    largest_row = (scales**2 * problem.degrees).max()  # bounds the norm of the scaled adjacency matrix
    shift = np.linalg.norm(multipliers, ord=2, axis=(1, 2)).max() + observed * largest_row
    by_node = scales[:, None, None]

    def apply(x: np.ndarray) -> np.ndarray:
        blocks = x.reshape(n_nodes, n, -1)
        image = shift * blocks - products(multipliers, blocks) + by_node * transposed_sums(problem, by_node * blocks)
        return image.reshape(x.shape)

    return float(shift), apply
