r"""pyFM's functional map network (Huang et al. 2014; Huang et al. 2020): a consistent latent basis by eigenvectors.

pyFM's map (i, j) takes functions on i to functions on j, so our C_ij is its map (j, i). Its bases Y_i answer
:math:`C_{ij} = Y_i Y_j^{-1}`.
"""

from typing import Any

import numpy as np
import scipy.sparse

from bench.methods import Answer, Rng, SyncProblem, method
from fmsync import so
from fmsync.adapters import to_pyfm_maps
from fmsync.extras import require

_EIGENVALUE_SHIFT = 1e-6


@method("pyfm-network")
def pyfm_network(problem: SyncProblem, *, rng: Rng, projected: bool = False, weights: str = "adjacency") -> Answer:
    """The network's maps, raw or projected to SO(n); of repeated observations the mean, since it holds one map a pair.

    ``weights`` are ``"adjacency"``; ``"icsm"``, pyFM's weights from 3-cycles, which it multiplies in the wrong order,
    so that exactly consistent maps have positive cycle errors; or ``"icsm-fixed"``, the same with the right order.
    """
    if weights not in ("adjacency", "icsm", "icsm-fixed"):
        raise ValueError(f"weights: 'adjacency', 'icsm' or 'icsm-fixed', not {weights!r}")
    network = shape_network(problem, fixed=weights == "icsm-fixed")
    if weights != "adjacency" and not has_cycles(network):
        raise ValueError("weights: the graph has no 3-cycle to weigh; use 'adjacency'")
    network.set_weights(weight_type="adjacency" if weights == "adjacency" else "icsm")
    bases = latent_bases(network, problem.n, rng)
    if projected:
        if np.linalg.det(bases).sum() < 0:
            bases = bases * np.where(np.arange(problem.n) == 0, -1.0, 1.0)
        return Answer.from_absolute(so.project(so.transpose(bases)))
    return Answer(lambda pairs: bases[pairs[:, 0]] @ np.linalg.inv(bases[pairs[:, 1]]))


def shape_network(problem: SyncProblem, fixed: bool):
    """The problem as pyFM sees it."""
    network_class = require("pyFM.FMN", "bench").FMN

    class RightOrder(network_class):
        def get_cycle_weight(self, cycle: tuple[int, int, int], M: int | None = None):
            i, j, k = cycle
            c_ij, c_jk, c_ki = (self.maps[edge][:M, :M] for edge in ((i, j), (j, k), (k, i)))
            loops = (c_ki @ c_jk @ c_ij, c_ij @ c_ki @ c_jk, c_jk @ c_ij @ c_ki)  # i -> j -> k -> i, and from j, from k
            return max(np.linalg.norm(loop - np.eye(len(loop))) for loop in loops)

    network = (RightOrder if fixed else network_class)([None] * problem.n_nodes)
    return network.set_maps(to_pyfm_maps(problem))


def has_cycles(network: Any) -> bool:
    """Whether pyFM finds a 3-cycle to be consistent about."""
    network.extract_3_cycles()
    network.compute_Amat()
    return bool(network.cycles)


def latent_bases(network: Any, n: int, rng: np.random.Generator) -> np.ndarray:
    """(N, n, n): ``FMN.compute_CLB`` with a start vector, without which the same input gives different bits."""
    network.compute_W(M=n)
    size = network.W.shape[0]
    mass = scipy.sparse.eye(size) / network.n_meshes
    _, vectors = scipy.sparse.linalg.eigsh(
        network.W, M=mass, k=network.M, which="LM", sigma=-_EIGENVALUE_SHIFT, v0=rng.standard_normal(size)
    )
    return vectors.reshape(network.n_meshes, network.M, network.M)
