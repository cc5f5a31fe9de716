"""Where a vertex goes and how sure that is: images under posterior draws, and under the evidence of other shapes."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fmsync._threads import single_threaded_blas
from fmsync.functional_map import _nearest
from fmsync.pipeline.samples import SampledShape

_NEAR = 0.05  # square roots of the area: images this near to each other count as one place
_FAR = 0.12  # two places this far apart are two modes
_SHARE = 0.2  # and both hold this share of the votes
_RESOLUTION = 0.02  # added to radii before they are scaled: no region is smaller than what samples resolve


@dataclass(frozen=True, eq=False)
class Confidence:
    """What is known of the images on shape j of the samples of shape i; lengths in square roots of the area.

    Attributes
    ----------
    mode
        (S,) sample of j hit most often, after merging near ones.
    image
        (S,) sample of j under the synchronised map: the centre of the region.
    radius
        (S,) geodesic radius about ``image`` that holds ``level`` of the draws.
    spread
        (S,) mean geodesic distance from ``image`` to where maps through other shapes send the sample.
    entropy
        (S,) of the draws' images, in nats.
    two_modes
        (S,) whether two distant places both hold a fifth of the votes of the maps through other shapes.
    level
        Of the region, in (0, 1).
    """

    mode: np.ndarray
    image: np.ndarray
    radius: np.ndarray
    spread: np.ndarray
    entropy: np.ndarray
    two_modes: np.ndarray
    level: float


def confidence(
    first: SampledShape,
    second: SampledShape,
    image: np.ndarray,
    draws: np.ndarray,
    votes: np.ndarray,
    level: float = 0.9,
) -> Confidence:
    """Confidence of the samples of shape i from draws (T, n, n) of C_ij and votes.

    Parameters
    ----------
    first, second
        Shapes i and j.
    image
        (S_i,) sample of j that the synchronised map gives.
    draws
        (T, n, n) posterior draws of C_ij.
    votes
        (W, S_i) samples of j according to the observed map and to compositions of two observed maps.
    level
        Probability that the region holds.
    """
    n = draws.shape[-1]
    with single_threaded_blas():
        moved = (first.sampled()[:, :n] @ draws).reshape(-1, n)
        hits = _nearest(moved, second.sampled()[:, :n]).reshape(len(draws), -1)  # (T, S_i)
    g = second.geodesics
    near = (g <= _NEAR).astype(float)
    counts = np.zeros((len(image), len(g)))  # (S_i, S_j)
    np.add.at(counts, (np.arange(len(image)), hits), 1)
    share = counts / len(draws)
    entropy = -(share * np.log(np.where(share > 0, share, 1))).sum(axis=1)
    return Confidence(
        (share @ near).argmax(axis=1),
        image,
        np.quantile(g[hits, image], level, axis=0),
        g[votes, image].mean(axis=0),
        entropy,
        two_modes(votes, g),
        level,
    )


def two_modes(votes: np.ndarray, geodesics: np.ndarray) -> np.ndarray:
    """Whether votes (W, S) for samples of a shape with ``geodesics`` (K, K) fall into two distant places, (S,)."""
    apart = geodesics[votes[:, None], votes[None]]  # (W, W, S)
    support = (apart <= 2 * _NEAR).mean(axis=1)  # (W, S) share of votes about each vote
    best = support.argmax(axis=0)
    columns = np.arange(votes.shape[1])
    elsewhere = apart[best, :, columns].T > _FAR  # (W, S)
    second = np.where(elsewhere, support, 0).max(axis=0)
    return (second >= _SHARE) & (support[best, columns] >= _SHARE)


@dataclass(frozen=True)
class Recalibration:
    """Radii that hold what they promise on shapes with a known truth: ``scale * (score + 0.02)``.

    ``score`` is the sum of the posterior radius and the spread of other maps: the first knows the noise, the second the
    error of the model.
    """

    scale: float
    level: float

    def radius(self, known: Confidence) -> np.ndarray:
        """Recalibrated radii (S,)."""
        return self.scale * _score(known)


def fit_recalibration(known: list[Confidence], errors: list[np.ndarray]) -> Recalibration:
    """The smallest scale that covers ``level`` of the errors (S,), the conformal quantile (Lei et al. 2018).

    Judge it on another collection than it was fitted on.
    """
    ratios = np.concatenate([e / _score(k) for k, e in zip(known, errors)])
    level = known[0].level
    return Recalibration(float(np.quantile(ratios, min(1.0, level * (1 + 1 / len(ratios))))), level)


def spread_out(first: SampledShape, values: np.ndarray) -> np.ndarray:
    """Values (S,) at samples carried to all vertices (V,) by the three nearest samples."""
    points = first.shape.vertices
    distance, nearest = cKDTree(points[first.samples]).query(points, k=min(3, len(first.samples)))
    weights = 1 / np.maximum(distance, 1e-9)
    return (weights * values[nearest]).sum(axis=1) / weights.sum(axis=1)


def _score(known: Confidence) -> np.ndarray:
    return known.radius + known.spread + _RESOLUTION
