"""Milliseconds of one sampler step, and how many times longer it takes written with geomstats operations.

``python -m fmsync.bench.speed_samplers`` prints the table. Times are minima over repeats on one BLAS thread; on a busy
machine trust the ratios.
"""

import time
from collections.abc import Callable

import numpy as np
import pandas as pd

from fmsync import SyncProblem, so
from fmsync._threads import single_threaded_blas
from fmsync.bench.peers.geomstats_rlfm import GeomstatsRLFM
from fmsync.problem import relative_maps
from fmsync.samplers.rlfm import RLFM


def complete_problem(n_nodes: int = 11, n: int = 20, sigma2: float = 0.2, rng: int = 0) -> SyncProblem:
    """The paper's size: random rotations observed on a complete graph through projected Gaussian noise."""
    generator = np.random.default_rng(rng)
    edges = np.array([(i, j) for i in range(n_nodes) for j in range(i + 1, n_nodes)])
    maps = relative_maps(so.random_uniform(n, n_nodes, generator), edges)
    return SyncProblem(n_nodes, edges, so.project(maps + np.sqrt(sigma2) * generator.standard_normal(maps.shape)))


def milliseconds(function: Callable[[], object], budget: float = 0.5, repeats: int = 5) -> float:
    """Shortest mean time of a call over ``repeats`` rounds of ``budget / repeats`` seconds each."""
    function()  # compiles, fills caches
    start = time.perf_counter()
    function()
    count = max(1, int(budget / repeats / max(time.perf_counter() - start, 1e-6)))
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(count):
            function()
        best = min(best, (time.perf_counter() - start) / count)
    return 1e3 * best


def table(chains: tuple[int, ...] = (1, 64)) -> pd.DataFrame:
    """One row for each number of chains and kind of step: milliseconds a chain, and the ratio to ``"rlfm"``."""
    problem, rows = complete_problem(), []
    kinds = {
        "rlfm": (RLFM, {}),
        "rlfm, qf": (RLFM, {"retraction": "qf"}),
        "rlfm, unconstrained": (RLFM, {"constrained": False}),
        "rlfm, geodesic energy": (RLFM, {"energy": "geodesic"}),
        "rlfm on geomstats": (GeomstatsRLFM, {}),
    }
    with single_threaded_blas():
        for count in chains:
            start = so.random_uniform(problem.n, (count, problem.n_nodes), rng=1)
            for name, (kind, options) in kinds.items():
                engine = kind(problem, start, np.random.default_rng(2), **options)
                rows.append((count, name, milliseconds(lambda engine=engine: engine.step(warming=False)) / count))
    frame = pd.DataFrame(rows, columns=["chains", "step", "ms a chain"])
    own = frame[frame.step == "rlfm"].set_index("chains")["ms a chain"]
    frame["times rlfm"] = frame["ms a chain"] / frame.chains.map(own)
    return frame


if __name__ == "__main__":
    print(table().round(3).to_string(index=False))
