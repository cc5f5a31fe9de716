r"""Functional maps: point map → matrix, descriptors → matrix, matrix → point map, draws → images of a vertex.

One convention everywhere: ``C_ij`` (n_i, n_j) takes coefficients on shape j to coefficients on shape i, so functions on
j are pulled back along a point map from i to j, and ``C_ij @ C_jk`` is ``C_ik`` (Ovsjanikov et al. 2012).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fmsync import checks, so
from fmsync.shape import Basis
from fmsync.threads import single_threaded_blas

_BLOCK, _MANY = 128, 4000  # rows at a time, and from where groups of rows are faster than all of them


@checks.checked(point_map=checks.plain)
def functional_map(basis_i: Basis, basis_j: Basis, point_map: np.ndarray) -> np.ndarray:
    r"""Functional map (n_i, n_j), :math:`C_{ij} = \Phi_i^\top A_i P \Phi_j`, of a point map from shape i to shape j.

    Bases hold n_i functions on V_i vertices, and n_j on V_j; ``point_map`` (V_i,) is the vertex of j that each vertex
    of i goes to: P f = f[point_map].

    >>> basis = Basis([0.0, 2.0], [[1.0, 1.0], [1.0, -1.0]], [0.5, 0.5])
    >>> functional_map(basis, basis, np.array([1, 0]))  # swapping the two vertices flips the second function
    array([[ 1.,  0.],
           [ 0., -1.]])
    """
    point_map = checks.indices("point_map", point_map, basis_j.n_vertices)
    if len(point_map) != basis_i.n_vertices:
        raise ValueError(f"point_map: need a vertex of j for each of {basis_i.n_vertices} of i, got {len(point_map)}")
    return basis_i.coefficients(basis_j.eigenfunctions[point_map])


@checks.checked(descriptors_i="A K", descriptors_j="W K", commutativity=checks.not_negative)
def functional_map_from_descriptors(
    basis_i: Basis,
    basis_j: Basis,
    descriptors_i: np.ndarray,
    descriptors_j: np.ndarray,
    orthogonal: bool = False,
    commutativity: float = 1e-3,
) -> np.ndarray:
    r"""Functional map (n_i, n_j) that takes the descriptors of shape j to those of shape i.

    Descriptors are functions, (V_i, K) on i and (V_j, K) on j; column k of both is the same quantity. With their
    coefficients A on i and B on j, and the weight w = ``commutativity`` >= 0, it minimises

    .. math:: \lVert C B - A \rVert_F^2 + w \lVert B \rVert_F^2 \sum_{ab}
              \frac{(\lambda^i_a - \lambda^j_b)^2}{\lambda_{\max}^2}\,C_{ab}^2,

    where the second term is small when C commutes with the Laplacians; scaling all descriptors changes nothing. The
    minimum has a closed form row by row, and directions about which nothing is known are left at zero.

    ``orthogonal`` searches SO(n) and needs n_i = n_j. There the norms ‖CB‖ and ‖C Λ‖ are constant and the projection
    :math:`C \leftarrow \Pi(A B^\top + 2 w' \Lambda_i C \Lambda_j)`, :math:`w' = w \lVert B \rVert_F^2 /
    \lambda_{\max}^2`, ascends to a local maximum of a convex function. The best rotation is a poor answer when the true
    map is near a reflection: fix the signs first (:meth:`Basis.with_flipped`).

    >>> basis = Basis([0.0, 2.0], [[1.0, 1.0], [1.0, -1.0]], [0.5, 0.5])
    >>> functional_map_from_descriptors(basis, basis, np.eye(2), np.eye(2)).round(12)
    array([[1., 0.],
           [0., 1.]])
    """
    for name, given, basis in (("i", descriptors_i, basis_i), ("j", descriptors_j, basis_j)):
        if len(given) != basis.n_vertices:
            raise ValueError(f"descriptors_{name}: {len(given)} rows for the {basis.n_vertices} vertices of {name}")
    if orthogonal and basis_i.n != basis_j.n:
        raise ValueError(f"an orthogonal map needs bases of one size, got {basis_i.n} and {basis_j.n}: truncate one")

    a, b = basis_i.coefficients(descriptors_i), basis_j.coefficients(descriptors_j)  # (n_i, K), (n_j, K)
    largest = max(basis_i.eigenvalues[-1], basis_j.eigenvalues[-1]) or 1.0
    values_i, values_j = basis_i.eigenvalues / largest, basis_j.eigenvalues / largest
    weight, target = commutativity * (b**2).sum(), a @ b.T
    if orthogonal:
        outer = 2 * weight * values_i[:, None] * values_j  # Λ_i C Λ_j is an entrywise product with this
        c = so.project_unchecked(target)
        for _ in range(1000):
            previous, c = c, so.project_unchecked(target + outer * c)
            if np.abs(c - previous).max() < 1e-9:
                break
        return c
    penalty = weight * (values_i[:, None] - values_j) ** 2  # of every row of C: one small normal equation each
    normal = b @ b.T + penalty[:, :, None] * np.eye(len(b))  # (n_i, n_j, n_j)
    return (np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ target[:, :, None])[:, :, 0]


@checks.checked(c_ij=checks.real, vertices=checks.plain)
def point_map(c_ij: np.ndarray, basis_i: Basis, basis_j: Basis, vertices: np.ndarray | None = None) -> np.ndarray:
    r"""Point map of a functional map: x goes to :math:`\arg\min_y \lVert (\Phi_i C_{ij})_x - (\Phi_j)_y \rVert`.

    Takes (n_i, n_j) to (V_i,) vertices of j, or (v,) for some ``vertices`` (v,) of i. Ties go to the lowest index. An
    exhaustive search: a tree is several times slower on noisy maps, where nothing can be pruned.

    >>> basis = Basis([0.0, 2.0], [[1.0, 1.0], [1.0, -1.0]], [0.5, 0.5])
    >>> point_map(np.diag([1.0, -1.0]), basis, basis)
    array([1, 0])
    """
    c_ij = np.asarray(c_ij, dtype=np.float64)
    if c_ij.shape != (basis_i.n, basis_j.n) or not np.isfinite(c_ij).all():
        raise ValueError(f"c_ij must be a finite ({basis_i.n}, {basis_j.n}) matrix, got shape {c_ij.shape}")
    rows = basis_i.eigenfunctions
    if vertices is not None:
        rows = rows[checks.indices("vertices", vertices, basis_i.n_vertices)]
    return nearest_rows_unchecked(rows @ c_ij, basis_j.eigenfunctions)


@checks.checked(maps=checks.array, vertex=checks.plain)
def vertex_images(maps: np.ndarray, basis_i: Basis, basis_j: Basis, vertex: ArrayLike) -> np.ndarray:
    r"""Images (K,) on shape j of one vertex of shape i under every map C_ij; or (S, K) of vertices (S,).

    The vertex x goes to :math:`\arg\min_y\lVert(\Phi_i C_{ij})_x-(\Phi_j)_y\rVert`, as in :func:`fmsync.point_map`.
    ``maps`` (K, n_i, n_j) may be draws, e.g. ``post.relative([[i, j]]).reshape(-1, n, n)``.

    >>> basis = Basis([0.0, 2.0], [[1.0, 1.0], [1.0, -1.0]], [0.5, 0.5])
    >>> vertex_images([np.eye(2), np.diag([1.0, -1.0])], basis, basis, 0)
    array([0, 1])
    """
    if maps.ndim != 3 or maps.shape[1:] != (basis_i.n, basis_j.n):
        raise ValueError(f"maps: expected (K, {basis_i.n}, {basis_j.n}), as large as the bases, got {maps.shape}")
    at = checks.indices("vertex", np.atleast_1d(vertex), basis_i.n_vertices)
    images = row_images(basis_i.eigenfunctions[at], maps, basis_j.eigenfunctions).T
    return images if np.ndim(vertex) else images[0]


@checks.checked(maps="K n m", vertices=checks.plain)
def images_both_ways(
    maps: np.ndarray, bases: Sequence[Basis], vertices: Sequence[ArrayLike]
) -> tuple[np.ndarray, np.ndarray]:
    """Images of vertices of two shapes on each other: there under rotations, and back under their transposes.

    Takes ``maps`` (K, n, n) of C_01 between two ``bases``, and vertices (S_0,) and (S_1,), to (S_0, K) and (S_1, K).

    >>> basis = Basis([0.0, 2.0], [[1.0, 1.0], [1.0, -1.0]], [0.5, 0.5])
    >>> images_both_ways([np.diag([1.0, -1.0])], (basis, basis), ([0, 1], [0]))
    (array([[1],
           [0]]), array([[1]]))
    """
    (i, j), back = bases, so.transpose(maps)
    at = [checks.indices(f"vertices[{k}]", vertices[k], bases[k].n_vertices) for k in (0, 1)]
    return vertex_images(maps, i, j, at[0]), vertex_images(back, j, i, at[1])


@checks.checked(rows="S n", maps="K n m", functions="V m")
def row_images(rows: np.ndarray, maps: np.ndarray, functions: np.ndarray) -> np.ndarray:
    """Row of ``functions`` (V, m) nearest to each of the ``rows`` (S, n) that each of the maps (K, n, m) moves: (K, S).

    >>> row_images([[1.0, 0.0]], [np.eye(2), [[0.0, 1.0], [1.0, 0.0]]], np.eye(2))
    array([[0],
           [1]])
    """
    with single_threaded_blas():
        moved = (rows @ maps).reshape(-1, functions.shape[1])
        return nearest_rows_unchecked(moved, functions).reshape(len(maps), -1)


@checks.checked(queries="Q n", targets="V n")
def nearest_rows(queries: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Index of the target (V, n) nearest to each query (Q, n), in the precision of the targets."""
    queries = queries.astype(targets.dtype, copy=False)
    if min(len(queries), len(targets)) >= _MANY:
        return _nearest_of_many(queries, targets)
    lifted, queries = _lifted(queries, targets)
    nearest = np.empty(len(queries), dtype=np.int64)
    for start in range(0, len(queries), _BLOCK):
        nearest[start : start + _BLOCK] = (queries[start : start + _BLOCK] @ lifted.T).argmin(axis=1)
    return nearest


nearest_rows_unchecked = checks.unchecked(nearest_rows)  # for loops


def _lifted(queries: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Targets (V, n + 1) and queries (Q, n + 1) whose products are ‖t‖² − 2 q·t, which orders as the distance does."""
    ones = np.ones(len(queries), queries.dtype)
    return np.column_stack([-2 * targets, (targets**2).sum(axis=1)]), np.column_stack([queries, ones])


def _distances(queries: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """(Q, V) distances."""
    lifted, ones = _lifted(queries, targets)
    squared = ones @ lifted.T
    squared += (queries**2).sum(axis=1)[:, None]
    return np.sqrt(np.maximum(squared, 0, out=squared), out=squared)


def _closest(rows: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest centre of each row and its distance, a few rows at a time, in the precision of the centres."""
    parts = (_distances(rows[k : k + _BLOCK].astype(centres.dtype), centres) for k in range(0, len(rows), _BLOCK))
    found = [(away.argmin(axis=1), away.min(axis=1)) for away in parts]
    nearest, distance = (np.concatenate(part) for part in zip(*found))
    return nearest, distance


def _nearest_of_many(queries: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Nearest rows, passing over groups of targets that are too far to hold one.

    A query q that has a target at distance b need not look into the group about c of radius r if ‖q − c‖ > b + r.
    Rows of n eigenfunctions lie on a surface, so that few groups are near, however large n is.
    """
    stride = max(1, int(len(targets) ** 0.5 / 4))
    centres = targets[::stride].astype(np.float32)  # (G, n), G about 4 √V; single precision tells what is far
    (group, away), (closest, _) = _closest(targets, centres), _closest(queries, centres)
    radius = np.zeros(len(centres), np.float32)
    group[::stride] = np.arange(len(centres))  # also where centres fall together: no group is empty
    np.maximum.at(radius, group, away)
    squares = np.einsum("vn,vn->v", targets, targets)
    largest = max(squares.max(), np.einsum("qn,qn->q", queries, queries).max())
    radius += np.float32(2e-3 * np.sqrt(largest))  # what single precision loses
    nearest = np.empty(len(queries), dtype=np.int64)
    for g in np.unique(closest):
        mine = np.flatnonzero(closest == g)
        rough = queries[mine].astype(np.float32)
        best = _distances(rough, targets[group == g].astype(np.float32)).min(axis=1)  # (Q_g,)
        away = _distances(rough, centres)  # (Q_g, G)
        near = np.flatnonzero((away <= best[:, None] + radius).any(axis=0)[group])
        score = queries[mine] @ targets[near].T
        score *= -2
        score += squares[near]  # ‖t‖² − 2 q·t, which orders as the distance does
        nearest[mine] = near[score.argmin(axis=1)]
    return nearest
