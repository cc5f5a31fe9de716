"""Least squares of geodesic distances: the maximum likelihood estimate under the paper's Riemannian Gaussian."""

from collections.abc import Callable

import numpy as np

from fmsync import checks, so
from fmsync.bounds import grounded_laplacian
from fmsync.estimators.base import Callback, Estimate, Recorder, estimator
from fmsync.estimators.starts import starting_point
from fmsync.problem import SyncProblem
from fmsync.problem import relative_maps_unchecked as relative_maps
from fmsync.so import transpose

Pairs = list[tuple[np.ndarray, np.ndarray]]  # steps, and the changes of the gradient along them

_MEMORY = 10  # pairs of the quasi-Newton model
_SUFFICIENT = 1e-4  # Armijo's fraction of the predicted decrease


@estimator("mle-geodesic")
@checks.checked(tolerance=checks.not_negative, max_iterations=">= 0")
def mle_geodesic(
    problem: SyncProblem,
    *,
    rng: np.random.Generator,
    callback: Callback,
    init: str | np.ndarray | Estimate = "spectral",
    tolerance: float = 1e-6,
    max_iterations: int = 500,
) -> Estimate:
    r"""Minimise :math:`U_R = \sum w\,\lVert\log(C_{ij}^\top C_i^\top C_j)\rVert_F^2` over rotations.

    Quasi-Newton (L-BFGS) in the frame of the universe, :math:`C_i\leftarrow\exp(\omega_i)C_i`; the two-loop recursion
    starts from the scalar graph Laplacian, factored once (Govindu 2004). At the cut locus, where an eigen-angle of an
    edge reaches π, the logarithm jumps. The cost is continuous there and bends downwards on both sides, so that no
    minimum lies on it: Armijo's backtracking keeps every step downhill, and pairs from across a jump, which have
    negative curvature, are not remembered. Local minima remain; compare starts with ``restarts=``.

    Observed maps off SO(n) are projected to it first. Parameters are those of ``"mle"``, with the gradient of
    U_R and quasi-Newton steps. ``cost`` is U_R, without the ½ of the density :math:`\exp(-U_R/2)`.
    """
    recorder, absolute = Recorder(callback), starting_point(problem, init, rng)
    observed, factor = so.project_unchecked(problem.maps), grounded_laplacian(problem)

    def metric(gradient: np.ndarray) -> np.ndarray:  # the inverse of twice the graph Laplacian; node 1 is held
        solution = np.zeros_like(gradient)
        solution[1:] = factor.solve(gradient[1:].reshape(len(gradient) - 1, -1)).reshape(solution[1:].shape) / 2
        return solution

    cost, gradient = _evaluate(problem, observed, absolute)
    norm, pairs = float(np.linalg.norm(gradient)), Pairs()
    recorder(absolute, cost, norm)
    while norm > tolerance and len(recorder) <= max_iterations:
        direction = -_two_loop(gradient, pairs, metric)
        slope = np.vdot(gradient, direction)
        found = _backtrack(problem, observed, absolute, direction, cost, slope) if slope < 0 else None
        if found is None:
            if not pairs:
                break  # the predicted decrease is below rounding
            pairs.clear()  # the memory has gone stale across the cut locus
            continue
        step, absolute, cost, new_gradient = found
        change = new_gradient - gradient
        gradient = new_gradient
        if np.vdot(step, change) > 1e-10 * np.linalg.norm(step) * np.linalg.norm(change):
            pairs = [*pairs[-_MEMORY + 1 :], (step, change)]
        norm = float(np.linalg.norm(gradient))
        recorder(absolute, cost, norm)
    converged, trace = norm <= tolerance, recorder.trace()
    return Estimate.from_absolute(problem, absolute, "mle-geodesic", cost=cost, converged=converged, trace=trace)


def _evaluate(problem: SyncProblem, observed: np.ndarray, absolute: np.ndarray) -> tuple[float, np.ndarray]:
    """Geodesic energy and its gradient in the universe's frame, (N, n, n) skew-symmetric."""
    i, j = problem.edges.T
    angle = so.log_unchecked(transpose(observed) @ relative_maps(absolute, problem.edges))  # (E, n, n)
    cost = float((problem.weights * (angle**2).sum((1, 2))).sum())
    pull = 2 * problem.weights[:, None, None] * (absolute[j] @ angle @ transpose(absolute[j]))
    gradient = np.zeros_like(absolute)
    np.add.at(gradient, j, pull)
    np.subtract.at(gradient, i, pull)  # C_i A Λ Aᵀ C_iᵀ = C_j Λ C_jᵀ: one matrix, two signs
    return cost, gradient


def _two_loop(gradient: np.ndarray, pairs: Pairs, metric: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """The inverse quasi-Newton matrix times the gradient (Nocedal & Wright, algorithm 7.4)."""
    q, alphas = gradient.copy(), []
    for step, change in reversed(pairs):
        alpha = np.vdot(step, q) / np.vdot(step, change)
        q -= alpha * change
        alphas.append(alpha)
    result = metric(q)
    for (step, change), alpha in zip(pairs, reversed(alphas)):
        result += (alpha - np.vdot(change, result) / np.vdot(step, change)) * step
    return result


def _backtrack(
    problem: SyncProblem, observed: np.ndarray, absolute: np.ndarray, direction: np.ndarray, cost: float, slope: float
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray] | None:
    """(step, rotations, cost, gradient) after the first halving that Armijo accepts, or None."""
    length = 1.0
    rounding = 1e-14 * max(1.0, cost)
    while length > 1e-10:
        step = length * direction
        trial = so.exp_unchecked(step) @ absolute
        trial_cost, trial_gradient = _evaluate(problem, observed, trial)
        if trial_cost <= cost + _SUFFICIENT * length * slope + rounding:
            return step, trial, trial_cost, trial_gradient
        length /= 2
    return None
