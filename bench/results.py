"""One tidy table a suite: a row for every number of every run, kept as Parquet; intervals and comparisons."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from bench.metrics import METRICS
from fmsync.files import replacing

FOLDER = Path(__file__).parents[1] / "results"  # what is committed

#: Parameters of problems that have a column of their own; the rest stays in ``problem``.
_NUMBERS = ("n_nodes", "n", "density", "sigma2", "kappa", "outliers")
PARAMETERS = (*_NUMBERS, "noise", "two_way", "around", "collection")
_WHAT = ("generator", "problem", "seed", "label", "method", "options", "status")
_WHERE = ("commit", "machine", "versions", "arithmetic", "code")
_RESAMPLES, _TAIL = 2000, (1 - 0.95) / 2


def to_frame(suite: str, records: Iterable[Mapping]) -> pd.DataFrame:
    """A row for every number of every run; failed runs have one row, of no metric.

    Columns: what the run is, metric, at, value, unit, direction, and where the number comes from: commit, machine,
    versions, arithmetic (:func:`data_gen.cache.arithmetic`) and code (:func:`bench.cache.code_hash`). The last two are
    None for runs that finished before they were recorded.
    """
    rows = []
    for record in records:
        run = {"suite": suite} | {name: record.get(name) for name in _WHAT + _WHERE}
        run |= {name: record["problem"].get(name) for name in PARAMETERS}
        run |= {name: json.dumps(record[name], sort_keys=True) for name in ("problem", "options")}
        run["detail"] = (record.get("traceback") or "").strip().rpartition("\n")[2] or None
        for name, at, value in record["metrics"] or [(None, None, np.nan)]:
            metric = METRICS.get(name)
            unit, direction = (metric.unit, metric.direction) if metric else (None, None)
            rows.append({**run, "metric": name, "at": at, "value": value, "unit": unit, "direction": direction})
    frame = pd.DataFrame(rows)
    numeric = [*_NUMBERS, "at", "value"]
    frame[numeric] = frame[numeric].apply(pd.to_numeric)
    return frame


def write(frame: pd.DataFrame, path: str | Path) -> None:
    """Write Parquet; the file appears whole or not at all."""
    repeated = [name for name in frame.columns if frame[name].dtype == object]
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        frame.astype({name: "category" for name in repeated}).to_parquet(file, compression="zstd", index=False)


def committed(name: str):
    """What ``results`` holds under a name: rows of a suite, a table (CSV), or the findings of a study (JSON)."""
    path = FOLDER / name
    readers = {".parquet": read, ".csv": pd.read_csv, ".json": lambda p: json.loads(p.read_text(encoding="utf-8"))}
    return readers[path.suffix](path)


def read(path: str | Path) -> pd.DataFrame:
    """Read what :func:`write` wrote; a ValueError tells how to make a file that is missing or damaged."""
    path = Path(path)
    make = f"make them with 'python -m bench run {path.stem}'"
    if not path.is_file():
        raise ValueError(f"{path}: no results there; {make}")
    try:
        frame = pd.read_parquet(path)
    except Exception as error:  # whatever pyarrow and pandas raise of a damaged file
        raise ValueError(f"{path}: cannot be read ({type(error).__name__}); {make} or restore the file") from error
    return frame.astype({name: object for name in frame.columns if frame[name].dtype == "category"})


def bootstrap(values: Sequence[float]) -> tuple[float, float]:
    """Percentile interval of the mean over resampled seeds; NaN for fewer than two."""
    values = np.asarray(values, dtype=float)
    if len(values) < 2:
        return np.nan, np.nan
    drawn = np.random.default_rng(0).integers(len(values), size=(_RESAMPLES, len(values)))
    low, high = np.quantile(values[drawn].mean(axis=1), [_TAIL, 1 - _TAIL])
    return float(low), float(high)


def summarise(frame: pd.DataFrame, by: Sequence[str], metric: str) -> pd.DataFrame:
    """Mean over seeds of a metric for every group: the columns ``by``, mean, low, high (bootstrap interval), seeds."""
    groups = frame[frame.metric == metric].groupby(list(by), dropna=False, sort=False)["value"]
    rows = [(*key, values.mean(), *bootstrap(values), len(values)) for key, values in groups]
    return pd.DataFrame(rows, columns=[*by, "mean", "low", "high", "seeds"])


def compare(before: pd.DataFrame, after: pd.DataFrame, tolerance: float = 0.01) -> pd.DataFrame:
    """What changed between two results of a suite, in paired seeds.

    A row for every method, metric and problem whose relative change exceeds ``tolerance`` (five times that for seconds
    and memory) and whose bootstrap interval of the paired differences excludes 0, and for every run that failed in one
    of the two alone. Metrics without a better direction are left out. Columns: label, metric, problem, before, after,
    change, verdict ("worse", "better" or the two statuses).
    """
    keys = ["generator", "problem", "label", "metric"]
    scalar = [frame[frame["at"].isna() & frame.metric.notna()] for frame in (before, after)]
    joined = scalar[0].merge(scalar[1], on=[*keys, "seed"], suffixes=("_before", "_after"))
    rows = []
    for key, group in joined.groupby(keys, sort=False):
        metric = METRICS.get(key[3])
        if metric is None or metric.direction == "none":
            continue
        old, new = group.value_before.mean(), group.value_after.mean()
        change = (new - old) / max(abs(old), 1e-9)
        difference = group.value_after - group.value_before
        low, high = bootstrap(difference) if len(group) > 1 else (difference.iloc[0],) * 2
        limit = tolerance * (5 if metric.tolerance is None else 1)
        if abs(change) > limit and (low > 0 or high < 0):
            worse = (change > 0) == (metric.direction == "lower")
            rows.append((key[2], key[3], key[1], old, new, change, "worse" if worse else "better"))
    which = ["generator", "problem", "label", "seed"]
    status = [frame.drop_duplicates(which)[[*which, "status"]] for frame in (before, after)]
    both = status[0].merge(status[1], on=which, suffixes=("_before", "_after"))
    for row in both[(both.status_before == "ok") != (both.status_after == "ok")].itertuples():
        verdict = f"{row.status_before} -> {row.status_after}"
        rows.append((row.label, "status", f"{row.problem} seed {row.seed}", np.nan, np.nan, np.nan, verdict))
    columns = ["label", "metric", "problem", "before", "after", "change", "verdict"]
    found = pd.DataFrame(rows, columns=columns)
    return found.sort_values("change", key=np.abs, ascending=False, ignore_index=True)
