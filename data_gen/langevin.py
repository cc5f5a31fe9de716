r"""Exact draws from the matrix-Langevin distribution :math:`p(Z)\propto\exp(\kappa\operatorname{tr}Z)` on SO(n).

The density depends on the rotation angles of Z alone. By Weyl's integration formula the cosines :math:`x=\cos\theta` of
the k = ⌊n/2⌋ angles have the joint density :math:`\prod_{i<j}(x_i-x_j)^2\prod_i w(x_i)`: they are a projection
determinantal process, drawn one by one without rejection (Hough, Krishnapur, Peres & Virág 2006). The planes are a Haar
frame.
"""

import numpy as np

from fmsync import checks, so

_GRID = 1024  # angles; drawing one cell and then uniformly within it errs by the square of its width
_CHUNK = 512


def langevin_noise(n: int, kappa: float, size: int, rng: int | np.random.Generator = 0) -> np.ndarray:
    """Rotations (size, n, n) around the identity with concentration kappa >= 0; 0 is Haar.

    >>> noise = langevin_noise(4, 30.0, 500, rng=0)
    >>> bool(abs(np.trace(noise, axis1=1, axis2=2).mean() - 3.90) < 0.02)
    True
    """
    kappa, rng, k = checks.not_negative("kappa", kappa), np.random.default_rng(rng), n // 2
    grid, width, functions = _orthonormal_functions(n, kappa)
    angles = np.empty((size, k))  # in the order drawn
    for first in range(0, size, _CHUNK):
        count = min(_CHUNK, size - first)
        span = np.broadcast_to(np.eye(k), (count, k, k)).copy()  # rows: what is left of the function space
        for step in range(k):
            left = span[:, : k - step]
            density = ((left @ functions.T) ** 2).sum(axis=1)  # (count, grid)
            cumulative = density.cumsum(axis=1)
            level = rng.random(count) * cumulative[:, -1]
            cell = np.minimum((cumulative < level[:, None]).sum(axis=1), len(grid) - 1)
            angles[first : first + count, step] = grid[cell] + width * (rng.random(count) - 0.5)
            span[:, : k - step - 1] = _without(left, np.einsum("brk,bk->br", left, functions[cell]))
    angles *= rng.choice([-1.0, 1.0], angles.shape)
    blocks = np.zeros((size, n, n))
    blocks[:, n - 1, n - 1] = 1.0  # of odd n; overwritten for even n
    first = 2 * np.arange(k)
    blocks[:, first, first] = blocks[:, first + 1, first + 1] = np.cos(angles)
    blocks[:, first + 1, first] = np.sin(angles)
    blocks[:, first, first + 1] = -np.sin(angles)
    frame = so.random_uniform(n, size, rng)
    return frame @ blocks @ so.transpose(frame)


def _orthonormal_functions(n: int, kappa: float) -> tuple[np.ndarray, float, np.ndarray]:
    r"""Cell midpoints θ (G,), their width, and the first k polynomials in cos θ, orthonormal under the weight, (G, k).

    The weight is :math:`e^{2\kappa\cos\theta}` dθ, times :math:`1-\cos\theta` for odd n.
    """
    k = n // 2
    # beyond this angle the weight, even against the polynomials' growth, is below rounding
    reach = np.pi if kappa == 0 else min(np.pi, np.arccos(max(-1.0, 1 - (40 + 6 * k) / (2 * kappa))))
    width = reach / _GRID
    grid = (np.arange(_GRID) + 0.5) * width
    log_weight = 2 * kappa * (np.cos(grid) - 1) + (np.log1p(-np.cos(grid)) if n % 2 else 0.0)
    centred = 2 * (np.cos(grid) - np.cos(reach)) / (1 - np.cos(reach)) - 1  # in [-1, 1]
    chebyshev = np.cos(np.arange(k) * np.arccos(np.clip(centred, -1, 1))[:, None])
    functions, _ = np.linalg.qr(np.exp(log_weight / 2)[:, None] * chebyshev)
    return grid, width, functions


def _without(rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Orthonormal rows (B, r-1, k) of the part of the span of rows (B, r, k) that vanishes at the drawn point.

    ``values`` (B, r) are the functions' values there; a Householder reflection turns them into the first axis.
    """
    normal = values / np.linalg.norm(values, axis=1, keepdims=True)
    normal = normal * np.where(normal[:, :1] < 0, -1.0, 1.0)
    normal[:, 0] += 1.0  # ‖v + e‖² = 2 (1 + v_0), never small after the sign change
    scale = 2 / (normal**2).sum(axis=1)
    reflected = rows - (scale[:, None] * normal)[:, :, None] * np.einsum("br,brk->bk", normal, rows)[:, None, :]
    return reflected[:, 1:]
