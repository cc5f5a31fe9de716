"""Maximum a posteriori: maximum likelihood without a prior, the prior without data, and the energy between them."""

import numpy as np
import pytest

import fmsync
from fmsync import so
from fmsync.energy import energy


@pytest.fixture(scope="module")
def prior():
    return fmsync.LangevinPrior(so.random_uniform(5, 7, rng=4), np.array([3.0, 0, 1, 0, 2, 0, 5]))


def posterior_energy(problem, prior, kappa, c):
    """What the docstring of "map" states, term by term."""
    return energy(problem, c) + (prior.kappa * ((c - prior.mean) ** 2).sum((1, 2))).sum() / kappa


def test_without_a_prior_it_is_maximum_likelihood(planted):
    problem, _ = planted(sigma2=0.2)
    np.testing.assert_array_equal(fmsync.solve(problem, "map").absolute, fmsync.solve(problem, "mle").absolute)


def test_a_flat_prior_only_fixes_the_gauge(planted):
    problem, _ = planted(sigma2=0.2)
    flat = fmsync.LangevinPrior(np.stack([np.eye(5)] * 7), 1e-7)
    likelihood = fmsync.solve(problem, "mle", tolerance=1e-9)
    estimate = fmsync.solve(problem, "map", prior=flat, kappa=1.0, tolerance=1e-9)
    np.testing.assert_allclose(estimate.relative(), likelihood.relative(), atol=1e-5)


def test_a_strong_prior_is_its_mean(planted):
    problem, _ = planted(sigma2=0.2)
    strong = fmsync.LangevinPrior(so.random_uniform(5, 7, rng=4), 1e8)
    np.testing.assert_allclose(fmsync.solve(problem, "map", prior=strong, kappa=1.0).absolute, strong.mean, atol=1e-5)


def test_it_minimises_the_energy_it_states(planted, prior):
    """Central differences along geodesics: the slope vanishes in every direction and the curvature is positive."""
    problem, _ = planted(sigma2=0.2)
    estimate = fmsync.solve(problem, "map", prior=prior, kappa=4.0, tolerance=1e-9)
    np.testing.assert_allclose(estimate.cost, posterior_energy(problem, prior, 4.0, estimate.absolute), rtol=1e-12)
    rng, step = np.random.default_rng(0), 1e-4
    for _ in range(10):
        direction = so.skew(rng.standard_normal(estimate.absolute.shape))
        direction /= np.linalg.norm(direction)
        ahead, behind = (
            posterior_energy(problem, prior, 4.0, estimate.absolute @ so.exp(sign * step * direction))
            for sign in (1, -1)
        )
        assert abs(ahead - behind) / (2 * step) < 1e-6
        assert ahead + behind - 2 * estimate.cost > 0


def test_errors_name_the_prior(planted, prior):
    problem, _ = planted(n_nodes=6)
    with pytest.raises(ValueError, match=r"prior.mean: expected \(6, 5, 5\)"):
        fmsync.solve(problem, "map", prior=prior)
    with pytest.raises(ValueError, match="kappa: must be finite and > 0, got -1"):
        fmsync.solve(planted()[0], "map", prior=prior, kappa=-1.0)
