"""Maximum likelihood as others write it: pymanopt's trust regions on the power manifold SO(n)^N.

pymanopt and autograd are imported when it runs, so that nothing else waits for them.
"""

from typing import Any

import numpy as np

from fmsync.adapters import to_pymanopt
from fmsync.estimators import Callback, Estimate, estimator, starting_point
from fmsync.estimators.base import Recorder
from fmsync.problem import SyncProblem


@estimator("mle-pymanopt")
def mle_pymanopt(
    problem: SyncProblem,
    *,
    rng: np.random.Generator,
    callback: Callback,
    init: str | np.ndarray | Estimate = "random",
    derivatives: str = "hand",
    tolerance: float = 1e-6,
    max_iterations: int = 500,
) -> Estimate:
    """The paper's MLE (2) with the paper's software: the cost of ``"mle"`` by ``pymanopt.optimizers.TrustRegions``.

    Options are those of ``"mle"``, but the start is random by default, as in the paper. ``derivatives`` are written out
    (``"hand"``) or those of ``"autograd"``.
    """
    from pymanopt.optimizers import TrustRegions

    if derivatives not in ("hand", "autograd"):
        raise ValueError(f"derivatives: 'hand' or 'autograd', not {derivatives!r}")
    start, recorder = starting_point(problem, init, rng), Recorder(callback)
    plain = to_pymanopt(problem)
    objective = _watched(problem, plain, recorder) if derivatives == "hand" else _by_autograd(problem, plain.manifold)
    optimizer = TrustRegions(min_gradient_norm=tolerance, max_iterations=max_iterations, verbosity=0)
    result = optimizer.run(objective, initial_point=start)
    trace, point = recorder.trace(), result.point
    converged = float(np.linalg.norm(objective.riemannian_gradient(point))) <= tolerance
    return Estimate.from_absolute(problem, point, "mle-pymanopt", converged=converged, trace=trace)


def _watched(problem: SyncProblem, plain: Any, recorder: Recorder) -> Any:
    """The same objective, whose gradient -2 S tells the recorder of the cost, constant - Σ tr(C_j^T S_j), as well."""
    import pymanopt

    ambient = pymanopt.function.numpy(plain.manifold)

    def gradient(c: np.ndarray):
        found = plain.euclidean_gradient(c)
        norm = np.linalg.norm(plain.manifold.euclidean_to_riemannian_gradient(c, found))
        recorder(c, problem.constant + np.vdot(c, found) / 2, norm)
        return found

    return pymanopt.Problem(
        plain.manifold,
        ambient(plain.cost),
        euclidean_gradient=ambient(gradient),
        riemannian_hessian=ambient(plain.riemannian_hessian),
    )


def _by_autograd(problem: SyncProblem, manifold) -> Any:
    import autograd.numpy as anp
    import pymanopt

    i, j = problem.edges.T

    @pymanopt.function.autograd(manifold)
    def cost(c: Any):
        residual = anp.matmul(c[i], problem.maps) - c[j]
        return anp.sum(problem.weights[:, None, None] * residual**2)

    return pymanopt.Problem(manifold, cost)
