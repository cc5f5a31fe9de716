r"""Compiled moves on SO(n)^N, batched over chains and nodes: what every gradient sampler spends its time on."""

import numba
import numpy as np

# Optimised Taylor polynomials of Bader, Blanes & Casas (2019), which spend one product on two to four further degrees.
# Degree 12, four products, in powers 0..3 of A.
_T12 = np.array(
    [
        [9.0198e-16, 0.46932117595418237389, -0.20099424927047284052, -0.04623946134063071740],
        [5.31597895759871264183, 1.19926790417132231573, 0.01179296240992997031, 0.01108844528519167989],
        [0.18188869982170434744, 0.05502798439925399070, 0.09351590770535414968, 0.00610700528898058230],
        [-2.0861320e-13, -0.13181061013830184015, -0.02027855540589259079, -0.00675951846863086359],
    ]
)
# Degree 18, five products, in powers 0, 1, 2, 3 and 6 of A.
_T18 = np.array(
    [
        [0.0, -1.00365581030144618291e-01, -8.02924648241156932449e-03, -8.92138498045729985177e-04, 0.0],
        [0.0, 0.3978497494996451, 1.3678377846041172, 0.49828962252538267, -0.0006378981945947233],
        [-10.967639605296206, 1.680158138789062, 0.05717798464788655, -0.0069821012248805206, 3.349750170860705e-05],
        [-0.09043168323908106, -0.06764045190713819, 0.06759613017704597, 0.029555257042931552, -1.391802575160607e-05],
        [0.0, 0.0, -9.23364619367118555360e-02, -1.69364939002081722752e-02, -1.40086798182036094347e-05],
    ]
)
# Largest spectral norms at which the first neglected term, norm^(m+1) / (m+1)!, is below 1e-13.
_REACH_12, _REACH_18 = 0.56, 1.6


@numba.njit(cache=True)
def rotate(c: np.ndarray, omega: np.ndarray) -> None:
    r"""Move along geodesics in place: :math:`C \leftarrow C\exp(\Omega)`, c and omega both C-contiguous (B, n, n).

    The polynomial and the number of squarings are chosen for every matrix by the bound
    :math:`\lVert\Omega\rVert_2 \le (\lVert\Omega^2\rVert_F^2/2)^{1/4}`, which holds because the singular values of a
    skew-symmetric matrix come in pairs.
    """
    n = c.shape[-1]
    a, a2, a3 = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    x, y, e = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    for k in range(len(c)):
        a[:] = omega[k]
        np.dot(a, a, a2)
        norm = (np.sum(a2 * a2) / 2) ** 0.25
        squarings = 0
        while norm > _REACH_18 and squarings < 60:
            a *= 0.5
            a2 *= 0.25
            norm *= 0.5
            squarings += 1
        np.dot(a2, a, a3)
        if norm <= _REACH_12:
            _taylor_12(a, a2, a3, x, y, e)
        else:
            _taylor_18(a, a2, a3, x, y, e)
        for _ in range(squarings):
            np.dot(e, e, x)
            e[:] = x
        np.dot(c[k], e, x)
        c[k] = x


@numba.njit(cache=True)
def _combine(row: np.ndarray, a: np.ndarray, a2: np.ndarray, a3: np.ndarray, out: np.ndarray) -> None:
    """Out = row[0] I + row[1] A + row[2] A² + row[3] A³."""
    n = len(a)
    for r in range(n):
        for s in range(n):
            out[r, s] = row[1] * a[r, s] + row[2] * a2[r, s] + row[3] * a3[r, s]
        out[r, r] += row[0]


@numba.njit(cache=True)
def _taylor_12(a: np.ndarray, a2: np.ndarray, a3: np.ndarray, x: np.ndarray, y: np.ndarray, e: np.ndarray) -> None:
    _combine(_T12[3], a, a2, a3, x)
    np.dot(x, x, y)
    _combine(_T12[2], a, a2, a3, x)
    y += x  # A6 = B3 + B4²
    _combine(_T12[1], a, a2, a3, x)
    x += y
    np.dot(x, y, e)
    _combine(_T12[0], a, a2, a3, x)
    e += x  # B1 + (B2 + A6) A6


@numba.njit(cache=True)
def _taylor_18(a: np.ndarray, a2: np.ndarray, a3: np.ndarray, x: np.ndarray, y: np.ndarray, e: np.ndarray) -> None:
    a6 = np.dot(a3, a3)
    _combine(_T18[0], a, a2, a3, x)
    _combine(_T18[4], a, a2, a3, e)
    e += _T18[4, 4] * a6
    np.dot(x, e, y)
    _combine(_T18[3], a, a2, a3, x)
    y += x
    y += _T18[3, 4] * a6  # A9 = B1 B5 + B4
    _combine(_T18[2], a, a2, a3, x)
    x += _T18[2, 4] * a6
    x += y
    np.dot(x, y, e)
    _combine(_T18[1], a, a2, a3, x)
    e += x
    e += _T18[1, 4] * a6  # B2 + (B3 + A9) A9


@numba.njit(cache=True)
def langevin_tangents(
    c: np.ndarray, sums: np.ndarray, noise: np.ndarray, drift: float, noise_scale: float
) -> np.ndarray:
    r"""Tangent vectors (B, n, n) :math:`\Omega = 2d\,\mathrm{skew}(C^\top S) + sW`, d the drift and s the noise scale.

    W is a standard normal skew-symmetric matrix in the Frobenius product: entries above the diagonal are ``noise``
    (B, n(n-1)/2) divided by √2.
    """
    batch, n = c.shape[0], c.shape[-1]
    omega = np.empty((batch, n, n))
    m = np.empty((n, n))
    half = noise_scale / np.sqrt(2.0)
    for k in range(batch):
        np.dot(c[k].T, sums[k], m)
        t = 0
        for r in range(n):
            omega[k, r, r] = 0.0
            for s in range(r + 1, n):
                value = drift * (m[r, s] - m[s, r]) + half * noise[k, t]
                omega[k, r, s] = value
                omega[k, s, r] = -value
                t += 1
    return omega


def reorthonormalised(c: np.ndarray) -> np.ndarray:
    r"""Take the rounding off nearly orthogonal (..., n, n) by one Newton step :math:`C(3I - C^\top C)/2`.

    It squares the distance from the group, so that after any number of moves what is left is rounding.
    """
    return c @ (1.5 * np.eye(c.shape[-1]) - 0.5 * (np.swapaxes(c, -1, -2) @ c))
