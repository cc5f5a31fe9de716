import time

import numpy as np
import pytest

import fmsync
from fmsync import so, uncertainty
from fmsync.shape import Basis


def basis(n_vertices, n=20, rng=0):
    rng = np.random.default_rng(rng)
    return Basis(np.arange(n, dtype=float), rng.standard_normal((n_vertices, n)), np.full(n_vertices, 1 / n_vertices))


def test_images_against_the_point_map_of_every_draw():
    basis_i, basis_j, draws = basis(60), basis(70, rng=1), so.random_uniform(20, 30, rng=2)
    images = uncertainty.vertex_images(draws, basis_i, basis_j, 7)
    assert images.tolist() == [fmsync.point_map(c, basis_i, basis_j)[7] for c in draws]


def test_density_counts_every_draw():
    counts = uncertainty.image_density(np.array([3, 1, 3]), 5)
    assert counts.tolist() == [0, 1, 0, 2, 0]


def test_a_hundred_draws_at_28k_vertices_take_a_tenth_of_a_second():
    basis_i, basis_j, draws = basis(10), basis(28_000, rng=1), so.random_uniform(20, 100, rng=2)
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        uncertainty.vertex_images(draws, basis_i, basis_j, 0)
        best = min(best, time.perf_counter() - start)
    assert best < 0.1


def test_bad_input_is_named():
    b = basis(10, n=4)
    with pytest.raises(ValueError, match=r"expected \(K, 4, 4\)"):
        uncertainty.vertex_images(np.eye(4), b, b, 0)
    with pytest.raises(ValueError, match=r"vertex\[0\] = 10"):
        uncertainty.vertex_images(np.eye(4)[None], b, b, 10)
    with pytest.raises(ValueError, match=r"images\[1\] = 9"):
        uncertainty.image_density([0, 9], 5)
