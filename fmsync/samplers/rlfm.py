r"""The paper's sampler: Riemannian Langevin dynamics without a Metropolis test."""

import numpy as np

from fmsync import checks, energy, so
from fmsync.problem import SyncProblem, anchored
from fmsync.problem import fix_gauge_unchecked as fix_gauge
from fmsync.samplers import langevin_kernels
from fmsync.samplers.base import Sampler, Target, sampler

_REPAIR_EVERY = 100  # steps between two re-orthonormalisations


@sampler("rlfm")
class RLFM(Sampler):
    r"""Riemannian Langevin functional map sampler: unadjusted, so its distribution is off by O(h).

    .. math::
        V_i &= \Pi_{C_i}\bigl(-h\,\nabla_i U + \sqrt{2h/\beta}\,Z_i\bigr),

        C_i &\leftarrow R_{C_i}(V_i)

    with standard normal Z_i, for the density :math:`\exp(-\beta U)` with respect to Haar measure. The paper prints the
    drift with a plus sign; that chain climbs U and samples :math:`\exp(+\beta U)`.

    * ``retraction``, R: ``"exp"``, along geodesics, or ``"qf"``, the Q factor of C + V.
    * ``constrained`` False: arbitrary matrices with the energy :math:`\sum w\lVert C_i C_{ij}-C_j\rVert_F^2`, MC (1) of
      the paper, in the gauge C_1 = I (or that of the prior), without which its mean is 0. Draws are projected one by
      one.
    * ``step``, h > 0: by default :math:`h/\beta = 1/(10\,(\kappa\deg_{\max} + n))`, a small part of the time in which
      the stiffest direction relaxes; the noise then turns no plane by more than about half a radian.
    * ``drift``: ``"descent"``, or ``"printed"`` for the sign that the paper prints.
    """

    @checks.checked(start="K N n n", retraction=("exp", "qf"), step=checks.positive, drift=("descent", "printed"))
    def __init__(
        self,
        target: Target,
        start: np.ndarray,
        rng: np.random.Generator,
        *,
        retraction: str = "exp",
        constrained: bool = True,
        step: float | None = None,
        drift: str = "descent",
    ):
        target.only("rlfm", likelihood="langevin")
        problem, kappa = target.problem, target.fixed_kappa()
        self._euclidean, self._exp, self._constrained = target.energy == "euclidean", retraction == "exp", constrained
        if not constrained:
            checks.unused("with constrained=False", retraction=(retraction, "exp"))
        if not (self._euclidean or constrained):
            raise ValueError("energy: the geodesic distance needs rotations; set constrained=True")
        self._n_kept = problem.n_nodes
        self._held: int | None = None
        if target.prior is not None:  # one more node, the last, that is held at I
            anchor = np.broadcast_to(np.eye(problem.n), (len(start), 1, problem.n, problem.n))
            problem, start = anchored(problem, target.prior, kappa), np.concatenate([start, anchor], axis=1)
            self._held = self._n_kept
        elif not constrained:
            start, self._held = fix_gauge(start), 0
            start[:, 0] = np.eye(problem.n)  # without the rounding
        self._problem, self._rng, self._age = problem, rng, 0
        self._c = np.ascontiguousarray(start)  # (K, N or N + 1, n, n)
        self._known: tuple[np.ndarray, np.ndarray] | None = None  # what _evaluated finds for the present state
        self._climbs, self._beta = drift == "printed", kappa / 2
        default = default_step(problem, kappa)
        self._h = default if step is None else step
        self._drift, self._noise = -self._h if self._climbs else self._h, np.sqrt(2 * self._h / self._beta)
        if not constrained:
            self._gram = energy.gram_blocks(problem)
        self.kappa = np.full(len(self._c), kappa)
        self.ceiling = self._ceiling()
        self.advice = f"the step h = {self._h:.3g} is too long, try step={min(default, self._h / 4):.2g}"
        self._choices = {"energy": target.energy, "retraction": retraction, "drift": drift}

    @property
    def settings(self) -> dict[str, object]:
        return self._choices | {"constrained": self._constrained, "step": float(self._h), "beta": self._beta}

    @property
    def state(self) -> np.ndarray:
        return self._c[:, : self._n_kept]

    def draw(self) -> np.ndarray:
        return self.state if self._constrained else so.project_unchecked(self.state)

    def energy(self) -> np.ndarray:
        return self._evaluated()[0]

    def step(self, warmup: bool) -> None:
        fixed = None if self._held is None else self._c[:, self._held].copy()
        pull = self._evaluated()[1]
        if self._constrained:
            n = self._c.shape[-1]
            flat = self._c.reshape(-1, n, n)  # a view: the state is C-contiguous
            noise = self._rng.standard_normal((len(flat), n * (n - 1) // 2))
            sums, drift = (pull.reshape(flat.shape), self._drift) if self._euclidean else (flat, 0.0)
            omega = langevin_kernels.langevin_tangents(flat, sums, noise, drift, self._noise)  # of V = C Ω
            if not self._euclidean:
                omega -= self._drift * pull.reshape(flat.shape)
            if self._exp:
                langevin_kernels.rotate(flat, omega)
            else:
                self._c = so.qf_unchecked(flat + flat @ omega).reshape(self._c.shape)
        else:
            noise = self._rng.standard_normal(self._c.shape)
            self._c = self._c - self._drift * pull + self._noise * noise
        if fixed is not None:
            self._c[:, self._held] = fixed
        self._known = None
        self._age += 1
        if self._constrained and self._age % _REPAIR_EVERY == 0:
            self._c = langevin_kernels.reorthonormalised(self._c)

    def _evaluated(self) -> tuple[np.ndarray, np.ndarray]:
        """Energies (K,) of the present state and its gradient, of constrained Euclidean ones the neighbour sums."""
        if self._known is None:
            problem, c = self._problem, self._c
            if not self._euclidean:
                self._known = energy.geodesic_energy_and_gradient_unchecked(problem, c)
            else:
                sums = energy.neighbour_sums_unchecked(problem, c)
                if self._constrained:
                    self._known = problem.constant - np.einsum("kiab,kiab->k", c, sums), sums
                else:
                    gradient = 2 * (c @ self._gram - sums)
                    self._known = np.einsum("kiab,kiab->k", c, gradient) / 2, gradient
        return self._known

    def _ceiling(self) -> np.ndarray:
        r"""(K,) energies that no sound chain reaches.

        Every posterior lies below the mean m of U under Haar, by β s² to first order with s its standard deviation. A
        chain whose start lay far below must not come back to m; the others must not be ten s above it.
        """
        if self._climbs:
            return np.full(len(self._c), np.finfo(float).max)
        problem, energy = self._problem, self.energy()
        weights, maps, n = problem.weights, problem.maps, problem.n
        if not self._constrained:
            free = self._c[0].size - n * n
            return np.full(len(energy), 100.0 * (problem.constant + free / (2 * self._beta)))
        if self._euclidean:  # under Haar E tr(M^T C) = 0 and E tr(M^T C)^2 = ||M||^2 / n
            mean = problem.constant
            deviation = 2 * np.sqrt(weights**2 @ (maps**2).sum((1, 2)) / n)
        else:
            squared = so.dist_unchecked(np.eye(n), so.random_uniform(n, 200, self._rng.spawn(1)[0])) ** 2
            mean, deviation = squared.mean() * weights.sum(), squared.std() * np.sqrt((weights**2).sum())
        gap = np.minimum(mean - energy, self._beta * deviation**2)  # where a sound chain stays below the mean
        return np.where(0.9 * gap > 6 * deviation, mean - 0.1 * gap, mean + 10 * deviation)


def default_step(problem: SyncProblem, kappa: float) -> float:
    r"""The default h: :math:`h/\beta = 1/(10\,(\kappa\,\deg_{\max} + n))`, β = κ/2."""
    return 0.05 * kappa / (kappa * problem.degrees.max() + problem.n)
