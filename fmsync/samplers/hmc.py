"""Gradient samplers with a Metropolis test: exact for either energy, and the reference for the others."""

import numpy as np

from fmsync import checks, energy, so
from fmsync.samplers import langevin_kernels
from fmsync.samplers.base import Sampler, Target, sampler
from fmsync.samplers.concentration import Concentration
from fmsync.samplers.random_streams import generators

Evaluated = tuple[np.ndarray, np.ndarray, np.ndarray]  # energy (K,), potential (K,), gradient (K, N, n, n)

_REPAIR_EVERY = 50  # transitions between two re-orthonormalisations
_MOST_STEPS = 200  # of one trajectory
_BURN_IN = 100  # transitions of the warm-up before an unknown κ moves


@sampler("hmc")
class HMC(Sampler):
    r"""Hamiltonian Monte Carlo on :math:`SO(n)^N` with trivialised momenta.

    Momenta :math:`p_i=\mathrm{skew}(Z_i)` in the body frame have kinetic energy :math:`\tfrac12\lVert p\rVert_F^2`. A
    step is half a kick, a move :math:`C_i\leftarrow C_i\exp(\varepsilon p_i)` or :math:`C_i\,\mathrm{cay}(\varepsilon
    p_i)`, half a kick: either is reversible and keeps the volume, so that the Metropolis test makes it exact. The
    geodesic energy needs κ or β, because its normaliser is not known; its gradient jumps on the cut locus, where draws
    stay exact and fewer are accepted.

    * ``integrator``: ``"cayley"`` or ``"exp"``.
    * ``step``, ε > 0, for all chains: by default adapted for each by dual averaging in the warm-up (Hoffman & Gelman
      2014), towards 80 % acceptance.
    * ``length``, time ε L of a trajectory: by default a quarter of the mean period, from the curvature that the warm-up
      sees, :math:`E\lVert\nabla V\rVert^2 = E\operatorname{tr}\nabla^2V`, without one from the mean degree. Every
      trajectory takes 50 to 150 % of it.

    What the warm-up adapts is frozen after it: a length that followed the state would make the kernel inexact.
    """

    _target = 0.8

    @checks.checked(start="K N n n", integrator=("cayley", "exp"), step=checks.positive, length=checks.positive)
    def __init__(
        self,
        target: Target,
        start: np.ndarray,
        rng: np.random.Generator,
        *,
        integrator: str = "cayley",
        step: float | None = None,
        length: float | None = None,
    ):
        target.only("hmc", likelihood="langevin")
        if length is not None and isinstance(self, MALA):
            raise ValueError("length: 'mala' has no such option, its trajectories have one step")
        problem, self._euclidean = target.problem, target.energy == "euclidean"
        if not (self._euclidean or isinstance(target.kappa, float)):
            why = "the normaliser of the geodesic energy is not known, so that kappa cannot be inferred with it"
            raise ValueError(f"kappa: {why}; give kappa or beta, or use energy='euclidean'")
        self._problem, self._rng, self._exp = problem, rng, integrator == "exp"
        self._field = so.transpose(target.field)  # κ_i M_i, or empty
        self._concentration = Concentration(target, len(start), rng)
        self.kappa = self._concentration.value
        self.inverse_temperature = np.ones(len(start))
        self._states = generators(rng, len(start))  # for κ
        first = 0.5 / np.sqrt(self.kappa * problem.degrees.max() + problem.n) if step is None else step
        self._adapting, self._averaging = step is None, DualAveraging(np.full(len(start), first), self._target)
        self._step = self._averaging.step
        n = problem.n
        # mean curvature = mean square of one of the n(n-1)/2 coordinates of the gradient, which has n² entries
        self._length, self._squares = length, (self.kappa * problem.degrees.mean() + 1) * (n - 1) / (2 * n)  # (K,)
        self._weight = 0.0  # of what the warm-up saw
        self._c, self._age = np.ascontiguousarray(start), 0
        self._accepted, self._tried = 0.0, 0
        self._observed, self._potential, self._gradient = self.evaluate(self._c)
        self._choices: dict[str, object] = {"energy": target.energy, "integrator": integrator}

    @property
    def settings(self) -> dict[str, object]:
        """Choices, and what was adapted: mean step over the chains, steps a trajectory, acceptance since."""
        return self._choices | {
            "kappa_inferred": self._concentration.inferred,
            "step": float(self._step.mean()),
            "n_steps": self._n_steps(1.0),
            "acceptance": self._accepted / max(self._tried, 1),
        }

    @property
    def state(self) -> np.ndarray:
        return self._c

    def energy(self) -> np.ndarray:
        return self._observed

    def step(self, warmup: bool) -> None:
        """One trajectory of every chain, and a draw of κ where it is inferred."""
        if self._adapting and not warmup:
            self._step, self._adapting = self._averaging.average, False
        momentum = so.skew(self._rng.standard_normal(self._c.shape))
        count = self._n_steps(self._rng.uniform(0.5, 1.5))
        c, p, (observed, potential, gradient) = self.trajectory(self._c, momentum, self._gradient, count)
        error = potential - self._potential + ((p**2).sum((1, 2, 3)) - (momentum**2).sum((1, 2, 3))) / 2
        chance = np.exp(-np.clip(np.where(np.isfinite(error), error, np.inf), 0, 700))  # (K,)
        taken = self._rng.random(len(chance)) < chance
        wide = taken[:, None, None, None]
        self._c, self._gradient = np.where(wide, c, self._c), np.where(wide, gradient, self._gradient)
        self._observed = np.where(taken, observed, self._observed)
        self._potential = np.where(taken, potential, self._potential)
        self._age += 1
        if warmup:
            if self._adapting:
                self._step = self._averaging.update(chance)
            self._weight = 0.95 * self._weight + 1
            self._squares = self._squares + ((self._gradient**2).mean((1, 2, 3)) - self._squares) / self._weight
        else:
            self._accepted, self._tried = self._accepted + float(chance.mean()), self._tried + 1
        if self._concentration.inferred and not (warmup and self._age < _BURN_IN):
            self._concentration.update(self._traces(), self._states, self.inverse_temperature)
            self.refresh()
        if self._age % _REPAIR_EVERY == 0:
            self._c = langevin_kernels.reorthonormalised(self._c)
            self.refresh()

    def trajectory(
        self, c: np.ndarray, p: np.ndarray, gradient: np.ndarray, count: int
    ) -> tuple[np.ndarray, np.ndarray, Evaluated]:
        """End point, momenta and :meth:`evaluate` there, after ``count`` steps from rotations c with momenta p."""
        eps = self._step[:, None, None, None]
        for _ in range(count):
            p = p - eps / 2 * gradient
            c = self._move(c, eps * p)
            evaluated = self.evaluate(c)
            gradient = evaluated[2]
            p = p - eps / 2 * gradient
        return c, p, evaluated

    def evaluate(self, c: np.ndarray) -> Evaluated:
        """Energy of the observations (K,), potential (K,) with temperature and prior, its gradient (K, N, n, n)."""
        if self._euclidean:
            sums = energy.neighbour_sums_unchecked(self._problem, c)
            observed = self._problem.constant - np.einsum("kiab,kiab->k", c, sums)
            gradient = energy.gradient_unchecked(self._problem, c, sums)
        else:
            observed, gradient = energy.geodesic_energy_and_gradient_unchecked(self._problem, c)
        half = self.inverse_temperature * self.kappa / 2
        potential, gradient = half * observed, half[:, None, None, None] * gradient
        if len(self._field):
            potential = potential - np.einsum("kiab,iab->k", c, self._field)
            gradient = gradient - so.skew(so.transpose(c) @ self._field)
        return observed, potential, gradient

    def refresh(self) -> None:
        """Evaluate again where the chains are: the temperature or the rounding has changed."""
        self._observed, self._potential, self._gradient = self.evaluate(self._c)

    def log_likelihood(self) -> np.ndarray:
        """(K,) logarithm of the likelihood of maps and κ, up to a constant."""
        if self._euclidean:
            return self._concentration.log_likelihood(self._traces())
        return -self.kappa / 2 * self._observed

    def set_temperature(self, inverse: np.ndarray) -> None:
        """Raise the likelihood of each chain to a power (K,)."""
        self.inverse_temperature[:] = inverse
        self.refresh()

    def _traces(self) -> np.ndarray:
        return (self._problem.constant - self._observed) / 2

    def _move(self, c: np.ndarray, omega: np.ndarray) -> np.ndarray:
        if not self._exp:
            return c @ so.cayley_unchecked(omega)
        moved = np.array(c).reshape(-1, *c.shape[-2:])
        langevin_kernels.rotate(moved, np.ascontiguousarray(omega).reshape(moved.shape))
        return moved.reshape(c.shape)

    def _n_steps(self, fraction: float) -> int:
        n = self._problem.n
        adapted = np.pi / 2 / np.sqrt(np.maximum(self._squares * 2 * n / (n - 1), 1e-12))
        length = adapted if self._length is None else self._length
        return int(np.clip(np.ceil(fraction * np.median(length / self._step)), 1, _MOST_STEPS))


@sampler("mala")
class MALA(HMC):
    r"""Metropolis-adjusted Langevin: Hamiltonian Monte Carlo whose trajectories have one step, 57 % accepted.

    The proposal is one step of ``"rlfm"`` with :math:`h\beta^{-1} = \varepsilon^2/2`, and the test takes off its bias.
    Options are those of ``"hmc"`` but for ``length``, which is refused.
    """

    _target = 0.574

    def _n_steps(self, fraction: float) -> int:
        return 1


class DualAveraging:
    r"""Steps that make the mean acceptance of each chain meet a target (Hoffman & Gelman 2014, algorithm 5).

    ``step`` (K,) is to be used next; ``average`` (K,) is what to freeze.
    """

    def __init__(self, step: np.ndarray, target: float):
        self.step, self.average, self._target = step, step.copy(), target
        self._centre, self._error, self._count = np.log(10 * step), np.zeros_like(step), 0

    def update(self, chance: np.ndarray) -> np.ndarray:
        """Take in the acceptance probabilities (K,); the next steps (K,)."""
        self._count += 1
        m = self._count
        self._error += (self._target - chance - self._error) / (m + 10)
        log_step = self._centre - np.sqrt(m) / 0.05 * self._error
        self.step = np.exp(log_step)
        self.average = np.exp(m**-0.75 * log_step + (1 - m**-0.75) * np.log(self.average))
        return self.step
