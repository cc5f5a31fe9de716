"""Chains of different problems as one batch: for many small problems, whose steps are mostly calls from Python."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fmsync.problem import SyncProblem
from fmsync.samplers.base import SAMPLERS
from fmsync.samplers.draw_store import DrawStore
from fmsync.samplers.posterior import Posterior
from fmsync.samplers.rlfm import RLFM
from fmsync.samplers.sample import check_counts, no_callback, run_chains, starts
from fmsync.threads import single_threaded_blas


def sample_together(
    problems: Sequence[SyncProblem],
    *,
    rngs: Sequence[int | np.random.Generator],
    n_draws: int = 1000,
    warmup: int = 1000,
    thin: int = 1,
    init: str = "spectral",
    **options: Any,
) -> list[Posterior]:
    """One chain of ``"rlfm"`` for each of several problems of one size, all advanced as one batch.

    Draw by draw the same as ``fmsync.sample(problem, "rlfm", n_chains=1, rng=rng, ...)`` for every problem and its
    generator, in less time where problems are small (``python -m bench.speed_runner`` measures it).
    Convergence is not judged: see :func:`fmsync.diagnostics.warn_unless_converged`.

    Parameters
    ----------
    problems
        With as many shapes and basis functions each; graphs and weights may differ.
    rngs
        Seed or generator of every problem.
    n_draws, warmup, thin, init, options
        As for :func:`fmsync.sample`.

    Raises
    ------
    ValueError
        Problems of different sizes, another number of generators, an unknown option, counts below one.
    RuntimeError
        A chain diverged; the message gives its number, which is that of its problem.

    Examples
    --------
    >>> import numpy as np, fmsync
    >>> edges, maps = [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3)
    >>> problems = [fmsync.SyncProblem(3, edges, maps), fmsync.SyncProblem(3, edges[:2], maps[:2])]
    >>> [post.absolute.shape for post in sample_together(problems, rngs=[0, 1], n_draws=50, warmup=20)]
    [(1, 50, 3, 4, 4), (1, 50, 3, 4, 4)]
    """
    SAMPLERS.find("rlfm", options)
    check_counts(n_draws=n_draws, warmup=warmup, thin=thin)
    sizes = {(problem.n_nodes, problem.n) for problem in problems}
    if len(sizes) != 1 or len(rngs) != len(problems):
        raise ValueError(
            f"problems, rngs: {len(problems)} problems of sizes (n_nodes, n) {sorted(sizes)} and {len(rngs)} generators"
            "; need problems of one size and a generator for each"
        )
    generators = tuple(np.random.default_rng(rng) for rng in rngs)
    with single_threaded_blas():
        start = np.concatenate([starts(problem, init, 1, rng) for problem, rng in zip(problems, generators)])
        engine = RLFM(tuple(problems), start, generators, **options)
        draws = DrawStore("memory", n_draws, engine.state.shape)
        with draws:
            energies, kappas = run_chains(engine, n_draws, warmup, thin, no_callback, draws)
    settings = {"warmup": int(warmup), "thin": int(thin), **engine.settings}
    return [
        Posterior(
            problem,
            "rlfm",
            draws.result[k : k + 1],
            energies[k : k + 1],
            kappas[k : k + 1],
            energies.shape[1] < n_draws,
            {**settings, "step": float(engine.steps[k])},
        )
        for k, problem in enumerate(problems)
    ]
