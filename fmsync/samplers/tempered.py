"""Replica exchange: hot copies carry a chain across the valleys that separate the modes of a posterior."""

import numpy as np

from fmsync.problem import LangevinPrior, SyncProblem
from fmsync.samplers.base import concentration, sampler
from fmsync.samplers.heat_bath import HeatBath
from fmsync.samplers.hmc import HMC, MALA

_BASES = {"heat-bath": HeatBath, "hmc": HMC, "mala": MALA}
_ROUND = 50  # steps of the warm-up between two spacings of the ladder


@sampler("tempered")
class Tempered:
    r"""Parallel tempering over κ around any of the exact samplers.

    Each chain is a ladder of replicas at concentrations :math:`0 < \kappa_1 < \dots < \kappa_R = \kappa`. After every
    step of all replicas neighbours exchange places with probability
    :math:`\min\{1, \exp((\kappa_r-\kappa_s)(U_r-U_s)/2)\}`, even and odd pairs in turn, far quicker than random
    pairs. In the warm-up the ladder is spaced for equal rejection along it (Syed, Bouchard-Côté, Deligiannidis & Doucet
    2022). The coldest replica is the draw.

    Parameters
    ----------
    problem, start, rng, prior
        As :func:`fmsync.sample` passes them; every replica begins at the start of its chain.
    kappa, beta
        Concentration of the observations, κ = 2β, β = 1 by default; it cannot be inferred here.
    base
        ``"heat-bath"``, ``"hmc"`` or ``"mala"``.
    rungs
        Replicas R >= 2 of a chain. Take more when ``settings["swaps"]`` falls below 0.2.
    hottest
        Concentration of the hottest replica as a share of κ, in (0, 1); by default 1e-3, nearly uniform maps.
    energy
        ``"euclidean"``, or ``"geodesic"`` with a gradient sampler as base.

    Raises
    ------
    ValueError
        ``kappa="auto"``, unknown choices, fewer than two rungs, ``hottest`` outside (0, 1).
    """

    def __init__(
        self,
        problem: SyncProblem,
        start: np.ndarray,
        rng: np.random.Generator,
        prior: LangevinPrior | None = None,
        *,
        kappa: float | None = None,
        beta: float | None = None,
        base: str = "heat-bath",
        rungs: int = 8,
        hottest: float = 1e-3,
        energy: str = "euclidean",
    ):
        if base not in _BASES:
            raise ValueError(f"base: {', '.join(map(repr, _BASES))}, not {base!r}")
        if isinstance(rungs, bool) or int(rungs) != rungs or rungs < 2:
            raise ValueError(f"rungs: an integer >= 2, got {rungs}")
        if not 0 < hottest < 1:
            raise ValueError(f"hottest: a share of kappa in (0, 1), got {hottest}")
        self._coldest, self._rng, self._n_chains = concentration(kappa, beta), rng, len(start)
        shares = np.concatenate([[hottest], np.linspace(0, 1, int(rungs))[1:]])
        self._ladder = self._coldest * shares  # (R,), coldest last
        copies = np.repeat(start, rungs, axis=0)  # replica r of chain k is number k R + r
        self._engine = _BASES[base](problem, copies, rng, prior, kappa=self._coldest, energy=energy)
        self._rung = np.tile(np.arange(rungs), (len(start), 1))  # (K, R): the rung of each replica
        self._rejected, self._tried = np.zeros(rungs - 1), np.zeros(rungs - 1)
        self._age, self._warming, self._trips = 0, True, np.zeros(len(start), dtype=int)
        self._was_hottest = np.zeros(self._rung.shape, dtype=bool)
        self._assign()
        self.kappa = np.full(len(start), self._coldest)
        self.ceiling, self.advice = np.full(len(start), np.inf), self._engine.advice
        self._plain = {"base": base, "energy": energy}

    @property
    def settings(self) -> dict[str, object]:
        """Choices, the ladder, the share of exchanges made on the worst rung, round trips from hottest to coldest."""
        swaps = 1 - (self._rejected / np.maximum(self._tried, 1)).max()
        found = {"ladder": self._ladder.round(6).tolist(), "swaps": float(swaps), "trips": int(self._trips.sum())}
        return self._plain | found

    @property
    def state(self) -> np.ndarray:
        """(K, N, n, n) rotations of the coldest replicas."""
        return self._engine.state[self._cold()]

    def draw(self) -> np.ndarray:
        """(K, N, n, n) rotations."""
        return self.state

    def energy(self) -> np.ndarray:
        """(K,) energy of the coldest replicas."""
        return self._engine.energy()[self._cold()]

    def step(self, warming: bool) -> None:
        """One step of all replicas, then exchanges along every ladder."""
        if self._warming and not warming:
            self._warming, self._rejected, self._tried = False, 0 * self._rejected, 0 * self._tried
            self._trips[:] = 0
        self._engine.step(warming)
        self._exchange()
        self._age += 1
        if warming and self._age % _ROUND == 0:
            self._respace()
        self._assign()

    def _exchange(self) -> None:
        energy = self._engine.energy().reshape(self._rung.shape)
        chains = np.arange(self._n_chains)
        at = np.argsort(self._rung, axis=1)  # (K, R): the replica on each rung
        for r in range(self._age % 2, len(self._ladder) - 1, 2):
            lower, upper = at[:, r], at[:, r + 1]
            gain = (self._ladder[r + 1] - self._ladder[r]) / 2 * (energy[chains, upper] - energy[chains, lower])
            chance = np.exp(np.clip(gain, -700, 0))
            self._rejected[r] += (1 - chance).sum()
            self._tried[r] += len(chance)
            swapped = chains[self._rng.random(len(chance)) < chance]
            self._rung[swapped, lower[swapped]], self._rung[swapped, upper[swapped]] = r + 1, r
        arrived = self._was_hottest & (self._rung == len(self._ladder) - 1)
        self._trips += arrived.sum(axis=1)
        self._was_hottest = (self._was_hottest & ~arrived) | (self._rung == 0)

    def _respace(self) -> None:
        """Put the rungs where the rejection summed from the hottest is the same between any two."""
        rejection = np.where(self._tried > 0, self._rejected / np.maximum(self._tried, 1), 0.5)
        barrier = np.concatenate([[0], np.cumsum(np.maximum(rejection, 1e-3))])
        self._ladder = np.interp(np.linspace(0, barrier[-1], len(self._ladder)), barrier, self._ladder)
        self._rejected[:], self._tried[:] = 0, 0

    def _assign(self) -> None:
        self._engine.set_kappa(self._ladder[self._rung].ravel())

    def _cold(self) -> np.ndarray:
        n_rungs = len(self._ladder)
        return np.arange(self._n_chains) * n_rungs + np.argmax(self._rung, axis=1)
