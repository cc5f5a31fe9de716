"""The heat bath against exact laws and slow twins; thresholds are numbers of standard errors."""

import time
from concurrent.futures import ThreadPoolExecutor

import networkx as nx
import numba
import numpy as np
import pytest
from joblib import Parallel, delayed
from scipy import stats
from scipy.special import ive

import data_gen
import fmsync
from fmsync import langevin, so
from fmsync.energy import neighbour_sums
from fmsync.samplers import noise_level, plane_rotations, random_streams, thread_pool
from tests.samplers.laws import ONE_EDGE_OF_SO20, mean_and_error, noisy, one_edge


def test_generators_against_their_definition():
    """Python's whole numbers in place of 64-bit registers, one lane after the other."""
    state = random_streams.generators(np.random.default_rng(0), 2)[1]
    lanes, mask = [[int(v) for v in state[:, lane]] for lane in range(8)], 2**64 - 1
    expected = np.empty((100, 8))
    for t in range(100):
        for lane, s in enumerate(lanes):
            total = (s[0] + s[3]) & mask
            result = (((total << 23) | (total >> 41)) + s[0]) & mask
            shifted = (s[1] << 17) & mask
            s[2] ^= s[0]
            s[3] ^= s[1]
            s[1] ^= s[2]
            s[0] ^= s[3]
            s[2] ^= shifted
            s[3] = ((s[3] << 45) | (s[3] >> 19)) & mask
            expected[t, lane] = (result >> 11) / 2**53
    drawn = np.empty((100, 8))
    drawn[0, 0] = random_streams.uniform(state.copy())
    assert drawn[0, 0] == expected[0, 0]
    random_streams.fill(state, drawn)
    np.testing.assert_array_equal(drawn, expected)
    assert len(np.unique(drawn)) == drawn.size


def half_angles(k, count, state):
    """(count, 2) cosines and sines by the compiled draw, each with another place in its vectors."""
    pool, at, drawn = np.empty(random_streams.POOL), random_streams.POOL, np.empty((count // 5, 5, 2))
    room = np.empty((3, 8))
    for t in range(len(drawn)):
        at = random_streams.von_mises_halves(np.full(8, k), room[0], room[1], room[2], 5, state, pool, at)
        drawn[t] = room[:2, :5].T
    return drawn.reshape(-1, 2)


@pytest.mark.parametrize("k", [0.0, 1e-13, 0.3, 1.99, 2.0, 5.0, 200.0, 1e7])
def test_von_mises_draws(k):
    half = half_angles(k, 20_000, random_streams.generators(np.random.default_rng(1), 1)[0])
    np.testing.assert_allclose((half**2).sum(1), 1)
    angle = 2 * np.arctan2(half[:, 1], half[:, 0])
    angle = np.angle(np.exp(1j * angle))
    law = stats.uniform(-np.pi, 2 * np.pi) if k < 1e-6 else stats.vonmises(k)
    if k > 1e5:
        law = stats.norm(0, 1 / np.sqrt(k))
    assert stats.kstest(angle, law.cdf).pvalue > 1e-4
    if 0.1 < k < 1e3:
        cosine = np.cos(angle)
        assert abs(cosine.mean() - ive(1, k) / ive(0, k)) < 4 * cosine.std() / np.sqrt(len(cosine))


def test_the_envelope_lies_above_the_von_mises_law():
    """The bounds 2.4 and 1.14 that the rejections rest on, over all k and all angles."""
    k = np.concatenate([np.linspace(0, 5, 501), np.geomspace(5, 1e9, 200)])[:, None]
    w = 1 / (8 * k + 0.5)
    z = np.minimum(np.concatenate([w * np.linspace(0, 30, 1000), np.tile(np.linspace(0, 1, 2000), (len(k), 1))], 1), 1)
    ratio = np.exp(-8 * k * z / (1 + z) ** 2) * (1 + z / w) ** 1.5 / (1 + z)
    assert (ratio <= np.where(k >= 2, 1.14, 2.4)).all()


def test_an_exponential_of_plain_arithmetic():
    x = np.concatenate([-np.geomspace(1e-12, 50, 300), [0.0]])
    np.testing.assert_allclose([random_streams._exp(v) for v in x], np.exp(x), rtol=0, atol=3e-14)


@pytest.mark.parametrize("n", [2, 3, 6, 9])
def test_every_plane_is_in_one_round_of_disjoint_planes(n):
    table = plane_rotations.rounds(n)
    assert sorted(map(tuple, table.reshape(-1, 2))) == [(a, b) for a in range(n) for b in range(a + 1, n)]
    assert all(len(set(pairs.ravel())) == pairs.size for pairs in table)


def test_colours_are_proper():
    graph = data_gen.random_graph(40, 0.2, rng=0)
    p = data_gen.perturb(data_gen.planted(40, 3, graph, rng=0), 0.1, 1)
    start, _, other, _ = p.incidence
    order, first = plane_rotations.colours(start, other)
    assert sorted(order) == list(range(40))
    assert (first[0], first[-1]) == (0, 40)
    assert len(first) - 1 <= p.degrees.max() + 1
    colour = np.repeat(np.arange(len(first) - 1), np.diff(first))[np.argsort(order)]
    assert (colour[p.edges[:, 0]] != colour[p.edges[:, 1]]).all()


def slow_sweep(c, problem, kappa, field, over_relaxations, order, states):
    """The same pass on whole matrices, with a fresh W = Fᵀ C before every rotation."""
    count = problem.n // 2
    padded = -(-count // 4) * 4
    for i in order:
        pool, at, room = np.empty(random_streams.POOL), random_streams.POOL, np.empty((3, padded))
        force = kappa * neighbour_sums(problem, c)[i] + field[i]
        for over_relax in [True] * over_relaxations + [False]:
            for pairs in plane_rotations.rounds(problem.n):
                size = np.ones(padded)
                w = force.T @ c[i]
                size[:count] = [np.hypot(w[a, a] + w[b, b], w[a, b] - w[b, a]) for a, b in pairs]
                if not over_relax:
                    at = random_streams.von_mises_halves(size, room[0], room[1], room[2], count, states[i], pool, at)
                for k, (a, b) in enumerate(pairs):
                    w = force.T @ c[i]
                    mode = np.arctan2(w[a, b] - w[b, a], w[a, a] + w[b, b])
                    angle = 2 * mode if over_relax else mode + 2 * np.arctan2(room[1, k], room[0, k])
                    turn = np.eye(problem.n)
                    turn[[a, b], [a, b]] = np.cos(angle)
                    turn[b, a], turn[a, b] = np.sin(angle), -np.sin(angle)
                    c[i] = c[i] @ turn


@pytest.mark.parametrize(("n", "with_prior"), [(4, False), (4, True), (5, False), (2, True)])
def test_sweep_against_its_slow_twin(n, with_prior):
    truth = data_gen.planted(6, n, data_gen.random_graph(6, 0.5, rng=0), rng=0)
    p = data_gen.perturb(truth, 0.1, 1, repeats=2)
    p = fmsync.SyncProblem(6, p.edges, p.maps, weights=np.random.default_rng(2).uniform(0.5, 2, p.n_edges))
    start, edge, other, forward = p.incidence
    blocks = np.empty(2 * p.n_edges * n * n)
    plane_rotations.node_blocks(p.maps, p.weights, start, edge, forward, blocks)
    c = so.random_uniform(n, 6, rng=3)
    field = so.random_uniform(n, 6, rng=4) * 3 if with_prior else np.zeros((6, n, n))
    given = np.ascontiguousarray(so.transpose(field)) if with_prior else np.empty((0, n, n))
    states, (order, _) = random_streams.generators(np.random.default_rng(5), 6), plane_rotations.colours(start, other)
    twin, x, twin_states, gains = c.copy(), np.ascontiguousarray(so.transpose(c)), states.copy(), np.empty(6)
    plane_rotations.sweep(x, blocks, start, other, given, 5.0, 2, plane_rotations.rounds(p.n), order, states, gains)
    slow_sweep(twin, p, 5.0, field, 2, order, twin_states)
    np.testing.assert_allclose(so.transpose(x), twin, atol=1e-11)
    change = (fmsync.energy.energy(p, c) - fmsync.energy.energy(p, twin)) / 2
    assert gains.sum() == pytest.approx(change, abs=1e-9)


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
    post = fmsync.sample(p, "heat-bath", kappa=8.0, n_chains=1, n_draws=3, thin=40_000, warmup=0, rng=0)
    last = post.absolute[0, -1]
    assert np.abs(so.transpose(last) @ last - np.eye(3)).max() < 1e-10
    np.testing.assert_allclose(post.energy, fmsync.energy.energy(p, post.absolute), atol=1e-9)


def test_prior_is_sampled_with_its_own_concentration():
    """On a tree the prior on one node and the edge are independent Langevin laws."""
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


@pytest.mark.parametrize("n", [2, 3, 4, 9, 20])
def test_table_of_the_normaliser(n):
    kappa = np.exp(np.random.default_rng(n).uniform(np.log(1e-4), np.log(1e5), 200))
    exact = np.concatenate([np.atleast_1d(langevin.log_normaliser(n, k)) for k in kappa])
    table = noise_level.normaliser_table(n)
    ours = np.array([noise_level.interpolated_log_normaliser(k, table) for k in kappa])
    np.testing.assert_allclose(ours, exact, rtol=1e-8)


@pytest.mark.parametrize(("trace", "count"), [(1.0, 3.0), (40.0, 15.0), (44.9999, 15.0)])
def test_concentration_step_against_quadrature(trace, count):
    table, state = noise_level.normaliser_table(3), random_streams.generators(np.random.default_rng(0), 1)[0]
    draws, kappa = np.empty(20_000), 1.0
    for t in range(len(draws)):
        draws[t] = kappa = noise_level.draw_kappa(kappa, trace, count, 3, table, state)
    grid = np.geomspace(1e-6, 1e5, 2500)  # equal steps in log κ: the density gains a factor κ
    normaliser = np.array([float(langevin.log_normaliser(3, k)) for k in grid])
    density = grid * trace - count * normaliser + np.log(grid)
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
    assert post.settings["level_inferred"]
    assert abs(post.kappa.mean() - 12) < 4 * post.kappa.std()
    assert post.kappa.std() < 1.5
    assert fmsync.diagnostics.rhat(post.kappa) < 1.02
    with pytest.raises(ValueError, match="sigma2"):
        post.sigma2  # noqa: B018


def test_a_tree_does_not_tell_its_noise():
    truth = data_gen.planted(4, 3, nx.path_graph(4), rng=0)
    tree = data_gen.perturb(truth, 0.1, 1)
    for options in ({}, {"kappa": "auto"}, {"likelihood": "projected-gaussian"}):
        with pytest.raises(ValueError, match="tree without repeated edges"):
            fmsync.sample(tree, "heat-bath", **options)
    prior = fmsync.LangevinPrior(truth.absolute, [5.0, 0, 0, 5.0])
    for p, options in ((data_gen.perturb(truth, 0.1, 1, repeats=2), {}), (tree, {"prior": prior})):
        assert fmsync.sample(p, "heat-bath", n_draws=2, warmup=5, **options).settings["level_inferred"]


def test_chains_do_not_depend_on_their_number():
    p, start = noisy(), so.random_uniform(4, 5, rng=0)
    a, b = (
        fmsync.sample(p, "heat-bath", kappa=5.0, init=start, n_chains=k, n_draws=5, warmup=3, rng=1) for k in (2, 3)
    )
    np.testing.assert_array_equal(a.absolute, b.absolute[:2])
    assert np.abs(b.absolute[1] - b.absolute[0]).max() > 0.1


@pytest.mark.parametrize(
    ("n_nodes", "n_chains", "options"),
    [
        (24, 4, {"kappa": 5.0}),
        (24, 4, {"likelihood": "projected-gaussian"}),
        (400, 1, {"kappa": 5.0}),
        (400, 1, {"kappa": "auto"}),
    ],
)
def test_draws_do_not_depend_on_the_number_of_threads(monkeypatch, n_nodes, n_chains, options):
    """Chains side by side in the first two, nodes of one colour in the others."""
    n = 20 if n_nodes < 100 else 8
    graph = data_gen.random_graph(n_nodes, 0.5 if n_nodes < 100 else 0.02, rng=0)
    p = data_gen.perturb(data_gen.planted(n_nodes, n, graph, rng=0), 0.1, 1)
    start, shares = so.random_uniform(n, (n_chains, n_nodes), rng=2), []
    plain = thread_pool.Crew.share

    def counted(crew, work, count):
        shares.append((crew.size, count))
        plain(crew, work, count)

    monkeypatch.setattr(thread_pool.Crew, "share", counted)
    draws = []
    for threads in (1, 3):
        monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", threads)
        draws.append(
            fmsync.sample(p, "heat-bath", init=start, n_chains=n_chains, n_draws=4, warmup=0, rng=3, **options)
        )
    np.testing.assert_array_equal(draws[0].absolute, draws[1].absolute)
    np.testing.assert_array_equal(draws[0].energy, draws[1].energy)
    np.testing.assert_array_equal(draws[0].kappa, draws[1].kappa)
    shared = [count for size, count in shares if size == 3]
    assert max(shared) == n_chains if n_chains > 1 else max(shared) > 12


def test_ctrl_c_in_a_shared_step_waits_for_the_other_thread(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    finished = []

    def work(first, last):
        if first == 0:  # in the thread of the caller, the one that Ctrl-C interrupts
            raise KeyboardInterrupt
        time.sleep(0.2)
        finished.append(last)

    with pytest.raises(KeyboardInterrupt):
        thread_pool.Crew().share(work, 10)
    assert finished == [10]


def test_ctrl_c_in_a_shared_step_returns_the_draws_so_far(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 2)
    p = data_gen.perturb(data_gen.planted(24, 20, rng=0), 0.1, 1)
    options = {"kappa": 5.0, "n_chains": 4, "n_draws": 6, "warmup": 0, "rng": 3, "init": "random"}
    whole, calls, plain = fmsync.sample(p, "heat-bath", **options), [], thread_pool.Crew.share

    def interrupted(crew, work, count):
        calls.append(count)
        plain(crew, work, count)
        if len(calls) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(thread_pool.Crew, "share", interrupted)
    post = fmsync.sample(p, "heat-bath", **options)
    assert post.interrupted
    np.testing.assert_array_equal(post.absolute, whole.absolute[:, :3])


RUN = {"kappa": 5.0, "n_chains": 4, "n_draws": 3, "warmup": 0}


def test_two_runs_at_once_do_not_meet():
    p = noisy(24, 20)
    with ThreadPoolExecutor(2) as callers:
        together = list(callers.map(lambda k: _absolute(p, k, RUN), range(2)))
    for k in range(2):
        np.testing.assert_array_equal(together[k], _absolute(p, k, RUN))


@pytest.mark.slow  # the workers import everything anew
def test_joblib_workers_make_the_same_draws():
    p = noisy(24, 20)
    for k, apart in enumerate(Parallel(n_jobs=2)(delayed(_absolute)(p, k, RUN) for k in range(2))):
        np.testing.assert_array_equal(apart, _absolute(p, k, RUN))


def _absolute(problem, seed, run):
    return fmsync.sample(problem, "heat-bath", rng=seed, **run).absolute


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kappa": 0.0}, "kappa: must be finite and > 0"),
        ({"kappa": -3.0}, "kappa: must be finite and > 0"),
        ({"kappa": np.nan}, "kappa"),
        ({"kappa": "matched"}, "kappa: a number > 0 or 'auto'"),
        ({"kappa": 3.0, "beta": 1.5}, "give one of them"),
        ({"kappa": "auto", "beta": 1.5}, "give one of them"),
        ({"likelihood": "gaussian"}, "likelihood: 'langevin' or 'projected-gaussian'"),
        ({"likelihood": "projected-gaussian", "kappa": 3.0}, "infers sigma2"),
        ({"over_relaxations": -1}, "over_relaxations"),
        ({"energy": "geodesic"}, "energy: 'heat-bath' needs the Euclidean energy; 'hmc', 'mala' and 'rlfm' take"),
        ({"n_draws": 0}, "n_draws"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        fmsync.sample(noisy(), "heat-bath", **options)


def test_levels_need_rotations_and_plain_weights():
    p = noisy()
    stretched = fmsync.SyncProblem(p.n_nodes, p.edges, 1.1 * p.maps)
    for options in ({"kappa": "auto"}, {"likelihood": "projected-gaussian"}):
        with pytest.raises(ValueError, match="0 is not a rotation"):
            fmsync.sample(stretched, "heat-bath", **options)
    assert fmsync.sample(stretched, "heat-bath", kappa=2.0, n_draws=1, warmup=0).n_draws == 1
    weighted = fmsync.SyncProblem(p.n_nodes, p.edges, p.maps, np.full(p.n_edges, 2.0))
    with pytest.raises(ValueError, match="weights"):
        fmsync.sample(weighted, "heat-bath", likelihood="projected-gaussian")
