"""Shapes that do not belong to a collection: unlike the rest in the lowest eigenvalues, or in what maps to them keep.

Shapes are put into groups by average linkage, which ends where poses of one surface no longer differ so much. Whatever
is outside the largest group is an outlier. The limits are those of ``python -m bench.own_shapes outliers``.
"""

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.cluster.hierarchy import average, fcluster
from scipy.spatial.distance import squareform

from fmsync import checks
from fmsync.matching.pairwise import FINE, PairMatch
from fmsync.matching.samples import SampledShape

_LOWEST = 20  # eigenvalues: of the higher ones those of all surfaces of one area are alike (Weyl's law)
# What poses of one surface may differ by, on average over a group. The second is half-way, on development folders,
# between the largest that joins poses of a species and the smallest that joins an outlier to them.
SPECTRUM, BOTH = 0.2, 0.067
_HOPELESS = 2.5  # spectra so many times as far from the rest are refused


class OutlierWarning(UserWarning):
    """Shapes that seem to be unlike the rest, whose maps mean little."""


def spectral_distances(shapes: Sequence[SampledShape]) -> np.ndarray:
    """(N, N) mean absolute differences of the logarithms of the lowest eigenvalues."""
    logs = np.log([s.basis.eigenvalues[1 : _LOWEST + 1] for s in shapes])
    return np.abs(logs[:, None] - logs).mean(axis=2)


def differences(shapes: Sequence[SampledShape], edges: np.ndarray, matches: Sequence[PairMatch]) -> np.ndarray:
    """(N, N) geometric means of spectral distance and distortion; that of a pair without a map is its shapes' mean."""
    found = np.full((len(shapes),) * 2, np.nan)
    found[edges[:, 0], edges[:, 1]] = found[edges[:, 1], edges[:, 0]] = [m.distortion for m in matches]
    of_shape = np.nanmean(found, axis=1)
    found = np.where(np.isnan(found), (of_shape[:, None] + of_shape) / 2, found)
    return np.sqrt(found * spectral_distances(shapes))


def groups(apart: np.ndarray, limit: float) -> list[list[int]]:
    """Groups of shapes whose mean distances, of (N, N), are at most ``limit``, the largest first.

    >>> groups(np.abs(np.subtract.outer([0, 1, 9, 2], [0, 1, 9, 2])), 3)
    [[0, 1, 3], [2]]
    """
    apart = apart * (1 - np.eye(len(apart)))
    labels = fcluster(average(squareform(apart, checks=False)), limit, "distance")
    return sorted((np.flatnonzero(labels == k).tolist() for k in np.unique(labels)), key=lambda g: (-len(g), g))


def belonging(
    shapes: Sequence[SampledShape], drop: bool, edges: np.ndarray | None = None, matches: Sequence[PairMatch] = ()
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Shapes (K,) to go on with, and the names of outliers, by spectra or, given ``matches``, by their maps as well.

    Without ``drop`` all shapes stay and outliers are named in a warning, those that are hopeless in a ValueError. With
    it a ValueError says if no group is the largest. Maps are looked at if they have the full size of a match.
    """
    everybody = np.arange(len(shapes))
    if edges is None:
        apart, limit = spectral_distances(shapes), SPECTRUM
        hopeless = groups(apart, _HOPELESS * limit)
    elif matches[0].c_ij.shape[-1] == FINE:
        apart, limit, hopeless = differences(shapes, edges, matches), BOTH, []
    else:
        return everybody, ()
    found = groups(apart, limit)
    if len(found) == 1:
        return everybody, ()
    names = [[shapes[k].shape.name for k in group] for group in found]
    said, outliers = sentence(names), tuple(name for group in names[1:] for name in group)
    if (len(hopeless) > 1 and not drop) or (drop and len(found[0]) == len(found[1])):
        raise ValueError(said)
    if drop:
        return np.sort(found[0]), outliers
    warnings.warn(said, OutlierWarning, stacklevel=3)
    return everybody, outliers


def sentence(names: Sequence[Sequence[str]]) -> str:
    """What to say of groups, the largest first."""
    if len(names[0]) == len(names[1]):
        kinds = " | ".join(", ".join(group) for group in names)
        return f"the shapes seem to be of {len(names)} kinds, {kinds}: match those of one kind"
    others = [name for group in names[1:] for name in group]
    is_are, them = ("is", "a likely outlier; leave it") if len(others) == 1 else ("are", "likely outliers; leave them")
    return f"{', '.join(others)} {is_are} unlike the rest: {them} out (--drop-outliers, drop_outliers=True)"


def among(stay: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which edges (E, 2) have both ends among the shapes that stay, which they must connect, and in new numbers."""
    keep = np.flatnonzero(np.isin(edges, stay).all(axis=1))
    return keep, checks.connected_edges(len(stay), np.searchsorted(stay, edges[keep]))
