"""How fast the samplers are: milliseconds of a step, and independent draws a second.

``python -m bench.speed_samplers`` prints the tables. Times are CPU seconds on one BLAS thread, minima over
repeats for steps; on a busy machine trust the ratios. What two threads take is the CPU time of all that is done less
that of the shorter of two parts done side by side: what the clock shows when both have a core for themselves.
"""

import time
from collections.abc import Callable

import numpy as np
import pandas as pd

import fmsync
from bench.peers.geomstats_rlfm import GeomstatsRLFM
from fmsync import SyncProblem, bounds, diagnostics, langevin, so
from fmsync.energy import gradient
from fmsync.problem import relative_maps
from fmsync.samplers.base import Target
from fmsync.samplers.heat_bath import HeatBath
from fmsync.samplers.rlfm import RLFM, default_step
from fmsync.samplers.thread_pool import ThreadPool
from fmsync.threads import single_threaded_blas

_STEIN_TOLERANCE = 0.05


def complete_problem(n_nodes: int = 11, n: int = 20, sigma2: float = 0.2, rng: int = 0) -> SyncProblem:
    """The paper's size: random rotations observed on a complete graph through projected Gaussian noise."""
    generator = np.random.default_rng(rng)
    edges = np.array([(i, j) for i in range(n_nodes) for j in range(i + 1, n_nodes)])
    maps = relative_maps(so.random_uniform(n, n_nodes, generator), edges)
    return SyncProblem(n_nodes, edges, so.project(maps + np.sqrt(sigma2) * generator.standard_normal(maps.shape)))


def milliseconds(function: Callable[[], object], budget: float = 0.5, repeats: int = 5) -> float:
    """Shortest mean time of a call over ``repeats`` rounds of ``budget / repeats`` seconds each."""
    function()  # compiles, fills caches
    start = time.process_time()
    function()
    count = max(1, int(budget / repeats / max(time.process_time() - start, 1e-6)))
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(count):
            function()
        best = min(best, (time.process_time() - start) / count)
    return 1e3 * best


class _StopwatchPool(ThreadPool):
    """A pool of two threads that adds up the seconds in which one of them works beside the longer part of the other."""

    saved = 0.0

    def parallel_for(self, work: Callable[[int, int], None], count: int) -> None:
        spent = []

        def timed(first: int, last: int) -> None:
            start = time.thread_time()
            work(first, last)
            spent.append(time.thread_time() - start)

        super().parallel_for(timed, count)
        self.saved += sum(spent) - max(spent)


def one_and_two_threads(
    problem: SyncProblem, start: np.ndarray, kappa: float, repeats: int = 5, count: int = 20
) -> tuple[float, float]:
    """Shortest mean CPU seconds of a sweep of the heat bath: by one thread, by two that have a core each."""
    found = []
    for pool in (_StopwatchPool(), _StopwatchPool()):
        engine, best = HeatBath(Target(problem, kappa=kappa), start, np.random.default_rng(0)), np.inf
        engine.threads, pool.size = pool, 1 + len(found)
        engine.step(warmup=False)  # compiles, starts the thread
        with single_threaded_blas():
            for _ in range(repeats):
                saved, begin = pool.saved, time.process_time()
                for _ in range(count):
                    engine.step(warmup=False)
                spent = time.process_time() - begin - (pool.saved - saved)
                best = min(best, spent / count)
        found.append(best)
    return found[0], found[1]


def table(chains: tuple[int, ...] = (1, 64)) -> pd.DataFrame:
    """One row for each number of chains and kind of step: milliseconds a chain, and the ratio to ``"rlfm"``."""
    problem, rows = complete_problem(), []
    kinds = {
        "rlfm": (RLFM, {}, {}),
        "rlfm, qf": (RLFM, {}, {"retraction": "qf"}),
        "rlfm, unconstrained": (RLFM, {}, {"constrained": False}),
        "rlfm, geodesic energy": (RLFM, {"energy": "geodesic"}, {}),
        "rlfm on geomstats": (GeomstatsRLFM, {}, {}),
    }
    with single_threaded_blas():
        for count in chains:
            start = so.random_uniform(problem.n, (count, problem.n_nodes), rng=1)
            for name, (kind, given, options) in kinds.items():
                engine = kind(Target(problem, **given), start, np.random.default_rng(2), **options)
                rows.append((count, name, milliseconds(lambda engine=engine: engine.step(warmup=False)) / count))
    frame = pd.DataFrame(rows, columns=["chains", "step", "ms a chain"])
    own = frame[frame.step == "rlfm"].set_index("chains")["ms a chain"]
    frame["times rlfm"] = frame["ms a chain"] / frame.chains.map(own)
    return frame


def efficiency(problem: SyncProblem, method: str, n_draws: int, warmup: int, **options) -> tuple[float, float, float]:
    """Least ESS over the energy, tr C_12 and an entry of C_12: by CPU second, by second of the clock, and by step.

    The clock runs from the first draw kept to the last.
    """
    seen, times = [], []

    def watch(draw: int, state: np.ndarray, energy: np.ndarray) -> None:
        c_12 = so.transpose(state[:, 0]) @ state[:, 1]
        seen.append((energy.copy(), np.trace(c_12, axis1=1, axis2=2), c_12[:, 0, 0]))
        times.append((time.process_time(), time.perf_counter()))

    post = fmsync.sample(problem, method, n_draws=n_draws, warmup=warmup, callback=watch, **options)
    least = min(diagnostics.ess(x.T) for x in np.array(seen).transpose(1, 0, 2))  # (3, draws, chains)
    cpu, clock = np.subtract(times[-1], times[0])
    return least / cpu, least / clock, least / (n_draws * post.n_chains * post.settings["thin"])


def stein_ratio(problem: SyncProblem, kappa: float, step: float) -> float:
    r"""Measured :math:`E\lVert\nabla\log p\rVert^2 / ((n-1)\kappa\,E\sum\operatorname{tr})` of rlfm; 1 if unbiased."""
    squares, traces = [], []

    def record(draw, state, energy):
        squares.append(((kappa / 2 * gradient(problem, state)) ** 2).sum((1, 2, 3)).mean())
        traces.append((problem.constant - energy).mean() / 2)

    chains = {"n_chains": 16, "n_draws": 60, "warmup": 400, "thin": 10, "rng": 0, "init": "spectral"}
    try:
        fmsync.sample(problem, "rlfm", kappa=kappa, step=step, callback=record, **chains)
    except RuntimeError:  # diverged
        return np.inf
    return np.mean(squares) / ((problem.n - 1) * kappa * np.mean(traces))


def draws_a_second(sigma2: float = 0.2) -> pd.DataFrame:
    """Independent draws a second at N = 11, n = 20, complete, matched κ: one row a sampler, called as a user would.

    The heat bath shares its chains out over the cores (``NUMBA_NUM_THREADS``), the others have nothing to share; the
    seconds of the clock mean something on an idle machine only. rlfm runs at the largest step, in factors of 2^(1/2),
    whose Stein ratio is within 5 %. On geomstats operations it is the same chain: its draws a step are those of ours,
    its time a step is measured.
    """
    problem = complete_problem(sigma2=sigma2)
    kappa = langevin.matched_kappa(problem.n, bounds.projected_noise_moments(problem.n, sigma2)[0] / problem.n)
    rows = []
    for method, n_draws, warmup in (("heat-bath", 8000, 200), ("hmc", 2000, 400), ("mala", 8000, 1500)):
        rows.append((method, *efficiency(problem, method, n_draws, warmup, kappa=kappa, n_chains=4)[:2]))
    for multiple in 2.0 ** np.arange(3, -6, -0.5):
        step = multiple * default_step(problem, kappa)
        ratio = stein_ratio(problem, kappa, step)
        if abs(ratio - 1) < _STEIN_TOLERANCE:
            break
    *ours, by_step = efficiency(problem, "rlfm", 6000, 500, kappa=kappa, step=step, n_chains=4, thin=4)
    rows.append((f"rlfm, {multiple:.2f} default steps, Stein {ratio:.3f}", *ours))
    with single_threaded_blas():
        start = so.random_uniform(problem.n, (4, problem.n_nodes), rng=1)
        engine = GeomstatsRLFM(Target(problem, kappa=kappa), start, np.random.default_rng(2), step=step)
        per_step = milliseconds(lambda: engine.step(warmup=False)) / 1e3 / 4
    rows.append(("the same on geomstats", *[by_step / per_step] * 2))
    columns = ["sampler", "min ESS a CPU second", "min ESS a second"]
    frame = pd.DataFrame(rows, columns=columns)
    for column in columns[1:]:
        frame["heat bath: times, by " + column.removeprefix("min ESS a ")] = frame[column].iloc[0] / frame[column]
    return frame


def sparse_sweeps() -> pd.DataFrame:
    """Seconds of a heat-bath sweep at N = 1,000, n = 20 against the number of edges."""
    rows, rng = [], np.random.default_rng(0)
    for n_edges in (2_500, 5_000, 10_000, 20_000):
        pairs = {(i, i + 1) for i in range(999)}
        while len(pairs) < n_edges:
            i, j = sorted(rng.integers(1000, size=2).tolist())
            if i != j:
                pairs.add((i, j))
        problem = SyncProblem(1000, sorted(pairs), so.random_uniform(20, n_edges, rng))
        start = so.random_uniform(20, (1, 1000), rng)
        rows.append((n_edges, *one_and_two_threads(problem, start, 8.0, count=4)))
    return pd.DataFrame(rows, columns=["edges", "seconds a sweep", "by two threads"])


def stretch_steps() -> pd.DataFrame:
    """What a draw of all stretches costs beside a sweep over the maps."""
    rows = []
    for sigma2 in (0.1, 0.2):
        problem = complete_problem(sigma2=sigma2)
        start = fmsync.solve(problem, "mle").absolute[None]
        plain, full = (
            HeatBath(Target(problem, **options), start, np.random.default_rng(0))
            for options in ({"kappa": 1 / sigma2}, {"likelihood": "projected-gaussian"})
        )
        with single_threaded_blas():
            for _ in range(150):
                full.step(warmup=False)
            sweep, both = (milliseconds(lambda e=engine: e.step(warmup=False)) for engine in (plain, full))
        rows.append((sigma2, sweep, both - sweep, both / sweep - 1))
    return pd.DataFrame(rows, columns=["sigma2", "ms a map sweep", "ms a stretch step", "in map sweeps"])


if __name__ == "__main__":
    for made in (table, draws_a_second, sparse_sweeps, stretch_steps):
        print(made().round(3).to_string(index=False), end="\n\n", flush=True)
