"""Problems of the benchmark suites, made from plain parameters and a seed.

A suite names a function of this file, such as ``bench.problems:rotations``; imported while it runs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from data_gen.collections import collection_files, load_collection
from data_gen.graphs import random_graph
from data_gen.noise import perturb
from data_gen.truth import GroundTruth, ground_truth
from data_gen.truth import planted as planted_rotations
from fmsync import bounds
from fmsync.problem import SyncProblem, relative_maps
from fmsync.shape import Basis, Shape

_MOST_NODES = 1500  # beyond it the factor of a random graph's Laplacian is dense, and there are no reference lines
_ONE_EDGE = np.array([[0, 1]])  # of resistance 1
_MOST_PAIRS = 2000  # pairs that an "all pairs" metric looks at; larger problems show a fixed random sample


@dataclass(frozen=True, eq=False)
class Planted:
    """A problem with a known answer. Methods see ``problem`` alone, controls that ask for it see the truth too.

    ``truth`` (N, n, n) are rotations, ``references`` small-error bound and expected value of the error by name. Where
    point maps are to be scored, ``bases`` are those of the N shapes, ``scored`` (P,) the vertices whose images are
    scored, the same on every shape, and ``distances`` for each shape (P, V) geodesic distances from these vertices to
    all, in square roots of its area.
    """

    problem: SyncProblem
    truth: np.ndarray
    references: Mapping[str, float] = field(default_factory=dict)
    bases: tuple[Basis, ...] = ()
    scored: np.ndarray | None = None
    distances: tuple[np.ndarray, ...] = ()

    def relative(self, pairs: np.ndarray) -> np.ndarray:
        """True relative maps (K, n, n) of pairs (K, 2)."""
        return relative_maps(self.truth, pairs)

    def pairs(self) -> np.ndarray:
        """(K, 2) pairs i < j of all nodes; 2000 fixed random ones of a problem that has more."""
        n_nodes = self.problem.n_nodes
        if n_nodes * (n_nodes - 1) // 2 <= _MOST_PAIRS:
            return np.stack(np.triu_indices(n_nodes, 1), axis=1)
        rng = np.random.default_rng(0)
        drawn = np.sort(rng.integers(n_nodes, size=(4 * _MOST_PAIRS, 2)), axis=1)
        pairs = np.unique(drawn[drawn[:, 0] != drawn[:, 1]], axis=0)
        return pairs[np.sort(rng.permutation(len(pairs))[:_MOST_PAIRS])]


def rotations(
    *,
    seed: int,
    n_nodes: int,
    n: int,
    density: float = 1.0,
    sigma2: float | None = None,
    kappa: float | None = None,
    noise: str = "projected-gaussian",
    two_way: bool = False,
    outliers: float = 0.0,
) -> Planted:
    """Haar-random absolute maps on a random connected graph; all else as in :func:`data_gen.perturb`."""
    for_graph, for_truth, for_noise = _streams(seed)
    truth = planted_rotations(n_nodes, n, random_graph(n_nodes, density, for_graph), for_truth)
    return _observed(truth, for_noise, sigma2=sigma2, kappa=kappa, noise=noise, two_way=two_way, outliers=outliers)


def shapes(
    *,
    seed: int,
    n_nodes: int,
    n: int,
    collection: str = "cats",
    n_vertices: int = 5000,
    density: float = 1.0,
    sigma2: float | None = None,
    kappa: float | None = None,
    noise: str = "projected-gaussian",
    around: str = "consistent",
    two_way: bool = False,
    outliers: float = 0.0,
    points: int = 0,
) -> Planted:
    """Functional maps between ``n_nodes`` random shapes of a collection, in the paper's protocol.

    The seed chooses shapes, graph and noise. ``n_vertices`` are those of the synthetic cats. With ``points`` it
    has the bases, and geodesic distances from so many vertices, evenly over their order, so that point maps are scored.
    """
    for_graph, for_choice, for_noise = _streams(seed)
    source = collection, n_vertices, _stamps(collection)
    loaded = _loaded(*source)
    if n_nodes > len(loaded):
        raise ValueError(f"n_nodes: {n_nodes} shapes of a collection of {len(loaded)}")
    chosen = np.sort(for_choice.permutation(len(loaded))[:n_nodes])
    graph = random_graph(n_nodes, density, for_graph)
    truth = ground_truth([loaded[k] for k in chosen], graph, n)
    protocol = {"sigma2": sigma2, "kappa": kappa, "noise": noise, "two_way": two_way, "outliers": outliers}
    planted = _observed(truth, for_noise, around=around, **protocol)
    if not points:
        return planted
    distances = tuple(_distances(*source, int(k), points) for k in chosen)
    scored = thinned(loaded[0].n_vertices, points)
    return Planted(planted.problem, planted.truth, planted.references, truth.bases, scored, distances)


def data_files(problem: Mapping[str, object]) -> list[Path]:
    """Files that a problem is read from, none for what this package makes; ValueError if they are missing."""
    collection = problem.get("collection", "cats")
    return [] if collection == "cats" else collection_files(collection)


def _streams(seed: int) -> list[np.random.Generator]:
    """Generators of graph, truth and noise: the graph does not change when the noise takes one number more."""
    return [np.random.default_rng([int(seed), k]) for k in range(3)]


def _observed(truth: GroundTruth, rng: np.random.Generator, **protocol) -> Planted:
    problem = perturb(truth, rng=rng, **protocol)
    return Planted(problem, truth.absolute, _references(problem, **protocol))


def _references(problem, sigma2, kappa, noise, outliers, **_) -> dict[str, float]:
    """Root mean squares over the edges of the small-error bound and of the expected error, where theory knows them."""
    if outliers or not (sigma2 or kappa) or problem.n_nodes > _MOST_NODES:
        return {}
    n_nodes, n = problem.n_nodes, problem.n
    resistance = _mean_resistance(n_nodes, tuple(problem.edges.ravel().tolist()))
    if noise == "langevin":
        return {"floor_rms": float(np.sqrt(bounds.langevin_error_bound(2, _ONE_EDGE, n, kappa)[0] * resistance))}
    found = {"floor_rms": float(np.sqrt(n * (n - 1) / 2 * sigma2 * resistance))}
    if noise == "projected-gaussian":
        found["expected_rms"] = float(bounds.expected_rms_error(2, _ONE_EDGE, n, sigma2)[0] * np.sqrt(resistance))
    return found


@lru_cache(maxsize=64)
def _mean_resistance(n_nodes: int, ends: tuple[int, ...]) -> float:
    """Of the pairs that are observed, each once; many problems share a graph."""
    edges = np.reshape(ends, (-1, 2))
    return float(bounds.effective_resistance(n_nodes, edges, np.unique(np.sort(edges, axis=1), axis=0)).mean())


def _stamps(collection: str) -> tuple:
    """Paths, times and sizes of the files of a collection: what is kept of it is not used once they have changed."""
    files = data_files({"collection": collection})
    return tuple((file, file.stat().st_mtime_ns, file.stat().st_size) for file in files)


@lru_cache(maxsize=4)
def _loaded(name: str, n_vertices: int, stamps: tuple) -> list[Shape]:
    return load_collection(name, n_vertices=n_vertices) if name == "cats" else load_collection(name)


@lru_cache(maxsize=16)
def _distances(name: str, n_vertices: int, stamps: tuple, k: int, points: int) -> np.ndarray:
    shape = _loaded(name, n_vertices, stamps)[k]
    return geodesics_from(shape, thinned(shape.n_vertices, points))


def geodesics_from(shape: Shape, sources: np.ndarray) -> np.ndarray:
    """(P, V) heat-method distances from some vertices of a shape to all, in square roots of its area, float32."""
    import potpourri3d

    solver = potpourri3d.MeshHeatMethodDistanceSolver(shape.vertices, shape.faces)
    return np.stack([(solver.compute_distance(int(v)) / np.sqrt(shape.area)).astype(np.float32) for v in sources])


def thinned(count: int, most: int) -> np.ndarray:
    """At most ``most`` indices spread evenly over 0..count-1.

    >>> thinned(10, 4).tolist()
    [0, 3, 6, 9]
    """
    return np.linspace(0, count - 1, min(most, count)).round().astype(int)
