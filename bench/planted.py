"""What a problem generator hands to the benchmark: a problem, its truth, and what can be expected of an answer."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fmsync.problem import SyncProblem, relative_maps
from fmsync.shape import Basis

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
