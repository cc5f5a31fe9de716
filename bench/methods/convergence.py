"""An iterative estimator with every step of its way, for the figure of convergence."""

from functools import partial

import numpy as np

from bench.methods import Answer, Rng, SyncProblem, method
from fmsync import estimators
from fmsync.problem import relative_maps

_MOST_STEPS = 60


@method("convergence")
def convergence(problem: SyncProblem, *, rng: Rng, of: str = "mle", on_group: bool = True, **options) -> Answer:
    """``of`` with the maps it passed through; ``on_group`` False reads relative maps as inverses, not transposes."""
    states = []

    def keep(iteration: int, absolute: np.ndarray, cost: float, gradient_norm: float):
        if iteration <= _MOST_STEPS:
            states.append((iteration, absolute.copy()))

    estimate = estimators.solve(problem, of, rng=rng, callback=keep, **options)

    def relative(absolute: np.ndarray, pairs: np.ndarray):
        if on_group:
            return relative_maps(absolute, pairs)
        return np.linalg.solve(absolute[pairs[:, 0]], absolute[pairs[:, 1]])

    return Answer(estimate.relative, path=tuple((k, partial(relative, absolute)) for k, absolute in states))
