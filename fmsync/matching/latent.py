r"""Functions that all shapes of a collection share, from maps that need be neither consistent nor orthogonal.

Latent functions of a collection are what every map carries over: columns :math:`Y_i` of coefficients on every shape
with :math:`C_{ij} Y_j \approx Y_i` (Wang et al. 2013). Unlike members of a group they may leave out directions that the
shapes do not share, such as half of a pair of eigenfunctions that the cut at n separates, and they need no signs.
Points are compared by the values of these functions (Consistent ZoomOut, Huang et al. 2020).
"""

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh

from fmsync import checks
from fmsync.functional_maps import nearest_rows_unchecked as nearest_rows
from fmsync.matching.samples import SampledShape
from fmsync.so import transpose
from fmsync.threads import single_threaded_blas

_SHARED = 0.9  # of the directions are kept, the most consistent ones
_DENSE_UP_TO = 4000  # matrix size
_STEP, _SETTLE = 5, 2  # functions that each step adds, and steps at the final size


@checks.checked(n_shapes="N >= 2", edges="E 2 < N", maps="E k k")
def latent_maps(n_shapes: int, edges: np.ndarray, maps: np.ndarray) -> np.ndarray:
    r"""Maps :math:`Y_i^\top` (N, M, k) from every shape to the M = 0.9 k directions on which maps (E, k, k) agree best.

    Minimises :math:`\sum w_{ij}\lVert C_{ij} Y_j - Y_i\rVert^2 + w_{ij}\lVert C_{ij}^\top Y_i - Y_j\rVert^2` where
    :math:`\sum d_i Y_i^\top Y_i = \bar d N I`, by eigenvectors. Weights fall with the distance of a map from orthogonal
    ones, :math:`1/\lVert C^\top C - I\rVert^2`, and d sums them at every shape.

    The graph of the ``edges`` (E, 2) must be connected.

    >>> c = np.array([[0.0, -1.0], [1.0, 0.0]])
    >>> y = latent_maps(3, np.array([[0, 1], [1, 2], [0, 2]]), np.array([c, c, c @ c]))
    >>> bool(np.allclose(y[0].T @ y[2], c @ c))
    True
    """
    k = maps.shape[-1]
    squares = transpose(maps) @ maps, maps @ transpose(maps)  # C^T C and C C^T
    weights = 1 / np.maximum(((squares[0] - np.eye(k)) ** 2).sum((1, 2)), 1e-9)
    degrees = np.bincount(edges.ravel(), np.repeat(weights, 2), minlength=n_shapes)
    first, second = edges.T
    diagonal = degrees[:, None, None] * np.eye(k)
    np.add.at(diagonal, first, weights[:, None, None] * squares[1])
    np.add.at(diagonal, second, weights[:, None, None] * squares[0])
    links = -2 * weights[:, None, None] * maps
    rows = np.concatenate([np.arange(n_shapes), first, second])
    columns = np.concatenate([np.arange(n_shapes), second, first])
    blocks = np.concatenate([diagonal, links, transpose(links)])
    blocks /= 2 * np.sqrt(degrees[rows] * degrees[columns])[:, None, None]
    size = n_shapes * k
    shared = max(1, round(_SHARED * k))
    if size <= _DENSE_UP_TO:
        matrix = np.zeros((n_shapes, k, n_shapes, k))
        matrix[rows, :, columns] = blocks  # every pair stands once
        vectors = eigh(matrix.reshape(size, size), subset_by_index=[0, shared - 1])[1]
    else:
        order = np.lexsort((columns, rows))
        starts = np.searchsorted(rows[order], np.arange(n_shapes + 1))
        matrix = sp.bsr_array((blocks[order], columns[order], starts), shape=(size, size))
        start = np.random.default_rng(0).standard_normal(size)  # the answer does not depend on it
        vectors = eigsh(2 * sp.eye_array(size) - matrix, shared, which="LA", v0=start, tol=1e-4)[1]
    scale = np.sqrt(degrees.mean() * n_shapes / degrees)
    return transpose(vectors.reshape(n_shapes, k, shared)) * scale[:, None, None]


def upsample(
    shapes: Sequence[SampledShape], edges: np.ndarray, maps: np.ndarray, sizes: Iterable[int], jobs: int = 1
) -> np.ndarray:
    """Latent maps (N, M, m) with orthonormal rows, m the last of ``sizes``, from maps (E, k, k) of the pairs.

    At every size points are matched by latent functions, in both directions, and the direction whose least-squares map
    is nearer to orthogonal stands for the pair (Huang et al. 2020). A pair's error does not grow: the next latent
    functions are again those on which all agree. With orthonormal rows relative maps are exactly consistent. Pairs are
    matched in ``jobs`` threads, at most one a core.
    """

    def matched(at: list[np.ndarray], back: list[np.ndarray], values: list[np.ndarray]) -> np.ndarray:
        found = pool.map(lambda pair: map_from_values(*([x[k] for k in pair] for x in (at, back, values))), edges)
        return np.array(list(found))

    with single_threaded_blas(), ThreadPoolExecutor(min(jobs, os.cpu_count() or 1)) as pool:
        latent = latent_maps(len(shapes), edges, maps)
        for size in sizes:
            k = latent.shape[-1]
            at = [s.sampled()[:, :size] for s in shapes]
            back = [np.linalg.pinv(phi) for phi in at]
            values = [phi[:, :k] @ y.T for phi, y in zip(at, latent)]  # (S, M) of the latent functions
            latent = latent_maps(len(shapes), edges, matched(at, back, values))
        u, _, vt = np.linalg.svd(latent, full_matrices=False)
    return u @ vt


def map_from_values(at: Sequence[np.ndarray], back: Sequence[np.ndarray], values: Sequence[np.ndarray]) -> np.ndarray:
    """C_ij (m, m) of samples matched by values of shared functions, in the direction that is nearer to orthogonal.

    Of i and j each: basis functions at samples (S, m), their pseudo-inverses, and the values (S, M).
    """
    first, second = (x.astype(np.float32) for x in values)  # enough to tell which sample is nearest
    there, again = nearest_rows(first, second), nearest_rows(second, first)
    both = back[0] @ at[1][there], (back[1] @ at[0][again]).T
    return min(both, key=lambda c: np.linalg.norm(c.T @ c - np.eye(len(c))))


def sizes(k: int, size: int, fast: bool = False) -> list[int]:
    """Sizes of the maps on the way from k to ``size``: five functions more at a time, or with ``fast`` 30 %."""
    found = []
    while (k := round(1.3 * k) if fast else k + _STEP) < size:
        found.append(k)
    return found + [size] * (1 + _SETTLE)
