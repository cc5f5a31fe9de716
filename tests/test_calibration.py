"""Simulation-based calibration on SO(3), and coverage: exact samplers pass, and what is wrong is seen to fail."""

import functools

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import calibration
from fmsync.energy import energy as euclidean_energy
from fmsync.samplers.concentration import interpolated_log_normaliser, normaliser_table

pytestmark = pytest.mark.filterwarnings("ignore::fmsync.diagnostics.ConvergenceWarning")
N_NODES, KAPPA, N_DRAWS = 5, 4.0, 29
EDGES = np.array([(i, j) for i in range(N_NODES) for j in range(i + 1, N_NODES)])


def log_likelihood(p, energy, kappa):
    """Of the Langevin noise, from the energy: κ T - E log c_3(κ)."""
    normaliser = np.vectorize(lambda k: interpolated_log_normaliser(k, normaliser_table(3)))(kappa)
    return kappa * (p.constant - energy) / 2 - p.n_edges * normaliser


@functools.cache
def planted_problem(seed, level, projected):
    """Truth, noise level and observations, shared by the samplers; a ``level`` of None is the fixed κ."""
    rng = np.random.default_rng([seed, 7])
    kappa = KAPPA if level is None else level(rng)
    truth = data_gen.planted(N_NODES, 3, rng=rng)
    noise = {"sigma2": 1 / kappa} if projected else {"noise": "langevin", "kappa": kappa}
    return truth, kappa, data_gen.perturb(truth, rng=rng, **noise)


def ranks_of(method, n_problems, level=None, factor=1.0, **options):
    """Ranks (P, 2) of the log-likelihood and of the noise level; ``level`` draws the true one, None fixes κ."""
    found = []
    projected = options.get("likelihood") == "projected-gaussian"
    for seed in range(n_problems):
        truth, kappa, p = planted_problem(seed, level, projected)
        given = {"kappa": factor * KAPPA} if level is None else {}
        post = fmsync.sample(p, method, n_chains=1, n_draws=N_DRAWS, rng=seed, init=truth.absolute, **given, **options)
        energy = euclidean_energy(p, truth.absolute)
        if projected:
            found.append((calibration.rank(post.energy[0], energy), calibration.rank(post.kappa[0], kappa)))
        else:
            draws = log_likelihood(p, post.energy[0], post.kappa[0])
            found.append(
                (calibration.rank(draws, log_likelihood(p, energy, kappa)), calibration.rank(post.kappa[0], kappa))
            )
    return np.array(found)


def check(n_problems, *setting, **options):
    ranks = ranks_of(*setting[:1], n_problems, *setting[1:], **options)
    return [calibration.uniformity(column, N_DRAWS) for column in ranks.T]


EXACT = {
    "heat-bath": ("heat-bath", {"warmup": 10, "thin": 2}),
    "hmc": ("hmc", {"warmup": 15, "thin": 2, "step": 0.15, "length": 0.3}),
    "mala": ("mala", {"warmup": 20, "thin": 5, "step": 0.2}),
    "tempered": ("tempered", {"warmup": 10, "thin": 2, "n_temperatures": 3, "hottest": 0.3}),
}


@pytest.mark.parametrize("name", EXACT)
def test_exact_samplers_are_calibrated(name):
    method, options = EXACT[name]
    assert check(60 if name in ("hmc", "mala") else 150, method, **options)[0] > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", EXACT)
def test_exact_samplers_are_calibrated_in_full(name):
    method, options = EXACT[name]
    options = options | {"thin": 2 * options["thin"]}  # so many ranks see whether draws depend on each other
    assert check(1500, method, **options)[0] > 1e-3


def uniform_kappa(rng):
    return rng.uniform(0, 1e5)


def log_uniform_precision(rng):
    return np.exp(-rng.uniform(np.log(1e-5), np.log(10.0)))


LEVELS = {
    "langevin": (uniform_kappa, {"warmup": 110, "thin": 5}),
    "projected-gaussian": (log_uniform_precision, {"warmup": 110, "thin": 8, "likelihood": "projected-gaussian"}),
}


@pytest.mark.parametrize("name", LEVELS)
def test_inferred_concentrations_are_calibrated(name):
    """Truths drawn from the documented priors of the noise level; its rank is looked at as well."""
    level, options = LEVELS[name]
    assert min(check(120, "heat-bath", level, **options)) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", LEVELS)
def test_inferred_concentrations_are_calibrated_in_full(name):
    level, options = LEVELS[name]
    options = options | {"thin": 2 * options["thin"]}  # so many ranks see whether draws depend on each other
    assert min(check(1500, "heat-bath", level, **options)) > 1e-3


def test_a_coarse_unadjusted_chain_fails():
    assert check(80, "rlfm", warmup=20, thin=4, step=0.12)[0] < 1e-4


@pytest.mark.parametrize("factor", [0.6, 1.6])
def test_a_wrong_temperature_fails(factor):
    assert check(100, "heat-bath", factor=factor, warmup=10, thin=2)[0] < 1e-4


def ball_levels(n_problems, noise, **options):
    """(P, M) levels of the truths of all pairs of six shapes with four basis functions."""
    rows = []
    for seed in range(n_problems):
        truth = data_gen.planted(6, 4, rng=[seed, 1])
        p = data_gen.perturb(truth, rng=[seed, 2], **noise)
        post = fmsync.sample(p, "heat-bath", n_chains=2, n_draws=200, warmup=120, rng=seed, **options)
        draws = post.relative().reshape(-1, p.n_edges, 4, 4)
        rows.append([calibration.ball_level(draws[:, e], c) for e, c in enumerate(truth.maps)])
    return np.array(rows)


def coverage(levels, nominal):
    """Shares covered (L,) at levels (P, M) of M maps of P problems, and standard errors over problems."""
    inside = (levels <= np.asarray(nominal)[:, None, None]).mean(axis=2)
    return inside.mean(axis=1), inside.std(axis=1, ddof=1) / np.sqrt(len(levels))


@pytest.mark.parametrize(
    ("noise", "options"),
    [
        ({"noise": "langevin", "kappa": 8.0}, {}),
        ({"sigma2": 0.1}, {"likelihood": "projected-gaussian"}),
    ],
)
def test_balls_cover_what_they_promise(noise, options):
    nominal = np.array([0.5, 0.8, 0.9, 0.95])
    shares, errors = coverage(ball_levels(40, noise, **options), nominal)
    assert (np.abs(shares - nominal) < np.maximum(3.5 * errors, 0.02)).all()
    assert errors.max() < 0.06


def test_balls_of_the_papers_temperature_cover_too_much():
    shares, errors = coverage(ball_levels(15, {"noise": "langevin", "kappa": 8.0}, beta=1.0), np.array([0.5, 0.8]))
    assert (shares - [0.5, 0.8] > 5 * errors).all()


def test_ranks_and_levels_by_hand():
    draws = np.array([[1.0, 5.0], [2.0, 6.0], [3.0, 7.0]])
    np.testing.assert_allclose(calibration.rank(draws, np.array([2.5, 4.0])), [2 / 3, 0])


def test_exact_draws_of_a_law_are_covered_by_their_own_balls():
    rng = np.random.default_rng(0)
    laws = data_gen.langevin.langevin_noise(4, 6.0, 300 * 201, rng).reshape(300, 201, 4, 4)
    levels = [calibration.ball_level(law[1:], law[0]) for law in laws]
    shares, errors = coverage(np.array(levels)[:, None], [0.2, 0.5, 0.9])
    assert (np.abs(shares - [0.2, 0.5, 0.9]) < 4 * errors).all()


def test_scores_prefer_the_law_that_the_truth_came_from():
    rng = np.random.default_rng(1)
    truths = data_gen.langevin.langevin_noise(4, 6.0, 120, rng)
    posteriors = [data_gen.langevin.langevin_noise(4, kappa, 400, rng) for kappa in (6.0, 20.0, 1.5)]
    right, cold, hot = (np.array([calibration.energy_score(draws, c) for c in truths]) for draws in posteriors)
    for wrong in (cold, hot):
        gap = wrong - right
        assert gap.mean() > 4 * gap.std() / np.sqrt(len(gap))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: calibration.rank(np.empty(0), 1.0), "draws"),
        (lambda: calibration.uniformity(np.zeros(20), 9), "ranks"),
        (lambda: calibration.ball_level(np.zeros((5, 2, 2)), np.eye(3)), "draws"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_energy_score_by_hand():
    draws = np.zeros((3, 1, 2, 2))
    draws[:, 0, 0, 0] = [0.0, 1.0, 3.0]
    truth = np.zeros((1, 2, 2))
    truth[0, 0, 0] = 1.0
    # distances to the truth 1, 0, 2: mean 1; between draws 1, 3, 2: mean 2
    assert calibration.energy_score(draws, truth) == pytest.approx(1.0 - 2.0 / 2)


def test_energy_score_against_its_slow_twin():
    rng = np.random.default_rng(0)
    draws, truth = rng.standard_normal((7, 3, 2, 2)), rng.standard_normal((3, 2, 2))
    slow = 0.0
    for pair in range(3):
        near = np.mean([np.linalg.norm(x - truth[pair]) for x in draws[:, pair]])
        apart = [np.linalg.norm(draws[a, pair] - draws[b, pair]) for a in range(7) for b in range(7) if a != b]
        slow += (near - np.mean(apart) / 2) / 3
    assert calibration.energy_score(draws, truth) == pytest.approx(slow)


def test_energy_score_prefers_the_right_width():
    rng = np.random.default_rng(1)
    truth = rng.standard_normal((400, 2, 2))
    scores = [
        calibration.energy_score(width * rng.standard_normal((100, 400, 2, 2)), truth) for width in (0.3, 1.0, 3.0)
    ]
    assert scores[1] < min(scores[0], scores[2]) - 0.02


def test_coverage_by_hand():
    draws = np.zeros((8, 1, 2, 2))
    draws[1::2, 0, 0, 0] = [1.0, 2.0, 3.0, 4.0]  # even draws put the centre at 0, odd ones the radii at 1..4
    for distance, inside in ((2.4, [True, True]), (3.0, [False, True]), (4.0, [False, False])):
        truth = np.zeros((1, 2, 2))
        truth[0, 0, 0] = distance
        np.testing.assert_array_equal(calibration.covered(draws, truth, (0.5, 0.8))[:, 0], inside)


def test_coverage_of_exact_draws_is_what_was_promised():
    rng, levels = np.random.default_rng(2), (0.5, 0.8, 0.9, 0.95)
    draws, truth = rng.standard_normal((2000, 1000, 3, 3)), rng.standard_normal((1000, 3, 3))
    shares = calibration.covered(draws, truth, levels).mean(axis=1)
    np.testing.assert_allclose(shares, levels, atol=0.045)  # three standard errors at one half


def test_calibration_error_by_hand():
    assert calibration.calibration_error([0.4, 1.0], (0.5, 0.8)) == pytest.approx(0.15)


def test_too_few_draws_are_refused():
    with pytest.raises(ValueError, match="draws: need at least two"):
        calibration.energy_score(np.zeros((1, 1, 2, 2)), np.zeros((1, 2, 2)))
    with pytest.raises(ValueError, match="four"):
        calibration.covered(np.zeros((3, 1, 2, 2)), np.zeros((1, 2, 2)), [0.5])
