"""Geodesic least squares: its derivatives, its optimum, and what it does at the cut locus."""

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import so
from fmsync.energy import geodesic_energy
from fmsync.estimators.mle_geodesic import _evaluate


def test_the_gradient_has_the_right_slope(planted):
    problem, _ = planted(n_nodes=6, n=5, sigma2=0.1, two_way=True)
    problem = fmsync.SyncProblem(6, problem.edges, problem.maps, np.linspace(0.5, 2, problem.n_edges))
    c = fmsync.solve(problem, "spectral").absolute
    cost, gradient = _evaluate(problem, problem.maps, c)
    np.testing.assert_allclose(cost, geodesic_energy(problem, c), rtol=1e-10)
    rng = np.random.default_rng(0)
    for _ in range(3):
        direction = so.skew(rng.standard_normal(c.shape))
        ahead, behind = (geodesic_energy(problem, so.exp(s * 1e-5 * direction) @ c) for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / 2e-5, np.vdot(gradient, direction), rtol=1e-6)


def test_the_optimum_is_stationary_for_the_stated_cost(planted):
    problem, _ = planted(sigma2=0.1)
    estimate = fmsync.solve(problem, "mle-geodesic", tolerance=1e-8)
    np.testing.assert_allclose(estimate.cost, geodesic_energy(problem, estimate.absolute), rtol=1e-10)
    _, gradient = fmsync.energy.geodesic_energy_and_gradient(problem, estimate.absolute)
    assert np.linalg.norm(gradient) < 1e-7
    assert estimate.cost < geodesic_energy(problem, fmsync.solve(problem, "mle").absolute)


def test_two_nodes_end_at_the_frechet_mean_of_their_observations():
    rng = np.random.default_rng(0)
    maps = so.exp(0.3 * so.skew(rng.standard_normal((9, 4, 4)))) @ so.random_uniform(4, rng=1)
    problem = fmsync.SyncProblem(2, [[0, 1]] * 9, maps)
    estimate = fmsync.solve(problem, "mle-geodesic", tolerance=1e-9)
    np.testing.assert_allclose(estimate.absolute[1], so.frechet_mean(maps), atol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_strong_noise_and_random_starts_converge_downhill(planted, seed):
    problem, _ = planted(n_nodes=6, n=10, sigma2=1.0, rng=seed)
    estimate = fmsync.solve(problem, "mle-geodesic", init="random", rng=seed)
    assert estimate.converged
    assert (np.diff(estimate.trace.cost) < 1e-9).all()


@pytest.mark.parametrize("offset", [0.0, 1e-9, -1e-9])
def test_a_start_on_the_cut_locus_is_left(offset):
    """Half a turn away from the only observation every direction of the plane is downhill; above four that differ
    there is a local minimum, as on the circle, and it must be a smooth one.
    """
    generator = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])
    start = np.stack([np.eye(3), so.exp((np.pi + offset) * generator)])
    alone = fmsync.solve(fmsync.SyncProblem(2, [[0, 1]], np.eye(3)[None]), "mle-geodesic", init=start)
    np.testing.assert_allclose(alone.absolute[1], np.eye(3), atol=1e-6)

    angles = np.array([-0.2, -0.1, 0.05, 0.3])
    problem = fmsync.SyncProblem(2, [[0, 1]] * 4, so.exp(angles[:, None, None] * generator))
    estimate = fmsync.solve(problem, "mle-geodesic", init=start)
    assert estimate.converged
    rng = np.random.default_rng(0)
    for _ in range(10):
        near = estimate.absolute @ so.exp(1e-3 * so.skew(rng.standard_normal((2, 3, 3))))
        assert geodesic_energy(problem, near) > estimate.cost - 1e-12


def test_the_gauge_of_the_start_does_not_matter(planted):
    problem, truth = planted(sigma2=0.05)
    turned = so.random_uniform(problem.n, rng=9) @ truth.absolute
    a, b = (fmsync.solve(problem, "mle-geodesic", init=c) for c in (truth.absolute, turned))
    np.testing.assert_allclose(a.absolute, b.absolute, atol=1e-6)


def test_sparse_graphs_take_the_same_road():
    graph = data_gen.random_graph(60, 0.1, rng=0)
    problem = data_gen.perturb(data_gen.planted(60, 4, graph, rng=0), 0.02, rng=1)
    assert fmsync.solve(problem, "mle-geodesic").converged
