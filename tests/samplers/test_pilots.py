"""Pilot chains: they name a mode that chains have not seen, and are silent where there is one."""

import warnings

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync.diagnostics import ConvergenceWarning
from fmsync.samplers import pilots
from tests.samplers.test_tempered import twisted_ring


@pytest.fixture
def said(monkeypatch):
    """What a short run says about modes, with the pilots that one of 2000 steps and four chains can afford."""

    def run(problem, method="heat-bath", n_draws=150, warmup=150, n_chains=4, **options):
        monkeypatch.setattr(pilots, "_SHARE", 0.03 * 4 * 2000 / (n_chains * (n_draws + warmup)))
        assert pilots.pilot_steps(n_chains, n_draws + warmup) == 30
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ConvergenceWarning)
            fmsync.sample(problem, method, n_draws=n_draws, warmup=warmup, n_chains=n_chains, **options)
        return [str(w.message) for w in caught if "mode" in str(w.message)]

    return run


@pytest.mark.parametrize("method", ["heat-bath", "rlfm", pytest.param("hmc", marks=pytest.mark.slow), "mala"])
def test_the_second_mode_of_a_ring_is_named(said, method):
    """Four chains from the spectral estimate sit in one of two equal modes, where a pilot ends one time in two.

    A chain may also cross while it warms up: then it is said that the chains themselves lie apart.
    """
    run = {"kappa": 12.0, "n_draws": 250, "warmup": 250}
    messages = [said(twisted_ring(2, n_nodes=9), method, rng=seed, **run) for seed in range(12)]
    assert sum(map(len, messages)) >= 10
    told = [message for one in messages for message in one]
    assert sum("settled in another mode" in message for message in told) >= 9
    assert all("another mode" in message for message in told)
    assert all("use method='tempered'" in message for message in told)


def test_what_is_advised_works(said):
    assert not said(twisted_ring(2, n_nodes=9), "tempered", kappa=12.0, n_draws=400, warmup=300)


@pytest.mark.parametrize(
    ("n_nodes", "n", "sigma2", "density"),
    [
        (11, 20, 0.1, 1.0),
        (11, 20, 0.4, 1.0),
        (4, 20, 1.0, 1.0),
        (5, 3, 0.3, 1.0),
        (30, 5, 0.05, 0.2),
        (20, 3, 0.02, 0.15),
    ],
)
def test_nothing_is_said_where_chains_mix(said, n_nodes, n, sigma2, density):
    for seed in range(3):
        graph = data_gen.random_graph(n_nodes, density, rng=seed) if density < 1 else nx.complete_graph(n_nodes)
        problem = data_gen.perturb(data_gen.planted(n_nodes, n, graph, rng=seed), sigma2, seed + 1)
        assert not said(problem, kappa="auto", rng=seed)


def test_short_runs_have_no_pilots():
    assert pilots.pilot_steps(4, 100) == 0
    assert pilots.pilot_steps(4, 2000) == 30


def test_pilots_do_not_change_the_draws():
    problem = twisted_ring(2, n_nodes=9)
    long = fmsync.sample(problem, "heat-bath", kappa=12.0, n_draws=1500, rng=3)
    short = fmsync.sample(problem, "heat-bath", kappa=12.0, n_draws=20, rng=3)
    np.testing.assert_array_equal(long.absolute[:, :20], short.absolute)


@pytest.mark.parametrize("seed", range(3))
def test_chains_in_different_modes_are_told_though_their_energies_agree(seed):
    problem = twisted_ring(2, n_nodes=9)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ConvergenceWarning)
        post = fmsync.sample(problem, "heat-bath", kappa=12.0, init="random", n_chains=16, n_draws=300, rng=seed)
    assert fmsync.diagnostics.rhat(post.energy) < 1.02
    (message,) = [str(w.message) for w in caught if "mode" in str(w.message)]
    assert "of 16 chains stay in another mode" in message
    assert "use method='tempered'" in message


@pytest.mark.parametrize("kappa", [2.0, 4.0, 8.0])
def test_noise_in_many_dimensions_is_not_a_distance(said, kappa):
    problem = data_gen.perturb(data_gen.planted(11, 20, rng=0), 0.2, 1)
    assert not said(problem, kappa=kappa, n_chains=2, n_draws=300, warmup=100, rng=5)
