"""What the paper makes of estimates before it scores them, and what it follows on the way."""

from dataclasses import replace

import numpy as np

from bench.methods import Answer, Rng, SyncProblem, method
from fmsync import estimators, oracle, so

_MOST_STEPS = 60


@method("rounded")
def rounded(problem: SyncProblem, *, rng: Rng, of: str = "mle-unconstrained") -> Answer:
    """The nearest rotation to every absolute map of ``of``; relative maps are then transposes, not inverses."""
    return Answer.from_absolute(so.project(estimators.solve(problem, of, rng=rng).absolute))


@method("mean-of-starts")
def mean_of_starts(
    problem: SyncProblem, *, rng: Rng, of: str = "mle", n_starts: int = 10, distance: str = "chordal"
) -> Answer:
    """Answers of ``of`` from random starts, gauges aligned, averaged on the group: the protocol of the MLE rows."""
    return Answer(estimators.mean_of_starts(problem, n_starts, of, rng=rng, distance=distance)[0].relative)


@method("haar-baseline")
def haar_baseline(problem: SyncProblem, *, rng: Rng, n_draws: int = 1000) -> Answer:
    """The baseline of oracle accuracy: one estimate of maximum likelihood, then draws that know nothing."""
    estimate = estimators.solve(problem, "mle", rng=rng)
    return Answer(estimate.relative, oracle.haar_baseline(estimate.absolute, n_draws, rng))


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
