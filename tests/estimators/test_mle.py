"""Maximum likelihood on SO(n)^N: its error against theory, and against pymanopt."""

import networkx as nx
import numpy as np
import pytest

import bench.peers  # noqa: F401  registers the peers
import fmsync
from fmsync.energy import energy, gradient


@pytest.mark.parametrize(
    ("n_nodes", "sigma2", "n_seeds", "band"),
    [(11, 0.01, 20, 0.04), (11, 0.05, 20, 0.04), (11, 0.1, 20, 0.10), (50, 0.1, 4, 0.03)],
)
def test_the_error_meets_the_expected_line(rms_ratio, n_nodes, sigma2, n_seeds, band):
    """Standard errors are about .003 (N = 11) and .002 (N = 50)."""
    assert abs(rms_ratio("mle", n_nodes, 20, sigma2, n_seeds) - 1) < band


@pytest.mark.parametrize(("sigma2", "band"), [(0.01, 0.04), (0.1, 0.10)])
def test_the_error_meets_the_line_on_two_way_multigraphs(rms_ratio, sigma2, band):
    assert abs(rms_ratio("mle", 11, 20, sigma2, 20, two_way=True) - 1) < band


@pytest.mark.parametrize("sigma2", [0.05, 0.3, 1.0])
def test_pymanopt_comes_to_the_same_cost(planted, sigma2):
    problem, _ = planted(n_nodes=8, n=6, sigma2=sigma2)
    ours = fmsync.solve(problem, "mle", restarts=5)
    theirs = fmsync.solve(problem, "mle-pymanopt", restarts=5)
    np.testing.assert_allclose(ours.cost, theirs.cost, rtol=1e-9)


@pytest.mark.parametrize("density", [1.0, 0.1])
def test_the_answer_is_a_critical_point_and_no_step_was_uphill(planted, density):
    import data_gen

    n_nodes = 40
    problem, _ = planted(n_nodes, 4, 0.2, graph=data_gen.random_graph(n_nodes, density, rng=0))
    assert problem.is_dense == (density == 1.0)
    estimate = fmsync.solve(problem, "mle", init="random", tolerance=1e-8)
    assert estimate.converged
    assert np.linalg.norm(gradient(problem, estimate.absolute)) < 1e-7
    assert (np.diff(estimate.trace.cost) < 1e-9).all()


def test_derivatives_by_autograd_agree(planted):
    pytest.importorskip("autograd")
    problem, _ = planted(n_nodes=5, n=4)
    by_hand, by_autograd = (
        fmsync.solve(problem, "mle-pymanopt", init="spectral", derivatives=kind) for kind in ("hand", "autograd")
    )
    np.testing.assert_allclose(by_hand.absolute, by_autograd.absolute, atol=1e-6)
    with pytest.raises(ValueError, match="derivatives: 'hand' or 'autograd', not 'jax'"):
        fmsync.solve(problem, "mle-pymanopt", derivatives="jax")


@pytest.mark.parametrize("sigma2", [0.0, 1e-7, 1e-3, 0.2])
def test_the_cost_is_the_energy_of_the_answer_also_where_hardly_any_is_left(planted, sigma2):
    problem, _ = planted(n_nodes=12, n=5, sigma2=sigma2)
    estimate = fmsync.solve(problem, "mle")
    np.testing.assert_allclose(estimate.cost, energy(problem, estimate.absolute), rtol=1e-10, atol=1e-20)


def test_spectral_meets_the_line_where_the_noise_is_small(rms_ratio):
    assert abs(rms_ratio("spectral", 11, 20, 0.01, 20) - 1) < 0.04


def test_spectral_by_blocks_equals_the_dense_eigensolver(planted, monkeypatch):
    from fmsync.estimators import spectral

    problem, _ = planted(n_nodes=30, n=5, sigma2=0.1, graph=nx.random_regular_graph(8, 30, seed=0))
    by_dense = fmsync.solve(problem, "spectral")  # 150 x 150
    monkeypatch.setattr(spectral, "_BLOCKS_FROM", 0)
    by_blocks = fmsync.solve(problem, "spectral")
    np.testing.assert_allclose(by_blocks.relative(), by_dense.relative(), atol=1e-4)


def test_spectral_turns_a_reflected_frame_as_a_whole(planted):
    """Eigenvectors know no orientation: half of all seeds give a frame of reflections, and no block may be torn."""
    for seed in range(6):
        problem, truth = planted(n_nodes=9, n=3, sigma2=0.01, rng=seed)
        error = np.linalg.norm(fmsync.solve(problem, "spectral").relative() - truth.maps, axis=(1, 2))
        assert error.max() < 0.5
