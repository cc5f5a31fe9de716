r"""How good an answer can be: effective resistance, Cramér–Rao bounds, and a rule of thumb for large errors."""

from functools import cache

import numpy as np
import scipy.sparse as sp
from scipy.optimize import brentq
from scipy.sparse.linalg import SuperLU, splu

from fmsync import checks, so
from fmsync.langevin import mean_cosine
from fmsync.problem import SyncProblem

_MOMENT_SAMPLES = 4000  # relative standard error of w_F at n = 20: 4e-4


@checks.checked()
def grounded_laplacian(problem: SyncProblem) -> SuperLU:
    """Sparse factors of the weighted graph Laplacian without its first row and column, whose node is held at 0."""
    (i, j), n_nodes = problem.edges.T, problem.n_nodes
    ends = (np.concatenate([i, j]), np.concatenate([j, i]))
    adjacency = sp.csc_matrix((np.tile(problem.weights, 2), ends), shape=(n_nodes, n_nodes))
    laplacian = sp.diags(problem.degrees).tocsc() - adjacency
    return splu(laplacian[1:, 1:].tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


@checks.checked(n_nodes="N >= 2", edges="E 2 < N", pairs="K 2 < N", weights="E")
def effective_resistance(
    n_nodes: int, edges: np.ndarray, pairs: np.ndarray | None = None, weights: np.ndarray | None = None
) -> np.ndarray:
    r"""Resistance :math:`R_{ij} = (e_i - e_j)^\top L^+ (e_i - e_j)` between pairs of nodes, edges as conductors.

    Returns (K,) for ``pairs`` (K, 2), the edges by default, of a connected graph whose repeated edges are parallel
    conductors; ``weights`` (E,) are conductances, ones by default. It is 2/N for every pair of a complete graph.

    >>> effective_resistance(3, [[0, 1], [1, 2], [0, 2]]).round(4)
    array([0.6667, 0.6667, 0.6667])
    """
    checked = SyncProblem(n_nodes, edges, np.broadcast_to(np.eye(2), (len(edges), 2, 2)), weights)
    pairs = checked.edges if pairs is None else pairs
    grounded = grounded_laplacian(checked)
    resistance = np.empty(len(pairs))
    for first in range(0, len(pairs), 1024):  # a block of right-hand sides at a time
        block = pairs[first : first + 1024]
        unit = np.zeros((n_nodes, len(block)))
        np.add.at(unit, (block[:, 0], np.arange(len(block))), 1.0)
        np.add.at(unit, (block[:, 1], np.arange(len(block))), -1.0)
        potential = np.zeros_like(unit)
        potential[1:] = grounded.solve(unit[1:])
        resistance[first : first + 1024] = (unit * potential).sum(0)
    return resistance


@checks.checked(n_nodes="N >= 2", edges="E 2 < N", sigma2=checks.not_negative, pairs="K 2 < N")
def relative_error_bound(
    n_nodes: int, edges: np.ndarray, n: int, sigma2: float, pairs: np.ndarray | None = None
) -> np.ndarray:
    r"""Cramér–Rao bound :math:`E\lVert\hat C_{ij} - C_{ij}\rVert_F^2 \ge d\,\sigma^2 R_{ij}` of unbiased estimators.

    For maps observed with Gaussian noise of variance σ² per entry; d = n(n-1)/2 and R is the effective resistance. It
    holds where errors are small, see :func:`is_small_error`. Returns (K,) lower bounds of the mean *squared* Frobenius
    error for ``pairs`` (K, 2), the edges by default, of a connected graph with one observation per edge.

    >>> relative_error_bound(3, [[0, 1], [1, 2], [0, 2]], n=3, sigma2=0.01).round(4)
    array([0.02, 0.02, 0.02])
    """
    return n * (n - 1) / 2 * sigma2 * effective_resistance(n_nodes, edges, pairs)


@checks.checked(squared="...")
def is_small_error(n: int, squared: np.ndarray | float) -> np.ndarray:
    r"""Whether lower bounds of squared errors (K,) are small enough to hold: at most a tenth of 2n.

    2n is the mean squared distance of unrelated maps. On a path of L edges the exact error is :math:`2n(1-c^L)`, c the
    mean cosine E tr Z / n of the noise, which is 5 % below the bound where that is a tenth of 2n, and 18 % at .42.

    >>> is_small_error(15, [0.5, 12.6])
    array([ True, False])
    """
    return np.asarray(squared) <= 0.1 * 2 * n


@checks.checked(n_nodes="N >= 2", edges="E 2 < N", kappa=checks.positive, pairs="K 2 < N")
def langevin_error_bound(
    n_nodes: int, edges: np.ndarray, n: int, kappa: float, pairs: np.ndarray | None = None
) -> np.ndarray:
    r"""Cramér–Rao bound :math:`d\,R_{ij} / (\kappa\beta_n(\kappa))` under matrix-Langevin noise.

    :math:`\kappa\beta_n(\kappa)` is the Fisher information of one observation per dimension of SO(n), d = n(n-1)/2;
    :math:`\beta_n` is :func:`fmsync.langevin.mean_cosine`. ``kappa`` is the concentration of the observations, in
    (0, 1e5]; all else as in :func:`relative_error_bound`.

    >>> langevin_error_bound(3, [[0, 1], [1, 2], [0, 2]], n=3, kappa=100.0).round(4)
    array([0.0201, 0.0201, 0.0201])
    """
    information = kappa * mean_cosine(n, kappa)
    return n * (n - 1) / 2 / information * effective_resistance(n_nodes, edges, pairs)


@checks.checked(n_nodes="N >= 2", edges="E 2 < N", sigma2=checks.not_negative, pairs="K 2 < N")
def expected_rms_error(
    n_nodes: int, edges: np.ndarray, n: int, sigma2: float, pairs: np.ndarray | None = None
) -> np.ndarray:
    r"""Root-mean-square error to expect of the Frobenius MLE under the paper's noise, :math:`d\sqrt{R_{ij}/w_F}`.

    :math:`w_F = \left(\tfrac{n-1}{2}E\operatorname{tr}Z\right)^2 / E\lVert\mathrm{skew}\,Z\rVert_F^2` for
    Z = proj(I + σG): the curvature of the cost squared over the variance of its gradient. First order in the error; all
    else as in :func:`relative_error_bound`, but not squared.

    >>> import networkx as nx
    >>> float(expected_rms_error(11, list(nx.complete_graph(11).edges), n=20, sigma2=0.01)[0].round(2))
    0.6
    """
    resistance = effective_resistance(n_nodes, edges, pairs)
    if sigma2 == 0:
        return np.zeros_like(resistance)
    trace, skew_squared = projected_noise_moments(n, float(sigma2))
    information = ((n - 1) / 2 * trace) ** 2 / skew_squared
    return n * (n - 1) / 2 * np.sqrt(resistance / information)


@checks.checked(sigma2=checks.not_negative)
@cache
def projected_noise_moments(n: int, sigma2: float, n_samples: int = _MOMENT_SAMPLES) -> tuple[float, float]:
    r"""(:math:`E\operatorname{tr}Z`, :math:`E\lVert\mathrm{skew}\,Z\rVert_F^2`) of Z = proj(I + σG), by a fixed sample.

    >>> round(projected_noise_moments(20, 0.2)[0] / 20, 2)
    0.41
    """
    gaussian = np.random.default_rng(2023).standard_normal((n_samples, n, n))
    noise = so.project(np.eye(n) + np.sqrt(sigma2) * gaussian)
    return float(np.einsum("kaa->k", noise).mean()), float((so.skew(noise) ** 2).sum((1, 2)).mean())


@checks.checked(n_nodes=">= 2", n_observations=checks.positive)
def recovery_cosine(n_nodes: int, n_observations: float) -> float:
    r"""Mean cosine :math:`1/\sqrt{2E/(N-1) + 1}` of the noise below which E observations between N nodes say little.

    >>> recovery_cosine(3, 3)
    0.5
    """
    return float(1 / np.sqrt(2 * n_observations / (n_nodes - 1) + 1))


@checks.checked(n_nodes=">= 2", n=">= 2", density=checks.share)
def recovery_threshold(n_nodes: int, n: int, observations_per_pair: int = 1, density: float = 1.0) -> float:
    r"""Noise variance σ² beyond which synchronisation of a random graph is expected to recover little.

    Where the mean cosine E tr Z / n of the noise falls to :math:`1/\sqrt{k\rho N + 1}`, k observations for each of a
    fraction ρ of the pairs: there the leading eigenvectors of the connection matrix drown in its bulk (a heuristic from
    random matrices), and message passing starts to recover in the limit of many nodes (Perry et al. 2018, for Gaussian
    observations of equal signal and noise). Infinity when even σ² = 100 stays above it.

    >>> 0.35 < recovery_threshold(11, 20) < 0.5
    True
    """
    target = recovery_cosine(n_nodes, observations_per_pair * density * n_nodes * (n_nodes - 1) / 2)

    def above(log_sigma2: float) -> float:  # the same sample each time: monotone enough
        return projected_noise_moments(n, float(np.exp(log_sigma2)), n_samples=500)[0] / n - target

    low, high = np.log([1e-4, 100.0])
    return float("inf") if above(high) > 0 else float(np.exp(brentq(above, low, high, xtol=2e-3)))
