"""The paper's protocol for its MLE rows: the Fréchet mean of ten answers from ten random starts."""

from bench.methods import Answer, method
from fmsync.estimators.restarts import mean_of_starts as fmsync_mean_of_starts


@method("mean-of-starts")
def mean_of_starts(problem, *, rng, of: str = "mle", n_starts: int = 10, distance: str = "chordal") -> Answer:
    """Answers of ``of`` from random starts, gauges aligned, averaged on the group."""
    mean, _ = fmsync_mean_of_starts(problem, n_starts, of, rng=rng, distance=distance)
    return Answer(mean.relative)
