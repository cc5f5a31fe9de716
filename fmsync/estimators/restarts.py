"""The paper's mean over several starts of one optimiser."""

from typing import Any

import numpy as np

from fmsync import checks, so
from fmsync.checks import checked
from fmsync.estimators.base import Estimate
from fmsync.estimators.solve import solve
from fmsync.problem import SyncProblem


@checked()
def mean_of_starts(
    problem: SyncProblem,
    n_starts: int = 10,
    method: str = "mle",
    *,
    rng: int | np.random.Generator = 0,
    distance: str = "geodesic",
    **options: Any,
) -> tuple[Estimate, list[Estimate]]:
    """The paper's protocol: independent random starts, gauges aligned, Fréchet mean of every absolute map.

    All answers stand in the gauge C_1 = I before they are averaged: without it each start would bring a frame of its
    own and the mean would be noise.

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
