"""Generators of the suites: noise that is not the same everywhere has the concentrations that it says."""

import numpy as np

from bench.unequal import unequal
from fmsync import langevin


def residuals(by, low, high, n=6):
    """Residual rotations C*^T C (E, n, n) of some problems, and the concentrations that their provenance names."""
    problems = [unequal(seed=seed, n_nodes=12, n=n, low=low, high=high, by=by) for seed in range(4)]
    maps = [p.relative(p.problem.edges).transpose(0, 2, 1) @ p.problem.maps for p in problems]
    return np.concatenate(maps), np.array([p.problem.provenance["kappas"] for p in problems])


def test_noise_by_edge_has_the_cosine_of_its_concentration():
    z, kappas = residuals("edge", 3, 100)
    assert kappas.shape == (4, 66)
    assert kappas.min() > 3
    assert kappas.max() < 100
    off = np.trace(z, axis1=1, axis2=2) / 6 - langevin.mean_cosine(6, kappas.ravel())
    assert abs(off.mean()) < 4 * off.std() / np.sqrt(len(off))


def test_noise_by_frequency_is_weaker_where_the_concentration_is_larger():
    z, kappas = residuals("frequency", 50, 400)
    assert (np.diff(kappas[0]) < 0).all()
    pairs = 1 / (kappas[0][:, None] + kappas[0])
    expected = (pairs.sum(axis=1) - np.diag(pairs)) / 2  # of 1 - Z_aa, to first order
    lost = 1 - np.diagonal(z, axis1=1, axis2=2)
    np.testing.assert_array_less(np.abs(lost.mean(axis=0) / expected - 1), 0.05 + 4 * lost.std(axis=0) / expected / 16)
