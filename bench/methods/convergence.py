"""An iterative estimator with every step of its way, for the figure of convergence."""

from dataclasses import replace

import numpy as np

from bench.methods import Answer, Rng, SyncProblem, method
from fmsync import estimators

_MOST_STEPS = 60


@method("convergence")
def convergence(problem: SyncProblem, *, rng: Rng, of: str = "mle", on_group: bool = True, **options) -> Answer:
    """``of`` with the maps it passed through; ``on_group`` False reads relative maps as inverses, not transposes."""
    states = []

    def keep(iteration: int, absolute: np.ndarray, cost: float, gradient_norm: float):
        if iteration <= _MOST_STEPS:
            states.append((iteration, absolute.copy()))

    estimate = estimators.solve(problem, of, rng=rng, callback=keep, **options)
    path = ((k, replace(estimate, absolute=absolute, on_group=on_group).relative) for k, absolute in states)
    return Answer(estimate.relative, path=tuple(path))
