"""Did the chains agree, and how many independent draws are there: R-hat and ESS of gauge-invariant scalars."""

import html
import warnings
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmsync import checks
from fmsync.problem import SyncProblem

_MAX_PAIRS = 10
LARGEST_RHAT, LEAST_ESS = 1.01, 400  # otherwise chains are warned of


@dataclass(frozen=True, eq=False)
class Draws:
    """What is looked at of a :class:`fmsync.Posterior`, which says what these are."""

    problem: SyncProblem
    method: str
    absolute: np.ndarray
    energy: np.ndarray
    kappa: np.ndarray
    interrupted: bool
    settings: Mapping[str, object]


class ConvergenceWarning(UserWarning):
    """The chains disagree, or hold too few independent draws; the message says what is wrong and what to do."""


@dataclass(frozen=True, eq=False, repr=False)
class Summary:
    """Statistics of K scalars over all chains and draws; printed, and displayed by a notebook, as a table.

    All (K,): ``mean`` and ``sd`` in the unit of each scalar, rank-normalised split ``r_hat`` (:func:`rhat`), effective
    sample sizes ``ess_bulk`` and ``ess_tail`` (:func:`ess`) in draws.

    >>> one = np.ones(1)
    >>> table = Summary(("energy",), 12.5 * one, 0.25 * one, 1.001 * one, 812.4 * one, 640.2 * one)
    >>> table
             mean    sd  r_hat  ess_bulk  ess_tail
    energy  12.50  0.25  1.001       812       640
    >>> table["energy"]["ess_bulk"]
    812.4
    """

    names: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray
    r_hat: np.ndarray
    ess_bulk: np.ndarray
    ess_tail: np.ndarray

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> dict[str, float]:
        """The five statistics of one scalar by their names; ``KeyError`` when there is no such scalar."""
        if name not in self.names:
            raise KeyError(f"{name}: no scalar has this name; there are {', '.join(self.names)}")
        row = self.names.index(name)
        return {column: float(getattr(self, column)[row]) for column in _COLUMNS}

    @checks.checked()
    def head(self, count: int) -> "Summary":
        """The first ``count`` scalars."""
        return Summary(self.names[:count], *(getattr(self, column)[:count] for column in _COLUMNS))

    def __str__(self) -> str:
        rows = [("", *_COLUMNS), *self._cells()]
        first, *widths = (max(map(len, column)) for column in zip(*rows))
        return "\n".join("  ".join([name.ljust(first), *map(str.rjust, cells, widths)]) for name, *cells in rows)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        body, head = "", "".join(f"<th>{column}</th>" for column in ("", *_COLUMNS))
        for name, *cells in self._cells():
            body += f"<tr><th>{html.escape(name)}</th>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
        return f'<table class="dataframe"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'

    def _cells(self) -> list[tuple[str, ...]]:
        """Text of every row; the mean has as many decimals as the standard deviation has in two significant digits."""
        rows: list[tuple[str, ...]] = []
        for name in self.names:
            row = self[name]
            sd = row["sd"]
            decimals = int(np.clip(1 - np.floor(np.log10(sd)), 0, 8)) if np.isfinite(sd) and sd > 0 else 3
            numbers = (f"{row['mean']:.{decimals}f}", f"{sd:.{decimals}f}", f"{row['r_hat']:.3f}")
            rows.append((name, *numbers, f"{row['ess_bulk']:.0f}", f"{row['ess_tail']:.0f}"))
        return rows


_COLUMNS = ("mean", "sd", "r_hat", "ess_bulk", "ess_tail")


@checks.checked(values="chains draws")
def rhat(values: np.ndarray) -> float:
    """Rank-normalised split R-hat of (chains, draws): 1 when all chains, and both halves of each, agree.

    Near 1 is necessary, not sufficient; above 1.01 do not trust the draws (Vehtari et al. 2021). NaN for values that
    do not vary or for fewer than four draws.

    >>> noise = np.random.default_rng(0).standard_normal((4, 500))
    >>> rhat(noise) < 1.01 < rhat(noise + np.arange(4)[:, None])
    True
    """
    return _statistic("rhat", values)


@checks.checked(values="chains draws", kind=("bulk", "tail"))
def ess(values: np.ndarray, kind: str = "bulk") -> float:
    """Effective sample size of (chains, draws): ``"bulk"`` for the middle of a distribution, or ``"tail"``."""
    return _statistic("ess", values, method=kind, prob=(0.05, 0.95) if kind == "tail" else None)


def _statistic(name: str, values: np.ndarray, **options: Any) -> float:
    """Of values that vary; imported here, because beside xarray and pandas the package takes seconds to import."""
    if values.shape[1] < 4 or not np.ptp(values) > 0:
        return np.nan
    from arviz_stats.base import array_stats  # noqa: PLC0415

    return float(getattr(array_stats, name)(values, **options))


@checks.checked(edges="K 2 < N")
def scalars(post: Draws, edges: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Gauge-invariant scalars of every draw, each (chains, draws): the energy, and of some relative maps two numbers.

    ``edges`` (E, 2) are the pairs whose trace and first entry are watched; by default ten at most of the problem's own.
    """
    if edges is None:
        distinct = np.unique(post.problem.edges, axis=0)
        edges = distinct[np.linspace(0, len(distinct) - 1, min(_MAX_PAIRS, len(distinct))).astype(int)]
    values = _watched(post)
    for i, j in np.asarray(edges).tolist():
        first, second = post.absolute[:, :, i], post.absolute[:, :, j]
        values[f"tr C[{i},{j}]"] = np.einsum("ktab,ktab->kt", first, second)
        values[f"C[{i},{j}][0,0]"] = np.einsum("kta,kta->kt", first[..., 0], second[..., 0])
    return values


@checks.checked(edges="K 2 < N")
def summary(post: Draws, edges: np.ndarray | None = None) -> Summary:
    """Mean, standard deviation, R-hat, bulk and tail ESS of :func:`scalars`, one row each.

    Warns with :class:`ConvergenceWarning` when an R-hat is above 1.01 or an effective sample size below 400.
    """
    values = scalars(post, edges)
    rows = [(x.mean(), x.std(), rhat(x), ess(x, "bulk"), ess(x, "tail")) for x in values.values()]
    table = Summary(tuple(values), *np.array(rows).T)
    _warn(post.method, table.names, table.r_hat, np.fmin(table.ess_bulk, table.ess_tail))
    return table


@checks.checked()
def warn_unless_converged(post: Draws) -> None:
    """Warn when the energy or an inferred concentration has R-hat above 1.01 or fewer than 400 effective draws."""
    values = _watched(post)
    r_hat, effective = (np.array([statistic(x) for x in values.values()]) for statistic in (rhat, ess))
    _warn(post.method, tuple(values), r_hat, effective)


def _watched(post: Draws) -> dict[str, np.ndarray]:
    """The energy, and the logarithm of the concentration where it was inferred."""
    values = {"energy": post.energy}
    if post.settings.get("kappa_inferred"):
        values["log kappa"] = np.log(post.kappa)
    return values


def _warn(method: str, names: tuple[str, ...], r_hat: np.ndarray, effective: np.ndarray) -> None:
    complaints, todos = [], []
    if (r_hat > LARGEST_RHAT).any():  # NaN, of scalars that do not vary, compares false
        worst = int(np.nanargmax(r_hat))
        complaints.append(f"R-hat of {names[worst]} is {r_hat[worst]:.3f} > {LARGEST_RHAT}: the chains disagree")
        todos.append("lengthen warmup, or try method='tempered' if it stays")
    if (effective < LEAST_ESS).any():
        worst = int(np.nanargmin(effective))
        complaints.append(f"only {effective[worst]:.0f} effective draws of {names[worst]} (want {LEAST_ESS})")
        better = ", or use heat-bath where the energy is Euclidean" * (method != "heat-bath")
        todos.append(f"raise n_draws (--draws) or thin{better}")
    if complaints:
        warnings.warn("; ".join(complaints + todos), ConvergenceWarning, stacklevel=5)


def short_run() -> AbstractContextManager[object]:
    """Silence :class:`ConvergenceWarning` around one run that is short on purpose."""
    return warnings.catch_warnings(action="ignore", category=ConvergenceWarning)
