"""Rough maps of a pair from its extremities: the ends of limbs, tails and heads.

A pose that stretches the skin mixes eigenfunctions, so that often no choice of signs gives a map to start from. But the
ends of a body stay its ends, and distances between them change little. They are the local maxima of the average
geodesic distance (Hilaga et al. 2001), and are paired by their distances (as in Au et al. 2010).
"""

import itertools

import numpy as np

from fmsync.functional_maps import nearest_rows_unchecked as nearest_rows
from fmsync.matching.samples import SampledShape

_AROUND = 0.15  # radius in which the average distance of an extremity is the largest, in √area
# Extremities of a shape, of them in a pairing, and pairings. On stretched development species neither four or six in a
# pairing nor twice as many pairings left fewer pairs wrong by more than chance.
_MOST, _PAIRED, _CANDIDATES = 8, 5, 128


def extremities(shape: SampledShape) -> np.ndarray:
    """Samples (P,), P <= 8, that are farther from all others, on average, than those around them; the farthest first.

    >>> import data_gen
    >>> from fmsync.matching.samples import sample_shape
    >>> (cat,) = data_gen.load_collection("cats", count=1, n_vertices=1000)
    >>> len(extremities(sample_shape(cat, 20, 300)))  # paws, tail and head
    6
    """
    far = shape.geodesics.mean(axis=1)
    near = shape.geodesics < _AROUND
    tops = np.flatnonzero(far >= np.where(near, far, 0).max(axis=1))
    found: list[int] = []
    for p in tops[np.argsort(-far[tops], kind="stable")].tolist():
        if not near[p][found].any():  # samples in one place have one distance
            found.append(p)
    return np.array(found[:_MOST])


def extremity_maps(first: SampledShape, second: SampledShape, size: int, n_samples: int) -> np.ndarray:
    """Candidates (R, size, size), R <= 128, for the map C_ij: five extremities of i, or fewer, go to as many of j.

    Of all pairings those are kept that change the distances between the extremities least. The first ``n_samples``
    samples of i then go to the samples of j whose distances to the paired extremities are most alike.
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
