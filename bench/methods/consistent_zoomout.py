"""Consistent ZoomOut (Huang et al. 2020) by pyFM: maps refined through vertices while they stay consistent."""

from types import SimpleNamespace

import numpy as np

from bench.methods import Answer, Planted, Rng, method
from bench.methods.pyfm_network import has_cycles, latent_bases, shape_network

_VERTICES = 1000  # of each shape by which maps are refined


@method("consistent-zoomout", sees_planted=True)
def consistent_zoomout(planted: Planted, *, rng: Rng, start: int | None = None) -> Answer:
    """From the leading ``start`` (default n/2) rows and columns of the observed maps back up to n, one at a time.

    It sees the bases of the shapes, which the other methods do not, and never the truth; at most 1000 vertices of each,
    drawn at random. Graphs without 3-cycles are refused.
    """
    if not planted.bases:
        raise ValueError("consistent-zoomout: the problem has no shapes; use a generator that brings bases")
    problem = planted.problem
    network = shape_network(problem, fixed=True)
    if not has_cycles(network):
        raise ValueError("consistent-zoomout: the graph has no 3-cycle to weigh")
    network.meshlist = [
        SimpleNamespace(eigenvalues=basis.eigenvalues, eigenvectors=basis.eigenfunctions, A=basis.mass)
        for basis in planted.bases
    ]
    network.set_subsample([rng.permutation(len(b.mass))[:_VERTICES] for b in planted.bases])
    network.M = problem.n // 2 if start is None else start
    while problem.n > network.M:  # its zoomout_refine would end with a search among all vertices
        network.zoomout_iteration(int(0.9 * network.M), network.M, network.M + 1, n_jobs=1)
    network.set_weights(weight_type="adjacency")
    bases = latent_bases(network, problem.n, rng)
    return Answer(lambda pairs: bases[pairs[:, 0]] @ np.linalg.inv(bases[pairs[:, 1]]))
