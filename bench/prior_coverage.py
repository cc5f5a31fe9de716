"""Coverage and ranks where the truth comes from the very prior that the sampler assumes, with chains from Haar starts.

``python -m bench.prior_coverage`` adds problems to ``results/prior_coverage_problems.csv`` until the pooled shares of
maps in balls of 50, 80, 90 and 95 % have standard errors of half a point, and writes ``results/prior_coverage.json``.
It can be stopped and continued. Eight chains start at Haar draws.

Balls cover as promised only if the true noise level is a draw of its prior, κ uniform or σ² log-uniform. It is drawn on
a part of the wide priors of the sampler, and draws of the posterior outside of it are discarded: that is the posterior
under the narrower prior. Data that leave fewer than a fifth of the draws, or fewer than 1,000 effective ones after a
longer run, are passed over; given the data the truth is still one more draw. With ``--fixed`` the level is the same for
all problems, and the table shows by how much balls miss then.
"""

import networkx as nx
import numpy as np
import pandas as pd
from scipy.stats import kstwo

import data_gen
import fmsync
from bench.calibration_coverage import COVERED
from bench.provenance import versions
from bench.studies import add_part, command_line, coverage, fill
from fmsync import calibration, diagnostics
from fmsync.energy import energy
from fmsync.problem import relative_maps

SETTINGS = {  # noise, n, N, least and largest level, sweeps between draws, step from one problem number to the next
    "Langevin, n = 3": ("langevin", 3, 5, (4.0, 40.0), 2, 1),
    "Langevin, n = 8": ("langevin", 8, 6, (4.0, 40.0), 2, 2),
    "projected, n = 3": ("projected-gaussian", 3, 5, (0.005, 0.4), 4, 3),
    "projected, n = 5": ("projected-gaussian", 5, 6, (0.005, 0.4), 4, 6),
}
_CHAINS, _DRAWS, _WARMUP = 8, 250, 150
_EFFECTIVE, _LEAST_SHARE, _PRECISION = 1000, 0.2, 0.005
_RANKS = ["rank_level", "rank_energy", "rank_entry"]
_FIELDS = ["setting", "prior", "problem", "level", "ess", "share_kept", *_RANKS, *COVERED.values()]


def one(setting: str, prior: str, problem: int) -> dict[str, object]:
    """One line of the file; without ranks and coverage where the data leave too few draws."""
    noise, n, n_nodes, (low, high), thin, _ = SETTINGS[setting]
    rng = np.random.default_rng([problem, list(SETTINGS).index(setting), prior == "fixed"])
    ring = nx.cycle_graph(n_nodes)
    ring.add_edge(0, 2)
    truth = data_gen.planted(n_nodes, n, ring, rng)
    langevin = noise == "langevin"
    level = rng.uniform(low, high) if langevin else float(np.exp(rng.uniform(np.log(low), np.log(high))))
    if prior == "fixed":
        level, low, high = 12.0 if langevin else 0.05, 0.0, np.inf
    p = data_gen.perturb(truth, noise=noise, rng=rng, **{"kappa" if langevin else "sigma2": level})
    pairs = np.stack(np.triu_indices(n_nodes, 1), axis=1)
    line = {"setting": setting, "prior": prior, "problem": problem, "level": level, "ess": 0.0}
    found, energies, maps, n_draws = [], [], [], _DRAWS
    for _ in range(3):  # what one run lacks the next one adds
        with diagnostics.short_run():
            run = {"n_chains": _CHAINS, "n_draws": n_draws, "warmup": _WARMUP, "thin": thin, "init": "random"}
            post = fmsync.sample(p, "heat-bath", rng=rng, likelihood=noise, **run)
        levels = post.kappa if langevin else post.sigma2
        kept = (levels >= low) & (levels <= high)
        relative = post.relative(pairs)
        distance = np.linalg.norm(relative[:, :, 0] - relative[:, :, 0].mean(axis=(0, 1)), axis=(-2, -1))
        line["ess"] += diagnostics.ess(distance) * kept.mean()
        for values, more in ((found, levels), (energies, post.energy), (maps, relative)):
            values.append(more[kept])
        line["share_kept"] = kept.mean()
        if line["ess"] >= _EFFECTIVE or kept.mean() < _LEAST_SHARE:
            break
        n_draws = min(int(1.2 * n_draws * (_EFFECTIVE / line["ess"] - 1)) + 25, 8 * _DRAWS)
    if line["ess"] < _EFFECTIVE:
        return line
    draws, true = np.concatenate(maps), relative_maps(truth.absolute, pairs)
    probability = np.array([calibration.ball_level(draws[:, k], true[k]) for k in range(len(pairs))])
    scalars = (np.concatenate(found), level), (np.concatenate(energies), energy(p, truth.absolute))
    ranks = [float(calibration.rank(*scalar)) for scalar in (*scalars, (draws[:, 0, 0, 0], true[0, 0, 0]))]
    return line | dict(zip(_RANKS, ranks)) | {name: (probability <= q).mean() for q, name in COVERED.items()}


def table(rows: pd.DataFrame) -> dict[str, dict[str, object]]:
    """Of every setting and of all together: coverage with clustered standard errors, and ranks against their band.

    ``ranks`` are largest distances of empirical from uniform distribution functions; 95 % of right posteriors stay
    within ``band``.
    """
    used, found = rows.dropna(subset=["rank_level"]), {}
    for name in [*SETTINGS, "all"]:
        group = used if name == "all" else used[used.setting == name]
        if len(group) < 2:
            continue
        tried = len(rows) if name == "all" else int((rows.setting == name).sum())
        line = {"problems": len(group), "passed over": tried - len(group), "ess": round(group.ess.median())}
        line |= {name: round(share, 4) for name, share in coverage(group, COVERED).items()}
        uniform = (np.arange(len(group)) + 0.5) / len(group)
        line["ranks"] = {c[5:]: round(float(np.abs(np.sort(group[c]) - uniform).max()), 4) for c in _RANKS}
        line["band"] = round(float(kstwo.ppf(0.95, len(group))), 4)
        found[name] = line
    return found


def main(arguments: list[str] | None = None) -> None:
    """Add problems until the pooled coverage is precise, and write the table."""
    parser = command_line(__doc__, problems=5000, jobs=1)
    parser.add_argument("--fixed", action="store_true", help="κ = 12 and σ² = 0.05 for all problems")
    options = parser.parse_args(arguments)
    path, prior = options.results / "prior_coverage_problems.csv", "fixed" if options.fixed else "drawn"

    def found() -> dict[str, dict[str, object]]:
        rows = pd.read_csv(path) if path.exists() else pd.DataFrame(columns=_FIELDS)
        return table(rows[rows.prior == prior])

    todo = [(name, prior, k) for k in range(options.problems) for name in SETTINGS if k % SETTINGS[name][-1] == 0]

    def precise() -> bool:
        pooled = found().get("all", {"problems": 0})
        return pooled["problems"] >= 1000 and max(pooled[f"se {q}"] for q in COVERED) <= _PRECISION

    fill(path, _FIELDS, todo, one, options.jobs, precise)
    command = f"python -m bench.prior_coverage{' --fixed' * options.fixed}"
    add_part(options.results / "prior_coverage.json", prior, {"versions": versions(), "settings": found()}, command)
    print(pd.DataFrame(found()).T.to_string())


if __name__ == "__main__":
    main()
