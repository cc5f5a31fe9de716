r"""The paper's sampler: Riemannian Langevin dynamics without a Metropolis test."""

import numpy as np

from fmsync import so
from fmsync.energy import geodesic_energy, geodesic_gradient, neighbour_sums, unconstrained_energy
from fmsync.problem import LangevinPrior, SyncProblem, check_rotations, fix_gauge
from fmsync.samplers import langevin_kernels
from fmsync.samplers.base import concentration, sampler, with_anchor

_POLISH_EVERY = 100  # steps between two repairs of orthogonality


@sampler("rlfm")
class RLFM:
    r"""Riemannian Langevin functional map sampler: unadjusted, so its distribution is off by O(h).

    .. math::
        V_i &= \Pi_{C_i}\bigl(-h\,\nabla_i U + \sqrt{2h/\beta}\,Z_i\bigr),

        C_i &\leftarrow R_{C_i}(V_i)

    with standard normal Z_i, for the density :math:`\exp(-\beta U)` with respect to Haar measure. The paper prints the
    drift with a plus sign; that chain climbs U and samples :math:`\exp(+\beta U)`.

    Parameters
    ----------
    problem
        What was observed.
    start
        (K, N, n, n) rotations.
    rng
        Generator of all chains.
    prior
        As for :func:`fmsync.sample`.
    energy
        ``"euclidean"`` :math:`\sum w\lVert C_i^\top C_j-C_{ij}\rVert_F^2` or ``"geodesic"``
        :math:`\sum w\lVert\log(C_{ij}^\top C_i^\top C_j)\rVert_F^2`.
    retraction
        R: ``"exp"``, along geodesics, or ``"qf"``, the Q factor of C + V.
    constrained
        False: arbitrary matrices with the energy :math:`\sum w\lVert C_i C_{ij}-C_j\rVert_F^2`, MC (1) of the paper, in
        the gauge C_1 = I (or that of the prior); without a gauge its mean is 0. Draws are projected one by one.
    step
        h > 0. By default :math:`h/\beta = 1/(10\,(\kappa\deg_{\max} + n))`, a small part of the time in which the
        stiffest direction relaxes; the noise then turns no plane by more than about half a radian.
    kappa, beta
        Temperature, one of the two: κ = 2β for either energy. β = 1 by default, as in the paper, whatever the noise.
    drift
        ``"descent"``, or ``"printed"`` for the sign that the paper prints.

    Raises
    ------
    ValueError
        A step, κ or β that is not positive, κ and β both given, an unknown choice, observations off the group with the
        geodesic energy, a geodesic energy in an unconstrained chain.
    """

    def __init__(
        self,
        problem: SyncProblem,
        start: np.ndarray,
        rng: np.random.Generator,
        prior: LangevinPrior | None = None,
        *,
        energy: str = "euclidean",
        retraction: str = "exp",
        constrained: bool = True,
        step: float | None = None,
        kappa: float | None = None,
        beta: float | None = None,
        drift: str = "descent",
    ):
        _one_of("energy", energy, ("euclidean", "geodesic"))
        _one_of("retraction", retraction, ("exp", "qf"))
        _one_of("drift", drift, ("descent", "printed"))
        concentrated = concentration(kappa, beta)
        if energy == "geodesic":
            if not constrained:
                raise ValueError("energy: the geodesic distance needs rotations; set constrained=True")
            check_rotations(problem.maps, "maps (node = edge)")
        if step is not None and not (np.isfinite(step) and step > 0):
            raise ValueError(f"step: must be finite and > 0, got {step}; leave it out for the default")
        self._n_kept = problem.n_nodes
        self._held: int | None = None
        if prior is not None:
            problem, start = with_anchor(problem, start, prior, concentrated)
            self._held = self._n_kept
        elif not constrained:
            start, self._held = fix_gauge(start), 0
            start[:, 0] = np.eye(problem.n)  # without the rounding
        self._problem, self._rng, self._age = problem, rng, 0
        self._c = np.ascontiguousarray(start)  # (K, N or N + 1, n, n)
        self._sums: np.ndarray | None = None  # neighbour sums of the present state, if known
        self._euclidean, self._exp, self._constrained = energy == "euclidean", retraction == "exp", constrained
        self._climbs = drift == "printed"
        self._beta = concentrated / 2
        default = default_step(problem, concentrated)
        self._h = default if step is None else float(step)
        self._drift, self._spread = -self._h if self._climbs else self._h, np.sqrt(2 * self._h / self._beta)
        if not constrained:
            self._gram = _gram(problem)
        self.kappa = np.full(len(self._c), concentrated)
        self.ceiling = self._ceiling()
        self.advice = f"the step h = {self._h:.3g} is too long, try step={min(default, self._h / 4):.2g}"
        self.settings = {
            "energy": energy,
            "retraction": retraction,
            "constrained": bool(constrained),
            "step": float(self._h),
            "beta": self._beta,
            "drift": drift,
        }

    @property
    def state(self) -> np.ndarray:
        """(K, N, n, n); rotations unless the chain is unconstrained."""
        return self._c[:, : self._n_kept]

    def draw(self) -> np.ndarray:
        """(K, N, n, n) rotations: the state, projected where the chain is unconstrained."""
        return self.state if self._constrained else so.project(self.state)

    def energy(self) -> np.ndarray:
        """(K,) potential U of the state, with the prior's part."""
        if not self._constrained:
            return unconstrained_energy(self._problem, self._c)
        if not self._euclidean:
            return geodesic_energy(self._problem, self._c)
        return self._problem.constant - np.einsum("kiab,kiab->k", self._c, self._neighbour_sums())

    def step(self, warming: bool) -> None:
        """Advance all chains by one step; nothing is adapted."""
        fixed = None if self._held is None else self._c[:, self._held].copy()
        if self._constrained:
            self._retract(self._tangents())
        else:
            gradient = 2 * (self._c @ self._gram - self._neighbour_sums())
            noise = self._rng.standard_normal(self._c.shape)
            self._c = self._c - self._drift * gradient + self._spread * noise
        if fixed is not None:
            self._c[:, self._held] = fixed
        self._sums = None
        self._age += 1
        if self._constrained and self._age % _POLISH_EVERY == 0:
            self._c = langevin_kernels.polish(self._c)

    def _tangents(self) -> np.ndarray:
        """Body-frame Ω (K N, n, n) of V = C Ω."""
        n = self._c.shape[-1]
        flat = self._c.reshape(-1, n, n)
        noise = self._rng.standard_normal((len(flat), n * (n - 1) // 2))
        drift, spread = np.full(len(flat), self._drift), np.full(len(flat), self._spread)
        if self._euclidean:
            sums = self._neighbour_sums().reshape(flat.shape)
            return langevin_kernels.langevin_tangents(flat, sums, noise, drift, spread)
        omega = langevin_kernels.langevin_tangents(flat, flat, noise, np.zeros(len(flat)), spread)
        omega -= self._drift * geodesic_gradient(self._problem, self._c).reshape(flat.shape)
        return omega

    def _retract(self, omega: np.ndarray) -> None:
        flat = self._c.reshape(omega.shape)  # a view: the state is C-contiguous
        if self._exp:
            langevin_kernels.rotate(flat, omega)
        else:
            self._c = so.qf(flat + flat @ omega).reshape(self._c.shape)

    def _neighbour_sums(self) -> np.ndarray:
        if self._sums is None:
            self._sums = neighbour_sums(self._problem, self._c)
        return self._sums

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
            squared = so.dist(np.eye(n), so.random_uniform(n, 200, self._rng.spawn(1)[0])) ** 2
            mean, deviation = squared.mean() * weights.sum(), squared.std() * np.sqrt((weights**2).sum())
        gap = np.minimum(mean - energy, self._beta * deviation**2)  # where a sound chain stays below the mean
        return np.where(0.9 * gap > 6 * deviation, mean - 0.1 * gap, mean + 10 * deviation)


def default_step(problem: SyncProblem, kappa: float) -> float:
    r"""The default h: :math:`h/\beta = 1/(10\,(\kappa\,\deg_{\max} + n))`, β = κ/2."""
    return 0.05 * kappa / (kappa * problem.degrees.max() + problem.n)


def _gram(problem: SyncProblem) -> np.ndarray:
    """(N, n, n) sum of w C_ij C_ij^T over edges out of a node and of w I over edges into it."""
    gram = np.zeros((problem.n_nodes, problem.n, problem.n))
    weights = problem.weights[:, None, None]
    np.add.at(gram, problem.edges[:, 0], weights * (problem.maps @ so.transpose(problem.maps)))
    np.add.at(gram, problem.edges[:, 1], weights * np.eye(problem.n))
    return gram


def _one_of(name: str, value: object, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ValueError(f"{name}: {' or '.join(map(repr, choices))}, not {value!r}")
