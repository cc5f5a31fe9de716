r"""Synchronization problems: observed relative maps on a graph, priors, and problems in one file.

Absolute maps C_i take shape i to a common universe, and an edge (i, j) carries an observation of
:math:`C_{ij} = C_i^\top C_j` (consistency: :math:`C_i C_{ij} = C_j`).
"""

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fmsync import checks
from fmsync.block_products import products
from fmsync.files import replacing
from fmsync.so import transpose

_DENSE_FROM = 0.5  # fraction of filled blocks from which one dense product beats a loop over edges
_FIELDS = ("n_nodes", "edges", "maps", "weights", "provenance")  # of a problem file
_EDGES_AT_ONCE = 256  # keeps temporary arrays far below the size of the observations


@dataclass(frozen=True, eq=False, init=False)
class SyncProblem:
    r"""Observed maps C_ij on the edges of a connected graph; arrays are validated, copied and made read-only.

    * ``n_nodes``, ``edges``: number of shapes N >= 2, and (E, 2) integers; edge (i, j) observes :math:`C_i^\top C_j`.
      Pairs may repeat and appear in both directions.
    * ``maps``: (E, n, n) observations. They need not be orthogonal, but the estimators on SO(n) expect nearly so.
    * ``weights``: (E,) positive multiplicities of the terms of the energy; ones by default.
    * ``provenance``: where the problem comes from (collection, seed, protocol, versions), plain JSON values, read by
      nobody who solves it.

    >>> import numpy as np, fmsync
    >>> p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
    >>> p.n, p.n_edges
    (4, 3)
    """

    n_nodes: int
    edges: np.ndarray
    maps: np.ndarray
    weights: np.ndarray
    provenance: Mapping[str, object]

    @checks.checked(n_nodes=">= 2", edges=checks.plain, maps=checks.real, weights=checks.real)
    def __init__(
        self,
        n_nodes: int,
        edges: ArrayLike,
        maps: ArrayLike,
        weights: ArrayLike | None = None,
        provenance: Mapping[str, object] | None = None,
    ) -> None:
        edges = checks.connected_edges(n_nodes, edges)
        maps = np.array(maps, dtype=float)
        if maps.ndim != 3 or maps.shape[1] != maps.shape[2] or maps.shape[1] < 2:
            raise ValueError(f"maps: expected (E, n, n) with n >= 2, got {maps.shape}; all maps must be of one size")
        if len(maps) != len(edges):
            raise ValueError(f"maps: {len(maps)} maps for {len(edges)} edges; give one map per edge")
        if (bad := np.flatnonzero(~np.isfinite(maps).all(axis=(1, 2)))).size:
            raise ValueError(f"maps: {checks.edge_name(edges, bad[0])} holds NaN or infinity")
        arrays = {"edges": edges, "maps": maps, "weights": checks.edge_weights(weights, edges)}
        checks.set_fields(self, n_nodes=n_nodes, **arrays, provenance={} if provenance is None else provenance)

    @property
    def n(self) -> int:
        """Size of every map."""
        return self.maps.shape[-1]

    @property
    def n_edges(self) -> int:
        """Number of observations E, repeats included."""
        return len(self.edges)

    @property
    def dim(self) -> int:
        """d = n(n-1)/2, the dimension of SO(n)."""
        return self.n * (self.n - 1) // 2

    @cached_property
    def degrees(self) -> np.ndarray:
        """(N,) sum of the weights of the edges at every node."""
        return np.bincount(self.edges.ravel(), np.repeat(self.weights, 2), minlength=self.n_nodes)

    @cached_property
    def orthogonality_error(self) -> np.ndarray:
        r"""(E,) how far every map is from orthogonal, :math:`\lVert C_{ij}^\top C_{ij} - I\rVert_F / \sqrt n`."""
        error = np.empty(self.n_edges)
        for first in range(0, self.n_edges, _EDGES_AT_ONCE):
            maps = self.maps[first : first + _EDGES_AT_ONCE]
            rest = products(maps, maps, transposed=True) - np.eye(self.n)
            error[first : first + _EDGES_AT_ONCE] = np.sqrt(np.einsum("eab,eab->e", rest, rest) / self.n)
        return error

    @cached_property
    def is_dense(self) -> bool:
        """Whether the connection matrix is stored and multiplied as one dense array."""
        return 2 * self.n_edges >= _DENSE_FROM * self.n_nodes**2

    @cached_property
    def connection(self) -> np.ndarray:
        """(N n, N n) symmetric block matrix of the observations, B_ij = w C_ij and B_ji its transpose."""
        n_nodes, n = self.n_nodes, self.n
        matrix = np.zeros((n_nodes, n, n_nodes, n))
        blocks = matrix.transpose(0, 2, 1, 3)
        for (i, j), weight, observation in zip(self.edges.tolist(), self.weights, self.maps):  # faster than add.at
            blocks[i, j] += weight * observation
            blocks[j, i] += weight * observation.T
        return matrix.reshape(n_nodes * n, n_nodes * n)

    @cached_property
    def incidence(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Edges sorted by node: (start (N+1,), edge, other, forward), forward where the node is the edge's head."""
        head, tail = self.edges[:, 1], self.edges[:, 0]
        node = np.concatenate([head, tail])
        order = np.argsort(node, kind="stable")
        edge = np.tile(np.arange(self.n_edges), 2)[order]
        other = np.concatenate([tail, head])[order]
        forward = np.repeat([True, False], self.n_edges)[order]
        start = np.concatenate([[0], np.cumsum(np.bincount(node, minlength=self.n_nodes))])
        return start, edge, other, forward

    @cached_property
    def edge_order(self) -> np.ndarray:
        """(E,) edges sorted by their nodes, so that what one has read is near when the next one needs it."""
        return np.lexsort((self.edges.max(axis=1), self.edges.min(axis=1)))

    @cached_property
    def constant(self) -> float:
        r"""The part of the Euclidean energy that no rotation changes: :math:`\sum w (n + \|C_{ij}\|_F^2)`."""
        return float(self.weights @ (self.n + np.einsum("eab,eab->e", self.maps, self.maps)))


@dataclass(frozen=True, eq=False)
class LangevinPrior:
    r"""Independent matrix-Langevin priors :math:`p(C_i)\propto\exp(\kappa_i\operatorname{tr}(M_i^\top C_i))`.

    ``mean`` (N, n, n) are the modes M_i, rotations; ``kappa`` (N,) or one float are concentrations >= 0, where 0 leaves
    that map uniform. All zero would be no prior: ValueError.
    """

    mean: np.ndarray
    kappa: np.ndarray

    def __post_init__(self) -> None:
        mean = np.array(checks.real("mean", self.mean), dtype=float)
        if mean.ndim != 3 or mean.shape[1] != mean.shape[2]:
            raise ValueError(f"mean: expected (N, n, n), got {mean.shape}")
        checks.rotations("mean", mean)
        kappa = checks.real("kappa", self.kappa).astype(float)
        if kappa.shape not in ((), mean.shape[:1]):
            raise ValueError(f"kappa: expected one number or ({len(mean)},), got {kappa.shape}")
        kappa = np.array(np.broadcast_to(kappa, len(mean)))
        if (bad := np.flatnonzero(~((kappa >= 0) & np.isfinite(kappa)))).size:
            raise ValueError(f"kappa: node {bad[0]} has {kappa[bad[0]]}; concentrations are finite and >= 0")
        if not kappa.any():
            raise ValueError("kappa: all concentrations are 0; leave the prior out instead")
        checks.set_fields(self, mean=mean, kappa=kappa)


@checks.checked(kappa=checks.positive)
def anchored(problem: SyncProblem, prior: LangevinPrior, kappa: float) -> SyncProblem:
    r"""The problem with its prior written as observations from one more node, the anchor, held at the identity.

    :math:`\kappa_i\operatorname{tr}(M_i^\top C_i)` is the Langevin log-likelihood of an edge from a node with C = I to
    node i that observed M_i with weight κ_i/κ.
    """
    check_prior(problem, prior)
    held = np.flatnonzero(prior.kappa)
    edges = np.stack([np.full(len(held), problem.n_nodes), held], axis=1)
    maps = np.concatenate([problem.maps, prior.mean[held]])
    weights = np.concatenate([problem.weights, prior.kappa[held] / kappa])
    return SyncProblem(problem.n_nodes + 1, np.concatenate([problem.edges, edges]), maps, weights)


@checks.checked()
def check_prior(problem: SyncProblem, prior: LangevinPrior) -> None:
    """Raise a ValueError unless the prior has a mode for every map."""
    expected = (problem.n_nodes, problem.n, problem.n)
    if prior.mean.shape != expected:
        raise ValueError(f"prior.mean: expected {expected} for this problem, got {prior.mean.shape}")


@checks.checked(absolute="... N n n", edges="K 2 < N")
def relative_maps(absolute: np.ndarray, edges: np.ndarray) -> np.ndarray:
    r"""Relative maps :math:`C_i^\top C_j` (..., E, n, n) of absolute rotations (..., N, n, n)."""
    i, j = np.asarray(edges).T
    return transpose(absolute[..., i, :, :]) @ absolute[..., j, :, :]


@checks.checked(absolute="... N n n", node="< N")
def fix_gauge(absolute: np.ndarray, node: int = 0) -> np.ndarray:
    """The equivalent rotations with C_node = I; (..., N, n, n)."""
    return transpose(absolute[..., node, None, :, :]) @ absolute


@checks.checked(n_nodes="N >= 2", edges="E 2 < N", maps="E n n")
def cycle_error(n_nodes: int, edges: np.ndarray, maps: np.ndarray) -> np.ndarray:
    r"""Inconsistency :math:`\lVert C_{ij}C_{jk}C_{ki} - I\rVert_F` of every 3-cycle i < j < k of the graph.

    (T,) one error per triangle, 0 for consistent maps. A direction that no edge observes is read as the transpose of
    the other one, which only rotations justify; of repeated edges the last counts.
    """
    pairs, maps = np.asarray(edges).tolist(), np.asarray(maps, dtype=float)
    lookup = {(j, i): c.T for (i, j), c in zip(pairs, maps)} | {(i, j): c for (i, j), c in zip(pairs, maps)}
    later: dict[int, set[int]] = {i: set() for i in range(n_nodes)}  # neighbours with a greater number
    for i, j in pairs:
        later[min(i, j)].add(max(i, j))
    triangles = [(i, j, k) for i in later for j in sorted(later[i]) for k in sorted(later[i] & later[j])]
    identity = np.eye(maps.shape[-1])
    return np.array([np.linalg.norm(lookup[i, j] @ lookup[j, k] @ lookup[k, i] - identity) for i, j, k in triangles])


@checks.checked()
def save_problem(problem: SyncProblem, path: str | Path) -> Path:
    """Write a problem; the file appears whole or not at all.

    Returns the path, with ``.npz`` appended if it was missing; the provenance is written, too.

    >>> import numpy as np, fmsync, pathlib, tempfile
    >>> p = fmsync.SyncProblem(2, [[0, 1]], np.eye(3)[None])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fmsync.load_problem(fmsync.save_problem(p, pathlib.Path(folder) / "two")).n_nodes
    2
    """
    path = Path(path)
    path = path if path.suffix == ".npz" else path.with_name(path.name + ".npz")
    record = np.frombuffer(json.dumps(dict(problem.provenance)).encode(), dtype=np.uint8)
    arrays = {"edges": problem.edges, "maps": problem.maps, "weights": problem.weights, "provenance": record}
    with replacing(path) as file:
        np.savez(file, n_nodes=np.int64(problem.n_nodes), **arrays)  # type: ignore[arg-type]
    return path


@checks.checked()
def load_problem(path: str | Path) -> SyncProblem:
    """Read a problem written by :func:`save_problem`; a ValueError names the file when it is not one."""
    data = Path(path).read_bytes()
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            n_nodes, edges, maps, weights, record = (file[name] for name in _FIELDS)
        return SyncProblem(int(n_nodes), edges, maps, weights, json.loads(record.tobytes()))
    except Exception as error:  # damaged archives raise errors of six kinds
        why = error if data.startswith(b"PK") else "no .npz archive"
        raise ValueError(f"{path}: not a complete problem file ({why}); write it again with save_problem") from error


relative_maps_unchecked, fix_gauge_unchecked = checks.unchecked(relative_maps), checks.unchecked(fix_gauge)  # for loops
