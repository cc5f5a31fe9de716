"""``tolerance="statistical"``: stop where the data say no more, and begin again cheaply."""

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import energy
from fmsync.bounds import relative_error_bound
from fmsync.estimators import spectral
from fmsync.estimators.mle import _tenth_of_noise
from fmsync.estimators.trust_region import Rotations


def a_problem(kappa=20.0, n_nodes=150, n=5, rng=0):
    graph = data_gen.random_graph(n_nodes, 20 / n_nodes, rng=[rng, 0])
    truth = data_gen.planted(n_nodes, n, graph, rng=[rng, 1])
    return data_gen.perturb(truth, kappa=kappa, noise="langevin", rng=[rng, 2]), truth


@pytest.mark.parametrize("kappa", [3.0, 20.0, 300.0])
def test_it_is_a_tenth_of_the_gradient_at_the_truth(kappa):
    """Its square has thousands of terms; the formula for the concentration is off by less than a fifth at n = 5."""
    problem, truth = a_problem(kappa)
    true = np.linalg.norm(energy.gradient(problem, truth.absolute))
    found = _tenth_of_noise(problem, fmsync.solve(problem, "mle").cost)
    assert found == pytest.approx(true / 10, rel=0.25)


def test_what_is_left_is_small_beside_the_standard_error():
    problem, _ = a_problem()
    rough, exact = (fmsync.solve(problem, "mle", tolerance=t) for t in ("statistical", 1e-8))
    assert rough.converged
    assert rough.trace.gradient_norm[-1] > 1e-4
    laplacian = np.diag(problem.degrees)
    np.subtract.at(laplacian, (*problem.edges.T,), 1)
    np.subtract.at(laplacian, (*problem.edges.T[::-1],), 1)
    worst = problem.degrees.mean() / np.linalg.eigvalsh(laplacian)[1]
    left = ((rough.relative() - exact.relative()) ** 2).sum((1, 2)).mean()
    bound = relative_error_bound(problem.n_nodes, problem.edges, problem.n, 1 / 20.0).mean()
    assert left < 0.1**2 * worst * bound


def test_a_tree_and_maps_without_noise_are_still_met():
    truth = data_gen.planted(6, 4, rng=0)
    exact = data_gen.perturb(truth, 0.0, 1)
    assert fmsync.solve(exact, "mle", tolerance="statistical").cost < 1e-10
    with pytest.raises(ValueError, match="tolerance"):
        fmsync.solve(exact, "mle", tolerance="statistics")


def test_a_solve_after_a_small_change_costs_a_third(monkeypatch):
    """Iterations, those of the spectral start and of conjugate gradients, after 2 % of the edges are observed anew."""
    problem, truth = a_problem(kappa=3.0, n_nodes=300)
    before = fmsync.solve(problem, "mle", tolerance="statistical")
    other = data_gen.perturb(truth, kappa=3.0, noise="langevin", rng=9)
    changed = np.random.default_rng(1).permutation(problem.n_edges)[: problem.n_edges // 50]
    maps = problem.maps.copy()
    maps[changed] = other.maps[changed]
    new, count = fmsync.SyncProblem(problem.n_nodes, problem.edges, maps), []

    def counted(function):
        return lambda *given: count.append(1) or function(*given)

    monkeypatch.setattr(spectral, "transposed_sums", counted(spectral.transposed_sums))
    monkeypatch.setattr(Rotations, "hessian", counted(Rotations.hessian))

    def iterations(**options):
        count.clear()
        assert fmsync.solve(new, "mle", tolerance="statistical", **options).converged
        return len(count)

    assert 1 <= iterations(init=before) <= iterations() / 3
