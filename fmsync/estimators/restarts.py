"""Several starts of one optimiser: do they agree, and the paper's mean over them."""

from dataclasses import replace

import numpy as np

from fmsync import so
from fmsync.estimators import Estimate, solve
from fmsync.problem import SyncProblem


def best_of_starts(problem: SyncProblem, method: str, restarts: int, rng: np.random.Generator, **options) -> Estimate:
    """The cheapest of ``restarts`` answers: one from the method's own start, the others from Haar-random ones.

    What ``solve(..., restarts=k)`` calls. The estimate says in ``n_agreeing`` how many starts, its own included, came
    to its cost up to one part in a million: that all agree is evidence for a global optimum, that some do not is
    proof of local ones.
    """
    if isinstance(restarts, bool) or int(restarts) != restarts or restarts < 1:
        raise ValueError(f"restarts: need a whole number of starts >= 1, got {restarts}")
    inits = [options.pop("init", None)] + ["random"] * (restarts - 1)
    answers = [
        solve(problem, method, rng=stream, **options, **({} if init is None else {"init": init}))
        for init, stream in zip(inits, rng.spawn(restarts))
    ]
    best = min(answers, key=lambda answer: answer.cost)
    slack = 1e-6 * max(1.0, abs(best.cost))
    return replace(best, n_starts=int(restarts), n_agreeing=sum(answer.cost <= best.cost + slack for answer in answers))


def mean_of_starts(
    problem: SyncProblem,
    n_starts: int = 10,
    method: str = "mle",
    *,
    rng: int | np.random.Generator = 0,
    distance: str = "geodesic",
    **options,
) -> tuple[Estimate, list[Estimate]]:
    """The paper's protocol: independent random starts, gauges aligned, Fréchet mean of every absolute map.

    All answers stand in the gauge C_1 = I before they are averaged: without it each start would bring a frame of its
    own and the mean would be noise.

    Parameters
    ----------
    problem
        Observed maps.
    n_starts
        10 in the paper.
    method
        An iterative method on :math:`SO(n)^N` with an ``init`` option.
    rng
        Seed or generator of the starts.
    distance
        Of the mean: ``"geodesic"`` or ``"chordal"`` (:func:`fmsync.so.frechet_mean`).
    options
        Passed to the method.

    Returns
    -------
    mean
        Estimate at the mean, its Euclidean energy as ``cost``.
    starts
        The single answers.

    Raises
    ------
    RuntimeError
        The starts ended too far apart for a geodesic mean (beyond the recovery threshold); use ``"chordal"``.

    Examples
    --------
    >>> import numpy as np, fmsync
    >>> from fmsync.estimators.restarts import mean_of_starts
    >>> p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
    >>> mean, starts = mean_of_starts(p, 3, rng=0)
    >>> mean.cost < 1e-12, len(starts)
    (True, 3)
    """
    streams = np.random.default_rng(rng).spawn(n_starts)
    starts = [solve(problem, method, rng=stream, init="random", **options) for stream in streams]
    absolute = so.frechet_mean(np.stack([start.absolute for start in starts]), distance=distance)
    mean = Estimate.from_absolute(problem, absolute, f"mean of {n_starts} {method}")
    return mean, starts
