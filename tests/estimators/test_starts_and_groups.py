"""Starts from earlier answers, maps that are hardly orthogonal, and maps that reverse orientation."""

import warnings

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import so


def first_nodes(problem, n_nodes):
    """The problem before its last nodes came."""
    old = (problem.edges < n_nodes).all(axis=1)
    return fmsync.SyncProblem(n_nodes, problem.edges[old], problem.maps[old])


@pytest.mark.parametrize("n_nodes", [2, 3])
def test_a_start_may_be_an_estimate_of_integers(n_nodes):
    problem = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
    known = fmsync.Estimate(first_nodes(problem, n_nodes), "by hand", np.stack([np.eye(4, dtype=int)] * n_nodes), 0.0)
    assert fmsync.solve(problem, init=known).cost < 1e-20


@pytest.mark.parametrize("method", ["mle", "mle-geodesic"])
def test_a_start_from_fewer_nodes_reaches_the_same_optimum_in_fewer_steps(planted, method):
    problem, _ = planted(n_nodes=14, n=6, sigma2=0.05)
    before = fmsync.solve(first_nodes(problem, 12), method)
    warm = fmsync.solve(problem, method, init=before)
    far = fmsync.solve(problem, method, init="random")
    assert warm.converged
    np.testing.assert_allclose(warm.absolute, fmsync.solve(problem, method).absolute, atol=1e-5)
    assert warm.trace.cost[0] < far.trace.cost[0] / 2
    assert warm.n_iterations < far.n_iterations


def test_new_nodes_are_reached_along_chains():
    """Node 3 hangs on 2, which is new as well; without noise the start is already the answer."""
    truth = data_gen.planted(4, 5, rng=0)
    edges = np.array([[0, 1], [2, 1], [2, 3]])
    problem = fmsync.SyncProblem(4, edges, truth.relative(edges))
    before = fmsync.solve(first_nodes(problem, 2))
    warm = fmsync.solve(problem, init=before)
    assert warm.n_iterations == 0
    np.testing.assert_allclose(warm.relative(truth.edges), truth.maps, atol=1e-12)


def test_new_edges_keep_the_old_answer_as_a_start(planted):
    problem, _ = planted(n_nodes=12, n=6, sigma2=0.1)
    fewer = fmsync.SyncProblem(12, problem.edges[:-6], problem.maps[:-6])
    before = fmsync.solve(fewer)
    warm = fmsync.solve(problem, init=before)
    np.testing.assert_array_equal(warm.trace.cost[0] < fmsync.solve(problem, init="random").trace.cost[0] / 2, True)
    np.testing.assert_allclose(warm.cost, fmsync.solve(problem).cost, rtol=1e-10)


def test_an_estimate_of_other_maps_is_no_start(planted):
    small, large = planted(n_nodes=5)[0], planted(n_nodes=7)[0]
    with pytest.raises(ValueError, match=r"init: expected \(5, 5, 5\), got \(7, 5, 5\)"):
        fmsync.solve(small, init=fmsync.solve(large))
    with pytest.raises(ValueError, match=r"init: expected \(7, 5, 5\), got \(7, 3, 3\)"):
        fmsync.solve(large, init=fmsync.solve(planted(n_nodes=7, n=3)[0]))


def test_maps_far_from_orthogonal_are_named(planted):
    problem, _ = planted()
    maps = problem.maps.copy()
    maps[3] *= 1.2
    maps[5] *= 1.6
    scaled = fmsync.SyncProblem(problem.n_nodes, problem.edges, maps)
    np.testing.assert_allclose(scaled.orthogonality_error[[0, 3, 5]], [0, 0.44, 1.56], atol=1e-12)
    with pytest.warns(UserWarning, match=r"maps: edge 5 \(0, 6\) is far from orthogonal .* = 1.6\); project the maps"):
        fmsync.solve(scaled, "spectral")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fmsync.solve(scaled, "mle-unconstrained")
        fmsync.solve(fmsync.SyncProblem(problem.n_nodes, problem.edges, so.project(maps)), "spectral")


@pytest.fixture
def reversing():
    """Consistent maps of which about half reverse orientation, with a little noise: (problem, absolute maps)."""
    rng = np.random.default_rng(3)
    absolute = so.random_uniform(6, 9, rng=rng)
    absolute[1::2, 0] *= -1
    absolute = so.transpose(absolute[:1]) @ absolute
    edges = data_gen.graph_edges(data_gen.random_graph(9, 0.7, rng=0))
    noise = so.project(np.eye(6) + 0.1 * rng.standard_normal((len(edges), 6, 6)))
    return fmsync.SyncProblem(9, edges, fmsync.problem.relative_maps(absolute, edges) @ noise), absolute


@pytest.mark.parametrize("method", ["spectral", "mle", "robust", "spanning-tree"])
def test_orthogonal_maps_of_both_orientations_are_synchronised(reversing, method):
    problem, absolute = reversing
    assert 0 < (np.linalg.det(problem.maps) < 0).sum() < problem.n_edges
    estimate = fmsync.solve(problem, method, group="O")
    np.testing.assert_allclose(np.linalg.det(estimate.absolute), np.linalg.det(absolute), atol=1e-9)
    error = np.linalg.norm(estimate.relative() - fmsync.problem.relative_maps(absolute, problem.edges), axis=(1, 2))
    assert error.max() < 1.5 if method == "spanning-tree" else error.max() < 0.6


def test_rotations_cannot_fit_them_and_the_certificate_says_so(reversing):
    problem, _ = reversing
    orthogonal, rotations = fmsync.solve(problem, group="O"), fmsync.solve(problem, group="SO")
    assert rotations.cost > 5 * orthogonal.cost
    assert fmsync.certify(problem, orthogonal).certified
    found = fmsync.certify(problem, rotations)
    assert not found.certified
    assert rotations.cost - orthogonal.cost <= found.gap_bound


def test_orthogonal_maps_start_anywhere_and_keep_their_gauge(reversing):
    problem, absolute = reversing
    start = so.project(absolute)  # wrong determinants are not repaired: steps are continuous
    assert (np.linalg.det(fmsync.solve(problem, group="O", init=start).absolute) > 0).all()
    fresh = fmsync.solve(problem, group="O", init="random", rng=1)
    assert (np.linalg.det(fresh.absolute) < 0).any()
    np.testing.assert_array_equal(fresh.absolute[0], np.eye(6))
    with pytest.raises(ValueError, match=r"group: 'SO' or 'O'"):
        fmsync.solve(problem, group="U")
