r"""Energies of absolute maps on the graph of a problem, their gradients and the Hessian.

Gradients live in the body frame: the tangent vector at C_j is :math:`C_j\,g_j` with g_j skew-symmetric. All energies
accept leading batch axes, e.g. chains.
"""

import numpy as np
from scipy.sparse import csr_array

from fmsync import checks, so
from fmsync.block_products import add_products
from fmsync.problem import SyncProblem
from fmsync.problem import relative_maps_unchecked as relative_maps
from fmsync.so import skew, sym, transpose

_EDGES_AT_ONCE = 256  # keeps temporary arrays far below the size of the observations
_CHAINS_AT_ONCE = 8  # of one dense product: those of many chains leave the cache


@checks.checked(c="... N m n")
def neighbour_sums(problem: SyncProblem, c: np.ndarray) -> np.ndarray:
    r"""S_j (..., N, n, n), the weighted sum of what every neighbour says about C_j.

    .. math:: S_j = \sum_{(i,j)\in E} w\,C_i C_{ij} + \sum_{(j,k)\in E} w\,C_k C_{jk}^\top

    One dense product for well-filled graphs, products along the edges for sparse ones. Blocks C_j may also be
    (m, n): then the sums are the product of the connection matrix with m vectors.
    """
    if problem.is_dense:
        n_nodes, rows, n = c.shape[-3:]
        flat = c.reshape(-1, n_nodes, rows, n)
        sums = np.empty(flat.shape)
        for first in range(0, len(flat), _CHAINS_AT_ONCE):
            part = flat[first : first + _CHAINS_AT_ONCE]
            stacked = part.transpose(0, 2, 1, 3).reshape(-1, n_nodes * n)  # (K m, N n)
            product = (stacked @ problem.connection).reshape(-1, rows, n_nodes, n)
            sums[first : first + _CHAINS_AT_ONCE] = product.transpose(0, 2, 1, 3)
        return sums.reshape(c.shape)
    return np.ascontiguousarray(transpose(transposed_sums_unchecked(problem, transpose(c))))


@checks.checked(blocks="... N n m", maps="E n n")
def transposed_sums(problem: SyncProblem, blocks: np.ndarray, maps: np.ndarray | None = None) -> np.ndarray:
    r"""Transposes of :func:`neighbour_sums`, (..., N, n, m), from ``blocks`` :math:`C_j^\top`.

    In the precision of ``blocks``; along the edges it is that of ``maps``, the observations, by default the problem's.
    """
    if problem.is_dense:
        return np.ascontiguousarray(transpose(neighbour_sums_unchecked(problem, transpose(blocks))))
    flat, maps = blocks.reshape(-1, *blocks.shape[-2:]), problem.maps if maps is None else maps
    sums, chains = np.zeros(flat.shape, flat.dtype), np.arange(len(flat) // problem.n_nodes)
    # a map is read once for both of its ends and all chains
    order = problem.edge_order
    ends = (problem.edges[order, None] + problem.n_nodes * chains[:, None]).reshape(-1, 2)
    number, weights = (np.repeat(a, 2 * len(chains)) for a in (order, problem.weights[order]))
    incoming = np.tile([False, True], len(ends))
    add_products(sums, ends.ravel(), maps, number, incoming, flat, ends[:, ::-1].ravel(), weights)
    return sums.reshape(blocks.shape)


@checks.checked(c="... N n n")
def energy(problem: SyncProblem, c: np.ndarray) -> np.ndarray:
    r"""Euclidean energy :math:`U_E = \sum w\,\lVert C_i^\top C_j - C_{ij}\rVert_F^2`, (...), edge by edge."""
    return squared_residuals_unchecked(problem, c) @ problem.weights


@checks.checked(c="... N n n")
def squared_residuals(problem: SyncProblem, c: np.ndarray) -> np.ndarray:
    r"""(..., E) the terms :math:`\lVert C_i^\top C_j - C_{ij}\rVert_F^2` of :func:`energy`, in double precision."""
    flat, chains = c.astype(float, copy=False).reshape(-1, *c.shape[-2:]), np.arange(c[..., 0, 0, 0].size)
    squares = np.empty((len(chains), problem.n_edges))
    for first in range(0, problem.n_edges, _EDGES_AT_ONCE):
        part = slice(first, first + _EDGES_AT_ONCE)
        i, j = (problem.edges[part] + problem.n_nodes * chains[:, None, None]).reshape(-1, 2).T
        residual = np.tile(-problem.maps[part], (len(chains), 1, 1))
        add_products(residual, np.arange(len(i)), flat, i, np.ones(len(i), bool), flat, j)
        squares[:, part] = np.einsum("eab,eab->e", residual, residual).reshape(len(chains), -1)
    return squares.reshape(*c.shape[:-3], problem.n_edges)


@checks.checked(c="... N n n", sums="... N n n")
def gradient(problem: SyncProblem, c: np.ndarray, sums: np.ndarray | None = None) -> np.ndarray:
    r"""Body-frame gradient of ``energy``: :math:`g_j = -2\,\mathrm{skew}(C_j^\top S_j)`, (..., N, n, n)."""
    sums = neighbour_sums_unchecked(problem, c) if sums is None else sums
    return -2 * skew(transpose(c) @ sums)


@checks.checked(c="... N n n", omega="... N n n skew", sums="... N n n")
def hessian(problem: SyncProblem, c: np.ndarray, omega: np.ndarray, sums: np.ndarray | None = None) -> np.ndarray:
    r"""Riemannian Hessian of ``energy`` along skew Ω: :math:`-2\,\mathrm{skew}(C_j^\top\dot S_j - \Omega_j\,\mathrm{sym}(C_j^\top S_j))`.

    Ṡ is S at the variation CΩ.
    """  # noqa: E501
    sums = neighbour_sums_unchecked(problem, c) if sums is None else sums
    moving = neighbour_sums_unchecked(problem, c @ omega)
    return -2 * skew(transpose(c) @ moving - omega @ sym(transpose(c) @ sums))


@checks.checked(c="... N n n rotations")
def geodesic_energy(problem: SyncProblem, c: np.ndarray) -> np.ndarray:
    r"""Geodesic energy :math:`U_R = \sum w\,\lVert\log(C_{ij}^\top C_i^\top C_j)\rVert_F^2` (maps are rotations)."""
    return (problem.weights * so.dist_unchecked(problem.maps, relative_maps(c, problem.edges)) ** 2).sum(-1)


@checks.checked(c="... N n n rotations")
def geodesic_energy_and_gradient(problem: SyncProblem, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r""":func:`geodesic_energy` (...) and its body-frame gradient (..., N, n, n) from the same logarithms.

    With :math:`A = C_i^\top C_j` and :math:`\Lambda = \log(C_{ij}^\top A)` an edge adds 2wΛ to g_j and
    :math:`-2w\,A\Lambda A^\top` to g_i. It jumps where an eigen-angle of an edge passes π (the cut locus).
    """
    logarithms = so.log_unchecked(transpose(problem.maps) @ relative_maps(c, problem.edges))  # (..., E, n, n)
    energies = np.einsum("...eab,...eab->...e", logarithms, logarithms) @ problem.weights
    head = c[..., problem.edges[:, 1], :, :]
    turns = np.moveaxis(head @ logarithms @ transpose(head), -3, 0)  # of the universe: opposite at the two ends
    start, edge, _, forward = problem.incidence
    signed = np.where(forward, 2, -2) * problem.weights[edge]
    spread = csr_array((signed, edge, start), shape=(problem.n_nodes, problem.n_edges))
    sums = spread @ turns.reshape(len(turns), turns[0].size)
    return energies, transpose(c) @ np.moveaxis(sums.reshape(problem.n_nodes, *turns.shape[1:]), 0, -3) @ c


@checks.checked()
def gram_blocks(problem: SyncProblem) -> np.ndarray:
    r"""(N, n, n) sums of :math:`w C_{ij} C_{ij}^\top` over edges out of a node and of w I over edges into it.

    The part of the Hessian of :func:`unconstrained_energy` on the diagonal, but for a factor of 2.
    """
    gram = np.zeros((problem.n_nodes, problem.n, problem.n))
    weights = problem.weights[:, None, None]
    np.add.at(gram, problem.edges[:, 0], weights * (problem.maps @ transpose(problem.maps)))
    np.add.at(gram, problem.edges[:, 1], weights * np.eye(problem.n))
    return gram


@checks.checked(c="... N n n")
def unconstrained_energy(problem: SyncProblem, c: np.ndarray) -> np.ndarray:
    r""":math:`\sum w\,\lVert C_i C_{ij} - C_j\rVert_F^2` for arbitrary matrices C_i; equals ``energy`` on rotations."""
    i, j = problem.edges.T
    residual = c[..., i, :, :] @ problem.maps - c[..., j, :, :]
    return (problem.weights * (residual**2).sum((-2, -1))).sum(-1)


# without the tests of arguments: for loops inside the library
neighbour_sums_unchecked = checks.unchecked(neighbour_sums)
transposed_sums_unchecked = checks.unchecked(transposed_sums)
energy_unchecked, gradient_unchecked = checks.unchecked(energy), checks.unchecked(gradient)
squared_residuals_unchecked = checks.unchecked(squared_residuals)
unconstrained_energy_unchecked = checks.unchecked(unconstrained_energy)
geodesic_energy_and_gradient_unchecked = checks.unchecked(geodesic_energy_and_gradient)
