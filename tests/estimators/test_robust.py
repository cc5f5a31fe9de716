"""Robust estimates: three edges in ten are garbage, and the others are enough."""

import numpy as np
import pytest

import fmsync
from fmsync import langevin, so
from fmsync.estimators import robust


def spoiled(planted, sigma2, share=0.3, n_nodes=12, n=8, rng=0):
    """(problem, truth, good, bad): a share of the edges replaced by Haar-random rotations."""
    clean, truth = planted(n_nodes, n, sigma2, rng)
    bad = np.random.default_rng(rng).permutation(clean.n_edges)[: round(share * clean.n_edges)]
    maps = clean.maps.copy()
    maps[bad] = so.random_uniform(n, len(bad), rng=rng + 1)
    good = np.setdiff1d(np.arange(clean.n_edges), bad)
    return fmsync.SyncProblem(n_nodes, clean.edges, maps), truth, good, bad


def rms(estimate, truth):
    return np.sqrt(((estimate.relative(truth.edges) - truth.maps) ** 2).sum((1, 2)).mean())


@pytest.mark.parametrize(("loss", "excess"), [("mixture", 1.02), ("geman-mcclure", 1.06), ("l1", 1.25)])
def test_outliers_cost_little_where_plain_maximum_likelihood_fails(planted, loss, excess):
    """Compared with the estimate of somebody who knows the bad edges and leaves them out; mean over seeds."""
    ratios, plain = [], []
    for seed in range(5):
        problem, truth, good, bad = spoiled(planted, 0.01, rng=seed)
        oracle = rms(fmsync.solve(fmsync.SyncProblem(12, problem.edges[good], problem.maps[good])), truth)
        estimate = fmsync.solve(problem, "robust", loss=loss)
        assert estimate.converged
        assert estimate.edge_weights[bad].max() < estimate.edge_weights[good].min()
        ratios.append(rms(estimate, truth) / oracle)
        plain.append(rms(fmsync.solve(problem), truth) / oracle)
    assert np.mean(plain) > 1.8
    assert np.mean(ratios) < excess


@pytest.mark.parametrize("loss", robust.LOSSES)
def test_clean_maps_between_outliers_are_recovered_exactly(planted, loss):
    problem, truth, *_ = spoiled(planted, 0.0)
    assert rms(fmsync.solve(problem, "robust", loss=loss), truth) < 1e-3
    assert rms(fmsync.solve(problem), truth) > 0.3


@pytest.mark.parametrize("loss", robust.LOSSES)
def test_no_round_raises_the_cost(planted, loss):
    problem, *_ = spoiled(planted, 0.05)
    estimate = fmsync.solve(problem, "robust", loss=loss)
    assert np.diff(estimate.trace.cost).max() < 1e-9


def stated_cost(problem, loss, c, estimate):
    i, j = problem.edges.T
    relative = so.transpose(c[i]) @ c[j]
    squares = ((relative - problem.maps) ** 2).sum((1, 2))
    if loss == "l1":
        return np.sqrt(squares + 1e-8 * problem.n).sum()
    if loss == "geman-mcclure":
        return (estimate["scale"] * squares / (estimate["scale"] + squares)).sum()
    trace = np.einsum("eab,eab->e", problem.maps, relative)
    density = np.exp(estimate["kappa"] * trace - langevin.log_normaliser(problem.n, estimate["kappa"]))
    return -np.log((1 - estimate["outliers"]) * density + estimate["outliers"]).sum()


def test_the_answer_minimises_the_l1_cost_it_states(planted):
    problem, *_ = spoiled(planted, 0.05)
    estimate = fmsync.solve(problem, "robust", loss="l1", tolerance=1e-8)
    cost = stated_cost(problem, "l1", estimate.absolute, {})
    np.testing.assert_allclose(estimate.cost, cost, rtol=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(5):
        step = 1e-4 * so.skew(rng.standard_normal(estimate.absolute.shape))
        ahead, behind = (stated_cost(problem, "l1", estimate.absolute @ so.exp(sign * step), {}) for sign in (1, -1))
        assert abs(ahead - behind) / 2e-4 < 1e-5
        assert ahead + behind > 2 * cost


def test_the_mixture_is_stationary_in_maps_concentration_and_share(planted):
    """The stated likelihood, written out, at the estimate: no direction and neither parameter improves it."""
    problem, *_ = spoiled(planted, 0.1)
    estimate = fmsync.solve(problem, "robust", tolerance=1e-9)
    believed = estimate.edge_weights
    trace = np.einsum("eab,eab->e", problem.maps, estimate.relative())
    at = {
        "kappa": langevin.matched_kappa(problem.n, believed @ trace / believed.sum() / problem.n),
        "outliers": 1 - believed.mean(),
    }
    cost = stated_cost(problem, "mixture", estimate.absolute, at)
    np.testing.assert_allclose(estimate.cost, cost, rtol=1e-6)
    for name in at:
        for factor in (0.97, 1.03):
            assert stated_cost(problem, "mixture", estimate.absolute, at | {name: at[name] * factor}) > cost
    rng = np.random.default_rng(0)
    for _ in range(5):
        step = 1e-3 * so.skew(rng.standard_normal(estimate.absolute.shape))
        assert stated_cost(problem, "mixture", estimate.absolute @ so.exp(step), at) > cost


def test_without_outliers_the_mixture_is_maximum_likelihood(planted):
    problem, _ = planted(n_nodes=8, n=8, sigma2=0.05)
    likelihood, mixture = fmsync.solve(problem), fmsync.solve(problem, "robust")
    np.testing.assert_allclose(mixture.relative(), likelihood.relative(), atol=1e-3)
    assert mixture.edge_weights.min() > 0.99


def test_an_unknown_loss_is_refused(planted):
    with pytest.raises(ValueError, match="loss: 'mixture' or 'geman-mcclure' or 'l1', not 'huber'"):
        fmsync.solve(planted()[0], "robust", loss="huber")
