"""The numbers that tables of the suites show: their names, units and how exactly another machine repeats them."""

from dataclasses import dataclass

import numpy as np

STANDARD_ERRORS = 4.0  # of one problem: the largest difference where chains part
_ROUNDING = 1e-9  # absolute: what should be zero, such as the cycle error of absolute maps, has no relative precision
LEVELS = (0.5, 0.8, 0.9, 0.95)


@dataclass(frozen=True)
class Metric:
    """A number that tables show, and how :mod:`bench.verify` compares it with the number of another run.

    ``direction`` says which way is better: "lower", "higher", or "none". ``tolerance`` is relative, between processors;
    None for what the load decides, which is not compared. ``few_edges``: whether it is a share of the edges of one
    problem, which cross a threshold together: that runs all give the same one does not show that no run gives another.
    """

    name: str
    unit: str
    direction: str
    tolerance: float | None = 1e-6
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
        *(Metric(f"{name}_error", "Frobenius", "lower") for name in ("edge", "pair", "cycle")),
        *(Metric(name, "Frobenius", "lower") for name in ("edge_rms", "pair_rms", "energy_score", "error_at_step")),
        *(Metric(name, "Frobenius", "none") for name in ("floor_rms", "expected_rms")),
        *(Metric(f"coverage_{round(100 * level)}", "share", "none", few_edges=True) for level in LEVELS),
        Metric("calibration_error", "share", "lower", few_edges=True),
        *(Metric(name, "1/(1+Frobenius)", "higher") for name in ("oracle_accuracy", "accuracy_at_draws")),
        Metric("point_error", "sqrt(area)", "lower"),
        *(Metric(name, "share", "higher") for name in ("point_curve", "point_area")),
        Metric("ess_per_second", "1/s", "higher", tolerance=None),
        *(Metric(name, "s", "lower", tolerance=None) for name in ("seconds", "cpu_seconds")),
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
