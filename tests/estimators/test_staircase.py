"""The staircase: global optima where a start is caught, bounds that hold, and never worse than plain descent."""

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import so
from fmsync.block_krylov import largest_eigenpairs
from fmsync.energy import energy, neighbour_sums
from fmsync.estimators import staircase


def ring(n_nodes, n):
    """A ring of identity maps, and the local minimum that turns the first plane once around it."""
    edges = [(i, (i + 1) % n_nodes) for i in range(n_nodes)]
    angle = 2 * np.pi * np.arange(n_nodes) / n_nodes
    wound = np.tile(np.eye(n), (n_nodes, 1, 1))
    wound[:, 0, 0], wound[:, 0, 1], wound[:, 1, 0], wound[:, 1, 1] = (
        np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle),
    )  # fmt: skip
    return fmsync.SyncProblem(n_nodes, edges, np.stack([np.eye(n)] * n_nodes)), wound


def hard(seed, n_nodes=11, n=20, sigma2=0.6):
    return data_gen.perturb(data_gen.planted(n_nodes, n, rng=[seed, 1]), sigma2, rng=[seed, 2])


def relaxed_optimum(problem, rank, rounds=1500):
    """Least cost over maps with ``rank`` rows, node by node: each the polar factor of its neighbours' sum."""
    rng = np.random.default_rng(0)
    y = np.linalg.qr(rng.standard_normal((problem.n_nodes, rank, problem.n)))[0]
    for _ in range(rounds):
        for node in range(problem.n_nodes):
            u, _, vt = np.linalg.svd(neighbour_sums(problem, y)[node], full_matrices=False)
            y[node] = u @ vt
    return problem.constant - sum(
        2 * weight * np.trace(observed.T @ y[i].T @ y[j])
        for (i, j), weight, observed in zip(problem.edges, problem.weights, problem.maps)
    )


@pytest.mark.parametrize("n_nodes", [9, 12, 15])
@pytest.mark.parametrize("n", [2, 3, 5])
def test_a_ring_wound_once_is_unwound_and_certified(n_nodes, n):
    problem, wound = ring(n_nodes, n)
    assert fmsync.solve(problem, "mle", init=wound).cost > 1  # 4 N (1 - cos(2 pi / N))
    found = fmsync.solve(problem, "staircase", init=wound, tolerance=1e-9)
    assert found.converged
    assert found.cost < 1e-12
    assert fmsync.certify(problem, found).certified
    assert found.n_iterations == 1


@pytest.mark.parametrize("seed", [8, 11])
def test_beyond_the_threshold_the_answer_improves_and_the_gap_is_stated(seed):
    """Problems whose plain answer is not the best known."""
    problem = hard(seed)
    plain, found = fmsync.solve(problem, "mle"), fmsync.solve(problem, "staircase")
    assert found.cost <= plain.cost
    assert found.lower_bound <= fmsync.solve(problem, "mle", restarts=5).cost
    stated = fmsync.certify(problem, found)
    np.testing.assert_allclose(stated.gap_bound, found.cost - found.lower_bound)
    assert stated.gap_bound < 0.05 * found.cost < fmsync.certify(problem, plain).gap_bound
    assert not stated.certified


@pytest.mark.parametrize(("n_nodes", "n", "density"), [(5, 3, 1.0), (8, 2, 0.5), (6, 4, 1.0)])
@pytest.mark.parametrize("seed", range(3))
def test_the_lower_bound_is_the_optimum_of_the_relaxation(n_nodes, n, density, seed):
    graph = data_gen.random_graph(n_nodes, density, rng=seed)
    clean = data_gen.perturb(data_gen.planted(n_nodes, n, graph, rng=seed), 2.0, rng=seed + 1)
    weights = np.random.default_rng(seed).uniform(0.5, 2, clean.n_edges)
    problem = fmsync.SyncProblem(n_nodes, clean.edges, clean.maps, weights)
    found = fmsync.solve(problem, "staircase", group="O")
    optimum = relaxed_optimum(problem, rank=n_nodes * n)
    assert found.lower_bound <= optimum + 1e-6
    assert found.lower_bound >= optimum - 0.055 * (found.cost - optimum) - 1e-5 * found.cost
    assert found.cost <= fmsync.solve(problem, "mle", group="O").cost + 1e-9


def test_derivatives_of_the_lifted_cost():
    problem = hard(0, n_nodes=5, n=4)
    rng = np.random.default_rng(1)
    model = staircase._Lifts(problem, 7)
    y = np.linalg.qr(rng.standard_normal((5, 7, 4)))[0]
    v = rng.standard_normal(y.shape)
    v -= y @ so.sym(so.transpose(y) @ v)
    point, step = model.evaluate(y), 1e-4
    ahead, behind = (model.evaluate(model.retract(point, s * v)) for s in (step, -step))
    np.testing.assert_allclose((ahead.cost - behind.cost) / (2 * step), np.vdot(point.gradient, v), rtol=1e-6)
    second = (ahead.cost - 2 * point.cost + behind.cost) / step**2
    np.testing.assert_allclose(second, np.vdot(v, model.hessian(point, v)), rtol=1e-4)
    square = so.random_uniform(4, 5, rng)
    np.testing.assert_allclose(staircase._Lifts(problem, 4).evaluate(square).cost, energy(problem, square))


def test_what_is_certified_at_once_is_the_answer_of_mle():
    problem = data_gen.perturb(data_gen.planted(8, 5, rng=0), 0.05, rng=1)
    plain, found = fmsync.solve(problem, "mle"), fmsync.solve(problem, "staircase")
    np.testing.assert_array_equal(found.absolute, plain.absolute)
    assert found.n_iterations == 0
    np.testing.assert_allclose(found.lower_bound, plain.cost, rtol=1e-6)


def test_a_lower_bound_counts_for_its_own_problem_only():
    problem, other = hard(0, n=4), hard(1, n=4)
    found = fmsync.solve(problem, "staircase")
    assert fmsync.certify(other, found) == fmsync.certify(other, found.absolute)


def test_more_eigenvalues_coincide_than_are_asked_for():
    """As the zeros of a certificate do; the blocks of the search then outgrow what is asked for."""
    diagonal = np.concatenate([np.full(60, 2.0), np.linspace(0.1, 1, 540)])
    values, _ = largest_eigenpairs(lambda x: diagonal[:, None] * x, 600, 20)
    np.testing.assert_allclose(values, 2)


def test_a_sparse_problem_beyond_the_dense_eigensolvers():
    problem, wound = ring(180, 3)
    start = np.linalg.matrix_power(wound[1], 3)
    start = np.stack([np.linalg.matrix_power(start, k) for k in range(180)])
    found = fmsync.solve(problem, "staircase", init=start)
    assert fmsync.solve(problem, "mle", init=start).cost > 1
    assert found.cost < 1e-6


def test_wrong_options_are_refused_in_words():
    problem = hard(0, n_nodes=4, n=3)
    with pytest.raises(ValueError, match="rank: 'staircase' has no such option; it takes init, group, tolerance"):
        fmsync.solve(problem, "staircase", rank=5)
    with pytest.raises(ValueError, match="group"):
        fmsync.solve(problem, "staircase", group="U")
    with pytest.raises(ValueError, match="init: node 0 is not a rotation"):
        fmsync.solve(problem, "staircase", init=np.zeros((4, 3, 3)))
    with pytest.warns(RuntimeWarning, match="'staircase' stopped after"):
        fmsync.solve(problem, "staircase", init="random", max_iterations=1)
