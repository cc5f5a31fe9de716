"""What every sampler has in common: its target, the protocol and the registry of names."""

from collections.abc import Callable, Mapping
from dataclasses import InitVar, dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from fmsync import checks
from fmsync.energy import energy
from fmsync.estimators.solve import solve
from fmsync.langevin import matched_kappa
from fmsync.problem import LangevinPrior, SyncProblem, check_prior
from fmsync.registry import Registry
from fmsync.so import transpose

SAMPLERS: "Registry[Callable[..., Sampler]]" = Registry("sampler", given=("target", "start", "rng"))  #: by name

_CHOICES = {
    "likelihood": ("langevin", "projected-gaussian", "mixture", "by-edge", "by-frequency"),
    "energy": ("euclidean", "geodesic"),
}


@dataclass(frozen=True, eq=False)
class Target:
    """The posterior that a sampler draws from; the parameters are those of :func:`fmsync.sample`.

    ``kappa`` is a number, "auto", or None where neither κ nor β was given.
    """

    problem: SyncProblem
    prior: LangevinPrior | None = None
    kappa: float | str | None = None
    beta: InitVar[float | None] = None
    likelihood: str = "langevin"
    energy: str = "euclidean"

    def __post_init__(self, beta: float | None) -> None:
        for name, choices in _CHOICES.items():
            checks.one_of(name, getattr(self, name), choices)
        if self.prior is not None:
            check_prior(self.problem, self.prior)
        if self.likelihood != "langevin" and (self.problem.weights != 1).any():
            raise ValueError(f"weights: likelihood={self.likelihood!r} needs weights 1; repeat an edge instead")
        if self.energy == "geodesic":
            checks.rotations("maps (node = edge)", self.problem.maps)
        if self.kappa is not None and beta is not None:
            raise ValueError("kappa, beta: give one of them, they are the same temperature (kappa = 2 beta)")
        if isinstance(self.kappa, str):
            if self.kappa != "auto":
                raise ValueError(f"kappa: a number > 0 or 'auto', not {self.kappa!r}")
        elif self.kappa is not None:
            object.__setattr__(self, "kappa", checks.positive("kappa", self.kappa))
        elif beta is not None:
            object.__setattr__(self, "kappa", 2 * checks.positive("beta", beta))

    def only(self, method: str, **given: str) -> None:
        """Refuse a likelihood or an energy that a method does not know."""
        for name, value in given.items():
            if getattr(self, name) != value:
                raise ValueError(f"{name}: {method!r} takes {value!r} alone; fmsync.sample says which takes more")

    def fixed_kappa(self) -> float:
        """κ for a sampler that does not infer it: 2, the paper's β = 1, where neither is given."""
        if isinstance(self.kappa, str):
            raise ValueError("kappa: this sampler does not infer it; give a number > 0, or use 'heat-bath'")
        return 2.0 if self.kappa is None else self.kappa

    def matched_kappa(self, name: str, rng: np.random.Generator) -> float:
        """Where chains begin that infer κ: that of the mean cosine of the observations around the spectral estimate.

        A ValueError where ``name`` cannot be inferred: observations off the group, or a forest without repeated edges,
        where some maps meet all observations exactly whatever their noise.
        """
        p, prior = self.problem, self.prior
        held, nodes = (0, p.n_nodes) if prior is None else (int((prior.kappa > 0).sum()), p.n_nodes + 1)
        if p.n_edges + held < nodes:
            why = "a tree without repeated edges says nothing about its noise, every observation can be met exactly"
            raise ValueError(f"{name}: {why}; give {name} a value, or add observations")
        checks.rotations("maps (node = edge)", p.maps)
        trace = (p.constant - energy(p, solve(p, "spectral", rng=rng).absolute)) / 2
        cosine = trace / (p.n * p.weights.sum())
        return max(matched_kappa(p.n, min(cosine, 1 - 1e-3)), 0.1)

    @cached_property
    def field(self) -> np.ndarray:
        r"""(N, n, n) transposed linear terms :math:`\kappa_i M_i^\top` of the prior; (0, n, n) without one."""
        if self.prior is None:
            return np.empty((0, self.problem.n, self.problem.n))
        return np.ascontiguousarray(self.prior.kappa[:, None, None] * transpose(self.prior.mean))


class Sampler(Protocol):
    """A transition kernel of K chains that advance as one batch.

    Made as ``Sampler(target, start, rng, **options)`` from a :class:`Target` and rotations ``start`` (K, N, n, n).

    ``kappa`` (K,) is the concentration of the observations. A chain whose energy reaches the ``ceiling``, (K,) or one
    for all, has diverged, and ``advice`` says what to do then. ``edge_weights`` (K, E) are the inlier probabilities of
    the observations, where the likelihood has outliers, and ``kappas`` (K, E) or (K, n) the concentrations of
    observations or of basis functions, where each has its own.
    """

    kappa: np.ndarray
    edge_weights: np.ndarray | None = None
    kappas: np.ndarray | None = None
    ceiling: np.ndarray | float = np.inf
    advice: str = "the state is not finite"

    @property
    def settings(self) -> Mapping[str, object]:
        """Plain values that it chose or was given."""

    @property
    def state(self) -> np.ndarray:
        """(K, N, n, n) where the chains are, without helper nodes."""

    def draw(self) -> np.ndarray:
        """(K, N, n, n) the state as rotations."""
        return self.state

    def energy(self) -> np.ndarray:
        """(K,) potential U of the state, without the temperature and, but for ``"rlfm"``, without the prior."""

    def step(self, warmup: bool) -> None:
        """One transition of all chains; it may adapt itself in the warm-up, never after."""


sampler = SAMPLERS.register  #: register a sampler class under a name


def methods() -> list[str]:
    """Names that :func:`fmsync.sample` knows."""
    return sorted(SAMPLERS)
