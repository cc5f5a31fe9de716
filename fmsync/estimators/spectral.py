"""The eigenvector relaxation of Singer (2011): a start for every other estimator, and hard to beat at low noise."""

import warnings

import numpy as np
from scipy.linalg import eigh
from scipy.sparse.linalg import LinearOperator, lobpcg

from fmsync import so
from fmsync.estimators import Callback, Estimate, estimator
from fmsync.estimators._groups import check_group
from fmsync.problem import SyncProblem, gradient, neighbour_sums

_BLOCKS_FROM = 600  # matrix size above which a block iteration beats the dense eigensolver


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
    if problem.is_dense and size <= _BLOCKS_FROM:
        return eigh(scale[:, None] * problem.connection * scale, subset_by_index=[size - n, size - 1])[1]

    def multiply(x):  # (N n, m)
        rows = so.transpose((scale[:, None] * x).reshape(problem.n_nodes, n, -1))
        return scale[:, None] * so.transpose(neighbour_sums(problem, rows)).reshape(size, -1)

    operator = LinearOperator((size, size), matvec=lambda x: multiply(x[:, None])[:, 0], matmat=multiply)
    start = np.linalg.qr(multiply(rng.standard_normal((size, n))))[0]
    with warnings.catch_warnings():  # past the recovery threshold there is no gap to converge by; the cost will tell
        warnings.simplefilter("ignore", UserWarning)
        return lobpcg(operator, start, largest=True, tol=tolerance, maxiter=60)[1]


def _common_orientation(blocks: np.ndarray) -> np.ndarray:
    """Flip one shared axis when most blocks are reflections: rounding each alone would tear them apart."""
    if np.sign(np.linalg.det(blocks)).sum() < 0:
        blocks = blocks.copy()
        blocks[:, 0] *= -1  # the same row in every block: a change of gauge, not of any C_i^T C_j
    return blocks
