"""``fmsync solve`` and ``fmsync sample``: absolute maps of a problem that ``fmsync.save_problem`` wrote."""

import argparse
import json
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

import fmsync
from fmsync.files import replacing

Answer = tuple[dict[str, Any], dict[str, object]]  # arrays by name (None is left out), and the summary


def run_solve(options: argparse.Namespace) -> int:
    """Solve, certify and write."""
    return _run(options, _solved)


def run_sample(options: argparse.Namespace) -> int:
    """Sample, diagnose and write."""
    return _run(options, _sampled)


def _solved(problem: fmsync.SyncProblem, options: argparse.Namespace) -> Answer:
    estimate = fmsync.solve(problem, options.method, rng=options.seed, restarts=options.restarts)
    certificate = fmsync.certify(problem, estimate) if estimate.on_group else None
    arrays = {"absolute": estimate.absolute, "edges": problem.edges, "relative": estimate.relative()}
    return arrays | {"edge_weights": estimate.edge_weights}, {
        "cost": estimate.cost,
        "converged": estimate.converged,
        "iterations": estimate.n_iterations,
        "certified": certificate is not None and certificate.certified,
        "gap_bound": None if certificate is None else certificate.gap_bound,
        "starts_that_agree": f"{estimate.n_agreeing} of {estimate.n_starts}",
    }


def _sampled(problem: fmsync.SyncProblem, options: argparse.Namespace) -> Answer:
    names = ("n_chains", "n_draws", "warmup", "thin", "kappa", "likelihood")
    chosen = {name: getattr(options, name) for name in names}
    post = fmsync.sample(problem, options.method, rng=options.seed, **chosen)
    if post.interrupted:
        raise KeyboardInterrupt
    kept = ("absolute", "energy", "kappa", "edge_weights", "kappas")
    arrays = {name: getattr(post, name) for name in kept}
    return arrays | {"edges": problem.edges, "relative_mean": post.relative_mean()}, {
        "chains": post.n_chains,
        "draws": post.n_draws,
        "energy": float(post.energy.mean()),
        "r_hat": fmsync.diagnostics.rhat(post.energy),
        "ess": fmsync.diagnostics.ess(post.energy),
        "kappa": float(post.kappa.mean()),
        "kappa_sd": float(post.kappa.std()),
    }


def print_summary(summary: Mapping[str, object]) -> None:
    """One line a number, for people."""
    for name, value in summary.items():
        text = "yes" if value is True else "no" if value is False else "-" if value is None else value
        print(f"{name.replace('_', ' '):28}{f'{text:.6g}' if isinstance(text, float) else text}")


def _run(options: argparse.Namespace, work: Callable[[fmsync.SyncProblem, argparse.Namespace], Answer]) -> int:
    """The arrays of the answer into the output, whole or not at all, and the summary on stdout."""
    if options.seed < 0:
        raise ValueError(f"--seed: a whole number >= 0, got {options.seed}")
    if options.output.suffix != ".npz" or options.output.is_dir() or not options.output.parent.is_dir():
        raise ValueError(f"{options.output}: name a file that ends in .npz, in a folder that is there")
    if not options.problem.is_file():
        raise ValueError(f"{options.problem}: there is no such file")
    if options.output.exists() and options.output.samefile(options.problem):
        raise ValueError(f"{options.output}: it is the problem; name another file")
    problem, began = fmsync.load_problem(options.problem), time.perf_counter()
    with warnings.catch_warnings(record=True, action="always") as caught:
        arrays, summary = work(problem, options)
    said = [*dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, UserWarning | RuntimeWarning))]
    for line in said:  # without the lines of code that Python adds
        print(f"fmsync: warning: {line}", file=sys.stderr)
    with replacing(options.output) as file:
        np.savez(file, **{name: values for name, values in arrays.items() if values is not None})
    told = {"output": str(options.output), "method": options.method, **summary, "seconds": time.perf_counter() - began}
    if options.json:
        print(as_json(told | {"warnings": said}))
    else:
        print_summary(told)
    return 0


def as_json(told: object) -> str:
    """Strict JSON: NaN and infinity, which it lacks, are null."""
    return json.dumps(json.loads(json.dumps(told), parse_constant=lambda _: None), indent=1)
