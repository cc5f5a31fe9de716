"""A control: every map is the identity."""

import numpy as np

from bench.methods import Answer, method


@method("identity")
def identity(problem, *, rng) -> Answer:
    """Identity maps: what one says without looking; near-diagonal functional maps flatter it."""
    return Answer.from_absolute(np.broadcast_to(np.eye(problem.n), (problem.n_nodes, problem.n, problem.n)))
