r"""Is a posterior right? Ranks of planted truths among draws, coverage of credible balls, and proper scores.

If truths come from the prior and data from the likelihood, a truth is one more draw of its posterior: its rank among
the others is uniform (simulation-based calibration, Talts et al. 2018), and a ball with 80 % of the draws holds 80 % of
the truths.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc

from fmsync import checks

_MOST_DRAWS = 200  # of the energy score, whose cost grows with their square


@checks.checked(draws="T ...", truth="...")
def rank(draws: np.ndarray, truth: ArrayLike) -> np.ndarray:
    """Share of draws (T, ...) below the truth (...): uniform on 0, 1/T, ..., 1 over problems when all is right."""
    if len(draws) == 0:
        raise ValueError("draws: need at least one along the first axis")
    if draws.shape[1:] != np.shape(truth):
        raise ValueError(f"truth: expected {draws.shape[1:]}, as the draws have it, got {np.shape(truth)}")
    return (draws < truth).mean(axis=0)


@checks.checked(ranks="P", bins=">= 2")
def uniformity(ranks: np.ndarray, n_draws: int, bins: int = 10) -> float:
    r"""p-value of the :math:`\chi^2` test that ranks (P,) among ``n_draws`` draws are uniform.

    Bins expect as many as their share of the ``n_draws + 1`` possible ranks.
    """
    if len(ranks) < 5 * bins or ranks.min() < 0 or ranks.max() > 1:
        told = f"{len(ranks)} from {min(ranks, default=0)} to {max(ranks, default=1)}"
        raise ValueError(f"ranks: expected at least {5 * bins} shares from 0 to 1 for {bins} bins, got {told}")
    possible = np.arange(n_draws + 1) * bins // (n_draws + 1)  # bin of every rank
    expected = np.bincount(possible, minlength=bins) * len(ranks) / (n_draws + 1)
    observed = np.bincount(possible[np.rint(ranks * n_draws).astype(int)], minlength=bins)
    return float(chdtrc(bins - 1, ((observed - expected) ** 2 / expected).sum()))


@checks.checked(draws=checks.array, truth="m n")
def ball_level(draws: np.ndarray, truth: np.ndarray) -> float:
    r"""Probability of the smallest credible ball that holds the truth (n, n), from draws (T, n, n) of a relative map.

    The ball is :meth:`fmsync.Posterior.credible_balls`'s: centred at the arithmetic mean, distances of draws taken to
    the mean of the others. A ball of level q covers the truth if and only if this number is at most q.
    """
    draws = _checked(draws, truth)
    mean = draws.mean(axis=0)
    others = len(draws) / (len(draws) - 1)
    distances = others * np.linalg.norm(draws - mean, axis=(1, 2))
    return float(rank(distances, np.linalg.norm(truth - mean)))


@checks.checked(draws="T K n n", truth="K n n", levels="L")
def covered(draws: np.ndarray, truth: np.ndarray, levels: ArrayLike) -> np.ndarray:
    r"""Whether credible balls of ``levels`` (L,) hold truths (K, n, n) of K maps, (L, K) booleans; splits the draws.

    The ball of a map is centred at the mean m of the *even* ``draws`` (T, K, n, n), T >= 4, and its radius is the
    quantile of :math:`\lVert X-m\rVert` over the *odd* ones. :func:`ball_level` loses no draws, and needs that they
    hardly depend on each other.
    """
    if len(draws) < 4:
        raise ValueError(f"draws: credible balls need at least four, got {len(draws)}")
    centre = draws[::2].mean(axis=0)
    radii = np.quantile(np.linalg.norm(draws[1::2] - centre, axis=(-2, -1)), np.asarray(levels), axis=0)
    return np.linalg.norm(truth - centre, axis=(-2, -1)) <= radii


@checks.checked(shares="L", levels="L")
def calibration_error(shares: ArrayLike, levels: ArrayLike) -> float:
    """Mean distance of coverage (L,) from the levels (L,) that were promised."""
    return round(float(np.abs(np.subtract(shares, levels)).mean()), 12)


@checks.checked(draws="T ... m n", truth="... m n")
def energy_score(draws: np.ndarray, truth: np.ndarray) -> float:
    r"""Energy score :math:`E\lVert C-C^*\rVert_F - \tfrac12E\lVert C-C'\rVert_F` of draws; lower is better.

    Strictly proper (Gneiting & Raftery 2007); unbiased, over all pairs of two hundred draws, evenly from those given.
    For draws (T, n, n) and truth (n, n), or (T, K, n, n) and (K, n, n) of K maps, whose scores are averaged.

    >>> energy_score(np.stack([np.eye(3)] * 5), np.eye(3))
    0.0
    """
    draws = _checked(draws, truth)
    count = min(len(draws), _MOST_DRAWS)
    chosen = draws[np.linspace(0, len(draws) - 1, count).round().astype(int)]
    near = np.linalg.norm(chosen - truth, axis=(-2, -1)).mean()
    flats = chosen.reshape(count, -1, truth.shape[-2] * truth.shape[-1])
    apart = 0.0
    for flat in np.moveaxis(flats, 1, 0):
        flat = np.ascontiguousarray(flat)
        squares = np.einsum("ta,ta->t", flat, flat)
        squared = squares[:, None] + squares - 2 * flat @ flat.T
        np.fill_diagonal(squared, 0.0)
        apart += np.sqrt(np.maximum(squared, 0)).sum()
    return float(near - apart / (flats.shape[1] * count * (count - 1)) / 2)


def _checked(draws: np.ndarray, truth: np.ndarray) -> np.ndarray:
    draws = np.asarray(draws, dtype=float)
    if draws.shape[1:] != np.shape(truth) or len(draws) < 2:
        raise ValueError(f"draws: need at least two that fit the truth {np.shape(truth)}, got shape {draws.shape}")
    return draws
