"""Posterior draws: every sampler is one file here, registered by name, called through :func:`sample`.

A sampler is a class made as ``Sampler(problem, start, rng, prior, **options)`` from rotations ``start`` (K, N, n, n), K
chains that advance as one batch. It offers

- ``step(warming)``: one transition of all chains; it may adapt itself while ``warming`` is true, never after;
- ``state`` (K, N, n, n): where the chains are, without helper nodes;
- ``draw()`` (K, N, n, n): the same as rotations;
- ``energy()`` (K,): its potential U there, without the temperature; ``ceiling`` (K,): energies no sound chain reaches;
- ``kappa`` (K,): the concentration of the observations; ``settings``: plain values it chose or was given;
- ``advice``: what to do when a chain diverges.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from tqdm import tqdm

from fmsync import so
from fmsync._registry import Registry
from fmsync._threads import single_threaded_blas
from fmsync.estimators import Estimate, solve, starting_point
from fmsync.problem import LangevinPrior, SyncProblem, anchored
from fmsync.samplers._posterior import Posterior
from fmsync.samplers._store import DrawStore

__all__ = ["Posterior", "concentration", "methods", "sample", "sampler", "with_anchor"]

Callback = Callable[[int, np.ndarray, np.ndarray], None]  # (draw, state (chains, N, n, n), energy (chains,))

_REGISTRY = Registry("sampler", __name__, given=("problem", "start", "rng", "prior"))
_CHECK_EVERY = 50  # warm-up steps between two looks at the energy


def sampler(name: str) -> Callable[[type], type]:
    """Register a sampler class under a name."""
    return _REGISTRY.register(name)


def methods() -> list[str]:
    """Names that :func:`fmsync.sample` knows.

    Examples
    --------
    >>> import fmsync
    >>> "rlfm" in fmsync.samplers.methods()
    True
    """
    return _REGISTRY.names()


def sample(
    problem: SyncProblem,
    method: str = "rlfm",
    *,
    rng: int | np.random.Generator = 0,
    n_chains: int = 4,
    n_draws: int = 1000,
    warmup: int = 1000,
    thin: int = 1,
    init: str | np.ndarray | Estimate = "spectral",
    prior: LangevinPrior | None = None,
    callback: Callback | None = None,
    store: str | Path | None = "memory",
    **options,
) -> Posterior:
    r"""Draw the absolute maps from their posterior :math:`\propto\exp(-\beta U(C))`, all chains as one batch.

    Parameters
    ----------
    problem
        What was observed.
    method
        A name of :func:`fmsync.samplers.methods`.
    rng
        Seed or generator: same seed, same draws.
    n_chains
        Chains, run as one batch.
    n_draws
        Draws kept of each chain.
    warmup
        Steps thrown away before the first draw.
    thin
        Steps from one draw to the next.
    init
        Where chains start: ``"spectral"``; ``"random"``, another Haar draw for each chain; ``"dispersed"``, every other
        chain at the maximum of the likelihood and the rest at Haar draws; rotations (N, n, n), the same for all chains,
        or (chains, N, n, n); an :class:`~fmsync.Estimate` on the group.
    prior
        Langevin prior on the absolute maps; it fixes the gauge.
    callback
        Called as ``callback(draw, state, energy)`` for every draw kept, with the (chains, N, n, n) where the chains
        are: not rotations in an unconstrained chain. Do not change it. :mod:`fmsync.samplers.running` has summaries to
        be used here.
    store
        Where draws go: ``"memory"``; a path ending in ``.npy``, written as they come and put in place when complete;
        None, nowhere (energies and concentrations are kept), for runs of any length with a running summary.
    options
        Passed to the sampler; an unknown option is refused with the list of known ones.

    Returns
    -------
    Posterior
        With fewer draws and ``interrupted`` set after Ctrl-C (which goes through if there is no draw yet).

    Warns
    -----
    fmsync.diagnostics.ConvergenceWarning
        R-hat of the energy or of an inferred noise level above 1.01, or fewer than 400 effective draws of them.

    Raises
    ------
    ValueError
        Unknown method or option, counts below one, a start of wrong shape or off the group (names the node).
    RuntimeError
        A chain diverged; the message names a step to try.

    Examples
    --------
    >>> import numpy as np, fmsync
    >>> p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
    >>> post = fmsync.sample(p, "rlfm", n_chains=2, n_draws=50, warmup=20, rng=0)
    >>> post.absolute.shape, post.relative_mean().shape
    ((2, 50, 3, 4, 4), (3, 4, 4))
    """
    kind, _ = _REGISTRY.find(method, options)
    _check_counts(n_chains=n_chains, n_draws=n_draws, warmup=warmup, thin=thin)
    rng = np.random.default_rng(rng)
    with single_threaded_blas():
        start = _starts(problem, init, n_chains, rng)
        engine = kind(problem, start, rng, prior, **options)
        draws = DrawStore(store, n_draws, engine.state.shape)
        with draws:
            energies, kappas = _run(engine, n_draws, warmup, thin, callback or _nothing, draws)
    settings = {"warmup": int(warmup), "thin": int(thin), **engine.settings}
    interrupted = energies.shape[1] < n_draws
    post = Posterior(problem, method, draws.result, energies, kappas, interrupted, settings)
    from fmsync.diagnostics import warn_unless_converged

    warn_unless_converged(post)
    return post


def _check_counts(**counts: int) -> None:
    """Refuse what is no integer, or too small: a warm-up may be left out, nothing else."""
    for name, count in counts.items():
        least = 0 if name == "warmup" else 1
        if isinstance(count, bool) or int(count) != count or count < least:
            raise ValueError(f"{name}: an integer >= {least}, got {count}")


def _run(engine, n_draws: int, warmup: int, thin: int, callback: Callback, draws: DrawStore) -> tuple[np.ndarray, ...]:
    """Energies and concentrations, each (K, T); the rotations go to ``draws``. T < n_draws after Ctrl-C."""
    energies, kappas = np.empty((len(engine.state), n_draws)), np.empty((len(engine.state), n_draws))
    done = 0
    with tqdm(total=warmup + thin * n_draws, disable=None, unit="step", leave=False) as bar:
        try:
            for k in range(warmup):
                engine.step(warming=True)
                bar.update()
                if (k + 1) % _CHECK_EVERY == 0:
                    _check(engine)
            while done < n_draws:
                for _ in range(thin):
                    engine.step(warming=False)
                    bar.update()
                energies[:, done] = _check(engine)
                kappas[:, done] = engine.kappa
                draws.put(done, engine.draw())
                callback(done, engine.state, energies[:, done])
                done += 1
                draws.done = done
        except KeyboardInterrupt:
            if done == 0:
                raise
    return energies[:, :done], kappas[:, :done]


def _check(engine) -> np.ndarray:
    """Energies (K,) of the chains; a RuntimeError when one of them is where no sound chain goes."""
    with np.errstate(over="ignore", invalid="ignore"):  # a chain that blew up is told of below
        energy = engine.energy()
    bad = np.flatnonzero(~(energy <= engine.ceiling))
    if bad.size:
        raise RuntimeError(f"chain {bad[0]} diverged: energy {energy[bad[0]]:.4g}; {engine.advice}")
    return energy


def concentration(kappa: float | None, beta: float | None) -> float:
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


def _starts(problem: SyncProblem, init, n_chains: int, rng: np.random.Generator) -> np.ndarray:
    """Rotations (K, N, n, n), one start for each chain."""
    if isinstance(init, str) and init in ("random", "dispersed"):
        starts = so.random_uniform(problem.n, (n_chains, problem.n_nodes), rng)
        if init == "dispersed":
            starts[::2] = solve(problem, "mle", rng=rng).absolute
        return starts
    if isinstance(init, str) and init != "spectral":
        raise ValueError(f"init: 'spectral', 'random', 'dispersed', rotations or an Estimate, not {init!r}")
    if not isinstance(init, str | Estimate) and np.ndim(init) == 4:
        if len(init) != n_chains:
            raise ValueError(f"init: {len(init)} starts for {n_chains} chains")
        return np.stack([starting_point(problem, start, rng) for start in init])
    return np.stack([starting_point(problem, init, rng)] * n_chains)


def _nothing(draw: int, state: np.ndarray, energy: np.ndarray) -> None:
    """The callback of a caller who gave none."""
