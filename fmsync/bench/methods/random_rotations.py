"""A control: Haar-random rotations."""

from fmsync import so
from fmsync.bench.methods import Answer, method


@method("random")
def random(problem, *, rng) -> Answer:
    r"""Rotations that know nothing: about :math:`\sqrt{2n}` from any truth."""
    return Answer.from_absolute(so.random_uniform(problem.n, problem.n_nodes, rng))
