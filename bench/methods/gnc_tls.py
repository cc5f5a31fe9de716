"""Truncated least squares by graduated non-convexity (Yang et al. 2020): the usual robust baseline of pose graphs."""

import numpy as np

from bench.methods import Answer, Rng, method
from fmsync import SyncProblem, solve
from fmsync.problem import relative_maps


def _squares(problem: SyncProblem, absolute: np.ndarray) -> np.ndarray:
    return ((relative_maps(absolute, problem.edges) - problem.maps) ** 2).sum((1, 2))


@method("gnc-tls")
def gnc_tls(problem: SyncProblem, *, rng: Rng, growth: float = 1.4, tolerance: float = 1e-5) -> Answer:
    """Weighted least squares from the plain answer; the weights sharpen by ``growth`` a round until they are 0 or 1.

    Residuals are cut at 1.5 times the 30 % quantile of those of the l1 answer: the method wants a bound of the noise,
    and so many maps are sound in the suite.
    """
    first = _squares(problem, solve(problem, "robust", loss="l1", rng=rng).absolute)
    bound = max(1.5**2 * np.quantile(first, 0.3), 1e-12)
    answer = solve(problem, "mle", rng=rng)
    squares = np.maximum(_squares(problem, answer.absolute), 1e-300)
    mu = bound / max(2 * squares.max() - bound, bound)
    while True:
        kept = np.clip(np.sqrt(bound / squares * mu * (mu + 1)) - mu, 0, 1)
        weights = problem.weights * np.maximum(kept, 1e-9)  # the graph stays connected
        answer = solve(SyncProblem(problem.n_nodes, problem.edges, problem.maps, weights), "mle", init=answer, rng=rng)
        if np.minimum(kept, 1 - kept).max() < tolerance or mu > 1e9:
            return Answer(answer.relative)
        squares, mu = np.maximum(_squares(problem, answer.absolute), 1e-300), growth * mu
