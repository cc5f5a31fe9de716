"""Maps multiplied along one tree."""

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync


def test_observations_of_a_tree_are_met_exactly():
    p = data_gen.perturb(data_gen.planted(7, 4, nx.balanced_tree(2, 2), rng=0), 0.3, 1)
    estimate = fmsync.solve(p, "spanning-tree")
    np.testing.assert_allclose(estimate.relative(), p.maps, atol=1e-12)
    np.testing.assert_allclose(estimate.absolute[0], np.eye(4))


def test_the_shortest_way_from_the_first_shape_counts():
    p = data_gen.perturb(data_gen.planted(5, 3, rng=0), 0.3, 1)  # complete: every shape is one map away
    np.testing.assert_allclose(fmsync.solve(p, "spanning-tree").relative([[0, k] for k in range(1, 5)]), p.maps[:4])


@pytest.mark.parametrize("heavier", [0, 1])
def test_of_repeated_observations_the_heaviest_counts_in_either_direction(heavier):
    maps = fmsync.so.random_uniform(3, 2, rng=0)
    p = fmsync.SyncProblem(2, [[0, 1], [1, 0]], maps, [3.0, 2.0] if heavier == 0 else [2.0, 3.0])
    expected = maps[0] if heavier == 0 else maps[1].T
    np.testing.assert_allclose(fmsync.solve(p, "spanning-tree").relative([[0, 1]])[0], expected, atol=1e-12)
