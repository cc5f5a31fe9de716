"""The heat bath against exact distributions; thresholds are numbers of standard errors."""

import numpy as np
import pytest
from scipy.special import i0, i1

import fmsync
from fmsync import langevin, so
from tests.samplers.helpers import ONE_EDGE_OF_SO20, mean_and_error, noisy, one_edge


@pytest.mark.parametrize(("kappa", "exact"), ONE_EDGE_OF_SO20)
def test_one_edge_of_so20(kappa, exact):
    p = one_edge(20)
    post = fmsync.sample(p, "heat-bath", kappa=kappa, n_chains=32, n_draws=300, warmup=30, init="dispersed", rng=kappa)
    mean, error = mean_and_error((p.constant - post.energy) / 2)
    assert abs(mean - exact) < 4 * error
    assert error < 0.02


def test_without_data_draws_are_haar():
    p = one_edge(4)
    post = fmsync.sample(p, "heat-bath", kappa=1e-9, n_chains=20, n_draws=1000, warmup=10, rng=0)
    trace = np.einsum("ktaa->kt", post.relative()[:, :, 0])
    for values, exact in ((trace, 0), (trace**2, 1)):
        mean, error = mean_and_error(values)
        assert abs(mean - exact) < 4 * error
        assert error < 0.03


def test_energy_is_that_of_the_draws_and_the_group_is_not_left():
    p = noisy(3, 3)
    post = fmsync.sample(p, "heat-bath", kappa=8.0, n_chains=1, n_draws=3, thin=4000, warmup=0, rng=0)
    last = post.absolute[0, -1]
    assert np.abs(so.transpose(last) @ last - np.eye(3)).max() < 1e-14  # 1e-13 if rotations were not repaired
    np.testing.assert_allclose(post.energy, fmsync.energy.energy(p, post.absolute), atol=1e-12)


def test_prior_is_sampled_with_its_own_concentration():
    """On a tree the prior on one node and the edge are independent Langevin distributions."""
    mean = so.random_uniform(3, 2, rng=1)
    prior = fmsync.LangevinPrior(mean, [4.0, 0.0])
    post = fmsync.sample(
        one_edge(3), "heat-bath", kappa=2.0, n_chains=20, n_draws=600, warmup=30, init="random", prior=prior, rng=9
    )
    traces = np.einsum("ktab,ab->kt", post.absolute[:, :, 0], mean[0])
    relative = np.einsum("ktaa->kt", post.relative()[:, :, 0])
    for values, kappa in ((traces, 4.0), (relative, 2.0)):
        average, error = mean_and_error(values)
        assert abs(average - 3 * langevin.mean_cosine(3, kappa)) < 4 * error
        assert error < 0.03


@pytest.mark.parametrize("concentrations", [[1.0, 2.5], np.geomspace(400, 40, 10)])
def test_concentration_by_frequency_is_a_factor_of_the_maps(concentrations):
    """One observation I Λ: on SO(2) a von Mises angle, and for small noise the diagonal that the book reads Λ off."""
    n, p = len(concentrations), fmsync.SyncProblem(2, [[0, 1]], np.diag(concentrations)[None])
    post = fmsync.sample(p, "heat-bath", kappa=1.0, n_chains=20, n_draws=400, warmup=30, rng=4)
    pairs = 1 / np.add.outer(concentrations, concentrations)
    exact = 1 - np.repeat(i1(3.5) / i0(3.5), 2) if n == 2 else (pairs.sum(0) - np.diag(pairs)) / 2
    for k in range(n):
        mean, error = mean_and_error(1 - post.relative()[:, :, 0, k, k])
        assert abs(mean - exact[k]) < 4.5 * error + (0 if n == 2 else 0.03 * exact[k])
        assert error < 0.02


def test_chains_do_not_depend_on_their_number():
    p, start = noisy(), so.random_uniform(4, 5, rng=0)
    a, b = (
        fmsync.sample(p, "heat-bath", kappa=5.0, init=start, n_chains=k, n_draws=5, warmup=3, rng=1) for k in (2, 3)
    )
    np.testing.assert_array_equal(a.absolute, b.absolute[:2])
    assert np.abs(b.absolute[1] - b.absolute[0]).max() > 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kappa": 0.0}, "kappa: must be finite and > 0"),
        ({"kappa": -3.0}, "kappa: must be finite and > 0"),
        ({"kappa": np.nan}, "kappa"),
        ({"kappa": "matched"}, "kappa: a number > 0 or 'auto'"),
        ({"kappa": 3.0, "beta": 1.5}, "give one of them"),
        ({"kappa": "auto", "beta": 1.5}, "give one of them"),
        ({"likelihood": "gaussian"}, "likelihood: 'langevin' or 'projected-gaussian' or 'mixture'"),
        ({"likelihood": "projected-gaussian", "kappa": 3.0}, "infers sigma2"),
        ({"likelihood": "projected-gaussian", "beta": 3.0}, "infers sigma2"),
        ({"energy": "geodesic"}, "energy: 'heat-bath' takes 'euclidean' alone"),
        ({"n_draws": 0}, "n_draws"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        fmsync.sample(noisy(), "heat-bath", **options)
