"""Summaries that take in draws as they come: ``sample(..., callback=summary, store=None)`` needs constant memory."""

import numpy as np

from fmsync import so
from fmsync.functional_maps import nearest_rows
from fmsync.problem import relative_maps
from fmsync.shape import Basis


class RelativeMoments:
    r"""Running mean, and on request covariance, of relative maps :math:`C_i^\top C_j`.

    Parameters
    ----------
    edges
        (E, 2) pairs.
    covariance
        Keep the (n², n²) covariance of the entries of every map as well.

    Examples
    --------
    >>> import numpy as np, fmsync
    >>> from fmsync.samplers.streaming import RelativeMoments
    >>> p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
    >>> moments = RelativeMoments([[0, 1]])
    >>> post = fmsync.sample(p, "heat-bath", kappa=5.0, callback=moments, store=None)
    >>> moments.count, moments.mean.shape, post.absolute.shape
    (4000, (1, 4, 4), (4, 0, 3, 4, 4))
    """

    def __init__(self, edges: np.ndarray, *, covariance: bool = False) -> None:
        self._edges, self._with_covariance, self.count = np.asarray(edges), covariance, 0
        self._mean = self._products = np.zeros(())

    def __call__(self, draw: int, state: np.ndarray, energy: np.ndarray) -> None:
        """Take in the rotations (chains, N, n, n) of one draw."""
        maps = relative_maps(state, self._edges)  # (chains, E, n, n)
        flat = maps.reshape(*maps.shape[:2], -1)
        before, self.count = self._mean, self.count + len(maps)
        self._mean = before + (flat - before).sum(axis=0) / self.count
        self._n = maps.shape[-1]
        if self._with_covariance:  # of Welford, for a whole batch
            self._products = self._products + np.einsum("kea,keb->eab", flat - before, flat - self._mean)

    @property
    def mean(self) -> np.ndarray:
        """(E, n, n) arithmetic mean, not projected."""
        return self._mean.reshape(len(self._edges), self._n, self._n)

    @property
    def covariance(self) -> np.ndarray:
        """(E, n², n²) covariance of the entries, row by row."""
        if not self._with_covariance:
            raise ValueError("covariance: was not asked for; make RelativeMoments(edges, covariance=True)")
        return self._products / (self.count - 1)


class PointMapCounts:
    """How often each vertex of shape i went to each vertex of shape j, over all draws of C_ij.

    Parameters
    ----------
    edge
        The pair (i, j).
    basis_i, basis_j
        Bases of the two shapes.
    vertices
        (V,) vertices of shape i to follow.

    Attributes
    ----------
    counts
        (V, V_j) whole numbers; every row sums to the number of draws.
    """

    def __init__(self, edge: tuple[int, int], basis_i: Basis, basis_j: Basis, vertices: np.ndarray):
        self._edge, self._rows = edge, basis_i.eigenfunctions[np.asarray(vertices)]
        self._target = basis_j.eigenfunctions
        self.counts = np.zeros((len(self._rows), len(self._target)), dtype=np.int64)

    def __call__(self, draw: int, state: np.ndarray, energy: np.ndarray) -> None:
        """Take in the rotations (chains, N, n, n) of one draw."""
        i, j = self._edge
        numbers = np.arange(len(self._rows))
        for relative in so.transpose(state[:, i]) @ state[:, j]:
            self.counts[numbers, nearest_rows(self._rows @ relative, self._target)] += 1
