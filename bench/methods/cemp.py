"""Cycle-edge message passing (Lerman & Shi 2022): what 3-cycles say of an edge weighs them by their other two edges."""

import numpy as np

from bench.methods import Answer, Rng, method
from fmsync import SyncProblem, solve
from fmsync.so import transpose


@method("cemp")
def cemp(problem: SyncProblem, *, rng: Rng, rounds: int = 6) -> Answer:
    r"""Least squares weighted by :math:`e^{-\beta s}`, s in [0, 1] the corruption of an edge.

    In ``rounds`` rounds β doubles. Edges in no 3-cycle keep their weight.
    """
    (i, j), n = problem.edges.T, problem.n
    maps = np.zeros((problem.n_nodes, problem.n_nodes, n, n))
    maps[i, j], maps[j, i] = problem.maps, transpose(problem.maps)
    there = maps.any(axis=(2, 3))
    cycles = there[:, :, None] & there[None] & there[:, None]
    traces = np.einsum("ijab,jkbc,ikac->ijk", maps, maps, maps, optimize=True)
    error = np.sqrt(np.maximum(1 - traces / n, 0) / 2)  # of C_ij C_jk C_ki, 1 the largest
    weights = cycles.astype(float)
    for k in range(rounds):
        corruption = (weights * error).sum(axis=2) / np.maximum(weights.sum(axis=2), 1e-300)
        weights = cycles * np.exp(-(2.0**k) * (corruption[:, None] + corruption[None]))
    kept = problem.weights * np.maximum(np.exp(-(2.0 ** (rounds - 1)) * corruption[i, j]), 1e-9)
    answer = solve(SyncProblem(problem.n_nodes, problem.edges, problem.maps, kept / kept.max()), "mle", rng=rng)
    return Answer(answer.relative)
