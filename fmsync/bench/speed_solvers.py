"""How fast the solvers are, beside pymanopt and across sizes: ``python -m fmsync.bench.speed_solvers [--large]``.

Every ratio is of two numbers of the same run on one core, since seconds depend on the machine. Peak memory is what
NumPy allocated during the call, divided by the size of the observed maps.
"""

import argparse
import time
import tracemalloc
from collections.abc import Callable

import networkx as nx
import numpy as np

import fmsync
from fmsync import so
from fmsync.problem import SyncProblem, relative_maps


def noisy_problem(edges: np.ndarray, n: int, sigma2: float, seed: int) -> tuple[SyncProblem, np.ndarray]:
    """(problem, true relative maps) with noise proj(C_ij + σG) on planted Haar rotations."""
    edges = np.asarray(edges)
    rng = np.random.default_rng(seed)
    n_nodes = int(edges.max()) + 1
    truth = relative_maps(so.random_uniform(n, n_nodes, rng), edges)
    maps = np.empty_like(truth)
    for first in range(0, len(edges), 4096):
        part = slice(first, first + 4096)
        maps[part] = so.project(truth[part] + np.sqrt(sigma2) * rng.standard_normal(truth[part].shape))
    return SyncProblem(n_nodes, edges, maps), truth


def sparse_edges(n_nodes: int, seed: int = 0) -> np.ndarray:
    """A connected random graph of mean degree 20."""
    return np.array(nx.random_regular_graph(20, n_nodes, seed=seed).edges)


def best_seconds(run: Callable[[], object], repeats: int) -> tuple[float, object]:
    """(seconds of the fastest run, its result)."""
    seconds, result = [], None
    for _ in range(repeats):
        began = time.perf_counter()
        result = run()
        seconds.append(time.perf_counter() - began)
    return min(seconds), result


def against_pymanopt(repeats: int) -> None:
    """Both from the spectral start, initialisation included, to the same gradient norm."""
    print("N = 11, n = 20, complete, gradient norm 1e-6; seconds")
    print("sigma2   mle     pymanopt  ratio  cost difference")
    for sigma2 in (0.2, 0.6, 1.0):
        ours, theirs, difference = 0.0, 0.0, 0.0
        for seed in range(3):
            problem, _ = noisy_problem(nx.complete_graph(11).edges, 20, sigma2, seed)
            seconds, estimate = best_seconds(lambda: fmsync.solve(problem, "mle"), repeats)  # noqa: B023
            ours += seconds / 3
            seconds, other = best_seconds(lambda: fmsync.solve(problem, "mle-pymanopt", init="spectral"), repeats)  # noqa: B023
            theirs += seconds / 3
            difference = max(difference, estimate.cost - other.cost, key=abs)
        print(f"{sigma2:<7}  {ours:.4f}  {theirs:.4f}    {theirs / ours:.2f}   {difference:+.1e}")


def across_sizes(sizes: list[int]) -> None:
    """Sparse graphs: seconds and error of spectral start and maximum likelihood together, and peak memory."""
    print("\nmean degree 20, n = 20, sigma2 = 0.1, initialisation included")
    print("N      edges   seconds  peak/maps  steps  error/expected")
    edges, seconds = [], []
    for n_nodes in sizes:
        problem, truth = noisy_problem(sparse_edges(n_nodes), 20, 0.1, seed=1)
        tracemalloc.start()
        taken, estimate = best_seconds(lambda: fmsync.solve(problem, "mle"), 1)  # noqa: B023
        peak = tracemalloc.get_traced_memory()[1] / problem.maps.nbytes
        tracemalloc.stop()
        expected = np.sqrt(
            (fmsync.expected_rms_error(n_nodes, problem.edges, 20, 0.1, problem.edges[:500]) ** 2).mean()
        )
        error = rms_error(estimate, truth) / expected  # of all edges, which the line of 500 stands for
        print(f"{n_nodes:<6} {problem.n_edges:<7} {taken:<8.2f} {peak:<10.2f} {estimate.n_iterations:<6} {error:.3f}")
        edges.append(problem.n_edges)
        seconds.append(taken)
    print(f"exponent in edges {np.polyfit(np.log(edges), np.log(seconds), 1)[0]:.2f}")


def complete_graph(n_nodes: int = 200) -> None:
    """A complete graph, where one dense product serves."""
    problem, truth = noisy_problem(nx.complete_graph(n_nodes).edges, 20, 0.2, seed=1)
    taken, estimate = best_seconds(lambda: fmsync.solve(problem, "mle"), 2)
    expected = fmsync.expected_rms_error(n_nodes, problem.edges, 20, 0.2)[0]
    print(f"\ncomplete N = {n_nodes}, sigma2 = 0.2: {taken:.2f} s, {estimate.n_iterations} steps,", end=" ")
    print(f"error/expected {rms_error(estimate, truth) / expected:.3f}")


def streams(n_nodes: int = 1000) -> None:
    """A shape more, or a hundred edges: from the earlier answer against from nothing."""
    edges = sparse_edges(n_nodes)
    problem, _ = noisy_problem(edges, 20, 0.1, seed=1)
    cold, _ = best_seconds(lambda: fmsync.solve(problem, "mle"), 2)
    print(f"\nN = {n_nodes}, warm/cold seconds:", end=" ")
    fewer_edges = SyncProblem(n_nodes, edges[:-100], problem.maps[:-100])
    kept = (edges < n_nodes - 1).all(axis=1)
    fewer_nodes = SyncProblem(n_nodes - 1, edges[kept], problem.maps[kept])
    for change, before in (("a hundred edges", fewer_edges), ("a shape", fewer_nodes)):
        earlier = fmsync.solve(before, "mle")
        warm, _ = best_seconds(lambda: fmsync.solve(problem, "mle", init=earlier), 2)  # noqa: B023
        print(f"{change} {warm / cold:.2f} ", end=" ")
    print()


def rms_error(estimate: fmsync.Estimate, truth: np.ndarray) -> float:
    """Root-mean-square Frobenius error over the edges."""
    return float(np.sqrt(((estimate.relative() - truth) ** 2).sum((1, 2)).mean()))


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--large", action="store_true", help="go up to N = 10,000 (about two minutes, 2 GB)")
    arguments = parser.parse_args()
    small, _ = noisy_problem(sparse_edges(150), 20, 0.1, seed=0)
    fmsync.solve(small, "mle")  # compiles the kernels
    against_pymanopt(repeats=5)
    complete_graph()
    streams()
    across_sizes([300, 1000, 3000, 10_000] if arguments.large else [300, 1000, 3000])


if __name__ == "__main__":
    main()
