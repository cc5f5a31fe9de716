"""Riemannian trust regions on SO(n)^N for the Euclidean energy, with truncated conjugate gradients.

The textbook method of Absil, Baker & Gallivan (2007), specialised: one product with the observations per Hessian
vector, reused for the gradient of an accepted step; Cayley retraction; preconditioned by the exact inverse of the
Hessian's node-diagonal part, a Lyapunov operator of sym(C_j^T S_j).
"""

import time
from dataclasses import dataclass

import numpy as np

from fmsync import so
from fmsync.estimators import Callback, Trace
from fmsync.problem import SyncProblem, neighbour_sums
from fmsync.so import skew, sym, transpose

_MACHINE_STEP = 1e-13  # relative decrease of the cost that rounding still resolves


@dataclass
class _Point:
    """An iterate with all that its gradient and Hessian need."""

    absolute: np.ndarray  # (N, n, n)
    cost: float
    gradient: np.ndarray  # (N, n, n) body frame
    curvature: np.ndarray  # (N, n, n) sym(C_j^T S_j)

    @property
    def norm(self) -> float:
        return float(np.linalg.norm(self.gradient))


def minimise(
    problem: SyncProblem,
    start: np.ndarray,
    *,
    tolerance: float,
    max_iterations: int,
    callback: Callback,
) -> tuple[np.ndarray, bool, Trace]:
    """Rotations (N, n, n) with gradient norm below ``tolerance``, whether it was reached, and the trace."""
    began = time.perf_counter()
    point = _evaluate(problem, start)
    history = []

    def record(iteration: int) -> None:
        history.append((point.cost, point.norm, time.perf_counter() - began))
        callback(iteration, point.absolute, point.cost, point.norm)

    record(0)
    radius_limit = np.sqrt(problem.n_nodes * problem.n)
    radius, iteration = radius_limit / 8, 0
    for _ in range(max_iterations):
        if point.norm <= tolerance:
            break
        step, predicted, at_boundary = _truncated_cg(problem, point, radius, tolerance)
        trial = _evaluate(problem, point.absolute @ so.cayley(step))
        decrease = point.cost - trial.cost
        slack = _MACHINE_STEP * max(1.0, problem.constant)  # near the optimum both differences are rounding
        ratio = (decrease + slack) / (predicted + slack)
        if ratio < 0.25:
            radius = 0.25 * min(radius, float(np.linalg.norm(step)))
        elif ratio > 0.75 and at_boundary:
            radius = min(2 * radius, radius_limit)
        if ratio > 0.1:
            point = trial
            iteration += 1
            record(iteration)
        elif radius < 1e-14:
            break
    trace = Trace(*(np.array(column) for column in zip(*history)))
    return point.absolute, point.norm <= tolerance, trace


def _evaluate(problem: SyncProblem, absolute: np.ndarray) -> _Point:
    product = transpose(absolute) @ neighbour_sums(problem, absolute)  # C_j^T S_j
    cost = problem.constant - float(np.einsum("jaa->", product))
    return _Point(absolute, cost, -2 * skew(product), sym(product))


def _truncated_cg(
    problem: SyncProblem, point: _Point, radius: float, tolerance: float
) -> tuple[np.ndarray, float, bool]:
    """Steihaug–Toint: a step (N, n, n), the decrease its quadratic model predicts, and whether it hit the boundary."""
    absolute_t = transpose(point.absolute)
    eigenvalues, axes = np.linalg.eigh(point.curvature)
    axes_t = transpose(axes)
    pairs = eigenvalues[:, :, None] + eigenvalues[:, None, :]  # (N, n, n), eigenvalues of the node-diagonal Hessian
    pairs = np.maximum(pairs, 0.05 * np.abs(eigenvalues).max(axis=1)[:, None, None])

    def precondition(residual):
        return axes @ ((axes_t @ residual @ axes) / pairs) @ axes_t

    def hessian(direction):
        moving = neighbour_sums(problem, point.absolute @ direction)
        return -2 * skew(absolute_t @ moving - direction @ point.curvature)

    step = np.zeros_like(point.gradient)
    curved_step = np.zeros_like(step)  # Hessian times step, for the model value
    residual = point.gradient
    preconditioned = precondition(residual)
    slope = np.vdot(residual, preconditioned)
    direction = -preconditioned
    target = point.norm * min(0.1, point.norm)
    target = max(target, 0.3 * tolerance)  # superlinear, but no better than what is asked for

    def model_decrease():
        return -float(np.vdot(step, point.gradient) + np.vdot(step, curved_step) / 2)

    for _ in range(problem.n_nodes * problem.dim):
        curved = hessian(direction)
        curvature = np.vdot(direction, curved)
        length = slope / curvature if curvature > 0 else np.inf
        if curvature <= 0 or np.linalg.norm(step + length * direction) >= radius:
            length = _to_boundary(step, direction, radius)
            step = step + length * direction
            curved_step = curved_step + length * curved
            return step, model_decrease(), True
        step = step + length * direction
        curved_step = curved_step + length * curved
        residual = residual + length * curved
        if np.linalg.norm(residual) <= target:
            break
        preconditioned = precondition(residual)
        slope, old_slope = np.vdot(residual, preconditioned), slope
        direction = -preconditioned + (slope / old_slope) * direction
    return step, model_decrease(), False


def _to_boundary(step: np.ndarray, direction: np.ndarray, radius: float) -> float:
    """Positive root of ‖step + length · direction‖ = radius."""
    a, b, c = np.vdot(direction, direction), np.vdot(step, direction), np.vdot(step, step) - radius**2
    return float((-b + np.sqrt(max(b * b - a * c, 0.0))) / a)
