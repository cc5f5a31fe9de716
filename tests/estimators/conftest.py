"""Problems with a planted truth, shared by the tests of the estimators."""

import networkx as nx
import numpy as np
import pytest

import data_gen


@pytest.fixture(scope="session")
def planted():
    """Factory of (problem, truth): projected-Gaussian noise on planted rotations."""

    def make(n_nodes=7, n=5, sigma2=0.1, rng=0, graph=None, two_way=False):
        truth = data_gen.planted(n_nodes, n, graph, rng=[rng, 1])
        return data_gen.perturb(truth, sigma2, np.random.default_rng([rng, 2]), two_way=two_way), truth

    return make


@pytest.fixture(scope="session")
def rms_ratio(planted):
    """Root-mean-square error of an estimator over seeds, divided by the expected line."""
    import fmsync

    def ratio(method, n_nodes, n, sigma2, n_seeds, two_way=False, **options):
        squared = []
        for seed in range(n_seeds):
            problem, truth = planted(n_nodes, n, sigma2, seed, two_way=two_way)
            estimate = fmsync.solve(problem, method, **options)
            squared.append(((estimate.relative(truth.edges) - truth.maps) ** 2).sum((1, 2)).mean())
        edges = list(nx.complete_graph(n_nodes).edges)
        edges += [(j, i) for i, j in edges] if two_way else []
        expected = fmsync.expected_rms_error(n_nodes, np.array(edges), n, sigma2)[0]  # complete graph: all edges alike
        return np.sqrt(np.mean(squared)) / expected

    return ratio


@pytest.fixture(scope="session")
def winding_ring():
    """(problem, rotations): identity maps around a ring of 10, and the local minimum that winds around it once."""
    import fmsync

    edges = np.stack([np.arange(10), (np.arange(10) + 1) % 10], axis=1)
    problem = fmsync.SyncProblem(10, edges, np.stack([np.eye(3)] * 10))
    angle = 2 * np.pi * np.arange(10) / 10
    winding = np.tile(np.eye(3), (10, 1, 1))
    winding[:, 0, 0], winding[:, 0, 1] = np.cos(angle), -np.sin(angle)
    winding[:, 1, 0], winding[:, 1, 1] = np.sin(angle), np.cos(angle)
    return problem, winding
