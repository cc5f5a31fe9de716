"""Graphs are connected and have the edges they promise."""

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import data_gen


@given(st.integers(2, 30), st.floats(0.01, 1.0), st.integers(0, 2**32 - 1))
def test_connected_with_the_promised_number_of_edges(n_nodes, density, seed):
    n_pairs = n_nodes * (n_nodes - 1) // 2
    if round(density * n_pairs) < n_nodes - 1:
        with pytest.raises(ValueError, match="ask for at least"):
            data_gen.random_graph(n_nodes, density, seed)
        return
    graph = data_gen.random_graph(n_nodes, density, seed)
    assert nx.is_connected(graph)
    assert graph.number_of_edges() == round(density * n_pairs)
    assert graph.graph["achieved_density"] == pytest.approx(graph.number_of_edges() / n_pairs)
    edges = data_gen.graph_edges(graph)
    assert (edges[:, 0] < edges[:, 1]).all()
    assert len(np.unique(edges, axis=0)) == len(edges)


def test_the_advised_density_is_enough():
    with pytest.raises(ValueError, match="at least") as refusal:
        data_gen.random_graph(11, 0.05)
    least = float(str(refusal.value).rsplit(" ", 1)[-1])
    assert data_gen.random_graph(11, least).number_of_edges() == 10


def test_seed_decides():
    a, b, c = (data_gen.graph_edges(data_gen.random_graph(12, 0.4, seed)).tolist() for seed in (1, 1, 2))
    assert a == b
    assert a != c


def test_trees_favour_no_edge():
    """Of the 16 labelled trees on 4 nodes, each edge is in half: frequencies within 4 standard errors."""
    counts = np.zeros((4, 4))
    rng = np.random.default_rng(0)
    for _ in range(2000):
        edges = data_gen.graph_edges(data_gen.random_graph(4, 0.5, rng))
        counts[edges[:, 0], edges[:, 1]] += 1
    share = counts[np.triu_indices(4, 1)] / 2000
    assert np.abs(share - 0.5).max() < 4 * 0.5 / np.sqrt(2000)


@pytest.mark.parametrize(("n_nodes", "density"), [(1, 1.0), (4, 0.0), (4, 1.1), (4, -1), (4, float("nan"))])
def test_bad_arguments(n_nodes, density):
    with pytest.raises(ValueError, match=r"n_nodes|density"):
        data_gen.random_graph(n_nodes, density)


def test_graph_edges_refuses_odd_graphs():
    with pytest.raises(ValueError, match="2 components"):
        data_gen.graph_edges(nx.Graph([(0, 1), (2, 3)]))
    with pytest.raises(ValueError, match=r"0\.\.N-1"):
        data_gen.graph_edges(nx.Graph([("a", "b")]))
