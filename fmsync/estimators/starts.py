"""Where iterative estimators begin."""

import numpy as np

from fmsync import checks, so
from fmsync.energy import neighbour_sums_unchecked as neighbour_sums
from fmsync.estimators.base import GROUPS, Estimate, nearest
from fmsync.estimators.spectral import spectral_maps
from fmsync.problem import SyncProblem

_ROUGH = 0.03  # residual of the eigenvectors that a start is made of: an optimiser does the rest faster


@checks.checked(group=GROUPS)
def starting_point(
    problem: SyncProblem, init: str | np.ndarray | Estimate, rng: np.random.Generator, group: str = "SO"
) -> np.ndarray:
    """Members of the group (N, n, n) to start from.

    "spectral", "random" (Haar), given maps, or an earlier estimate: of this problem, or of one that had only the first
    few of its nodes. Nodes that are new to it start at what their known neighbours say.
    """
    n_nodes, n = problem.n_nodes, problem.n
    if isinstance(init, str):
        if init == "random":
            absolute = so.random_uniform(n, n_nodes, rng)
            if group == "O":
                absolute[..., 0] *= rng.choice([-1.0, 1.0], size=(n_nodes, 1))
            return absolute
        if init == "spectral":
            return spectral_maps(problem, rng, group, _ROUGH)
        raise ValueError(f"init: 'spectral', 'random', rotations or an Estimate, not {init!r}")
    earlier = isinstance(init, Estimate)
    known = np.array(init.absolute if isinstance(init, Estimate) else init, dtype=float)
    if earlier and known.shape[1:] == (n, n) and len(known) < n_nodes:
        return _grown(problem, nearest(known, group), group)
    if known.shape != (n_nodes, n, n):
        raise ValueError(f"init: expected {(n_nodes, n, n)}, got {known.shape}")
    if group == "SO" and not earlier:
        checks.rotations("init", known)
    return nearest(known, group)


def _grown(problem: SyncProblem, known: np.ndarray, group: str) -> np.ndarray:
    """(N, n, n): known maps first; the others, outwards along the edges, nearest to the sum over known neighbours."""
    absolute = np.zeros((problem.n_nodes, problem.n, problem.n))
    absolute[: len(known)] = known
    placed = np.arange(problem.n_nodes) < len(known)
    tail, head = problem.edges.T
    while not placed.all():
        reached = np.zeros_like(placed)
        reached[head[placed[tail]]] = True
        reached[tail[placed[head]]] = True
        reached &= ~placed
        absolute[reached] = nearest(neighbour_sums(problem, absolute)[reached], group)
        placed |= reached
    return absolute
