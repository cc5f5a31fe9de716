"""Descriptors: functions on a shape that an isometry keeps, computed from its Laplace–Beltrami basis.

All live on the basis of unit area, so that units do not matter. Signatures cannot tell left from right on a symmetric
shape; :func:`heat_kernel` from a few landmarks can.
"""

import numpy as np

from fmsync import checks
from fmsync.shape import Basis


@checks.checked()
def heat_kernel_signature(basis: Basis, n_times: int = 32) -> np.ndarray:
    r"""Heat kernel signature :math:`\sum_k e^{-\lambda_k t} \phi_k(x)^2 / \sum_k e^{-\lambda_k t}` (Sun et al. 2009).

    (V, ``n_times``) for a basis of at least two functions, at times log-spaced between :math:`4 \ln 10 / \lambda_n` and
    :math:`4 \ln 10 / \lambda_2`, short ones first; the area-weighted mean of every column is 1.
    """
    return _squares_averaged(basis, np.exp(-np.outer(_times(basis, n_times), basis.eigenvalues)))


@checks.checked()
def wave_kernel_signature(basis: Basis, n_energies: int = 32) -> np.ndarray:
    r"""Wave kernel signature :math:`\sum_k w_k(e) \phi_k(x)^2 / \sum_k w_k(e)` (Aubry et al. 2011).

    (V, ``n_energies``), weights :math:`w_k(e) = e^{-(e - \ln \lambda_k)^2 / 2 s^2}` at energies e evenly spaced from
    :math:`\ln \lambda_2 + 2s` to :math:`\ln \lambda_n - 2s`, s = 7 spacings; the area-weighted mean of a column is 1.
    """
    logs = np.log(_varying(basis))
    # spacing δ, width s = 7δ, range shortened by 2s at both ends: (K − 1) δ = span − 4s gives δ = span / (K + 27).
    spacing = max((logs[-1] - logs[0]) / (n_energies + 27), 1e-6)
    width = 7 * spacing
    energies = logs[0] + 2 * width + spacing * np.arange(n_energies)
    exponents = -((energies[:, None] - logs) ** 2) / (2 * width**2)  # (K, n - 1)
    exponents -= exponents.max(axis=1, keepdims=True)  # cancels in the average; keeps a narrow window from 0 / 0
    weights = np.column_stack([np.zeros(n_energies), np.exp(exponents)])  # the constant function says nothing
    return _squares_averaged(basis, weights)


@checks.checked(landmarks="L < V")
def heat_kernel(basis: Basis, landmarks: np.ndarray, n_times: int = 8) -> np.ndarray:
    r"""Heat at every vertex from a unit source at each landmark, :math:`\sum_k e^{-\lambda_k t} \phi_k(x) \phi_k(y)`.

    (V, L * n_times), the times of :func:`heat_kernel_signature` of the first landmark first, each column scaled to
    area-weighted norm 1. ``landmarks`` (L,) are vertices y, the same points in the same order on every shape.
    """
    decay = np.exp(-np.outer(_times(basis, n_times), basis.eigenvalues))  # (T, n)
    sources = basis.eigenfunctions[landmarks]  # (L, n)
    coefficients = (sources[:, None, :] * decay).reshape(-1, basis.n)  # (L T, n)
    coefficients /= np.linalg.norm(coefficients, axis=1, keepdims=True)  # Parseval: the norm of the function
    return basis.eigenfunctions @ coefficients.T


def _times(basis: Basis, n_times: int) -> np.ndarray:
    values, scale = _varying(basis), 4 * np.log(10)
    return np.geomspace(scale / values[-1], scale / values[0], n_times)


def _squares_averaged(basis: Basis, weights: np.ndarray) -> np.ndarray:
    """Mean of φ_k² (V, n) under weights (K, n): (V, K)."""
    weights = weights / weights.sum(axis=1, keepdims=True)
    return basis.eigenfunctions**2 @ weights.T


def _varying(basis: Basis) -> np.ndarray:
    """Eigenvalues (n - 1,) of all functions but the constant one."""
    if basis.n < 2:
        raise ValueError("descriptors need a basis of at least two functions: the first one is constant")
    return basis.eigenvalues[1:]
