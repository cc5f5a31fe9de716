"""Point answers: every estimator is one file here, registered by name, called through :func:`solve`."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fmsync._registry import Registry
from fmsync._threads import single_threaded_blas
from fmsync.estimators._groups import nearest
from fmsync.problem import SyncProblem, energy, fix_gauge, relative_maps

Callback = Callable[[int, np.ndarray, float, float], None]  # (iteration, absolute (N,n,n), cost, gradient norm)

_FAR = 0.5  # distortion of a map above which its user is warned; a map with a quarter of its rank missing has it

_REGISTRY = Registry("estimator", __name__, given=("problem", "rng", "callback"))


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
        cls, problem: SyncProblem, absolute: np.ndarray, method: str, group: str = "SO", **fields
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


def estimator(name: str) -> Callable:
    """Register a function ``(problem, *, rng, callback, **options) -> Estimate`` under a name."""
    return _REGISTRY.register(name)


def methods() -> list[str]:
    """Names that :func:`solve` knows.

    Examples
    --------
    >>> import fmsync
    >>> "spectral" in fmsync.methods()
    True
    """
    return _REGISTRY.names()


def solve(
    problem: SyncProblem,
    method: str = "mle",
    *,
    rng: int | np.random.Generator = 0,
    callback: Callback | None = None,
    restarts: int | None = None,
    **options,
) -> Estimate:
    """Estimate the absolute maps of a problem; BLAS runs single-threaded meanwhile, which small products like.

    Parameters
    ----------
    problem
        What was observed.
    method
        A name of :func:`methods`.
    rng
        Seed or generator: same seed, same answer.
    callback
        Called as ``callback(iteration, absolute, cost, gradient_norm)`` at the start and after each accepted step of an
        iterative method; direct methods call it once.
    restarts
        Number of starts of a method with an ``init`` option: its own and Haar-random ones. The cheapest answer is
        returned, and its ``n_agreeing`` counts the starts that came to its cost.
    options
        Passed to the estimator; an unknown option is refused with the list of known ones.

    Returns
    -------
    Estimate

    Warns
    -----
    RuntimeWarning
        The method stopped before its tolerance was met; ``converged`` is then False.
    UserWarning
        Maps far from orthogonal met a method that answers with rotations; names the worst edge.

    Raises
    ------
    ValueError
        Unknown method or option.

    Examples
    --------
    >>> import numpy as np, fmsync
    >>> p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
    >>> fmsync.solve(p, "mle").cost < 1e-20
    True
    """
    function, known = _REGISTRY.find(method, options)
    generator = np.random.default_rng(rng)
    if restarts is not None:
        if "init" not in known:
            raise ValueError(f"restarts: {method!r} has no starting point to vary; leave restarts out")
        return best_of_starts(problem, method, restarts, generator, callback=callback, **options)
    with single_threaded_blas():
        estimate = function(problem, rng=generator, callback=callback or _nothing, **options)
    if not estimate.converged:
        left = "" if estimate.trace is None else f", gradient norm {estimate.trace.gradient_norm[-1]:.2g}"
        message = f"{method!r} stopped after {estimate.n_iterations} steps before its tolerance was met{left}"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
    worst = int(np.argmax(problem.distortion))
    if estimate.on_group and problem.distortion[worst] > _FAR:
        edge = tuple(problem.edges[worst].tolist())
        message = (
            f"maps: edge {worst} {edge} is far from orthogonal (‖CᵀC - I‖/√n = {problem.distortion[worst]:.2g}); "
            "project the maps with fmsync.so.project, or use 'mle-unconstrained'"
        )
        warnings.warn(message, UserWarning, stacklevel=2)
    return estimate


def _nothing(iteration: int, absolute: np.ndarray, cost: float, gradient_norm: float) -> None:
    """The callback of a caller who gave none."""


# These need what stands above.
from fmsync.estimators._starts import starting_point  # noqa: E402, F401
from fmsync.estimators.restarts import best_of_starts, mean_of_starts  # noqa: E402, F401
