"""Rough maps of a pair from the ends of limbs, tails and heads.

A pose that stretches the skin mixes eigenfunctions, and then no choice of signs gives a map to start from. But the
ends of a body stay its ends, and the distances between them change little.
"""

import itertools

import numpy as np

from fmsync.functional_maps import nearest_rows_unchecked as nearest_rows
from fmsync.matching.samples import SampledShape

_AROUND = 0.15  # an extremity is farther from the rest than all that is nearer to it than this, in √area
_MOST, _PAIRED, _CANDIDATES = 8, 5, 128  # extremities of a shape; of them in a pairing; pairings


def extremities(shape: SampledShape) -> np.ndarray:
    """Samples (P,), P <= 8, that are farther from all others, on average, than those around them; the farthest first.

    >>> import data_gen
    >>> from fmsync.matching.samples import sample_shape
    >>> (cat,) = data_gen.load_collection("cats", count=1, n_vertices=1000)
    >>> len(extremities(sample_shape(cat, 20, 300)))  # paws, tail and head
    6
    """
    far = shape.geodesics.mean(axis=1)
    found = np.flatnonzero(far >= np.where(shape.geodesics < _AROUND, far, 0).max(axis=1))
    return found[np.argsort(-far[found], kind="stable")[:_MOST]]


def extremity_maps(first: SampledShape, second: SampledShape, size: int, n_samples: int) -> np.ndarray:
    """Candidates (R, size, size), R <= 128, for the map C_ij: five extremities of i go to five of j.

    Of all ways to choose and to order them those that change the distances between them least. The first ``n_samples``
    samples of i are matched to all of j by their distances from the five.
    """
    a, b = extremities(first), extremities(second)
    count = min(_PAIRED, len(a), len(b))
    one, other = np.triu_indices(count, 1)
    chosen = a[list(itertools.combinations(range(len(a)), count))]  # (A, count)
    images = b[list(itertools.permutations(range(len(b)), count))]  # (B, count)
    distances = second.geodesics[images[:, one], images[:, other]]  # (B, count (count - 1) / 2)
    change = np.array([np.abs(distances - first.geodesics[own[one], own[other]]).sum(axis=1) for own in chosen])
    best = np.argsort(change, axis=None, kind="stable")[:_CANDIDATES]
    at_i, at_j = first.sampled(n_samples)[:, :size], second.sampled()[:, :size]
    back, found = np.linalg.pinv(at_i), []
    for k, m in zip(*np.unravel_index(best, change.shape)):
        nearest = nearest_rows(first.geodesics[: len(at_i), chosen[k]], second.geodesics[:, images[m]])
        found.append(back @ at_j[nearest])
    return np.array(found)
