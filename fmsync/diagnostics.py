"""Did the chains agree, and how many independent draws are there: R-hat and ESS of gauge-invariant scalars."""

import warnings

import numpy as np
import pandas as pd
from arviz_stats.base import array_stats

from fmsync.samplers import Posterior

_MAX_PAIRS = 10
_LARGEST_RHAT, _LEAST_ESS = 1.01, 400


class ConvergenceWarning(UserWarning):
    """The chains disagree, or hold too few independent draws; the message says what to do."""


def rhat(values: np.ndarray) -> float:
    """Rank-normalised split R-hat of (chains, draws): 1 when all chains, and both halves of each, tell the same story.

    Near 1 is necessary, not sufficient; above 1.01 do not trust the draws (Vehtari et al. 2021). NaN for values that
    do not vary or for fewer than four draws.

    Examples
    --------
    >>> import numpy as np
    >>> from fmsync import diagnostics
    >>> noise = np.random.default_rng(0).standard_normal((4, 500))
    >>> diagnostics.rhat(noise) < 1.01 < diagnostics.rhat(noise + np.arange(4)[:, None])
    True
    """
    values = _checked(values)
    return float(array_stats.rhat(values)) if _varies(values) else np.nan


def ess(values: np.ndarray, kind: str = "bulk") -> float:
    """Effective sample size of (chains, draws): ``"bulk"`` for the middle of the law, ``"tail"`` for its quantiles.

    Examples
    --------
    >>> import numpy as np
    >>> from fmsync import diagnostics
    >>> walk = np.cumsum(np.random.default_rng(0).standard_normal((4, 500)), axis=1)
    >>> diagnostics.ess(walk) < 50
    True
    """
    if kind not in ("bulk", "tail"):
        raise ValueError(f"kind: 'bulk' or 'tail', not {kind!r}")
    values = _checked(values)
    if not _varies(values):
        return np.nan
    return float(array_stats.ess(values, method=kind, prob=(0.05, 0.95) if kind == "tail" else None))


def scalars(post: Posterior, edges: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Gauge-invariant scalars of every draw, each (chains, draws): the energy, and of some relative maps two numbers.

    ``edges`` (E, 2) are the pairs whose trace and first entry are watched; by default ten at most of the problem's own.
    """
    if edges is None:
        distinct = np.unique(post.problem.edges, axis=0)
        edges = distinct[np.linspace(0, len(distinct) - 1, min(_MAX_PAIRS, len(distinct))).astype(int)]
    values = _levels(post)
    absolute = post.kept()
    for i, j in np.asarray(edges).tolist():
        first, second = absolute[:, :, i], absolute[:, :, j]
        values[f"tr C[{i},{j}]"] = np.einsum("ktab,ktab->kt", first, second)
        values[f"C[{i},{j}][0,0]"] = np.einsum("kta,kta->kt", first[..., 0], second[..., 0])
    return values


def summary(post: Posterior, edges: np.ndarray | None = None) -> pd.DataFrame:
    """Mean, standard deviation, R-hat, bulk and tail ESS of :func:`scalars`, one row each.

    Examples
    --------
    >>> import numpy as np, fmsync
    >>> p = fmsync.SyncProblem(2, [[0, 1]], np.eye(3)[None])
    >>> fmsync.sample(p, n_chains=2, n_draws=100, warmup=50).summary().columns.tolist()
    ['mean', 'sd', 'r_hat', 'ess_bulk', 'ess_tail']
    """
    rows = {
        name: (x.mean(), x.std(), rhat(x), ess(x, "bulk"), ess(x, "tail")) for name, x in scalars(post, edges).items()
    }
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["mean", "sd", "r_hat", "ess_bulk", "ess_tail"])
    _warn(table.r_hat, table[["ess_bulk", "ess_tail"]].min(axis=1))
    return table


def warn_unless_converged(post: Posterior) -> None:
    """Warn when the energy or an inferred noise level has R-hat above 1.01 or fewer than 400 effective draws.

    :func:`summary` warns of its other scalars as well.
    """
    values = pd.Series(_levels(post))
    _warn(values.map(rhat), values.map(ess))


def _levels(post: Posterior) -> dict[str, np.ndarray]:
    """The energy, and the logarithm of the concentration where it was inferred."""
    values = {"energy": post.energy}
    if post.settings.get("level_inferred"):
        values["log kappa"] = np.log(post.kappa)
    return values


def _warn(r_hat: pd.Series, effective: pd.Series) -> None:
    complaints = []
    if (r_hat > _LARGEST_RHAT).any():
        complaints.append(
            f"R-hat of {r_hat.idxmax()} is {r_hat.max():.3f} > {_LARGEST_RHAT}: the chains tell different stories; "
            "lengthen warmup, or try method='tempered' if it stays"
        )
    if (effective < _LEAST_ESS).any():
        complaints.append(
            f"only {effective.min():.0f} effective draws of {effective.idxmin()} (want {_LEAST_ESS}): raise n_draws or "
            "thin, or use 'heat-bath' where the energy is Euclidean"
        )
    if complaints:
        warnings.warn("; ".join(complaints), ConvergenceWarning, stacklevel=4)


def _checked(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values, dtype=float)
    if values.ndim != 2:
        raise ValueError(f"values: expected (chains, draws), got shape {values.shape}")
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        raise ValueError(f"values: chain {bad[0][0]}, draw {bad[0][1]} is not finite")
    return values


def _varies(values: np.ndarray) -> bool:
    return values.shape[1] >= 4 and np.ptp(values) > 0
