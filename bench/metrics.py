"""The numbers that tables of the suites show: their names, units and how exactly another machine repeats them."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

STANDARD_ERRORS = 4.0  # of one problem: the largest difference where chains part
_ROUNDING = 1e-9  # absolute: what should be zero, such as the cycle error of absolute maps, has no relative precision
LEVELS = (0.5, 0.8, 0.9, 0.95)


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
