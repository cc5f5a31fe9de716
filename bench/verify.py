"""Run random cells of a table of results again, here, and see whether they agree with what the table says."""

import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bench import methods
from bench.cell import run_cell
from bench.suites import Cell, data_fingerprint

_EQUAL = 1e-6
_POINT, _DRAWN = 1e-3, 0.02  # beyond rounding, relative
_DEVIATIONS = 3
_STEP = 0.25  # in which the share of a few pairs moves
_SECONDS, _MEMORY = 1200.0, 16000.0


@dataclass(frozen=True)
class Verdict:
    """How one metric of one cell compares.

    Attributes
    ----------
    cell
        What was run again.
    metric, before, now
        Its name, the value in the table (the mean of a curve) and the value here.
    interval
        Largest difference that counts as agreement.
    verdict
        "equal" to one part in a million, "agrees" within the interval, "differs", or the status of a cell that failed.
    """

    cell: str
    metric: str
    before: float
    now: float
    interval: float
    verdict: str


def verify(
    frame: pd.DataFrame,
    n_cells: int,
    rng: int | np.random.Generator,
    *,
    run: Callable[[Cell], dict] = run_cell,
) -> Iterator[Verdict]:
    """Run random cells of a table again, each alone, and compare all metrics but those of time, memory and company.

    The interval: one part in a million where arithmetic is the same. On other machines products round differently;
    estimators then agree to a thousandth. Chains do not follow the same path any more: what comes of one is another
    draw, within two per cent and three standard deviations of the seeds, and one step of a share of four pairs.

    Parameters
    ----------
    frame
        Rows of :func:`bench.results.read`.
    n_cells
        How many cells, of those that gave an answer and whose data are on this machine.
    rng
        Chooses them: seed or generator.

    Raises
    ------
    ValueError
        The table has no such number of cells.
    """
    keys = ["generator", "problem", "label", "method", "options", "seed"]
    sound = frame[(frame.status == "ok") & ~frame.unit.isin(["s", "MB", "1/s", "cells"])]
    cells = sound[keys].drop_duplicates()
    if not 0 < n_cells <= len(cells):
        raise ValueError(f"n_cells: {n_cells} of a table of {len(cells)} cells")
    order = np.random.default_rng(rng).permutation(len(cells))
    here = (cell for cell in map(_cell, cells.iloc[order].itertuples(index=False)) if _is_here(cell))
    for cell in itertools.islice(here, n_cells):
        problem = json.dumps(cell.problem, sort_keys=True)
        kind = sound[(sound.problem == problem) & (sound.label == cell.label) & (sound.generator == cell.generator)]
        record = run(cell)
        if record["status"] != "ok":
            yield Verdict(str(cell), "status", np.nan, np.nan, np.nan, record["status"])
            continue
        now = pd.DataFrame(record["metrics"], columns=["metric", "at", "value"]).groupby("metric")["value"].mean()
        drawn = methods.get(cell.method).kind == "sampler"
        for metric, rows in kind.groupby("metric"):
            by_seed = rows.groupby("seed")["value"].mean()
            if cell.seed not in by_seed:  # a graph of this seed without triangles has no cycle error
                continue
            before, value = float(by_seed[cell.seed]), float(now.get(metric, np.nan))
            interval = _interval(drawn, before, by_seed.std(), rows.unit.iloc[0] == "share")
            yield Verdict(str(cell), str(metric), before, value, interval, _verdict(before, value, interval))


def _cell(row) -> Cell:
    problem, options = json.loads(row.problem), json.loads(row.options)
    return Cell(row.generator, problem, int(row.seed), row.label, row.method, options, _SECONDS, _MEMORY)


def _is_here(cell: Cell) -> bool:
    try:
        data_fingerprint(cell.generator, cell.problem)
    except ValueError:
        return False
    return True


def _interval(drawn: bool, before: float, deviation: float, share: bool) -> float:
    if not drawn:
        return _POINT * abs(before)
    spread = 0.0 if np.isnan(deviation) else _DEVIATIONS * deviation  # of one seed nothing is known
    return _DRAWN * abs(before) + spread + (_STEP if share else 0.0)


def _verdict(before: float, now: float, interval: float) -> str:
    difference = abs(now - before)
    if difference <= _EQUAL * max(1.0, abs(before)):
        return "equal"
    return "agrees" if difference <= interval else "differs"


def agrees(verdict: Verdict) -> bool:
    """Whether this metric is no reason for doubt.

    Examples
    --------
    >>> from bench.verify import Verdict, agrees
    >>> agrees(Verdict("mle [...]", "edge_error", 2.0, 2.5, 0.002, "differs"))
    False
    """
    return verdict.verdict in ("equal", "agrees")
