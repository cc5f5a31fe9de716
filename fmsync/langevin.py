r"""The matrix-Langevin distribution on SO(n): normaliser, mean cosine and the concentration that matches a noise.

:math:`p(R) = \exp(\kappa\operatorname{tr}(M^\top R)) / c_n(\kappa)` with respect to the Haar probability. Weyl's
integration formula makes :math:`c_n` a Hankel determinant of the weight
:math:`e^{2\kappa x}(1-x)^{a}(1+x)^{-1/2}` on [-1, 1], a = -1/2 for even and 1/2 for odd n. Determinants overflow and
cancel; the recurrence of the orthogonal polynomials of that weight does neither (Gautschi 2004, Stieltjes procedure
on Gauss–Jacobi nodes): with :math:`\alpha_j, b_j` its coefficients and k = ⌊n/2⌋,

.. math::
    \frac{d}{d\kappa}\log c_n &= [n\ \mathrm{odd}] + 2\sum_{j<k}\alpha_j,

    \log c_n &= [n\ \mathrm{odd}]\,\kappa + \sum_{j<k} \log\frac{h_j(\kappa)}{h_j(0)},

    h_j &= h_0 b_1^2\cdots b_j^2.
"""

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.polynomial.legendre import leggauss
from numpy.typing import ArrayLike

from fmsync import checks

_LARGEST_KAPPA = 1e5
_SMALL = 2.0  # below it the norms h_j cancel too much, and log c_n is the integral of its derivative
_SERIES_NODES = 64  # c_2 = I_0(2κ) has the nearest complex zero, at 1.2 i: 64 nodes on [-2, 2] leave nothing over


def log_normaliser(n: int, kappa: float | np.ndarray) -> np.ndarray:
    r"""Logarithm of :math:`c_n(\kappa) = E_{\mathrm{Haar}} \exp(\kappa \operatorname{tr} R)` on SO(n).

    For n >= 2 and concentrations in [0, 1e5] of any shape; relative error below 1e-12 for n <= 200 and kappa <= 1e4.

    >>> float(log_normaliser(20, 10.0).round(11))
    50.22636766261
    """
    kappa, flat = _checked(n, kappa)
    result = np.empty(flat.shape)
    if (small := flat < _SMALL).any():
        result[small] = _log_normaliser_small(n, flat[small])
    if (~small).any():
        large, k = flat[~small], n // 2
        _, mass, ratio = _recurrence(n, large)
        times = 2.0 * np.arange(k - 1, 0, -1)  # b_j enters h_j, ..., h_{k-1}
        result[~small] = (n % 2) * large + k * (np.log(mass / np.pi) + 2 * large) + np.log(ratio) @ times
    return result.reshape(kappa.shape)[()]


def mean_cosine(n: int, kappa: float | np.ndarray) -> np.ndarray:
    r""":math:`\beta_n(\kappa) = E\operatorname{tr}(M^\top R)/n = \frac1n\frac{d}{d\kappa}\log c_n(\kappa)`, in [0, 1).

    Arguments as in :func:`log_normaliser`; absolute error below 1e-12.
    """
    kappa, flat = _checked(n, kappa)
    return (_derivative(n, flat) / n).reshape(kappa.shape)[()]


def matched_kappa(n: int, cosine: float) -> float:
    r"""The concentration with :math:`\beta_n(\kappa)` = ``cosine``: the inverse of :func:`mean_cosine`.

    Mean cosines <= 0 give 0. For the noise proj(I + σG), ``cosine`` is E tr Z / n
    (:func:`fmsync.bounds.projected_noise_moments`).
    """
    if checks.number("cosine", cosine) <= 0:
        return 0.0
    low, high = 0.0, 1.0
    while mean_cosine(n, high) < cosine:
        if high == _LARGEST_KAPPA:
            raise ValueError(f"cosine: {cosine} asks for a concentration above {_LARGEST_KAPPA:g}")
        low, high = high, min(2 * high, _LARGEST_KAPPA)
    while high - low > 1e-13 * high:  # bisection, eight points at a time
        grid = np.linspace(low, high, 10)
        above = np.searchsorted(mean_cosine(n, grid[1:-1]), cosine)
        if (grid[above], grid[above + 1]) == (low, high):
            break
        low, high = grid[above], grid[above + 1]
    return float((low + high) / 2)


def _checked(n: int, kappa: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    checks.count("n", n, least=2)
    kappa = checks.real("kappa", kappa).astype(float)
    flat = kappa.ravel()
    if (bad := flat[~((flat >= 0) & (flat <= _LARGEST_KAPPA))]).size:
        raise ValueError(f"kappa: concentrations lie in [0, {_LARGEST_KAPPA:g}], got {bad[0]}")
    return kappa, flat


def _derivative(n: int, kappa: np.ndarray) -> np.ndarray:
    """d/dκ log c_n for (K,) concentrations, negative ones too: then the weight is shifted to its other end."""
    sign = np.where(kappa < 0, -1.0, 1.0)
    centre, _, _ = _recurrence(n, kappa)
    return n % 2 + 2 * (sign[:, None] * (1 - centre)).sum(1)


def _log_normaliser_small(n: int, kappa: np.ndarray) -> np.ndarray:
    """log c_n = κ² ∫₀¹ u g(κu) du with g(s) = (d/ds log c_n)/s interpolated where s is large enough to divide by."""
    nodes = _SMALL * np.cos(np.pi * (np.arange(_SERIES_NODES) + 0.5) / _SERIES_NODES)  # even in number: none is 0
    values = _derivative(n, nodes) / nodes
    degrees = np.arange(_SERIES_NODES)
    cosines = np.cos(np.outer(degrees, np.pi * (np.arange(_SERIES_NODES) + 0.5) / _SERIES_NODES))
    coefficients = 2 / _SERIES_NODES * cosines @ values
    coefficients[0] /= 2
    g = Chebyshev(coefficients, domain=[-_SMALL, _SMALL])
    u, weight = leggauss(_SERIES_NODES // 2)
    u, weight = (u + 1) / 2, weight / 2
    return kappa**2 * (g(np.multiply.outer(kappa, u)) @ (weight * u))


def _recurrence(n: int, kappa: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three-term recurrence in t = 1 - x (κ >= 0) or 1 + x (κ < 0) under the weight that is 1 at t = 0.

    Returns (K, k) centres, (K,) total mass, and (K, k-1) widths b_j divided by those at κ = 0, which are
    1/√2 or 1/2. The Lanczos form with the root of the weight inside the vectors: nothing overflows.
    """
    k = n // 2
    largest = np.abs(kappa).max(initial=0)
    spread = 40 + 4 * k * np.log1p(2 * largest / k)  # nats between the peak of p_k² and what rounding keeps
    m = int(k + 60 + np.sqrt(largest * spread))
    i = np.arange(1, m + 1)
    if n % 2 == 0:
        angle, weight = (2 * i - 1) * np.pi / (2 * m), np.full(m, np.pi / m)
    else:
        angle = 2 * i * np.pi / (2 * m + 1)
        weight = 4 * np.pi / (2 * m + 1) * np.sin(angle / 2) ** 2
    near, far = 2 * np.sin(angle / 2) ** 2, 2 * np.cos(angle / 2) ** 2
    t = np.where((kappa < 0)[:, None], far, near)  # (K, m)
    vector = np.sqrt(weight * np.exp(-2 * np.abs(kappa)[:, None] * t))
    mass = (vector**2).sum(1)
    vector /= np.sqrt(mass)[:, None]
    before, width = np.zeros_like(vector), np.zeros(len(kappa))
    centres, ratios = np.empty((len(kappa), k)), np.empty((len(kappa), k - 1))
    for j in range(k):
        moved = t * vector
        centres[:, j] = (moved * vector).sum(1)
        if j == k - 1:
            break
        moved -= centres[:, j, None] * vector + width[:, None] * before
        width = np.sqrt((moved**2).sum(1))
        at_zero = np.sqrt(0.5) if j == 0 and n % 2 == 0 else 0.5
        ratios[:, j] = width / at_zero
        before, vector = vector, moved / width[:, None]
    return centres, mass, ratios
