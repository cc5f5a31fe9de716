"""A control: Haar-random rotations."""

from bench.methods import Answer, method
from fmsync import so


@method("random")
def random(problem, *, rng) -> Answer:
    r"""Rotations that know nothing: about :math:`\sqrt{2n}` from any truth."""
    return Answer.from_absolute(so.random_uniform(problem.n, problem.n_nodes, rng))
