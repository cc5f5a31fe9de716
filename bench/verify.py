r"""Repeat random runs of a table of results, here, and see whether they agree with what the table says.

* ``"bits"``: the row names the arithmetic (:func:`data_gen.cache.arithmetic`), versions and code that run here, so that
  every number must be the same in all of its bits.
* ``"tolerance"``: anywhere else they may differ by what the metric says in :data:`bench.metrics.METRICS`.
* ``"rounding"``: a linear program with many solutions or two minima of one cost amplify the last bit. A run outside of
  the tolerance is repeated with observations whose last digits are moved; the row agrees if one of these runs gives its
  number within the tolerance, or if it lies among them.
* ``"Monte Carlo"``: a chain takes another path as soon as one proposal is decided otherwise. A run outside of the
  tolerance is repeated *on the same problem* with other random numbers. The row agrees if it is within
  :math:`q\,s\sqrt{1+1/k}` of the mean of these k runs, s their standard deviation and q the quantile of Student's
  distribution that is exceeded as rarely as four standard deviations of a normal one.
* ``"Monte Carlo together"``: standardised differences of all rows of a sampler, added: these show less than one can.
"""

import json
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd
from scipy import stats

from bench import methods
from bench.cache import data_hash
from bench.metrics import METRICS, STANDARD_ERRORS, Metric
from bench.provenance import machine, versions
from bench.runner import isolated
from bench.suites import Run
from data_gen.cache import arithmetic

RULES = ("bits", "tolerance", "rounding", "Monte Carlo", "Monte Carlo together")
_FEWEST = 3  # runs of which nothing is concluded: Student's distribution has no variance then
_LIMITS = (1200.0, 16000.0)  # seconds and MB
_RUN = ["suite", "generator", "problem", "label", "method", "options", "seed"]

Curve = dict[float | None, float]  # values of a metric by their abscissa, which is None for a single number


@dataclass(frozen=True)
class Verdict:
    """How one metric of one run compares: the value in the table, the value here, the largest difference allowed.

    Of a curve these are of the point that differs most, of runs that were repeated several times of their mean.
    ``verdict`` is "equal" in all bits, "agrees" within the interval, "differs", or the status of a run that failed;
    ``rule`` is what was demanded, one of :data:`RULES`; ``reason`` says why not equal bits, and is empty for "bits".
    """

    run: str
    metric: str
    before: float
    now: float
    interval: float
    verdict: str
    rule: str
    reason: str = ""

    @property
    def agrees(self) -> bool:
        """Whether this metric is no reason for doubt."""
        return self.verdict in ("equal", "agrees")


class Repeated:
    """A number of the table beside the same number in several runs: mean, deviation, and how far it may be off."""

    def __init__(self, name: str, before: float, values: list[float]):
        metric, self.count = _metric(name), len(values)
        self.before, self.mean = before, float(np.mean(values))
        self.deviation = _deviation(np.array(values), metric)
        quantile = stats.t.isf(stats.norm.sf(STANDARD_ERRORS), self.count - 1)
        self.interval = float(quantile * self.deviation * np.sqrt(1 + 1 / self.count)) + metric.allowed(before)
        self.excess = abs(before - self.mean) - self.interval


def verify(
    frame: pd.DataFrame,
    n_runs: int,
    rng: int | np.random.Generator,
    *,
    n_replicas: int = 16,
    execute: Callable[..., dict] = isolated,
) -> Iterator[Verdict]:
    """Repeat random runs of a table, each alone, and compare all metrics but those of time, memory and batch size.

    One verdict for every metric of every run, then one for every metric of a method of which at least two runs were
    compared by ``"Monte Carlo"``, of these together. Runs are chosen by ``rng`` among those of the ``frame`` (see
    :func:`bench.results.read`) that gave an answer and whose data are here; one outside of the tolerance is repeated
    ``n_replicas`` >= 3 times (with 16 the quantile of four standard errors is 5.4, with 8 7.6, with 4 17).
    """
    if n_replicas < _FEWEST:
        raise ValueError(f"n_replicas: need at least {_FEWEST} to know how much runs vary, got {n_replicas}")
    sound = frame[(frame.status == "ok") & frame.metric.map(lambda name: _metric(name).tolerance is not None)]
    number = sound.groupby(_RUN, sort=False).ngroup()
    count = number.max() + 1
    if not 0 < n_runs <= count:
        raise ValueError(f"n_runs: {n_runs} of a table of {count} runs")
    pooled: dict[tuple[str, str], list[Repeated]] = defaultdict(list)  # by method and metric
    for k in np.random.default_rng(rng).permutation(count):
        rows = sound[number == k]
        row = rows.iloc[0]
        problem, options = json.loads(row.problem), json.loads(row.options)
        module = row.generator.partition(":")[0]
        if module.partition(".")[0] != "bench" and module not in sys.modules:
            raise ValueError(f"generator: {row.generator!r} is not part of bench; import it if you trust the table")
        run = Run(row.generator, problem, int(row.seed), row.label, row.method, options, *_LIMITS)
        try:
            data_hash(run.generator, run.problem)
        except ValueError:
            continue  # its data are not here
        yield from _compare(rows, run, n_replicas, execute, pooled)
        if (n_runs := n_runs - 1) == 0:
            break
    for (label, name), repeated in pooled.items():
        if len(repeated) > 1:
            yield together(label, name, repeated)


def _metric(name: str | None) -> Metric:
    return METRICS.get(name) or Metric(str(name), "", "none")  # a method of another file may bring numbers of its own


def _compare(rows: pd.DataFrame, run: Run, n_replicas: int, execute: Callable, pooled: dict) -> Iterable[Verdict]:
    """Verdicts of a run whose rows of the table are these; numbers of chains are added to ``pooled``."""
    reason = _why_not_bits(rows.iloc[0], run)
    once = partial(_once, str(run), reason)
    first = execute(run)
    if first["status"] != "ok":
        return [replace(once("status", {None: np.nan}, {}), verdict=first["status"])]
    table, now = _curves(rows[["metric", "at", "value"]].itertuples(index=False)), _curves(first["metrics"])
    found = {name: once(name, before, now.get(name, {})) for name, before in table.items()}
    outside = {name for name, one in found.items() if reason and not one.agrees}
    again = [execute(run, replica=k) for k in range(1, n_replicas + 1)] if outside else []
    curves = [now, *(_curves(record["metrics"]) for record in again if record["status"] == "ok")]
    chain = methods.get(run.method).kind == "sampler"
    for name, before in table.items():
        alike = [one[name] for one in curves if one.get(name, {}).keys() == before.keys()]
        if len(alike) <= _FEWEST:
            continue
        if chain:
            means = [float(np.mean(list(curve.values()))) for curve in (before, *alike)]
            points = [Repeated(name, means[0], means[1:])]
            pooled[run.label, name] += [one for one in points if one.deviation > 0]
        elif name in outside:
            points = [Repeated(name, before[at], [curve[at] for curve in alike]) for at in before]
        if name in outside:
            worst = max(points, key=lambda one: one.excess)
            met = not chain and any(once(name, before, curve).agrees for curve in alike)
            verdict = "agrees" if met or worst.excess <= 0 else "differs"
            numbers = worst.before, worst.mean, worst.interval
            found[name] = Verdict(str(run), name, *numbers, verdict, "Monte Carlo" if chain else "rounding", reason)
    return found.values()


def _why_not_bits(row, run: Run) -> str:
    """Why a row may differ in its last bits from a run here; empty if it may not."""
    there, here = row.machine.partition(",")[0], machine().partition(",")[0]
    told = [getattr(row, name, None) for name in ("arithmetic", "code")]
    silent = "made on a processor of the same name, but the table does not say in which arithmetic and by which code"
    reasons = {
        f"made on another processor: {there}": there != here,
        "made with other versions": row.versions != versions(),
        silent: not all(isinstance(value, str) for value in told),
        f"made in other arithmetic: {told[0]}": told[0] != arithmetic(),
        "made by other code": told[1] != run.code,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def _curves(rows) -> dict[str, Curve]:
    found: dict[str, Curve] = defaultdict(dict)
    for name, at, value in rows:
        if _metric(name).tolerance is not None:
            found[name][None if at is None or np.isnan(at) else float(at)] = float(value)
    return found


def _once(run: str, reason: str, name: str, before: Curve, now: Curve) -> Verdict:
    """Compare with one run: bit for bit if there is no reason against it, else within the tolerance of the metric."""
    rule = "tolerance" if reason else "bits"
    if before.keys() != now.keys():
        return Verdict(run, name, next(iter(before.values())), np.nan, 0.0, "differs", rule, reason)
    allowed = {at: _metric(name).allowed(value) if reason else 0.0 for at, value in before.items()}
    at = max(before, key=lambda at: abs(now[at] - before[at]) - allowed[at])
    within = reason and abs(now[at] - before[at]) <= allowed[at]
    verdict = "equal" if now == before else "agrees" if within else "differs"
    return Verdict(run, name, before[at], now[at], allowed[at], verdict, rule, reason)


def _deviation(values: np.ndarray, metric: Metric) -> float:
    """Standard deviation of runs; of a share of few edges, half a run that found 0 and half a run that found 1 join."""
    if not metric.few_edges:
        return float(values.std(ddof=1))
    values, weights = np.append(values, [0.0, 1.0]), np.append(np.ones(len(values)), [0.5, 0.5])
    return float(np.sqrt(weights @ (values - np.average(values, weights=weights)) ** 2 / (weights.sum() - 1)))


def together(label: str, name: str, repeated: list[Repeated]) -> Verdict:
    """Compare the mean over runs, each weighed by the inverse of its standard deviation."""
    weights = np.array([1 / one.deviation for one in repeated])
    before = float(np.average([one.before for one in repeated], weights=weights))
    now = float(np.average([one.mean for one in repeated], weights=weights))
    # of a standardised difference the variance is Student's times 1 + 1/k; the sum of several is nearly normal
    variances = [(1 + 1 / one.count) * (one.count - 1) / (one.count - 3) for one in repeated]
    interval = STANDARD_ERRORS * np.sqrt(sum(variances)) / weights.sum()
    verdict = "agrees" if abs(before - now) <= interval else "differs"
    return Verdict(f"{label}: runs together", name, before, now, interval, verdict, "Monte Carlo together")
