"""The projected Gaussian likelihood: each conditional step against quadrature, the whole against its data."""

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import so
from fmsync.samplers import plane_rotations, polar_factor, random_streams
from tests.samplers.helpers import mean_and_error


def generator(seed=0):
    return random_streams.generators(np.random.default_rng(seed), 1)[0]


@pytest.mark.parametrize(("sigma2", "angle"), [(0.05, 0.3), (0.8, 1.2), (0.8, 3.0)])
def test_polar_factors_of_one_edge_against_quadrature(sigma2, angle):
    """n = 2: the density (p11 + p22) exp(-||P - A||²/2σ²) where p11 + p22 > 0, on a grid of three numbers."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x = np.stack([np.eye(2), turn.T])[None]
    observed = so.exp(np.array([[[0.0, -0.2], [0.2, 0.0]]]))
    centre = so.sym(observed[0].T @ turn)

    t = np.linspace(-6, 6, 161) * np.sqrt(sigma2)
    a, b, c = np.meshgrid(centre[0, 0] + t, centre[1, 1] + t, centre[0, 1] + t, indexing="ij")
    distance = (a - centre[0, 0]) ** 2 + (b - centre[1, 1]) ** 2 + 2 * (c - centre[0, 1]) ** 2
    weight = np.maximum(a + b, 0) * np.exp(-distance / (2 * sigma2))
    weight /= weight.sum()

    count, repeats = 500, 40
    factors, read, states = np.empty((repeats, count, 2, 2)), np.empty((repeats, count, 2, 2)), generator()[None]
    unprojected = np.empty((1, 1, 2, 2))
    vectors, eigenvalues = np.eye(2)[None, None].copy(), np.array([[[1.2, 0.7]]])
    for r in range(repeats):
        for t in range(count):
            polar_factor.polar_factor_step(
                x, vectors, eigenvalues, np.array([sigma2]), np.ones(1), unprojected, states, np.array([[0, 1]]),
                observed, plane_rotations.rounds(2), t % 2, False,
            )  # fmt: skip
            factors[r, t] = (vectors[0, 0].T * eigenvalues[0, 0]) @ vectors[0, 0]
            read[r, t] = unprojected[0, 0]
    np.testing.assert_allclose(read, observed[0] @ factors, atol=1e-12)
    diagonal = factors[..., 0, 0], factors[..., 1, 1]
    for values, grid in zip((*diagonal, factors[..., 0, 1], diagonal[0] * diagonal[1]), (a, b, c, a * b)):
        mean, error = mean_and_error(values)
        assert abs(mean - (weight * grid).sum()) < 4.5 * error
        assert error < 0.05 * np.sqrt(sigma2) + 0.01


def test_eigenvalues_of_many_dimensions_stay_in_the_region():
    """Far more factors than a double holds: the density must not overflow."""
    n, state = 150, generator(1)
    values, centre = np.linspace(0.5, 40.0, n), np.full(n, 1.0)
    for k in range(10):
        polar_factor.draw_eigenvalues(values, centre, 9.0, k % 2, state)
    assert np.isfinite(values).all()
    assert np.sort(values)[:2].sum() > 0
    assert np.ptp(values) > 1


@pytest.mark.parametrize(("n", "n_edges", "linear"), [(2, 3, 5.5), (3, 4, 11.0)])
def test_variance_and_scale_against_quadrature(n, n_edges, linear):
    """Fixed shapes P0: s^{E n² - 1} σ^{-E n²} exp(-(s² Q - 2 s L + c)/2σ²) ds d log σ², on a grid."""
    constant, dimension, quadratic = n_edges * n, n_edges * n * n, 1.1 * n_edges * n
    s, level = np.meshgrid(np.exp(np.linspace(-3, 4, 701)), np.exp(np.linspace(np.log(1e-5), np.log(10), 1201)))
    log_weight = dimension * (np.log(s) - np.log(level) / 2)
    log_weight -= (s**2 * quadratic - 2 * s * linear + constant) / (2 * level)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()

    state, scale, sigma2 = generator(2), 1.0, 0.5
    draws = np.empty((40, 500, 2))
    for r in range(40):
        for t in range(500):
            sigma2, factor = polar_factor.draw_sigma2(
                scale**2 * quadratic, scale * linear, constant, dimension, sigma2, state
            )
            scale *= factor
            draws[r, t] = np.log(scale), np.log(sigma2)
            assert polar_factor.LEAST_SIGMA2 <= sigma2 <= polar_factor.LARGEST_SIGMA2
    for k, grid in enumerate((np.log(s), np.log(level))):
        mean, error = mean_and_error(draws[..., k])
        assert abs(mean - (weight * grid).sum()) < 4 * error
        assert error < 0.05


def test_noise_variance_of_the_papers_noise_is_found():
    truth = data_gen.planted(8, 8, rng=0)
    p = data_gen.perturb(truth, 0.1, 1)
    post = fmsync.sample(p, "heat-bath", likelihood="projected-gaussian", n_draws=300, warmup=200, init="dispersed")
    assert abs(np.log(post.sigma2.mean() / 0.1)) < 4 * np.log(post.sigma2).std()
    assert np.log(post.sigma2).std() < 0.2
    np.testing.assert_allclose(post.sigma2 * post.kappa, 1)
    np.testing.assert_allclose(post.energy, fmsync.energy.energy(p, post.absolute))
    assert fmsync.diagnostics.rhat(post.sigma2) < 1.05


def test_scale_moves_keep_the_noise_variance_moving():
    """Autocorrelation time of σ² below ten sweeps at the paper's size; 46 without moving scale and level together."""
    p = data_gen.perturb(data_gen.planted(11, 20, rng=0), 0.1, 1)
    post = fmsync.sample(p, "heat-bath", likelihood="projected-gaussian", n_chains=4, n_draws=300, warmup=150, rng=0)
    assert post.sigma2.size / fmsync.diagnostics.ess(post.sigma2) < 10
