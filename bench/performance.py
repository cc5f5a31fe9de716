"""Methods of a suite, best first, in words: a list whose entries open on the file that holds the method."""

import html
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

from bench import methods, report

CONTROLS = ("observed", "identity", "haar-baseline")
WORDS = tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))


def relative_performance(frame: pd.DataFrame) -> pd.DataFrame:
    """Error over that of the best method of a problem: label, ratio (geometric mean over problems), low, high, file.

    ``frame`` holds the results of one suite; low and high are the ratios on the problems that suit a method best and
    least. Methods without error, which see the truth, are left out. Best first.
    """
    board = report.scoreboard(frame)
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
