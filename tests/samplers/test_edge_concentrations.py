"""A concentration for every edge: against quadrature, calibrated under its own prior, and recovered where planted."""

import numpy as np
import pytest

import data_gen
import fmsync
from data_gen.langevin import langevin_noise
from fmsync import langevin
from fmsync.samplers import concentration
from fmsync.samplers.random_streams import generators
from tests.samplers.helpers import mean_and_error

pytestmark = pytest.mark.filterwarnings("ignore::fmsync.diagnostics.ConvergenceWarning")
LOG_KAPPA = np.linspace(np.log(1e-5), np.log(concentration.LARGEST_KAPPA), 700)  # of all quadratures
KAPPA = np.minimum(np.exp(LOG_KAPPA), concentration.LARGEST_KAPPA)
N_DRAWS = 60  # among which planted values are ranked


def prior(shape, means):
    """Weights (M, 700) on KAPPA of gamma distributions cut to [0, 1e5]."""
    scaled = KAPPA / means[:, None]
    log_weight = shape * (np.log(scaled) - scaled)
    log_weight[:, -1] -= np.log(2)  # the end of the trapezia
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    return weight / weight.sum(axis=1, keepdims=True)


@pytest.mark.parametrize(("traces", "power"), [((2.9, 1.0), 1.0), ((2.97, 2.6), 0.5), ((2.99999, 2.9999), 1.0)])
def test_a_step_against_quadrature(traces, power):
    """κ of two edges, a and m, under the whole prior; a power of 1/2 is that of a tempered chain."""
    shapes, means = concentration.SHAPES, concentration.MEANS
    exponent = power * (np.multiply.outer(traces, KAPPA) - langevin.log_normaliser(3, KAPPA))
    density = np.exp(exponent - exponent.max(axis=1, keepdims=True))  # (2, 700)
    joint, expected = np.empty((len(shapes), len(means))), np.zeros(4)
    for k, a in enumerate(shapes):
        one, first = prior(a, means) @ density.T, prior(a, means) @ (density[0] * LOG_KAPPA)
        joint[k] = one.prod(axis=1)
        expected[0] += first @ one[:, 1]
    expected[0] /= joint.sum()
    weight = joint / joint.sum()
    expected[1], expected[2] = weight.sum(axis=1) @ np.log(shapes), weight.sum(axis=0) @ np.log(means)
    expected[3] = weight.sum(axis=1) @ np.log(shapes) ** 2

    p = fmsync.SyncProblem(2, [[0, 1], [0, 1]], np.stack([np.eye(3)] * 2))
    target, chains = fmsync.samplers.Target(p, likelihood="by-edge"), 24
    prior_of_all = concentration.EdgeConcentrations(target, 1, np.random.default_rng(0)).prior
    table, states = concentration.normaliser_table(3), generators(np.random.default_rng(1), chains)
    draws = np.empty((4, chains, 900))
    for k in range(chains):
        kappas, level = np.ones(2), np.array([12, 300])
        for t in range(900):
            concentration.draw_by_edge(kappas, level, np.array(traces), power, 3, table, prior_of_all, states[k])
            log_a = np.log(shapes[level[0]])
            draws[:, k, t] = np.log(kappas[0]), log_a, np.log(means[level[1]]), log_a**2
    for values, wanted in zip(draws[:, :, 100:], expected):
        mean, error = mean_and_error(values)
        assert abs(mean - wanted) < 5 * error
        assert error < 0.15


@pytest.fixture
def coarse(monkeypatch):
    """A prior with few values, all of moderate concentrations."""
    monkeypatch.setattr(concentration, "SHAPES", np.array([1.0, 3.0, 10.0]))
    monkeypatch.setattr(concentration, "MEANS", np.geomspace(2, 20, 5))


@pytest.mark.parametrize("method", ["heat-bath", "tempered"])
@pytest.mark.usefixtures("coarse")
def test_triangle_of_so2_against_quadrature(method):
    angles = np.array([0.3, 0.5, 2.0])
    grid = 2 * np.pi * np.arange(300) / 300
    first, second = np.meshgrid(grid, grid)
    traces = 2 * np.cos(np.stack([first, second, first + second]) - angles[:, None, None])
    seen = np.linspace(-2, 2, 2001)
    density = np.exp(np.multiply.outer(seen, KAPPA) - langevin.log_normaliser(2, KAPPA))  # (2001, 700)
    total, energy, logarithm = 0.0, 0.0, 0.0
    for a in concentration.SHAPES:
        for weight in prior(a, concentration.MEANS):
            one, log_one = (np.interp(traces, seen, density @ part) for part in (weight, weight * LOG_KAPPA))
            total += one.prod(axis=0).sum()
            energy += (one.prod(axis=0) * (12 - 2 * traces.sum(axis=0))).sum()
            logarithm += (log_one[2] * one[0] * one[1]).sum()

    c, s = np.cos(angles), np.sin(angles)
    p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2))
    more = {"n_temperatures": 3, "hottest": 0.2} if method == "tempered" else {}
    options = {"likelihood": "by-edge", "n_chains": 24, "n_draws": 700, "warmup": 150, "init": "random"}
    post = fmsync.sample(p, method, **options, **more)
    for values, wanted in ((post.energy, energy), (np.log(post.kappas[:, :, 2]), logarithm)):
        mean, error = mean_and_error(values)
        assert abs(mean - wanted / total) < 5 * error
        assert error < 0.1
    np.testing.assert_allclose(post.kappas.mean(axis=2), post.kappa)


def planted(rng, n_nodes, n, kappas):
    """A truth, and the problem whose edges have concentrations (E,)."""
    truth = data_gen.planted(n_nodes, n, rng=rng)
    noise = np.concatenate([langevin_noise(n, kappa, 1, rng) for kappa in kappas])
    return truth, fmsync.SyncProblem(n_nodes, truth.edges, truth.maps @ noise)


def ranks(n_problems, factor=1.0):
    """Of planted values among draws, in [0, 1]: κ of every edge (P, E), and the log-likelihood (P,).

    The noise has ``factor`` times the concentrations.
    """
    own, likelihood = [], []
    run = {"n_chains": 1, "n_draws": N_DRAWS, "warmup": 150, "thin": 8}
    for seed in range(n_problems):
        rng = np.random.default_rng([seed, 3])
        a, m = rng.choice(concentration.SHAPES), rng.choice(concentration.MEANS)
        kappas = rng.gamma(a, m / a, 10)
        truth, p = planted(rng, 5, 3, factor * kappas)
        post = fmsync.sample(p, "heat-bath", likelihood="by-edge", rng=rng, **run)
        every = np.concatenate([post.kappas[0], kappas[None]])
        relative = np.concatenate([post.relative()[0], truth.maps[None]])
        traces = np.einsum("eab,deab->de", p.maps, relative)
        values = (every * traces - langevin.log_normaliser(3, every)).sum(axis=1)
        own.append((every[:-1] < kappas).mean(axis=0))
        likelihood.append((values[:-1] < values[-1]).mean())
    return np.array(own), np.array(likelihood)


def deviations(own, likelihood):
    """Standard errors between ranks and uniform ones: their means, and their mean squared distances from 1/2."""
    values = own.mean(axis=1), ((own - 0.5) ** 2).mean(axis=1), likelihood, (likelihood - 0.5) ** 2
    wanted = (0.5, (1 + 2 / N_DRAWS) / 12) * 2
    return [(v.mean() - w) / (v.std(ddof=1) / np.sqrt(len(v))) for v, w in zip(values, wanted)]


@pytest.mark.usefixtures("coarse")
def test_ranks_under_the_prior_are_uniform():
    assert np.abs(deviations(*ranks(60))).max() < 4.5


@pytest.mark.slow
@pytest.mark.usefixtures("coarse")
def test_ranks_under_the_prior_are_uniform_in_full():
    assert np.abs(deviations(*ranks(1000))).max() < 4.5
    assert np.abs(deviations(*ranks(1000, factor=1.3))).max() > 6


def test_planted_concentrations_are_recovered():
    covered, errors = [], {"by-edge": [], "langevin": []}
    for seed in range(3):
        rng = np.random.default_rng([seed, 9])
        kappas = np.exp(rng.uniform(np.log(10), np.log(200), 28))
        truth, p = planted(rng, 8, 12, kappas)
        for likelihood, found in errors.items():
            post = fmsync.sample(p, "heat-bath", likelihood=likelihood, n_draws=300, warmup=200, rng=seed)
            found.append(np.linalg.norm(post.relative_mean() - truth.maps))
            if likelihood == "by-edge":
                draws = post.kappas.reshape(-1, p.n_edges)
                low, high = np.quantile(draws, (0.05, 0.95), axis=0)
                covered.append(((low < kappas) & (kappas < high)).mean())
                assert np.corrcoef(np.log(draws.mean(axis=0)), np.log(kappas))[0, 1] > 0.9
    assert abs(np.mean(covered) - 0.9) < 4.5 * np.sqrt(0.09 / (3 * 28))
    assert (np.array(errors["by-edge"]) < 0.95 * np.array(errors["langevin"])).all()
    assert post.kappas is None
