r"""The concentration κ as a hyperparameter: drawn given the maps, exactly, with its normaliser.

Given the maps, :math:`p(\kappa)\propto\exp(\kappa T - E\log c_n(\kappa))` on [0, 1e5], the prior being uniform,
:math:`T=\sum w\operatorname{tr}(C_{ij}^\top C_i^\top C_j)` and E the sum of the multiplicities w. The normaliser comes
from a table: :math:`g(\kappa) = (1+\kappa)\log c_n(\kappa)/\kappa^2` rises from 1/2 to n, and is interpolated in
log(1 + κ) by cubic Hermite polynomials.
"""

from functools import cache, cached_property

import numba
import numpy as np

from fmsync import langevin
from fmsync.samplers.base import Target
from fmsync.samplers.random_streams import uniform

LARGEST_KAPPA = 1e5
_KNOTS = 1201
_UPDATES = 4  # slices a step: the draws are then nearly independent of the last κ


@cache
def normaliser_table(n: int) -> np.ndarray:
    """Values and slopes in log(1 + κ) of g at equally spaced knots, (2, 1201)."""
    u = np.linspace(0, np.log1p(LARGEST_KAPPA), _KNOTS)
    kappa = np.minimum(np.expm1(u), LARGEST_KAPPA)
    table = np.empty((2, _KNOTS))
    second, third = (2.0, 0.0) if n == 2 else (1.0, float(n == 3))  # Haar moments of the trace
    table[:, 0] = second / 2, second / 2 + third / 6
    for part in np.array_split(np.arange(1, _KNOTS), 40):  # the cost of a batch is that of its largest κ
        k = kappa[part]
        value, slope = langevin.log_normaliser(n, k), n * langevin.mean_cosine(n, k)
        table[0, part] = value * (1 + k) / k**2
        table[1, part] = (slope * (1 + k) - value * (1 + 2 / k)) / k**2 * (1 + k)
    table.setflags(write=False)
    return table


@numba.njit(cache=True, nogil=True)
def interpolated_log_normaliser(kappa: float, table: np.ndarray) -> float:
    """log c_n(κ) from the table of n, with a relative error below 1e-8."""
    knots = table.shape[1]
    width = np.log1p(LARGEST_KAPPA) / (knots - 1)
    u = np.log1p(kappa) / width
    k = min(int(u), knots - 2)
    t = u - k
    s = 1 - t
    g = s * s * ((1 + 2 * t) * table[0, k] + t * width * table[1, k])
    g += t * t * ((3 - 2 * t) * table[0, k + 1] - s * width * table[1, k + 1])
    return g * kappa * kappa / (1 + kappa)


@numba.njit(cache=True, nogil=True)
def draw_kappa(kappa: float, trace: float, count: float, n: int, table: np.ndarray, state: np.ndarray) -> float:
    """New κ given T = trace and E = count, by slice sampling of its log-concave density."""
    dim = n * (n - 1) / 2
    for _ in range(_UPDATES):
        width = 3 * max(kappa * np.sqrt(2 / (count * dim)), 1 / (n * np.sqrt(count)))
        here = kappa * trace - count * interpolated_log_normaliser(kappa, table)
        level = here + np.log(1 - uniform(state))
        low = kappa - width * uniform(state)
        high = low + width
        while low > 0 and low * trace - count * interpolated_log_normaliser(low, table) > level:
            low -= width
        while high < LARGEST_KAPPA and high * trace - count * interpolated_log_normaliser(high, table) > level:
            high += width
        low, high = max(low, 0.0), min(high, LARGEST_KAPPA)
        while True:
            new = low + (high - low) * uniform(state)
            if new * trace - count * interpolated_log_normaliser(new, table) >= level:
                break
            if new < kappa:
                low = new
            else:
                high = new
        kappa = new
    return kappa


class Concentration:
    """κ of every chain: a number that stays, or inferred with the maps where the target gives none."""

    def __init__(self, target: Target, n_chains: int, rng: np.random.Generator):
        self.inferred = not isinstance(target.kappa, float)
        value = target.matched_kappa("kappa", rng) if self.inferred else target.fixed_kappa()
        self.value = np.full(n_chains, value)
        self._n, self._count = target.problem.n, float(target.problem.weights.sum())
        self._table = normaliser_table(self._n) if self.inferred else np.empty((2, 0))

    def update(
        self, traces: np.ndarray, states: np.ndarray, powers: np.ndarray, counts: np.ndarray | None = None
    ) -> None:
        """Draw κ of every chain given T (K,); states (K, 4, 8) generators, powers (K,) of the likelihood.

        ``counts`` (K,) are E where it is not that of all observations.
        """
        counts = np.full(len(traces), self._count) if counts is None else np.maximum(counts, 1e-9)  # of none: the prior
        for k, (trace, count, b) in enumerate(zip(traces, counts, powers)):
            self.value[k] = draw_kappa(self.value[k], b * trace, b * count, self._n, self._table, states[k])

    def log_likelihood(self, traces: np.ndarray) -> np.ndarray:
        """(K,) κ T, and where κ is inferred - E log c_n(κ)."""
        if not self.inferred:
            return self.value * traces
        return self.value * traces - self._count * self.log_normaliser()

    @cached_property
    def _fixed(self) -> np.ndarray:
        return langevin.log_normaliser(self._n, self.value)

    def log_normaliser(self) -> np.ndarray:
        """(K,) log c_n(κ)."""
        if not self.inferred:
            return self._fixed
        return np.array([interpolated_log_normaliser(kappa, self._table) for kappa in self.value])
