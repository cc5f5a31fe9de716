"""What the runner costs beside the methods it runs. Run: ``python -m bench.speed_runner``.

Prints CPU milliseconds of a short cell beside its method (problem made, limits set, answer measured, record sent and
written) as a share of the method's own; and what the chains of ten seeds gain that advance as one batch. On a busy
machine trust the ratios.
"""

import os
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

import fmsync
from bench import methods
from bench.runner import run_cells
from bench.speed_samplers import complete_problem
from bench.store import Store
from bench.suites import Cell
from fmsync.samplers.together import sample_together

_COUNT = 60  # cells of a round ...
_METHODS = 5  # ... so many for each problem
_METHOD = """
import numpy as np
from bench.methods import Answer, method


@method("some-work")
def some_work(problem, *, rng, products: int):
    matrix = np.eye(20)
    for _ in range(products):
        matrix = matrix @ matrix
    return Answer.from_absolute(np.stack([np.eye(problem.n)] * problem.n_nodes))
"""
_CHAINS = {
    "Euclidean": {},
    "unconstrained": {"constrained": False},
    "geodesic": {"energy": "geodesic"},
}


def overhead(folder: Path) -> None:
    """Print CPU milliseconds of a cell beside its method, and their share of the method's own."""
    file = folder / "some_work.py"
    file.write_text(_METHOD)
    methods.load(file)
    name, generator = "some-work", "bench.problems:rotations"
    problem = {"n_nodes": 4, "n": 5, "sigma2": 0.1}
    products = 37_000  # about 50 ms
    for n_jobs in (1, 2):
        rounds = []
        for k in range(6):
            seeds = range(k * _COUNT, (k + 1) * _COUNT, _METHODS)  # as in a suite, several methods meet a problem
            options = [{"products": products + method} for method in range(_METHODS)]
            todo = [Cell(generator, problem, s, name, name, one, file=str(file)) for s in seeds for one in options]
            began = _cpu_of_all()
            run = run_cells(todo, Store(folder / str(n_jobs)), n_jobs=n_jobs)
            spent = (_cpu_of_all() - began) / _COUNT
            own = np.mean([value for r in run.records for metric, _, value in r["metrics"] if metric == "cpu_seconds"])
            rounds.append((spent / own - 1, own, spent - own))
        share, own, rest = np.median(rounds[1:], axis=0)  # the first round imports, compiles and starts the processes
        print(f"{n_jobs} at a time: method {1e3 * own:.1f} ms, beside it {1e3 * rest:.2f} ms, {share:.1%}", flush=True)


def _cpu_of_all() -> float:
    """CPU seconds of this process and of its workers."""
    spent, tick = time.process_time(), os.sysconf("SC_CLK_TCK")
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == os.getpid():
            spent += (int(fields[11]) + int(fields[12])) / tick
    return spent


def batches(n_nodes: int, count: int = 10, rounds: int = 3) -> None:
    """Print CPU milliseconds of a step of one chain of ``"rlfm"``, alone and in a batch of chains of other problems."""
    problems = [complete_problem(n_nodes, rng=seed) for seed in range(count)]
    print(f"\nN = {n_nodes}: CPU ms of a step of one chain, draws kept, alone and as one of {count}")
    for name, options in _CHAINS.items():
        n_draws, warmup = 40, 20
        run = {"n_draws": n_draws, "warmup": warmup, **options}

        def alone(run=run):
            for seed, problem in enumerate(problems):
                fmsync.sample(problem, "rlfm", n_chains=1, rng=seed, **run)

        def together(run=run):
            sample_together(problems, rngs=range(count), **run)

        spent = []
        for way in [alone, together] * (rounds + 1):
            began = time.process_time()
            way()
            spent.append(1e3 * (time.process_time() - began) / count / (n_draws + warmup))
        each = np.median(np.reshape(spent[2:], (rounds, 2)), axis=0)  # the first round compiles
        print(f"{name:15s} {each[0]:8.3f} {each[1]:8.3f}   gain {each[0] / each[1]:5.2f}x", flush=True)


def main() -> None:
    """Print all tables."""
    warnings.simplefilter("ignore", fmsync.diagnostics.ConvergenceWarning)  # nobody reads these draws
    with tempfile.TemporaryDirectory() as folder:
        overhead(Path(folder))
    for n_nodes in (4, 11):
        batches(n_nodes)


if __name__ == "__main__":
    main()
