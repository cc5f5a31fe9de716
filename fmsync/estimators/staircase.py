"""Maximum likelihood that climbs out of local minima: the Riemannian staircase, with a certificate at its end."""

from dataclasses import replace

import numpy as np

from fmsync import checks
from fmsync.block_krylov import DENSE, block_lanczos, largest_eigenpairs, orthonormal_rows
from fmsync.energy import gradient_unchecked as gradient
from fmsync.energy import neighbour_sums_unchecked as neighbour_sums
from fmsync.estimators.base import Callback, Estimate, Recorder, estimator, nearest
from fmsync.estimators.certificate import Certificate, certify, least_eigenvalue, shifted_certificate
from fmsync.estimators.mle import descend
from fmsync.estimators.spectral import common_orientation
from fmsync.estimators.starts import starting_point
from fmsync.estimators.trust_region import Point, Rotations, minimise
from fmsync.problem import SyncProblem
from fmsync.so import sym, transpose

_MOST_LIFTS = 5  # of up to n rows each; one is enough for most problems
_SOLVED = 0.05  # fraction of the gap that the accuracy of the relaxation may be to blame for
_LOOSE = 1e-3  # fraction of the gradient that a relaxation may leave: its answer is rounded anyhow


@estimator("staircase")
@checks.checked(tolerance=checks.not_negative, max_iterations=">= 0")
def staircase(
    problem: SyncProblem,
    *,
    rng: np.random.Generator,
    callback: Callback,
    init: str | np.ndarray | Estimate = "spectral",
    group: str = "SO",
    tolerance: float = 1e-6,
    max_iterations: int = 500,
) -> Estimate:
    r"""What ``"mle"`` answers or a better one: where :func:`fmsync.certify` refuses, relax, descend, and round.

    Maps with r > n rows, :math:`Y_i \in \mathrm{St}(r, n)`, have the cost :math:`\mathrm{const} -
    \operatorname{tr}(Y B Y^\top)`, and negative eigenvectors of the certificate matrix Q as new rows lower it. Trust
    regions then find a minimum, and the rank grows until the certificate holds there, nearly. Its n leading directions,
    rounded, are a start for ``"mle"`` (Boumal 2015; Rosen et al. 2019; Dellaert et al. 2020).

    Options are those of ``"mle"``, whose cost is never exceeded. No orthogonal maps cost less than ``lower_bound``,
    which :func:`fmsync.certify` takes into account: its gap bound is then far smaller than that of the maps alone. The
    ``trace`` has one entry for ``"mle"``, and one more if rounding improved on it.
    """
    recorder = Recorder(callback)
    options = {"tolerance": tolerance, "max_iterations": max_iterations}

    def record(answer: Estimate) -> Certificate:
        recorder(answer.absolute, answer.cost, float(np.linalg.norm(gradient(problem, answer.absolute))))
        return certify(problem, answer)

    best = descend(problem, starting_point(problem, init, rng, group), "staircase", **options)
    certificate = record(best)
    lower, lift = best.cost - certificate.gap_bound, best.absolute
    for _ in range(_MOST_LIFTS * (not certificate.certified)):
        start = _escape(problem, lift)
        if start is None:
            break
        model = _Lifts(problem, start.shape[1])
        loose = max(tolerance, _LOOSE * model.evaluate(start).norm)
        lift, _, trace = minimise(model, start, tolerance=loose, max_iterations=max_iterations)
        inexact = problem.n_nodes * problem.n * max(0.0, -least_eigenvalue(problem, lift))
        lower = max(lower, trace.cost[-1] - inexact)
        if inexact <= _SOLVED * (best.cost - lower):
            break
    if lift is not best.absolute:
        leading, _, _ = np.linalg.svd(np.concatenate(list(lift), axis=1), full_matrices=False)
        blocks = leading[:, : problem.n].T @ lift  # in the n leading directions of the lifts
        start = nearest(common_orientation(blocks) if group == "SO" else blocks, group)
        rounded = descend(problem, start, "staircase", **options)
        if rounded.cost < best.cost:
            best, lower = rounded, max(lower, rounded.cost - record(rounded).gap_bound)
    return replace(best, trace=recorder.trace(), lower_bound=min(float(lower), best.cost))


class _Lifts(Rotations):
    r"""The cost :math:`\mathrm{const} - \sum\operatorname{tr}(Y_i^\top S_i)` on N Stiefel manifolds St(r, n).

    Tangent arrays are ambient: V with :math:`Y_i^\top V_i` skew-symmetric.
    """

    def __init__(self, problem: SyncProblem, rank: int) -> None:
        super().__init__(problem)
        self.dimension = problem.n_nodes * (rank * problem.n - problem.n * (problem.n + 1) // 2)

    def evaluate(self, absolute: np.ndarray) -> Point:
        sums = neighbour_sums(self._problem, absolute)
        product = transpose(absolute) @ sums
        curvature = sym(product)
        cost = self._problem.constant - float(np.einsum("jaa->", product))
        return Point(absolute, cost, 2 * (absolute @ curvature - sums), (absolute, curvature))

    def hessian(self, point: Point, direction: np.ndarray) -> np.ndarray:
        absolute, curvature = point.extra
        ambient = 2 * (direction @ curvature - neighbour_sums(self._problem, direction))
        return ambient - absolute @ sym(transpose(absolute) @ ambient)

    def retract(self, point: Point, step: np.ndarray) -> np.ndarray:
        return nearest(point.absolute + step, "O")


def _escape(problem: SyncProblem, lift: np.ndarray) -> np.ndarray | None:
    """Cheaper lifts (N, r + k, n), with k <= n negative eigenvectors of Q in new rows; None where none are found."""
    n_nodes, rank, n = lift.shape
    point = _Lifts(problem, rank).evaluate(lift)
    shift, apply = shifted_certificate(problem, point.extra[1], np.ones(n_nodes))
    if n_nodes * n <= DENSE:
        values, columns = largest_eigenpairs(apply, n_nodes * n, n)
        rows = columns.T
    else:
        first, _ = orthonormal_rows(np.random.default_rng(0).standard_normal((n, n_nodes * n)))
        values, rows = block_lanczos(apply, first, n, lambda found: 1e-4 * found, min(12, n_nodes), cycles=4)
    k = int((values > (1 + 1e-9) * shift).sum())
    rows = rows[:k].reshape(k, n_nodes, n).swapaxes(0, 1)  # any negative direction will do
    for halvings in range(20 * (k > 0)):
        moved = nearest(np.concatenate([lift, 0.5**halvings / np.abs(rows).max() * rows], axis=1), "O")
        if _Lifts(problem, rank + k).evaluate(moved).cost < point.cost:
            return moved
    return None
