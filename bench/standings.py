"""Methods of a suite, best first, in words: a list whose entries open on the file that holds the method."""

import html

import numpy as np
import pandas as pd

from bench import methods, report

CONTROLS = ("observed", "identity", "haar-baseline")
WORDS = {
    "MC (1)": "MC (1): mean of Langevin draws, matrices",
    "MC (2)": "MC (2): mean of Langevin draws, rotations",
    "MC (2) geodesic": "MC (2) with the geodesic energy",
    "MLE (1)": "MLE (1): maximum likelihood over matrices",
    "MLE (1) rounded": "MLE (1), rounded to rotations",
    "MLE (2)": "MLE (2): maximum likelihood over rotations",
    "Langevin posterior mean": "posterior mean, Langevin noise",
    "consistent-zoomout": "Consistent ZoomOut, which sees the shapes",
    "gnc-tls": "graduated non-convexity, truncated squares",
    "haar-baseline": "the paper's baseline",
    "heat-bath": "posterior mean, heat bath",
    "heat-bath projected": "posterior mean under the paper's noise",
    "hmc": "posterior mean, Hamiltonian Monte Carlo",
    "identity": "identity maps",
    "mala": "posterior mean, Metropolis-adjusted Langevin",
    "mle": "maximum likelihood",
    "mle-geodesic": "maximum likelihood, geodesic energy",
    "mle-pymanopt": "maximum likelihood by pymanopt",
    "mle-pymanopt-autograd": "maximum likelihood by pymanopt, automatic derivatives",
    "mle-unconstrained": "maximum likelihood over all matrices",
    "observed": "the observed maps as they are",
    "posterior mean": "posterior mean, the noise that was added",
    "pyfm-cycles": "pyFM's network, edges weighed by cycles",
    "pyfm-cycles-fixed": "pyFM's network, cycles multiplied in order",
    "pyfm-network": "pyFM's network",
    "pyfm-projected": "pyFM's network, projected to rotations",
    "rlfm": "mean of the paper's sampler",
    "rlfm at beta 1": "mean of the paper's sampler at β = 1",
    "rlfm at kappa 20": "mean of the paper's sampler, noise level told",
    "rlfm-geomstats": "the paper's sampler built from geomstats",
    "robust": "robust maximum likelihood",
    "robust-l1": "robust maximum likelihood, absolute residuals",
    "scipy-eigh": "eigenvectors, dense",
    "spanning-tree": "one tree, no averaging",
    "spectral": "eigenvectors",
    "staircase": "maximum likelihood, staircase where the certificate refuses",
    "way of MLE (1)": "MLE (1) from one random start",
    "way of MLE (2)": "MLE (2) from one random start",
}


def standings(frame: pd.DataFrame) -> pd.DataFrame:
    """Error over that of the best method of a problem: label, ratio (geometric mean over problems), low, high, file.

    ``frame`` holds the results of one suite; low and high are the ratios on the problems that suit a method best and
    least. Methods without error, which see the truth, are left out. Best first.
    """
    board = report.scoreboard(frame)
    rows = board[board.error > 0]
    over = np.log(rows.error / rows.groupby("problem").error.transform("min")).groupby(rows.label)
    table = np.exp(over.agg(ratio="mean", low="min", high="max"))
    table["file"] = frame.drop_duplicates("label").set_index("label").method.map(_file)
    return table.sort_values("ratio").reset_index()


def as_list(table: pd.DataFrame, title: str, most: float = 10.0) -> str:
    """HTML of :func:`standings`: a dot for the mean, a bar to the extremes, hollow for controls, cut at ``most``."""
    rows = []
    for row in table.itertuples():
        dot, low, high = (100 * min(np.log(x) / np.log(most), 1.0) for x in (row.ratio, row.low, row.high))
        scale = f'<i style="left:{low:.1f}%;width:{high - low:.1f}%"></i><b style="left:{dot:.1f}%"></b>'
        kind = "fm-standing fm-control" if row.label in CONTROLS else "fm-standing"
        words = html.escape(WORDS.get(row.label, row.label))
        rows.append(
            f'<details class="{kind}"><summary><span>{words}</span><span class="fm-scale">{scale}</span>'
            f"<span>{row.ratio:.2f}</span></summary><p><code>{html.escape(row.label)}</code> is in "
            f"<code>{row.file}</code>; {row.low:.2f} to {row.high:.2f} on single problems.</p></details>"
        )
    return f'<div class="fm-standings"><p><strong>{html.escape(title)}</strong></p>{"".join(rows)}</div>'


def _file(method: str) -> str:
    return f"{methods.get(method).module.replace('.', '/')}.py"
