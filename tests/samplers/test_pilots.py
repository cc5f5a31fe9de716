"""Pilot chains: they name a mode that chains have not seen, and are silent where there is one."""

import warnings

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync.diagnostics import ConvergenceWarning
from fmsync.samplers.pilots import pilot_steps
from tests.samplers.test_tempered import twisted_ring

UNSEEN = "settled in another mode"


def said(problem, method="heat-bath", **options):
    """What a run says about modes."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ConvergenceWarning)
        fmsync.sample(problem, method, **options)
    return [str(w.message) for w in caught if UNSEEN in str(w.message)]


@pytest.mark.parametrize("method", ["heat-bath", "rlfm", pytest.param("hmc", marks=pytest.mark.slow), "mala"])
def test_the_second_mode_of_a_ring_is_named(method):
    """Four chains from the spectral estimate sit in one of two equal modes, where a pilot ends one time in two."""
    messages = [said(twisted_ring(2, n_nodes=9), method, kappa=12.0, rng=seed) for seed in range(8)]
    assert sum(map(len, messages)) >= 7
    assert all("use method='tempered'" in message for one in messages for message in one)


def test_what_is_advised_works():
    assert not said(twisted_ring(2, n_nodes=9), "tempered", kappa=12.0)


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
def test_nothing_is_said_where_chains_mix(n_nodes, n, sigma2, density):
    for seed in range(3):
        graph = data_gen.random_graph(n_nodes, density, rng=seed) if density < 1 else nx.complete_graph(n_nodes)
        problem = data_gen.perturb(data_gen.planted(n_nodes, n, graph, rng=seed), sigma2, seed + 1)
        assert not said(problem, kappa="auto", n_draws=600, warmup=400, rng=seed)


def test_short_runs_have_no_pilots():
    assert pilot_steps(4, 100) == 0
    assert pilot_steps(4, 2000) == 30


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
def test_noise_in_many_dimensions_is_not_a_distance(kappa):
    problem = data_gen.perturb(data_gen.planted(11, 20, rng=0), 0.2, 1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ConvergenceWarning)
        fmsync.sample(problem, "heat-bath", kappa=kappa, n_chains=2, n_draws=1200, warmup=100, rng=5)
    assert not [w for w in caught if "mode" in str(w.message)]
