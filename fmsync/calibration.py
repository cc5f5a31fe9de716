r"""Is a posterior right? Ranks of planted truths among draws, coverage of credible balls, and proper scores.

If truths come from the prior and data from the likelihood, a truth is one more draw of its posterior: its rank among
the others is uniform (simulation-based calibration, Talts et al. 2018), and a ball with 80 % of the draws holds 80 % of
the truths.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from fmsync import langevin, so


def rank(draws: np.ndarray, truth: ArrayLike) -> np.ndarray:
    """Share of draws (T, ...) below the truth (...): uniform on 0, 1/T, ..., 1 over problems when all is right.

    Examples
    --------
    >>> import numpy as np
    >>> from fmsync import calibration
    >>> float(calibration.rank(np.arange(4.0), 1.5))
    0.5
    """
    draws = np.asarray(draws)
    if draws.ndim == 0 or len(draws) == 0:
        raise ValueError("draws: need at least one along the first axis")
    return (draws < truth).mean(axis=0)


def uniformity(ranks: np.ndarray, n_draws: int, bins: int = 10) -> float:
    r"""p-value of the :math:`\chi^2` test that ranks (P,) among ``n_draws`` draws are uniform.

    Small when the sampler, the likelihood or its temperature is wrong. The expected count of a bin takes into account
    how many of the ``n_draws + 1`` possible ranks fall in it.

    Examples
    --------
    >>> import numpy as np
    >>> from fmsync import calibration
    >>> u = np.random.default_rng(0).integers(0, 100, 500) / 99
    >>> calibration.uniformity(u, 99) > 0.01 > calibration.uniformity(u**2, 99)
    True
    """
    ranks = np.asarray(ranks, dtype=float)
    if ranks.ndim != 1 or len(ranks) < 5 * bins:
        raise ValueError(f"ranks: expected (P,) with P >= {5 * bins} for {bins} bins, got shape {ranks.shape}")
    possible = np.arange(n_draws + 1) * bins // (n_draws + 1)  # bin of every rank
    expected = np.bincount(possible, minlength=bins) * len(ranks) / (n_draws + 1)
    observed = np.bincount(possible[np.rint(ranks * n_draws).astype(int)], minlength=bins)
    return float(chi2.sf(((observed - expected) ** 2 / expected).sum(), bins - 1))


def ball_level(draws: np.ndarray, truth: np.ndarray) -> float:
    r"""Probability of the smallest credible ball that holds the truth (n, n), from draws (T, n, n) of a relative map.

    The ball is :meth:`fmsync.Posterior.credible_balls`'s: centred at the arithmetic mean, distances of draws taken to
    the mean of the others. A ball of level q covers the truth if and only if this number is at most q.

    Examples
    --------
    >>> import numpy as np
    >>> from fmsync import calibration, so
    >>> draws = so.random_uniform(3, 200, rng=0)
    >>> 0 <= calibration.ball_level(draws, np.eye(3)) <= 1
    True
    """
    draws = _checked(draws, truth)
    mean = draws.mean(axis=0)
    others = len(draws) / (len(draws) - 1)
    distances = others * np.linalg.norm(draws - mean, axis=(1, 2))
    return float(rank(distances, np.linalg.norm(truth - mean)))


def coverage(levels: np.ndarray, nominal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Share of truths that balls of the nominal levels cover, and its standard error.

    Parameters
    ----------
    levels
        (P, M) results of :func:`ball_level` for M maps of P problems. Maps of one problem share its noise: the error is
        that of a mean of P problem means.
    nominal
        (L,) probabilities.

    Returns
    -------
    tuple
        (L,) shares and (L,) standard errors.

    Examples
    --------
    >>> import numpy as np
    >>> from fmsync import calibration
    >>> shares, errors = calibration.coverage(np.random.default_rng(0).random((400, 5)), [0.5, 0.9])
    >>> bool((abs(shares - [0.5, 0.9]) < 4 * errors).all())
    True
    """
    levels = np.asarray(levels, dtype=float)
    if levels.ndim != 2 or len(levels) < 2:
        raise ValueError(f"levels: expected (problems, maps) with two problems at least, got shape {levels.shape}")
    covered = (levels <= np.asarray(nominal)[:, None, None]).mean(axis=2)  # (L, P)
    return covered.mean(axis=1), covered.std(axis=1, ddof=1) / np.sqrt(len(levels))


def energy_score(draws: np.ndarray, truth: np.ndarray) -> float:
    r"""Energy score :math:`E\lVert C-C^*\rVert_F - \tfrac12E\lVert C-C'\rVert_F` of draws (T, n, n); lower is better.

    Strictly proper: on average the true posterior cannot be beaten. Pairs C, C' are neighbours in a fixed shuffle.

    Examples
    --------
    >>> import numpy as np
    >>> from fmsync import calibration, so
    >>> calibration.energy_score(np.stack([np.eye(3)] * 5), np.eye(3))
    0.0
    """
    draws = _checked(draws, truth)
    order = np.random.default_rng(0).permutation(len(draws))
    pairs = np.linalg.norm(draws[order] - draws[np.roll(order, 1)], axis=(1, 2)).mean()
    return float(np.linalg.norm(draws - truth, axis=(1, 2)).mean() - pairs / 2)


def log_score(draws: np.ndarray, truth: np.ndarray) -> float:
    r"""Logarithmic score :math:`-\log\hat p(C^*)` of the matrix-Langevin law fitted to draws (T, n, n); lower is better.

    Mode: the projected mean; concentration: matched to the mean cosine, so that the fit is the maximum of the likelihood.

    Examples
    --------
    >>> import numpy as np
    >>> from fmsync import calibration, so
    >>> draws = so.exp(0.1 * so.skew(np.random.default_rng(0).standard_normal((300, 3, 3))))
    >>> calibration.log_score(draws, np.eye(3)) < 0
    True
    """  # noqa: E501
    draws = _checked(draws, truth)
    n, mean = draws.shape[-1], draws.mean(axis=0)
    mode = so.project(mean)
    kappa = langevin.matched_kappa(n, float(np.vdot(mode, mean)) / n)
    return float(langevin.log_normaliser(n, kappa) - kappa * np.vdot(mode, truth))


def _checked(draws: np.ndarray, truth: np.ndarray) -> np.ndarray:
    draws = np.asarray(draws, dtype=float)
    if draws.ndim != 3 or draws.shape[1:] != np.shape(truth) or len(draws) < 2:
        raise ValueError(f"draws: expected (T, n, n) that fit the truth {np.shape(truth)}, T >= 2, got {draws.shape}")
    return draws
