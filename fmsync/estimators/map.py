"""Maximum a posteriori with a Langevin prior on the absolute maps; maximum likelihood is the case without a prior."""

import numpy as np

from fmsync import checks
from fmsync.estimators.base import Callback, Estimate, estimator
from fmsync.estimators.mle import mle
from fmsync.problem import LangevinPrior, SyncProblem, anchored, fix_gauge


@estimator("map")
@checks.checked(kappa=checks.positive, tolerance=checks.not_negative, max_iterations=">= 0")
def maximum_a_posteriori(
    problem: SyncProblem,
    *,
    rng: np.random.Generator,
    callback: Callback,
    kappa: float = 2.0,
    prior: LangevinPrior | None = None,
    tolerance: float = 1e-6,
    max_iterations: int = 500,
) -> Estimate:
    r"""Maximise :math:`\kappa\sum w\operatorname{tr}(C_{ij}^\top C_i^\top C_j) + \sum_i \kappa_i\operatorname{tr}(M_i^\top C_i)`.

    A prior on C_i is an observation of the edge from an anchor node held at the identity, so this is maximum
    likelihood on N + 1 nodes (:func:`fmsync.problem.anchored`). Without a prior it is exactly ``"mle"``.

    The prior's concentrations are weighed against ``kappa`` of the observations; 2 is the paper's β = 1. The ``prior``
    (:class:`~fmsync.LangevinPrior`) fixes the gauge, so that ``absolute`` is not brought to C_1 = I. Other options are
    those of ``"mle"``.

    The ``cost`` is the energy of the observations plus :math:`\frac{1}{\kappa}\sum\kappa_i\lVert C_i - M_i\rVert_F^2`.
    """  # noqa: E501
    if prior is None:
        checks.unused("without a prior", kappa=(kappa, 2.0))
    whole = problem if prior is None else anchored(problem, prior, kappa)
    found = mle(whole, rng=rng, callback=callback, tolerance=tolerance, max_iterations=max_iterations)
    absolute = found.absolute
    if prior is not None:
        absolute = fix_gauge(absolute, problem.n_nodes)[: problem.n_nodes]
    return Estimate(problem, "map", absolute, found.cost, found.converged, found.trace)
