r"""Compiled sweeps of the heat bath: rotations of two columns at a time, exact for densities exp(tr(Fᵀ C)).

Absolute maps are kept transposed, x[i] = C_iᵀ, so that the columns which rotate are rows, contiguous in memory.
"""

import numba
import numpy as np

from fmsync.samplers._random import von_mises_half


@numba.njit(cache=True, nogil=True)
def node_blocks(maps, weights, start, edge, forward, out):
    r"""What every neighbour says, side by side: out (2E n²,) holds at ``start[i] n²`` the (n, deg n) blocks of node i.

    With them :math:`S_i^\top` is one product with the stacked transposed maps of the neighbours.
    """
    n = maps.shape[-1]
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
def sweep(x, blocks, start, other, field, kappa, over_relaxations, state):
    r"""One pass over all nodes of one chain: each node is over-relaxed some times, then drawn by the heat bath.

    Rotating columns a, b of C_i by θ changes the exponent :math:`\operatorname{tr} W`, :math:`W = F_i^\top C_i`, into
    :math:`A\cos\theta + B\sin\theta`, A = W_aa + W_bb, B = W_ab - W_ba: θ is von Mises. Over-relaxation takes θ to
    twice the angle of the mode, which leaves the density as it is.

    Parameters
    ----------
    x
        (N, n, n) transposed absolute maps, changed in place.
    blocks, start, other
        From :func:`node_blocks` and the incidence of the problem.
    field
        (N, n, n) transposed linear terms of a prior, or (0, n, n): :math:`F_i = \kappa S_i + \mathrm{field}_i^\top`.
    kappa
        Concentration of the observations.
    over_relaxations
        Reflections of every pair of columns before the draw.
    state
        (4,) generator.

    Returns
    -------
    float
        Change of :math:`\sum_E w \operatorname{tr}(C_{ij}^\top C_i^\top C_j)`.
    """
    n_nodes, n = x.shape[0], x.shape[1]
    largest = 0
    for i in range(n_nodes):
        largest = max(largest, start[i + 1] - start[i])
    gathered = np.empty((largest * n, n))
    sums, force, product = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    rows = np.empty((n, 2 * n))  # row a: column a of W, then column a of C
    gained = 0.0
    for i in range(n_nodes):
        degree = start[i + 1] - start[i]
        for t in range(degree):
            gathered[t * n : (t + 1) * n] = x[other[start[i] + t]]
        block = blocks[start[i] * n * n : start[i + 1] * n * n].reshape(n, degree * n)
        np.dot(block, gathered[: degree * n], sums)  # S_iᵀ
        for a in range(n):
            for b in range(n):
                gained -= sums[a, b] * x[i, a, b]
                force[a, b] = kappa * sums[a, b]
                if len(field):
                    force[a, b] += field[i, a, b]
        np.dot(x[i], force.T, product)  # Wᵀ
        for a in range(n):
            for b in range(n):
                rows[a, b] = product[a, b]
                rows[a, n + b] = x[i, a, b]
        for _ in range(over_relaxations):
            _rotate_all(rows, n, True, state)
        _rotate_all(rows, n, False, state)
        for a in range(n):
            for b in range(n):
                x[i, a, b] = rows[a, n + b]
                gained += sums[a, b] * x[i, a, b]
    return gained


@numba.njit(cache=True, nogil=True)
def _rotate_all(rows, n, over_relax, state):
    for a in range(n - 1):
        for b in range(a + 1, n):
            along, across = rows[a, a] + rows[b, b], rows[b, a] - rows[a, b]
            square = along * along + across * across
            if over_relax:
                if square == 0.0:
                    continue
                c, s = (along * along - across * across) / square, 2 * along * across / square
            else:
                size = np.sqrt(square)
                x, y, scale = von_mises_half(size, state)
                c, s = (x * x - y * y) / scale, 2 * x * y / scale
                if size > 0.0:  # turned by the angle of the mode
                    c, s = (along * c - across * s) / size, (across * c + along * s) / size
            p, q = rows[a], rows[b]
            for r in range(2 * n):
                u, v = p[r], q[r]
                p[r] = c * u + s * v
                q[r] = c * v - s * u
