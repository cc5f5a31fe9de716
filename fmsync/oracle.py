r"""The paper's oracle accuracy: how near the truth lies the best map that can be pieced together from the draws."""

import numpy as np

from fmsync import checks, so
from fmsync.problem import fix_gauge_unchecked as fix_gauge


@checks.checked(draws=checks.array, truth="N n n rotations", counts="M < K1")
def oracle_accuracy(draws: np.ndarray, truth: np.ndarray, counts: np.ndarray | None = None) -> np.ndarray:
    r"""Oracle accuracy against the number of samples.

    Draws and truth are gauged to C_1 = I. For every entry of every true map the oracle takes, among the first k draws,
    the entry closest to it; Ĉ_i holds these, and :math:`\mathrm{Acc} = \frac{1}{N}\sum_i 1 / (1 + \lVert C_i - \hat
    C_i\rVert_F)`. The first map counts with accuracy 1 whatever was sampled, and n² separate searches are won by any
    sampler that scatters widely enough: the number separates samplers poorly.

    ``draws`` (K, N, n, n) are absolute maps in any gauge (``post.absolute.reshape(-1, N, n, n)``), not necessarily
    rotations, only invertible in the first node; ``truth`` (N, n, n) are rotations. Returns (M,) accuracies in (0, 1],
    never falling, for ``counts`` (M,) of samples, between 1 and K; 1..K by default.

    >>> truth = so.random_uniform(4, 3, rng=0)
    >>> oracle_accuracy(truth[None], truth).round(6)
    array([1.])
    """
    draws, truth = np.asarray(draws, dtype=float), np.asarray(truth, dtype=float)
    if draws.ndim != 4 or draws.shape[1:] != truth.shape or len(draws) == 0:
        raise ValueError(f"draws: expected (K, {', '.join(map(str, truth.shape))}) with K >= 1, got {draws.shape}")
    counts = np.arange(1, len(draws) + 1) if counts is None else np.asarray(counts)
    if (bad := np.flatnonzero((counts < 1) | (counts > len(draws)))).size:
        raise ValueError(f"counts[{bad[0]}] = {counts[bad[0]]} is outside 1..{len(draws)}, the number of draws")
    target = fix_gauge(truth)
    squared = np.empty((len(draws), len(truth)))  # of ‖C_i - Ĉ_i‖ after every draw
    nearest = np.full(truth.shape, np.inf)
    for k, draw in enumerate(draws):
        np.minimum(nearest, np.abs(np.linalg.inv(draw[0]) @ draw - target), out=nearest)
        squared[k] = (nearest**2).sum((1, 2))
    return (1 / (1 + np.sqrt(squared[counts - 1]))).mean(axis=1)


@checks.checked(first="N n n rotations")
def haar_baseline(first: np.ndarray, n_samples: int, rng: int | np.random.Generator = 0) -> np.ndarray:
    """The paper's baseline draws (n_samples, N, n, n): a point estimate first, then uniform rotations.

    ``first`` (N, n, n) are absolute maps, e.g. of the maximum of the likelihood, and count as a sample.
    """
    uniform = so.random_uniform(first.shape[-1], (n_samples - 1, len(first)), rng)
    return np.concatenate([fix_gauge(first)[None], fix_gauge(uniform)])
