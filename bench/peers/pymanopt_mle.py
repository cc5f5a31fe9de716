"""Maximum likelihood as others write it: pymanopt's trust regions on the power manifold SO(n)^N.

The power manifold, never ``Product([SO(n)] * N)``: the Riemannian Hessian of the product is wrong (pymanopt issue 219)
and its trust regions then do not converge.
"""

import autograd.numpy as anp
import numpy as np
import pymanopt
from pymanopt.manifolds import SpecialOrthogonalGroup
from pymanopt.optimizers import TrustRegions

from fmsync.energy import neighbour_sums
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
    if derivatives not in ("hand", "autograd"):
        raise ValueError(f"derivatives: 'hand' or 'autograd', not {derivatives!r}")
    start, recorder = starting_point(problem, init, rng), Recorder(callback)
    manifold = SpecialOrthogonalGroup(problem.n, k=problem.n_nodes)
    objective = (_by_hand if derivatives == "hand" else _by_autograd)(problem, manifold, recorder)
    optimizer = TrustRegions(min_gradient_norm=tolerance, max_iterations=max_iterations, verbosity=0)
    result = optimizer.run(objective, initial_point=start)
    trace, point = recorder.trace(), result.point
    converged = float(np.linalg.norm(objective.riemannian_gradient(point))) <= tolerance
    return Estimate.from_absolute(problem, point, "mle-pymanopt", converged=converged, trace=trace)


def _by_hand(problem: SyncProblem, manifold, recorder: Recorder) -> pymanopt.Problem:
    """Ambient derivatives of U_E = constant - Σ tr(C_j^T S_j): -2 S and, along V, -2 S(V)."""

    @pymanopt.function.numpy(manifold)
    def cost(c):
        return problem.constant - np.vdot(c, neighbour_sums(problem, c))

    @pymanopt.function.numpy(manifold)
    def euclidean_gradient(c):
        sums = neighbour_sums(problem, c)
        norm = np.linalg.norm(manifold.euclidean_to_riemannian_gradient(c, -2 * sums))
        recorder(c, problem.constant - np.vdot(c, sums), norm)
        return -2 * sums

    @pymanopt.function.numpy(manifold)
    def euclidean_hessian(c, v):
        return -2 * neighbour_sums(problem, v)

    return pymanopt.Problem(manifold, cost, euclidean_gradient=euclidean_gradient, euclidean_hessian=euclidean_hessian)


def _by_autograd(problem: SyncProblem, manifold, recorder: Recorder) -> pymanopt.Problem:
    i, j = problem.edges.T

    @pymanopt.function.autograd(manifold)
    def cost(c):
        residual = anp.matmul(c[i], problem.maps) - c[j]
        return anp.sum(problem.weights[:, None, None] * residual**2)

    return pymanopt.Problem(manifold, cost)
