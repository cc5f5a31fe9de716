"""Least squares over arbitrary matrices: sparse, iterative and dense solutions are one."""

import numpy as np
import pytest

import fmsync
from fmsync.energy import unconstrained_energy
from fmsync.estimators.mle_unconstrained import precision


def dense_least_squares(problem):
    """The same minimum from the residuals themselves, one dense lstsq: C_i C_ij - C_j for every edge, C_1 = I."""
    n, size = problem.n, problem.n_nodes * problem.n
    rows = np.zeros((problem.n_edges * n, size))  # acts on the stack of C_i^T
    for e, (i, j) in enumerate(problem.edges):
        block = slice(e * n, (e + 1) * n)
        rows[block, i * n : (i + 1) * n] = np.sqrt(problem.weights[e]) * problem.maps[e].T
        rows[block, j * n : (j + 1) * n] = -np.sqrt(problem.weights[e]) * np.eye(n)
    stack = np.linalg.lstsq(rows[:, n:], -rows[:, :n], rcond=None)[0]
    return np.concatenate([np.eye(n)[None], stack.reshape(-1, n, n).transpose(0, 2, 1)])


def test_exact_iterative_and_dense_solutions_agree(planted):
    clean, _ = planted(n_nodes=6, n=4, sigma2=0.2, two_way=True)
    rng = np.random.default_rng(0)
    noisy = clean.maps + 0.1 * rng.standard_normal(
        clean.maps.shape
    )  # off the group: nothing may rely on C_ij^T C_ij = I
    problem = fmsync.SyncProblem(6, clean.edges, noisy, rng.uniform(0.5, 2, clean.n_edges))
    expected = dense_least_squares(problem)
    exact = fmsync.solve(problem, "mle-unconstrained")
    iterative = fmsync.solve(problem, "mle-unconstrained", solver="iterative", tolerance=1e-9)
    np.testing.assert_allclose(exact.absolute, expected, atol=1e-10)
    np.testing.assert_allclose(iterative.absolute, expected, atol=1e-8)
    assert iterative.converged
    np.testing.assert_allclose(exact.cost, iterative.cost, rtol=1e-12)
    assert not exact.on_group
    i, j = problem.edges[3]
    np.testing.assert_allclose(exact.relative()[3], np.linalg.inv(exact.absolute[i]) @ exact.absolute[j])


def test_without_the_gauge_the_minimiser_is_zero(planted):
    problem, _ = planted(sigma2=0.3)
    assert unconstrained_energy(problem, np.zeros((problem.n_nodes, problem.n, problem.n))) == 0
    estimate = fmsync.solve(problem, "mle-unconstrained")
    for shrink in (0.5, 0.1):  # every step towards zero pays, as soon as the first map is let go
        assert unconstrained_energy(problem, shrink * estimate.absolute) < estimate.cost


def test_precision_is_the_quadratic_form_of_the_energy(planted):
    problem, _ = planted(n_nodes=4, n=3, sigma2=0.3)
    k, b = precision(problem)
    rng = np.random.default_rng(1)

    def energy_of(x):  # (N-1, n, n), blocks C_2..C_N
        return unconstrained_energy(problem, np.concatenate([np.eye(3)[None], x]))

    def form(x):
        rows = x.transpose(1, 0, 2).reshape(3, -1)  # row r of every block
        return sum(r @ (k @ r) - 2 * b[:, index] @ r for index, r in enumerate(rows))

    x, y = rng.standard_normal((2, 3, 3, 3))
    np.testing.assert_allclose(form(x) - form(y), energy_of(x) - energy_of(y))


def test_an_unknown_solver_is_refused(planted):
    with pytest.raises(ValueError, match="solver: 'exact' or 'iterative', not 'cg'"):
        fmsync.solve(planted()[0], "mle-unconstrained", solver="cg")
