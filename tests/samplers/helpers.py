"""Small problems and yardsticks that the sampler tests share."""

import numpy as np

import data_gen
import fmsync

ONE_EDGE_OF_SO20 = [(3, 3.0000), (10, 10.1674), (30, 16.8173)]  # kappa and the exact mean of the trace


def one_edge(n):
    return fmsync.SyncProblem(2, [[0, 1]], np.eye(n)[None])


def noisy(n_nodes=5, n=4, sigma2=0.1, rng=0, **options):
    return data_gen.perturb(data_gen.planted(n_nodes, n, rng=rng), sigma2, rng + 1, **options)


def mean_and_error(values):
    """Mean of (chains, draws) and its standard error from the spread of the chains' means."""
    means = np.mean(values, axis=1)
    return means.mean(), means.std(ddof=1) / np.sqrt(len(means))
