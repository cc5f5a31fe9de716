"""The compiled kernel agrees with plain products, entry by entry, in every shape of tile."""

import numpy as np
import pytest

from fmsync.block_products import add_products, products


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (2, 3, 1), (4, 4, 8), (5, 7, 3), (20, 20, 20), (3, 20, 47), (9, 2, 30), (7, 11, 13)]
)
def test_products_are_those_of_numpy(shape, dtype):
    (n, k, m), rng = shape, np.random.default_rng(0)
    a, b = rng.standard_normal((6, n, k)).astype(dtype), rng.standard_normal((6, k, m)).astype(dtype)
    close = {"atol": 50 * k * np.finfo(dtype).eps, "rtol": 0}
    np.testing.assert_allclose(products(a, b), a @ b, **close)
    np.testing.assert_allclose(products(a.swapaxes(1, 2), b, transposed=True), a @ b, **close)
    assert products(a, b).dtype == dtype


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_sums_along_lists_are_those_of_a_loop_and_leave_the_rest_alone(dtype):
    rng, n = np.random.default_rng(1), 6
    left, right = (rng.standard_normal((5, n, n)).astype(dtype) for _ in range(2))
    to, first, second = rng.integers(0, 4, 30), rng.integers(0, 5, 30), rng.integers(0, 5, 30)
    transposed, weights = rng.random(30) < 0.5, rng.random(30)
    guarded = np.full((6, n, n), 7, dtype)
    out, expected = guarded[1:5], guarded[1:5].astype(float)
    add_products(out, to, left, first, transposed, right, second, weights)
    for o, f, t, s, w in zip(to, first, transposed, second, weights):
        expected[o] += w * (left[f].T if t else left[f]).astype(float) @ right[s]
    np.testing.assert_allclose(out, expected, atol=1e3 * np.finfo(dtype).eps)
    assert (guarded[[0, 5]] == 7).all()


def test_arrays_that_are_views_are_read_as_they_are():
    rng = np.random.default_rng(2)
    a, b = rng.standard_normal((2, 8, 5, 5))
    a.setflags(write=False)
    np.testing.assert_allclose(products(a[::2], b[::-2]), a[::2] @ b[::-2], atol=1e-13)
