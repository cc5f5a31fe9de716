"""Hamiltonian and Langevin chains with a Metropolis test: integrator, exact laws, agreement of exact samplers."""

import numpy as np
import pytest

import data_gen
import fmsync
from data_gen.langevin import langevin_noise
from fmsync import so
from fmsync.energy import gradient
from fmsync.samplers.base import Target
from fmsync.samplers.hmc import HMC, DualAveraging
from tests.samplers.helpers import ONE_EDGE_OF_SO20, mean_and_error, noisy, one_edge


@pytest.mark.parametrize("integrator", ["cayley", "exp"])
@pytest.mark.parametrize("energy", ["euclidean", "geodesic"])
def test_integrator_is_reversible(integrator, energy):
    p, rng = noisy(6, 5, sigma2=0.02), np.random.default_rng(0)
    start = so.random_uniform(5, (2, 6), rng)
    if energy == "geodesic":
        start = np.stack([fmsync.solve(p, "mle").absolute] * 2)
    engine = HMC(Target(p, kappa=10.0, energy=energy), start, rng, integrator=integrator, step=0.02)
    momentum = so.skew(rng.standard_normal(start.shape))
    end, arrived, (_, _, gradient) = engine.trajectory(start, momentum, engine.evaluate(start)[2], 20)
    assert np.abs(end - start).max() > 0.1
    back, returned, _ = engine.trajectory(end, -arrived, gradient, 20)
    np.testing.assert_allclose(back, start, atol=1e-10)
    np.testing.assert_allclose(returned, -momentum, atol=1e-10)


def test_integrator_keeps_the_energy_to_second_order():
    p, rng = noisy(6, 5, sigma2=0.02), np.random.default_rng(1)
    start, errors = so.random_uniform(5, (3, 6), rng), []
    momentum = so.skew(rng.standard_normal(start.shape))
    for step, count in ((0.02, 10), (0.01, 20), (0.005, 40)):
        engine = HMC(Target(p, kappa=10.0), start, rng, step=step)
        _, before, gradient = engine.evaluate(start)
        _, arrived, (_, after, _) = engine.trajectory(start, momentum, gradient, count)
        errors.append(np.abs(after - before + ((arrived**2).sum((1, 2, 3)) - (momentum**2).sum((1, 2, 3))) / 2))
    np.testing.assert_allclose(errors[0] / errors[1], 4, rtol=0.15)
    np.testing.assert_allclose(errors[1] / errors[2], 4, rtol=0.05)


@pytest.mark.parametrize("energy", ["euclidean", "geodesic"])
def test_gradient_of_the_potential_by_differences(energy):
    p, rng = noisy(4, 4, sigma2=0.02), np.random.default_rng(2)
    c = fmsync.solve(p, "mle").absolute[None]
    prior = fmsync.LangevinPrior(so.random_uniform(4, 4, rng), [3.0, 0.0, 1.0, 2.0])
    engine = HMC(Target(p, prior, kappa=7.0, energy=energy), c, rng)
    direction = so.skew(rng.standard_normal(c.shape))
    slope = (engine.evaluate(c)[2] * direction).sum()
    ends = [engine.evaluate(c @ so.exp(t * direction))[1][0] for t in (1e-5, -1e-5)]
    assert (ends[0] - ends[1]) / 2e-5 == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize(("kappa", "exact"), ONE_EDGE_OF_SO20)
@pytest.mark.parametrize(
    ("method", "options"),
    [("hmc", {}), pytest.param("hmc", {"integrator": "exp"}, marks=pytest.mark.slow), ("mala", {})],
)
def test_one_edge_of_so20(method, options, kappa, exact):
    p = one_edge(20)
    thin = 10 if method == "mala" else 1
    run = {"n_draws": 60, "warmup": 300} if method == "mala" else {"n_draws": 100, "warmup": 150}
    post = fmsync.sample(p, method, kappa=kappa, rng=1, n_chains=16, thin=thin, **run, **options)
    mean, error = mean_and_error((p.constant - post.energy) / 2)
    assert abs(mean - exact) < 4 * error
    assert error < 0.1  # without the Metropolis test the mean is 7 errors and more off at κ >= 10
    assert abs(post.settings["acceptance"] - {"hmc": 0.8, "mala": 0.574}[method]) < 0.1


def test_geodesic_energy_on_the_circle():
    """On SO(2) the angle is normal, cut at π: U = 2θ², p ∝ exp(-2 β θ²)."""
    beta = 0.2
    post = fmsync.sample(
        one_edge(2), "hmc", energy="geodesic", beta=beta, n_chains=64, n_draws=800, warmup=100, init="random", rng=6
    )
    grid = np.linspace(-np.pi, np.pi, 20_001)
    weight = np.exp(-2 * beta * grid**2)
    mean, error = mean_and_error(post.energy / 2)
    assert abs(mean - weight @ grid**2 / weight.sum()) < 4 * error
    assert error < 0.02


@pytest.mark.parametrize("integrator", ["cayley", "exp"])
@pytest.mark.parametrize("method", ["hmc", "mala"])
def test_geodesic_energy_on_rotations_of_space(method, integrator):
    """On SO(3) the angle has density (1 - cos θ) exp(-2 β θ²) on [0, π]; the cut locus is often met."""
    beta, thin = 0.2, 6 if method == "mala" else 1
    post = fmsync.sample(
        one_edge(3), method, energy="geodesic", beta=beta, integrator=integrator, n_chains=64, n_draws=300,
        warmup=150, thin=thin, init="random", rng=7,
    )  # fmt: skip
    angle = np.linspace(0, np.pi, 20_001)
    weight = (1 - np.cos(angle)) * np.exp(-2 * beta * angle**2)
    mean, error = mean_and_error(post.energy / 2)
    assert abs(mean - weight @ angle**2 / weight.sum()) < 4 * error
    assert error < 0.05


def test_exact_samplers_agree_and_meet_the_stein_identity():
    """Energies and an entry of a relative map by three methods; E ||grad log p||² = (n-1) κ E Σ tr by each."""
    p = noisy(5, 4, two_way=True)
    kappa, found = 6.0, {}
    for method, thin in (("heat-bath", 1), ("hmc", 1), ("mala", 8)):
        squares = []

        def record(draw, state, energy, squares=squares):
            squares.append(((kappa / 2 * gradient(p, state)) ** 2).sum((1, 2, 3)))

        post = fmsync.sample(
            p, method, kappa=kappa, n_chains=24, n_draws=250, warmup=200, thin=thin, rng=3, callback=record
        )
        entry = np.einsum("kta,kta->kt", post.absolute[:, :, 0, :, 0], post.absolute[:, :, 1, :, 0])
        found[method] = mean_and_error(post.energy), mean_and_error(entry)
        traces = (p.constant - post.energy) / 2
        difference, error = mean_and_error(np.array(squares).T - (p.n - 1) * kappa * traces)
        assert abs(difference) < 4 * error
        assert error < 0.01 * (p.n - 1) * kappa * traces.mean()
    for method in ("hmc", "mala"):
        for (a, a_error), (b, b_error) in zip(found["heat-bath"], found[method]):
            assert abs(a - b) < 4 * np.hypot(a_error, b_error)
            assert np.hypot(a_error, b_error) < 0.02 * max(abs(a), 1)


def test_unknown_concentration_agrees_with_the_heat_bath():
    p = data_gen.perturb(data_gen.planted(6, 4, rng=0), noise="langevin", kappa=8.0, rng=1)
    options = {"n_chains": 16, "n_draws": 200, "warmup": 250, "rng": 2}
    (a, a_error), (b, b_error) = (
        mean_and_error(np.log(fmsync.sample(p, method, thin=thin, **options).kappa))
        for method, thin in (("heat-bath", 1), ("hmc", 2))
    )
    assert abs(a - b) < 4 * np.hypot(a_error, b_error)
    assert np.hypot(a_error, b_error) < 0.02


def test_prior_is_sampled_with_its_own_concentration():
    mean = so.random_uniform(3, 2, rng=1)
    prior = fmsync.LangevinPrior(mean, [4.0, 0.0])
    options = {"kappa": 2.0, "n_chains": 20, "n_draws": 200, "warmup": 100, "prior": prior, "rng": 4}
    values = [
        np.einsum("ktab,ab->kt", fmsync.sample(one_edge(3), method, **options).absolute[:, :, 0], mean[0])
        for method in ("heat-bath", "hmc")
    ]
    (a, a_error), (b, b_error) = map(mean_and_error, values)
    assert abs(a - b) < 4 * np.hypot(a_error, b_error)
    assert np.hypot(a_error, b_error) < 0.06


def test_dual_averaging_finds_the_step():
    """Acceptance exp(-step): 0.8 at step 0.223."""
    averaging = DualAveraging(np.array([3.0, 1e-3]), 0.8)
    step = averaging.step
    for _ in range(2000):
        step = averaging.update(np.exp(-step))
    np.testing.assert_allclose(averaging.average, -np.log(0.8), rtol=0.05)


def test_nothing_is_adapted_after_the_warmup():
    p = noisy()
    engine = HMC(Target(p, kappa=5.0), so.random_uniform(4, (2, 5), rng=0), np.random.default_rng(0))
    for _ in range(30):
        engine.step(warmup=True)
    engine.step(warmup=False)
    frozen = engine.settings["step"], engine.settings["n_steps"]
    for _ in range(30):
        engine.step(warmup=False)
    assert (engine.settings["step"], engine.settings["n_steps"]) == frozen


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kappa": -1.0}, "kappa: must be finite and > 0"),
        ({"energy": "l1"}, "energy: 'euclidean' or 'geodesic'"),
        ({"integrator": "qf"}, "integrator: 'cayley' or 'exp'"),
        ({"step": 0.0}, "step: must be finite and > 0"),
        ({"length": -1.0}, "length: must be finite and > 0"),
        ({"energy": "geodesic"}, "cannot be inferred"),
        ({"energy": "geodesic", "kappa": "auto"}, "cannot be inferred"),
        ({"likelihood": "projected-gaussian"}, "likelihood: 'hmc' takes 'langevin' alone"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        fmsync.sample(noisy(), "hmc", **options)


def test_a_length_is_refused_by_mala():
    with pytest.raises(ValueError, match="length: 'mala' has no such option"):
        fmsync.sample(noisy(), "mala", length=0.3)


@pytest.fixture(scope="module")
def exact_draws():
    """Five thousand chains on one edge of SO(3) in their stationary distribution, κ = 3."""
    start = np.empty((5000, 2, 3, 3))
    start[:, 0] = np.eye(3)
    start[:, 1] = langevin_noise(3, 3.0, len(start), np.random.default_rng(0))
    return start


@pytest.mark.parametrize(
    ("method", "options"),
    [("hmc", {"step": 0.35}), ("hmc", {}), ("mala", {"step": 0.5}), ("mala", {}), ("heat-bath", {})],
)
def test_chains_from_exact_draws_stay_exact_without_a_warm_up(exact_draws, method, options):
    """Nothing that is tuned may follow the state: a path length that did gave 2.520 with a step of .35."""
    p, kappa, n_chains = one_edge(3), 3.0, len(exact_draws)
    post = fmsync.sample(
        p, method, kappa=kappa, init=exact_draws, n_chains=n_chains, n_draws=6, warmup=0, thin=2, rng=1, **options
    )
    trace = (p.constant - post.energy) / 2
    exact = 3 * fmsync.langevin.mean_cosine(3, kappa)
    assert exact == pytest.approx(2.4701, abs=1e-4)
    for draws in trace.T:
        assert abs(draws.mean() - exact) < 4 * draws.std() / np.sqrt(n_chains)


@pytest.mark.parametrize("warmup", [0, 30])
def test_step_and_length_are_frozen_before_the_first_kept_draw(warmup):
    chains = HMC(Target(noisy(), kappa=5.0), so.random_uniform(4, (3, 5), rng=0), np.random.default_rng(1))
    for _ in range(warmup):
        chains.step(warmup=True)
    tuned = []
    for _ in range(20):
        chains.step(warmup=False)
        tuned.append((chains.settings["step"], chains.settings["n_steps"]))
    assert len(set(tuned)) == 1
