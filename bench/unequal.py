"""Problems whose noise is not the same everywhere: its concentration differs by edge or by basis function."""

import numpy as np

from bench.problems import Planted
from data_gen.langevin import langevin_noise
from data_gen.truth import planted
from fmsync import SyncProblem, sample
from fmsync.diagnostics import short_run


def unequal(*, seed: int, n_nodes: int, n: int, low: float, high: float, by: str) -> Planted:
    """Haar-random maps on a complete graph, observed with Langevin noise; the problem's provenance has its ``kappas``.

    By ``"edge"`` they are log-uniform on [low, high]; by ``"frequency"`` they fall from high, of the first basis
    function, to low.
    """
    rng = np.random.default_rng(seed)
    truth = planted(n_nodes, n, rng=rng)
    if by == "edge":
        kappas = np.exp(rng.uniform(np.log(low), np.log(high), len(truth.edges)))
        noise = np.concatenate([langevin_noise(n, kappa, 1, rng) for kappa in kappas])
    else:
        kappas, count = np.geomspace(high, low, n), len(truth.edges)
        one = SyncProblem(2, [[0, 1]], np.diag(kappas)[None])
        with short_run():
            draws = sample(one, "heat-bath", kappa=1.0, n_chains=count, n_draws=1, warmup=100, rng=rng)
        noise = draws.relative()[:, 0, 0]
    problem = SyncProblem(n_nodes, truth.edges, truth.maps @ noise, provenance={"kappas": kappas.tolist()})
    return Planted(problem, truth.absolute)
