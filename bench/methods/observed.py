"""A control: the observations themselves, not synchronized."""

import numpy as np

from bench.methods import Answer, method
from fmsync import so


@method("observed")
def observed(problem, *, rng) -> Answer:
    """The observed map of every edge, the projected mean where a pair is observed more than once; no other pair."""
    totals: dict[tuple[int, int], np.ndarray] = {}
    for (i, j), c in zip(problem.edges.tolist(), problem.maps):
        key, c = ((i, j), c) if i < j else ((j, i), c.T)
        totals[key] = totals.get(key, 0.0) + c
    maps = {pair: so.project(total) for pair, total in totals.items()}
    maps |= {(j, i): c.T for (i, j), c in maps.items()}
    nothing = np.full((problem.n, problem.n), np.nan)
    return Answer(lambda pairs: np.stack([maps.get((i, j), nothing) for i, j in np.asarray(pairs).tolist()]))
