"""Multiplying maps along one spanning tree: what one has before synchronization."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import breadth_first_order

from fmsync import checks
from fmsync.energy import gradient_unchecked as gradient
from fmsync.estimators.base import GROUPS, Callback, Estimate, estimator, nearest
from fmsync.problem import SyncProblem
from fmsync.so import transpose


@estimator("spanning-tree")
@checks.checked(group=GROUPS)
def spanning_tree(problem: SyncProblem, *, rng: np.random.Generator, callback: Callback, group: str = "SO") -> Estimate:
    """Absolute maps along a breadth-first tree from shape 1, the heaviest observation of each pair: no averaging.

    ``group`` is ``"SO"`` or ``"O"``: what every map of the tree is projected to first.
    """
    estimate = Estimate.from_absolute(problem, along_tree(problem, group), "spanning-tree", group)
    callback(0, estimate.absolute, estimate.cost, float(np.linalg.norm(gradient(problem, estimate.absolute))))
    return estimate


def along_tree(problem: SyncProblem, group: str) -> np.ndarray:
    """Products of maps, nearest members of the group, along the tree: (N, n, n), outwards from C_1 = I."""
    n_nodes = problem.n_nodes
    pairs = np.sort(problem.edges, axis=1) @ [n_nodes, 1]  # (E,)
    by_weight = np.argsort(problem.weights, kind="stable")
    heaviest = dict(zip(pairs[by_weight].tolist(), by_weight.tolist()))  # the last of a pair stays
    adjacency = sp.coo_array((np.ones(problem.n_edges), problem.edges.T), shape=(n_nodes, n_nodes))
    order, parents = breadth_first_order((adjacency + adjacency.T).tocsr().sorted_indices(), 0)
    children, parents = order[1:], parents[order[1:]]
    links = np.sort(np.stack([children, parents], axis=1), axis=1) @ [n_nodes, 1]  # (N - 1,)
    used = [heaviest[link] for link in links.tolist()]
    maps, forward = nearest(problem.maps[used], group), problem.edges[used, 0] == parents
    absolute = np.zeros((n_nodes, problem.n, problem.n))
    absolute[0] = np.eye(problem.n)
    for child, parent, step in zip(children, parents, np.where(forward[:, None, None], maps, transpose(maps))):
        absolute[child] = absolute[parent] @ step
    return absolute
