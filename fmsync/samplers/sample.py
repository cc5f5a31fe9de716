"""Draw from the posterior of a problem by any sampler."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from tqdm import tqdm

from fmsync import so
from fmsync.diagnostics import warn_unless_converged
from fmsync.estimators.base import Estimate
from fmsync.estimators.solve import solve
from fmsync.estimators.starts import starting_point
from fmsync.problem import LangevinPrior, SyncProblem
from fmsync.samplers.base import SAMPLERS, Sampler
from fmsync.samplers.draw_store import DrawStore
from fmsync.samplers.posterior import Posterior
from fmsync.threads import single_threaded_blas

Callback = Callable[[int, np.ndarray, np.ndarray], None]  # (draw, state (chains, N, n, n), energy (chains,))

_CHECK_EVERY = 50  # warm-up steps between two looks at the energy


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
    **options: object,
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
        are: not rotations in an unconstrained chain. Do not change it. :mod:`fmsync.samplers.streaming` has
        summaries to be used here.
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
    kind, _ = SAMPLERS.find(method, options)
    check_counts(n_chains=n_chains, n_draws=n_draws, warmup=warmup, thin=thin)
    rng = np.random.default_rng(rng)
    with single_threaded_blas():
        start = starts(problem, init, n_chains, rng)
        engine = kind(problem, start, rng, prior, **options)
        draws = DrawStore(store, n_draws, engine.state.shape)
        with draws:
            energies, kappas = run_chains(engine, n_draws, warmup, thin, callback or no_callback, draws)
    settings = {"warmup": int(warmup), "thin": int(thin), **engine.settings}
    interrupted = energies.shape[1] < n_draws
    post = Posterior(problem, method, draws.result, energies, kappas, interrupted, settings)
    warn_unless_converged(post)
    return post


def check_counts(**counts: int) -> None:
    """Refuse what is no integer, or too small: a warm-up may be left out, nothing else."""
    for name, count in counts.items():
        least = 0 if name == "warmup" else 1
        if isinstance(count, bool) or int(count) != count or count < least:
            raise ValueError(f"{name}: an integer >= {least}, got {count}")


def run_chains(
    engine: Sampler, n_draws: int, warmup: int, thin: int, callback: Callback, draws: DrawStore
) -> tuple[np.ndarray, np.ndarray]:
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


def _check(engine: Sampler) -> np.ndarray:
    """Energies (K,) of the chains; a RuntimeError when one of them is where no sound chain goes."""
    with np.errstate(over="ignore", invalid="ignore"):  # a chain that blew up is told of below
        energy = engine.energy()
    bad = np.flatnonzero(~(energy <= engine.ceiling))
    if bad.size:
        raise RuntimeError(f"chain {bad[0]} diverged: energy {energy[bad[0]]:.4g}; {engine.advice}")
    return energy


def starts(
    problem: SyncProblem, init: str | np.ndarray | Estimate, n_chains: int, rng: np.random.Generator
) -> np.ndarray:
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


def no_callback(draw: int, state: np.ndarray, energy: np.ndarray) -> None:
    """The callback of a caller who gave none."""
