"""A sweep of the heat bath against its slow twin."""

import numpy as np
import pytest
from scipy import stats

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
                angle = mode + slow_over_relaxed(mode, size, z, u)
                turn = np.eye(n)
                turn[[a, b], [a, b]] = np.cos(angle)
                turn[b, a], turn[a, b] = np.sin(angle), -np.sin(angle)
                c[i] = c[i] @ turn


def slow_over_relaxed(mode, size, z, u):
    """The new angle from the mode of one that was at 0: a Metropolis step from the reflected angle, ``mode``."""
    if size < 0.5:
        angle = 2 * np.arcsin(np.sin(np.pi * (u - 0.5)))
        return angle if u * 2**27 % 1 < np.exp(size * (np.cos(angle) - np.cos(mode))) else mode
    keep = plane_rotations.OVER_RELAXATION
    old = np.sin(mode / 2)
    new = keep * old + np.sqrt(1 - keep**2) * z / (2 * np.sqrt(size))
    if abs(new) >= 1:
        return mode
    target = [-2 * size * s**2 - np.log(1 - s**2) / 2 for s in (old, new)]
    normal = [-2 * size * s**2 for s in (old, new)]
    ratio = np.exp(target[1] - target[0] + normal[0] - normal[1])
    return 2 * np.arcsin(new) if u < ratio else mode


def test_functions_of_plain_arithmetic():
    x = np.linspace(-1, 1, 401)
    sines = [plane_rotations._sin(v) for v in np.pi / 2 * x]
    np.testing.assert_allclose([plane_rotations._exp(v) for v in x], np.exp(x), rtol=0, atol=1e-14)
    np.testing.assert_allclose(sines, np.sin(np.pi / 2 * x), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("n", "with_prior"), [(4, False), (4, True), (5, False), (2, True)])
def test_sweep_against_its_slow_twin(n, with_prior):
    truth = data_gen.planted(6, n, data_gen.random_graph(6, 0.5, rng=0), rng=0)
    p = data_gen.perturb(truth, 0.1, 1, repeats=2)
    p = fmsync.SyncProblem(6, p.edges, p.maps, weights=np.random.default_rng(2).uniform(0.5, 2, p.n_edges))
    c = so.random_uniform(n, 6, rng=3)
    field = so.random_uniform(n, 6, rng=4) * 3 if with_prior else np.zeros((6, n, n))
    given = np.ascontiguousarray(so.transpose(field)) if with_prior else np.empty((0, n, n))
    for kappa in (0.01, 5.0):
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


@pytest.mark.parametrize("k", [1e-13, 0.02, 0.3, 0.5, 2.0, 200.0, 1e7])
def test_over_relaxation_leaves_the_von_mises_density(k):
    """Angles drawn from it exactly are, after a move, as far from it as chance, and further apart than before."""
    rng, count = np.random.default_rng(1), 40_000
    before = rng.vonmises(0, k, count) if k < 1e5 else rng.normal(0, 1 / np.sqrt(k), count)
    along, across = k * np.cos(-before), k * np.sin(-before)  # seen from an angle the mode lies the other way
    cosine, sine = np.empty((2, count))
    plane_rotations.over_relaxed(along, across, cosine, sine, rng.standard_normal(count), rng.random(count))
    np.testing.assert_allclose(cosine**2 + sine**2, 1)
    after = 2 * np.arctan2(sine, cosine)
    np.testing.assert_allclose(along + 1j * across, np.exp(-1j * before), atol=1e-9)
    expected = stats.uniform(-np.pi, 2 * np.pi) if k < 1e-6 else stats.vonmises(k)
    if k > 1e5:
        expected = stats.norm(0, 1 / np.sqrt(k))
    assert stats.kstest(after, expected.cdf).pvalue > 1e-4
    if k >= 2:
        keep = -plane_rotations.OVER_RELAXATION
        found = np.corrcoef(np.sin(before / 2), np.sin(after / 2))[0, 1]
        assert abs(found - keep) < 4 / np.sqrt(count) + 0.5 / k
        assert np.mean(np.abs(after + before) < 1e-12) < 0.5 / k  # rejected steps leave the reflected angle


@pytest.mark.parametrize(("along", "across"), [(0.0, 0.0), (-3.0, 0.0), (-3.0, 1e-300), (3.0, 0.0), (1e-200, -1e-200)])
def test_angles_at_the_ends_stay_angles(along, across):
    a, b, cosine, sine = (np.full(4, v) for v in (along, across, 0.0, 0.0))
    plane_rotations.over_relaxed(a, b, cosine, sine, np.array([-0.3, 0.1, 2.0, 9.0]), np.array([0.0, 0.3, 0.6, 0.9]))
    np.testing.assert_allclose([a**2 + b**2, cosine**2 + sine**2], 1)
