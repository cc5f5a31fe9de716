"""What every estimator has in common: the estimate, its trace, and the registry of names."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmsync.energy import energy
from fmsync.estimators.groups import nearest
from fmsync.problem import SyncProblem, fix_gauge, relative_maps
from fmsync.registry import Registry

Callback = Callable[[int, np.ndarray, float, float], None]  # (iteration, absolute (N,n,n), cost, gradient norm)

#: Estimators by name.
ESTIMATORS: "Registry[Callable[..., Estimate]]" = Registry("estimator", given=("problem", "rng", "callback"))


@dataclass(frozen=True, eq=False)
class Trace:
    """What an optimiser saw at its start and after every accepted step.

    Attributes
    ----------
    cost, gradient_norm, seconds
        (K + 1,) each; the Frobenius norm of the gradient of the cost, and wall-clock seconds since the start.
    """

    cost: np.ndarray
    gradient_norm: np.ndarray
    seconds: np.ndarray


@dataclass(frozen=True, eq=False)
class Estimate:
    """A point answer.

    Attributes
    ----------
    method
        Registered name of the estimator.
    absolute
        (N, n, n) absolute maps in the gauge C_1 = I (or in the gauge of the prior).
    cost
        The estimator's own cost at ``absolute``.
    n_iterations, converged
        Accepted steps of the optimiser (0 for direct methods) and whether its tolerance was met.
    trace
        :class:`~fmsync.estimators.Trace`, or None for direct methods.
    on_group
        Whether ``absolute`` are rotations; unconstrained estimates are not.
    n_starts, n_agreeing
        With ``restarts=k``: how many starts were made, and how many of them came to this cost.
    edge_weights
        (E,) in [0, 1]: how far ``"robust"`` believed each edge; None for the others.
    """

    problem: SyncProblem
    method: str
    absolute: np.ndarray
    cost: float
    n_iterations: int = 0
    converged: bool = True
    trace: Trace | None = None
    on_group: bool = True
    n_starts: int = 1
    n_agreeing: int = 1
    edge_weights: np.ndarray | None = None

    @classmethod
    def from_absolute(
        cls, problem: SyncProblem, absolute: np.ndarray, method: str, group: str = "SO", **fields: Any
    ) -> "Estimate":
        """An estimate on the group: rounding taken off, gauge C_1 = I, Euclidean energy as its cost unless given."""
        absolute = fix_gauge(nearest(absolute, group))
        absolute[0] = np.eye(problem.n)
        fields.setdefault("cost", float(energy(problem, absolute)))
        return cls(problem, method, absolute, **fields)

    def relative(self, edges: np.ndarray | None = None) -> np.ndarray:
        r"""Relative maps (E, n, n): :math:`C_i^\top C_j` on the group, :math:`C_i^{-1} C_j` off it.

        ``edges`` (E, 2) defaults to the problem's own.
        """
        edges = self.problem.edges if edges is None else np.asarray(edges)
        if self.on_group:
            return relative_maps(self.absolute, edges)
        return np.linalg.solve(self.absolute[edges[:, 0]], self.absolute[edges[:, 1]])


def estimator(name: str) -> Callable[[Callable[..., Estimate]], Callable[..., Estimate]]:
    """Register a function ``(problem, *, rng, callback, **options) -> Estimate`` under a name."""
    return ESTIMATORS.register(name)


def methods() -> list[str]:
    """Names that :func:`solve` knows.

    Examples
    --------
    >>> import fmsync
    >>> "spectral" in fmsync.methods()
    True
    """
    return ESTIMATORS.names()
