"""The certificate: true where the optimum is known to be global, not given to a planted local minimum."""

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import so
from fmsync.energy import energy, gradient
from fmsync.estimators import certificate


def noisy(sigma2, n_nodes=11, n=6, seed=0, graph=None):
    return data_gen.perturb(data_gen.planted(n_nodes, n, graph, rng=seed), sigma2, rng=seed + 1)


def certificate_matrix(problem, c):
    """blkdiag(sym(C_i^T S_i)) - B, block by block from the definition."""
    n = problem.n
    q = np.zeros((problem.n_nodes, problem.n_nodes, n, n))
    for (i, j), weight, observed in zip(problem.edges, problem.weights, problem.maps):
        q[i, j] -= weight * observed
        q[j, i] -= weight * observed.T
        q[j, j] += weight * so.sym(c[j].T @ c[i] @ observed)
        q[i, i] += weight * so.sym(c[i].T @ c[j] @ observed.T)
    return q.transpose(0, 2, 1, 3).reshape(problem.n_nodes * n, -1)


@pytest.mark.parametrize("sigma2", [0.0, 0.01, 0.1])
def test_clean_and_low_noise_optima_are_certified(sigma2):
    problem = noisy(sigma2)
    found = fmsync.certify(problem, fmsync.solve(problem))
    assert found.certified
    assert abs(found.min_eigenvalue) < 1e-7
    assert found.gap_bound < 1e-4


def test_the_winding_ring_is_a_local_minimum_and_not_certified():
    c = wound_once(10)
    edges = [(i, (i + 1) % 10) for i in range(10)]
    problem = fmsync.SyncProblem(10, edges, np.stack([np.eye(3)] * 10))
    assert np.abs(gradient(problem, c)).max() < 1e-14
    found = fmsync.certify(problem, c)
    assert not found.certified
    np.testing.assert_allclose(found.min_eigenvalue, -0.38, atol=0.005)
    assert energy(problem, c) <= found.gap_bound  # the global minimum is 0


def wound_once(n_nodes):
    """Rotations of the first plane that go round once, (N, 3, 3)."""
    angle = 2 * np.pi * np.arange(n_nodes) / n_nodes
    c = np.tile(np.eye(3), (n_nodes, 1, 1))
    c[:, 0, 0], c[:, 0, 1], c[:, 1, 0], c[:, 1, 1] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    return c


@pytest.mark.parametrize("heavy", [1e8, 1e4, 1.0])
def test_one_heavy_edge_does_not_certify_a_local_minimum(heavy):
    """A ring wound once with a pendant node: the optimum is 0, and the largest degree says nothing about the ring."""
    edges = [*((i, (i + 1) % 9) for i in range(9)), (0, 9)]
    problem = fmsync.SyncProblem(10, edges, np.stack([np.eye(3)] * 10), [1.0] * 9 + [heavy])
    wound = np.concatenate([wound_once(9), wound_once(9)[:1]])
    assert np.abs(gradient(problem, wound)).max() < 1e-6
    found = fmsync.certify(problem, wound)
    assert not found.certified
    assert energy(problem, wound) <= found.gap_bound
    assert fmsync.certify(problem, np.stack([np.eye(3)] * 10)).certified


def test_a_long_ring_with_one_heavy_edge_is_not_certified():
    """The heavy edge is not turned, the others share its part."""
    edges = [(i, (i + 1) % 500) for i in range(500)]
    weights = np.ones(500)
    weights[-1] = 2e4
    problem = fmsync.SyncProblem(500, edges, np.stack([np.eye(3)] * 500), weights)
    wound = fmsync.solve(problem, "mle", init=wound_once(500), max_iterations=2000).absolute
    assert energy(problem, wound) > 0.1  # still wound
    found = fmsync.certify(problem, wound)
    assert not found.certified
    assert energy(problem, wound) <= found.gap_bound


@pytest.mark.parametrize(("n_nodes", "density", "sigma2"), [(100, 1.0, 0.0), (100, 0.2, 0.005), (30, 0.3, 0.01)])
def test_true_optima_of_unequal_weights_are_certified(n_nodes, density, sigma2):
    clean = noisy(sigma2, n_nodes, n=14, graph=data_gen.random_graph(n_nodes, density, rng=3))
    weights = 10 ** np.random.default_rng(1).uniform(-1, 1, clean.n_edges)
    problem = fmsync.SyncProblem(n_nodes, clean.edges, clean.maps, weights)
    assert fmsync.certify(problem, fmsync.solve(problem)).certified


def test_the_gap_bound_holds_for_any_maps():
    problem = noisy(0.2)
    best = fmsync.solve(problem).cost
    for seed in range(5):
        anywhere = so.random_uniform(problem.n, problem.n_nodes, rng=seed)
        found = fmsync.certify(problem, anywhere)
        assert not found.certified
        assert energy(problem, anywhere) - best <= found.gap_bound


def test_the_eigenvalue_is_that_of_the_matrix_in_its_definition():
    clean = noisy(0.3, n_nodes=8, n=4, graph=nx.cycle_graph(8))
    edges = np.concatenate([clean.edges, clean.edges[:3, ::-1]])
    maps = np.concatenate([clean.maps, so.random_uniform(4, 3, rng=5)])
    problem = fmsync.SyncProblem(8, edges, maps, np.linspace(0.5, 2, len(edges)))
    c = so.random_uniform(4, 8, rng=6)
    expected = np.linalg.eigvalsh(certificate_matrix(problem, c))[0]
    np.testing.assert_allclose(fmsync.certify(problem, c).min_eigenvalue, expected, rtol=1e-10)


@pytest.mark.parametrize("density", [1.0, 0.1])
def test_lanczos_agrees_with_the_dense_eigensolver(density, monkeypatch):
    problem = noisy(0.1, n_nodes=60, n=4, graph=data_gen.random_graph(60, density, rng=0))
    optimum = fmsync.solve(problem)
    elsewhere = so.random_uniform(4, 60, rng=0)
    dense = [fmsync.certify(problem, c) for c in (optimum, elsewhere)]
    monkeypatch.setattr(certificate, "_DENSE_UP_TO", 0)
    lanczos = [fmsync.certify(problem, c) for c in (optimum, elsewhere)]
    assert [found.certified for found in lanczos] == [found.certified for found in dense] == [True, False]
    for a, b in zip(dense, lanczos):
        np.testing.assert_allclose(a.min_eigenvalue, b.min_eigenvalue, atol=1e-9)


def test_the_gauge_does_not_matter():
    problem = noisy(0.3)
    c = so.random_uniform(problem.n, problem.n_nodes, rng=3)
    turned = so.random_uniform(problem.n, rng=4) @ c
    expected = fmsync.certify(problem, c).min_eigenvalue
    np.testing.assert_allclose(fmsync.certify(problem, turned).min_eigenvalue, expected, rtol=1e-10)


def test_what_cannot_be_certified_is_refused():
    problem = noisy(0.1)
    with pytest.raises(ValueError, match="estimate: node . is not orthogonal"):
        fmsync.certify(problem, fmsync.solve(problem, "mle-unconstrained"))
    with pytest.raises(ValueError, match=r"estimate: expected \(11, 6, 6\)"):
        fmsync.certify(problem, np.eye(6)[None])
