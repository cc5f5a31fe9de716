"""Runs of methods that misbehave."""

from collections import Counter
from pathlib import Path

from bench import methods
from bench.suites import Run

TRICKS = str(Path(__file__).with_name("tricks.py"))
methods.load(TRICKS)
TIMING = {"seconds", "cpu_seconds", "peak_memory", "ess_per_second"}


def runs(method, count, **options):
    """The same method on problems of several seeds."""
    problem = {"n_nodes": 4, "n": 3, "sigma2": 0.1}
    return [
        Run("bench.problems:rotations", problem, seed, method, method, options, file=TRICKS) for seed in range(count)
    ]


def values(record):
    """Numbers of a record by their names."""
    return {name: value for name, at, value in record["metrics"] if at is None}


def untimed(record):
    """The numbers that must not depend on where a run was executed."""
    return {name: value for name, value in values(record).items() if name not in TIMING}


def calls(log):
    """How often ``trick-count`` met each problem."""
    return Counter(log.read_text().split()) if log.exists() else Counter()
