"""The numbers that tables of the suites show: their names, units and how exactly another machine repeats them."""

from dataclasses import dataclass

import numpy as np

STANDARD_ERRORS = 4.0  # of one problem: the largest difference where chains part
_ROUNDING = 1e-9  # absolute: what should be zero, such as the cycle error of absolute maps, has no relative precision
LEVELS = (0.5, 0.8, 0.9, 0.95)


@dataclass(frozen=True)
class Metric:
    """A number that tables show, and how :mod:`bench.verify` compares it with the number of another run.

    ``few_edges``: whether it is a share of the edges of one problem. These are few and cross a threshold together, so
    that runs which all give the same share do not show that another run could not give a different one.
    """

    name: str
    unit: str
    direction: str  # which way is better: "lower", "higher", or "none"
    tolerance: float | None = (
        1e-6  # relative, between processors; None for what the load decides, which is not compared
    )
    few_edges: bool = False

    def allowed(self, value: float) -> float:
        """Largest difference from a value in the table that rounding explains."""
        return self.tolerance * abs(value) + _ROUNDING


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
        Metric("at_once", "cells", "none", tolerance=None),  # of tables made when chains of several seeds were a batch
    )
}


def frobenius_errors(maps: np.ndarray, truth: np.ndarray) -> np.ndarray:
    r""":math:`\lVert\hat C_{ij}-C_{ij}\rVert_F`, (K,), of (K, n, n); not squared, as the numbers of Table 1."""
    return np.linalg.norm(maps - truth, axis=(-2, -1))


def root_mean_square(values: np.ndarray) -> float:
    """The mean that bounds of small errors speak about."""
    return float(np.sqrt(np.mean(np.square(values))))


def cumulative_curve(errors: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Share of the errors that are at most each threshold."""
    return (np.asarray(errors)[None] <= np.asarray(thresholds)[:, None]).mean(axis=1)


def area_under_curve(errors: np.ndarray, largest: float) -> float:
    r"""Area under the cumulative curve on [0, largest] by its length: the mean of :math:`(1 - e/largest)_+`."""
    return float(np.maximum(0.0, 1 - np.asarray(errors) / largest).mean())


def thinned(count: int, most: int) -> np.ndarray:
    """At most ``most`` indices spread evenly over 0..count-1.

    >>> thinned(10, 4).tolist()
    [0, 3, 6, 9]
    """
    return np.linspace(0, count - 1, min(most, count)).round().astype(int)
