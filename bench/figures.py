"""Figures of the suites. They draw what is in the tables and compute nothing."""

import json

import matplotlib as mpl
import matplotlib.ticker
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

_WIDTH = 5.2  # inches: one column, whose type can be read on a phone
_MARKERS = "osD^v<>pPXd"


def table1(tables: dict[str, pd.DataFrame], density: float = 1.0) -> Figure:
    """Error of every row and noise level at one density: a colour for each variant, a cross for the printed number.

    ``tables`` are those of :func:`bench.report.table1`, by the name of the protocol variant. Bars are bootstrap
    intervals. The grey band ends at the smallest small-error bound of the variants, where one of them is valid;
    triangles at the upper edge stand for errors beyond it.
    """
    own = {name: table[table.density == density] for name, table in tables.items()}
    first = next(iter(own.values()))
    printed = set(first.label[first.paper.notna()]) | {"observed"}
    labels = [label for label in first.label.cat.categories if label in printed]
    noise, top = sorted(first.sigma2.unique()), 7.0
    figure = Figure(figsize=(_WIDTH, 1.9 * -(-len(labels) // 2) + 1.2), layout="constrained")
    axes = figure.subplots(-(-len(labels) // 2), 2, sharex=True, sharey=True, squeeze=False)
    for axis, label in zip(axes.flat, labels):
        for k, (name, table) in enumerate(own.items()):
            part = table[table.label == label].set_index("sigma2").reindex(noise)
            at = np.arange(len(noise)) + 0.14 * (k - (len(own) - 1) / 2)
            out = part["mean"] > top
            around = np.array([part["mean"] - part.low, part.high - part["mean"]])[:, ~out]
            axis.errorbar(at[~out], part["mean"][~out], around, fmt="o", ms=3.5, color=f"C{k}", label=name)
            axis.plot(at[out], np.full(out.sum(), top - 0.2), "^", ms=4, color=f"C{k}")
        paper = first[first.label == label].set_index("sigma2").paper.reindex(noise).astype(float)
        axis.plot(range(len(noise)), paper, "kx", label="the paper")
        for x, sigma2 in enumerate(noise):
            bounds = pd.concat([t[(t.sigma2 == sigma2) & t.bound_valid].floor for t in own.values()])
            if len(bounds):
                axis.fill_between([x - 0.45, x + 0.45], 0, bounds.min(), color="0.6", alpha=0.4, lw=0)
        axis.set_title(str(label), fontsize=11)
        axis.set(ylim=(0, top), xticks=range(len(noise)), xticklabels=[f"{x:g}" for x in noise])
    axes[0, 0].fill_between([], [], [], color="0.6", alpha=0.4, lw=0, label="small-error bound, where valid")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", fontsize=10)
    figure.supylabel("Frobenius error", fontsize=11)
    for axis in axes[-1]:
        axis.set_xlabel("σ²", fontsize=11)
    return figure


def density(tables: dict[str, pd.DataFrame], label: str = "MLE (2)", sigma2: float = 0.2) -> Figure:
    """Error of one row at one noise level against density: every variant, its expected line dotted, and the paper."""
    figure, axis = _one_panel(5.0)
    for k, (name, table) in enumerate(tables.items()):
        part = table[(table.label == label) & (table.sigma2 == sigma2)].sort_values("density")
        around = [part["mean"] - part.low, part.high - part["mean"]]
        axis.errorbar(part.density, part["mean"], around, color=f"C{k}", marker="o", capsize=3, label=name)
        axis.plot(part.density, part.expected, ":", color=f"C{k}")
    axis.plot(part.density, part.paper, "kx", ms=8, mew=2, label="the paper")
    axis.set(xlabel="share of the pairs that are observed", ylabel="Frobenius error", xticks=part.density)
    axis.set_ylim(bottom=0)
    figure.legend(loc="outside lower center", fontsize=10)
    return figure


def convergence(frame: pd.DataFrame) -> Figure:
    """Error against iteration, mean over seeds: MLE (2) solid, MLE (1) dashed, what was observed dotted; colour: σ²."""
    figure, axis = _one_panel(4.0)
    last, drawn = 40, []
    for label, style in (("way of MLE (2)", "-"), ("way of MLE (1)", "--")):
        rows = frame[(frame.label == label) & (frame.metric == "error_at_step") & (frame["at"] <= last)]
        for sigma2, part in rows.groupby("sigma2"):
            traces = part.pivot_table(index="at", columns="seed", values="value")
            mean = traces.reindex(range(last + 1)).ffill().mean(axis=1)  # who has arrived stays there
            drawn += [mean.min(), mean.max() if style == "-" else mean.min()]  # a start off the group is far away
            axis.plot(mean.index, mean, style, **_of_noise(sigma2, style))
    observed = frame[(frame.label == "observed") & (frame.metric == "edge_error") & frame.density.isna()]
    for sigma2, part in observed.groupby("sigma2"):
        axis.plot([0, last], [part.value.mean()] * 2, ":", lw=1.2, **_of_noise(sigma2, ":"))
        drawn.append(part.value.mean())
    axis.set(xlabel="iteration", ylabel="Frobenius error", xlim=(0, last))
    axis.set_ylim(min(drawn, default=0.0) - 0.2, max(drawn, default=1.0) + 0.2)
    figure.legend(loc="outside lower center", ncols=3, fontsize=10)
    return figure


def oracle(frame: pd.DataFrame) -> Figure:
    """Oracle accuracy against the number of draws: MC (2) solid, the Haar baseline dotted; complete graph of four."""
    figure, axis = _one_panel(3.6)
    rows = frame[(frame.metric == "accuracy_at_draws") & (frame.n_nodes == 4) & frame.density.fillna(1.0).eq(1.0)]
    rows = rows[~rows.two_way.eq(True)]
    both = set(rows[rows.label == "MC (2)"].sigma2) & set(rows[rows.label == "haar-baseline"].sigma2)
    for label, style in (("MC (2)", "-"), ("haar-baseline", ":")):
        for sigma2, part in rows[(rows.label == label) & rows.sigma2.isin(both)].groupby("sigma2"):
            mean = part.groupby("at")["value"].mean()
            axis.semilogx(mean.index, mean, style, **_of_noise(sigma2, style))
    axis.set(xlabel="number of draws", ylabel="oracle accuracy")
    figure.legend(loc="outside lower center", ncols=3, fontsize=10)
    return figure


def error_against_seconds(board: pd.DataFrame) -> Figure:
    """Error against CPU seconds of every method of a scoreboard, a panel for each problem.

    Errors are root mean squares, as is the small-error bound, a line that is dotted where it does not hold. Names stand
    at the right, in their order; methods without error, which see the truth, are left out.
    """
    rows = board[board.cpu.notna() & (board.rms > 0)]
    kinds = dict(iter(rows.groupby("problem", sort=False)))
    heights = [0.6 + 0.21 * max(len(part), 7) for part in kinds.values()]
    figure = Figure(figsize=(_WIDTH, sum(heights) + 0.5), layout="constrained")
    axes = figure.subplots(len(kinds), 1, squeeze=False, height_ratios=heights)[:, 0]
    for axis, drawn, title in zip(axes, kinds.values(), _differences(list(kinds))):
        axis.plot(drawn.cpu, drawn.rms, "o")
        axis.set(xscale="log", yscale="log" if drawn.rms.max() > 4 * drawn.rms.min() else "linear")
        for one, values in ((axis.xaxis, drawn.cpu), (axis.yaxis, drawn.rms)):
            if one.get_scale() == "log":
                few = values.max() < 30 * values.min()
                one.set_major_locator(mpl.ticker.LogLocator(subs=(1, 2, 5) if few else (1,)))
                one.set_major_formatter(mpl.ticker.FormatStrFormatter("%g"))
                one.set_minor_formatter(mpl.ticker.NullFormatter())
        axis.margins(0.08)
        if drawn.floor.notna().any():
            axis.axhline(drawn.floor.iloc[0], color="k", lw=1.2, ls="-" if drawn.bound_valid.iloc[0] else ":")
        axis.set_title(title, loc="left", fontsize=11)
        axis.set_ylabel("rms error", fontsize=11)
    axes[-1].set_xlabel("CPU seconds", fontsize=11)
    figure.draw_without_rendering()  # the places of the names are known only now
    for axis, drawn in zip(axes, kinds.values()):
        _name_at_the_right(axis, drawn.label, drawn.cpu, drawn.rms)
    return figure


def point_curves(frame: pd.DataFrame) -> Figure:
    """Share of vertices that land within a distance of their place, for every method of the rows given."""
    curves = frame[frame.metric == "point_curve"].groupby(["label", "at"])["value"].mean().unstack("at")
    middle = curves.columns[len(curves.columns) // 3]
    curves = curves.sort_values(middle, ascending=False)  # the legend reads from the highest curve to the lowest
    figure, axis = _one_panel(3.6 + 0.11 * len(curves))
    for k, (label, curve) in enumerate(curves.iterrows()):
        colour = mpl.colormaps["viridis"](0.9 * (1 - k / max(len(curves) - 1, 1)))
        style = {"color": colour, "ls": "-" if k % 2 else "--", "marker": _MARKERS[k % len(_MARKERS)]}
        axis.plot(curve.index, curve, label=str(label), lw=1.2, ms=4, markevery=(k % 4, 4), **style)
    axis.set(xlabel="geodesic distance, in square roots of the area", ylabel="share of vertices", ylim=(0, 1))
    figure.legend(loc="outside lower center", ncols=2, fontsize=10)
    return figure


def _one_panel(height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(_WIDTH, height), layout="constrained")
    return figure, figure.subplots()


def _of_noise(sigma2: float, style: str) -> dict:
    """Colour of a noise level, and its entry in the legend, where solid lines stand for all."""
    colour = mpl.colormaps["viridis"](0.95 * min(sigma2, 1.0))
    return {"color": colour, "label": f"σ² = {sigma2:g}" if style == "-" else None}


def _differences(problems: list[str]) -> list[str]:
    """What is different between problems, as titles."""
    values = [json.loads(problem) for problem in problems]
    names = dict.fromkeys(name for one in values for name in one)
    told = [name for name in names if len({json.dumps(one.get(name)) for one in values}) > 1]
    spoken = {"sigma2": "σ²", "n_nodes": "shapes", "kappa": "κ"}

    def told_of(name: str, value: object) -> str:
        return f"{spoken.get(name, name)} = {f'{value:.3g}' if isinstance(value, float) else value}"

    return [", ".join(told_of(name, one[name]) for name in told if one.get(name) is not None) for one in values]


def _name_at_the_right(axis: Axes, names, x, y) -> None:
    """Write names of points, lowest first, in a column beside the axes, apart from each other, a thin line to each."""
    own = axis.transAxes.inverted().transform(axis.transData.transform(np.column_stack([x, y])))
    gap = 1 / max(len(own) - 1, 7)
    order = np.lexsort((-own[:, 0], np.round(own[:, 1] / gap)))  # lines of equal heights do not cross
    apart = gap * np.arange(len(own))
    places = np.maximum.accumulate(own[order, 1] - apart) + apart
    places = np.maximum(places - max(0.0, places.max(initial=0.0) - 1.0), apart)  # within the axes
    points = list(zip(names, x, y))
    arrow = {"arrowstyle": "-", "color": "0.6", "lw": 0.6, "shrinkA": 0, "shrinkB": 2, "relpos": (0, 0.5)}
    beside = {"textcoords": "axes fraction", "va": "center", "fontsize": 10, "annotation_clip": False}
    for k, place in zip(order, places):
        name, *point = points[k]
        axis.annotate(str(name), point, xytext=(1.06, place), arrowprops=arrow, **beside)
