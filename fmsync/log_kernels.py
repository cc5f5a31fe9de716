r"""Compiled parts of logarithms and projections: a series near the identity, polar factors.

One matrix at a time, so that its powers stay in the cache.
"""

import numba
import numpy as np

from fmsync.block_products import add_product

_WHOLE = (0, 0, 0)  # where all matrices begin


@numba.njit(cache=True, nogil=True)
def log_series(r: np.ndarray, terms: np.ndarray, reach: float, out: np.ndarray, near: np.ndarray) -> None:
    r"""Logarithms ``out`` (B, n, n) of rotations, K times a polynomial of X, and ``near`` (B,), of which they are good.

    With S and K the symmetric and the skew part, :math:`X = (I - S)/2` has the eigenvalues :math:`\sin^2(\theta/2)`, of
    which the largest is at most :math:`\lVert X^4\rVert_F^{1/4}`: this must be below ``reach``. ``terms`` (T, 4) are
    the coefficients; Horner's rule in the fourth power of X.
    """
    n = r.shape[1]
    shape, rows = (n, n, n), (n, 1)
    x, x2, x3, x4 = np.empty(n * n), np.empty(n * n), np.empty(n * n), np.empty(n * n)
    total, following = np.empty(n * n), np.empty(n * n)
    for k in range(len(r)):
        for a in range(n):
            for b in range(n):
                x[a * n + b] = -(r[k, a, b] + r[k, b, a]) / 4
            x[a * n + a] += 0.5
        x2[:], x3[:], x4[:] = 0.0, 0.0, 0.0
        add_product(x2, x, x, _WHOLE, rows, shape, 1.0)
        near[k] = np.dot(x2, x2) < n**0.5 * reach**4  # at most √n ‖X⁴‖_F
        if near[k]:
            add_product(x4, x2, x2, _WHOLE, rows, shape, 1.0)
            near[k] = np.dot(x4, x4) < reach**8
        if not near[k]:
            continue
        add_product(x3, x2, x, _WHOLE, rows, shape, 1.0)
        total[:] = 0.0
        for t in range(len(terms) - 1, -1, -1):
            for a in range(n * n):
                following[a] = terms[t, 1] * x[a] + terms[t, 2] * x2[a] + terms[t, 3] * x3[a]
            following[:: n + 1] += terms[t, 0]
            add_product(following, x4, total, _WHOLE, rows, shape, 1.0)
            total, following = following, total
        for a in range(n):
            for b in range(n):
                x[a * n + b] = (r[k, a, b] - r[k, b, a]) / 2
        following[:] = 0.0
        add_product(following, total, x, _WHOLE, rows, shape, 1.0)
        for a in range(n):
            for b in range(n):
                out[k, a, b] = (following[a * n + b] - following[b * n + a]) / 2


@numba.njit(cache=True, nogil=True)
def newton_schulz(x: np.ndarray, least: float, steps: int, last: np.ndarray) -> None:
    r"""Take x (B, n, n), C-contiguous, to their polar factors in place: :math:`X \leftarrow sX(3I - s^2X^\top X)/2`.

    The scales s are the best for singular values in [least, 1] (Chen & Chow 2014). ``last`` (B,) gets the largest entry
    by which the right factor of the last step differed from I.
    """
    n = x.shape[1]
    shape, rows, columns = (n, n, n), (n, 1), (1, n)
    here, there, factor = np.empty(n * n), np.empty(n * n), np.empty(n * n)
    for k in range(len(x)):
        flat, low, worst = x[k].reshape(-1), least, 0.0
        here[:] = flat
        for _ in range(steps):
            s = np.sqrt(3 / (1 + low + low * low))
            low *= s * (3 - s * s * low * low) / 2
            there[:], factor[:] = 0.0, 0.0
            for a in range(n):
                factor[a * n + a] = 1.5 * s
            add_product(factor, here, here, _WHOLE, columns, shape, -0.5 * s * s * s)
            add_product(there, here, factor, _WHOLE, rows, shape, 1.0)
            here, there = there, here
        flat[:] = here
        for a in range(n * n):
            worst = np.maximum(worst, abs(factor[a] - (a % (n + 1) == 0)))  # NaN stays
        last[k] = worst
