r"""Compiled sweeps of the heat bath: rotations of two columns at a time, exact for densities exp(tr(Fᵀ C)).

Absolute maps are kept transposed, x[i] = C_iᵀ, so that the columns which rotate are rows, contiguous in memory. The
planes of a map are visited in rounds of disjoint ones, whose angles do not wait for each other: all move at once.
"""

import networkx as nx
import numba
import numpy as np

from fmsync.block_products import add_product
from fmsync.samplers.random_streams import LANES, fill, normals, uniform

OVER_RELAXATION = 0.35  # what an angle keeps, reflected, of its distance from the mode
_RENEWAL = np.sqrt(1 - OVER_RELAXATION**2)
_CONCENTRATED, _FRESH = 10.0, 1 / 32  # below the first, and else in this share of moves, an angle is drawn anew
_VECTOR = 4  # doubles of AVX2


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
def sweep(
    x: np.ndarray,
    maps: np.ndarray,
    weights: np.ndarray,
    incidence: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    field: np.ndarray,
    kappa: float,
    planes: np.ndarray,
    nodes: np.ndarray,
    states: np.ndarray,
    gains: np.ndarray,
) -> None:
    r"""Visit ``nodes`` of a chain in order, and move all planes of each by :func:`over_relaxed`.

    Rotating columns a, b of C_i by θ changes the exponent :math:`\operatorname{tr} W`, :math:`W = F_i^\top C_i`, into
    :math:`A\cos\theta + B\sin\theta`, A = W_aa + W_bb, B = W_ab - W_ba: θ is von Mises.

    Transposed maps x (N, n, n) change in place. ``maps`` (E, n, n) and ``weights`` (E,) are the observations,
    ``incidence`` the problem's; ``field`` (N, n, n), or (0, n, n), are transposed linear terms of a prior,
    :math:`F_i = \kappa S_i + \mathrm{field}_i^\top`; ``planes`` those of :func:`rounds`, ``states`` (N, 4, 8)
    generators. ``gains`` (N,) gets at every node visited the change of
    :math:`\sum_E w \operatorname{tr}(C_{ij}^\top C_i^\top C_j)`.
    """
    (start, edge, other, forward), n = incidence, x.shape[-1]
    sums, force, product = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    rows = np.empty((n, 2 * n))  # row a: column a of W, then column a of C
    room, shape = plane_room(planes), (n, n, n)
    flat_x, flat_maps = x.reshape(-1), maps.reshape(-1)
    for i in nodes:
        sums[:] = 0.0  # S_iᵀ
        for t in range(start[i], start[i + 1]):
            places, steps = (0, edge[t] * n * n, other[t] * n * n), (1, n) if forward[t] else (n, 1)
            add_product(sums.reshape(-1), flat_maps, flat_x, places, steps, shape, weights[edge[t]])
        before = inner(sums, x[i])
        for a in range(n):
            for b in range(n):
                force[b, a] = kappa * sums[a, b]
                if len(field):
                    force[b, a] += field[i, a, b]
        product[:] = 0.0  # Wᵀ
        add_product(product.reshape(-1), flat_x, force.reshape(-1), (0, i * n * n, 0), (n, 1), shape, 1.0)
        rows[:, :n] = product
        rows[:, n:] = x[i]
        _rotate_planes(rows, planes, room, states[i])
        x[i] = rows[:, n:]
        gains[i] = inner(sums, x[i]) - before


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def inner(a: np.ndarray, b: np.ndarray) -> float:
    """The sum of a_rs b_rs."""
    total = 0.0
    for r in range(a.shape[0]):
        for s in range(a.shape[1]):
            total += a[r, s] * b[r, s]
    return total


@numba.njit(cache=True, nogil=True)
def plane_room(planes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Room to move all planes of a matrix: (7, M) for one round, padded to whole vectors, and two of random numbers."""
    n_rounds, count = planes.shape[0], planes.shape[1]
    width = (count + _VECTOR - 1) // _VECTOR * _VECTOR
    numbers = ((n_rounds - 1) * count + width + LANES - 1) // LANES * LANES
    return np.ones((7, width)), np.empty(numbers), np.empty(numbers)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _rotate_planes(
    rows: np.ndarray, planes: np.ndarray, room: tuple[np.ndarray, np.ndarray, np.ndarray], state: np.ndarray
) -> None:
    (angles, normal, level), count = room, planes.shape[1]
    along, across, cosine, sine, size = angles[0], angles[1], angles[2], angles[3], angles[4]
    normals(state, normal.reshape(-1, LANES))
    fill(state, level.reshape(-1, LANES))
    for r in range(len(planes)):
        for p in range(count):
            a, b = planes[r, p, 0], planes[r, p, 1]
            along[p], across[p] = rows[a, a] + rows[b, b], rows[b, a] - rows[a, b]
        over_relaxed(along, across, cosine, sine, size, normal[r * count :], level[r * count :], count, state)
        for p in range(len(along)):  # twice the half angle, turned by the angle of the mode
            c, s = 1 - 2 * sine[p] * sine[p], 2 * sine[p] * cosine[p]
            cosine[p], sine[p] = along[p] * c - across[p] * s, across[p] * c + along[p] * s
        rotate_rows(rows, planes[r], cosine, sine)


@numba.njit(cache=True, nogil=True)
def von_mises_half(k: float, state: np.ndarray) -> tuple[float, float]:
    r"""Cosine and sine of ψ/2 for an exact draw of ψ of density :math:`\propto e^{k\cos\psi}`, k >= 0.

    The tangent of ψ/4 is proposed by Student's t distribution with two degrees of freedom,
    :math:`v=\sqrt{w}\,a/\sqrt{1-a^2}` with a uniform on (-1, 1) and w = 1/(8k + 1/2), cut to \|v\| <= 1. Target over
    envelope, :math:`e^{-8kz/(1+z)^2}(1+z/w)^{3/2}/(1+z)` with :math:`z=v^2`, is at most 2.4, and 1.14 for k >= 2.
    """
    w, most = 1 / (8 * k + 0.5), 1.14 if k >= 2 else 2.4
    while True:
        a, level = 2 * uniform(state) - 1, uniform(state)
        q = 1 - a * a
        if w * a * a >= q:
            continue
        z = w * a * a / q
        if level * most * q * np.sqrt(q) * (1 + z) < np.exp(-8 * k * z / (1 + z) ** 2):
            return (1 - z) / (1 + z), 2 * np.copysign(np.sqrt(z), a) / (1 + z)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def over_relaxed(
    along: np.ndarray,
    across: np.ndarray,
    cosine: np.ndarray,
    sine: np.ndarray,
    size: np.ndarray,
    normal: np.ndarray,
    level: np.ndarray,
    count: int,
    state: np.ndarray,
) -> None:
    r"""One move of the first ``count`` angles, each with a von Mises density about a mode of its own.

    Angles count from where they are. ``along`` and ``across`` are k cos m and k sin m for the angle m of the mode:
    they become cos m and sin m, ``size`` becomes k, and ``cosine`` and ``sine`` those of half the new angle ψ from the
    mode. The density :math:`\propto e^{k\cos\psi}` of :math:`s=\sin(\psi/2)` is :math:`e^{-2ks^2}/\sqrt{1-s^2}`, nearly
    normal. As with Adler's over-relaxation (1981) of a normal number, s is reflected about the mode, and moves in part
    to a new draw, :math:`s' = -\alpha s + \sqrt{1-\alpha^2}\,z/2\sqrt k` with z from ``normal``. The Metropolis step is
    rejected about once in 13k times, decided by ``level``, uniform on [0, 1), and then the angle is reflected. It would
    hardly leave the far side of the mode: angles with k < 10, and one in 32 of the others, are drawn anew instead.
    """
    for p in range(len(along)):
        a, b = along[p], across[p]
        k = np.sqrt(a * a + b * b)
        twice = np.sqrt(2 * k * (k + abs(a)))  # 2k times the larger of cos(m/2) and sin(m/2)
        inverse = 1 / (k * twice) if k > 1e-100 else 0.0
        shrink, larger, smaller = twice * inverse, twice * twice * inverse / 2, k * abs(b) * inverse
        # of m/2: as seen from the mode the angle is at -m, and reflected at m
        old_cosine, old = (larger, np.copysign(smaller, b)) if a >= 0.0 else (smaller, np.copysign(larger, b))
        new = OVER_RELAXATION * old + _RENEWAL / 2 * np.sqrt(shrink) * normal[p]
        square = max(1 - new * new, 0.0)
        # the density of s over the proposal's is 1/√(1 - s²)
        u = (level[p] - _FRESH) / (1 - _FRESH)
        passed = (u * u * square if abs(new) < 1.0 else 2.0) < old_cosine * old_cosine
        along[p], across[p], size[p] = a * shrink if k > 1e-100 else 1.0, b * shrink, k
        sine[p] = new if passed else old
        cosine[p] = np.sqrt(square) if passed else old_cosine
    for p in range(count):
        if size[p] < _CONCENTRATED or level[p] < _FRESH:
            cosine[p], sine[p] = von_mises_half(size[p], state)


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
