"""Tables of results: Table 1 cell by cell beside the paper's, a scoreboard of any suite, and its methods best first."""

import html
import json
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

from bench import methods, results
from bench.metrics import root_mean_square
from fmsync.bounds import is_small_error, recovery_threshold

_PAPER = Path(__file__).with_name("paper_table1.csv")
_OWN_ROWS = ["MLE (1) rounded", "observed", "spectral", "posterior mean", "Langevin posterior mean"]
CONTROLS = ("observed", "identity", "haar-baseline")
WORDS = tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))
_LEGEND = "ours [95 % interval] / paper; * = the printed number lies in the interval; ' = beyond the recovery "
_LEGEND += "threshold; (bound) = errors are too large for it"
_SUMMARIES = (
    (["problem", "label"], ("seconds", "cpu_seconds", "peak_memory"), "median"),
    (["problem", "label"], ("edge_rms",), root_mean_square),
    (["problem"], ("floor_rms", "expected_rms"), "mean"),
)
_SHORT = {"mean": "error", "edge_rms": "rms", "cpu_seconds": "cpu", "peak_memory": "memory"}
_SHORT |= {"floor_rms": "floor", "expected_rms": "expected"}
_BOARD = ["problem", "label", "error", "low", "high", "rms", "seconds", "cpu", "memory", "failed", "floor", "expected"]


def paper_table() -> pd.DataFrame:
    """The 75 printed cells: label, density, sigma2, paper."""
    return pd.read_csv(_PAPER)


def table1(frame: pd.DataFrame, *, n_nodes: int = 4, two_way: bool = False, around: str = "consistent") -> pd.DataFrame:
    """Results (see :func:`bench.results.read`) of the suite ``paper`` beside the printed cells.

    A variant of the protocol has 4 or 11 shapes, one or two observations of a pair, noise around consistent or measured
    maps. Columns: label, density, sigma2, mean, low, high (95 % bootstrap interval over seeds), seeds, paper (NaN for
    our rows), agrees (whether the printed number lies in the interval), floor (the small-error bound) and expected
    (root mean squares), recoverable (:func:`fmsync.bounds.recovery_threshold`), bound_valid
    (:func:`fmsync.bounds.is_small_error`).
    """
    where = (frame.n_nodes == n_nodes) & (frame.two_way.eq(True) == two_way) & frame.density.notna()
    chosen = frame[where & (frame.around.fillna("consistent") == around)]
    if chosen.empty:
        variant = f"n_nodes={n_nodes}, two_way={two_way}, around={around!r}"
        raise ValueError(f"no results for {variant}; make them with 'python -m bench run paper'")
    labels = [label for label in [*paper_table().label.unique(), *_OWN_ROWS] if label in set(chosen.label)]
    table = results.summarise(chosen[chosen.label.isin(labels)], ["label", "density", "sigma2"], "edge_error")
    table = table.merge(paper_table(), how="left", on=["label", "density", "sigma2"])
    table["agrees"] = (table.low <= table.paper) & (table.paper <= table.high)
    lines = chosen[chosen.metric.isin(["floor_rms", "expected_rms"])]
    lines = lines.pivot_table("value", ["density", "sigma2"], "metric", "mean").rename(columns=_SHORT)
    table = table.merge(lines.reindex(columns=["floor", "expected"]), how="left", on=["density", "sigma2"])
    n, per_pair = int(chosen.n.iloc[0]), 2 if two_way else 1
    thresholds = {share: recovery_threshold(n_nodes, n, per_pair, density=share) for share in table.density.unique()}
    table["recoverable"] = table.sigma2 < table.density.map(thresholds)
    table["bound_valid"] = [_holds(n, floor) for floor in table.floor]
    table["label"] = pd.Categorical(table.label, labels, ordered=True)
    return table.sort_values(["label", "density", "sigma2"], ascending=[True, False, True], ignore_index=True)


def beside(table: pd.DataFrame, *, interval: bool = False) -> pd.DataFrame:
    """A table of :func:`table1` as text: rows label and density, columns σ², cells 'ours / paper', two reference lines.

    ``interval`` puts its ends after our number. A star: the printed number lies in it; a prime: beyond the recovery
    threshold; a bound in brackets does not hold.
    """
    cells = {}
    for row in table.itertuples():
        text = f"{row.mean:#.3g}" if row.mean < 100 else f"{row.mean:.0f}"
        if interval:
            text = f"{row.mean:.2f} [{row.low:.2f}, {row.high:.2f}]"
        if pd.notna(row.paper):
            text += f" / {row.paper:.2f}{'*' if row.agrees else ''}"
        cells[row.label, row.density, f"{row.sigma2:g}"] = text + ("" if row.recoverable else "'")
    for name, line in {"bound": bracketed(table), "expected": table.expected.map("{:.2f}".format)}.items():
        for row in table.assign(line=line).drop_duplicates(["density", "sigma2"]).itertuples():
            cells[f"{name} (rms)", row.density, f"{row.sigma2:g}"] = row.line
    rows = pd.MultiIndex.from_tuples(dict.fromkeys(key[:2] for key in cells))
    return pd.Series(cells).unstack(2).reindex(rows).rename_axis(columns="σ²")


def protocol_variants(frame: pd.DataFrame) -> list[dict]:
    """The variants of the protocol for which there are results, as arguments of :func:`table1`."""
    rows = frame[frame.label.isin(["MLE (1)", "MLE (2)"])][["n_nodes", "two_way", "around"]]
    rows = rows.assign(two_way=rows.two_way.eq(True), around=rows.around.fillna("consistent"))  # absent: the default
    return rows.drop_duplicates().astype({"n_nodes": int}).to_dict("records")


def variant_name(n_nodes: int, two_way: bool, around: str) -> str:
    """A variant of the protocol in words.

    >>> variant_name(4, False, "consistent")
    'N = 4, one observation of a pair, noise around consistent maps'
    """
    observations = "two observations" if two_way else "one observation"
    return f"N = {n_nodes}, {observations} of a pair, noise around {around} maps"


def scoreboard(frame: pd.DataFrame) -> pd.DataFrame:
    """One row for every method and kind of problem of a suite, best error first within a problem.

    Columns: problem, label, error (mean over seeds), low, high, rms, seconds, cpu and memory (medians, MiB), failed
    (runs without an answer); floor (small-error bound) and expected, root mean squares, where theory knows them, and
    bound_valid as in :func:`table1`.
    """
    scalar, keys = frame[frame["at"].isna()], ["problem", "label"]
    runs = frame.drop_duplicates([*keys, "seed"])
    table = (runs.status != "ok").groupby([runs.problem, runs.label]).sum().rename("failed").reset_index()
    table = table.merge(results.summarise(scalar, keys, "edge_error"), how="left", on=keys)
    for by, names, mean in _SUMMARIES:
        values = scalar[scalar.metric.isin(names)].pivot_table("value", by, "metric", mean)
        table = table.merge(values, how="left", on=by)
    table = table.rename(columns=_SHORT).reindex(columns=_BOARD)
    sizes = table.problem.map(lambda problem: json.loads(problem).get("n", np.nan))
    table["bound_valid"] = [_holds(n, floor) for n, floor in zip(sizes, table.floor)]
    return table.sort_values(["problem", "error"], ignore_index=True)


def _holds(n: float, floor: float) -> bool:
    """Whether the bound is known and valid."""
    return bool(n >= 1 and np.isfinite(floor) and is_small_error(int(n), floor**2))


def bracketed(table: pd.DataFrame) -> pd.Series:
    """The column ``floor`` as text, in brackets where errors are too large for the bound to hold; NaN where unknown."""
    text = [f"{x:.2f}" if valid else f"({x:.2f})" for x, valid in zip(table.floor, table.bound_valid)]
    return pd.Series(text, table.index).where(table.floor.notna())


def report(frame: pd.DataFrame) -> str:
    """The tables of a suite as text."""
    seeds = frame.drop_duplicates(["generator", "problem", "label", "seed"]).groupby(["problem", "label"]).size()
    told = [f"suite {frame.suite.iloc[0]}: {seeds.sum()} runs, {seeds.min()} to {seeds.max()} seeds"]
    for name, label in (("commit", "commit "), ("machine", "machine "), ("versions", "")):
        told.append(label + "; ".join(sorted(filter(None, frame[name].dropna().unique()))))
    lines = ["\n".join(told)]
    if frame.suite.str.startswith("paper").all():
        for variant in protocol_variants(frame):
            wide = beside(table1(frame, **variant), interval=True)
            lines.append(f"{variant_name(**variant)}\n{_LEGEND}\n{wide.to_string()}")
    else:
        for problem, group in scoreboard(frame).groupby("problem", sort=False):
            shown = group.assign(bound=bracketed(group)).drop(columns=["problem", "floor", "bound_valid"])
            shown = shown.dropna(axis="columns", how="all")
            lines += [_named(problem), shown.to_string(index=False, float_format="{:.4g}".format)]
    failed = frame[frame.status != "ok"]
    if len(failed):
        lines.append(f"{len(failed)} runs gave no answer:")
        for row in failed.head(20).itertuples():
            lines.append(f"  {row.status}: {row.label} {_named(row.problem)} seed {row.seed}: {row.detail}")
    return "\n\n".join(lines)


def _named(problem: str) -> str:
    return ", ".join(f"{name}={value}" for name, value in json.loads(problem).items())


def relative_performance(frame: pd.DataFrame) -> pd.DataFrame:
    """Error over that of the best method of a problem: label, ratio (geometric mean over problems), low, high, file.

    ``frame`` holds the results of one suite; low and high are the ratios on the problems that suit a method best and
    least. Methods without error, which see the truth, are left out. Best first.
    """
    board = scoreboard(frame)
    rows = board[board.error > 0]
    over = np.log(rows.error / rows.groupby("problem").error.transform("min")).groupby(rows.label)
    table = np.exp(over.agg(ratio="mean", low="min", high="max"))
    modules = frame.drop_duplicates("label").set_index("label").method.map(lambda name: methods.get(name).module)
    table["file"] = modules.str.replace(".", "/") + ".py"
    return table.sort_values("ratio").reset_index()


def as_list(table: pd.DataFrame, title: str, most: float = 10.0) -> str:
    """HTML of :func:`relative_performance`: a dot for the mean, a bar to the extremes, hollow for controls."""
    rows = []
    for row in table.itertuples():
        dot, low, high = (100 * min(np.log(x) / np.log(most), 1.0) for x in (row.ratio, row.low, row.high))
        scale = f'<i style="left:{low:.1f}%;width:{high - low:.1f}%"></i><b style="left:{dot:.1f}%"></b>'
        kind = "fm-performance fm-control" if row.label in CONTROLS else "fm-performance"
        words = html.escape(WORDS.get(row.label, row.label))
        rows.append(
            f'<details class="{kind}"><summary><span>{words}</span><span class="fm-scale">{scale}</span>'
            f"<span>{row.ratio:.2f}</span></summary><p><code>{html.escape(row.label)}</code> is in "
            f"<code>{row.file}</code>; {row.low:.2f} to {row.high:.2f} on single problems.</p></details>"
        )
    return f'<div class="fm-performances"><p><strong>{html.escape(title)}</strong></p>{"".join(rows)}</div>'
