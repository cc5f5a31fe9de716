"""Replica exchange on a loop that contradicts itself: two modes, equally likely by symmetry."""

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import so
from fmsync.samplers.base import Target
from fmsync.samplers.tempered import Tempered
from tests.samplers.helpers import mean_and_error, noisy, one_edge

KAPPA = 12.0


def twisted_ring(n, n_nodes=8):
    """All observations say I but one, which is a half turn: the loop closes by turning the rest either way."""
    maps = np.stack([np.eye(n)] * n_nodes)
    maps[0] = np.diag([-1.0, -1.0] + [1.0] * (n - 2))
    return fmsync.SyncProblem(n_nodes, [(i, (i + 1) % n_nodes) for i in range(n_nodes)], maps)


def turns_left(post):
    """(chains, draws) whether the other edges together turn the first plane one way or the other."""
    relative = post.relative()[:, :, 1:]
    angle = np.arctan2(relative[..., 1, 0] - relative[..., 0, 1], relative[..., 0, 0] + relative[..., 1, 1])
    return angle.sum(axis=2) > 0


@pytest.mark.parametrize(("n", "base"), [(2, "heat-bath"), (3, "heat-bath"), (2, "hmc"), (2, "mala")])
def test_the_modes_are_crossed(n, base):
    p = twisted_ring(n)
    thin, n_draws = (8, 1000) if base == "mala" else (2, 500)
    post = fmsync.sample(
        p, "tempered", base=base, kappa=KAPPA, n_chains=8, n_draws=n_draws, warmup=400, thin=thin, rng=0
    )
    share, error = mean_and_error(turns_left(post))
    assert abs(share - 0.5) < 4 * error
    assert error < 0.1
    assert post.settings["round_trips"] > 20
    assert post.settings["swap_acceptance"] > 0.1
    assert (post.kappa == KAPPA).all()
    np.testing.assert_allclose(post.energy, fmsync.energy.energy(p, post.absolute), atol=1e-8)


@pytest.mark.parametrize("n", [2, 3])
def test_a_single_chain_stays_in_one_mode_at_the_same_energy(n):
    """Both modes have the same energies by symmetry: the chain that never crosses has them right."""
    p = twisted_ring(n)
    options = {"kappa": KAPPA, "n_chains": 8, "n_draws": 500, "warmup": 400, "rng": 1}
    stuck, crossing = fmsync.sample(p, "heat-bath", **options), fmsync.sample(p, "tempered", thin=2, **options)
    share = turns_left(stuck).mean(axis=1)
    assert ((share == 0) | (share == 1)).all()
    (a, a_error), (b, b_error) = mean_and_error(stuck.energy), mean_and_error(crossing.energy)
    assert abs(a - b) < 4 * np.hypot(a_error, b_error)
    assert np.hypot(a_error, b_error) < 0.05 * a


def test_left_and_right_of_symmetric_shapes_are_crossed():
    """Six shapes in a ring, one map of six mirrored: in the odd plane the loop closes to the left or to the right."""
    truth = data_gen.planted(6, 4, nx.cycle_graph(6), rng=0)
    p = data_gen.perturb(truth, 0.0, 1, outliers=1 / 6, outlier_kind="flip")
    a, b = np.flatnonzero(np.diag(truth.flip) < 0)
    options = {"kappa": KAPPA, "n_chains": 8, "n_draws": 400, "warmup": 300, "thin": 2, "init": "random", "rng": 2}
    shares = []
    for method in ("heat-bath", "tempered"):
        maps = fmsync.sample(p, method, **options).relative([[0, 3]])[:, :, 0]
        turn = truth.relative([[0, 3]])[0].T @ maps
        shares.append((turn[..., b, a] > turn[..., a, b]).mean(axis=1))
    alone, tempered = shares
    assert ((alone < 0.02) | (alone > 0.98)).all()
    assert 0 < (alone > 0.5).mean() < 1  # the starts decide
    assert abs(tempered.mean() - 0.5) < 4 * tempered.std(ddof=1) / np.sqrt(8)
    assert tempered.std(ddof=1) / np.sqrt(8) < 0.08


def test_few_landmarks_tip_the_odds_as_they_should():
    """On SO(2) the share of a mode is an integral over the angle between two nodes: two paths and the landmarks."""
    ring, angle, weight = twisted_ring(2), 0.6, 0.05
    landmarks = so.exp(np.array([[0.0, -angle], [angle, 0.0]]))
    p = fmsync.SyncProblem(
        8,
        np.concatenate([ring.edges, [[0, 4]]]),
        np.concatenate([ring.maps, landmarks[None]]),
        np.append(np.ones(8), weight),
    )
    grid = np.linspace(-np.pi, np.pi, 2048, endpoint=False)
    path = np.fft.ifft(np.fft.fft(np.exp(2 * KAPPA * (np.cos(np.fft.ifftshift(grid)) - 1))) ** 4).real  # of four edges
    density = path * np.roll(path, len(grid) // 2) * np.exp(2 * KAPPA * weight * np.cos(np.fft.ifftshift(grid) - angle))
    left = density[np.fft.ifftshift(grid) > 0].sum() / density.sum()
    assert 0.55 < left < 0.9
    post = fmsync.sample(p, "tempered", kappa=KAPPA, n_chains=16, n_draws=500, warmup=400, thin=2, rng=0)
    turn = post.relative([[0, 4]])[:, :, 0]
    share, error = mean_and_error(turn[..., 1, 0] > turn[..., 0, 1])
    assert abs(share - left) < 4 * error
    assert error < 0.03


def test_energies_at_every_temperature_are_those_of_their_temperature():
    """On one edge the exact mean trace is known at every concentration of the ladder."""
    p = one_edge(3)
    start = so.random_uniform(3, (20, 2), rng=0)
    engine = Tempered(Target(p, kappa=10.0), start, np.random.default_rng(1), n_temperatures=4)
    for _ in range(100):
        engine.step(warmup=True)
    ladder, traces = np.array(engine.settings["ladder"]), []
    assert (np.diff(ladder) > 0).all()
    for _ in range(600):
        engine.step(warmup=False)
        energy = engine._replicas.energy().reshape(20, 4)
        traces.append(np.take_along_axis((p.constant - energy) / 2, np.argsort(engine._place, axis=1), axis=1))
    for r, kappa in enumerate(10.0 * ladder):
        mean, error = mean_and_error(np.array(traces)[:, :, r].T)
        assert abs(mean - 3 * fmsync.langevin.mean_cosine(3, kappa)) < 4 * error
        assert error < 0.05


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"base": "rlfm"}, "base"),
        ({"n_temperatures": 1}, "n_temperatures"),
        ({"hottest": 1.0}, "hottest"),
        ({"kappa": 0.0}, "kappa: must be finite and > 0"),
        ({"kappa": 2.0, "energy": "geodesic"}, "'heat-bath' takes 'euclidean' alone"),
        ({"base": "hmc", "energy": "geodesic"}, "normaliser of the geodesic energy is not known"),
        ({"base": "hmc", "likelihood": "projected-gaussian"}, "'hmc' takes 'langevin' alone"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        fmsync.sample(noisy(), "tempered", **options)


@pytest.mark.parametrize(
    "options",
    [
        {"kappa": "auto"},
        {"kappa": "auto", "base": "hmc"},
        {"likelihood": "projected-gaussian"},
        pytest.param({"energy": "geodesic", "kappa": 8.0, "base": "hmc"}, marks=pytest.mark.slow),
    ],
)
def test_every_likelihood_agrees_with_its_base_where_there_is_one_mode(options):
    """Energy and concentration of the coldest replicas are those of the sampler that they are replicas of."""
    p, run = noisy(4, 3, sigma2=0.05), {"n_chains": 16, "n_draws": 200, "warmup": 400, "thin": 2}
    base = options.get("base", "heat-bath")
    alone = fmsync.sample(p, base, rng=1, **run, **{k: v for k, v in options.items() if k != "base"})
    tempered = fmsync.sample(p, "tempered", rng=2, n_temperatures=8, hottest=0.02, **run, **options)
    assert tempered.settings["swap_acceptance"] > 0.1
    assert tempered.settings["round_trips"] > 3
    assert tempered.settings["kappa_inferred"] == alone.settings["kappa_inferred"]
    for values in (lambda post: post.energy, lambda post: np.log(post.kappa)):
        if np.ptp(values(alone)) > 0:
            (a, a_error), (b, b_error) = mean_and_error(values(alone)), mean_and_error(values(tempered))
            assert abs(a - b) < 4 * np.hypot(a_error, b_error)


@pytest.mark.parametrize(
    "options",
    [
        {"kappa": "auto"},
        pytest.param({"likelihood": "projected-gaussian"}, marks=pytest.mark.slow),
        pytest.param({"kappa": 5.0, "energy": "geodesic", "base": "hmc"}, marks=pytest.mark.slow),
    ],
)
def test_modes_are_crossed_with_an_unknown_noise_level(options):
    p = twisted_ring(3)
    p = fmsync.SyncProblem(8, np.concatenate([p.edges] * 3), np.concatenate([p.maps] * 3))  # three observations each
    init = np.stack([fmsync.solve(p, "mle").absolute] * 8)
    post = fmsync.sample(
        p, "tempered", n_temperatures=12, n_chains=8, n_draws=300, warmup=600, thin=4, init=init, rng=0, **options
    )
    relative = post.relative()[:, :, 1:8]
    angle = np.arctan2(relative[..., 1, 0] - relative[..., 0, 1], relative[..., 0, 0] + relative[..., 1, 1])
    share, error = mean_and_error(angle.sum(axis=2) > 0)
    assert abs(share - 0.5) < 4 * error
    assert error < 0.12
    assert post.settings["round_trips"] > 20
