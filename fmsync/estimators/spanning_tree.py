"""Multiplying maps along one spanning tree: what one has before synchronization."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import breadth_first_order

from fmsync import checks
from fmsync.energy import gradient_unchecked as gradient
from fmsync.estimators.base import GROUPS, Callback, Estimate, estimator, nearest
from fmsync.problem import SyncProblem


@estimator("spanning-tree")
@checks.checked(group=GROUPS)
def spanning_tree(problem: SyncProblem, *, rng: np.random.Generator, callback: Callback, group: str = "SO") -> Estimate:
    """Absolute maps along a breadth-first tree from shape 1, the heaviest observation of each pair: no averaging.

    ``group`` is ``"SO"`` or ``"O"``: what every map is projected to first.
    """
    heaviest = {frozenset(problem.edges[e].tolist()): e for e in np.argsort(problem.weights, kind="stable")}
    adjacency = sp.coo_array((np.ones(problem.n_edges), problem.edges.T), shape=(problem.n_nodes, problem.n_nodes))
    order, parents = breadth_first_order((adjacency + adjacency.T).tocsr().sorted_indices(), 0)
    maps = nearest(problem.maps, group)
    absolute = np.zeros((problem.n_nodes, problem.n, problem.n))
    absolute[0] = np.eye(problem.n)
    for child in order[1:].tolist():
        parent = int(parents[child])
        e = heaviest[frozenset((parent, child))]
        forward = problem.edges[e, 0] == parent
        absolute[child] = absolute[parent] @ (maps[e] if forward else maps[e].T)
    estimate = Estimate.from_absolute(problem, absolute, "spanning-tree", group)
    callback(0, estimate.absolute, estimate.cost, float(np.linalg.norm(gradient(problem, estimate.absolute))))
    return estimate
