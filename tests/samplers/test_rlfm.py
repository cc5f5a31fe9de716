"""The chain against distributions known exactly; thresholds are numbers of standard errors over independent chains."""

import numpy as np
import pytest
from scipy.special import iv

import bench.peers  # noqa: F401  registers the peers
import fmsync
from fmsync import so
from fmsync.energy import gradient, unconstrained_energy
from fmsync.estimators.mle_unconstrained import precision
from fmsync.samplers.rlfm import default_step
from tests.samplers.helpers import ONE_EDGE_OF_SO20, mean_and_error, noisy, one_edge


def mean_trace_of_so3(kappa):
    """E tr under exp(κ tr C) on SO(3): derivative of log c, c = e^κ (I_0(2κ) - I_1(2κ))."""
    i0, i1 = iv(0, 2 * kappa), iv(1, 2 * kappa)
    return 1 + 2 * (i1 - (i0 - i1 / (2 * kappa))) / (i0 - i1)


def mean_trace(n, kappa, multiple, rng, **options):
    """E tr on one edge at a multiple of the default step, over the same time of the diffusion, and its error."""
    p = one_edge(n)
    options = {"n_chains": 48, "n_draws": 250, "warmup": round(100 / multiple), "thin": max(1, round(1 / multiple))} | (
        options
    )
    post = fmsync.sample(p, kappa=kappa, step=multiple * default_step(p, kappa), rng=rng, **options)
    return mean_and_error((p.constant - post.energy) / 2)


@pytest.mark.parametrize(("kappa", "exact"), ONE_EDGE_OF_SO20)
def test_one_edge_of_so20(kappa, exact):
    """Two step sizes extrapolated to h = 0 meet the exact mean; the printed sign does not come near it."""
    coarse, coarse_error = mean_trace(20, kappa, 1.0, rng=1)
    fine, fine_error = mean_trace(20, kappa, 0.5, rng=2)
    error = np.hypot(2 * fine_error, coarse_error)
    assert abs(2 * fine - coarse - exact) < 4 * error
    assert error < 0.07 * exact  # half the temperature, or twice, would be seen

    printed, printed_error = mean_trace(20, kappa, 0.5, rng=3, drift="printed", n_draws=40, n_chains=16)
    assert printed < -0.5 * exact < exact - 20 * printed_error


def test_bias_falls_linearly_in_the_step():
    exact, n, kappa = 16.8173, 20, 30
    (coarse, coarse_error), (fine, fine_error) = (mean_trace(n, kappa, m, rng=4) for m in (2.0, 1.0))
    bias, half = exact - coarse, exact - fine
    assert half > 8 * fine_error
    ratio_error = bias / half * np.hypot(coarse_error / bias, fine_error / half)
    assert ratio_error < 0.15
    assert abs(bias / half - 2) < 4 * ratio_error + 0.25  # the next order in h is 15 % of the first here


@pytest.mark.parametrize(("retraction", "two_way"), [("exp", False), ("qf", True)])
def test_stein_identity(retraction, two_way):
    """E ||grad log p||² = (n-1) κ E Σ tr at a small step, and badly not so with the printed sign."""
    p = noisy(two_way=two_way)
    kappa = 6.0

    def score(drift):
        squares = []

        def record(draw, state, energy):
            squares.append(((kappa / 2 * gradient(p, state)) ** 2).sum((1, 2, 3)))

        post = fmsync.sample(
            p,
            kappa=kappa,
            step=0.1 * default_step(p, kappa),
            n_chains=80,
            n_draws=40 if drift == "descent" else 5,
            warmup=400,
            thin=20,
            rng=5,
            retraction=retraction,
            drift=drift,
            callback=record,
        )
        traces = (p.constant - post.energy) / 2
        difference, error = mean_and_error(np.array(squares).T - (p.n - 1) * kappa * traces)
        return difference / error, difference / ((p.n - 1) * kappa * traces.mean())

    z, relative = score("descent")
    assert abs(z) < 4
    assert abs(relative) < 0.03
    assert score("printed")[0] > 20


def test_geodesic_energy_on_the_circle():
    """On SO(2) it is quadratic: the chain is linear and its stationary variance 1 / (4 β (1 - 2h)) exact at any h."""
    p, beta, h = one_edge(2), 2.0, 0.1
    post = fmsync.sample(
        p, energy="geodesic", beta=beta, step=h, n_chains=100, n_draws=100, warmup=60, thin=10, init="random", rng=6
    )
    angle_squared, error = mean_and_error(post.energy / 2)
    exact = 1 / (4 * beta * (1 - 2 * h))
    assert abs(angle_squared - exact) < 4 * error
    assert error < 0.02 * exact  # at step 0 it is a fifth smaller


def test_both_energies_agree_where_the_posterior_is_narrow():
    """κ = 2β for either energy: near the mode both are the same quadratic form."""
    p = noisy(4, 3, sigma2=0.0)
    options = {"kappa": 2000.0, "n_chains": 20, "n_draws": 150, "warmup": 300, "thin": 5, "rng": 7}
    (a, a_error), (b, b_error) = (
        mean_and_error(fmsync.sample(p, energy=name, **options).energy) for name in ("euclidean", "geodesic")
    )
    assert abs(a - b) < 4 * np.hypot(a_error, b_error)
    assert np.hypot(a_error, b_error) < 0.05 * a


def test_unconstrained_chain_against_its_exact_gaussian():
    """The discretised chain is linear: mean K⁻¹ b, covariance [2β K (I - hK)]⁻¹ for each row, exact at any step."""
    p, beta = noisy(4, 3, sigma2=0.2), 1.5
    h = 2 * default_step(p, 2 * beta)
    k, b = precision(p)
    k = k.toarray()
    centre, covariance = np.linalg.solve(k, b), np.linalg.inv(2 * beta * k @ (np.eye(len(k)) - h * k))
    states = []
    post = fmsync.sample(
        p,
        beta=beta,
        step=h,
        constrained=False,
        n_chains=300,
        n_draws=40,
        warmup=1500,
        thin=60,
        rng=8,
        callback=lambda draw, state, energy: states.append(state.copy()),
    )
    states = np.array(states)  # (draws, chains, N, n, n)
    np.testing.assert_array_equal(states[:, :, 0], np.broadcast_to(np.eye(3), states[:, :, 0].shape))
    np.testing.assert_allclose(post.absolute, so.project(states).swapaxes(0, 1))
    np.testing.assert_allclose(post.energy, unconstrained_energy(p, states).T)
    rows = states[:, :, 1:].transpose(0, 1, 3, 2, 4).reshape(*states.shape[:2], 3, -1)  # row r of C_2..C_N
    values, vectors = np.linalg.eigh(covariance)
    white = (rows - centre.T) @ (vectors / np.sqrt(values))  # standard normal if the law is right
    by_chain = white.mean(axis=0).reshape(300, -1)
    z_mean = by_chain.mean(0) / (by_chain.std(0, ddof=1) / np.sqrt(300))
    by_chain = (white**2).mean(axis=0).reshape(300, -1)
    z_variance = (by_chain.mean(0) - 1) / (by_chain.std(0, ddof=1) / np.sqrt(300))
    assert np.abs(z_mean).max() < 4.5  # the largest of 27
    assert np.abs(z_variance).max() < 4.5
    assert (by_chain.std(0, ddof=1) / np.sqrt(300)).max() < 0.05


def test_unconstrained_chain_climbing_blows_up():
    with pytest.raises(RuntimeError, match="diverged"):
        fmsync.sample(noisy(), constrained=False, drift="printed", warmup=100_000, n_draws=1)


def test_prior_is_sampled_with_its_own_concentration():
    """On a tree the prior on one node and the edge are independent Langevin laws."""
    p, n = one_edge(3), 3
    mean = so.random_uniform(n, 2, rng=1)
    prior = fmsync.LangevinPrior(mean, [4.0, 0.0])
    post = fmsync.sample(
        p, kappa=2.0, step=0.01, n_chains=200, n_draws=60, warmup=600, thin=20, init="random", prior=prior, rng=9
    )
    assert post.absolute.shape == (200, 60, 2, n, n)
    traces = np.einsum("ktab,ab->kt", post.absolute[:, :, 0], mean[0])
    relative = np.einsum("ktaa->kt", post.relative()[:, :, 0])
    for values, kappa in ((traces, 4.0), (relative, 2.0)):
        average, error = mean_and_error(values)
        assert abs(average - mean_trace_of_so3(kappa)) < 4 * error + 0.03  # 0.03: the bias of this step
        assert error < 0.03


def test_gauge_of_the_start_does_not_matter():
    """Turned starts and turned noise-free drift give turned draws: compare energies along one noise stream."""
    p = noisy()
    start = so.random_uniform(p.n, p.n_nodes, rng=3)
    turned = so.random_uniform(p.n, rng=4) @ start
    a, b = (fmsync.sample(p, init=c, n_chains=2, n_draws=20, warmup=5, rng=1) for c in (start, turned))
    np.testing.assert_allclose(a.energy, b.energy, atol=1e-9)
    np.testing.assert_allclose(a.relative(), b.relative(), atol=1e-10)
    assert np.abs(a.absolute - b.absolute).max() > 0.1


def test_orthogonality_does_not_drift():
    post = fmsync.sample(noisy(), n_chains=1, n_draws=1, warmup=20_000, rng=0)
    last = post.absolute[0, -1]
    assert np.abs(so.transpose(last) @ last - np.eye(4)).max() < 1e-12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"step": 0.0}, "step"),
        ({"step": -1.0}, "step"),
        ({"step": np.nan}, "step"),
        ({"kappa": 2.0, "beta": 1.0}, "give one of them"),
        ({"kappa": 0.0}, "kappa"),
        ({"beta": -1.0}, "beta"),
        ({"energy": "l1"}, "energy"),
        ({"retraction": "cayley"}, "retraction"),
        ({"drift": "up"}, "drift"),
        ({"energy": "geodesic", "constrained": False}, "geodesic"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        fmsync.sample(noisy(), **options)


def test_geodesic_energy_needs_rotations():
    p = fmsync.SyncProblem(2, [[0, 1]], 2 * np.eye(3)[None])
    with pytest.raises(ValueError, match="0 is not a rotation"):
        fmsync.sample(p, energy="geodesic")


@pytest.mark.parametrize(
    "options", [{"step": 0.3}, {"step": 0.5, "energy": "geodesic"}, {"step": 0.5, "constrained": False}]
)
def test_a_diverging_chain_stops_and_names_a_step_that_works(options):
    p = noisy(11, 8, sigma2=0.05)
    with pytest.raises(RuntimeError, match=r"chain 0 diverged: .* try step=") as caught:
        fmsync.sample(p, n_chains=2, n_draws=50, warmup=100, rng=0, **options)
    step = float(str(caught.value).rsplit("=", 1)[1])
    post = fmsync.sample(p, n_chains=2, n_draws=50, warmup=100, rng=0, **(options | {"step": step}))
    assert not post.interrupted


def test_the_version_on_geomstats_operations_follows_the_same_distribution():
    """Same drift without noise (β large): same path; this also checks the drift against an edge-by-edge gradient."""
    p = noisy()
    start = so.random_uniform(p.n, p.n_nodes, rng=0)
    options = {"init": start, "n_chains": 2, "n_draws": 5, "warmup": 0, "beta": 1e14, "step": 0.02}
    ours, theirs = (fmsync.sample(p, name, **options) for name in ("rlfm", "rlfm-geomstats"))
    np.testing.assert_allclose(ours.absolute, theirs.absolute, atol=1e-5)
    assert np.abs(ours.absolute[0, -1] - start).max() > 0.01
