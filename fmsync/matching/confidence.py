"""Where a vertex goes and how sure that is: images under posterior draws, and under the maps of other shapes."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from fmsync.descriptors import heat_kernel_signature
from fmsync.functional_maps import row_images
from fmsync.matching.samples import SampledShape

_NEAR = 0.05  # square roots of the area: images this near to each other count as one place
_FAR = 0.12  # two places this far apart are two modes
_SHARE = 0.2  # and both hold this share of the votes
_NEIGHBOURS, _AROUND = 0.1, 0.15  # square roots of the area: how far local distortion looks, and is averaged over
_ALIKE = 0.05  # largest difference of the logarithms of heat kernel signatures of places that look the same


@dataclass(frozen=True, eq=False)
class Confidence:
    """What is known of the images on shape j of the S samples of shape i; lengths in square roots of the area.

    Nothing here has seen a truth. All are (S,) but ``level``, that of the region, in (0, 1):

    * ``image``, the sample of j under the synchronised map: the centre of the region.
    * ``radius``, the geodesic radius about it that holds ``level`` of the draws; ``entropy`` of their images, in nats.
    * ``spread``, the mean geodesic distance from ``image`` to where maps through other shapes send the sample.
    * ``two_modes``, whether the answer is not one place: two distant ones both hold a fifth of the votes of the maps
      through other shapes, or the surface has a continuous symmetry that moves the image far.
    * ``symmetry_radius`` that holds ``level`` of the places which symmetry makes as good as ``image``; 0 without any.
    * ``local_distortion``, the relative change of the distances to the samples nearby, averaged over the neighbourhood:
      where the map tears, folds or slides; a pure number, which hardly depends on how many samples there are.
    * ``distortion``, the mean change of the geodesic distances to all other samples: of wrong maps, or of shapes that
      are not isometric. Like the local one it indicates errors that all maps share.
    * ``fullness``, the area nearby relative to that of a plane: below 1 in thin parts, such as a tail.
    """

    image: np.ndarray
    radius: np.ndarray
    spread: np.ndarray
    entropy: np.ndarray
    two_modes: np.ndarray
    symmetry_radius: np.ndarray
    level: float
    local_distortion: np.ndarray
    distortion: np.ndarray
    fullness: np.ndarray

    def uncertainty_score(self) -> np.ndarray:
        r"""(S,) larger where errors are likely: :math:`\sqrt{c\sqrt{d}}` of local distortions c.

        These rank the vertices of a pair; its mean distortion d makes pairs and collections comparable. Errors grow
        more slowly than distortions, hence the root.
        """
        return np.sqrt(self.local_distortion * np.sqrt(self.distortion.mean()))

    def region_score(self) -> np.ndarray:
        """(S,) what radii of regions are multiples of: uncertainty score over fullness.

        In thin parts errors are on average what the uncertainty score says, but the largest are larger: along the part.
        """
        return self.uncertainty_score() / self.fullness


def confidence(
    first: SampledShape,
    second: SampledShape,
    image: np.ndarray,
    vertex: np.ndarray,
    draws: np.ndarray,
    votes: np.ndarray,
    level: float,
) -> Confidence:
    """Confidence of the samples of shape i = ``first`` on shape j = ``second``.

    The synchronised map sends the samples of i to samples ``image`` (S_i,) and vertices ``vertex`` (S_i,) of j;
    ``draws`` (T, n, n) are of C_ij; ``votes`` (W, S_i) samples of j by the observed map and compositions of two.
    """
    g, hits = second.geodesics, draw_images(first, second, draws)
    counts = np.zeros((len(image), len(g)))  # (S_i, S_j)
    np.add.at(counts, (np.arange(len(image)), hits), 1)
    share = counts / len(draws)
    double, reach = two_modes(votes, g)
    symmetric = np.where(double, np.where(reach, g[votes, image], 0).max(axis=0), 0.0)
    if has_continuous_symmetry(second):
        signature = np.log(heat_kernel_signature(second.basis, 12)[second.samples])  # (S, 12)
        alike = np.abs(signature[:, None] - signature).max(axis=2) <= _ALIKE  # what looks the same to heat
        radii = np.array([np.quantile(away[same], level) for away, same in zip(g, alike)])
        symmetric = np.maximum(symmetric, radii[image])
    return Confidence(
        image=image,
        radius=np.maximum(np.quantile(g[hits, image], level, axis=0), symmetric),
        spread=g[votes, image].mean(axis=0),
        entropy=-(share * np.log(np.where(share > 0, share, 1))).sum(axis=1),
        two_modes=double | (symmetric > _FAR),
        symmetry_radius=symmetric,
        level=level,
        local_distortion=local_distortion(first, second.shape.vertices[vertex]),
        distortion=np.abs(first.geodesics - g[np.ix_(image, image)]).mean(axis=1),
        fullness=_near(first) @ sample_areas(first) / (np.pi * _NEIGHBOURS**2),
    )


def draw_images(first: SampledShape, second: SampledShape, draws: np.ndarray, count: int | None = None) -> np.ndarray:
    """(T, S) samples of j where draws (T, n, n) of C_ij send the first ``count`` samples of i, or all."""
    n = draws.shape[-1]
    return row_images(first.sampled(count)[:, :n], draws, second.sampled()[:, :n])


def two_modes(votes: np.ndarray, geodesics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether votes (W, S) for samples of a shape with ``geodesics`` (K, K) fall into two distant places, (S,).

    Also which votes are for a place that holds a fifth of them, (W, S).
    """
    apart = geodesics[votes[:, None], votes[None]]  # (W, W, S)
    support = (apart <= 2 * _NEAR).mean(axis=1)  # (W, S) share of votes about each vote
    best = support.argmax(axis=0)
    columns = np.arange(votes.shape[1])
    elsewhere = apart[best, :, columns].T > _FAR  # (W, S)
    second = np.where(elsewhere, support, 0).max(axis=0)
    return (second >= _SHARE) & (support[best, columns] >= _SHARE), support >= _SHARE


def has_continuous_symmetry(shape: SampledShape) -> bool:
    """Whether the surface turns into itself, with no landmarks to stop it."""
    return shape.n_landmarks < 2 and shape.basis.has_continuous_symmetry


def samples_to_vertices(first: SampledShape, values: np.ndarray) -> np.ndarray:
    """Values (S, ...) at samples carried to all vertices (V, ...) by the three nearest samples."""
    points = first.shape.vertices
    distance, nearest = cKDTree(points[first.samples]).query(points, k=min(3, len(first.samples)))
    weights = 1 / np.maximum(distance, 1e-9)
    return np.einsum("vk,vk...->v...", weights / weights.sum(axis=1, keepdims=True), values[nearest])


def local_distortion(first: SampledShape, images: np.ndarray) -> np.ndarray:
    """Relative change of the distances of samples to those nearby, given their images (S, 3); smoothed.

    Straight-line distances between vertices: images among samples would be too coarse. What is near is said in square
    roots of the area, by Gaussian weights: the nearest few samples would lie the closer the more samples there are.
    """
    points, g = first.shape.vertices[first.samples], first.geodesics
    before, after, near = cdist(points, points), cdist(images, images), _near(first)
    change = (near * np.abs(after - before)).sum(axis=1) / np.maximum((near * before).sum(axis=1), 1e-12)
    weights = np.exp(-((g / _AROUND) ** 2))
    return weights @ change / weights.sum(axis=1)


def sample_areas(shape: SampledShape) -> np.ndarray:
    """Areas (S,) of the vertices to which a sample is the nearest one: a fine part of a mesh has more samples."""
    points = shape.shape.vertices
    nearest = cKDTree(points[shape.samples]).query(points)[1]
    return np.bincount(nearest, shape.basis.mass, minlength=len(shape.samples))


def _near(shape: SampledShape) -> np.ndarray:
    """Gaussian weights (S, S) of samples by their distances."""
    return np.exp(-((shape.geodesics / _NEIGHBOURS) ** 2))
