"""Energies agree with plain loops, derivatives with finite differences."""

import copy

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import energy as energies
from fmsync import so

EDGES = np.array([[0, 1], [1, 2], [2, 0], [0, 1], [3, 2]])  # repeated, reversed, sparse


def a_problem(n_nodes=4, n=5, edges=EDGES, rng=3, weights=None):
    rng = np.random.default_rng(rng)
    return fmsync.SyncProblem(n_nodes, edges, so.random_uniform(n, len(edges), rng), weights)


def sparse_problem():
    graph = data_gen.random_graph(40, 0.08, rng=1)
    return data_gen.perturb(data_gen.planted(40, 4, graph, rng=2), 0.3, rng=3)


PROBLEMS = {
    "multigraph": a_problem(),
    "weighted": a_problem(weights=[0.5, 2.0, 1.0, 3.0, 0.1]),
    "sparse": sparse_problem(),
    "not orthogonal": fmsync.SyncProblem(4, EDGES, np.random.default_rng(5).standard_normal((5, 5, 5))),
}


@pytest.fixture(params=PROBLEMS, scope="module")
def problem(request):
    return PROBLEMS[request.param]


@pytest.fixture
def c(problem):
    return so.random_uniform(problem.n, problem.n_nodes, rng=9)


def energy_by_loop(p, c, term):
    return sum(w * term(c[i], m, c[j]) for (i, j), m, w in zip(p.edges, p.maps, p.weights))


class TestEnergies:
    def test_euclidean_energy_is_the_sum_over_edges(self, problem, c):
        by_loop = energy_by_loop(problem, c, lambda a, m, b: np.linalg.norm(a.T @ b - m) ** 2)
        assert energies.energy(problem, c) == pytest.approx(by_loop)

    def test_neighbour_sums_match_their_definition(self, problem, c):
        sums = np.zeros_like(c)
        for (i, j), m, w in zip(problem.edges, problem.maps, problem.weights):
            sums[j] += w * c[i] @ m
            sums[i] += w * c[j] @ m.T
        np.testing.assert_allclose(energies.neighbour_sums(problem, c), sums, atol=1e-12)
        shortcut = problem.constant - np.vdot(c, sums)
        assert energies.energy(problem, c) == pytest.approx(shortcut)

    def test_dense_and_sparse_products_agree(self):
        dense, rng = PROBLEMS["multigraph"], np.random.default_rng(0)
        sparse = copy.copy(dense)
        sparse.__dict__["is_dense"] = False
        c = rng.standard_normal((3, 4, 5, 5))
        blocks, sums = c.swapaxes(-2, -1), energies.neighbour_sums(dense, c)
        assert dense.is_dense
        assert not PROBLEMS["sparse"].is_dense
        for problem in (dense, sparse):
            np.testing.assert_allclose(energies.neighbour_sums(problem, c), sums, atol=1e-12)
            np.testing.assert_allclose(energies.transposed_sums(problem, blocks).swapaxes(-2, -1), sums, atol=1e-12)
        single = energies.transposed_sums(sparse, blocks.astype(np.float32), sparse.maps.astype(np.float32))
        assert single.dtype == np.float32
        np.testing.assert_allclose(single.swapaxes(-2, -1), sums, atol=1e-4)

    def test_unconstrained_energy_equals_the_euclidean_one_on_rotations(self, problem, c):
        assert energies.unconstrained_energy(problem, c) == pytest.approx(energies.energy(problem, c))

    def test_geodesic_energy_by_loop(self):
        p = PROBLEMS["weighted"]
        c = so.random_uniform(5, 4, rng=1)
        by_loop = energy_by_loop(p, c, lambda a, m, b: np.linalg.norm(so.log(m.T @ a.T @ b)) ** 2)
        assert energies.geodesic_energy(p, c) == pytest.approx(by_loop)

    def test_batches_are_independent(self, problem):
        c = so.random_uniform(problem.n, (2, 3, problem.n_nodes), rng=1)
        for function in (energies.energy, energies.gradient, energies.unconstrained_energy):
            whole = function(problem, c)
            np.testing.assert_allclose(whole[1, 2], function(problem, c[1, 2]), atol=1e-10)

    def test_gauge_changes_nothing(self, problem, c):
        q = so.random_uniform(problem.n, (), rng=4)
        assert energies.energy(problem, q @ c) == pytest.approx(energies.energy(problem, c))
        np.testing.assert_allclose(energies.gradient(problem, q @ c), energies.gradient(problem, c), atol=1e-10)


def slope(errors, steps):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


class TestDerivatives:
    steps = np.array([3e-3, 1e-3, 3e-4])

    def test_gradient_slope(self, problem, c):
        """|f(C exp tΩ) - f - t<g,Ω>| falls as t²."""
        omega = so.skew(np.random.default_rng(1).standard_normal(c.shape))
        base, linear = energies.energy(problem, c), np.vdot(energies.gradient(problem, c), omega)
        errors = [abs(energies.energy(problem, c @ so.exp(t * omega)) - base - t * linear) for t in self.steps]
        assert slope(errors, self.steps) == pytest.approx(2, abs=0.05)

    def test_hessian_slope(self, problem, c):
        """The second-order model along a geodesic leaves t³."""
        omega = so.skew(np.random.default_rng(1).standard_normal(c.shape))
        base, linear = energies.energy(problem, c), np.vdot(energies.gradient(problem, c), omega)
        quadratic = np.vdot(energies.hessian(problem, c, omega), omega)
        errors = [
            abs(energies.energy(problem, c @ so.exp(t * omega)) - base - t * linear - t * t / 2 * quadratic)
            for t in self.steps
        ]
        assert slope(errors, self.steps) == pytest.approx(3, abs=0.1)

    def test_hessian_is_symmetric_and_blind_to_the_gauge(self, problem, c):
        a, b = so.skew(np.random.default_rng(2).standard_normal((2, *c.shape)))
        left, right = np.vdot(energies.hessian(problem, c, a), b), np.vdot(a, energies.hessian(problem, c, b))
        assert left == pytest.approx(right)
        common = so.skew(np.random.default_rng(3).standard_normal((problem.n, problem.n)))
        gauge = so.transpose(c) @ common @ c  # moves all C_j by the same rotation from the left
        assert abs(np.vdot(energies.gradient(problem, c), gauge)) < 1e-9
        moved = energies.gradient(problem, so.exp(1e-4 * common) @ c) - energies.gradient(problem, c)
        assert np.abs(moved).max() < 1e-10

    def test_geodesic_gradient_away_from_the_cut_locus(self):
        truth = data_gen.planted(4, 5, rng=1)
        p = data_gen.perturb(truth, 0.02, rng=2, two_way=True)
        c = truth.absolute @ so.exp(0.05 * so.skew(np.random.default_rng(3).standard_normal((4, 5, 5))))
        omega = so.skew(np.random.default_rng(4).standard_normal(c.shape))
        directional = np.vdot(energies.geodesic_energy_and_gradient(p, c)[1], omega)
        t = 1e-5
        ahead, behind = (energies.geodesic_energy(p, c @ so.exp(s * omega)) for s in (t, -t))
        assert directional == pytest.approx((ahead - behind) / (2 * t), rel=1e-6)

    def test_geodesic_gradient_batches(self):
        p = PROBLEMS["weighted"]
        c = so.random_uniform(5, (3, 4), rng=1)
        together, alone = (energies.geodesic_energy_and_gradient(p, x)[1] for x in (c, c[2]))
        np.testing.assert_allclose(together[2], alone, atol=1e-9)

    def test_geodesic_energy_and_gradient_by_loop(self):
        p = PROBLEMS["weighted"]
        c = so.random_uniform(5, (2, 4), rng=1)
        energy, gradient = energies.geodesic_energy_and_gradient(p, c)
        by_loop = np.zeros(c.shape)
        for state, found in zip(c, by_loop):
            for (i, j), observed, weight in zip(p.edges, p.maps, p.weights):
                relative = state[i].T @ state[j]
                pull = 2 * weight * so.log(observed.T @ relative)
                found[j] += pull
                found[i] -= relative @ pull @ relative.T
        np.testing.assert_allclose(gradient, by_loop, atol=1e-12)
        np.testing.assert_allclose(energy, energies.geodesic_energy(p, c))
        assert (p.edges[:, 0] > p.edges[:, 1]).any()
        assert energies.geodesic_energy_and_gradient(p, c[:0])[1].shape == (0, 4, 5, 5)
