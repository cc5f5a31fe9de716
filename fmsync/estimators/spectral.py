"""The eigenvector relaxation of Singer (2011): a start for every other estimator, and hard to beat at low noise."""

import numpy as np
from scipy.linalg import eigh

from fmsync import checks, so
from fmsync.block_krylov import block_lanczos, orthonormal_rows
from fmsync.energy import gradient_unchecked as gradient
from fmsync.energy import transposed_sums_unchecked as transposed_sums
from fmsync.estimators.base import GROUPS, Callback, Estimate, estimator, nearest
from fmsync.estimators.spanning_tree import along_tree
from fmsync.problem import SyncProblem

_BLOCKS_FROM = 600  # matrix size above which a block iteration beats the dense eigensolver
_DEPTH, _CYCLES = 12, 8  # products before a restart, which store as many blocks; and how many restarts
_ANY = 0.1  # of the start of a block iteration: a random part
_SINGLE_FROM = 1e-3  # residual that single precision reaches easily


@estimator("spectral")
@checks.checked(group=GROUPS, tolerance=checks.not_negative)
def spectral(
    problem: SyncProblem, *, rng: np.random.Generator, callback: Callback, group: str = "SO", tolerance: float = 1e-6
) -> Estimate:
    r"""Synchronize by the leading eigenvectors of the degree-normalised connection matrix.

    Relaxes :math:`\max\sum w\operatorname{tr}(C_{ij}^\top C_i^\top C_j)` from :math:`SO(n)^N` to orthonormal frames and
    rounds every block to the nearest rotation (Singer 2011, Singer & Wu 2012). Exact for consistent maps; recovers
    something while the mean cosine of the noise exceeds :math:`1/\sqrt{N+1}`.

    The ``group`` ``"SO"`` answers with rotations, ``"O"`` with orthogonal matrices of either determinant; ``tolerance``
    is the residual, of eigenvalues of order 1, at which the block iteration for large problems stops.
    """
    estimate = Estimate.from_absolute(problem, spectral_maps(problem, rng, group, tolerance), "spectral", group)
    callback(0, estimate.absolute, estimate.cost, float(np.linalg.norm(gradient(problem, estimate.absolute))))
    return estimate


def spectral_maps(problem: SyncProblem, rng: np.random.Generator, group: str, tolerance: float) -> np.ndarray:
    """Members of the group (N, n, n): what ``spectral`` answers, in a gauge of its own."""
    n_nodes, n = problem.n_nodes, problem.n
    size, scale = n_nodes * n, np.repeat(problem.degrees**-0.5, n)  # (N n,)
    if size <= max(_BLOCKS_FROM, _DEPTH * n):
        frame = eigh(scale[:, None] * problem.connection * scale, subset_by_index=[size - n, size - 1])[1]  # (N n, n)
    else:  # by blocks, without forming the matrix
        precision = np.float32 if tolerance >= _SINGLE_FROM else np.float64
        rough = scale[:, None].astype(precision)
        maps = problem.maps if problem.is_dense else problem.maps.astype(precision, copy=False)

        def multiply(x: np.ndarray) -> np.ndarray:  # (N n, n)
            sums = transposed_sums(problem, (rough * x).reshape(n_nodes, n, n), maps).reshape(size, n)
            return rough * sums.astype(precision, copy=False)

        start = _rough_eigenvectors(problem, rng, group, scale).astype(precision)
        # past the recovery threshold there is no gap to converge by: the best there is
        frame = block_lanczos(multiply, start, n, lambda values: np.full(n, tolerance), _DEPTH, _CYCLES)[1].T
    blocks = so.transpose(frame.astype(float).reshape(n_nodes, n, n)) / scale.reshape(n_nodes, n)[:, :1, None]
    return nearest(common_orientation(blocks) if group == "SO" else blocks, group)  # up to one frame


def _rough_eigenvectors(problem: SyncProblem, rng: np.random.Generator, group: str, scale: np.ndarray) -> np.ndarray:
    """Orthonormal rows (n, N n): maps along a tree, which on large sparse graphs save up to half of the products.

    A little of a random start keeps every eigenvector within reach, however symmetric the problem.
    """
    size = len(scale)
    tree, _ = orthonormal_rows(along_tree(problem, group).transpose(1, 0, 2).reshape(-1, size) / scale)
    anything, _ = orthonormal_rows(rng.standard_normal(tree.shape))
    return orthonormal_rows(tree + _ANY * anything)[0]


def common_orientation(blocks: np.ndarray) -> np.ndarray:
    """Flip one shared axis when most blocks are reflections: rounding each alone would tear them apart."""
    if np.sign(np.linalg.det(blocks)).sum() < 0:
        blocks = blocks.copy()
        blocks[:, 0] *= -1  # the same row in every block: a change of gauge, not of any C_i^T C_j
    return blocks
