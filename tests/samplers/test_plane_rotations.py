"""A sweep of the heat bath against its slow twin."""

import numpy as np
import pytest

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
    start, _, other, _ = p.incidence
    blocks = np.empty(2 * p.n_edges * n * n)
    plane_rotations.node_blocks(p.maps, p.weights, p.incidence, blocks)
    c = so.random_uniform(n, 6, rng=3)
    field = so.random_uniform(n, 6, rng=4) * 3 if with_prior else np.zeros((6, n, n))
    given = np.ascontiguousarray(so.transpose(field)) if with_prior else np.empty((0, n, n))
    states, (order, _) = random_streams.generators(np.random.default_rng(5), 6), plane_rotations.colours(start, other)
    twin, x, twin_states, gains = c.copy(), np.ascontiguousarray(so.transpose(c)), states.copy(), np.empty(6)
    plane_rotations.sweep(
        x[None], blocks[None], start, other, given, np.array([5.0]), 2, plane_rotations.rounds(n), order,
        states[None], gains[None],
    )  # fmt: skip
    slow_sweep(twin, p, 5.0, field, 2, order, twin_states)
    np.testing.assert_allclose(so.transpose(x), twin, atol=1e-11)
    change = (fmsync.energy.energy(p, c) - fmsync.energy.energy(p, twin)) / 2
    assert gains.sum() == pytest.approx(change, abs=1e-9)
