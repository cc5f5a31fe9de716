"""pyFM's functional map network, which relaxes and never rounds, on the same maps."""

import networkx as nx
import numpy as np
import pytest

import fmsync

pytest.importorskip("pyFM")


def rms_error(relative, truth):
    return np.sqrt(((relative - truth.maps) ** 2).sum((1, 2)).mean())


@pytest.fixture
def network():
    from bench.methods.pyfm_network import pyfm_network

    return lambda problem, **options: pyfm_network(problem, rng=np.random.default_rng(0), **options)


def test_consistent_maps_come_back_from_both(planted, network):
    problem, truth = planted(n_nodes=6, n=4, sigma2=0.0)
    np.testing.assert_allclose(network(problem).relative(truth.edges), truth.maps, atol=1e-6)
    np.testing.assert_allclose(fmsync.solve(problem).relative(truth.edges), truth.maps, atol=1e-8)


def test_its_rounded_bases_are_our_spectral_answer_on_a_regular_graph(planted, network):
    """Both relax to leading eigenvectors, of the same matrix where all nodes have one degree."""
    problem, truth = planted(n_nodes=10, n=5, sigma2=0.1, graph=nx.random_regular_graph(6, 10, seed=0))
    theirs = network(problem, projected=True).relative(truth.edges)
    np.testing.assert_allclose(fmsync.solve(problem, "spectral").relative(truth.edges), theirs, atol=1e-5)


def test_maximum_likelihood_is_nearer_to_the_truth(planted, network):
    ours, theirs = [], []
    for seed in range(10):
        problem, truth = planted(n_nodes=10, n=8, sigma2=0.1, rng=seed)
        ours.append(rms_error(fmsync.solve(problem).relative(truth.edges), truth))
        theirs.append(rms_error(network(problem).relative(truth.edges), truth))
    assert (np.array(ours) < np.array(theirs)).all()
