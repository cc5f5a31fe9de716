"""A control: the truth itself. Any error it shows is an error of the metric."""

from bench.methods import Answer, method


@method("oracle", sees_planted=True)
def oracle(planted, *, rng) -> Answer:
    """The true maps."""
    return Answer(planted.relative)
