"""Collections whose vertex order is known, and errors at some of their vertices."""

from collections.abc import Callable, Sequence

import numpy as np

from bench.problems import geodesics_from
from data_gen import Creature, load_collection
from fmsync.functional_maps import nearest_rows
from fmsync.matching.confidence import samples_to_vertices
from fmsync.matching.samples import SampledShape
from fmsync.shape import Shape


class Evaluation:
    """Geodesic distances from the true images of some vertices, by the heat method on the full meshes.

    ``vertices`` (N, P) are the evaluation vertices of every shape: the same point of the surface in every column.
    """

    def __init__(self, shapes: Sequence[SampledShape], vertices: np.ndarray):
        self.shapes, self.vertices = shapes, vertices
        self.distances = [geodesics_from(s.shape, own) for s, own in zip(shapes, vertices)]

    def errors(self, i: int, j: int, first: np.ndarray, second: np.ndarray | None = None) -> np.ndarray:
        """(P,) distance on shape j from where the evaluation vertices of i are sent to where they belong.

        Vertices are matched by functions that both shapes share, to which ``first`` (M, m_i) and ``second`` (M, m_j)
        map their coefficients; without ``second`` by those of j, to which ``first`` = C_ij^T maps.
        """
        at_i = self.shapes[i].basis.eigenfunctions[self.vertices[i], : first.shape[1]] @ first.T
        at_j = self.shapes[j].basis.eigenfunctions[:, : len(first) if second is None else second.shape[1]]
        nearest = nearest_rows(at_i, at_j if second is None else at_j @ second.T)
        return self.distances[j][np.arange(len(at_i)), nearest]

    def mean(self, pairs: Sequence[tuple[int, int]], maps: Callable) -> float:
        """Mean error over pairs of the maps C_ij that ``maps(i, j)`` gives."""
        return float(np.mean([self.errors(i, j, maps(i, j).T) for i, j in pairs]))

    def at(self, i: int, values: np.ndarray) -> np.ndarray:
        """Values at the samples of shape i carried to the evaluation vertices."""
        return samples_to_vertices(self.shapes[i], values)[self.vertices[i]]


def species(number: int, count: int = 4) -> list[Creature]:
    """Poses of a random species, each with a triangulation of its own."""
    return load_collection("creatures", species=number, count=count, n_vertices=1500, remeshed=True)


def evaluation_vertices(shapes: list[Shape], count: int = 80) -> np.ndarray:
    """(N, P) vertices at which errors are measured, of shapes of one order or of creatures."""
    located = [s.located if isinstance(s, Creature) else np.arange(s.n_vertices) for s in shapes]
    chosen = np.random.default_rng(0).choice(len(located[0]), min(count, len(located[0])), replace=False)
    return np.array([own[chosen] for own in located])


def some_pairs(count: int, most: int = 22) -> list[tuple[int, int]]:
    """Ordered pairs of ``count`` shapes, evenly from all."""
    ordered = [(i, j) for i in range(count) for j in range(count) if i != j]
    return [ordered[k] for k in np.linspace(0, len(ordered) - 1, min(most, len(ordered))).astype(int)]
