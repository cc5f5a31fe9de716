r"""Compiled sweeps of the heat bath: rotations of two columns at a time, exact for densities exp(tr(Fᵀ C)).

Absolute maps are kept transposed, x[i] = C_iᵀ, so that the columns which rotate are rows, contiguous in memory. The
planes of a map are visited in rounds of disjoint ones, whose angles do not wait for each other: all are drawn at once.
"""

import networkx as nx
import numba
import numpy as np

from fmsync.samplers.random_streams import POOL, von_mises_halves


def rounds(n: int) -> np.ndarray:
    """All planes of n columns in rounds of disjoint ones, (n - 1 or n, n // 2, 2): the table of a tournament."""
    last = n - 1 + n % 2  # an odd n has one more player, who is nobody
    table = [[(last, r)] + [((r + k) % last, (r - k) % last) for k in range(1, (last + 1) // 2)] for r in range(last)]
    return np.array([[sorted(pair) for pair in pairs if max(pair) < n] for pairs in table]).reshape(-1, n // 2, 2)


def colours(start: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A greedy colouring: nodes in the order of their colours, and where each colour begins (C + 1,).

    Nodes of one colour are not neighbours: what one does is nothing to the others, in whatever order they are visited.
    """
    graph, node = nx.empty_graph(len(start) - 1), np.repeat(np.arange(len(start) - 1), np.diff(start))
    graph.add_edges_from(zip(node.tolist(), other.tolist()))
    found = nx.greedy_color(graph, lambda graph, colours: graph)  # one node after the other
    colour = np.array([found[i] for i in graph])
    return np.argsort(colour, kind="stable"), np.append(0, np.cumsum(np.bincount(colour)))


@numba.njit(cache=True, nogil=True)
def node_blocks(maps: np.ndarray, weights: np.ndarray, incidence: tuple[np.ndarray, ...], out: np.ndarray) -> None:
    r"""What every neighbour says, side by side: out (2E n²,) holds at ``start[i] n²`` the (n, deg n) blocks of node i.

    With them :math:`S_i^\top` is one product with the stacked transposed maps of the neighbours. ``incidence`` is the
    problem's, which begins with ``start``.
    """
    (start, edge, _, forward), n = incidence, maps.shape[-1]
    for i in range(len(start) - 1):
        degree = start[i + 1] - start[i]
        block = out[start[i] * n * n : start[i + 1] * n * n].reshape(n, degree * n)
        for t in range(degree):
            e = edge[start[i] + t]
            for a in range(n):
                for b in range(n):
                    value = maps[e, b, a] if forward[start[i] + t] else maps[e, a, b]
                    block[a, t * n + b] = weights[e] * value


@numba.njit(cache=True, nogil=True)
def sweep(
    x: np.ndarray,
    blocks: np.ndarray,
    start: np.ndarray,
    other: np.ndarray,
    field: np.ndarray,
    kappa: np.ndarray,
    over_relaxations: int,
    planes: np.ndarray,
    nodes: np.ndarray,
    states: np.ndarray,
    gains: np.ndarray,
) -> None:
    r"""Visit ``nodes`` of every chain in order: each is over-relaxed some times, then drawn by the heat bath.

    Rotating columns a, b of C_i by θ changes the exponent :math:`\operatorname{tr} W`, :math:`W = F_i^\top C_i`, into
    :math:`A\cos\theta + B\sin\theta`, A = W_aa + W_bb, B = W_ab - W_ba: θ is von Mises. Over-relaxation takes θ to
    twice the angle of the mode, which leaves the density as it is.

    Transposed maps x (K, N, n, n) change in place. ``blocks`` of :func:`node_blocks` are (K, 2E n²) or, where all
    chains read the same, (1, 2E n²); ``field`` (N, n, n), or (0, n, n), are transposed linear terms of a prior,
    :math:`F_i = \kappa S_i + \mathrm{field}_i^\top`; ``kappa`` (K,), ``planes`` of :func:`rounds`, ``states``
    (K, N, 4, 8) generators. ``gains`` (K, N) gets at every node visited the change of
    :math:`\sum_E w \operatorname{tr}(C_{ij}^\top C_i^\top C_j)`.
    """
    n = x.shape[-1]
    largest = 0
    for i in nodes:
        largest = max(largest, start[i + 1] - start[i])
    gathered = np.empty((largest * n, n))
    sums, force, product = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    rows = np.empty((n, 2 * n))  # row a: column a of W, then column a of C
    angles = np.ones((5, (planes.shape[1] + 3) // 4 * 4))  # whole vectors: those beyond the planes are not used
    pool = np.empty(POOL)
    for k in range(len(x)):
        c, own = x[k], blocks[k if len(blocks) > 1 else 0]
        for i in nodes:
            degree = start[i + 1] - start[i]
            for t in range(degree):
                gathered[t * n : (t + 1) * n] = c[other[start[i] + t]]
            block = own[start[i] * n * n : start[i + 1] * n * n].reshape(n, degree * n)
            np.dot(block, gathered[: degree * n], sums)  # S_iᵀ
            before = inner(sums, c[i])
            for a in range(n):
                for b in range(n):
                    force[a, b] = kappa[k] * sums[a, b]
                    if len(field):
                        force[a, b] += field[i, a, b]
            np.dot(c[i], force.T, product)  # Wᵀ
            rows[:, :n] = product
            rows[:, n:] = c[i]
            for _ in range(over_relaxations):
                _over_relax(rows, planes, angles)
            _draw(rows, planes, angles, states[k, i], pool)
            c[i] = rows[:, n:]
            gains[k, i] = inner(sums, c[i]) - before


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def inner(a: np.ndarray, b: np.ndarray) -> float:
    """The sum of a_rs b_rs."""
    total = 0.0
    for r in range(a.shape[0]):
        for s in range(a.shape[1]):
            total += a[r, s] * b[r, s]
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _over_relax(rows: np.ndarray, planes: np.ndarray, angles: np.ndarray) -> None:
    along, across, cosine, sine = angles[0], angles[1], angles[2], angles[3]
    for pairs in planes:
        _read(rows, pairs, along, across)
        for p in range(len(along)):
            square = along[p] * along[p] + across[p] * across[p]
            shrink = 1 / square if square > 0.0 else 0.0
            cosine[p] = (along[p] * along[p] - across[p] * across[p]) * shrink if square > 0.0 else 1.0
            sine[p] = 2 * along[p] * across[p] * shrink
        rotate_rows(rows, pairs, cosine, sine)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _draw(rows: np.ndarray, planes: np.ndarray, angles: np.ndarray, state: np.ndarray, pool: np.ndarray) -> None:
    along, across, cosine, sine, size = angles[0], angles[1], angles[2], angles[3], angles[4]
    spare, at = np.empty(len(size)), POOL
    for pairs in planes:
        _read(rows, pairs, along, across)
        for p in range(len(size)):
            size[p] = np.sqrt(along[p] * along[p] + across[p] * across[p])
            shrink = 1 / size[p] if size[p] > 0.0 else 0.0
            along[p] = along[p] * shrink if size[p] > 0.0 else 1.0
            across[p] *= shrink
        at = von_mises_halves(size, cosine, sine, spare, len(pairs), state, pool, at)
        for p in range(len(size)):  # twice the half angle, turned by the angle of the mode
            c, s = cosine[p] * cosine[p] - sine[p] * sine[p], 2 * cosine[p] * sine[p]
            cosine[p], sine[p] = along[p] * c - across[p] * s, across[p] * c + along[p] * s
        rotate_rows(rows, pairs, cosine, sine)


@numba.njit(cache=True, nogil=True)
def _read(rows: np.ndarray, pairs: np.ndarray, along: np.ndarray, across: np.ndarray) -> None:
    for p in range(len(pairs)):
        a, b = pairs[p, 0], pairs[p, 1]
        along[p], across[p] = rows[a, a] + rows[b, b], rows[b, a] - rows[a, b]


@numba.njit(cache=True, nogil=True, fastmath={"contract"})
def rotate_rows(rows: np.ndarray, pairs: np.ndarray, cosine: np.ndarray, sine: np.ndarray) -> None:
    """Rotate pairs of rows, first ← c first + s second, second ← c second - s first."""
    width = rows.shape[1]
    for k in range(len(pairs)):
        p, q = rows[pairs[k, 0]], rows[pairs[k, 1]]
        c, s = cosine[k], sine[k]
        for r in range(width):
            u, v = p[r], q[r]
            p[r] = c * u + s * v
            q[r] = c * v - s * u
