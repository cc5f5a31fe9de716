"""A sweep of the heat bath against its slow twin."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import ive

import data_gen
import fmsync
from fmsync import so
from fmsync.energy import neighbour_sums
from fmsync.samplers import plane_rotations, random_streams


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


def slow_sweep(c, problem, kappa, field, order, states):
    """The same pass on whole matrices, with a fresh W = Fᵀ C before every rotation."""
    n, count = problem.n, problem.n // 2
    for i in order:
        _, *numbers = plane_rotations.plane_room(plane_rotations.rounds(n))
        normal, level = (a.reshape(-1, 8) for a in numbers)
        random_streams.normals(states[i], normal)
        random_streams.fill(states[i], level)
        force = kappa * neighbour_sums(problem, c)[i] + field[i]
        for r, pairs in enumerate(plane_rotations.rounds(n)):
            w = force.T @ c[i]
            for k, (a, b) in enumerate(pairs):
                size, mode = np.hypot(w[a, a] + w[b, b], w[a, b] - w[b, a]), 0.0
                if size > 0:
                    mode = np.arctan2(w[a, b] - w[b, a], w[a, a] + w[b, b])
                z, u = normal.flat[r * count + k], level.flat[r * count + k]
                angle = mode + slow_over_relaxed(mode, size, z, u, states[i])
                turn = np.eye(n)
                turn[[a, b], [a, b]] = np.cos(angle)
                turn[b, a], turn[a, b] = np.sin(angle), -np.sin(angle)
                c[i] = c[i] @ turn


def slow_over_relaxed(mode, size, z, u, state):
    """The new angle from the mode of one that was at 0: a Metropolis step from the reflected angle, ``mode``."""
    if size < 10 or u < 1 / 32:
        cosine, sine = plane_rotations.von_mises_half(size, state)
        return 2 * np.arctan2(sine, cosine)
    keep = plane_rotations.OVER_RELAXATION
    old = np.sin(mode / 2)
    new = keep * old + np.sqrt(1 - keep**2) * z / (2 * np.sqrt(size))
    if abs(new) >= 1:
        return mode
    target = [-2 * size * s**2 - np.log(1 - s**2) / 2 for s in (old, new)]
    normal = [-2 * size * s**2 for s in (old, new)]
    ratio = np.exp(target[1] - target[0] + normal[0] - normal[1])
    return 2 * np.arcsin(new) if (u - 1 / 32) * 32 / 31 < ratio else mode


@pytest.mark.parametrize(("n", "with_prior"), [(4, False), (4, True), (5, False), (2, True)])
def test_sweep_against_its_slow_twin(n, with_prior):
    truth = data_gen.planted(6, n, data_gen.random_graph(6, 0.5, rng=0), rng=0)
    p = data_gen.perturb(truth, 0.1, 1, repeats=2)
    p = fmsync.SyncProblem(6, p.edges, p.maps, weights=np.random.default_rng(2).uniform(0.5, 2, p.n_edges))
    c = so.random_uniform(n, 6, rng=3)
    field = so.random_uniform(n, 6, rng=4) * 3 if with_prior else np.zeros((6, n, n))
    given = np.ascontiguousarray(so.transpose(field)) if with_prior else np.empty((0, n, n))
    for kappa in (0.01, 5.0, 50.0):
        states, (order, _) = random_streams.generators(np.random.default_rng(5), 6), _order(p)
        twin, x, twin_states, gains = c.copy(), np.ascontiguousarray(so.transpose(c)), states.copy(), np.empty(6)
        table = plane_rotations.rounds(n)
        plane_rotations.sweep(x, p.maps, p.weights, p.incidence, given, kappa, table, order, states, gains)
        slow_sweep(twin, p, kappa, field, order, twin_states)
        np.testing.assert_allclose(so.transpose(x), twin, atol=1e-11)
        change = (fmsync.energy.energy(p, c) - fmsync.energy.energy(p, twin)) / 2
        assert gains.sum() == pytest.approx(change, abs=1e-9)


def _order(problem):
    return plane_rotations.colours(*problem.incidence[::2])


def moved(angle, k, rng, state):
    """Angles (M,) from the mode after one move of angles from the mode, with the cosines and sines of their halves."""
    along, across = k * np.cos(-angle), k * np.sin(-angle)  # seen from an angle the mode lies the other way
    cosine, sine, size = np.empty((3, len(angle)))
    normal, level = rng.standard_normal(len(angle)), rng.random(len(angle))
    plane_rotations.over_relaxed(along, across, cosine, sine, size, normal, level, len(angle), state)
    np.testing.assert_allclose(cosine**2 + sine**2, 1)
    if k > 1e-100:
        np.testing.assert_allclose([along, across, size], [np.cos(angle), np.sin(-angle), np.full_like(angle, k)])
    return 2 * np.arctan2(sine, cosine)


@pytest.mark.parametrize("k", [0.0, 1e-158, 1e-13, 0.3, 2.0, 9.999, 10.0, 12.0, 200.0, 1e7])
def test_moves_leave_the_von_mises_density(k):
    """After a move exact draws are as far from the density as chance, and after 200 moves those from afar as well."""
    rng, state, count = np.random.default_rng(1), random_streams.generators(np.random.default_rng(2), 1)[0], 40_000
    expected = stats.uniform(-np.pi, 2 * np.pi) if k < 1e-6 else stats.vonmises(k)
    if k > 1e5:
        expected = stats.norm(0, 1 / np.sqrt(k))
    before = rng.vonmises(0, k, count) if k < 1e5 else rng.normal(0, 1 / np.sqrt(k), count)
    after = moved(before, k, rng, state)
    assert stats.kstest(after, expected.cdf).pvalue > 1e-4
    if k >= 10:
        fresh = 1 / 32 + 1 / (6 * k)  # in either case the angle does not remember in the usual way
        found = np.corrcoef(np.sin(before / 2), np.sin(after / 2))[0, 1]
        assert abs(found + plane_rotations.OVER_RELAXATION) < 4 / np.sqrt(count) + fresh
        reflected = np.mean(np.abs(after + before) < 1e-12)  # what a rejected step leaves
        assert abs(reflected * 13 * k - 1) < 0.1 + 4 * np.sqrt(13 * k / count)
    far = np.full(4000, np.pi)
    for _ in range(400):
        far = moved(far, k, rng, state)
    assert stats.kstest(far, expected.cdf).pvalue > 1e-4


@pytest.mark.parametrize("k", [0.0, 1e-13, 0.3, 1.99, 2.0, 5.0, 200.0, 1e7])
def test_von_mises_draws(k):
    state = random_streams.generators(np.random.default_rng(1), 1)[0]
    half = np.array([plane_rotations.von_mises_half(k, state) for _ in range(20_000)])
    np.testing.assert_allclose((half**2).sum(1), 1)
    angle = 2 * np.arctan2(half[:, 1], half[:, 0])
    expected = stats.uniform(-np.pi, 2 * np.pi) if k < 1e-6 else stats.vonmises(k)
    if k > 1e5:
        expected = stats.norm(0, 1 / np.sqrt(k))
    assert stats.kstest(angle, expected.cdf).pvalue > 1e-4
    if 0.1 < k < 1e3:
        cosine = np.cos(angle)
        assert abs(cosine.mean() - ive(1, k) / ive(0, k)) < 4 * cosine.std() / np.sqrt(len(cosine))


def test_the_envelope_lies_above_the_von_mises_density():
    """The bounds 2.4 and 1.14 that the rejections rest on, over all k and all angles."""
    k = np.concatenate([np.linspace(0, 5, 501), np.geomspace(5, 1e9, 200)])[:, None]
    w = 1 / (8 * k + 0.5)
    z = np.minimum(np.concatenate([w * np.linspace(0, 30, 1000), np.tile(np.linspace(0, 1, 2000), (len(k), 1))], 1), 1)
    ratio = np.exp(-8 * k * z / (1 + z) ** 2) * (1 + z / w) ** 1.5 / (1 + z)
    assert (ratio <= np.where(k >= 2, 1.14, 2.4)).all()


@pytest.mark.parametrize(("along", "across"), [(0.0, 0.0), (-3.0, 0.0), (-30.0, 1e-300), (3.0, 0.0), (1e-158, -1e-158)])
def test_angles_at_the_ends_stay_angles(along, across):
    a, b, cosine, sine, size = (np.full(4, v) for v in (along, across, 0.0, 0.0, 0.0))
    normal, level = np.array([-0.3, 0.1, 2.0, 9.0]), np.array([0.0, 0.3, 0.6, 0.9])
    state = random_streams.generators(np.random.default_rng(1), 1)[0]
    plane_rotations.over_relaxed(a, b, cosine, sine, size, normal, level, 4, state)
    np.testing.assert_allclose([a**2 + b**2, cosine**2 + sine**2], 1)
