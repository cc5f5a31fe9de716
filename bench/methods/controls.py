"""Controls: what the identity, nothing, the observations and the truth itself would score."""

import numpy as np

from bench.methods import Answer, Planted, Rng, SyncProblem, method
from fmsync import so
from fmsync.adapters import to_pyfm_maps


@method("identity")
def identity(problem: SyncProblem, *, rng: Rng) -> Answer:
    """Identity maps: what one says without looking; near-diagonal functional maps flatter it."""
    return Answer.from_absolute(np.broadcast_to(np.eye(problem.n), (problem.n_nodes, problem.n, problem.n)))


@method("random")
def random(problem: SyncProblem, *, rng: Rng) -> Answer:
    r"""Haar-random rotations, which know nothing: about :math:`\sqrt{2n}` from any truth."""
    return Answer.from_absolute(so.random_uniform(problem.n, problem.n_nodes, rng))


@method("observed")
def observed(problem: SyncProblem, *, rng: Rng) -> Answer:
    """The observed map of every edge, the projected mean where a pair is observed more than once; no other pair."""
    maps = {(i, j): so.project(c) for (j, i), c in to_pyfm_maps(problem).items()}
    nothing = np.full((problem.n, problem.n), np.nan)
    return Answer(lambda pairs: np.stack([maps.get((i, j), nothing) for i, j in np.asarray(pairs).tolist()]))


@method("oracle", sees_planted=True)
def oracle(planted: Planted, *, rng: Rng) -> Answer:
    """The true maps: any error they show is an error of the metric."""
    return Answer(planted.relative)
