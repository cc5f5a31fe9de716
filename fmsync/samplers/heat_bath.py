"""The heat bath: exact Gibbs sweeps over planes of every map, without a step size, without rejections."""

from collections.abc import Callable

import numpy as np

from fmsync import so
from fmsync.energy import energy as euclidean_energy
from fmsync.problem import LangevinPrior, SyncProblem, check_rotations
from fmsync.samplers import langevin_kernels, plane_rotations
from fmsync.samplers.base import sampler
from fmsync.samplers.noise_level import Concentration, check_identified
from fmsync.samplers.polar_factor import Stretches
from fmsync.samplers.random_streams import generators
from fmsync.samplers.thread_pool import Crew

_POLISH_EVERY = 200  # sweeps between two repairs of orthogonality and of the running energy
# Below these a thread costs more to wake than it saves: N n² (n + 30) of all chains; of a colour, its nodes a thread.
_WORTH_SHARING, _LEAST_COLOUR = 3e5, 4
_SETTLE = 100  # sweeps of the warm-up before an unknown noise level moves: chains from random maps must order first


@sampler("heat-bath")
class HeatBath:
    r"""Givens–von Mises heat bath with over-relaxation for the Euclidean energy: exact and without tuning.

    Given the rest, map i has density :math:`\propto\exp(\kappa\operatorname{tr}(S_i^\top C_i))`, and the angle by which
    two of its columns are rotated is von Mises. A sweep visits every pair of columns of every map: once to reflect the
    angle about the mode (over-relaxation, which moves far at the same density) and once to draw it.

    On several cores chains run side by side, or, when they are fewer than the cores, nodes of one graph colour. Draws
    do not depend on the number of threads, which is that of numba (``NUMBA_NUM_THREADS``).

    Parameters
    ----------
    problem, start, rng, prior
        As :func:`fmsync.sample` passes them; ``start`` (K, N, n, n).
    likelihood
        ``"langevin"``: :math:`p(C_{ij})\propto\exp(\kappa\operatorname{tr}(C_{ij}^\top C_i^\top C_j))`; weights are
        multiplicities. ``"projected-gaussian"``: :math:`C_{ij}=\mathrm{proj}_{SO(n)}(C_i^\top C_j+\sigma G)`, the
        paper's noise, exact by putting back the stretches that the projection took away; σ² is inferred with
        :math:`\log\sigma^2` uniform on [log 1e-5, log 10].
    kappa, beta
        Concentration of the Langevin likelihood, κ = 2β; ``kappa="auto"``, the default, infers it under a uniform prior
        on [0, 1e5].
    over_relaxations
        Reflections before each draw, >= 0.
    energy
        ``"euclidean"`` is the only one; any other raises a ValueError that says which samplers can.

    Raises
    ------
    ValueError
        A level that is not positive, both given, one given to the projected Gaussian likelihood, or one to be inferred
        from a forest without repeated edges; unknown choices.
    """

    def __init__(
        self,
        problem: SyncProblem,
        start: np.ndarray,
        rng: np.random.Generator,
        prior: LangevinPrior | None = None,
        *,
        likelihood: str = "langevin",
        kappa: float | str | None = None,
        beta: float | None = None,
        over_relaxations: int = 1,
        energy: str = "euclidean",
    ):
        if energy != "euclidean":
            raise ValueError("energy: 'heat-bath' needs the Euclidean energy; 'hmc', 'mala' and 'rlfm' take either")
        if likelihood not in ("langevin", "projected-gaussian"):
            raise ValueError(f"likelihood: 'langevin' or 'projected-gaussian', not {likelihood!r}")
        if isinstance(over_relaxations, bool) or int(over_relaxations) != over_relaxations or over_relaxations < 0:
            raise ValueError(f"over_relaxations: an integer >= 0, got {over_relaxations}")
        self._problem, self._over, self._age = problem, int(over_relaxations), 0
        streams = generators(rng, len(start), problem.n_nodes + 1)  # of the chain, then of its nodes
        self._states, self._streams = np.ascontiguousarray(streams[:, 0]), np.ascontiguousarray(streams[:, 1:])
        self._x = np.ascontiguousarray(so.transpose(start))  # (K, N, n, n), transposed maps
        self._field = prior_field(problem, prior)
        self._stretches = None
        start_of, edge, self._other, forward = problem.incidence
        self._start_of, self._planes, self.crew = start_of, plane_rotations.rounds(problem.n), Crew()
        self._order, self._colours = plane_rotations.colours(start_of, self._other)
        self._gains = np.empty(start.shape[:2])
        self._heavy = self._gains.size * problem.n**2 * (problem.n + 30) > _WORTH_SHARING
        if likelihood == "langevin":
            self._level = Concentration(problem, prior, kappa, beta, len(start), rng)
            self.kappa = self._level.value
            blocks = np.empty(2 * problem.n_edges * problem.n**2)
            plane_rotations.node_blocks(problem.maps, problem.weights, start_of, edge, forward, blocks)
            self._blocks = blocks[None]  # every chain reads the same
        else:
            if kappa is not None or beta is not None:
                raise ValueError("kappa, beta: likelihood='projected-gaussian' infers sigma2; leave them out")
            if (problem.weights != 1).any():
                raise ValueError("weights: likelihood='projected-gaussian' needs weights 1; repeat an edge instead")
            check_identified(problem, prior, "sigma2")
            check_rotations(problem.maps, "maps (node = edge)")
            self._stretches = Stretches(problem, len(start), rng)
            self.kappa = 1 / self._stretches.sigma2
            self._blocks = self._stretches.blocks
        self._refresh()
        self.ceiling = np.full(len(start), np.inf)
        self.advice = "the state is not finite"
        self.settings = {"likelihood": likelihood, "over_relaxations": self._over, "level_inferred": self._inferred}

    @property
    def _inferred(self) -> bool:
        return self._stretches is not None or self._level.inferred

    @property
    def state(self) -> np.ndarray:
        """(K, N, n, n) rotations."""
        return so.transpose(self._x)

    def draw(self) -> np.ndarray:
        """(K, N, n, n) rotations."""
        return self.state

    def energy(self) -> np.ndarray:
        """(K,) Euclidean energy of the observations, without the prior."""
        if self._stretches is not None:
            return euclidean_energy(self._problem, self.state)
        return self._problem.constant - 2 * self._traces

    def step(self, warming: bool) -> None:
        """One sweep of every chain, after a draw of what is unknown beside the maps."""
        moving = not (warming and self._age < _SETTLE)
        if self._stretches is not None:
            self._stretches.step(self._x, self._states, moving, self._share)
            self.kappa = 1 / self._stretches.sigma2
        elif self._level.inferred and moving:
            self._level.update(self._traces, self._states)
        self._sweep()
        self._traces += self._gains.sum(axis=1)
        self._age += 1
        if self._age % _POLISH_EVERY == 0:
            self._refresh()

    def set_kappa(self, kappa: np.ndarray) -> None:
        """Other concentrations (K,), when they are not inferred."""
        self.kappa[:] = kappa

    def _sweep(self) -> None:
        """Every node of every chain: chains side by side, or the nodes of one colour when chains are too few."""
        n_chains, order = len(self._x), self._order

        def sweep(chains: slice, nodes: np.ndarray) -> None:
            blocks = self._blocks if len(self._blocks) == 1 else self._blocks[chains]
            plane_rotations.sweep_chains(
                self._x[chains], blocks, self._start_of, self._other, self._field, self.kappa[chains], self._over,
                self._planes, nodes, self._streams[chains], self._gains[chains],
            )  # fmt: skip

        if n_chains >= self.crew.size or not self._heavy:
            self._share(lambda first, last: sweep(slice(first, last), order), n_chains)
            return
        for first, last in zip(self._colours, self._colours[1:]):
            nodes = order[first:last]
            if len(nodes) < _LEAST_COLOUR * self.crew.size:
                sweep(slice(None), nodes)
            else:

                def some(a: int, b: int, nodes: np.ndarray = nodes) -> None:
                    sweep(slice(None), nodes[a:b])

                self.crew.share(some, len(nodes))

    def _share(self, work: Callable[[int, int], None], count: int) -> None:
        if self._heavy:
            self.crew.share(work, count)
        else:
            work(0, count)

    def _refresh(self) -> None:
        """Take off the rounding that maps and running energies gathered."""
        self._x = langevin_kernels.polish(self._x)
        self._traces = (self._problem.constant - euclidean_energy(self._problem, self.state)) / 2  # (K,)


def prior_field(problem: SyncProblem, prior: LangevinPrior | None) -> np.ndarray:
    r"""(N, n, n) transposed linear terms :math:`\kappa_i M_i^\top` of the prior; (0, n, n) without one."""
    if prior is None:
        return np.empty((0, problem.n, problem.n))
    expected = (problem.n_nodes, problem.n, problem.n)
    if prior.mean.shape != expected:
        raise ValueError(f"prior.mean: expected {expected} for this problem, got {prior.mean.shape}")
    return np.ascontiguousarray(prior.kappa[:, None, None] * so.transpose(prior.mean))
