"""Coverage of credible balls at the paper's size: nominal against actual, for right and wrong likelihoods.

``python -m bench.calibration_coverage --problems 400`` adds what is missing to
``results/calibration_problems.csv``, one line a problem, as they come, and writes the table
``results/calibration_coverage.csv``. Problem number k is the same whatever ran before: the run can be stopped and
continued. Wrong models, which miss by far, get every fourth problem.
"""

import argparse
import csv
import importlib
import time
import warnings
from pathlib import Path

import joblib
import numpy as np
import pandas as pd

import fmsync
from fmsync import calibration, diagnostics
from fmsync.problem import relative_maps

NOMINAL = (0.5, 0.8, 0.9, 0.95)
_MAKER = "bench.problems:rotations"  # named, not imported: the library does not know where problems come from
_N_NODES, _N, _DRAWS = 11, 20, 300
_WRONG_EVERY = 4
_THINNING = {  # sweeps between draws, so that 200 of them are effective; 2 elsewhere
    ("langevin", 8.0, "langevin"): 3,
    ("projected-gaussian", 0.1, "projected-gaussian"): 3,
    ("projected-gaussian", 0.2, "projected-gaussian"): 7,
    ("projected-gaussian", 0.02, "beta = 1"): 8,
    ("projected-gaussian", None, "beta = 1"): 6,
    ("projected-gaussian", 0.2, "langevin"): 3,
}
_FIELDS = [
    *("noise", "level", "model", "problem", "cpu_seconds", "ess", "level_found"),
    *("error_mean", "error_unprojected", "error_mle", "energy_score"),
    *(f"covered_{round(100 * q)}" for q in NOMINAL),
]

CELLS = [("langevin", kappa, "langevin") for kappa in (8.0, 11.0, 20.0, 50.0)]
CELLS += [
    ("projected-gaussian", sigma2, model)
    for model in ("projected-gaussian", "langevin", "beta = 1")
    for sigma2 in (0.02, 0.05, 0.1, 0.2)
]


def one(noise: str, level: float, model: str, problem: int) -> dict[str, object]:
    """Sample one planted problem and see which balls cover the truth: one line of the file."""
    warnings.simplefilter("ignore", diagnostics.ConvergenceWarning)
    module, name = _MAKER.split(":")
    maker = getattr(importlib.import_module(module), name)
    options = {"kappa": level} if noise == "langevin" else {"sigma2": level}
    planted = maker(seed=problem, n_nodes=_N_NODES, n=_N, noise=noise, **options)
    p = planted.problem
    began = time.process_time()
    chosen = {
        "langevin": {"kappa": "auto"},
        "beta = 1": {"beta": 1.0},
        "projected-gaussian": {"likelihood": "projected-gaussian"},
    }[model]
    thin = _THINNING.get((noise, level, model), _THINNING.get((noise, None, model), 2))
    mle = fmsync.solve(p, "mle", rng=problem)
    post = fmsync.sample(
        p, "heat-bath", n_chains=1, n_draws=_DRAWS, warmup=250, thin=thin, rng=problem, init=mle, **chosen
    )
    truth = relative_maps(planted.truth, p.edges)
    draws = post.relative()[0]  # (draws, E, n, n)
    levels = np.array([calibration.ball_level(draws[:, e], truth[e]) for e in range(p.n_edges)])
    found = post.sigma2 if model == "projected-gaussian" else post.kappa
    distance = np.linalg.norm(draws[:, 0] - draws[:, 0].mean(axis=0), axis=(1, 2))
    errors = {
        "error_mean": post.relative_mean(),
        "error_unprojected": post.relative_mean(projected=False),
        "error_mle": mle.relative(),
    }
    return {
        **{"noise": noise, "level": level, "model": model, "problem": problem},
        "cpu_seconds": time.process_time() - began,
        "ess": min(diagnostics.ess(distance[None]), diagnostics.ess(post.energy)),
        "level_found": found.mean(),
        **{name: np.linalg.norm(maps - truth, axis=(1, 2)).mean() for name, maps in errors.items()},
        "energy_score": np.mean([calibration.energy_score(draws[:, e], truth[e]) for e in range(5)]),
        **{f"covered_{round(100 * q)}": (levels <= q).mean() for q in NOMINAL},
    }


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """One line for each cell: shares covered with standard errors clustered by problem, and what they cost."""
    lines = []
    for (noise, level, model), group in rows.groupby(["noise", "level", "model"], sort=False):
        line = {"noise": noise, "level": level, "model": model, "problems": len(group)}
        for q in NOMINAL:
            covered = group[f"covered_{round(100 * q)}"]
            line[f"{q:g}"] = covered.mean()
            line[f"se {q:g}"] = covered.std(ddof=1) / np.sqrt(len(group))
        for name in ("ess", "level_found", "error_mean", "error_unprojected", "error_mle", "energy_score"):
            line[name] = group[name].mean()
        line["cpu_hours"] = group.cpu_seconds.sum() / 3600
        lines.append(line)
    return pd.DataFrame(lines).sort_values(["noise", "model", "level"], ignore_index=True)


def missing(path: Path, n_problems: int) -> list[tuple]:
    """(noise, level, model, problem) not in the file yet, all cells of a problem together."""
    known = set()
    if path.exists():
        rows = pd.read_csv(path)
        known = set(zip(rows.noise, rows.level, rows.model, rows.problem))
    wanted = [(*cell, k) for k in range(n_problems) for cell in CELLS if cell[0] == cell[2] or k % _WRONG_EVERY == 0]
    return [line for line in wanted if line not in known]


def main() -> None:
    """Compute what is missing and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=400, help="planted problems of every cell")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=np.inf, help="stop after about this long")
    parser.add_argument("--results", type=Path, default=Path("results"))
    arguments = parser.parse_args()
    path = arguments.results / "calibration_problems.csv"
    todo, began = missing(path, arguments.problems), time.monotonic()
    fresh = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, _FIELDS)
        if fresh:
            writer.writeheader()
        with joblib.Parallel(arguments.jobs) as parallel:
            for first in range(0, len(todo), 4 * arguments.jobs):
                if time.monotonic() - began > 60 * arguments.minutes:
                    break
                batch = todo[first : first + 4 * arguments.jobs]
                for line in parallel(joblib.delayed(one)(*cell) for cell in batch):
                    writer.writerow({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in line.items()})
                file.flush()
    made = table(pd.read_csv(path))
    made.round(4).to_csv(arguments.results / "calibration_coverage.csv", index=False)
    print(made.round(3).to_string(index=False))


if __name__ == "__main__":
    main()
