"""What every sampler has in common: the protocol, the registry of names, the temperature, and the prior as a node."""

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from fmsync.problem import LangevinPrior, SyncProblem, anchored
from fmsync.registry import Registry

#: Sampler classes by name.
SAMPLERS: "Registry[Callable[..., Sampler]]" = Registry("sampler", given=("problem", "start", "rng", "prior"))


class Sampler(Protocol):
    """A transition kernel of K chains that advance as one batch.

    Made as ``Sampler(problem, start, rng, prior, **options)`` from rotations ``start`` (K, N, n, n).

    Attributes
    ----------
    kappa
        (K,) concentration of the observations.
    ceiling
        (K,) energies that no sound chain reaches.
    advice
        What to do when a chain diverges.
    settings
        Plain values that it chose or was given.
    """

    kappa: np.ndarray
    ceiling: np.ndarray
    advice: str

    @property
    def settings(self) -> Mapping[str, object]:
        """Plain values that it chose or was given."""
        ...

    @property
    def state(self) -> np.ndarray:
        """(K, N, n, n) where the chains are, without helper nodes."""
        ...

    def draw(self) -> np.ndarray:
        """(K, N, n, n) the state as rotations."""
        ...

    def energy(self) -> np.ndarray:
        """(K,) potential U of the state, without the temperature."""
        ...

    def step(self, warming: bool) -> None:
        """One transition of all chains; it may adapt itself while ``warming`` is true, never after."""
        ...


def sampler(name: str) -> Callable[[Callable[..., Sampler]], Callable[..., Sampler]]:
    """Register a sampler class under a name."""
    return SAMPLERS.register(name)


def methods() -> list[str]:
    """Names that :func:`fmsync.sample` knows.

    Examples
    --------
    >>> import fmsync
    >>> "rlfm" in fmsync.samplers.methods()
    True
    """
    return SAMPLERS.names()


def concentration(kappa: float | str | None, beta: float | None) -> float:
    """κ from κ or β, of which one at most is given: κ = 2β, and β = 1 where neither is."""
    if kappa is not None and beta is not None:
        raise ValueError("kappa, beta: give one of them, they are the same temperature (kappa = 2 beta)")
    name, value = ("kappa", kappa) if kappa is not None else ("beta", 1.0 if beta is None else beta)
    if isinstance(value, str):
        raise ValueError(f"{name}: this sampler does not infer it; give a number > 0, or use 'heat-bath'")
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{name}: must be finite and > 0, got {value}")
    return float(value) if name == "kappa" else 2.0 * float(value)


def with_anchor(
    problem: SyncProblem, start: np.ndarray, prior: LangevinPrior | None, kappa: float
) -> tuple[SyncProblem, np.ndarray]:
    """Write the prior as edges from one more node, the last, that is held at I; without a prior change nothing."""
    if prior is None:
        return problem, start
    anchor = np.broadcast_to(np.eye(problem.n), (len(start), 1, problem.n, problem.n))
    return anchored(problem, prior, kappa), np.concatenate([start, anchor], axis=1)
