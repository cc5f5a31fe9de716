"""Coverage of credible balls at the paper's size: nominal against actual, for right and wrong likelihoods.

``python -m bench.calibration_coverage --problems 400`` adds what is missing to ``results/calibration_problems.csv``,
one line a problem, and writes ``results/calibration_coverage.csv``. It can be stopped and continued. Wrong models,
which miss by far, get every fourth problem. The one chain starts at the maximum of the likelihood, which tests that the
posterior holds the truth and is left unchanged; in :mod:`bench.prior_coverage` it must be found from Haar draws.
"""

import time
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

import fmsync
from bench.metrics import LEVELS
from bench.problems import rotations
from bench.studies import command_line, coverage, fill
from fmsync import calibration, diagnostics
from fmsync.problem import relative_maps

_WRONG_EVERY = 4
_TOLD = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_SWEEPS = {tuple(case): sweeps for *case, sweeps in _TOLD["cases"]}  # between draws, of noise, level and model
CASES = list(_SWEEPS)
_MEANS = ["ess", "level_found", "error_mean", "error_unprojected", "error_mle", "energy_score"]
COVERED = {q: f"covered_{round(100 * q)}" for q in LEVELS}
_FIELDS = ["noise", "level", "model", "problem", "cpu_seconds", *_MEANS, *COVERED.values()]


def one(noise: str, level: float, model: str, problem: int, n: int = 20, n_draws: int = 300) -> dict[str, object]:
    """Sample one planted problem and see which balls cover the truth: one line of the file."""
    strength = {"kappa" if noise == "langevin" else "sigma2": level}
    planted = rotations(seed=problem, n_nodes=11, n=n, noise=noise, **strength)
    p, began = planted.problem, time.process_time()
    mle, thin = fmsync.solve(p, "mle", rng=problem), _SWEEPS.get((noise, level, model), 2)
    options = {"n_chains": 1, "n_draws": n_draws, "warmup": 250, "thin": thin, **_TOLD["models"][model]}
    with diagnostics.short_run():
        post = fmsync.sample(p, "heat-bath", rng=problem, init=mle, **options)
    truth = relative_maps(planted.truth, p.edges)
    draws = post.relative()[0]  # (draws, E, n, n)
    levels = np.array([calibration.ball_level(draws[:, e], truth[e]) for e in range(p.n_edges)])
    found = post.sigma2 if model == "projected-gaussian" else post.kappa
    distance = np.linalg.norm(draws[:, 0] - draws[:, 0].mean(axis=0), axis=(1, 2))
    unprojected = post.relative_mean(projected=False)
    return {
        **{"noise": noise, "level": level, "model": model, "problem": problem},
        "cpu_seconds": time.process_time() - began,
        "ess": min(diagnostics.ess(distance[None]), diagnostics.ess(post.energy)),
        "level_found": found.mean(),
        "error_mean": np.linalg.norm(post.relative_mean() - truth, axis=(1, 2)).mean(),
        "error_unprojected": np.linalg.norm(unprojected - truth, axis=(1, 2)).mean(),
        "error_mle": np.linalg.norm(mle.relative() - truth, axis=(1, 2)).mean(),
        "energy_score": np.mean([calibration.energy_score(draws[:, e], truth[e]) for e in range(5)]),
        **{name: (levels <= q).mean() for q, name in COVERED.items()},
    }


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """One line for each case: shares covered with standard errors clustered by problem, and what they cost."""
    lines = []
    for (noise, level, model), group in rows.groupby(["noise", "level", "model"], sort=False):
        line = {"noise": noise, "level": level, "model": model, "problems": len(group), **coverage(group, COVERED)}
        line |= group[_MEANS].mean().to_dict() | {"cpu_hours": group.cpu_seconds.sum() / 3600}
        lines.append(line)
    return pd.DataFrame(lines).sort_values(["noise", "model", "level"], ignore_index=True)


def main(arguments: list[str] | None = None) -> None:
    """Compute what is missing and write the table."""
    options = command_line(__doc__, problems=400, jobs=2).parse_args(arguments)
    path = options.results / "calibration_problems.csv"
    right = [noise == model for noise, _, model in CASES]
    todo = [(*c, k) for k in range(options.problems) for c, r in zip(CASES, right) if r or k % _WRONG_EVERY == 0]
    fill(path, _FIELDS, todo, one, options.jobs)
    made = table(pd.read_csv(path))
    made.round(4).to_csv(options.results / "calibration_coverage.csv", index=False)
    print(made.round(3).to_string(index=False))


if __name__ == "__main__":
    main()
