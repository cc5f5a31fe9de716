"""The heat bath: exact Gibbs sweeps over planes of every map, without a step size, without rejections."""

from collections.abc import Callable

import numpy as np

from fmsync import checks, so
from fmsync.energy import energy_unchecked as euclidean_energy
from fmsync.samplers import langevin_kernels, plane_rotations
from fmsync.samplers.base import Sampler, Target, sampler
from fmsync.samplers.concentration import Concentration, EdgeConcentrations, FrequencyConcentrations
from fmsync.samplers.inliers import Inliers
from fmsync.samplers.polar_factor import PolarFactors
from fmsync.samplers.random_streams import generators
from fmsync.samplers.thread_pool import ThreadPool

_REPAIR_EVERY = 200  # sweeps between two re-orthonormalisations, which also renew the accumulated energy
# Below these a thread costs more to wake than it saves: N n² (n + 30) of all chains; of a colour, its nodes a thread.
_WORTH_THREADS, _LEAST_COLOUR = 3e5, 4
_BURN_IN = 100  # sweeps of the warm-up before an unknown κ or σ² moves: chains from random maps must order first

_Latent = PolarFactors | Inliers | EdgeConcentrations
_LATENT: dict[str, Callable[..., _Latent]] = {
    "projected-gaussian": PolarFactors, "mixture": Inliers, "by-edge": EdgeConcentrations,
    "by-frequency": FrequencyConcentrations,
}  # fmt: skip


@sampler("heat-bath")
class HeatBath(Sampler):
    r"""Givens–von Mises heat bath with over-relaxation for the Euclidean energy: exact and without tuning.

    Given the rest, map i has density :math:`\propto\exp(\kappa\operatorname{tr}(S_i^\top C_i))`, and the angle by which
    two of its columns are rotated is von Mises. A sweep visits every pair of columns of every map: once to reflect the
    angle about the mode (over-relaxation, which moves far at the same density) and once to draw it.

    On several cores chains run side by side, or, when they are fewer than the cores, nodes of one graph colour. Draws
    do not depend on the number of threads, which is that of numba (``NUMBA_NUM_THREADS``). ``over_relaxations`` >= 0
    are the reflections before each draw.
    """

    @checks.checked(start="K N n n", over_relaxations=">= 0")
    def __init__(self, target: Target, start: np.ndarray, rng: np.random.Generator, *, over_relaxations: int = 1):
        target.only("heat-bath", energy="euclidean")
        problem = target.problem
        self._problem, self._over, self._age = problem, over_relaxations, 0
        streams = generators(rng, len(start), problem.n_nodes + 1)  # of the chain, then of its nodes
        self._states, self._streams = np.ascontiguousarray(streams[:, 0]), np.ascontiguousarray(streams[:, 1:])
        self._x = np.ascontiguousarray(so.transpose(start))  # (K, N, n, n), transposed maps
        self._field, self._likelihood = target.field, target.likelihood
        self._start_of, _, self._other, _ = problem.incidence
        self._planes = plane_rotations.rounds(problem.n)
        self._order, self._colours = plane_rotations.colours(self._start_of, self._other)
        self._gains = np.empty(start.shape[:2])
        self.threads = ThreadPool(alone=self._gains.size * problem.n**2 * (problem.n + 30) <= _WORTH_THREADS)
        self.inverse_temperature = np.ones(len(start))
        self._latent: _Latent | None = None
        if target.likelihood == "langevin":
            self._concentration = Concentration(target, len(start), rng)
            self.kappa = self._concentration.value
            blocks = np.empty(2 * problem.n_edges * problem.n**2)
            plane_rotations.node_blocks(problem.maps, problem.weights, problem.incidence, blocks)
            self._blocks = blocks[None]  # every chain reads the same
        else:
            self._latent = latent = _LATENT[target.likelihood](target, len(start), rng)
            self.kappa, self._blocks = latent.kappa, latent.blocks
        self._refresh()

    @property
    def settings(self) -> dict[str, object]:
        inferred = (self._latent or self._concentration).inferred
        return {"likelihood": self._likelihood, "over_relaxations": self._over, "kappa_inferred": inferred}

    @property
    def state(self) -> np.ndarray:
        return so.transpose(self._x)

    @property
    def edge_weights(self) -> np.ndarray | None:  # type: ignore[override]
        return self._latent.probabilities(self._x) if isinstance(self._latent, Inliers) else None

    @property
    def kappas(self) -> np.ndarray | None:  # type: ignore[override]
        return self._latent.kappas if isinstance(self._latent, EdgeConcentrations) else None

    def energy(self) -> np.ndarray:
        if self._latent is not None:
            return euclidean_energy(self._problem, self.state)
        return self._problem.constant - 2 * self._traces

    def step(self, warmup: bool) -> None:
        """One sweep of every chain, after a draw of what is unknown beside the maps."""
        moving = not (warmup and self._age < _BURN_IN)
        if self._latent is not None:
            self._latent.step(self._x, self._states, moving, self.threads.parallel_for, self.inverse_temperature)
            self.kappa = self._latent.kappa
        elif self._concentration.inferred and moving:
            self._concentration.update(self._traces, self._states, self.inverse_temperature)
        self._sweep()
        self._traces += self._gains.sum(axis=1)
        self._age += 1
        if self._age % _REPAIR_EVERY == 0:
            self._refresh()

    def log_likelihood(self) -> np.ndarray:
        """(K,) what :meth:`set_temperature` multiplies, up to a constant; of projected noise only the coupling."""
        if self._latent is None:
            return self._concentration.log_likelihood(self._traces)
        return self._latent.log_likelihood(self._x)

    def set_temperature(self, inverse: np.ndarray) -> None:
        """Powers (K,) of the likelihood, or for projected noise of the coupling."""
        self.inverse_temperature[:] = inverse

    def _sweep(self) -> None:
        """Every node of every chain: chains side by side, or the nodes of one colour when chains are too few."""
        n_chains, order = len(self._x), self._order
        kappa = self.inverse_temperature * self.kappa

        def sweep(chains: slice, nodes: np.ndarray) -> None:
            blocks = self._blocks if len(self._blocks) == 1 else self._blocks[chains]
            plane_rotations.sweep(
                self._x[chains], blocks, self._start_of, self._other, self._field, kappa[chains], self._over,
                self._planes, nodes, self._streams[chains], self._gains[chains],
            )  # fmt: skip

        if n_chains >= self.threads.size:
            self.threads.parallel_for(lambda first, last: sweep(slice(first, last), order), n_chains)
            return
        for nodes in np.split(order, self._colours[1:-1]):
            if len(nodes) < _LEAST_COLOUR * self.threads.size:
                sweep(slice(None), nodes)
            else:  # the loop waits for all parts
                self.threads.parallel_for(lambda a, b: sweep(slice(None), nodes[a:b]), len(nodes))  # noqa: B023

    def _refresh(self) -> None:
        """Take off the rounding that maps and accumulated energies gathered."""
        self._x = langevin_kernels.reorthonormalised(self._x)
        self._traces = (self._problem.constant - euclidean_energy(self._problem, self.state)) / 2  # (K,)
