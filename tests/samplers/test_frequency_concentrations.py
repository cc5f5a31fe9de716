"""A concentration for every basis function: its normaliser, draws against quadrature, and recovered where planted."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import i0e

import fmsync
from bench.unequal import unequal
from fmsync import langevin, so
from fmsync.samplers import concentration
from fmsync.samplers.random_streams import generators
from tests.samplers.helpers import mean_and_error

pytestmark = pytest.mark.filterwarnings("ignore::fmsync.diagnostics.ConvergenceWarning")


def log_normaliser(own):
    own = np.asarray(own, dtype=float)
    return concentration.log_normaliser_by_frequency(own, concentration.normaliser_table(len(own)))


def test_normaliser_where_it_is_exact():
    for n, kappa in ((2, 0.3), (3, 7.0), (20, 40.0)):
        assert log_normaliser(np.full(n, kappa)) == pytest.approx(langevin.log_normaliser(n, kappa), rel=1e-7)
    assert log_normaliser([1.0, 4.5]) == pytest.approx(np.log(i0e(5.5)) + 5.5, rel=1e-7)


@pytest.mark.parametrize(
    ("own", "within"),
    [([5.0, 2.0, 1.0], 0.015), ([20.0, 5.0, 2.0], 0.01), ([100.0, 30.0, 5.0], 0.002), ([1000.0, 1.0, 1.0], 0.1)],
)
def test_normaliser_of_so3_against_quadrature(own, within):
    """With a unit quaternion q the trace is linear in the squares of q, whose first two have a uniform sum u."""
    exponents = so.transpose([[1, 1, -1, -1], [1, -1, 1, -1], [1, -1, -1, 1]]) @ own

    def density(u):
        (a, b), (c, d) = u * exponents[:2], (1 - u) * exponents[2:]
        return np.exp(max(a, b) + max(c, d) - exponents.max()) * i0e((a - b) / 2) * i0e((c - d) / 2)

    exact = exponents.max() + np.log(quad(density, 0, 1, points=[0.9, 0.99, 0.999], limit=400)[0])
    assert abs(log_normaliser(own) - exact) < within


@pytest.mark.parametrize(("largest", "within"), [(400.0, 0.03), (100.0, 0.05)])
def test_slope_of_the_normaliser_is_the_mean_of_the_diagonal(largest, within):
    own = np.geomspace(largest, largest / 20, 20)
    one = fmsync.SyncProblem(2, [[0, 1]], np.diag(own)[None])
    post = fmsync.sample(one, "heat-bath", kappa=1.0, n_chains=20, n_draws=300, warmup=60, rng=4)
    steps = 1e-4 * np.diag(own)
    slopes = [(log_normaliser(own + step) - log_normaliser(own - step)) / (2 * step.max()) for step in steps]
    for k, slope in enumerate(slopes):
        mean, error = mean_and_error(1 - post.relative()[:, :, 0, k, k])
        assert abs(mean - (1 - slope)) < 4.5 * error + within * mean
        assert error < 0.05 * mean


def test_a_step_against_quadrature():
    """Three λ whose joint density is summed over a grid, equally spaced in their logarithms."""
    traces, count, n = np.array([5.9, 5.6, 5.2]), 6.0, 3
    grid = np.exp(np.linspace(np.log(0.01), np.log(2000), 60))
    logs = np.array([[[count * log_normaliser([a, b, c]) for c in grid] for b in grid] for a in grid])
    axes = np.meshgrid(grid, grid, grid, indexing="ij")
    density = sum(t * x + np.log(x) for t, x in zip(traces, axes)) - logs
    weight = np.exp(density - density.max())
    wanted = [(weight * np.log(x)).sum() / weight.sum() for x in axes]
    table, states = concentration.normaliser_table(n), generators(np.random.default_rng(1), 24)
    draws = np.empty((24, 1200, n))
    for chain, state in zip(draws, states):
        own = np.full(n, 5.0)
        for draw in chain:
            concentration.draw_by_frequency(own, traces, count, table, state)
            draw[:] = np.log(own)
    for k in range(n):
        mean, error = mean_and_error(draws[:, 100:, k])
        assert abs(mean - wanted[k]) < 5 * error
        assert error < 0.05


@pytest.mark.parametrize("method", ["heat-bath", "tempered"])
def test_triangle_of_so2_against_quadrature(method):
    """Only the sum s of the two λ counts: it has the prior density s, and the normaliser I_0(s)."""
    angles, grid, s = np.array([0.3, 0.5, 2.0]), 2 * np.pi * np.arange(240) / 240, np.geomspace(1e-3, 1e3, 500)
    first, second = np.meshgrid(grid, grid)
    seen = np.cos(np.stack([first, second, first + second]) - angles[:, None, None]).sum(axis=0).ravel()
    exponent = np.multiply.outer(seen, s) + 2 * np.log(s) - 3 * (np.log(i0e(s)) + s)
    weight = np.exp(exponent - exponent.max())
    energy, logarithm = weight.sum(axis=1) @ (12 - 4 * seen), weight.sum(axis=0) @ np.log(s)

    c, sine = np.cos(angles), np.sin(angles)
    p = fmsync.SyncProblem(
        3, [[0, 1], [1, 2], [0, 2]], np.stack([np.stack([c, -sine], -1), np.stack([sine, c], -1)], -2)
    )
    more = {"n_temperatures": 3, "hottest": 0.2} if method == "tempered" else {}
    options = {"likelihood": "by-frequency", "n_chains": 24, "n_draws": 700, "warmup": 150, "init": "random"}
    post = fmsync.sample(p, method, **options, **more)
    assert post.kappas.shape == (24, 700, 2)
    for values, wanted in ((post.energy, energy), (np.log(post.kappas.sum(axis=2)), logarithm)):
        mean, error = mean_and_error(values)
        assert abs(mean - wanted / weight.sum()) < 5 * error
        assert error < 0.1
    np.testing.assert_allclose(post.kappas.mean(axis=2), post.kappa)


def test_planted_concentrations_are_recovered():
    covered = []
    for seed in range(3):
        planted = unequal(seed=seed, n_nodes=9, n=12, low=10.0, high=200.0, by="frequency")
        kappas, errors = np.array(planted.problem.provenance["kappas"]), []
        true = planted.relative(planted.problem.edges)
        for likelihood in ("by-frequency", "langevin"):
            post = fmsync.sample(planted.problem, "heat-bath", likelihood=likelihood, n_draws=300, warmup=200, rng=seed)
            errors.append(np.linalg.norm(post.relative_mean() - true))
            if likelihood == "by-frequency":
                low, high = np.quantile(post.kappas, (0.05, 0.95), axis=(0, 1))
                covered.append(((low < kappas) & (kappas < high)).mean())
                found = np.log(post.kappas.mean(axis=(0, 1)))
                assert np.sqrt(np.mean((found - np.log(kappas)) ** 2)) < 0.3
        assert errors[0] < 0.97 * errors[1]
    assert abs(np.mean(covered) - 0.9) < 4.5 * np.sqrt(0.09 / 36)
