"""The mixture with outliers: against enumeration and quadrature, and calibrated over planted problems."""

import itertools

import numpy as np
import pytest
from scipy.special import betaln, i0

import data_gen
import fmsync
from fmsync import calibration, so
from fmsync.samplers.inliers import jump
from fmsync.samplers.random_streams import generators, uniform
from tests.samplers.helpers import mean_and_error, noisy

pytestmark = pytest.mark.filterwarnings("ignore::fmsync.diagnostics.ConvergenceWarning")
TRIANGLE = [[0, 1], [1, 2], [0, 2]]


def exact_triangle(angles, kappa):
    """Inlier probabilities (3,) and mean energy of three observed angles on SO(2): p is integrated, z enumerated."""
    grid = 2 * np.pi * np.arange(400) / 400
    first, second = np.meshgrid(grid, grid)
    traces = 2 * np.cos(np.stack([first, second, first + second]) - angles[:, None, None])
    total, inlier, energy = 0.0, np.zeros(3), 0.0
    for z in itertools.product((0, 1), repeat=3):
        z = np.array(z)
        density = np.exp(np.tensordot(z, kappa * traces - np.log(i0(2 * kappa)), 1) + betaln(1 + z.sum(), 4 - z.sum()))
        total, inlier = total + density.mean(), inlier + z * density.mean()
        energy += (density * (12 - 2 * traces.sum(axis=0))).mean()
    return inlier / total, energy / total


@pytest.mark.parametrize("method", ["heat-bath", "tempered"])
def test_triangle_of_so2_against_enumeration(method):
    angles, kappa = np.array([0.3, 0.5, 2.4]), 2.0
    c, s = np.cos(angles), np.sin(angles)
    p = fmsync.SyncProblem(3, TRIANGLE, np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2))
    options = {"likelihood": "mixture", "kappa": kappa, "warmup": 20, "n_draws": 250, "init": "random"}
    more = {"n_temperatures": 3, "hottest": 0.2} if method == "tempered" else {}
    posts = [fmsync.sample(p, method, rng=seed, n_chains=2, thin=2, **options, **more) for seed in range(12)]
    inlier, energy = exact_triangle(angles, kappa)
    for k in range(3):
        mean, error = mean_and_error(np.array([[post.edge_weights[k]] for post in posts]))
        assert abs(mean - inlier[k]) < 5 * error
        assert error < 0.02
    mean, error = mean_and_error(np.concatenate([post.energy for post in posts]))
    assert abs(mean - energy) < 5 * error


def jumped(c, p, field, exponent, prior, state):
    """The slow twin of ``jump`` for one chain c (N, n, n): what the maps of a node say, a proposal, a verdict."""
    log_density = lambda value: np.logaddexp(0, prior + exponent[0] * value - exponent[1])  # noqa: E731
    for i in range(p.n_nodes):
        said = [c[a] @ m for (a, b), m in zip(p.edges, p.maps) if b == i]
        said += [c[b] @ m.T for (a, b), m in zip(p.edges, p.maps) if a == i]
        if len(said) < 2:
            continue
        a = int(len(said) * uniform(state))
        b = (a + 1 + int((len(said) - 1) * uniform(state))) % len(said)
        moved = said[b] @ said[a].T @ c[i]
        gain = sum(log_density(np.trace(m.T @ moved)) - log_density(np.trace(m.T @ c[i])) for m in said)
        gain += np.trace(field[i] @ (moved - c[i])) if len(field) else 0
        c[i] = moved if np.log(uniform(state)) < gain else c[i]
    return c


def test_a_jump_against_its_twin():
    rng = np.random.default_rng(3)
    edges = np.array([[0, 1], [2, 0], [1, 2], [3, 1], [2, 3], [4, 0], [5, 4]])  # node 5 has one neighbour
    p = fmsync.SyncProblem(6, edges, so.random_uniform(4, len(edges), rng))
    for field in (np.empty((0, 4, 4)), rng.standard_normal((6, 4, 4))):
        c, exponent, prior = so.random_uniform(4, (3, 6), rng), rng.uniform(0, 2, (3, 2)), rng.standard_normal(3)
        states = generators(rng, 3)
        twin = [jumped(*one) for one in zip(c.copy(), [p] * 3, [field] * 3, exponent, prior, states.copy())]
        x = np.ascontiguousarray(so.transpose(c))
        jump(x, p.maps, p.incidence, field, exponent, prior, states)
        np.testing.assert_allclose(so.transpose(x), twin, atol=1e-12)
        assert (np.abs(x - so.transpose(c)).max(axis=(2, 3)) > 1e-3).sum() > 5  # some maps jumped


def replaced(seed, n_nodes, inlier_probability, kappa):
    """A planted problem on SO(3) and which of its observations are sound."""
    rng = np.random.default_rng([seed, 5])
    p = data_gen.perturb(data_gen.planted(n_nodes, 3, rng=rng), noise="langevin", kappa=kappa, rng=rng)
    sound = rng.random(p.n_edges) < inlier_probability(rng)
    maps = np.where(sound[:, None, None], p.maps, so.random_uniform(3, p.n_edges, rng))
    return fmsync.SyncProblem(n_nodes, p.edges, maps), sound


def calibrated(weights, sound):
    """Standard errors between promised and found: in three bins of the probability, and the Brier score."""
    parts = [(sound - weights) * ((weights >= a) & (weights < b)) for a, b in ((0, 0.1), (0.1, 0.9), (0.9, 1.01))]
    means = [part.mean(axis=1) for part in (*parts, (sound - weights) ** 2 - weights * (1 - weights))]
    return [mean.mean() / (mean.std(ddof=1) / np.sqrt(len(mean))) for mean in means]


def inlier_probabilities(n_problems):
    """Probabilities and indicators (P, E), p drawn from its prior."""
    found = []
    for seed in range(n_problems):
        p, sound = replaced(seed, 5, np.random.Generator.random, 8.0)
        options = {"likelihood": "mixture", "kappa": 8.0, "n_chains": 2, "n_draws": 150, "warmup": 110}
        found.append((fmsync.sample(p, "heat-bath", init="random", rng=seed, **options).edge_weights, sound))
    return np.array(found).transpose(1, 0, 2)


def test_inlier_probabilities_are_calibrated():
    assert np.abs(calibrated(*inlier_probabilities(50))).max() < 4.5


@pytest.mark.slow
def test_inlier_probabilities_are_calibrated_in_full():
    weights, sound = inlier_probabilities(1200)
    assert np.abs(calibrated(weights, sound)).max() < 4.5
    assert np.abs(calibrated(weights**2, sound)).max() > 10  # wrong ones are seen


def at_thirty_percent(n_problems):
    """Levels (P, E) of the balls that just hold the truth, N = 8 and n = 3, and whether the sampler and others err."""
    levels, wrong = [], {"sampler": [], "robust": []}
    for seed in range(n_problems):
        truth = data_gen.planted(8, 3, rng=seed)
        p = data_gen.perturb(truth, noise="langevin", kappa=12.0, rng=seed + 5000, outliers=0.3)
        options = {"n_chains": 2, "n_draws": 200, "warmup": 200, "thin": 2, "rng": seed}
        post = fmsync.sample(p, "heat-bath", likelihood="mixture", kappa=12.0, **options)
        draws = post.relative().reshape(-1, p.n_edges, 3, 3)
        levels.append([calibration.ball_level(draws[:, e], truth.maps[e]) for e in range(p.n_edges)])
        sound = ~np.isin(np.arange(p.n_edges), p.provenance["outlier_edges"])
        for name, weights in (("sampler", post.edge_weights), ("robust", fmsync.solve(p, "robust").edge_weights)):
            wrong[name].append(((weights > 0.5) != sound).mean())
    return np.array(levels), {name: np.mean(shares) for name, shares in wrong.items()}


@pytest.mark.slow
def test_coverage_with_thirty_percent_of_outliers():
    levels, wrong = at_thirty_percent(400)
    for level in (0.5, 0.8, 0.9, 0.95):
        covered = (levels <= level).mean(axis=1)
        assert abs(covered.mean() - level) < max(0.02, 4.5 * covered.std() / np.sqrt(len(covered)))
    assert wrong["sampler"] < wrong["robust"] < 0.05


def test_concentration_is_that_of_the_inliers():
    truth = data_gen.planted(8, 6, rng=0)
    p = data_gen.perturb(truth, noise="langevin", kappa=12.0, rng=1, outliers=0.3)
    post = fmsync.sample(p, "heat-bath", likelihood="mixture", n_draws=400, warmup=200, init="dispersed", rng=0)
    assert post.settings["kappa_inferred"]
    assert abs(post.kappa.mean() - 12) < 4.5 * post.kappa.std() < 7
    sound = ~np.isin(np.arange(p.n_edges), p.provenance["outlier_edges"])
    assert post.edge_weights[sound].min() > 0.5 > post.edge_weights[~sound].max()
    assert fmsync.sample(p, "heat-bath", n_draws=2, warmup=2).edge_weights is None


def test_what_the_mixture_does_not_take():
    p = noisy()
    stretched = fmsync.SyncProblem(p.n_nodes, p.edges, 1.1 * p.maps)
    weighted = fmsync.SyncProblem(p.n_nodes, p.edges, p.maps, np.full(p.n_edges, 2.0))
    for problem, method, message in (
        (stretched, "heat-bath", "0 is not a rotation"),
        (weighted, "heat-bath", "needs weights 1"),
        (p, "hmc", "takes 'langevin' alone"),
    ):
        with pytest.raises(ValueError, match=message):
            fmsync.sample(problem, method, likelihood="mixture", kappa=4.0)
