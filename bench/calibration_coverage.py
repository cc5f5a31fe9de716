"""Coverage of credible balls at the paper's size: nominal against actual, for right and wrong likelihoods.

``python -m bench.calibration_coverage --problems 400`` adds what is missing to ``results/calibration_problems.csv``,
one line a problem, and writes ``results/calibration_coverage.csv``. It can be stopped and continued. Wrong models,
which miss by far, get every fourth problem. The one chain starts at the maximum of the likelihood, which tests that the
posterior holds the truth and is left unchanged; in :mod:`bench.prior_coverage` it must be found from Haar draws.
"""

import time

import numpy as np
import pandas as pd

import fmsync
from bench.problems import rotations
from bench.studies import command_line, coverage, fill
from fmsync import calibration, diagnostics
from fmsync.problem import relative_maps

NOMINAL = (0.5, 0.8, 0.9, 0.95)
_WRONG_EVERY = 4
_MODELS = {
    "langevin": {"kappa": "auto"},
    "beta = 1": {"beta": 1.0},
    "projected-gaussian": {"likelihood": "projected-gaussian"},
}
_THINNING = {  # sweeps between draws, so that 200 of them are effective; 2 elsewhere
    ("langevin", 8.0, "langevin"): 3,
    ("projected-gaussian", 0.1, "projected-gaussian"): 3,
    ("projected-gaussian", 0.2, "projected-gaussian"): 7,
    ("projected-gaussian", 0.02, "beta = 1"): 8,
    **{("projected-gaussian", sigma2, "beta = 1"): 6 for sigma2 in (0.05, 0.1, 0.2)},
    ("projected-gaussian", 0.2, "langevin"): 3,
}
_MEANS = ["ess", "level_found", "error_mean", "error_unprojected", "error_mle", "energy_score"]
COVERED = {q: f"covered_{round(100 * q)}" for q in NOMINAL}
_FIELDS = ["noise", "level", "model", "problem", "cpu_seconds", *_MEANS, *COVERED.values()]

CASES = [("langevin", kappa, "langevin") for kappa in (8.0, 11.0, 20.0, 50.0)]
for _model in ("projected-gaussian", "langevin", "beta = 1"):
    CASES += [("projected-gaussian", sigma2, _model) for sigma2 in (0.02, 0.05, 0.1, 0.2)]


def one(noise: str, level: float, model: str, problem: int, n: int = 20, n_draws: int = 300) -> dict[str, object]:
    """Sample one planted problem and see which balls cover the truth: one line of the file."""
    strength = {"kappa" if noise == "langevin" else "sigma2": level}
    planted = rotations(seed=problem, n_nodes=11, n=n, noise=noise, **strength)
    p, began = planted.problem, time.process_time()
    thin = _THINNING.get((noise, level, model), 2)
    mle = fmsync.solve(p, "mle", rng=problem)
    options = {"n_chains": 1, "n_draws": n_draws, "warmup": 250, "thin": thin, **_MODELS[model]}
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
    fill(path, _FIELDS, todo, one, options.jobs, options.minutes)
    made = table(pd.read_csv(path))
    made.round(4).to_csv(options.results / "calibration_coverage.csv", index=False)
    print(made.round(3).to_string(index=False))


if __name__ == "__main__":
    main()
