"""The paper's baseline for oracle accuracy: one estimate of maximum likelihood, then draws that know nothing."""

from bench.methods import Answer, method
from fmsync import estimators, oracle


@method("haar-baseline")
def haar_baseline(problem, *, rng, n_draws: int = 1000) -> Answer:
    """Draws of :func:`fmsync.oracle.haar_baseline`; the point answer is the estimate."""
    estimate = estimators.solve(problem, "mle", rng=rng)
    return Answer(estimate.relative, oracle.haar_baseline(estimate.absolute, n_draws, rng))
