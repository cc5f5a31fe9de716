r"""Run random cells of a table of results again, here, and see whether they agree with what the table says.

Which differences are accepted depends on where the row was made and on what the run does with rounding:

``"bits"``
    The row names the arithmetic (:func:`data_gen.cache.arithmetic`), versions and code that run here: every number must
    be the same in all of its bits.
``"tolerance"``
    Anywhere else the last bits may differ. Each metric of :data:`bench.metrics.METRICS` says by how much, usually one
    part in a million.
``"rounding"``
    A method that takes no random path may still amplify the last bit: a linear program with many solutions, or two
    minima of one cost. Where a run is outside of the tolerance, it is repeated with observations whose last digits are
    moved. The row agrees if one of these runs gives its number within the tolerance, or if it lies among them.
``"Monte Carlo"``
    A chain may take another path as soon as one proposal is decided otherwise. Where a run is outside of the tolerance,
    it is repeated *on the same problem* with other random numbers, and the row has to lie within four Monte Carlo
    standard errors. Differences between problems, which are many times as large, do not enter.

With :math:`m` and :math:`s` the mean and the standard deviation of :math:`k` runs on the same problem, a row agrees if
it differs from :math:`m` by at most :math:`q\,s\sqrt{1+1/k}`, where :math:`q` is the quantile of Student's distribution
with :math:`k-1` degrees of freedom that is exceeded as rarely as four standard deviations of a normal one. All rows of
a sampler together can show a small difference that one row cannot, so their standardised differences are also added:
``"Monte Carlo together"``.
"""

import itertools
import json
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from bench import methods
from bench.cell import machine, run_cell, versions
from bench.metrics import METRICS, ROUNDING, Metric
from bench.suites import Cell, data_fingerprint
from data_gen.cache import arithmetic

RULES = ("bits", "tolerance", "rounding", "Monte Carlo", "Monte Carlo together")
N_REPLICAS = 16
_FEWEST = 3  # runs of which nothing is concluded: Student's distribution has no variance then
_SECONDS, _MEMORY = 1200.0, 16000.0
_CELL = ["suite", "generator", "problem", "label", "method", "options", "seed"]


@dataclass(frozen=True)
class Verdict:
    """How one metric of one cell compares.

    Attributes
    ----------
    cell
        What was run again.
    metric, before, now
        Its name, the value in the table and the value here: of a curve, the point that differs most, or the mean where
        runs were repeated. Where they were, ``now`` is their mean.
    interval
        Largest difference that counts as agreement.
    verdict
        "equal" in all bits, "agrees" within the interval, "differs", or the status of a cell that failed.
    rule
        One of :data:`RULES`: what was demanded.
    reason
        Why less than equal bits was demanded; empty for ``"bits"``.
    """

    cell: str
    metric: str
    before: float
    now: float
    interval: float
    verdict: str
    rule: str = "tolerance"
    reason: str = ""


@dataclass(frozen=True)
class _Repeated:
    """A number of the table, and the mean, standard deviation and count of the same number in runs of its cell."""

    name: str
    before: float
    mean: float
    deviation: float
    count: int

    @classmethod
    def of(cls, name: str, before: float, values: list[float]) -> "_Repeated":
        return cls(name, before, float(np.mean(values)), _deviation(np.array(values), _metric(name)), len(values))

    @property
    def difference(self) -> float:
        return abs(self.before - self.mean)

    @property
    def interval(self) -> float:
        """Student's quantile that is exceeded as rarely as the standard errors of the metric by a normal variable."""
        quantile = stats.t.isf(stats.norm.sf(_metric(self.name).standard_errors), self.count - 1)
        return float(quantile * self.deviation * np.sqrt(1 + 1 / self.count)) + _allowed(self.name, self.before)


_Pool = dict[tuple[str, str], dict[str, _Repeated]]  # by method and metric, then by cell


def verify(
    frame: pd.DataFrame,
    n_cells: int,
    rng: int | np.random.Generator,
    *,
    n_replicas: int = N_REPLICAS,
    run: Callable[..., dict] = run_cell,
) -> Iterator[Verdict]:
    """Run random cells of a table again, each alone, and compare all metrics but those of time, memory and batch size.

    Parameters
    ----------
    frame
        Rows of :func:`bench.results.read`.
    n_cells
        How many cells, of those that gave an answer and whose data are on this machine.
    rng
        Chooses them: seed or generator.
    n_replicas
        How often a cell is repeated whose first run is outside of the tolerance, >= 3. With 16 the quantile that stands
        for four standard errors is 5.4, with 8 it is 7.6, with 4 it is 17.
    run
        Called with a cell, and with ``replica=k`` for the repetitions; see :func:`bench.cell.run_cell`.

    Yields
    ------
    Verdict
        One for every metric of every cell, cell by cell; then one for every metric of a method of which at least two
        cells were compared by ``"Monte Carlo"``, of these cells together.

    Raises
    ------
    ValueError
        The table has no such number of cells, or there are too few replicas.

    Examples
    --------
    >>> from bench import results
    >>> from bench.cell import run_cell
    >>> from bench.suites import Cell
    >>> cell = Cell("bench.problems:rotations", {"n_nodes": 4, "n": 3, "sigma2": 0.1}, 0, "mle", "mle")
    >>> table = results.to_frame("mine", [run_cell(cell)])
    >>> {(one.rule, one.verdict) for one in verify(table, 1, rng=0)}
    {('bits', 'equal')}
    """
    if n_replicas < _FEWEST:
        raise ValueError(f"n_replicas: need at least {_FEWEST} to know how much runs vary, got {n_replicas}")
    sound = frame[(frame.status == "ok") & frame.metric.map(lambda name: _metric(name).tolerance is not None)]
    cells = sound[_CELL].drop_duplicates()
    if not 0 < n_cells <= len(cells):
        raise ValueError(f"n_cells: {n_cells} of a table of {len(cells)} cells")
    order = np.random.default_rng(rng).permutation(len(cells))
    chosen = ((row, _cell(row)) for row in cells.iloc[order].itertuples(index=False))
    here = ((row, cell) for row, cell in chosen if _is_here(cell))
    pooled: _Pool = defaultdict(dict)
    for row, cell in itertools.islice(here, n_cells):
        rows = sound[(sound.problem == row.problem) & (sound.seed == row.seed) & (sound.label == row.label)]
        rows = rows[(rows.suite == row.suite) & (rows.generator == row.generator)]
        yield from _compare(rows, cell, n_replicas, run, pooled)
    for (label, name), differences in pooled.items():
        if len(differences) > 1:
            yield _together(label, name, list(differences.values()))


def _metric(name: str | None) -> Metric:
    return METRICS.get(name) or Metric(str(name), "", "none")  # a method of another file may bring numbers of its own


def _cell(row) -> Cell:
    problem, options = json.loads(row.problem), json.loads(row.options)
    return Cell(row.generator, problem, int(row.seed), row.label, row.method, options, _SECONDS, _MEMORY)


def _is_here(cell: Cell) -> bool:
    try:
        data_fingerprint(cell.generator, cell.problem)
    except ValueError:
        return False
    return True


def _compare(
    rows: pd.DataFrame, cell: Cell, n_replicas: int, run: Callable[..., dict], pooled: _Pool
) -> Iterator[Verdict]:
    """Verdicts of a cell whose rows of the table are these; differences of chains are noted in ``pooled``."""
    reason = why_not_bits(rows.iloc[0], cell)
    first = run(cell)
    if first["status"] != "ok":
        rule = "tolerance" if reason else "bits"
        yield Verdict(str(cell), "status", np.nan, np.nan, np.nan, first["status"], rule, reason)
        return
    table, now = _curves(rows[["metric", "at", "value"]].itertuples(index=False)), _curves(first["metrics"])
    outside = []
    for name, before in table.items():
        found = _once(str(cell), name, before, now.get(name, {}), reason)
        if found.verdict == "differs" and reason:
            outside.append(name)
        else:
            yield found
    if not outside:
        return
    again = [run(cell, replica=k) for k in range(1, n_replicas + 1)]
    runs = [now, *(_curves(record["metrics"]) for record in again if record["status"] == "ok")]
    chain = methods.get(cell.method).kind == "sampler"
    for name, before in table.items():
        comparable = [curves[name] for curves in runs if curves.get(name, {}).keys() == before.keys()]
        if len(comparable) <= _FEWEST:
            if name in outside:
                yield _once(str(cell), name, before, now.get(name, {}), reason)
            continue
        if chain:
            mean = _Repeated.of(name, _mean(before), [_mean(curve) for curve in comparable])
            if mean.deviation > 0:
                pooled[cell.label, name][str(cell)] = mean
        if name in outside:
            points = [mean] if chain else [_Repeated.of(name, before[at], [c[at] for c in comparable]) for at in before]
            worst = max(points, key=lambda one: one.difference - one.interval)
            met = not chain and any(_once("", name, before, curve, reason).verdict != "differs" for curve in comparable)
            verdict = "agrees" if met or worst.difference <= worst.interval else "differs"
            rule = "Monte Carlo" if chain else "rounding"
            yield Verdict(str(cell), name, worst.before, worst.mean, worst.interval, verdict, rule, reason)


def why_not_bits(row, cell: Cell) -> str:
    """Why a row may differ in its last bits from a run of its cell here; empty if it may not.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> from bench.suites import Cell
    >>> cell = Cell("bench.problems:rotations", {"n_nodes": 4, "n": 3, "sigma2": 0.1}, 0, "mle", "mle")
    >>> why_not_bits(SimpleNamespace(machine="Z80, 1 cores, CP/M", versions="", arithmetic=None, code=None), cell)
    'made on another processor: Z80'
    """
    processor = row.machine.partition(",")[0]
    if processor != machine().partition(",")[0]:
        return f"made on another processor: {processor}"
    if row.versions != versions():
        return "made with other versions"
    told = [getattr(row, name, None) for name in ("arithmetic", "code")]
    if not all(isinstance(value, str) for value in told):
        return "made on a processor of the same name, but the table does not say in which arithmetic and by which code"
    if told[0] != arithmetic():
        return f"made in other arithmetic: {told[0]}"
    return "" if told[1] == cell.content["code"] else "made by other code"


def _curves(rows) -> dict[str, dict[float | None, float]]:
    """Values of every metric by their abscissa, which is None for a single number."""
    found: dict[str, dict[float | None, float]] = defaultdict(dict)
    for name, at, value in rows:
        if _metric(name).tolerance is not None:
            found[name][None if at is None or np.isnan(at) else float(at)] = float(value)
    return found


def _mean(curve: dict) -> float:
    return float(np.mean(list(curve.values())))


def _allowed(name: str, before: float) -> float:
    return _metric(name).tolerance * abs(before) + ROUNDING


def _once(cell: str, name: str, before: dict, now: dict, reason: str) -> Verdict:
    """Compare with one run: bit for bit if there is no reason against it, else within the tolerance of the metric."""
    rule = "tolerance" if reason else "bits"
    if before.keys() != now.keys():
        value = _mean(now) if now else np.nan
        return Verdict(cell, name, _mean(before), value, 0.0, "differs", rule, reason)
    allowed = {at: _allowed(name, value) if reason else 0.0 for at, value in before.items()}
    at = max(before, key=lambda at: abs(now[at] - before[at]) - allowed[at])
    if now == before:
        verdict = "equal"
    else:
        verdict = "agrees" if reason and abs(now[at] - before[at]) <= allowed[at] else "differs"
    return Verdict(cell, name, before[at], now[at], allowed[at], verdict, rule, reason)


def _deviation(values: np.ndarray, metric: Metric) -> float:
    """Standard deviation of runs; of a share of few edges, half a run that found 0 and half a run that found 1 join."""
    if not metric.few_edges:
        return float(values.std(ddof=1))
    values, weights = np.append(values, [0.0, 1.0]), np.append(np.ones(len(values)), [0.5, 0.5])
    mean = np.average(values, weights=weights)
    return float(np.sqrt(weights @ (values - mean) ** 2 / (weights.sum() - 1)))


def _together(label: str, name: str, repeated: list[_Repeated]) -> Verdict:
    """Compare the mean over cells, each weighed by the inverse of its standard deviation.

    Of a standardised difference the variance is that of Student's distribution times 1 + 1/k; the sum of several is
    nearly normal.
    """
    weights = np.array([1 / one.deviation for one in repeated])
    before = float(np.average([one.before for one in repeated], weights=weights))
    now = float(np.average([one.mean for one in repeated], weights=weights))
    variances = [(1 + 1 / one.count) * (one.count - 1) / (one.count - 3) for one in repeated]
    interval = _metric(name).standard_errors * np.sqrt(sum(variances)) / weights.sum()
    verdict = "agrees" if abs(before - now) <= interval else "differs"
    return Verdict(f"{label}: cells together", name, before, now, interval, verdict, "Monte Carlo together")


def agrees(verdict: Verdict) -> bool:
    """Whether this metric is no reason for doubt.

    Examples
    --------
    >>> from bench.verify import Verdict, agrees
    >>> agrees(Verdict("mle [...]", "edge_error", 2.0, 2.5, 0.002, "differs"))
    False
    """
    return verdict.verdict in ("equal", "agrees")
