"""Problems and priors refuse bad input by name; cycle errors."""

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import energy as energies
from fmsync import problem as problems
from fmsync import so

EDGES = np.array([[0, 1], [1, 2], [2, 0], [0, 1], [3, 2]])  # repeated, reversed, sparse


def a_problem(n_nodes=4, n=5, edges=EDGES, rng=3, weights=None):
    rng = np.random.default_rng(rng)
    return fmsync.SyncProblem(n_nodes, edges, so.random_uniform(n, len(edges), rng), weights)


class TestPrior:
    def test_the_anchor_carries_the_log_prior(self):
        p, kappa = a_problem(), 7.0
        prior = fmsync.LangevinPrior(so.random_uniform(5, 4, rng=0), [0.0, 2.0, 5.0, 1.0])
        whole = problems.anchored(p, prior, kappa)

        def log_posterior(c):
            likelihood = sum(np.trace(m.T @ c[i].T @ c[j]) for (i, j), m in zip(p.edges, p.maps))
            return kappa * likelihood + sum(k * np.trace(m.T @ x) for k, m, x in zip(prior.kappa, prior.mean, c))

        a, b = so.random_uniform(5, (2, 4), rng=1)
        with_anchor = [np.concatenate([c, np.eye(5)[None]]) for c in (a, b)]
        by_energy = -kappa / 2 * (energies.energy(whole, with_anchor[0]) - energies.energy(whole, with_anchor[1]))
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
            problems.anchored(a_problem(), fmsync.LangevinPrior(mean[:2], 1.0), 1.0)
        with pytest.raises(ValueError, match="kappa"):
            problems.anchored(a_problem(), fmsync.LangevinPrior(mean, 1.0), 0.0)


class TestBadInput:
    eyes = np.stack([np.eye(3)] * 3)

    @pytest.mark.parametrize(
        ("n_nodes", "edges", "maps", "words"),
        [
            (1, [[0, 0]], eyes[:1], "n_nodes: an integer >= 2"),
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
        errors = problems.cycle_error(5, truth.edges, truth.maps)
        assert errors.shape == (10,)
        assert errors.max() < 1e-12
        p = data_gen.perturb(truth, 0.1, rng=2)
        assert problems.cycle_error(5, p.edges, p.maps).min() > 0.1

    def test_reversed_edges_read_as_transposes(self):
        truth = data_gen.planted(4, 3, rng=1)
        assert problems.cycle_error(4, truth.edges[:, ::-1], so.transpose(truth.maps)).max() < 1e-12

    def test_a_tree_has_no_cycles(self):
        assert problems.cycle_error(3, [[0, 1], [1, 2]], np.stack([np.eye(2)] * 2)).shape == (0,)


def test_networkx_edges_are_welcome():
    p = fmsync.SyncProblem(4, list(nx.complete_graph(4).edges), np.stack([np.eye(3)] * 6))
    assert p.n_edges == 6
