"""Riemannian trust regions with truncated conjugate gradients (Absil, Baker & Gallivan 2007), for any model.

A model knows a manifold embedded in arrays with the Frobenius product and a cost on it; :class:`Rotations` is the
Euclidean energy on SO(n)^N and, as nothing in it looks at determinants, on O(n)^N.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from fmsync import so
from fmsync.block_products import products
from fmsync.energy import transposed_sums_unchecked as transposed_sums
from fmsync.estimators.base import Callback, Recorder, Trace
from fmsync.problem import SyncProblem
from fmsync.so import sym, transpose

_MACHINE_STEP = 1e-13  # relative decrease of the cost that rounding still resolves
_LOOSE = 0.1  # fraction of the gradient that a linear system may leave


@dataclass
class Point:
    """An iterate with all that its gradient and Hessian need; ``extra`` belongs to the model."""

    absolute: np.ndarray
    cost: float
    gradient: np.ndarray
    extra: Any

    @property
    def norm(self) -> float:
        return float(np.linalg.norm(self.gradient))


class Model(Protocol):
    """What the optimiser asks: dimensions, the size of the cost, and derivatives along tangent arrays."""

    dimension: int
    diameter: float
    magnitude: float

    def evaluate(self, absolute: np.ndarray) -> Point: ...

    def hessian(self, point: Point, direction: np.ndarray) -> np.ndarray: ...

    def preconditioner(self, point: Point) -> np.ndarray:
        """Positive factors, broadcast against tangent arrays, near the inverse of the Hessian's diagonal.

        Conjugate gradients run in their precision.
        """

    def retract(self, point: Point, step: np.ndarray) -> np.ndarray: ...


class Rotations:
    """The Euclidean energy in the body frame: tangent arrays are skew-symmetric (N, n, n), steps are Cayley steps.

    On sparse graphs Hessian products are in single precision: conjugate gradients gain a digit or two a step, and the
    next step, whose gradient is in double, takes off what rounding left.
    """

    def __init__(self, problem: SyncProblem):
        self._problem = problem
        self._maps = problem.maps if problem.is_dense else problem.maps.astype(np.float32)
        self.dimension = problem.n_nodes * problem.dim
        self.diameter = np.sqrt(problem.n_nodes * problem.n)
        self.magnitude = max(1.0, problem.constant)

    def evaluate(self, absolute: np.ndarray) -> Point:
        product = products(transposed_sums(self._problem, transpose(absolute)), absolute)  # S_j^T C_j
        cost = self._problem.constant - float(np.einsum("jaa->", product))
        extra = [a.astype(self._maps.dtype, order="C") for a in (absolute, sym(product), transpose(absolute))]
        return Point(absolute, cost, product - transpose(product), extra)

    def hessian(self, point: Point, direction: np.ndarray) -> np.ndarray:
        absolute, curvature, transposed = point.extra
        moving = transposed_sums(self._problem, products(direction, transposed), self._maps)  # (-S')^T: Omega is skew
        inner = products(curvature, direction) - products(moving, absolute)  # (C^T S' - Omega Lambda)^T
        return inner - transpose(inner)  # -2 skew of its transpose

    def preconditioner(self, point: Point) -> np.ndarray:
        # One number a node. The exact inverse of the node-diagonal part, a Lyapunov operator, saves a fifth of the
        # products and costs more than it saves.
        curvature = 2 * np.einsum("jaa->j", point.extra[1]) / self._problem.n
        return 1 / np.maximum(curvature, 0.05 * np.abs(curvature).max() + 1e-300)[:, None, None]

    def retract(self, point: Point, step: np.ndarray) -> np.ndarray:
        return point.absolute @ so.cayley_unchecked(step.astype(float))


def minimise(
    model: Model,
    start: np.ndarray,
    *,
    tolerance: float | Callable[[float], float],
    max_iterations: int,
    callback: Callback | None = None,
) -> tuple[np.ndarray, bool, Trace]:
    """A point with gradient norm below ``tolerance``, which may depend on the cost; if it was reached; the trace."""
    recorder = Recorder(callback)
    point = model.evaluate(start)
    recorder(point.absolute, point.cost, point.norm)
    radius = model.diameter / 8
    slack = _MACHINE_STEP * model.magnitude  # near the optimum both differences are rounding
    forcing = _LOOSE
    allowed = tolerance if callable(tolerance) else lambda cost: tolerance
    for _ in range(max_iterations):
        if point.norm <= allowed(point.cost):
            break
        target = max(forcing * point.norm, 0.3 * allowed(point.cost))  # no better than what is asked for
        step, predicted, at_boundary, left = _truncated_cg(model, point, radius, target)
        trial = model.evaluate(model.retract(point, step))
        ratio = (point.cost - trial.cost + slack) / (predicted + slack)
        if ratio < 0.25:
            radius = 0.25 * min(radius, float(np.linalg.norm(step)))
        elif ratio > 0.75 and at_boundary:
            radius = min(2 * radius, model.diameter)
        if ratio > 0.1:  # the next system is solved as far as the quadratic model held (Eisenstat & Walker 1996)
            forcing = min(_LOOSE, np.sqrt(abs(trial.norm - left) / point.norm))
            point = trial
            recorder(point.absolute, point.cost, point.norm)
        elif radius < 1e-14:
            break
    return point.absolute, point.norm <= allowed(point.cost), recorder.trace()


def _truncated_cg(model: Model, point: Point, radius: float, target: float) -> tuple[np.ndarray, float, bool, float]:
    """Steihaug–Toint: a step, the decrease its model predicts, whether it hit the boundary, the gradient left over."""
    inverse_diagonal = model.preconditioner(point)
    residual = point.gradient.astype(inverse_diagonal.dtype)
    step = np.zeros_like(residual)
    curved_step = np.zeros_like(step)  # Hessian times step, for the model value
    direction = -inverse_diagonal * residual
    slope = -np.vdot(residual, direction)
    at_boundary = False
    for _ in range(model.dimension):
        curved = model.hessian(point, direction)
        curvature = np.vdot(direction, curved)
        length = slope / curvature if curvature > 0 else np.inf
        a, b, c = np.vdot(direction, direction), np.vdot(step, direction), np.vdot(step, step) - radius**2
        to_boundary = float((-b + np.sqrt(max(b * b - a * c, 0.0))) / a)  # where the norm of the step is the radius
        at_boundary = length >= to_boundary
        length = min(length, to_boundary)
        step += length * direction
        curved *= length
        curved_step += curved
        if at_boundary:
            break
        residual += curved
        if np.linalg.norm(residual) <= target:
            break
        preconditioned = inverse_diagonal * residual
        slope, old_slope = np.vdot(residual, preconditioned), slope
        direction *= slope / old_slope
        direction -= preconditioned
    predicted = -float(np.vdot(step, point.gradient) + np.vdot(step, curved_step) / 2)
    return step, predicted, at_boundary, float(np.linalg.norm(residual))
