"""Every metric that makes sense for an answer."""

from collections.abc import Iterator

import numpy as np

from bench import metrics
from bench.methods import Answer
from bench.planted import Planted
from fmsync import calibration, oracle
from fmsync.functional_maps import point_map
from fmsync.problem import cycle_error

_MOST_DRAWS = 1000
_MOST_EDGES = 20  # whose draws are scored: edges of one problem say much the same
_LARGEST_POINT_ERROR = 0.25


def method_rng(seed: int) -> np.random.Generator:
    """The generator of a method, none of those that make problems: drawing from one it would start at the truth."""
    return np.random.default_rng([seed, 0x6D6574686F64])


def measure(planted: Planted, answer: Answer) -> list[list]:
    """All metrics that make sense here, as rows (name, at, value); ``at`` is the abscissa of curves, else None."""
    edges = np.unique(np.sort(planted.problem.edges, axis=1), axis=0)
    pairs = planted.pairs()
    edges = edges if len(edges) <= len(pairs) else edges[metrics.thinned(len(edges), len(pairs))]
    on_edges = answer.relative(edges)
    on_pairs = on_edges if np.array_equal(edges, pairs) else answer.relative(pairs)  # complete graphs have no others
    found: list[tuple[str, float | None, float]] = []
    for name, which, maps in (("edge", edges, on_edges), ("pair", pairs, on_pairs)):
        errors = metrics.frobenius_errors(maps, planted.relative(which))
        if np.isfinite(errors).all():
            found += [(f"{name}_error", None, errors.mean()), (f"{name}_rms", None, metrics.root_mean_square(errors))]
    cycles = cycle_error(planted.problem.n_nodes, edges, on_edges)
    if len(cycles):
        found.append(("cycle_error", None, cycles.mean()))
    if answer.draws is not None:
        found += _measure_draws(planted, answer.draws, edges)
    if planted.bases and planted.distances:
        found += _measure_points(planted, pairs, on_pairs)
    for step, relative in answer.path:
        found.append(("error_at_step", step, metrics.frobenius_errors(relative(edges), planted.relative(edges)).mean()))
    found += [(name, None, value) for name, value in {**answer.numbers(), **planted.references}.items()]
    return [[name, None if at is None else float(at), float(value)] for name, at, value in found]


def _measure_draws(planted: Planted, draws: np.ndarray, edges: np.ndarray) -> Iterator:
    chosen = draws[metrics.thinned(len(draws), _MOST_DRAWS)]
    edges = edges[metrics.thinned(len(edges), _MOST_EDGES)]
    truth = planted.relative(edges)
    relative = np.swapaxes(chosen[:, edges[:, 0]], -1, -2) @ chosen[:, edges[:, 1]]
    yield "energy_score", None, calibration.energy_score(relative, truth)
    coverage = calibration.covered(relative, truth, metrics.LEVELS).mean(axis=1)
    for level, share in zip(metrics.LEVELS, coverage):
        yield f"coverage_{round(100 * level)}", None, share
    yield "calibration_error", None, calibration.calibration_error(coverage, metrics.LEVELS)
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
    yield "point_area", None, metrics.area_under_curve(errors, _LARGEST_POINT_ERROR)
    thresholds = np.linspace(0, _LARGEST_POINT_ERROR, 26)
    for threshold, share in zip(thresholds, metrics.cumulative_curve(errors, thresholds)):
        yield "point_curve", threshold, share
