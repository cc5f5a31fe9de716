"""Resistances against the pseudo-inverse, floors against closed forms, moments against other samples."""

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import bounds, so


def resistance_by_pseudo_inverse(n_nodes, edges, weights, pairs):
    laplacian = np.zeros((n_nodes, n_nodes))
    for (i, j), weight in zip(edges, weights):
        laplacian[i, i] += weight
        laplacian[j, j] += weight
        laplacian[i, j] -= weight
        laplacian[j, i] -= weight
    inverse = np.linalg.pinv(laplacian)
    return np.array([inverse[i, i] + inverse[j, j] - 2 * inverse[i, j] for i, j in pairs])


def test_resistance_equals_the_pseudo_inverse_on_a_weighted_multigraph():
    rng = np.random.default_rng(0)
    edges = data_gen.graph_edges(data_gen.random_graph(12, 0.4, rng=1))
    edges = np.concatenate([edges, edges[:5, ::-1], edges[:3]])  # reversed and repeated pairs
    weights = rng.uniform(0.2, 3, len(edges))
    pairs = np.array([[0, 11], [3, 7], [11, 0], [5, 5]])
    expected = resistance_by_pseudo_inverse(12, edges, weights, pairs)
    np.testing.assert_allclose(bounds.effective_resistance(12, edges, pairs, weights), expected, atol=1e-12)
    at_edges = resistance_by_pseudo_inverse(12, edges, np.ones(len(edges)), edges)
    np.testing.assert_allclose(bounds.effective_resistance(12, edges), at_edges, atol=1e-12)


def test_resistances_known_in_closed_form():
    complete = np.array(nx.complete_graph(9).edges)
    np.testing.assert_allclose(bounds.effective_resistance(9, complete), 2 / 9)
    path = np.array(nx.path_graph(6).edges)
    np.testing.assert_allclose(bounds.effective_resistance(6, path, np.array([[0, 5]])), 5)
    sparse = data_gen.graph_edges(data_gen.random_graph(300, 0.02, rng=0))
    np.testing.assert_allclose(bounds.effective_resistance(300, sparse).sum(), 299)  # Foster: N - 1 for any graph


def test_the_floor_is_cramer_rao_on_a_tree():
    """On one edge the estimate is the observation, whose rotation noise is σ times d independent normals."""
    sigma2, n = 1e-4, 6
    noise = so.project(np.eye(n) + np.sqrt(sigma2) * np.random.default_rng(0).standard_normal((20000, n, n)))
    squared = ((noise - np.eye(n)) ** 2).sum((1, 2)).mean()
    np.testing.assert_allclose(fmsync.relative_error_bound(2, [[0, 1]], n, sigma2), squared, rtol=0.01)


def test_the_langevin_floor_is_met_on_one_edge():
    """Large κ: the tangent coordinates of the noise are nearly normal with variance 1/κ each."""
    n, kappa = 6, 1e3
    np.testing.assert_allclose(bounds.langevin_error_bound(2, [[0, 1]], n, kappa), 15 / kappa, rtol=0.01)
    with pytest.raises(ValueError, match="kappa: must be finite and > 0, got 0"):
        bounds.langevin_error_bound(2, [[0, 1]], n, 0)


def test_the_langevin_information_is_the_variance_of_the_score():
    """Importance weights turn Haar samples into Langevin noise; the score of κ tr(Zᵀ e^Ω) is κ skew(Z)."""
    n, kappa = 3, 2.0
    haar = so.random_uniform(n, 200_000, rng=1)
    weight = np.exp(kappa * np.trace(haar, axis1=1, axis2=2))
    score_squared = kappa**2 * (weight * (so.skew(haar) ** 2).sum((1, 2))).sum() / weight.sum()
    d = n * (n - 1) / 2
    floor = bounds.langevin_error_bound(2, [[0, 1]], n, kappa)[0]
    np.testing.assert_allclose(d**2 / score_squared, floor, rtol=0.01)


def test_the_expected_line_reaches_the_floor_as_the_noise_vanishes():
    edges = np.array(nx.complete_graph(5).edges)
    floor = np.sqrt(fmsync.relative_error_bound(5, edges, 8, 1e-5))
    np.testing.assert_allclose(fmsync.expected_rms_error(5, edges, 8, 1e-5), floor, rtol=0.01)
    assert (fmsync.expected_rms_error(5, edges, 8, 0.3) > np.sqrt(fmsync.relative_error_bound(5, edges, 8, 0.3))).all()
    np.testing.assert_array_equal(fmsync.expected_rms_error(5, edges, 8, 0.0), 0)


def test_moments_agree_with_an_independent_sample():
    noise = so.project(np.eye(10) + np.sqrt(0.2) * np.random.default_rng(7).standard_normal((4000, 10, 10)))
    trace, skew_squared = bounds.projected_noise_moments(10, 0.2)
    np.testing.assert_allclose(trace, np.trace(noise, axis1=1, axis2=2).mean(), rtol=0.01)
    np.testing.assert_allclose(skew_squared, (so.skew(noise) ** 2).sum((1, 2)).mean(), rtol=0.01)


def test_recovery_threshold():
    """At n = 20: about .41 with one observation a pair, about .8 with two."""
    assert abs(bounds.recovery_threshold(11, 20) - 0.41) < 0.03
    assert abs(bounds.recovery_threshold(11, 20, observations_per_pair=2) - 0.8) < 0.08
    # fewer edges, less noise: the threshold depends on the density
    assert abs(bounds.recovery_threshold(11, 20, density=5 / 6) - 0.34) < 0.02
    assert abs(bounds.recovery_threshold(11, 20, density=2 / 3) - 0.28) < 0.02


def test_the_bound_of_small_errors_holds_where_it_says_so_and_is_crossed_elsewhere():
    """On a path the estimate is the product of the observations: the mean squared error is 2n(1 - c^L) exactly."""
    n, sigma2, edges = 15, 0.02, np.array([(i, i + 1) for i in range(6)])
    noise = so.project(np.eye(n) + np.sqrt(sigma2) * np.random.default_rng(0).standard_normal((5000, 6, n, n)))
    cosine = bounds.projected_noise_moments(n, sigma2)[0] / n
    error = np.eye(n)
    for length in range(1, 7):
        error = error @ noise[:, length - 1]
        squared = ((error - np.eye(n)) ** 2).sum((1, 2))
        bound = fmsync.relative_error_bound(7, edges, n, sigma2, np.array([[0, length]]))
        assert abs(squared.mean() - 2 * n * (1 - cosine**length)) < 4 * squared.std() / np.sqrt(len(squared)) + 1e-2
        if bounds.is_small_error(n, bound)[0]:
            assert squared.mean() > 0.95 * bound[0]
    assert squared.mean() < 0.9 * bound[0]  # the ends: crossed, and not claimed
    assert not bounds.is_small_error(n, bound)[0]


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="sigma2: must be finite and >= 0, got -1"):
        fmsync.relative_error_bound(2, [[0, 1]], 3, -1)
    with pytest.raises(ValueError, match="sigma2: must be finite and >= 0, got nan"):
        fmsync.expected_rms_error(2, [[0, 1]], 3, np.nan)
    with pytest.raises(ValueError, match=r"falls into 2 components \(0, 1; 2, 3\)"):
        bounds.effective_resistance(4, [[0, 1], [2, 3]])
    for pairs in ([[0, 3]], [[-1, 0]]):
        with pytest.raises(ValueError, match=r"pairs\[.\] = -?[13] is outside the nodes 0..2"):
            bounds.effective_resistance(3, [[0, 1], [1, 2]], pairs)
