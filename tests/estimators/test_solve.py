"""What holds for every estimator: the call, its errors, gauge, seeds, exactness without noise."""

import warnings

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import checks, so

ITERATIVE = [
    name for name in fmsync.methods() if (name.startswith("mle") and name != "mle-unconstrained") or name == "robust"
]


@pytest.mark.parametrize("method", fmsync.methods())
def test_consistent_maps_are_recovered_exactly(planted, method):
    problem, truth = planted(n_nodes=6, n=5, sigma2=0.0)
    estimate = fmsync.solve(problem, method)
    np.testing.assert_allclose(estimate.relative(truth.edges), truth.maps, atol=1e-7)
    unseen = np.array([[5, 0], [3, 1]])
    np.testing.assert_allclose(estimate.relative(unseen), truth.relative(unseen), atol=1e-7)


@pytest.mark.parametrize("method", fmsync.methods())
def test_a_tree_is_solved_exactly_whatever_the_noise(planted, method):
    problem, _ = planted(n_nodes=6, n=4, sigma2=0.3, graph=nx.random_labeled_tree(6, seed=1))
    estimate = fmsync.solve(problem, method)
    np.testing.assert_allclose(estimate.relative(), problem.maps, atol=1e-6)


@pytest.mark.parametrize("method", fmsync.methods())
def test_gauge_shape_and_seed(planted, method):
    problem, _ = planted(sigma2=0.1, two_way=True)
    first, second = fmsync.solve(problem, method, rng=5), fmsync.solve(problem, method, rng=5)
    assert first.absolute.shape == (problem.n_nodes, problem.n, problem.n)
    np.testing.assert_array_equal(first.absolute[0], np.eye(problem.n))
    np.testing.assert_array_equal(first.absolute, second.absolute)
    assert first.cost == second.cost
    if first.on_group:
        checks.rotations(method, first.absolute)


@pytest.mark.parametrize("method", fmsync.methods())
def test_a_change_of_frame_on_the_shapes_moves_the_answer_along(planted, method):
    """C_ij -> R_i^T C_ij R_j for rotations R_i is the same problem seen from other frames."""
    problem, _ = planted(sigma2=0.05)
    frames = so.random_uniform(problem.n, problem.n_nodes, rng=8)
    i, j = problem.edges.T
    turned = fmsync.SyncProblem(problem.n_nodes, problem.edges, so.transpose(frames[i]) @ problem.maps @ frames[j])
    before, after = fmsync.solve(problem, method), fmsync.solve(turned, method)
    np.testing.assert_allclose(after.cost, before.cost, rtol=1e-8)
    np.testing.assert_allclose(after.relative(), so.transpose(frames[i]) @ before.relative() @ frames[j], atol=1e-5)


@pytest.mark.parametrize("method", fmsync.methods())
def test_the_callback_sees_the_cost_that_is_reported(planted, method):
    problem, _ = planted(sigma2=0.1)
    seen = []
    estimate = fmsync.solve(problem, method, callback=lambda k, c, cost, norm: seen.append((k, c.shape, cost, norm)))
    assert [entry[0] for entry in seen] == list(range(len(seen)))
    assert seen[-1][1] == estimate.absolute.shape
    np.testing.assert_allclose(seen[-1][2], estimate.cost, rtol=1e-9)
    if estimate.trace is not None:
        np.testing.assert_array_equal(estimate.trace.cost, [entry[2] for entry in seen])
        assert len(seen) == estimate.n_iterations + 1
        assert (np.diff(estimate.trace.seconds) >= 0).all()


@pytest.mark.parametrize("method", ITERATIVE)
def test_stopping_early_is_said_aloud(planted, method):
    problem, _ = planted(sigma2=0.3)
    with pytest.warns(RuntimeWarning, match=f"'{method}' stopped after . steps before its tolerance"):
        estimate = fmsync.solve(problem, method, init="random", max_iterations=1)
    assert not estimate.converged
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert fmsync.solve(problem, method).converged


def test_unknown_names_are_refused_with_a_hint(planted):
    problem, _ = planted()
    with pytest.raises(ValueError, match="'spectal'; did you mean spectral"):
        fmsync.solve(problem, "spectal")
    with pytest.raises(ValueError, match=r"known: .*spanning-tree"):
        fmsync.solve(problem, "xyz")
    with pytest.raises(ValueError, match="tol: 'mle' has no such option; it takes init, "):
        fmsync.solve(problem, "mle", tol=1)
    with pytest.raises(ValueError, match=r"init: 'spectral', 'random', .* not 'cold'"):
        fmsync.solve(problem, "mle", init="cold")
    with pytest.raises(ValueError, match="init: node 2 is not a rotation"):
        fmsync.solve(problem, "mle", init=np.stack([np.eye(5), np.eye(5), 2 * np.eye(5)] + 4 * [np.eye(5)]))
    with pytest.raises(ValueError, match=r"init: expected \(7, 5, 5\), got \(2, 5, 5\)"):
        fmsync.solve(problem, "mle", init=np.stack([np.eye(5)] * 2))


def test_restarts_count_the_starts_that_agree(planted):
    easy, _ = planted(sigma2=0.05)
    estimate = fmsync.solve(easy, "mle", restarts=4)
    assert (estimate.n_starts, estimate.n_agreeing) == (4, 4)
    np.testing.assert_allclose(estimate.relative(), fmsync.solve(easy, "mle").relative(), atol=1e-6)
    with pytest.raises(ValueError, match="restarts: 'spectral' has no starting point"):
        fmsync.solve(easy, "spectral", restarts=3)
    with pytest.raises(ValueError, match="restarts: an integer >= 1"):
        fmsync.solve(easy, "mle", restarts=0)


def test_restarts_leave_a_local_minimum_that_one_start_is_caught_in(winding_ring):
    problem, winding = winding_ring
    caught = fmsync.solve(problem, "mle", init=winding)
    assert caught.converged
    assert caught.cost > 1
    best = fmsync.solve(problem, "mle", init=winding, restarts=10)
    assert best.cost < 1e-9
    assert 1 <= best.n_agreeing < 10


def test_the_mean_of_starts_stands_in_one_gauge(planted):
    problem, _ = planted(n=6, sigma2=0.1)
    mean, starts = fmsync.estimators.mean_of_starts(problem, 5, rng=3)
    assert len(starts) == 5
    assert len({start.trace.cost[0] for start in starts}) == 5  # the starts were different points
    np.testing.assert_allclose(mean.relative(), fmsync.solve(problem, "mle").relative(), atol=1e-5)


def test_weights_count_observations():
    truth = data_gen.planted(5, 4, rng=0)
    problem = data_gen.perturb(truth, 0.2, rng=1)
    repeated = np.repeat(np.arange(problem.n_edges), np.arange(problem.n_edges) % 3 + 1)
    many = fmsync.SyncProblem(5, problem.edges[repeated], problem.maps[repeated])
    weighted = fmsync.SyncProblem(5, problem.edges, problem.maps, np.arange(problem.n_edges) % 3 + 1.0)
    for method in ("spectral", "mle", "mle-unconstrained"):
        a, b = fmsync.solve(many, method), fmsync.solve(weighted, method)
        np.testing.assert_allclose(a.cost, b.cost, rtol=1e-9)
        np.testing.assert_allclose(a.absolute, b.absolute, atol=1e-5)
