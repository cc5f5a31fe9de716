r"""Rectangular synchronization: shapes with bases of different sizes, absolute maps on Stiefel manifolds.

Shape i has n_i basis functions and an absolute map C_i (m, n_i) with orthonormal columns into a universe of size
m >= max n_i; an edge observes :math:`C_{ij} = C_i^\top C_j` (n_i, n_j). Its norm is not constant, so that the energy
keeps its quartic term and the certificate of the square case does not apply. A map that is not observed need not be
determined: what C_i and C_j hold beyond the span of the shapes between them can be rotated while all observed maps stay
(:meth:`RectangularEstimate.identifiable`). Inside, blocks are padded with zero columns to a common width.
"""

import itertools
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh

from fmsync import checks
from fmsync.estimators.base import Trace
from fmsync.estimators.trust_region import Point, minimise
from fmsync.so import sym, transpose
from fmsync.threads import single_threaded_blas

_DENSE_UP_TO = 1000  # matrix size
_RESTARTS = 8  # each finds one of two mirrored answers as often as the other
_ZERO = 1e-6  # sine of an angle between spans
_SAME = 1e-2  # Frobenius distance between maps that count as equal
_NUDGE = 1e-3  # of a column: on a path the spectral start can lie where symmetry holds a descent at a saddle


@dataclass(frozen=True, eq=False, init=False)
class RectangularSyncProblem:
    """Observed maps of unequal sizes on the edges of a connected graph.

    As :class:`~fmsync.SyncProblem`, but ``maps`` are E arrays (n_i, n_j); the ``sizes`` (N,) are read off them.
    """

    n_nodes: int
    edges: np.ndarray
    maps: tuple[np.ndarray, ...]
    weights: np.ndarray
    sizes: np.ndarray = field(init=False, repr=False)

    @checks.checked(n_nodes=">= 2", edges=checks.plain, maps=checks.real, weights=checks.real)
    def __init__(
        self, n_nodes: int, edges: ArrayLike, maps: Iterable[ArrayLike], weights: ArrayLike | None = None
    ) -> None:
        edges = checks.connected_edges(n_nodes, edges)
        checked = tuple(np.array(observed, dtype=float) for observed in maps)
        if len(checked) != len(edges):
            raise ValueError(f"maps: {len(checked)} maps for {len(edges)} edges; give one map per edge")
        weights = checks.edge_weights(weights, edges)
        seen: dict[int, tuple[int, int]] = {}  # of a node: its size, and the edge that told it
        for e, (ends, observed) in enumerate(zip(edges.tolist(), checked)):
            name = checks.edge_name(edges, e)
            if observed.ndim != 2 or 0 in observed.shape:
                raise ValueError(f"maps: {name} has shape {observed.shape}; expected a matrix (n_i, n_j)")
            if not np.isfinite(observed).all():
                raise ValueError(f"maps: {name} holds NaN or infinity")
            for node, size in zip(ends, observed.shape):
                known, teller = seen.setdefault(node, (size, e))
                if known != size:
                    before = f"edge {teller} gave it {known}; use one basis per shape"
                    raise ValueError(f"maps: {name} gives node {node} {size} basis functions, {before}")
            observed.setflags(write=False)
        sizes = np.array([seen[node][0] for node in range(n_nodes)], dtype=np.int64)
        checks.set_fields(self, n_nodes=n_nodes, edges=edges, maps=checked, weights=weights, sizes=sizes)

    @cached_property
    def padded(self) -> np.ndarray:
        """(E, k, k) the maps with zeros around them, k = max n_i."""
        k = int(self.sizes.max())
        padded = np.zeros((len(self.maps), k, k))
        for e, observed in enumerate(self.maps):
            padded[e, : observed.shape[0], : observed.shape[1]] = observed
        return padded

    @cached_property
    def degrees(self) -> np.ndarray:
        """(N,) sum of the weights of the edges at every node."""
        return np.bincount(self.edges.ravel(), np.repeat(self.weights, 2), minlength=self.n_nodes)


@dataclass(frozen=True, eq=False)
class RectangularEstimate:
    """A point estimate: ``absolute`` holds N arrays (m, n_i) with orthonormal columns, the first of them [I; 0]."""

    problem: RectangularSyncProblem
    absolute: tuple[np.ndarray, ...]
    cost: float
    converged: bool
    trace: Trace

    @checks.checked(edges="K 2 < N")
    def relative(self, edges: np.ndarray | None = None) -> list[np.ndarray]:
        r"""Relative maps :math:`C_i^\top C_j` (n_i, n_j) of ``edges`` (K, 2), by default the problem's own.

        A UserWarning names pairs that are not :meth:`identifiable`.
        """
        if edges is not None and (unknown := np.asarray(edges)[~self.identifiable(edges)].tolist()):
            pairs = f"{', '.join(map(str, unknown[:5]))}{' and others' * (len(unknown) > 5)}"
            told = f"relative: the observed maps do not determine pairs {pairs}"
            warnings.warn(f"{told}; observe them, or take a smaller universe", UserWarning, stacklevel=2)
        return self._relative(self.absolute, self.problem.edges if edges is None else edges)

    @checks.checked(edges="K 2 < N")
    def identifiable(self, edges: ArrayLike) -> np.ndarray:
        r"""Whether the observed maps, as fitted, determine the relative maps of pairs ``edges`` (K, 2): (K,) booleans.

        A pair is determined where it is observed, or where maps multiply along observed pairs without leaving a span:
        with T the neighbours of k among shapes that are determined together, :math:`C_i^\top C_k` follows from
        :math:`C_t^\top C_k` if the span of T holds that of C_i, and k is one of them if the span holds that of C_k.
        For other pairs eight fits from random starts look for frames that meet all observed maps exactly and differ
        here. False is then certain, True means that none was found.

        >>> import numpy as np, fmsync
        >>> p = fmsync.RectangularSyncProblem(3, [[0, 1], [1, 2]], [np.eye(4, 3), np.eye(3, 5)])
        >>> fmsync.solve_rectangular(p).identifiable([[0, 1], [0, 2]])
        array([ True, False])
        """
        pairs = np.asarray(edges)
        known = self._determined[tuple(pairs.T)]
        if not known.all():
            left, ours = np.flatnonzero(~known), self._relative(self.absolute, pairs[~known])
            known[left] = True
            for other in self._others:
                theirs = self._relative(other, pairs[left])
                known[left] &= [bool(np.linalg.norm(a - b) < _SAME) for a, b in zip(ours, theirs)]
        return known

    @cached_property
    def _determined(self) -> np.ndarray:
        """(N, N) pairs whose relative maps follow from the observed ones by products."""
        n_nodes, edges = self.problem.n_nodes, self.problem.edges
        known = np.eye(n_nodes, dtype=bool)
        known[tuple(edges.T)] = known[tuple(edges[:, ::-1].T)] = True
        near, grown = known.copy(), np.zeros_like(known)
        for edge in edges:
            if grown[tuple(edge)]:  # a set that has grown already holds both ends
                continue
            together, size = np.isin(np.arange(n_nodes), edge), 0
            while size < together.sum():
                size = int(together.sum())
                for k in np.flatnonzero(near[together].any(axis=0) & ~(together & known[together].all(axis=0))):
                    seen = np.hstack([self.absolute[t] for t in np.flatnonzero(together & near[k])])
                    squares, axes = np.linalg.eigh(seen @ seen.T)
                    beyond = axes[:, squares < _ZERO**2].T  # what no neighbour of k sees
                    held = np.array([np.abs(beyond @ block).max(initial=0) < _ZERO for block in self.absolute])
                    known[k] |= together & held
                    together[k] |= held[k]
            grown[np.ix_(together, together)] = True
        return known | known.T

    @cached_property
    def _others(self) -> list[tuple[np.ndarray, ...]]:
        """Frames that meet the fitted maps of the observed pairs exactly."""
        p = self.problem
        fitted = RectangularSyncProblem(p.n_nodes, p.edges, self._relative(self.absolute, p.edges), p.weights)
        m, rng = len(self.absolute[0]), np.random.default_rng(0)
        model, found = Frames(fitted, m), []
        with single_threaded_blas():
            for _ in range(_RESTARTS):
                start = _starting_frames(fitted, m, "random", rng)
                frames, _, trace = minimise(model, start, tolerance=1e-9, max_iterations=500)
                if trace.cost[-1] < 1e-12 * model.magnitude:
                    found.append(tuple(block[:, :size] for block, size in zip(frames, p.sizes)))
        return found

    @staticmethod
    def _relative(frames: tuple[np.ndarray, ...], edges: ArrayLike) -> list[np.ndarray]:
        return [frames[i].T @ frames[j] for i, j in np.asarray(edges)]


@checks.checked(init=("spectral", "random"), tolerance=checks.not_negative, max_iterations=">= 0")
def solve_rectangular(
    problem: RectangularSyncProblem,
    universe: int | None = None,
    *,
    init: str = "spectral",
    rng: int | np.random.Generator = 0,
    tolerance: float = 1e-6,
    max_iterations: int = 500,
) -> RectangularEstimate:
    r"""Minimise :math:`\sum w\,\lVert C_i^\top C_j - C_{ij}\rVert_F^2` over maps with orthonormal columns.

    Trust regions on the product of the Stiefel manifolds St(m, n_i), from leading eigenvectors (``init``
    ``"spectral"``) or ``"random"`` frames. The size m of the ``universe`` is the largest n_i by default, which presumes
    that one shape sees everything. A RuntimeWarning tells that the gradient stayed above ``tolerance``.

    >>> import numpy as np, fmsync
    >>> p = fmsync.RectangularSyncProblem(3, [[0, 1], [1, 2]], [np.eye(4, 3), np.eye(3, 5)])
    >>> bool(fmsync.solve_rectangular(p).cost < 1e-10)
    True
    """
    largest = int(problem.sizes.max())
    m = largest if universe is None else int(universe)
    if m < largest:
        node = int(problem.sizes.argmax())
        raise ValueError(f"universe: {m} is smaller than the {largest} basis functions of node {node}")
    with single_threaded_blas():
        model = Frames(problem, m)
        start = _starting_frames(problem, m, init, np.random.default_rng(rng))
        absolute, converged, trace = minimise(model, start, tolerance=tolerance, max_iterations=max_iterations)
    if not converged:
        message = f"solve_rectangular stopped before its tolerance, gradient norm {trace.gradient_norm[-1]:.2g}"
        warnings.warn(message, RuntimeWarning, stacklevel=3)
    first = absolute[0][:, : problem.sizes[0]]
    gauge = np.concatenate([first, np.linalg.svd(first)[0][:, first.shape[1] :]], axis=1)  # (m, m) orthogonal
    frames = tuple(gauge.T @ block[:, :size] for block, size in zip(absolute, problem.sizes))
    return RectangularEstimate(problem, frames, float(trace.cost[-1]), converged, trace)


class Frames:
    r"""The energy on St(m, n_1) x ... x St(m, n_N), padded to (N, m, k): what the trust regions ask of a model.

    Tangent arrays are ambient: V with :math:`C_i^\top V_i` skew-symmetric and zero columns past n_i.
    """

    def __init__(self, problem: RectangularSyncProblem, m: int) -> None:
        self._problem = problem
        k, sizes = problem.padded.shape[-1], problem.sizes
        self._absent = np.arange(k) >= sizes[:, None]  # (N, k)
        self.dimension = int((m * sizes - sizes * (sizes + 1) // 2).sum())
        self.diameter = float(np.sqrt(sizes.sum()))
        self.magnitude = max(1.0, float(problem.weights @ (k + (problem.padded**2).sum((1, 2)))))

    def evaluate(self, absolute: np.ndarray) -> Point:
        i, j = self._problem.edges.T
        residual = transpose(absolute[i]) @ absolute[j] - self._problem.padded
        weighted = self._problem.weights[:, None, None] * residual
        ambient = self._spread(absolute, weighted)
        curvature = sym(transpose(absolute) @ ambient)
        cost = float(np.vdot(weighted, residual))
        return Point(absolute, cost, ambient - absolute @ curvature, (weighted, curvature))

    def hessian(self, point: Point, direction: np.ndarray) -> np.ndarray:
        (i, j), c = self._problem.edges.T, point.absolute
        weighted, curvature = point.extra
        moving = transpose(direction[i]) @ c[j] + transpose(c[i]) @ direction[j]
        moving *= self._problem.weights[:, None, None]
        ambient = self._spread(direction, weighted) + self._spread(c, moving) - direction @ curvature
        return ambient - c @ sym(transpose(c) @ ambient)

    def preconditioner(self, point: Point) -> np.ndarray:
        return 1 / (2 * self._problem.degrees)[:, None, None]

    def retract(self, point: Point, step: np.ndarray) -> np.ndarray:
        """The polar factor of C + V; its Gram matrix is I + VᵀV, and 1 is put where a padded column has 0."""
        moved = point.absolute + step
        gram = transpose(moved) @ moved
        gram[:, np.arange(gram.shape[-1]), np.arange(gram.shape[-1])] += self._absent
        values, axes = np.linalg.eigh(gram)
        return moved @ ((axes / np.sqrt(values)[:, None, :]) @ transpose(axes))

    def _spread(self, c: np.ndarray, weighted: np.ndarray) -> np.ndarray:
        """2 Σ C_i D_ij at every head j and 2 Σ C_j D_ijᵀ at every tail i."""
        i, j = self._problem.edges.T
        total = np.zeros_like(c)
        np.add.at(total, j, 2 * c[i] @ weighted)
        np.add.at(total, i, 2 * c[j] @ transpose(weighted))
        return total


def _starting_frames(problem: RectangularSyncProblem, m: int, init: str, rng: np.random.Generator) -> np.ndarray:
    """Orthonormal columns (N, m, k), zero past n_i."""
    rows = _eigenvector_rows(problem, m, rng) if init == "spectral" else None
    start = np.zeros((problem.n_nodes, m, int(problem.sizes.max())))
    for node, size in enumerate(problem.sizes):
        block = rng.standard_normal((m, size))
        if rows is not None:
            block = _orthonormal(rows[node].T) + _NUDGE * block
        start[node, :, :size] = _orthonormal(block)
    return start


def _eigenvector_rows(problem: RectangularSyncProblem, m: int, rng: np.random.Generator) -> list[np.ndarray]:
    """N blocks (n_i, m) of the leading eigenvectors, scaled by the roots of their eigenvalues.

    On a complete graph the matrix of all C_iᵀC_j, diagonal included, is exactly UUᵀ, U the stack of the C_iᵀ; the
    scaled eigenvectors are U in another frame. On other graphs degrees stand in for what is not observed.
    """
    offset = np.concatenate([[0], np.cumsum(problem.sizes)])
    scale = np.repeat((problem.degrees + 1) ** -0.5, problem.sizes)
    matrix = sp.lil_matrix((offset[-1], offset[-1]))
    for (i, j), weight, observed in zip(problem.edges, problem.weights, problem.maps):
        matrix[offset[i] : offset[i + 1], offset[j] : offset[j + 1]] += weight * observed
    matrix = matrix.tocsr()
    matrix = sp.diags(scale) @ (matrix + matrix.T + sp.eye(offset[-1])) @ sp.diags(scale)
    size = offset[-1]
    if size <= max(_DENSE_UP_TO, 2 * m):
        values, vectors = eigh(matrix.toarray(), subset_by_index=[size - m, size - 1])
    else:
        values, vectors = eigsh(matrix, k=m, which="LA", v0=rng.standard_normal(size))
    stack = vectors * np.sqrt(np.maximum(values, 0)) / scale[:, None]
    return [stack[a:b] for a, b in itertools.pairwise(offset)]


def _orthonormal(block: np.ndarray) -> np.ndarray:
    u, _, vt = np.linalg.svd(block, full_matrices=False)
    return u @ vt
