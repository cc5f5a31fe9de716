r"""The noise level as an unknown: the concentration κ drawn given the maps, exactly, with its normaliser.

Given the maps, :math:`p(\kappa)\propto\exp(\kappa T - E\log c_n(\kappa))` on [0, 1e5], the prior being uniform,
:math:`T=\sum w\operatorname{tr}(C_{ij}^\top C_i^\top C_j)` and E the sum of the multiplicities w. The normaliser comes
from a table: :math:`g(\kappa) = (1+\kappa)\log c_n(\kappa)/\kappa^2` rises from 1/2 to n, and is interpolated in
log(1 + κ) by cubic Hermite polynomials.
"""

from functools import cache

import numba
import numpy as np

from fmsync import langevin
from fmsync.energy import energy
from fmsync.estimators.solve import solve
from fmsync.problem import LangevinPrior, SyncProblem, check_rotations
from fmsync.samplers.base import concentration
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
    width = np.log1p(100000.0) / (knots - 1)
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
        while high < 1e5 and high * trace - count * interpolated_log_normaliser(high, table) > level:
            high += width
        low, high = max(low, 0.0), min(high, 1e5)
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
    """κ of every chain: a number that stays, or inferred with the maps (``kappa="auto"``, which is the default).

    Raises ValueError where κ cannot be inferred: a forest without repeated edges (there the observations are met
    exactly by some maps, whatever their noise), or observations off the group.
    """

    def __init__(
        self,
        problem: SyncProblem,
        prior: LangevinPrior | None,
        kappa: float | str | None,
        beta: float | None,
        n_chains: int,
        rng: np.random.Generator,
    ):
        if isinstance(kappa, str) and kappa != "auto":
            raise ValueError(f"kappa: a number > 0 or 'auto', not {kappa!r}")
        self.inferred = beta is None and (kappa is None or kappa == "auto")
        if self.inferred:
            check_identified(problem, prior, "kappa")
            check_rotations(problem.maps, "maps (node = edge)")
            self._table = normaliser_table(problem.n)
            self.value = np.full(n_chains, matched_to_spectral(problem, rng))
        else:
            self.value = np.full(n_chains, concentration(kappa, beta))
        self._n, self._count = problem.n, float(problem.weights.sum())

    def update(self, traces: np.ndarray, states: np.ndarray) -> None:
        """Draw κ of every chain given T (K,); states (K, 4) generators."""
        for k, trace in enumerate(traces):
            self.value[k] = draw_kappa(self.value[k], trace, self._count, self._n, self._table, states[k])


def check_identified(problem: SyncProblem, prior: LangevinPrior | None, name: str) -> None:
    """Raise a ValueError unless some loop, of edges or through the prior, contradicts itself when there is noise."""
    held, nodes = (0, problem.n_nodes) if prior is None else (int((prior.kappa > 0).sum()), problem.n_nodes + 1)
    if problem.n_edges + held < nodes:
        raise ValueError(
            f"{name}: a tree without repeated edges says nothing about its noise level, every observation can be met "
            f"exactly; give {name} a value, or add observations"
        )


def matched_to_spectral(problem: SyncProblem, rng: np.random.Generator) -> float:
    """The κ whose mean cosine is that of the observations around the spectral estimate: where chains begin."""
    absolute = solve(problem, "spectral", rng=rng).absolute
    trace = (problem.constant - energy(problem, absolute)) / 2
    cosine = trace / (problem.n * problem.weights.sum())
    return max(langevin.matched_kappa(problem.n, min(cosine, 1 - 1e-3)), 0.1)
