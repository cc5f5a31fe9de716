"""Replica exchange: hot copies carry a chain across the valleys that separate the modes of a posterior."""

import numpy as np

from fmsync import checks
from fmsync.samplers.base import Sampler, Target, sampler
from fmsync.samplers.heat_bath import HeatBath
from fmsync.samplers.hmc import HMC, MALA

_BASES = {"heat-bath": HeatBath, "hmc": HMC, "mala": MALA}
_SPACE_EVERY = 50  # steps of the warm-up between two spacings of the ladder


@sampler("tempered")
class Tempered(Sampler):
    r"""Parallel tempering around any of the exact samplers, for every likelihood, with κ or σ² inferred or given.

    Each chain is a ladder of replicas at inverse temperatures :math:`0 < b_1 < \dots < b_R = 1`, the powers to which
    the likelihood L of each is raised. After every step of all replicas neighbours exchange places with probability
    :math:`\min\{1, (L_s/L_r)^{b_r-b_s}\}`, even and odd pairs in turn. In the warm-up the ladder is spaced for equal
    rejection along it (Syed, Bouchard-Côté, Deligiannidis & Doucet 2022). The coldest replica is the draw. Under
    projected noise L is the coupling of maps and observations alone, which keeps the polar factors proper.

    The ``base`` is ``"heat-bath"``, ``"hmc"`` or ``"mala"``. Take more replicas R, ``n_temperatures`` >= 2, when
    ``settings["swap_acceptance"]`` falls below 0.2. ``hottest``, in (0, 1), is the inverse temperature of the hottest.
    """

    @checks.checked(start="K N n n", base=tuple(_BASES), n_temperatures=">= 2", hottest=checks.probability)
    def __init__(
        self,
        target: Target,
        start: np.ndarray,
        rng: np.random.Generator,
        *,
        base: str = "heat-bath",
        n_temperatures: int = 8,
        hottest: float = 1e-3,
    ):
        self._rng, self._n_chains = rng, len(start)
        self._ladder = np.linspace(0, 1, n_temperatures)  # (R,) inverse temperatures, coldest last
        self._ladder[0] = hottest
        copies = np.repeat(start, n_temperatures, axis=0)  # replica r of chain k is number k R + r
        self._replicas = _BASES[base](target, copies, rng)
        self._place = np.tile(np.arange(n_temperatures), (len(start), 1))  # (K, R): of each replica on the ladder
        self._rejected, self._tried = np.zeros(n_temperatures - 1), np.zeros(n_temperatures - 1)
        self._age, self._in_warmup, self._round_trips = 0, True, np.zeros(len(start), dtype=int)
        self._was_hottest = np.zeros(self._place.shape, dtype=bool)
        self._replicas.set_temperature(self._ladder[self._place].ravel())
        self._choices: dict[str, object] = {"base": base, "energy": target.energy, "likelihood": target.likelihood}

    @property
    def settings(self) -> dict[str, object]:
        """Choices, the ladder, the least swap acceptance along it, and round trips from hottest to coldest."""
        acceptance = 1 - (self._rejected / np.maximum(self._tried, 1)).max()
        return self._choices | {
            "kappa_inferred": self._replicas.settings["kappa_inferred"],
            "ladder": self._ladder.round(6).tolist(),
            "swap_acceptance": float(acceptance),
            "round_trips": int(self._round_trips.sum()),
        }

    @property
    def kappa(self) -> np.ndarray:  # type: ignore[override]
        return self._replicas.kappa[self._cold()]

    @property
    def edge_weights(self) -> np.ndarray | None:  # type: ignore[override]
        weights = self._replicas.edge_weights
        return None if weights is None else weights[self._cold()]

    @property
    def kappas(self) -> np.ndarray | None:  # type: ignore[override]
        kappas = self._replicas.kappas
        return None if kappas is None else kappas[self._cold()]

    @property
    def state(self) -> np.ndarray:
        return self._replicas.state[self._cold()]

    def energy(self) -> np.ndarray:
        return self._replicas.energy()[self._cold()]

    def step(self, warmup: bool) -> None:
        """One step of all replicas, then swaps along every ladder."""
        if self._in_warmup and not warmup:
            self._in_warmup, self._rejected, self._tried = False, 0 * self._rejected, 0 * self._tried
            self._round_trips[:] = 0
        self._replicas.step(warmup)
        self._swap()
        self._age += 1
        if warmup and self._age % _SPACE_EVERY == 0:
            self._respace()
        self._replicas.set_temperature(self._ladder[self._place].ravel())

    def _swap(self) -> None:
        likelihood = self._replicas.log_likelihood().reshape(self._place.shape)
        chains = np.arange(self._n_chains)
        at = np.argsort(self._place, axis=1)  # (K, R): the replica on each place
        for r in range(self._age % 2, len(self._ladder) - 1, 2):
            lower, upper = at[:, r], at[:, r + 1]
            gain = (self._ladder[r + 1] - self._ladder[r]) * (likelihood[chains, lower] - likelihood[chains, upper])
            chance = np.exp(np.clip(gain, -700, 0))
            self._rejected[r] += (1 - chance).sum()
            self._tried[r] += len(chance)
            swapped = chains[self._rng.random(len(chance)) < chance]
            self._place[swapped, lower[swapped]], self._place[swapped, upper[swapped]] = r + 1, r
        arrived = self._was_hottest & (self._place == len(self._ladder) - 1)
        self._round_trips += arrived.sum(axis=1)
        self._was_hottest = (self._was_hottest & ~arrived) | (self._place == 0)

    def _respace(self) -> None:
        """Put the temperatures where the rejection summed from the hottest is the same between any two."""
        rejection = np.where(self._tried > 0, self._rejected / np.maximum(self._tried, 1), 0.5)
        barrier = np.concatenate([[0], np.cumsum(np.maximum(rejection, 1e-3))])
        self._ladder = np.interp(np.linspace(0, barrier[-1], len(self._ladder)), barrier, self._ladder)
        self._rejected[:], self._tried[:] = 0, 0

    def _cold(self) -> np.ndarray:
        n_places = len(self._ladder)
        return np.arange(self._n_chains) * n_places + np.argmax(self._place, axis=1)
