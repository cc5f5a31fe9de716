"""Estimates that some wrong maps do not spoil: reweighted least squares and a mixture with outliers."""

import copy
from collections.abc import Callable

import numpy as np

from fmsync import checks, langevin
from fmsync.energy import gradient_unchecked as gradient
from fmsync.energy import squared_residuals_unchecked as squared_residuals
from fmsync.estimators.base import Callback, Estimate, Recorder, Trace, estimator
from fmsync.estimators.starts import starting_point
from fmsync.estimators.trust_region import Rotations, minimise
from fmsync.problem import SyncProblem

Rule = Callable[[np.ndarray], tuple[float, np.ndarray]]  # squared residuals (E,) -> the cost, inlier weights (E,)
LOSSES = ("mixture", "geman-mcclure", "l1")
_LEAST_WEIGHT = 1e-9  # least fraction of its weight that an edge keeps, so that the graph stays connected
_LARGEST_KAPPA = 1e4  # clean maps would drive the concentration to infinity
_SMOOTH = 1e-4  # per unit √n: residuals below it count as squares in the l1 loss, which has a kink at 0


@estimator("robust")
@checks.checked(loss=LOSSES, tolerance=checks.not_negative, max_iterations=">= 0")
def robust(
    problem: SyncProblem,
    *,
    rng: np.random.Generator,
    callback: Callback,
    loss: str = "mixture",
    init: str | np.ndarray | Estimate = "spectral",
    group: str = "SO",
    tolerance: float = 1e-6,
    max_iterations: int = 500,
) -> Estimate:
    r"""Minimise a robust cost of the residuals :math:`r = \lVert C_i^\top C_j - C_{ij}\rVert_F` over rotations.

    Each round weighs every edge by how well it fits and solves the weighted least squares by trust regions; no round
    raises the cost (iteratively reweighted least squares; for the mixture, expectation–maximisation). Losses:

    * ``"mixture"``: an observation is Langevin with probability 1 - ε and Haar-uniform on SO(n) with probability ε,
      :math:`-\sum w\log\bigl((1-\varepsilon)\,p_{ij} + \varepsilon\bigr)` with
      :math:`p_{ij} = e^{\kappa\operatorname{tr}(C_{ij}^\top C_i^\top C_j)}/c_n(\kappa)` and the exact
      normaliser :func:`fmsync.langevin.log_normaliser`; κ and ε are estimated.
    * ``"geman-mcclure"``: :math:`\sum w\,c^2r^2/(c^2+r^2)`, c = 1.5 times the median residual of the l1 answer.
    * ``"l1"``: :math:`\sum w\sqrt{r^2+\delta^2}`, :math:`\delta = 10^{-4}\sqrt n` (Wang & Singer 2013).

    The first two start from the l1 answer. Wrong maps should be fewer than half at every node. ``init`` and ``group``
    are as in ``"mle"``; it stops after ``max_iterations`` rounds or where the norm of the gradient of the weighted
    squares, scaled to a mean weight of 1, is below ``tolerance``: at a fixed point it is proportional to the gradient
    of the robust ``cost``. ``edge_weights`` (E,) in [0, 1] are inlier weights, of the mixture probabilities.
    """
    absolute = starting_point(problem, init, rng, group)
    rule = _l1(problem)
    if loss != "l1":
        absolute = _reweigh(problem, rule, absolute, None, 1e-2, 50)[0]
        rule = (_geman_mcclure if loss == "geman-mcclure" else _mixture)(problem, squared_residuals(problem, absolute))
    absolute, *found = _reweigh(problem, rule, absolute, callback, tolerance, max_iterations)
    fields = dict(zip(("cost", "edge_weights", "converged", "trace"), found))
    return Estimate.from_absolute(problem, absolute, "robust", group, **fields)


def _reweigh(
    problem: SyncProblem, rule: Rule, absolute: np.ndarray, call: Callback | None, tolerance: float, rounds: int
) -> tuple[np.ndarray, float, np.ndarray, bool, Trace]:
    """Rounds of weights and weighted least squares: (rotations, cost, inlier weights, converged, trace)."""
    recorder = Recorder(call)
    while True:
        squares = squared_residuals(problem, absolute)
        cost, inlier = rule(squares)
        scale = len(inlier) / max(inlier.sum(), 1e-300)
        weighted = copy.copy(problem)  # the same observations, shared and already validated, under other weights
        for name in ("degrees", "connection", "constant"):
            weighted.__dict__.pop(name, None)  # cached from the old weights
        object.__setattr__(weighted, "weights", problem.weights * np.maximum(scale * inlier, _LEAST_WEIGHT))
        norm = float(np.linalg.norm(gradient(weighted, absolute)))
        recorder(absolute, cost, norm)
        if norm <= tolerance or len(recorder) > rounds:
            break
        inner = max(0.03 * norm, 0.1 * tolerance)  # a round need not be solved better than the weights are known
        before, (absolute, _, _) = absolute, minimise(Rotations(weighted), absolute, tolerance=inner, max_iterations=50)
        if absolute is before:
            break  # no step lowers the cost any more: rounding is in the way
    return absolute, cost, np.clip(inlier, 0, 1), norm <= tolerance, recorder.trace()


def _l1(problem: SyncProblem) -> Rule:
    smooth = _SMOOTH * np.sqrt(problem.n)

    def rule(squares: np.ndarray) -> tuple[float, np.ndarray]:
        distance = np.sqrt(squares + smooth**2)
        return float(problem.weights @ distance), distance.min() / distance

    return rule


def _geman_mcclure(problem: SyncProblem, first: np.ndarray) -> Rule:
    scale = max(1.5**2 * float(np.median(first)), _SMOOTH**2 * problem.n)

    def rule(squares: np.ndarray) -> tuple[float, np.ndarray]:
        cost = float(problem.weights @ (scale * squares / (scale + squares)))
        return cost, (scale / (scale + squares)) ** 2

    return rule


def _mixture(problem: SyncProblem, first: np.ndarray) -> Rule:
    """Expectation–maximisation; every call first sets κ and ε to their best for the last inlier weights."""
    inlier, n, weights = (first <= 1.5**2 * np.median(first)).astype(float), problem.n, problem.weights
    size = (problem.maps**2).sum((1, 2)) + n  # r² = size - 2 tr

    def rule(squares: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal inlier
        trace, kept = (size - squares) / 2, weights * inlier
        cosine = float(kept @ trace / kept.sum() / n)
        kappa = langevin.matched_kappa(n, min(cosine, float(langevin.mean_cosine(n, _LARGEST_KAPPA))))
        outliers = float(np.clip(1 - kept.sum() / weights.sum(), 1e-3, 1 - 1e-3))
        inside = np.log1p(-outliers) + kappa * trace - langevin.log_normaliser(n, kappa)
        total = np.logaddexp(inside, np.log(outliers))
        inlier = np.exp(inside - total)
        return -float(weights @ total), inlier

    return rule
