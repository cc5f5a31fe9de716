r"""The concentration κ as a hyperparameter: drawn given the maps, exactly, with its normaliser.

Given the maps, :math:`p(\kappa)\propto\exp(\kappa T - E\log c_n(\kappa))` on [0, 1e5], the prior being uniform,
:math:`T=\sum w\operatorname{tr}(C_{ij}^\top C_i^\top C_j)` and E the sum of the multiplicities w. The normaliser comes
from a table: :math:`g(\kappa) = (1+\kappa)\log c_n(\kappa)/\kappa^2` rises from 1/2 to n, and is interpolated in
log(1 + κ) by cubic Hermite polynomials.

With a concentration for every observation these are, a priori, independent gamma variables cut to [0, 1e5], of shape a
and mean m (before the cut), where log a and log m are uniform on the points :data:`SHAPES` and :data:`MEANS`. Given the
maps each κ is drawn as above, its density :math:`\kappa^{a-1}\exp(\kappa(T-a/m)-\log c_n(\kappa))` being log-concave
too; given all κ, m and then a are drawn from their tables. All steps are exact.

With a concentration λ for every basis function, uniform on [0, 1e5] each, :math:`p(Z)\propto\exp\sum\lambda_aZ_{aa}`.
The normaliser is approximated by :math:`c_n(g)\exp(\sum\lambda_a-ng)`, g the geometric mean of the means of all pairs:
exact where all λ are equal, for n = 2, and in the limit of small noise, where the entries of log Z are independent and
normal with variances :math:`1/(\lambda_a+\lambda_b)`. It is too large where most λ are below one, which
draws them towards each other.
"""

from functools import cache, cached_property

import numba
import numpy as np
from scipy.special import gammainc, gammaln

from fmsync import langevin, so
from fmsync.problem import SyncProblem
from fmsync.samplers.base import Target
from fmsync.samplers.random_streams import uniform

LARGEST_KAPPA = 1e5
SHAPES = np.geomspace(1, 100, 24)  # at 100 concentrations hardly differ; below 1 the density is not log-concave
MEANS = np.geomspace(0.1, LARGEST_KAPPA, 1401)
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
def _log_density(kappa: float, trace: float, count: float, power: float, table: np.ndarray) -> float:
    return kappa * trace - count * interpolated_log_normaliser(kappa, table) + power * np.log(kappa)


@numba.njit(cache=True, nogil=True)
def draw_kappa(
    kappa: float, trace: float, count: float, power: float, n: int, table: np.ndarray, state: np.ndarray
) -> float:
    r"""New κ of the log-concave density :math:`\kappa^{power}\exp(\kappa T-E\log c_n(\kappa))` by slices.

    T = ``trace``, E = ``count``, ``power`` >= 0.
    """
    dim = n * (n - 1) / 2
    for _ in range(_UPDATES):
        width = 3 * max(kappa * np.sqrt(2 / (count * dim + 2 * power)), 1 / (n * np.sqrt(count + power)))
        level = _log_density(kappa, trace, count, power, table) + np.log(1 - uniform(state))
        low = kappa - width * uniform(state)
        high = low + width
        while low > 0 and _log_density(low, trace, count, power, table) > level:
            low -= width
        while high < LARGEST_KAPPA and _log_density(high, trace, count, power, table) > level:
            high += width
        low, high = max(low, 0.0), min(high, LARGEST_KAPPA)
        while True:
            new = low + (high - low) * uniform(state)
            if _log_density(new, trace, count, power, table) >= level:
                break
            if new < kappa:
                low = new
            else:
                high = new
        kappa = new
    return kappa


class Concentration:
    """κ of every chain: a number that stays, or inferred with the maps where the target gives none.

    ``value`` (K,) are the present ones, ``count`` is E, ``table`` that of the normaliser, empty if κ stays.
    """

    def __init__(self, target: Target, n_chains: int, rng: np.random.Generator):
        self.inferred = not isinstance(target.kappa, float)
        value = target.matched_kappa("kappa", rng) if self.inferred else target.fixed_kappa()
        self.value = np.full(n_chains, value)
        self._n, self.count = target.problem.n, float(target.problem.weights.sum())
        self.table = normaliser_table(self._n) if self.inferred else np.empty((2, 0))

    def update(
        self, traces: np.ndarray, states: np.ndarray, powers: np.ndarray, counts: np.ndarray | None = None
    ) -> None:
        """Draw κ of every chain given T (K,); states (K, 4, 8) generators, powers (K,) of the likelihood.

        ``counts`` (K,) are E where it is not that of all observations.
        """
        counts = np.full(len(traces), self.count) if counts is None else np.maximum(counts, 1e-9)  # of none: the prior
        for k, (trace, count, b) in enumerate(zip(traces, counts, powers)):
            self.value[k] = draw_kappa(self.value[k], b * trace, b * count, 0.0, self._n, self.table, states[k])

    def log_likelihood(self, traces: np.ndarray) -> np.ndarray:
        """(K,) κ T, and where κ is inferred - E log c_n(κ)."""
        if not self.inferred:
            return self.value * traces
        return self.value * traces - self.count * self.log_normaliser()

    @cached_property
    def _fixed(self) -> np.ndarray:
        return langevin.log_normaliser(self._n, self.value)

    def log_normaliser(self) -> np.ndarray:
        """(K,) log c_n(κ)."""
        if not self.inferred:
            return self._fixed
        return np.array([interpolated_log_normaliser(kappa, self.table) for kappa in self.value])


@numba.njit(cache=True, nogil=True)
def _pick(log_weights: np.ndarray, state: np.ndarray) -> int:
    cumulative = np.exp(log_weights - log_weights.max()).cumsum()
    return min(np.searchsorted(cumulative, uniform(state) * cumulative[-1], side="right"), len(cumulative) - 1)


@numba.njit(cache=True, nogil=True)
def draw_by_edge(
    kappas: np.ndarray,
    level: np.ndarray,
    traces: np.ndarray,
    inverse_temperature: float,
    n: int,
    table: np.ndarray,
    prior: tuple[np.ndarray, np.ndarray, np.ndarray],
    state: np.ndarray,
) -> None:
    """New κ (E,) given a, m and ``traces`` (E,), then m and a given κ, in place: ``level`` has the places of a and m.

    ``prior`` are SHAPES, MEANS and the logarithms (24, 1401) of the factors that make the densities of κ integrate to
    1; the likelihood counts ``inverse_temperature`` times.
    """
    shapes, means, factor = prior
    a, rate = shapes[level[0]], shapes[level[0]] / means[level[1]]
    for e in range(len(kappas)):
        trace = inverse_temperature * traces[e] - rate
        kappas[e] = draw_kappa(kappas[e], trace, inverse_temperature, a - 1, n, table, state)
    total, logarithms, count = kappas.sum(), np.log(kappas).sum(), len(kappas)
    level[1] = _pick(count * factor[level[0]] - a * total / means, state)
    level[0] = _pick(count * factor[:, level[1]] + shapes * (logarithms - total / means[level[1]]), state)


class EdgeConcentrations:
    """A concentration of every observation, ``kappas`` (K, E); map sweeps read ``maps`` (1, E, n, n) and ``weights``.

    ``kappa`` (K,) are the means over the observations, by which the weights (K, E) are divided, and ``prior`` is what
    :func:`draw_by_edge` takes.
    """

    inferred = True

    def __init__(self, target: Target, n_chains: int, rng: np.random.Generator):
        self._problem = p = target.problem
        if target.kappa is not None:
            told = f"a concentration for every {target.likelihood.removeprefix('by-')}; leave them out"
            raise ValueError(f"kappa, beta: likelihood={target.likelihood!r} infers {told}")
        start = target.matched_kappa("kappa", rng)
        self.kappas = np.full((n_chains, p.n if target.likelihood == "by-frequency" else p.n_edges), start)
        self._level = np.tile([len(SHAPES) // 2, np.searchsorted(MEANS, start)], (n_chains, 1))
        a, m = SHAPES[:, None], MEANS
        self.prior = SHAPES, MEANS, a * np.log(a / m) - gammaln(a) - np.log(gammainc(a, a * LARGEST_KAPPA / m))
        self._table = normaliser_table(p.n)
        self.maps, self.weights = p.maps[None], np.empty((n_chains, p.n_edges))

    @property
    def kappa(self) -> np.ndarray:
        return self.kappas.mean(axis=1)

    def step(self, x: np.ndarray, states: np.ndarray, infer: bool, over_chains: object, powers: np.ndarray) -> None:
        """With ``infer`` new concentrations given the transposed maps x (K, N, n, n); then the weights.

        ``powers`` (K,) multiply the log-likelihood.
        """
        p = self._problem
        for k, (seen, b) in enumerate(zip(traces(p, x), powers)):
            if infer:
                draw_by_edge(self.kappas[k], self._level[k], seen, b, p.n, self._table, self.prior, states[k])
        self.weights[:] = self.kappas / self.kappa[:, None]

    def log_likelihood(self, x: np.ndarray) -> np.ndarray:
        """(K,) at transposed maps x (K, N, n, n)."""
        normalisers = [sum(interpolated_log_normaliser(kappa, self._table) for kappa in own) for own in self.kappas]
        return (self.kappas * traces(self._problem, x)).sum(axis=1) - normalisers


@numba.njit(cache=True, nogil=True)
def log_normaliser_by_frequency(own: np.ndarray, table: np.ndarray) -> float:
    """Of the concentrations λ (n,): approximate, see above."""
    n, total = len(own), 0.0
    for a in range(n):
        for b in range(a):
            total += np.log((own[a] + own[b]) / 2)
    mean = np.exp(2 * total / (n * (n - 1)))
    return own.sum() + interpolated_log_normaliser(mean, table) - n * mean


@numba.njit(cache=True, nogil=True)
def draw_by_frequency(own: np.ndarray, traces: np.ndarray, count: float, table: np.ndarray, state: np.ndarray) -> None:
    """Metropolis steps of log λ, in place, given the diagonal (n,) of the sum of ``count`` residual rotations."""
    n = len(own)
    width = min(7 / np.sqrt(count * max(n - 1, 1)), 3.0)  # of a uniform step: some standard deviations
    before = own @ traces - count * log_normaliser_by_frequency(own, table)
    for k in range(_UPDATES * n):
        old, step = own[k % n], width * (2 * uniform(state) - 1)
        own[k % n] = min(old * np.exp(step), LARGEST_KAPPA)
        after = own @ traces - count * log_normaliser_by_frequency(own, table)
        if own[k % n] < LARGEST_KAPPA and np.log(1 - uniform(state)) < after - before + step:
            before = after
        else:
            own[k % n] = old


class FrequencyConcentrations(EdgeConcentrations):
    """A concentration of every basis function, ``kappas`` (K, n), of which ``kappa`` (K,) are the means.

    Map sweeps read ``maps`` (K, E, n, n): columns of the observations, each times its concentration over the mean.
    """

    def __init__(self, target: Target, n_chains: int, rng: np.random.Generator):
        super().__init__(target, n_chains, rng)
        p = target.problem
        self.maps, self.weights = np.empty((n_chains, *p.maps.shape)), p.weights[None]

    def step(self, x: np.ndarray, states: np.ndarray, infer: bool, over_chains: object, powers: np.ndarray) -> None:
        p = self._problem
        for own, seen, b, state, maps in zip(self.kappas, self._traces(x), powers, states, self.maps):
            if infer:
                draw_by_frequency(own, b * seen, b * p.n_edges, self._table, state)
            np.multiply(p.maps, own / own.mean(), out=maps)

    def log_likelihood(self, x: np.ndarray) -> np.ndarray:
        normalisers = np.array([log_normaliser_by_frequency(own, self._table) for own in self.kappas])
        return (self.kappas * self._traces(x)).sum(axis=1) - self._problem.n_edges * normalisers

    def _traces(self, x: np.ndarray) -> np.ndarray:
        i, j = self._problem.edges.T
        return np.stack([(self._problem.maps * (c[i] @ so.transpose(c[j]))).sum(axis=(0, 1)) for c in x])


def traces(problem: SyncProblem, x: np.ndarray) -> np.ndarray:
    """(K, E) traces of every observation against the relative map, of transposed maps x (K, N, n, n)."""
    i, j = problem.edges.T
    return np.stack([np.einsum("eab,eab->e", c[i], problem.maps @ c[j]) for c in x])
