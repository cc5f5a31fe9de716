"""Maximum likelihood on SO(n)^N: the paper's MLE (2)."""

from functools import partial
from typing import Any

import numpy as np

from fmsync import checks
from fmsync.estimators.base import Callback, Estimate, estimator
from fmsync.estimators.starts import starting_point
from fmsync.estimators.trust_region import Rotations, minimise
from fmsync.problem import SyncProblem

_TOLERANCE = 1e-6
_DIGITS_LEFT = 1e-4  # a cost that is so much of the constant in it has lost four of sixteen digits


@estimator("mle")
@checks.checked(tolerance=checks.not_negative, max_iterations=">= 0")
def mle(
    problem: SyncProblem,
    *,
    rng: np.random.Generator,
    callback: Callback,
    init: str | np.ndarray | Estimate = "spectral",
    group: str = "SO",
    tolerance: float | str = _TOLERANCE,
    max_iterations: int = 500,
) -> Estimate:
    r"""Minimise :math:`U_E = \sum w\,\lVert C_i^\top C_j - C_{ij}\rVert_F^2` over rotations by trust regions.

    The maximum likelihood estimate under matrix-Langevin noise of any concentration, and the paper's MLE (2).

    * ``init``: ``"spectral"``, ``"random"``, rotations (N, n, n), or an earlier :class:`~fmsync.Estimate`, also of a
      problem that had only the first few of these nodes: after a change this saves the spectral start.
    * ``group``: ``"SO"`` for rotations; ``"O"`` for orthogonal matrices, where maps may reverse orientation. Steps keep
      every determinant, so that the start decides them; :func:`fmsync.certify` says whether it decided well.
    * ``tolerance``, ``max_iterations``: norm of the Riemannian gradient of U_E at which to stop, and trust-region
      steps, rejected ones included.

    ``tolerance="statistical"`` is a tenth of the norm that the gradient has at the true maps, so that the optimiser
    leaves undone a tenth of the standard error, times :math:`\sqrt{\bar d/\lambda_2}` at most, the mean degree over the
    algebraic connectivity of the graph. At the truth the gradient of node i has the mean square
    :math:`\tfrac2\kappa\operatorname{tr}H_{ii} = \tfrac{4c}{\kappa}\deg_i\tfrac{n(n-1)}2` (the information equality, c
    the mean cosine). The cost tells c, and :math:`\kappa\approx\tfrac{n-1}{4(1-c)}`, or nc where c < 1/2.
    """
    if isinstance(tolerance, str):
        checks.one_of("tolerance", tolerance, ("statistical",))
    goal = partial(_tenth_of_noise, problem) if isinstance(tolerance, str) else tolerance
    start = starting_point(problem, init, rng, group)  # before the model: each has a copy of the maps
    return descend(problem, start, "mle", tolerance=goal, max_iterations=max_iterations, callback=callback)


def descend(problem: SyncProblem, start: np.ndarray, method: str, **options: Any) -> Estimate:
    """The answer of a ``method`` that minimises from members of the group (N, n, n); options of :func:`minimise`."""
    absolute, converged, trace = minimise(Rotations(problem), start, **options)
    exact = trace.cost[-1] > _DIGITS_LEFT * problem.constant  # else a small difference of large numbers
    cost = {"cost": float(trace.cost[-1])} if exact else {}
    # "O" for both groups: the steps have kept the determinants of the start
    return Estimate.from_absolute(problem, absolute, method, "O", converged=converged, trace=trace, **cost)


def _tenth_of_noise(problem: SyncProblem, cost: float) -> float:
    """The tolerance ``"statistical"`` where the estimate has this cost; its residuals have lost N - 1 of E degrees."""
    size, spare = problem.weights.sum(), max(problem.n_edges - problem.n_nodes + 1, 1)
    lost = min(cost / (2 * problem.n * size) * problem.n_edges / spare, 0.5)  # 1 - c
    return max(0.1 * float(np.sqrt(8 * size * 2 * problem.n * lost * (1 - lost))), _TOLERANCE)
