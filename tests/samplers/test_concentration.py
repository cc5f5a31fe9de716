"""κ as a hyperparameter: the normaliser, one step against quadrature, the whole against its data."""

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import langevin
from fmsync.samplers import concentration, random_streams
from tests.samplers.helpers import noisy


@pytest.mark.parametrize("n", [2, 3, 4, 9, 20])
def test_table_of_the_normaliser(n):
    kappa = np.exp(np.random.default_rng(n).uniform(np.log(1e-4), np.log(1e5), 200))
    table = concentration.normaliser_table(n)
    ours = np.array([concentration.interpolated_log_normaliser(k, table) for k in kappa])
    np.testing.assert_allclose(ours, langevin.log_normaliser(n, kappa), rtol=1e-8)


@pytest.mark.parametrize(("trace", "count"), [(1.0, 3.0), (40.0, 15.0), (44.9999, 15.0)])
def test_concentration_step_against_quadrature(trace, count):
    table, state = concentration.normaliser_table(3), random_streams.generators(np.random.default_rng(0), 1)[0]
    draws, kappa = np.empty(20_000), 1.0
    for t in range(len(draws)):
        draws[t] = kappa = concentration.draw_kappa(kappa, trace, count, 0.0, 3, table, state)
    grid = np.geomspace(1e-6, 1e5, 2500)  # equal steps in log κ: the density gains a factor κ
    density = grid * trace - count * langevin.log_normaliser(3, grid) + np.log(grid)
    weight = np.exp(density - density.max())
    weight[[0, -1]] /= 2
    mean = (weight @ grid) / weight.sum()
    spread = np.sqrt(weight @ (grid - mean) ** 2 / weight.sum())
    assert abs(draws.mean() - mean) < 5 * spread / np.sqrt(len(draws) / 2)
    assert draws.std() == pytest.approx(spread, rel=0.03)


def test_unknown_concentration_of_langevin_noise():
    truth = data_gen.planted(8, 6, rng=0)
    p = data_gen.perturb(truth, noise="langevin", kappa=12.0, rng=1)
    post = fmsync.sample(p, "heat-bath", n_draws=400, warmup=200, init="dispersed", rng=0)
    assert post.settings["kappa_inferred"]
    assert abs(post.kappa.mean() - 12) < 4 * post.kappa.std()
    assert post.kappa.std() < 1.5
    assert fmsync.diagnostics.rhat(post.kappa) < 1.02
    with pytest.raises(ValueError, match="sigma2"):
        post.sigma2  # noqa: B018


def test_a_tree_does_not_tell_its_noise():
    truth = data_gen.planted(4, 3, nx.path_graph(4), rng=0)
    tree = data_gen.perturb(truth, 0.1, 1)
    for options in (
        {},
        {"kappa": "auto"},
        {"likelihood": "projected-gaussian"},
        {"likelihood": "by-edge"},
        {"likelihood": "by-frequency"},
    ):
        with pytest.raises(ValueError, match="tree without repeated edges"):
            fmsync.sample(tree, "heat-bath", **options)
    prior = fmsync.LangevinPrior(truth.absolute, [5.0, 0, 0, 5.0])
    for p, options in ((data_gen.perturb(truth, 0.1, 1, repeats=2), {}), (tree, {"prior": prior})):
        assert fmsync.sample(p, "heat-bath", n_draws=2, warmup=5, **options).settings["kappa_inferred"]


def test_hyperparameters_need_rotations_and_plain_weights():
    p = noisy()
    stretched = fmsync.SyncProblem(p.n_nodes, p.edges, 1.1 * p.maps)
    for options in (
        {"kappa": "auto"},
        {"likelihood": "projected-gaussian"},
        {"likelihood": "by-edge"},
        {"likelihood": "by-frequency"},
    ):
        with pytest.raises(ValueError, match="0 is not a rotation"):
            fmsync.sample(stretched, "heat-bath", **options)
    assert fmsync.sample(stretched, "heat-bath", kappa=2.0, n_draws=1, warmup=0).n_draws == 1
    weighted = fmsync.SyncProblem(p.n_nodes, p.edges, p.maps, np.full(p.n_edges, 2.0))
    for likelihood in ("projected-gaussian", "by-edge", "by-frequency"):
        with pytest.raises(ValueError, match="weights"):
            fmsync.sample(weighted, "heat-bath", likelihood=likelihood)
    with pytest.raises(ValueError, match="infers a concentration for every edge"):
        fmsync.sample(p, "heat-bath", likelihood="by-edge", kappa=3.0)
    with pytest.raises(ValueError, match="'hmc' takes 'langevin' alone"):
        fmsync.sample(p, "hmc", likelihood="by-edge")
