"""Consistent ZoomOut (Huang et al. 2020) by pyFM: maps refined through vertices while they stay consistent."""

from types import SimpleNamespace

import numpy as np

from fmsync.bench.methods import Answer, method
from fmsync.bench.methods.pyfm_network import _has_cycles, _latent_bases, _network


@method("consistent-zoomout", sees_planted=True)
def consistent_zoomout(planted, *, rng, start: int | None = None) -> Answer:
    """From the leading ``start`` (default n/2) rows and columns of the observed maps back up to n, one at a time.

    It sees the bases of the shapes, which the other methods do not, and never the truth. Graphs without 3-cycles are
    refused.
    """
    if not planted.bases:
        raise ValueError("consistent-zoomout: the problem has no shapes; use a generator that brings bases")
    problem = planted.problem
    network = _network(problem, fixed=True)
    if not _has_cycles(network):
        raise ValueError("consistent-zoomout: the graph has no 3-cycle to weigh")
    network.meshlist = [
        SimpleNamespace(eigenvalues=basis.eigenvalues, eigenvectors=basis.eigenfunctions, A=basis.mass)
        for basis in planted.bases
    ]
    first = problem.n // 2 if start is None else start
    network.zoomout_refine(nit=problem.n - first, step=1, subsample=0, M_init=first, n_jobs=1)
    network.set_weights(weight_type="adjacency")
    network.compute_W(M=problem.n)
    bases = _latent_bases(network, rng)
    return Answer(lambda pairs: bases[pairs[:, 0]] @ np.linalg.inv(bases[pairs[:, 1]]))
