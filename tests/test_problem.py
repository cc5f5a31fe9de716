"""Problems refuse bad input by name; energies agree with plain loops; derivatives with finite differences."""

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import problem as room
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
        assert room.energy(problem, c) == pytest.approx(by_loop)

    def test_neighbour_sums_match_their_definition(self, problem, c):
        sums = np.zeros_like(c)
        for (i, j), m, w in zip(problem.edges, problem.maps, problem.weights):
            sums[j] += w * c[i] @ m
            sums[i] += w * c[j] @ m.T
        np.testing.assert_allclose(room.neighbour_sums(problem, c), sums, atol=1e-12)
        shortcut = problem.constant - np.vdot(c, sums)
        assert room.energy(problem, c) == pytest.approx(shortcut)

    def test_dense_and_sparse_products_agree(self):
        dense, rng = PROBLEMS["multigraph"], np.random.default_rng(0)
        c = rng.standard_normal((3, 4, 5, 5))
        blocks = c.swapaxes(-2, -1)
        sums = room.sparse_sums(dense, blocks).swapaxes(-2, -1)
        assert dense.is_dense
        assert not PROBLEMS["sparse"].is_dense
        np.testing.assert_allclose(room.neighbour_sums(dense, c), sums, atol=1e-12)
        single = room.sparse_sums(dense, blocks.astype(np.float32), dense.maps.astype(np.float32))
        assert single.dtype == np.float32
        np.testing.assert_allclose(single.swapaxes(-2, -1), sums, atol=1e-4)

    def test_unconstrained_energy_equals_the_euclidean_one_on_rotations(self, problem, c):
        assert room.unconstrained_energy(problem, c) == pytest.approx(room.energy(problem, c))

    def test_geodesic_energy_by_loop(self):
        p = PROBLEMS["weighted"]
        c = so.random_uniform(5, 4, rng=1)
        by_loop = energy_by_loop(p, c, lambda a, m, b: np.linalg.norm(so.log(m.T @ a.T @ b)) ** 2)
        assert room.geodesic_energy(p, c) == pytest.approx(by_loop)

    def test_batches_are_independent(self, problem):
        c = so.random_uniform(problem.n, (2, 3, problem.n_nodes), rng=1)
        for function in (room.energy, room.gradient, room.unconstrained_energy):
            whole = function(problem, c)
            np.testing.assert_allclose(whole[1, 2], function(problem, c[1, 2]), atol=1e-10)

    def test_gauge_changes_nothing(self, problem, c):
        q = so.random_uniform(problem.n, (), rng=4)
        assert room.energy(problem, q @ c) == pytest.approx(room.energy(problem, c))
        np.testing.assert_allclose(room.gradient(problem, q @ c), room.gradient(problem, c), atol=1e-10)


def slope(errors, steps):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


class TestDerivatives:
    steps = np.array([3e-3, 1e-3, 3e-4])

    def test_gradient_slope(self, problem, c):
        """|f(C exp tΩ) - f - t<g,Ω>| falls as t²."""
        omega = so.skew(np.random.default_rng(1).standard_normal(c.shape))
        base, linear = room.energy(problem, c), np.vdot(room.gradient(problem, c), omega)
        errors = [abs(room.energy(problem, c @ so.exp(t * omega)) - base - t * linear) for t in self.steps]
        assert slope(errors, self.steps) == pytest.approx(2, abs=0.05)

    def test_hessian_slope(self, problem, c):
        """The second-order model along a geodesic leaves t³."""
        omega = so.skew(np.random.default_rng(1).standard_normal(c.shape))
        base, linear = room.energy(problem, c), np.vdot(room.gradient(problem, c), omega)
        quadratic = np.vdot(room.hessian(problem, c, omega), omega)
        errors = [
            abs(room.energy(problem, c @ so.exp(t * omega)) - base - t * linear - t * t / 2 * quadratic)
            for t in self.steps
        ]
        assert slope(errors, self.steps) == pytest.approx(3, abs=0.1)

    def test_hessian_is_symmetric_and_blind_to_the_gauge(self, problem, c):
        a, b = so.skew(np.random.default_rng(2).standard_normal((2, *c.shape)))
        left, right = np.vdot(room.hessian(problem, c, a), b), np.vdot(a, room.hessian(problem, c, b))
        assert left == pytest.approx(right)
        common = so.skew(np.random.default_rng(3).standard_normal((problem.n, problem.n)))
        gauge = so.transpose(c) @ common @ c  # moves all C_j by the same rotation from the left
        assert abs(np.vdot(room.gradient(problem, c), gauge)) < 1e-9
        moved = room.gradient(problem, so.exp(1e-4 * common) @ c) - room.gradient(problem, c)
        assert np.abs(moved).max() < 1e-10

    def test_geodesic_gradient_away_from_the_cut_locus(self):
        truth = data_gen.planted(4, 5, rng=1)
        p = data_gen.perturb(truth, 0.02, rng=2, two_way=True)
        c = truth.absolute @ so.exp(0.05 * so.skew(np.random.default_rng(3).standard_normal((4, 5, 5))))
        omega = so.skew(np.random.default_rng(4).standard_normal(c.shape))
        directional = np.vdot(room.geodesic_gradient(p, c), omega)
        t = 1e-5
        ahead, behind = (room.geodesic_energy(p, c @ so.exp(s * omega)) for s in (t, -t))
        assert directional == pytest.approx((ahead - behind) / (2 * t), rel=1e-6)

    def test_geodesic_gradient_batches(self):
        p = PROBLEMS["weighted"]
        c = so.random_uniform(5, (3, 4), rng=1)
        np.testing.assert_allclose(room.geodesic_gradient(p, c)[2], room.geodesic_gradient(p, c[2]), atol=1e-9)


class TestPrior:
    def test_the_anchor_carries_the_log_prior(self):
        p, kappa = PROBLEMS["multigraph"], 7.0
        prior = fmsync.LangevinPrior(so.random_uniform(5, 4, rng=0), [0.0, 2.0, 5.0, 1.0])
        whole = room.anchored(p, prior, kappa)

        def log_posterior(c):
            likelihood = sum(np.trace(m.T @ c[i].T @ c[j]) for (i, j), m in zip(p.edges, p.maps))
            return kappa * likelihood + sum(k * np.trace(m.T @ x) for k, m, x in zip(prior.kappa, prior.mean, c))

        a, b = so.random_uniform(5, (2, 4), rng=1)
        with_anchor = [np.concatenate([c, np.eye(5)[None]]) for c in (a, b)]
        by_energy = -kappa / 2 * (room.energy(whole, with_anchor[0]) - room.energy(whole, with_anchor[1]))
        assert by_energy == pytest.approx(log_posterior(a) - log_posterior(b))

    def test_bad_priors(self):
        mean = so.random_uniform(5, 4, rng=0)
        with pytest.raises(ValueError, match="node 2"):
            fmsync.LangevinPrior(mean, [1, 1, -1, 1])
        with pytest.raises(ValueError, match="leave the prior out"):
            fmsync.LangevinPrior(mean, 0.0)
        with pytest.raises(ValueError, match="node 1 is not a rotation"):
            fmsync.LangevinPrior(np.stack([mean[0], 2 * mean[1]]), 1.0)
        with pytest.raises(ValueError, match="prior.mean"):
            room.anchored(PROBLEMS["multigraph"], fmsync.LangevinPrior(mean[:2], 1.0), 1.0)
        with pytest.raises(ValueError, match="kappa"):
            room.anchored(PROBLEMS["multigraph"], fmsync.LangevinPrior(mean, 1.0), 0.0)


class TestBadInput:
    eyes = np.stack([np.eye(3)] * 3)

    @pytest.mark.parametrize(
        ("n_nodes", "edges", "maps", "words"),
        [
            (1, [[0, 0]], eyes[:1], "at least two"),
            (4, [[0, 1], [2, 3], [0, 1]], eyes, r"2 components \(0, 1; 2, 3\)"),
            (3, [[0, 1], [1, 1], [1, 2]], eyes, r"edge 1 \(1, 1\) is a self-loop"),
            (3, [[0, 1], [1, 3], [1, 2]], eyes, r"edge 1 \(1, 3\) is out of range"),
            (3, [[0, 1], [-1, 2], [1, 2]], eyes, r"edge 1 \(-1, 2\) is out of range"),
            (3, [[0.0, 1.0]], eyes[:1], "integers"),
            (3, [0, 1, 2], eyes, "expected \\(E, 2\\)"),
            (3, [[0, 1], [1, 2]], eyes, "3 maps for 2 edges"),
            (3, [[0, 1], [1, 2], [0, 2]], eyes[:, :2], "one size"),
            (3, [[0, 1], [1, 2], [0, 2]], np.where(np.arange(3)[:, None, None] == 1, np.nan, eyes), "edge 1 .*NaN"),
        ],
    )
    def test_is_refused_by_name(self, n_nodes, edges, maps, words):
        with pytest.raises(ValueError, match=words):
            fmsync.SyncProblem(n_nodes, edges, maps)

    def test_weights(self):
        edges = [[0, 1], [1, 2], [0, 2]]
        with pytest.raises(ValueError, match="edge 2 .*weight 0"):
            fmsync.SyncProblem(3, edges, self.eyes, [1, 1, 0])
        with pytest.raises(ValueError, match="expected \\(3,\\)"):
            fmsync.SyncProblem(3, edges, self.eyes, [1, 1])

    def test_arrays_are_copied_and_read_only(self):
        edges, maps = np.array([[0, 1]]), np.eye(3)[None].copy()
        p = fmsync.SyncProblem(2, edges, maps)
        maps[0, 0, 0] = 5
        assert p.maps[0, 0, 0] == 1
        with pytest.raises(ValueError, match="read-only"):
            p.maps[0, 0, 0] = 2


class TestCycleError:
    def test_consistent_maps_have_none_and_noise_has_some(self):
        truth = data_gen.planted(5, 6, rng=1)
        errors = room.cycle_error(5, truth.edges, truth.maps)
        assert errors.shape == (10,)
        assert errors.max() < 1e-12
        p = data_gen.perturb(truth, 0.1, rng=2)
        assert room.cycle_error(5, p.edges, p.maps).min() > 0.1

    def test_reversed_edges_read_as_transposes(self):
        truth = data_gen.planted(4, 3, rng=1)
        assert room.cycle_error(4, truth.edges[:, ::-1], so.transpose(truth.maps)).max() < 1e-12

    def test_a_tree_has_no_cycles(self):
        assert room.cycle_error(3, [[0, 1], [1, 2]], np.stack([np.eye(2)] * 2)).shape == (0,)


def test_networkx_edges_are_welcome():
    p = fmsync.SyncProblem(4, list(nx.complete_graph(4).edges), np.stack([np.eye(3)] * 6))
    assert p.n_edges == 6
