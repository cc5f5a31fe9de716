"""Where a vertex goes and how sure that is: images under posterior draws, and under the evidence of other shapes."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from fmsync._threads import single_threaded_blas
from fmsync.functional_map import _nearest
from fmsync.pipeline.samples import SampledShape

_NEAR = 0.05  # square roots of the area: images this near to each other count as one place
_FAR = 0.12  # two places this far apart are two modes
_SHARE = 0.2  # and both hold this share of the votes
_BLOCKS = (20, 30, 50, 80)  # sizes of the leading blocks by which an image is checked
_BLURRED = 50  # functions by which places are told apart: more of them follow the noise


@dataclass(frozen=True, eq=False)
class Confidence:
    """What is known of the images on shape j of the samples of shape i; lengths in square roots of the area.

    Nothing here has seen a truth. Scatter, blur, drift and distortion are signs of errors of different kinds, and
    :meth:`evidence` is what they say together.

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
    scatter
        (S,) mean geodesic distance of the draws' images from ``image``: noise of the maps.
    blur
        (S,) mean geodesic distance from ``image`` of the samples, weighted by how alike their eigenfunctions are to
        those of the moved sample: what a basis of this size does not resolve.
    drift
        (S,) mean geodesic distance from ``image`` to the images under smaller leading blocks of the map.
    distortion
        (S,) mean change of the geodesic distances to all other samples: wrong maps, shapes that are not isometric.
    residual
        (S,) distance of the moved sample's eigenfunctions from those of the nearest vertex, over the square root of
        their number; a pure number.
    """

    mode: np.ndarray
    image: np.ndarray
    radius: np.ndarray
    spread: np.ndarray
    entropy: np.ndarray
    two_modes: np.ndarray
    level: float
    scatter: np.ndarray
    blur: np.ndarray
    drift: np.ndarray
    distortion: np.ndarray
    residual: np.ndarray

    LENGTHS: ClassVar[tuple[str, ...]] = ("scatter", "blur", "drift", "distortion")

    def evidence(self) -> np.ndarray:
        """(S,) larger where errors are likely: the plain sum of ``LENGTHS``, times the square root of the residual.

        Weights fitted on one collection were no better on another than none.
        """
        return sum(getattr(self, name) for name in self.LENGTHS) * np.sqrt(self.residual)


def confidence(
    first: SampledShape,
    second: SampledShape,
    c_ij: np.ndarray,
    draws: np.ndarray,
    votes: np.ndarray,
    level: float = 0.9,
) -> Confidence:
    """Confidence of the samples of shape i from draws (T, n, n) of C_ij and votes.

    Parameters
    ----------
    first, second
        Shapes i and j.
    c_ij
        (m, m) synchronised map.
    draws
        (T, n, n) posterior draws of C_ij.
    votes
        (W, S_i) samples of j according to the observed map and to compositions of two observed maps.
    level
        Probability that the region holds.
    """
    n, m = draws.shape[-1], len(c_ij)
    at_i, at_j, g = first.sampled()[:, :m], second.sampled()[:, :m], second.geodesics
    with single_threaded_blas():
        hits = _nearest((at_i[:, :n] @ draws).reshape(-1, n), at_j[:, :n]).reshape(len(draws), -1)  # (T, S_i)
        smaller = [_nearest(at_i[:, :k] @ c_ij[:k, :k], at_j[:, :k]) for k in _BLOCKS if k < m]
        moved, everywhere = at_i @ c_ij, second.basis.eigenfunctions[:, :m]
        image = _nearest(moved, at_j)
        residual = np.linalg.norm(moved - everywhere[_nearest(moved, everywhere)], axis=1) / np.sqrt(m)
        k = min(_BLURRED, m)
        blur = _blur(at_i[:, :k] @ c_ij[:k, :k], at_j[:, :k], g[image])
    counts = np.zeros((len(image), len(g)))  # (S_i, S_j)
    np.add.at(counts, (np.arange(len(image)), hits), 1)
    share = counts / len(draws)
    away = g[hits, image]  # (T, S_i)
    return Confidence(
        mode=(share @ (g <= _NEAR)).argmax(axis=1),
        image=image,
        radius=np.quantile(away, level, axis=0),
        spread=g[votes, image].mean(axis=0),
        entropy=-(share * np.log(np.where(share > 0, share, 1))).sum(axis=1),
        two_modes=two_modes(votes, g),
        level=level,
        scatter=away.mean(axis=0),
        blur=blur,
        drift=np.mean([g[k, image] for k in smaller], axis=0) if smaller else np.zeros(len(image)),
        distortion=np.abs(first.geodesics - g[np.ix_(image, image)]).mean(axis=1),
        residual=residual,
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


def spread_out(first: SampledShape, values: np.ndarray) -> np.ndarray:
    """Values (S,) at samples carried to all vertices (V,) by the three nearest samples."""
    points = first.shape.vertices
    distance, nearest = cKDTree(points[first.samples]).query(points, k=min(3, len(first.samples)))
    weights = 1 / np.maximum(distance, 1e-9)
    return (weights * values[nearest]).sum(axis=1) / weights.sum(axis=1)


def _blur(moved: np.ndarray, targets: np.ndarray, away: np.ndarray) -> np.ndarray:
    """Mean of ``away`` (S_i, S_j), the distances from the image, weighted by how alike rows are to the moved ones.

    Likeness is Gaussian in the embedding, with the median squared distance of the nearest targets as its width.
    """
    squared = (moved**2).sum(axis=1)[:, None] + (targets**2).sum(axis=1) - 2 * moved @ targets.T  # (S_i, S_j)
    least = np.maximum(squared.min(axis=1), 0)
    likeness = np.exp(-(squared - least[:, None]) / max(float(np.median(least)), 1e-12))
    return (likeness * away).sum(axis=1) / likeness.sum(axis=1)
