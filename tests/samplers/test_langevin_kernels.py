import numpy as np
import pytest
from scipy.linalg import expm

from fmsync import so
from fmsync.samplers import langevin_kernels


@pytest.mark.parametrize("scale", [0.0, 1e-3, 0.05, 0.1, 0.3, 1.0, 10.0])
@pytest.mark.parametrize("n", [2, 3, 20])
def test_rotate_agrees_with_scipy(scale, n):
    rng = np.random.default_rng(0)
    omega = scale * so.skew(rng.standard_normal((5, n, n)))
    start = so.random_uniform(n, 5, rng)
    moved = start.copy()
    langevin_kernels.rotate(moved, omega)
    np.testing.assert_allclose(moved, start @ expm(omega), atol=1e-12)


def test_langevin_tangents_agree_with_the_formula():
    rng = np.random.default_rng(1)
    c, sums, noise = so.random_uniform(5, 7, rng), rng.standard_normal((7, 5, 5)), rng.standard_normal((7, 10))
    w = np.zeros((7, 5, 5))
    w[:, *np.triu_indices(5, 1)] = noise / np.sqrt(2)
    drift, scale = rng.random(2)
    expected = 2 * drift * so.skew(so.transpose(c) @ sums) + scale * (w - so.transpose(w))
    np.testing.assert_allclose(langevin_kernels.langevin_tangents(c, sums, noise, drift, scale), expected, atol=1e-14)


def test_reorthonormalising_squares_the_distance_from_the_group():
    rng = np.random.default_rng(2)
    rough = so.random_uniform(6, 4, rng) + 1e-5 * rng.standard_normal((4, 6, 6))
    repaired = langevin_kernels.reorthonormalised(rough)
    assert np.abs(so.transpose(repaired) @ repaired - np.eye(6)).max() < 1e-8
    assert np.abs(repaired - so.project(rough)).max() < 1e-8
