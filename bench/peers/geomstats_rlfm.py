"""The paper's sampler as others write it: every operation on SO(n) by geomstats, the energy summed edge by edge.

Only for comparison. geomstats is imported when the sampler is made, so that nothing else waits for it.
"""

import numpy as np

from fmsync.adapters import to_geomstats
from fmsync.energy import energy
from fmsync.samplers import Sampler, Target, sampler
from fmsync.samplers.rlfm import default_step


@sampler("rlfm-geomstats")
class GeomstatsRLFM(Sampler):
    """The constrained Euclidean chain of ``"rlfm"`` with geodesic steps; a prior is refused."""

    def __init__(self, target: Target, start: np.ndarray, rng: np.random.Generator, *, step: float | None = None):
        target.only("rlfm-geomstats", likelihood="langevin", energy="euclidean")
        if target.prior is not None:
            raise ValueError("prior: 'rlfm-geomstats' takes none; use 'rlfm'")
        self._problem, self._rng, self._age = target.problem, rng, 0
        self._space, self._c = to_geomstats(start)
        self.kappa = np.full(len(start), target.fixed_kappa())
        self._beta = self.kappa[0] / 2
        self._step = default_step(self._problem, self.kappa[0]) if step is None else step
        self.advice = "shorten the step"

    @property
    def settings(self) -> dict[str, float]:
        return {"step": self._step, "beta": self._beta}

    @property
    def state(self) -> np.ndarray:
        return self._c

    def energy(self) -> np.ndarray:
        return energy(self._problem, self._c)

    def step(self, warmup: bool) -> None:
        """One step: ambient gradient, projection to the tangent space and exponential map."""
        c = self._c
        gradient = np.zeros(c.shape)
        for (i, j), observed, weight in zip(self._problem.edges, self._problem.maps, self._problem.weights):
            gradient[:, i] -= 2 * weight * c[:, j] @ observed.T
            gradient[:, j] -= 2 * weight * c[:, i] @ observed
        noise = self._rng.standard_normal(c.shape)
        push = -self._step * gradient + np.sqrt(2 * self._step / self._beta) * noise
        flat = c.reshape(-1, *c.shape[-2:])
        tangent = self._space.to_tangent(push.reshape(flat.shape), base_point=flat)
        moved = self._space.exp(tangent, base_point=flat)
        self._age += 1
        if self._age % 100 == 0:  # without it rounding grows until the exponential overflows
            moved = self._space.projection(moved)
        self._c = moved.reshape(c.shape)
