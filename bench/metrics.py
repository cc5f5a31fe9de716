r"""How far an answer is from the truth, and how honest its uncertainty is: every number a table of the suite shows."""

from dataclasses import dataclass

import numpy as np

LEVELS = (0.5, 0.8, 0.9, 0.95)
_MOST_DRAWS = 200  # of the energy score, whose cost grows with their square


@dataclass(frozen=True)
class Metric:
    """A number that tables show, and how :mod:`bench.verify` compares it with the number of another run.

    Attributes
    ----------
    name, unit
        As in the tables.
    direction
        Which way is better: ``"lower"``, ``"higher"`` or ``"none"`` for context.
    tolerance
        Largest relative difference between processors, beside :data:`ROUNDING`; None for what the load of a machine
        decides (time, memory), which is not compared.
    standard_errors
        Largest difference where chains part, in Monte Carlo standard errors of one problem.
    few_edges
        Whether it is a share of the edges of one problem. These are few and cross a threshold together, so that runs
        which all give the same share do not show that another run could not give a different one.

    Examples
    --------
    >>> METRICS["edge_error"].tolerance, METRICS["seconds"].tolerance
    (1e-06, None)
    """

    name: str
    unit: str
    direction: str
    tolerance: float | None = 1e-6
    standard_errors: float = 4.0
    few_edges: bool = False


ROUNDING = 1e-9  # absolute: what should be zero, such as the cycle error of absolute maps, has no relative precision

# 315 runs of all methods but samplers were computed on an Intel Xeon (the tables), on an AMD EPYC, and on the latter in
# the arithmetic of an old processor. In 298 of them every metric differs by less than 1e-8 of its value, or less than
# 1e-12: no metric is ill-conditioned by itself, and all have the same tolerance. The other 17 runs are ill-conditioned
# as a whole, because of the method (linear programs with many solutions, nearest vertices) or of the problem (two
# minima). `bench.verify` finds out which runs these are by moving the last digits of their observations.
METRICS = {
    metric.name: metric
    for metric in (
        Metric("edge_error", "Frobenius", "lower"),
        Metric("edge_rms", "Frobenius", "lower"),
        Metric("pair_error", "Frobenius", "lower"),
        Metric("pair_rms", "Frobenius", "lower"),
        Metric("cycle_error", "Frobenius", "lower"),
        Metric("energy_score", "Frobenius", "lower"),
        *(Metric(f"coverage_{round(100 * level)}", "share", "none", few_edges=True) for level in LEVELS),
        Metric("calibration_error", "share", "lower", few_edges=True),
        Metric("oracle_accuracy", "1/(1+Frobenius)", "higher"),
        Metric("point_error", "sqrt(area)", "lower"),
        Metric("point_curve", "share", "higher"),
        Metric("point_area", "share", "higher"),
        Metric("error_at_step", "Frobenius", "lower"),
        Metric("accuracy_at_draws", "1/(1+Frobenius)", "higher"),
        Metric("ess_per_second", "1/s", "higher", tolerance=None),
        Metric("floor_rms", "Frobenius", "none"),
        Metric("expected_rms", "Frobenius", "none"),
        Metric("seconds", "s", "lower", tolerance=None),
        Metric("cpu_seconds", "s", "lower", tolerance=None),
        Metric("peak_memory", "MB", "lower", tolerance=None),
        Metric("at_once", "cells", "none", tolerance=None),
    )
}


def frobenius_errors(maps: np.ndarray, truth: np.ndarray) -> np.ndarray:
    r""":math:`\lVert\hat C_{ij}-C_{ij}\rVert_F`, (K,), of maps (K, n, n); not squared, as the numbers of Table 1 are.

    Examples
    --------
    >>> import numpy as np
    >>> frobenius_errors(np.zeros((1, 3, 3)), np.eye(3)[None]).round(3)
    array([1.732])
    """
    return np.linalg.norm(maps - truth, axis=(-2, -1))


def root_mean_square(values: np.ndarray) -> float:
    """The mean that error floors speak about.

    Examples
    --------
    >>> root_mean_square([3.0, 4.0]) == 12.5 ** 0.5
    True
    """
    return float(np.sqrt(np.mean(np.square(values))))


def energy_score(draws: np.ndarray, truth: np.ndarray) -> float:
    r"""Energy score :math:`E\lVert X-y\rVert-\tfrac12E\lVert X-X'\rVert`, averaged over pairs of nodes.

    Strictly proper: no distribution does better than the true posterior on average (Gneiting & Raftery 2007).
    Two hundred draws, evenly spread over those given, are looked at.

    Parameters
    ----------
    draws
        (T, K, n, n) relative maps of K pairs.
    truth
        (K, n, n).

    Raises
    ------
    ValueError
        Fewer than two draws.

    Examples
    --------
    >>> import numpy as np
    >>> two = np.zeros((2, 1, 2, 2)); two[1, 0, 0, 0] = 2.0
    >>> energy_score(two, np.zeros((1, 2, 2)))
    0.0
    """
    if len(draws) < 2:
        raise ValueError(f"draws: the energy score needs at least two, got {len(draws)}")
    chosen = draws[thinned(len(draws), _MOST_DRAWS)]
    count = len(chosen)
    near = frobenius_errors(chosen, truth).mean()
    apart = 0.0
    for pair in range(chosen.shape[1]):
        flat = chosen[:, pair].reshape(count, -1)
        squares = np.einsum("ta,ta->t", flat, flat)
        squared = squares[:, None] + squares - 2 * flat @ flat.T
        apart += np.sqrt(np.maximum(squared, 0)).sum() - np.sqrt(np.maximum(np.diag(squared), 0)).sum()
    apart /= chosen.shape[1] * count * (count - 1)  # unbiased: a draw is not compared with itself
    return float(near - apart / 2)


def covered(draws: np.ndarray, truth: np.ndarray, levels: tuple[float, ...] = LEVELS) -> np.ndarray:
    r"""Whether credible balls hold the truth, (levels, K) booleans.

    The ball of a pair is centred at the mean m of the *even* draws, and its radius is the quantile of
    :math:`\lVert X-m\rVert` over the *odd* ones: a centre taken from the same draws would lie too close to them.

    Parameters
    ----------
    draws
        (T, K, n, n) relative maps, T >= 4.
    truth
        (K, n, n).

    Raises
    ------
    ValueError
        Fewer than four draws.

    Examples
    --------
    >>> import numpy as np
    >>> draws = np.random.default_rng(0).standard_normal((400, 1, 2, 2))
    >>> covered(draws, np.zeros((1, 2, 2))).ravel().tolist()
    [True, True, True, True]
    """
    if len(draws) < 4:
        raise ValueError(f"draws: credible balls need at least four, got {len(draws)}")
    centre = draws[::2].mean(axis=0)
    radii = np.quantile(frobenius_errors(draws[1::2], centre), levels, axis=0)  # (levels, K)
    return frobenius_errors(truth, centre) <= radii


def calibration_error(coverage: np.ndarray, levels: tuple[float, ...] = LEVELS) -> float:
    """Mean distance of coverage (levels,) from the level that was promised.

    Examples
    --------
    >>> calibration_error([0.6, 0.8, 0.9, 0.95])
    0.025
    """
    return round(float(np.abs(np.asarray(coverage) - levels).mean()), 12)


def point_errors(point_map: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """Geodesic distance (P,) of where some vertices were sent from where they belong.

    Parameters
    ----------
    point_map
        (P,) vertices of the other shape.
    distances
        (P, V) on the other shape, from where they belong to all of its vertices.

    Examples
    --------
    >>> import numpy as np
    >>> point_errors(np.array([0, 0]), np.array([[0.0, 0.3], [0.3, 0.0]]))
    array([0. , 0.3])
    """
    return distances[np.arange(len(point_map)), point_map]


def cumulative_curve(errors: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Share of the errors that are at most each threshold.

    Examples
    --------
    >>> cumulative_curve([0.0, 0.1, 0.2, 0.9], [0.1, 0.25]).tolist()
    [0.5, 0.75]
    """
    return (np.asarray(errors)[None] <= np.asarray(thresholds)[:, None]).mean(axis=1)


def area_under_curve(errors: np.ndarray, largest: float) -> float:
    r"""Area under the cumulative curve on [0, largest], divided by ``largest``: the mean of :math:`(1 - e/largest)_+`.

    Examples
    --------
    >>> area_under_curve([0.0, 0.05, 0.2], largest=0.1)
    0.5
    """
    return float(np.maximum(0.0, 1 - np.asarray(errors) / largest).mean())


def thinned(count: int, most: int) -> np.ndarray:
    """At most ``most`` indices spread evenly over 0..count-1.

    Examples
    --------
    >>> thinned(10, 4).tolist()
    [0, 3, 6, 9]
    """
    return np.linspace(0, count - 1, min(most, count)).round().astype(int)
