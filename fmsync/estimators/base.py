"""What every estimator has in common: the estimate, its trace, the groups, and the registry of names."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import fdtri

from fmsync import checks, so
from fmsync.block_products import products
from fmsync.bounds import effective_resistance
from fmsync.energy import energy_unchecked as energy
from fmsync.problem import SyncProblem
from fmsync.problem import fix_gauge_unchecked as fix_gauge
from fmsync.problem import relative_maps_unchecked as relative_maps
from fmsync.registry import Registry

Callback = Callable[[int, np.ndarray, float, float], None]  # (iteration, absolute (N,n,n), cost, gradient norm)

#: Estimators by name.
ESTIMATORS: "Registry[Callable[..., Estimate]]" = Registry("estimator", given=("problem", "rng", "callback"))

_FIRST_ORDER = ("spectral", "mle", "staircase")  # equal to first order in the noise
GROUPS = ("SO", "O")  # what estimates may be: rotations, or all orthogonal matrices
_ROUNDING = 1e-8  # how far from orthogonal one Newton–Schulz step brings back to machine precision


def nearest(a: np.ndarray, group: str) -> np.ndarray:
    """Nearest member of the group to every (B, n, n): for "O" the polar factor, also of (B, r, n)."""
    rest = products(a, a, transposed=True) - np.eye(a.shape[-1])
    if np.abs(rest).max(initial=0) < _ROUNDING and (group == "O" or (np.linalg.det(a) > 0).all()):
        return a - products(a, rest) / 2
    if group == "SO":
        return so.project_unchecked(a)
    u, _, vt = np.linalg.svd(a, full_matrices=False)
    return u @ vt


@dataclass(frozen=True, eq=False)
class Trace:
    """What an optimiser saw at its start and after every accepted step, (K + 1,) each; seconds since the start."""

    cost: np.ndarray
    gradient_norm: np.ndarray
    seconds: np.ndarray


class Recorder:
    """Makes a trace of the points it is called with, and tells a callback of each; asked twice about one, it waits."""

    def __init__(self, callback: Callback | None):
        self._callback, self._began = callback, time.perf_counter()
        self._history: list[tuple[float, float, float]] = []
        self._last: np.ndarray | None = None

    def __call__(self, absolute: np.ndarray, cost: float, gradient_norm: float) -> None:
        if absolute is self._last:
            return
        self._last = absolute
        self._history.append((float(cost), float(gradient_norm), time.perf_counter() - self._began))
        if self._callback is not None:
            self._callback(len(self._history) - 1, absolute, float(cost), float(gradient_norm))

    def __len__(self) -> int:
        return len(self._history)

    def trace(self) -> Trace:
        """The history so far, (K + 1,) each; empty when the optimiser could not be watched."""
        return Trace(*np.array(self._history).reshape(-1, 3).T)


@dataclass(frozen=True, eq=False)
class Estimate:
    """A point estimate.

    ``absolute`` (N, n, n) are in the gauge C_1 = I (or in that of the prior), on the group unless the estimator is
    unconstrained (``on_group``); ``cost`` is the estimator's own there. ``converged``: the tolerance of the optimiser
    was met; ``trace`` is None for direct methods. With ``restarts=k`` of ``n_starts`` starts ``n_agreeing`` came to
    this cost. ``edge_weights`` (E,) in [0, 1] are the inlier weights of ``"robust"``, None for the others.
    """

    problem: SyncProblem
    method: str
    absolute: np.ndarray
    cost: float
    converged: bool = True
    trace: Trace | None = None
    on_group: bool = True
    n_starts: int = 1
    n_agreeing: int = 1
    edge_weights: np.ndarray | None = None
    lower_bound: float | None = None

    @property
    def n_iterations(self) -> int:
        """Accepted steps of the optimiser, 0 for direct methods."""
        return 0 if self.trace is None else len(self.trace.cost) - 1

    @classmethod
    @checks.checked(absolute="N n n", group=GROUPS)
    def from_absolute(
        cls, problem: SyncProblem, absolute: np.ndarray, method: str, group: str = "SO", **fields: Any
    ) -> "Estimate":
        """An estimate on the group: rounding taken off, gauge C_1 = I, Euclidean energy as its cost unless given."""
        absolute = fix_gauge(nearest(absolute, group))
        absolute[0] = np.eye(problem.n)
        if "cost" not in fields:
            fields["cost"] = float(energy(problem, absolute))
        return cls(problem, method, absolute, **fields)

    @checks.checked(edges="K 2 < N")
    def relative(self, edges: np.ndarray | None = None) -> np.ndarray:
        r"""Relative maps (E, n, n): :math:`C_i^\top C_j` on the group, :math:`C_i^{-1} C_j` off it.

        ``edges`` (E, 2) defaults to the problem's own.
        """
        edges = self.problem.edges if edges is None else np.asarray(edges)
        if self.on_group:
            return relative_maps(self.absolute, edges)
        return np.linalg.solve(self.absolute[edges[:, 0]], self.absolute[edges[:, 1]])

    @checks.checked(edges="K 2 < N", level=checks.probability)
    def confidence_balls(self, level: float, edges: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        r"""Centres (K, n, n) and radii (K,) of balls that hold each true relative map with probability ``level``.

        Without sampling, for ``"spectral"``, ``"mle"`` and ``"staircase"``, small errors, and noise Z, :math:`C_{ij} =
        C_i^\top C_j Z`, without a preferred direction. To first order the d coordinates of an error are independent
        Gaussians of variance :math:`s^2R_{ij}`, R the effective resistance, :math:`s^2 = E\lVert\mathrm{skew}
        Z\rVert_F^2/(d c^2)`, :math:`c = E\operatorname{tr}Z/n` (Zhong & Ling 2024 on complete graphs). The skew parts
        of the residuals :math:`\hat C_{ij}^\top C_{ij}` keep :math:`\nu = d(E-N+1)` degrees of freedom: :math:`\hat s^2
        = \sum w\lVert\mathrm{skew}\rVert_F^2/(\nu\hat c^2)`, and the squared Frobenius error over
        :math:`d\hat s^2R_{ij}` has the F distribution of d and ν degrees. Weights count observations. Radii lack terms
        of second order: at n = 20 take :meth:`fmsync.Posterior.credible_balls` unless the noise is weak.

        ``edges`` (K, 2) are any pairs, the problem's own by default. ValueError for other methods, and for graphs
        without a cycle or repeated edge, whose residuals are zero whatever the noise.

        >>> import numpy as np, fmsync
        >>> p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
        >>> bool((fmsync.solve(p).confidence_balls(0.9)[1] < 1e-6).all())
        True
        """
        if self.method not in _FIRST_ORDER:
            raise ValueError(f"confidence_balls: not known for {self.method!r}; use one of {', '.join(_FIRST_ORDER)}")
        p, spare = self.problem, self.problem.n_edges - self.problem.n_nodes + 1
        if spare == 0:
            raise ValueError("confidence_balls: a graph without cycles or repeated edges does not show its noise level")
        residual = so.transpose(self.relative()) @ p.maps
        variance = (p.weights @ (so.skew(residual) ** 2).sum((1, 2))) / (p.dim * spare)
        cosine = p.weights @ np.einsum("eaa->e", residual) / (p.n * p.weights.sum())
        edges = p.edges if edges is None else edges
        resistance = effective_resistance(p.n_nodes, p.edges, edges, p.weights)
        quantile = fdtri(p.dim, p.dim * spare, level)
        return self.relative(edges), np.sqrt(p.dim * variance / cosine**2 * resistance * quantile)


estimator = ESTIMATORS.register  #: register a function ``(problem, *, rng, callback, **options) -> Estimate`` by name


def methods() -> list[str]:
    """Names that :func:`solve` knows."""
    return sorted(ESTIMATORS)
