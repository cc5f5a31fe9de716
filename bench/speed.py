"""How fast the library is beside other software and the limits of the machine: ``results/speed.json``.

``python -m bench.speed`` measures each row at least five times, ours and its reference in turn, so that a machine whose
speed changes meanwhile slows both. One thread, CPU seconds. ``python -m bench.speed large`` solves, once, a problem of
a million maps; to make it takes 20 GB. ``... sweep`` is of the heat bath, and ``... workers`` solves and draws in one
process and in two, by the clock.
"""

import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType

import joblib
import networkx as nx
import numpy as np
from distributed import Client, LocalCluster

import bench.peers  # noqa: F401  registers the peers
import data_gen
import fmsync
from bench.provenance import versions
from bench.runner import peak_memory
from bench.studies import add_part
from fmsync import so
from fmsync.block_products import add_products
from fmsync.energy import transposed_sums_unchecked as transposed_sums
from fmsync.samplers.base import Target
from fmsync.samplers.heat_bath import HeatBath
from fmsync.samplers.rlfm import RLFM
from fmsync.threads import single_threaded_blas

_TABLE = Path("results/speed.json")
KINDS, SIZES, N, DEGREE, SIGMA2, RUNS = ("float64", "float32"), (300, 1000, 3000, 10000), 20, 20, 0.1, 5
_PLAIN = (
    "import time, numpy, scipy.linalg, scipy.sparse.csgraph, scipy.special; t = time.process_time(); import fmsync; "
)
_TINY = "p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], numpy.stack([numpy.eye(4)] * 3)); "
_FIRST = {
    "import": "",
    "first solve": f"{_TINY}fmsync.solve(p); ",
    "first heat bath": f"{_TINY}fmsync.sample(p, 'heat-bath', kappa=5.0, n_draws=5, warmup=5); ",
}


def seconds(work: Callable[[], object]) -> float:
    """CPU seconds of one call."""
    began = time.process_time()
    work()
    return time.process_time() - began


def paired(first: Callable[[], object], second: Callable[[], object], runs: int = RUNS) -> dict[str, float]:
    """Median seconds of both, measured in turn after one call each, and quartiles of the ratio of the second."""
    first(), second()
    times = np.array([(seconds(first), seconds(second)) for _ in range(runs)])
    low, ratio, high = np.quantile(times[:, 1] / times[:, 0], [0.25, 0.5, 0.75])
    ours, theirs = np.median(times, axis=0)
    return {"ours": ours, "reference": theirs, "ratio": ratio, "ratio_low": low, "ratio_high": high}


def problem(n_nodes: int, noise: int = 2, ring: bool = False) -> fmsync.SyncProblem:
    """Haar-random truth on a random graph of mean degree 20, observed with the paper's noise, which has a seed.

    Or on a ``ring``, where neighbours lie side by side in memory.
    """
    if ring:
        graph = nx.circulant_graph(n_nodes, range(1, DEGREE // 2 + 1))
    else:
        graph = data_gen.random_graph(n_nodes, DEGREE / (n_nodes - 1), rng=0)
    return data_gen.perturb(data_gen.planted(n_nodes, N, graph, rng=1), SIGMA2, noise)


def neighbour_sums(p: fmsync.SyncProblem, dtype: np.dtype) -> dict[str, float]:
    """Rates of sums over neighbours, of NumPy's batched products, and of one large product, in GFlop/s."""
    maps, blocks = p.maps.astype(dtype), so.random_uniform(N, p.n_nodes, 1).astype(dtype)
    square, flops, large = np.ones((1000, 1000), dtype), 4 * p.n_edges * N**3 / 1e9, 2.0
    (i, j), copy = p.edges.T, maps.copy()

    def by_numpy() -> None:
        out = np.zeros_like(blocks)
        np.add.at(out, i, maps @ blocks[j])
        np.add.at(out, j, so.transpose(maps) @ blocks[i])

    ours = paired(lambda: transposed_sums(p, blocks, maps), by_numpy, 2 * RUNS)
    limit = paired(lambda: transposed_sums(p, blocks, maps), lambda: square @ square, 2 * RUNS)
    return ours | {
        "rate": flops / limit["ours"], "large": large / limit["reference"],
        "share": flops / large * limit["ratio"],  # of the rate of the large product, pair by pair
        "copied": 2 * maps.nbytes / paired(lambda: np.copyto(copy, maps), lambda: None)["ours"] / 1e9,  # GB/s
        "read": maps.nbytes / limit["ours"] / 1e9,
    }  # fmt: skip


def solves(p: fmsync.SyncProblem) -> dict[str, float]:
    """Seconds of ``"mle"``, of large products of as many operations, and its memory over that of the observations."""
    times, done, square = [seconds(lambda: fmsync.solve(p)) for _ in range(RUNS)], [], np.ones((1000, 1000))

    def watch(frame: FrameType, event: str, argument: object) -> None:
        if event == "call" and frame.f_code is add_products.__code__:
            done.append(len(frame.f_locals["to"]))

    tracemalloc.start(), sys.setprofile(watch)
    try:
        fmsync.solve(p)
        memory = tracemalloc.get_traced_memory()[1] / p.maps.nbytes
    finally:
        tracemalloc.stop(), sys.setprofile(None)
    large = np.median([seconds(lambda: square @ square) for _ in range(RUNS)])
    found = {"n_nodes": p.n_nodes, "n_edges": p.n_edges} | _quartiles(times)
    return found | {"limit": sum(done) * 2 * N**3 / 2e9 * large, "memory": memory}


def warm(p: fmsync.SyncProblem, other: fmsync.SyncProblem) -> dict[str, float]:
    """A solve after 2 % of the edges were observed anew, from the solution before, beside a cold one."""
    before, maps = fmsync.solve(p, tolerance="statistical"), p.maps.copy()
    changed = np.random.default_rng(0).permutation(p.n_edges)[: p.n_edges // 50]
    maps[changed] = other.maps[changed]
    new = fmsync.SyncProblem(p.n_nodes, p.edges, maps)
    return paired(
        lambda: fmsync.solve(new, tolerance="statistical", init=before),
        lambda: fmsync.solve(new, tolerance="statistical"),
    )


def steps() -> dict[str, float]:
    """An RLFM step of one chain, ours, beside that of one of 64, at N = 11."""
    p = data_gen.perturb(data_gen.planted(11, N, rng=0), 0.2, 1)
    start = fmsync.solve(p).absolute
    alone, many = (RLFM(Target(p, None, 8.1), np.stack([start] * k), np.random.default_rng(0)) for k in (1, 64))
    return paired(lambda: many.step(False), lambda: [alone.step(False) for _ in range(64)], 2 * RUNS)


def sweep() -> dict[str, float]:
    """A sweep of the heat bath at N = 11, beside large products of as many operations as its sums over neighbours."""
    p = data_gen.perturb(data_gen.planted(11, N, rng=0), 0.2, 1)
    bath = HeatBath(Target(p, None, 8.1), fmsync.solve(p).absolute[None], np.random.default_rng(0))
    square, count = np.ones((1000, 1000)), 10 * round(2e8 / (4 * p.n_edges * N**3))  # whole tens, as it goes ahead
    with single_threaded_blas():
        found = paired(lambda: [bath.step(False) for _ in range(count)], lambda: square @ square, 2 * RUNS)
    return found | {"ours": found["ours"] / count}


def first_calls() -> dict[str, dict[str, float]]:
    """CPU seconds of first calls in new processes, beyond NumPy and SciPy; compiled before, and anew."""
    found = {}
    for name, call in _FIRST.items():
        line = [sys.executable, "-W", "ignore", "-c", f"{_PLAIN}{call}print(time.process_time() - t)"]
        with tempfile.TemporaryDirectory() as kept:
            runs = [_printed(line, kept) for _ in range(RUNS + 1)]  # the first one fills the cache
        found[name] = _quartiles(runs[1:])
    compiled = []
    for _ in range(RUNS):
        with tempfile.TemporaryDirectory() as empty:
            compiled.append(_printed(line, empty))
    return found | {f"{name}, compiled anew": _quartiles(compiled)}


def _printed(line: list[str], cache: str) -> float:
    return float(subprocess.check_output(line, text=True, env={**os.environ, "NUMBA_CACHE_DIR": cache}))


def _quartiles(seconds: Sequence[float]) -> dict[str, float]:
    return dict(zip(("low", "seconds", "high"), np.quantile(seconds, [0.25, 0.5, 0.75]).tolist()))


def large(n_nodes: int = 100_000) -> dict[str, float]:
    """CPU seconds of one solve, GB of its maps, and the most GB that the process held meanwhile, maps included."""
    p = problem(n_nodes)
    peak_memory(forget=True)
    with single_threaded_blas():
        taken = seconds(lambda: fmsync.solve(p))
    sizes = {"n_nodes": n_nodes, "n_edges": p.n_edges, "maps": p.maps.nbytes / 1e9}
    return sizes | {"seconds": taken, "peak": peak_memory() * 2**20 / 1e9, "versions": versions()}


def solved(p: fmsync.SyncProblem, seed: int) -> float:
    """The cost of one of many solves."""
    with single_threaded_blas():
        return fmsync.solve(p, rng=seed).cost


def sampled(p: fmsync.SyncProblem, seed: int) -> float:
    """The mean energy of one of many chains."""
    with fmsync.diagnostics.short_run():
        post = fmsync.sample(p, "heat-bath", kappa=8.1, n_chains=1, n_draws=2000, warmup=100, rng=seed)
    return float(post.energy.mean())


def workers(tasks: int) -> dict[str, dict[str, dict[str, float]]]:
    """Seconds by the clock of so many solves and chains, in one process and in two, in turn after one round."""
    works = {
        "solves of 1,000 shapes": (solved, problem(1000)),
        "chains of the heat bath, 11 shapes": (sampled, data_gen.perturb(data_gen.planted(11, N, rng=0), 0.2, 1)),
    }
    seeds, found = range(tasks), {}
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        for what, (work, p) in works.items():
            sent, each, taken = client.scatter(p, broadcast=True), joblib.delayed(work), []
            ways = {
                "one process": lambda work=work, p=p: [work(p, k) for k in seeds],
                "joblib": lambda each=each, p=p: joblib.Parallel(2)(each(p, k) for k in seeds),
                "Dask": lambda work=work, p=sent: client.gather([client.submit(work, p, k, pure=False) for k in seeds]),
            }
            for _ in range(RUNS + 1):
                marks = [time.perf_counter()]
                for way in ways.values():
                    way()
                    marks.append(time.perf_counter())
                taken.append(np.diff(marks))
            found[what] = {way: _quartiles(times) for way, times in zip(ways, np.transpose(taken[1:]))}
    return found


def logarithms_by_eigenvectors(r: np.ndarray) -> np.ndarray:
    """Logarithms (B, n, n) of rotations from the eigenvectors of their symmetric parts, which angles near π spoil."""
    cosine, v = np.linalg.eigh(so.sym(r))
    moved = so.skew(r) @ v
    sine = np.linalg.norm(moved, axis=-2)
    ratio = np.divide(np.arctan2(sine, cosine), sine, out=np.ones_like(sine), where=sine > 1e-9)
    return so.skew((moved * ratio[:, None]) @ so.transpose(v))


def main() -> None:
    """Measure, and write the file."""
    if sys.argv[1:] == ["large"]:
        add_part(_TABLE, "large", large(), "python -m bench.speed large")
        return
    if sys.argv[1:] == ["sweep"]:
        add_part(_TABLE, "sweep", sweep() | {"versions": versions()}, "python -m bench.speed sweep")
        return
    if sys.argv[1:] == ["workers"]:
        found = {"tasks": 8, "seconds": workers(8), "versions": versions()}
        add_part(_TABLE, "workers", found, "python -m bench.speed workers")
        return
    small, middle = problem(100), problem(1000)
    turns = so.exp(2 * so.skew(0.07 * np.random.default_rng(0).standard_normal((1000, N, N))))
    with single_threaded_blas():
        found = {
            "sums": {kind: neighbour_sums(problem(3000), np.dtype(kind)) for kind in KINDS},
            "on a ring": {kind: neighbour_sums(problem(3000, ring=True), np.dtype(kind)) for kind in KINDS},
            "peer": paired(lambda: fmsync.solve(small), lambda: fmsync.solve(small, "mle-pymanopt")),
            "warm": warm(middle, problem(1000, noise=3)),
            "steps": steps(),
            "mean": paired(lambda: so.frechet_mean(turns), lambda: logarithms_by_eigenvectors(turns)),
            "solves": [solves(problem(size)) for size in SIZES],
        }
    found |= {"versions": versions(), "first": first_calls()}
    add_part(_TABLE, "speed", found, "python -m bench.speed")


if __name__ == "__main__":
    main()
