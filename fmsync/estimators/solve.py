"""Estimate the absolute maps of a problem by any estimator, from one start or several."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from fmsync import checks, so
from fmsync.estimators.base import ESTIMATORS, Callback, Estimate
from fmsync.problem import SyncProblem
from fmsync.threads import single_threaded_blas

_FAR = 0.5  # orthogonality error of a map above which its user is warned: a quarter of the rank missing


@checks.checked()
def solve(
    problem: SyncProblem,
    method: str = "mle",
    *,
    rng: int | np.random.Generator = 0,
    callback: Callback | None = None,
    restarts: int | None = None,
    **options: Any,
) -> Estimate:
    """Estimate the absolute maps of a problem; BLAS runs single-threaded meanwhile, which small products like.

    * ``method``, ``rng``: a name of :func:`methods`, and a seed or generator: same seed, same answer.
    * ``callback``: called as ``callback(iteration, absolute, cost, gradient_norm)`` at the start and after each
      accepted step of an iterative method; direct methods call it once.
    * ``restarts``: number of starts of a method with an ``init`` option: its own and Haar-random ones. The cheapest
      answer is returned, and its ``n_agreeing`` starts came to its cost up to one part in a million: that all agree
      suggests a global optimum.
    * ``options`` of the method; an unknown one is refused with the list of known ones.

    Warns with a RuntimeWarning when the method stopped before its tolerance was met (``converged`` is then False), and
    with a UserWarning that names the worst edge when maps far from orthogonal met a method that answers with rotations.

    >>> import numpy as np, fmsync
    >>> p = fmsync.SyncProblem(3, [[0, 1], [1, 2], [0, 2]], np.stack([np.eye(4)] * 3))
    >>> fmsync.solve(p, "mle").cost < 1e-20
    True
    """
    function, known = ESTIMATORS.find(method, options)
    generator = np.random.default_rng(rng)
    if restarts is not None:
        if "init" not in known:
            raise ValueError(f"restarts: {method!r} has no starting point to vary; leave restarts out")
        inits = [options.pop("init", None)] + ["random"] * (restarts - 1)
        answers = [
            solve(problem, method, rng=stream, callback=callback, **options, **({} if init is None else {"init": init}))
            for init, stream in zip(inits, generator.spawn(restarts))
        ]
        best = min(answers, key=lambda answer: answer.cost)
        slack = 1e-6 * max(1.0, abs(best.cost))
        return replace(best, n_starts=restarts, n_agreeing=sum(answer.cost <= best.cost + slack for answer in answers))
    with single_threaded_blas():
        estimate = function(problem, rng=generator, callback=callback or (lambda *_: None), **options)
    if not estimate.converged:
        left = "" if estimate.trace is None else f", gradient norm {estimate.trace.gradient_norm[-1]:.2g}"
        message = f"{method!r} stopped after {estimate.n_iterations} steps before its tolerance was met{left}"
        warnings.warn(message, RuntimeWarning, stacklevel=3)
    worst = int(np.argmax(problem.orthogonality_error))
    if estimate.on_group and (error := problem.orthogonality_error[worst]) > _FAR:
        far = f"{checks.edge_name(problem.edges, worst)} is far from orthogonal (‖CᵀC - I‖/√n = {error:.2g})"
        todo = "project the maps with fmsync.so.project, or use 'mle-unconstrained'"
        warnings.warn(f"maps: {far}; {todo}", UserWarning, stacklevel=3)
    return estimate


@checks.checked()
def mean_of_starts(
    problem: SyncProblem,
    n_starts: int = 10,
    method: str = "mle",
    *,
    rng: int | np.random.Generator = 0,
    distance: str = "geodesic",
    **options: Any,
) -> tuple[Estimate, list[Estimate]]:
    """The paper's protocol: independent random starts, gauges aligned to C_1 = I, Fréchet mean of every absolute map.

    ``method`` is an iterative one on :math:`SO(n)^N` with an ``init`` option, and ``options`` go to it. Returns the
    estimate at the mean (:func:`fmsync.so.frechet_mean`), its Euclidean energy as ``cost``, and the single answers. A
    RuntimeError when they are too far apart for a geodesic mean (beyond the recovery threshold); use ``"chordal"``.
    """
    checks.unused("here, where all starts are random", init=(options.get("init"), None))
    streams = np.random.default_rng(rng).spawn(n_starts)
    starts = [solve(problem, method, rng=stream, init="random", **options) for stream in streams]
    absolute = so.frechet_mean(np.stack([start.absolute for start in starts]), distance=distance)
    mean = Estimate.from_absolute(problem, absolute, f"mean of {n_starts} {method}")
    return mean, starts
