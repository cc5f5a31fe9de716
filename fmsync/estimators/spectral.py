"""The eigenvector relaxation of Singer (2011): a start for every other estimator, and hard to beat at low noise."""

import numpy as np
from scipy.linalg import eigh

from fmsync import so
from fmsync.estimators import Callback, Estimate, estimator
from fmsync.estimators._groups import check_group
from fmsync.problem import SyncProblem, gradient, neighbour_sums

_BLOCKS_FROM = 600  # matrix size above which a block iteration beats the dense eigensolver
_DEPTH, _CYCLES = (
    8,
    12,
)  # products between two Rayleigh–Ritz steps, which store as many blocks; and how many such cycles


@estimator("spectral")
def spectral(
    problem: SyncProblem,
    *,
    rng: np.random.Generator,
    callback: Callback,
    group: str = "SO",
    tolerance: float = 1e-6,
) -> Estimate:
    r"""Synchronize by the leading eigenvectors of the degree-normalised connection matrix.

    Relaxes :math:`\max\sum w\operatorname{tr}(C_{ij}^\top C_i^\top C_j)` from SO(n)^N to orthonormal frames and rounds
    every block to the nearest rotation (Singer 2011, Singer & Wu 2012). Exact for consistent maps; recovers something
    while the mean cosine of the noise exceeds :math:`1/\sqrt{N+1}`.

    Parameters
    ----------
    problem
        N nodes, E observed maps (n, n).
    rng
        Draws the start of the block iteration.
    group
        ``"SO"`` answers with rotations, ``"O"`` with orthogonal matrices of either determinant.
    tolerance
        Residual at which the block iteration for large problems stops, of eigenvalues of order 1.

    Returns
    -------
    Estimate
        ``absolute`` (N, n, n).

    Examples
    --------
    >>> import numpy as np, fmsync
    >>> p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
    >>> bool(np.allclose(fmsync.solve(p, "spectral").relative(), np.eye(4)))
    True
    """
    check_group(group)
    n_nodes, n = problem.n_nodes, problem.n
    scale = np.repeat(problem.degrees**-0.5, n)  # (N n,)
    frame = _leading_eigenvectors(problem, scale, rng, tolerance)  # (N n, n)
    blocks = so.transpose(frame.reshape(n_nodes, n, n)) / scale.reshape(n_nodes, n)[:, :1, None]  # C_i up to one frame
    if group == "SO":
        blocks = _common_orientation(blocks)
    estimate = Estimate.from_absolute(problem, blocks, "spectral", group)
    callback(0, estimate.absolute, estimate.cost, float(np.linalg.norm(gradient(problem, estimate.absolute))))
    return estimate


def _leading_eigenvectors(
    problem: SyncProblem, scale: np.ndarray, rng: np.random.Generator, tolerance: float
) -> np.ndarray:
    """Leading n eigenvectors of the normalised connection matrix, (N n, n): dense, or by blocks without forming it."""
    size, n = len(scale), problem.n
    if size <= max(_BLOCKS_FROM, _DEPTH * n):
        return eigh(scale[:, None] * problem.connection * scale, subset_by_index=[size - n, size - 1])[1]

    def multiply(x):  # (N n, m)
        rows = so.transpose((scale[:, None] * x).reshape(problem.n_nodes, n, -1))
        return scale[:, None] * so.transpose(neighbour_sums(problem, rows)).reshape(size, -1)

    return _block_krylov(multiply, np.linalg.qr(rng.standard_normal((size, n)))[0], tolerance)


def _block_krylov(multiply, x: np.ndarray, tolerance: float) -> np.ndarray:
    """Leading eigenvectors (size, n) of a symmetric operator by restarted block Lanczos, from orthonormal x (size, n).

    Past the recovery threshold there is no gap to converge by: after the last cycle the best there is is returned.
    """
    size, n = x.shape
    basis = np.empty((_DEPTH * n, size))  # orthonormal rows
    for _ in range(_CYCLES):
        projected = np.zeros((_DEPTH * n, _DEPTH * n))  # upper triangle of the operator in that basis
        rows = x.T
        for used in range(n, _DEPTH * n + 1, n):
            basis[used - n : used] = rows
            known = basis[:used]
            image = multiply(rows.T).T
            overlap = known @ image.T
            projected[:used, used - n : used] = overlap
            q, coupling = _orthonormal(image.T - known.T @ overlap)
            q, _ = _orthonormal(q - known.T @ (known @ q))  # once more: what was left may have been rounding
            rows = q.T
            combination = np.linalg.eigh(projected[:used, :used], UPLO="U")[1][:, -n:]
            done = np.linalg.norm(coupling @ combination[-n:], axis=0).max() <= tolerance
            if done:
                break
        x = known.T @ combination
        if done:
            break
    return x


def _orthonormal(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """QR of a tall matrix by Cholesky, much faster than Householder's, which takes over where a is near singular."""
    try:
        factor = np.linalg.cholesky(a.T @ a)
    except np.linalg.LinAlgError:
        return np.linalg.qr(a)
    diagonal = np.diagonal(factor)
    if diagonal.min() < 1e-5 * diagonal.max():
        return np.linalg.qr(a)
    return a @ np.linalg.inv(factor).T, factor.T


def _common_orientation(blocks: np.ndarray) -> np.ndarray:
    """Flip one shared axis when most blocks are reflections: rounding each alone would tear them apart."""
    if np.sign(np.linalg.det(blocks)).sum() < 0:
        blocks = blocks.copy()
        blocks[:, 0] *= -1  # the same row in every block: a change of gauge, not of any C_i^T C_j
    return blocks
