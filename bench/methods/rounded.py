"""An unconstrained estimate brought to the group, as a mean on SO(n) such as the paper takes of its MLE (1) does it."""

from bench.methods import Answer, method
from fmsync import estimators, so


@method("rounded")
def rounded(problem, *, rng, of: str = "mle-unconstrained") -> Answer:
    """The nearest rotation to every absolute map of ``of``; relative maps are then transposes, not inverses."""
    return Answer.from_absolute(so.project(estimators.solve(problem, of, rng=rng).absolute))
