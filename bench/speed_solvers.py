"""How fast the solvers are, beside pymanopt and across sizes: ``python -m bench.speed_solvers [--large]``.

Seconds are of CPU time, which other users of the machine disturb least, and every ratio is the median over pairs of
runs in turn. Peak memory is what NumPy allocated during the call, divided by the size of the observed maps.
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


def in_turn(runs: list[Callable[[], fmsync.Estimate]], repeats: int) -> tuple[np.ndarray, list[fmsync.Estimate]]:
    """(CPU seconds (repeats, runs), estimates of the last round)."""
    seconds, estimates = np.empty((repeats, len(runs))), []
    for round_ in seconds:
        estimates = []
        for k, run in enumerate(runs):
            began = time.process_time()
            estimates.append(run())
            round_[k] = time.process_time() - began
    return seconds, estimates


def fresh(problem: SyncProblem) -> SyncProblem:
    """The same problem with nothing computed yet."""
    return SyncProblem(problem.n_nodes, problem.edges, problem.maps)


def against_pymanopt(repeats: int, n_seeds: int = 10) -> None:
    """Both from the spectral start, initialisation included, to the same gradient norm."""
    print(f"N = 11, n = 20, complete, gradient norm 1e-6; medians over {n_seeds} seeds")
    print("sigma2   mle     pymanopt  ratio  cost differences: least, greatest   ours higher")
    for sigma2 in (0.2, 0.6, 1.0):
        seconds, differences = [], []
        for seed in range(n_seeds):
            problem, _ = noisy_problem(nx.complete_graph(11).edges, 20, sigma2, seed)
            runs = [
                lambda: fmsync.solve(problem, "mle"),  # noqa: B023
                lambda: fmsync.solve(problem, "mle-pymanopt", init="spectral"),  # noqa: B023
            ]
            taken, (ours, theirs) = in_turn(runs, repeats)
            seconds.append(taken)
            differences.append(ours.cost - theirs.cost)
        seconds = np.concatenate(seconds)
        ours, theirs = np.median(seconds, axis=0)
        ratio = np.median(seconds[:, 1] / seconds[:, 0])
        higher = sum(difference > 1e-6 for difference in differences)
        print(
            f"{sigma2:<7}  {ours:.4f}  {theirs:.4f}    {ratio:.2f}   "
            f"{min(differences):+.1e}, {max(differences):+.1e}   {higher} of {n_seeds}"
        )


def across_sizes(sizes: list[int]) -> None:
    """Sparse graphs: seconds and error of spectral start and maximum likelihood together, and peak memory."""
    print("\nmean degree 20, n = 20, sigma2 = 0.1, initialisation included")
    print("N      edges   seconds  peak/maps  steps  error/expected")
    edges, seconds = [], []
    for n_nodes in sizes:
        problem, truth = noisy_problem(sparse_edges(n_nodes), 20, 0.1, seed=1)
        taken, (estimate,) = in_turn([lambda: fmsync.solve(problem, "mle")], 1)  # noqa: B023
        problem = fresh(problem)
        tracemalloc.start()
        fmsync.solve(problem, "mle")
        peak = tracemalloc.get_traced_memory()[1] / problem.maps.nbytes
        tracemalloc.stop()
        expected = np.sqrt(
            (fmsync.expected_rms_error(n_nodes, problem.edges, 20, 0.1, problem.edges[:500]) ** 2).mean()
        )
        error = rms_error(estimate, truth) / expected  # of all edges, which the line of 500 stands for
        row = f"{n_nodes:<6} {problem.n_edges:<7} {taken[0, 0]:<8.2f} {peak:<10.2f}"
        print(f"{row} {estimate.n_iterations:<6} {error:.3f}")
        edges.append(problem.n_edges)
        seconds.append(taken.item())
    print(f"exponent in edges {np.polyfit(np.log(edges), np.log(seconds), 1)[0]:.2f}")


def complete_graph(n_nodes: int = 200) -> None:
    """A complete graph, where one dense product serves."""
    problem, truth = noisy_problem(nx.complete_graph(n_nodes).edges, 20, 0.2, seed=1)
    taken, (estimate,) = in_turn([lambda: fmsync.solve(fresh(problem), "mle")], 3)
    expected = fmsync.expected_rms_error(n_nodes, problem.edges, 20, 0.2)[0]
    print(f"\ncomplete N = {n_nodes}, sigma2 = 0.2: {np.median(taken):.2f} s, {estimate.n_iterations} steps,", end=" ")
    print(f"error/expected {rms_error(estimate, truth) / expected:.3f}")


def streams(n_nodes: int = 1000) -> None:
    """A shape more, or a hundred edges: from the earlier answer against from nothing."""
    edges = sparse_edges(n_nodes)
    problem, _ = noisy_problem(edges, 20, 0.1, seed=1)
    fewer_edges = SyncProblem(n_nodes, edges[:-100], problem.maps[:-100])
    kept = (edges < n_nodes - 1).all(axis=1)
    fewer_nodes = SyncProblem(n_nodes - 1, edges[kept], problem.maps[kept])
    starts = ["spectral", fmsync.solve(fewer_edges, "mle"), fmsync.solve(fewer_nodes, "mle")]
    runs = [lambda start=start: fmsync.solve(fresh(problem), "mle", init=start) for start in starts]
    seconds, _ = in_turn(runs, 5)
    edges_ratio, shape_ratio = np.median(seconds[:, 1:] / seconds[:, :1], axis=0)
    print(f"\nN = {n_nodes}, warm/cold seconds: a hundred edges {edges_ratio:.2f}, a shape {shape_ratio:.2f}")


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
