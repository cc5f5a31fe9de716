"""The numbers that tables show: names, units, how exactly another machine repeats them, and how they are measured."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.methods import Answer
from bench.problems import Planted, thinned
from fmsync import calibration, oracle
from fmsync.functional_maps import point_map
from fmsync.problem import cycle_error

STANDARD_ERRORS = 4.0  # of one problem: the largest difference where chains part
_ROUNDING = 1e-9  # absolute: what should be zero, such as the cycle error of absolute maps, has no relative precision
LEVELS = (0.5, 0.8, 0.9, 0.95)
_MOST_DRAWS = 1000
_MOST_EDGES = 20  # whose draws are scored: edges of one problem say much the same
_LARGEST_POINT_ERROR = 0.25


@dataclass(frozen=True)
class Metric:
    """A number that tables show, and how :mod:`bench.verify` compares it with the number of another run.

    ``direction`` says which way is better: "lower", "higher", or "none". ``tolerance`` is relative, between processors;
    None for what is not compared; ``few_edges`` marks a share of the edges of one problem (see ``metrics.toml``).
    """

    name: str
    unit: str
    direction: str
    tolerance: float | None = 1e-6
    few_edges: bool = False

    def allowed(self, value: float) -> float:
        """Largest difference from a value in the table that rounding explains."""
        return self.tolerance * abs(value) + _ROUNDING


_TOLD = tomllib.loads(Path(__file__).with_name("metrics.toml").read_text(encoding="utf-8"))
METRICS = {name: Metric(name, **told) for name, told in _TOLD["compared"].items()}
METRICS |= {name: Metric(name, **told, tolerance=None) for name, told in _TOLD["not_compared"].items()}


def frobenius_errors(maps: np.ndarray, truth: np.ndarray) -> np.ndarray:
    r""":math:`\lVert\hat C_{ij}-C_{ij}\rVert_F`, (K,), of (K, n, n); not squared, as the numbers of Table 1."""
    return np.linalg.norm(maps - truth, axis=(-2, -1))


def root_mean_square(values: np.ndarray) -> float:
    """The mean that bounds of small errors speak about."""
    return float(np.sqrt(np.mean(np.square(values))))


def method_rng(seed: int) -> np.random.Generator:
    """The generator of a method, none of those that make problems: drawing from one it would start at the truth."""
    return np.random.default_rng([seed, 0x6D6574686F64])


def measure(planted: Planted, answer: Answer) -> list[list]:
    """All metrics that make sense here, as rows (name, at, value); ``at`` is the abscissa of curves, else None."""
    edges = np.unique(np.sort(planted.problem.edges, axis=1), axis=0)
    pairs = planted.pairs()
    edges = edges if len(edges) <= len(pairs) else edges[thinned(len(edges), len(pairs))]
    on_edges = answer.relative(edges)
    on_pairs = on_edges if np.array_equal(edges, pairs) else answer.relative(pairs)  # complete graphs have no others
    found: list[tuple[str, float | None, float]] = []
    for name, which, maps in (("edge", edges, on_edges), ("pair", pairs, on_pairs)):
        errors = frobenius_errors(maps, planted.relative(which))
        if np.isfinite(errors).all():
            found += [(f"{name}_error", None, errors.mean()), (f"{name}_rms", None, root_mean_square(errors))]
    cycles = cycle_error(planted.problem.n_nodes, edges, on_edges)
    if len(cycles):
        found.append(("cycle_error", None, cycles.mean()))
    if answer.draws is not None:
        found += _measure_draws(planted, answer.draws, edges)
    if planted.bases and planted.distances:
        found += _measure_points(planted, pairs, on_pairs)
    for step, relative in answer.path:
        found.append(("error_at_step", step, frobenius_errors(relative(edges), planted.relative(edges)).mean()))
    found += [(name, None, value) for name, value in {**answer.numbers(), **planted.references}.items()]
    return [[name, None if at is None else float(at), float(value)] for name, at, value in found]


def _measure_draws(planted: Planted, draws: np.ndarray, edges: np.ndarray) -> Iterator:
    chosen = draws[thinned(len(draws), _MOST_DRAWS)]
    edges = edges[thinned(len(edges), _MOST_EDGES)]
    scores, inside = [], []
    for (i, j), truth in zip(edges, planted.relative(edges)):  # edge by edge, what is at work stays in the cache
        relative = np.swapaxes(chosen[:, i], -1, -2) @ chosen[:, j]
        scores.append(calibration.energy_score(relative, truth))
        inside.append(calibration.covered(relative[:, None], truth[None], LEVELS))
    yield "energy_score", None, np.mean(scores)
    coverage = np.concatenate(inside, axis=1).mean(axis=1)
    for level, share in zip(LEVELS, coverage):
        yield f"coverage_{round(100 * level)}", None, share
    yield "calibration_error", None, calibration.calibration_error(coverage, LEVELS)
    counts = np.unique(np.geomspace(1, len(chosen), 13).astype(int))
    accuracy = oracle.oracle_accuracy(chosen, planted.truth, counts)
    yield "oracle_accuracy", None, accuracy[-1]
    for count, value in zip(counts, accuracy):
        yield "accuracy_at_draws", count, value


def _measure_points(planted: Planted, pairs: np.ndarray, maps: np.ndarray) -> Iterator:
    errors, own = [], np.arange(len(planted.scored))
    for (i, j), c in zip(pairs, maps):
        sent = point_map(c, planted.bases[i], planted.bases[j], planted.scored)
        errors.append(planted.distances[j][own, sent])
    errors = np.concatenate(errors)
    yield "point_error", None, errors.mean()
    # area under the curve by its length
    yield "point_area", None, np.maximum(0.0, 1 - errors / _LARGEST_POINT_ERROR).mean()
    for threshold in np.linspace(0, _LARGEST_POINT_ERROR, 26):
        yield "point_curve", threshold, (errors <= threshold).mean()
