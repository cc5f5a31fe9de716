"""Maximum likelihood on SO(n)^N: the paper's MLE (2)."""

import numpy as np

from fmsync import checks
from fmsync.checks import checked
from fmsync.estimators.base import Callback, Estimate, estimator
from fmsync.estimators.starts import starting_point
from fmsync.estimators.trust_region import Rotations, minimise
from fmsync.problem import SyncProblem


@estimator("mle")
@checked(tolerance=checks.not_negative, max_iterations=">= 0")
def mle(
    problem: SyncProblem,
    *,
    rng: np.random.Generator,
    callback: Callback,
    init: str | np.ndarray | Estimate = "spectral",
    group: str = "SO",
    tolerance: float = 1e-6,
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
    """
    start = starting_point(problem, init, rng, group)
    absolute, converged, trace = minimise(
        Rotations(problem), start, tolerance=tolerance, max_iterations=max_iterations, callback=callback
    )
    return Estimate.from_absolute(problem, absolute, "mle", group, converged=converged, trace=trace)
