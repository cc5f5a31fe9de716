"""How often confidence balls without sampling hold the truth, beside the credible balls of a sampler."""

import numpy as np

from bench import metrics
from bench.methods import Answer, Planted, Rng, method
from fmsync.estimators import solve


@method("confidence-balls", sees_planted=True)
def confidence_balls(planted: Planted, *, rng: Rng, of: str = "mle") -> Answer:
    """The estimate ``of`` a method; the truth is looked at by the metrics alone, when the clock has stopped."""
    estimate = solve(planted.problem, of, rng=rng)
    edges = np.unique(np.sort(planted.problem.edges, axis=1), axis=0)
    radii = {level: estimate.confidence_balls(level, edges)[1] for level in metrics.LEVELS}

    def numbers() -> dict[str, float]:
        errors = metrics.frobenius_errors(estimate.relative(edges), planted.relative(edges))
        return {f"coverage_{round(100 * level)}": float((errors <= radii[level]).mean()) for level in radii}

    return Answer(estimate.relative, numbers=numbers)
