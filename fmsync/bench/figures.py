"""Figures of the suites. They draw what is in the tables and compute nothing."""

import pandas as pd
from matplotlib.figure import Figure

_STYLES = {1.0: "-", 0.833: "--", 0.667: ":"}


def errors(table: pd.DataFrame) -> Figure:
    """Error against noise, a panel for each row of :func:`fmsync.bench.report.table1`, the paper's numbers as crosses.

    Densities as in the paper: solid 1, dashed .833, dotted .667. The floor is drawn below the recovery threshold only.
    """
    labels = [label for label in table.label.cat.categories if label != "observed"]
    rows = -(-len(labels) // 2)
    figure = Figure(figsize=(7.2, 2.5 * rows), layout="constrained")
    axes = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
    for axis in axes.flat[len(labels) :]:
        axis.set_visible(False)
    for axis, label in zip(axes.flat, labels):
        for density, part in table[table.label == label].groupby("density", observed=True):
            line, *_ = axis.plot(part.sigma2, part["mean"], _STYLES.get(density, "-"), label=f"density {density:g}")
            axis.fill_between(part.sigma2, part.low, part.high, color=line.get_color(), alpha=0.2, lw=0)
            axis.plot(part.sigma2, part.paper, "x", color=line.get_color())
        complete = table[(table.label == label) & (table.density == 1)]
        below, beyond = complete[complete.recoverable], complete[~complete.recoverable]
        axis.plot(below.sigma2, below.floor, "k-", lw=1, label="floor" if len(below) else None)
        axis.plot(beyond.sigma2, beyond.floor, "k:", lw=1, label="floor, not valid here" if len(beyond) else None)
        axis.set(title=str(label), ylim=(0, 7))
    axes.flat[0].legend(fontsize=7)
    for axis in axes[:, 0]:
        axis.set_ylabel("Frobenius error")
    for axis in axes[-1]:
        axis.set_xlabel("σ²")
    return figure


def convergence(frame: pd.DataFrame) -> Figure:
    """Error against iteration of both estimators of maximum likelihood, mean over seeds, for every noise level."""
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for axis, label in zip(axes, ("way of MLE (1)", "way of MLE (2)")):
        rows = frame[(frame.label == label) & (frame.metric == "error_at_step")]
        for k, (sigma2, part) in enumerate(rows.groupby("sigma2")):
            mean = part.groupby("at")["value"].mean()
            axis.plot(mean.index, mean, color=f"C{k}", label=f"σ² = {sigma2:g}")
        axis.set(title=label.removeprefix("way of "), xlabel="iteration", xlim=(0, 40))
    axes[0].set_ylabel("Frobenius error")
    axes[1].legend(fontsize=8)
    return figure


def oracle(frame: pd.DataFrame) -> Figure:
    """Oracle accuracy against the number of draws: MC (2) solid, the Haar baseline dotted; complete graph of four."""
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axis = figure.subplots()
    rows = frame[(frame.metric == "accuracy_at_draws") & (frame.n_nodes == 4) & frame.density.fillna(1.0).eq(1.0)]
    rows = rows[~rows.two_way.eq(True)]
    for label, style in (("MC (2)", "-"), ("haar-baseline", ":")):
        for sigma2, part in rows[rows.label == label].groupby("sigma2"):
            mean = part.groupby("at")["value"].mean()
            colour = f"C{round(5 * sigma2)}"
            axis.semilogx(mean.index, mean, style, color=colour, label=f"σ² = {sigma2:g}" if style == "-" else None)
    axis.set(xlabel="number of draws", ylabel="oracle accuracy")
    axis.legend(fontsize=8)
    return figure


def error_against_seconds(board: pd.DataFrame, problems: int = 6) -> Figure:
    """Error against CPU seconds of every method, a panel for each of the first few problems, the floor as a line."""
    kinds = [(problem, part) for problem, part in board.groupby("problem", sort=False) if part.error.notna().any()]
    kinds = kinds[:problems]
    rows = -(-len(kinds) // 2)
    figure = Figure(figsize=(7.2, 3.2 * rows), layout="constrained")
    axes = figure.subplots(rows, 2, squeeze=False)
    for axis in axes.flat[len(kinds) :]:
        axis.set_visible(False)
    for axis, (problem, part) in zip(axes.flat, kinds):
        for row in part.dropna(subset=["error", "cpu"]).itertuples():
            axis.plot(row.cpu, row.error, "o", color="C0", ms=4)
            axis.annotate(row.label, (row.cpu, row.error), fontsize=6, xytext=(3, 2), textcoords="offset points")
        if part.floor.notna().any():
            axis.axhline(part.floor.iloc[0], color="k", lw=1)
        axis.set_xscale("log")
        axis.set_title(problem.strip("{}").replace('"', ""), fontsize=6)
        axis.set(xlabel="CPU seconds", ylabel="Frobenius error")
    return figure
