r"""Functions that all shapes of a collection share, from maps that need be neither consistent nor orthogonal.

Latent functions of a collection are what every map carries over: columns :math:`Y_i` of coefficients on every shape
with :math:`C_{ij} Y_j \approx Y_i` (Wang et al. 2013). Unlike members of a group they may leave out directions that the
shapes do not share, such as half of a pair of eigenfunctions that the cut at n separates, and they need no signs.
Points are compared by the values of these functions (Consistent ZoomOut, Huang et al. 2020), divided by their norm, as
in spectral clustering (Ng et al. 2001): where poses lengthen skin, values at the end of a limb differ in size, and
small ones are near small ones at the end of any other limb.
"""

import functools
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh
from tqdm import tqdm

from fmsync import checks
from fmsync.functional_maps import nearest_rows_unchecked as nearest_rows
from fmsync.matching.pairwise import geodesic_distortion
from fmsync.matching.rigid import RigidSamples, rigid_map, rigid_samples
from fmsync.matching.samples import SampledShape
from fmsync.so import transpose
from fmsync.threads import single_threaded_blas

_SHARED = 0.9  # of the directions are kept, the most consistent ones
_DENSE_UP_TO = 4000  # matrix size
_GROWN = 20  # functions from which maps grow: beyond them a pair's map is less right than what the others make of it
_STEP, _SETTLE = 5, 2  # functions that each step adds, and steps at the final size
ROUNDS = 8  # of samples that move rigidly
_JUDGES, _CLEAR = 300, 0.05  # samples whose distances tell if rigid motion did harm: a clearly larger change does


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
    shapes: Sequence[SampledShape],
    edges: np.ndarray,
    maps: np.ndarray,
    size: int,
    *,
    fast: bool = False,
    given: bool = False,
    jobs: int = 1,
    progress: bool = False,
) -> np.ndarray:
    """Latent maps (N, M, ``size``) from maps (E, k, k), k <= ``size``, of the pairs (E, 2).

    Points are matched by the :func:`directions` of latent functions, and least-squares maps of the pairs give the next
    latent functions, again those on which all agree: a pair's error does not grow. If all shapes are meshes this is
    done eight times at the full size, and matched samples move as rigidly as possible (:mod:`fmsync.matching.rigid`),
    by turns from i to j and from j to i. If one is a point cloud, or ``fast``, maps grow step by step instead, and of
    both directions the one whose map is nearer to orthogonal stands for the pair (Huang et al. 2020). Maps that were
    ``given`` may be poor, or between mirrored meshes, which are reflected: those of meshes grow first, and what comes
    of moving samples is returned unless it keeps distances clearly worse. Maps that grow start with 20 functions at
    most. Pairs are matched in ``jobs`` threads, at most one a core.
    """
    bodies = [] if fast else rigid_bodies(shapes)
    growing = []
    if given or not bodies:
        maps = maps[:, :_GROWN, :_GROWN]
        growing = sizes(maps.shape[-1], size, fast)
    steps = growing + [size] * (ROUNDS if bodies else 0)

    @functools.lru_cache(maxsize=1)  # the last rounds have one size
    def at_samples(m: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
        at = [s.sampled()[:, :m] for s in shapes]
        return at, [np.linalg.pinv(phi) for phi in at]

    def matched(latent: np.ndarray, m: int, step: int) -> np.ndarray:
        at, back = at_samples(m)
        values = [directions(phi[:, : y.shape[1]] @ y.T) for phi, y in zip(at, latent)]  # (S, M)

        def rigid(i: int, j: int) -> np.ndarray:
            return rigid_map((bodies[i], bodies[j]), back[i], shapes[j], (values[i], values[j]), given)

        def pair_map(e: int) -> np.ndarray:
            i, j = edges[e]
            if step <= len(growing):
                found = map_from_values(*([x[k] for k in (i, j)] for x in (at, back, values)))
            else:
                found = rigid(j, i).T if (e + step + (i < j)) % 2 else rigid(i, j)
            bar.update()
            return found

        return np.array(list(pool.map(pair_map, range(len(edges)))))

    threads, total = min(jobs, os.cpu_count() or 1), len(steps) * len(edges)
    with (
        single_threaded_blas(),
        ThreadPoolExecutor(threads) as pool,
        tqdm(total=total, desc="refinement", disable=not progress) as bar,
    ):
        latent, found = latent_maps(len(shapes), edges, maps), []
        for step, m in enumerate(steps, start=1):
            latent = latent_maps(len(shapes), edges, matched(latent, m, step))
            if step in (len(growing), len(steps)):
                found.append(latent)
        if len(found) == 1:
            return found[0]
        grown, moved = (_distortion(shapes, edges, y) for y in found)
        return found[int(moved < (1 + _CLEAR) * grown)]


def directions(values: np.ndarray) -> np.ndarray:
    """Values (V, M) of functions divided by their norms at every vertex.

    >>> directions(np.array([[3.0, 4.0]]))
    array([[0.6, 0.8]])
    """
    return values / np.linalg.norm(values, axis=1, keepdims=True)


def _distortion(shapes: Sequence[SampledShape], edges: np.ndarray, latent: np.ndarray) -> float:
    """Mean absolute change of the distances between some samples, over the pairs."""
    values = [directions(s.sampled(_JUDGES)[:, : y.shape[1]] @ y.T) for s, y in zip(shapes, latent)]
    each = (geodesic_distortion(shapes[i], shapes[j], nearest_rows(values[i], values[j])) for i, j in edges)
    return float(np.mean(list(each)))


def rigid_bodies(shapes: Sequence[SampledShape]) -> list[RigidSamples]:
    """The samples of every shape, or an empty list if one of the shapes has no faces."""
    return [rigid_samples(s) for s in shapes] if all(s.normals is not None for s in shapes) else []


def map_from_values(at: Sequence[np.ndarray], back: Sequence[np.ndarray], values: Sequence[np.ndarray]) -> np.ndarray:
    """C_ij (m, m) of samples matched by values of shared functions, in the direction that is nearer to orthogonal.

    Of i and j each: basis functions at samples (S, m), their pseudo-inverses, and the values (S, M), as directions.
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
