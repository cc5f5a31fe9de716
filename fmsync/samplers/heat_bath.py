"""The heat bath: sweeps over planes of every map, without a step size."""

from collections.abc import Callable

import numba
import numpy as np

from fmsync import checks, so
from fmsync.energy import energy_unchecked as euclidean_energy
from fmsync.samplers import langevin_kernels, plane_rotations
from fmsync.samplers.base import Sampler, Target, sampler
from fmsync.samplers.concentration import Concentration, EdgeConcentrations, FrequencyConcentrations, draw_kappa
from fmsync.samplers.inliers import Inliers
from fmsync.samplers.polar_factor import PolarFactors
from fmsync.samplers.random_streams import generators
from fmsync.samplers.thread_pool import ThreadPool

_REPAIR_EVERY = 200  # steps between two re-orthonormalisations, which also renew the accumulated energy
# Below these a thread costs more to wake than it saves: N n² (n + 30) of all chains; of a colour, its nodes a thread.
_WORTH_THREADS, _LEAST_COLOUR = 3e5, 4
_AHEAD, _SMALL = 10, 1e6  # steps made at once by chains side by side, if all their maps are at most a million numbers
_SWEEPS_A_DRAW = 2  # of indicators, polar factors, or a concentration for every edge or function: the slower part
_BURN_IN = 100  # steps of the warm-up before an unknown κ or σ² moves: chains from random maps must order first

_Latent = PolarFactors | Inliers | EdgeConcentrations
_LATENT: dict[str, Callable[..., _Latent]] = {
    "projected-gaussian": PolarFactors, "mixture": Inliers, "by-edge": EdgeConcentrations,
    "by-frequency": FrequencyConcentrations,
}  # fmt: skip


@sampler("heat-bath")
class HeatBath(Sampler):
    r"""Givens–von Mises heat bath with over-relaxation for the Euclidean energy: exact and without tuning.

    Given the rest, map i has density :math:`\propto\exp(\kappa\operatorname{tr}(S_i^\top C_i))`, and the angle by which
    two of its columns are rotated is von Mises. A sweep visits every pair of columns of every map and moves the angle
    beyond its mode, in part to a new draw (``plane_rotations.over_relaxed``): neighbouring draws are less alike than
    with new draws alone.

    On several cores chains run side by side, or, when they are fewer than the cores, the nodes of one graph colour if
    these are many. Draws do not depend on the number of threads, which is that of numba (``NUMBA_NUM_THREADS``).
    """

    @checks.checked(start="K N n n")
    def __init__(self, target: Target, start: np.ndarray, rng: np.random.Generator):
        target.only("heat-bath", energy="euclidean")
        problem = target.problem
        self._problem, self._age = problem, 0
        streams = generators(rng, len(start), problem.n_nodes + 1)  # of the chain, then of its nodes
        self._states, self._streams = np.ascontiguousarray(streams[:, 0]), np.ascontiguousarray(streams[:, 1:])
        self._x = np.ascontiguousarray(so.transpose(start))  # (K, N, n, n), transposed maps
        self._field, self._likelihood = target.field, target.likelihood
        self._planes = plane_rotations.rounds(problem.n)
        self._order, self._colours = plane_rotations.colours(*problem.incidence[::2])
        self._gains = np.empty(start.shape[:2])
        self.threads = ThreadPool(alone=self._gains.size * problem.n**2 * (problem.n + 30) <= _WORTH_THREADS)
        self.inverse_temperature = np.ones(len(start))
        self._latent: _Latent | None = None
        self._normaliser = 0.0, np.empty((2, 0))
        if target.likelihood == "langevin":
            self._concentration = own = Concentration(target, len(start), rng)
            self._kappa, self._normaliser = own.value, (own.count, own.table)
            maps, weights = problem.maps[None], problem.weights[None]  # every chain reads the same
        else:
            self._latent = latent = _LATENT[target.likelihood](target, len(start), rng)
            self._kappa, maps, weights = latent.kappa, latent.maps, latent.weights
        self._read = maps.view(), weights.view()
        for a in self._read:
            a.setflags(write=False)  # one compiled signature
        small_colours = np.diff(self._colours).max() < _LEAST_COLOUR * self.threads.size
        self._side_by_side = len(start) >= self.threads.size or small_colours
        self._ahead = _AHEAD if self._x.size <= _SMALL and self._side_by_side else 1
        self._at = 0
        self._refresh()
        self._kept = self._x[:, None], self._traces[:, None], self._kappa[:, None]

    @property
    def settings(self) -> dict[str, object]:
        inferred = (self._latent or self._concentration).inferred
        return {"likelihood": self._likelihood, "kappa_inferred": inferred}

    @property
    def state(self) -> np.ndarray:
        return so.transpose(self._kept[0][:, self._at])

    @property
    def kappa(self) -> np.ndarray:  # type: ignore[override]
        return self._kept[2][:, self._at]

    @property
    def edge_weights(self) -> np.ndarray | None:  # type: ignore[override]
        return self._latent.probabilities(self._x) if isinstance(self._latent, Inliers) else None

    @property
    def kappas(self) -> np.ndarray | None:  # type: ignore[override]
        return self._latent.kappas if isinstance(self._latent, EdgeConcentrations) else None

    def energy(self) -> np.ndarray:
        if self._latent is not None:
            return euclidean_energy(self._problem, self.state)
        return self._problem.constant - 2 * self._kept[1][:, self._at]

    def step(self, warmup: bool) -> None:
        """A draw of κ and a sweep, or of other likelihoods a draw of their latent variables and two sweeps.

        Small chains that wait for nothing go some steps ahead, because to share out every single step takes long;
        ``state``, ``kappa`` and :meth:`energy` are those of the present one.
        """
        self._at += 1
        if self._at < self._kept[0].shape[1]:
            return
        moving, inferred = not (warmup and self._age < _BURN_IN), self._latent is None and self._concentration.inferred
        if self._latent is not None:
            self._latent.step(self._x, self._states, moving, self.threads.parallel_for, self.inverse_temperature)
            self._kappa[:] = self._latent.kappa
        settled = self._latent is None and (self._age >= _BURN_IN or not inferred)
        self._at, steps = 0, self._ahead if settled else 1
        if steps != self._kept[0].shape[1] or self._age == 0:
            k, n_nodes, n, _ = self._x.shape
            self._kept = np.empty((k, steps, n_nodes, n, n)), np.empty((k, steps)), np.empty((k, steps))
        for _ in range(1 if self._latent is None else _SWEEPS_A_DRAW):
            self._advance(moving and inferred)
        self._age += steps
        if self._age % _REPAIR_EVERY == 0:
            self._refresh()
            self._kept[0][:, -1], self._kept[1][:, -1] = self._x, self._traces

    def log_likelihood(self) -> np.ndarray:
        """(K,) what :meth:`set_temperature` multiplies, up to a constant; of projected noise only the coupling."""
        if self._latent is None:
            return self._concentration.log_likelihood(self._traces)
        return self._latent.log_likelihood(self._x)

    def set_temperature(self, inverse: np.ndarray) -> None:
        """Powers (K,) of the likelihood, or for projected noise of the coupling; after it no chain goes ahead."""
        self.inverse_temperature[:], self._ahead = inverse, 1

    def _advance(self, infer: bool) -> None:
        """As many steps as are kept: chains side by side, or the nodes of one colour when chains are too few."""
        n_chains, order, incidence = len(self._x), self._order, self._problem.incidence
        if self._side_by_side:

            def some(first: int, last: int) -> None:
                own = slice(first, last)
                maps, weights = (a if len(a) == 1 else a[own] for a in self._read)
                kept = self._kept[0][own], self._kept[1][own], self._kept[2][own]
                advance(
                    self._x[own], maps, weights, incidence, self._field, self._planes, order, self._streams[own],
                    self._gains[own], self._traces[own], self._kappa[own], self.inverse_temperature[own], infer,
                    *self._normaliser, self._states[own], kept,
                )  # fmt: skip

            self.threads.parallel_for(some, n_chains)
            return
        if infer:
            self._concentration.update(self._traces, self._states, self.inverse_temperature)
        kappa = self.inverse_temperature * self._kappa

        def sweep(nodes: np.ndarray) -> None:
            for k in range(n_chains):
                maps, weights = (a[k if len(a) > 1 else 0] for a in self._read)
                plane_rotations.sweep(
                    self._x[k], maps, weights, incidence, self._field, kappa[k], self._planes, nodes, self._streams[k],
                    self._gains[k],
                )  # fmt: skip

        for nodes in np.split(order, self._colours[1:-1]):
            if len(nodes) < _LEAST_COLOUR * self.threads.size:
                sweep(nodes)
            else:  # the loop waits for all parts
                self.threads.parallel_for(lambda a, b: sweep(nodes[a:b]), len(nodes))  # noqa: B023
        self._traces += np.cumsum(self._gains, axis=1)[:, -1]  # in turn, as in advance
        for kept, now in zip(self._kept, (self._x, self._traces, self._kappa)):
            kept[:, 0] = now

    def _refresh(self) -> None:
        """Take off the rounding that maps and accumulated energies gathered."""
        self._x = langevin_kernels.reorthonormalised(self._x)
        self._traces = (self._problem.constant - euclidean_energy(self._problem, so.transpose(self._x))) / 2  # (K,)


@numba.njit(cache=True, nogil=True)
def advance(
    x: np.ndarray,
    maps: np.ndarray,
    weights: np.ndarray,
    incidence: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    field: np.ndarray,
    planes: np.ndarray,
    nodes: np.ndarray,
    streams: np.ndarray,
    gains: np.ndarray,
    traces: np.ndarray,
    kappa: np.ndarray,
    powers: np.ndarray,
    infer: bool,
    count: float,
    table: np.ndarray,
    states: np.ndarray,
    kept: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Steps of chains, of each as many as there is room in ``kept``: x (K, B, N, n, n), traces and κ (K, B) after them.

    A step draws κ, with ``infer``, then sweeps. The first arrays are what :func:`fmsync.samplers.plane_rotations.sweep`
    takes, for every chain, but ``maps`` and ``weights`` may be (1, ...) for all. ``traces``, ``kappa``, and ``powers``
    of the likelihood are (K,); ``count``, ``table`` and ``states`` are for ``concentration.draw_kappa``.
    """
    for k in range(len(x)):
        own_maps, own_weights = maps[k if len(maps) > 1 else 0], weights[k if len(weights) > 1 else 0]
        for step in range(kept[0].shape[1]):
            if infer:
                b, n = powers[k], x.shape[-1]
                kappa[k] = draw_kappa(kappa[k], b * traces[k], b * count, 0.0, n, table, states[k])
            plane_rotations.sweep(
                x[k], own_maps, own_weights, incidence, field, powers[k] * kappa[k], planes, nodes, streams[k], gains[k]
            )
            traces[k] += gains[k].sum()
            kept[0][k, step], kept[1][k, step], kept[2][k, step] = x[k], traces[k], kappa[k]
