r"""A functional map of two shapes from nothing but the shapes.

Pairings of extremities (the ends of limbs, tail and head), signs of the first eigenfunctions, turns of neighbours that
a pose may mix, and a fit of descriptors give many rough maps; spectral upsampling (ZoomOut, Melzi et al. 2019) makes
each of them precise or exposes it; samples of the best then move as rigidly as possible, if both shapes are meshes; and
the one that keeps geodesic distances and orientation is the answer. Trying many signs is the idea of MapTree (Ren et
al. 2020).
"""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmsync import checks
from fmsync.functional_maps import functional_map_from_descriptors, row_images
from fmsync.matching.extremities import extremity_maps
from fmsync.matching.rigid import RigidSamples, rigid_map, rigid_samples
from fmsync.matching.samples import SampledShape
from fmsync.shape import Basis
from fmsync.threads import single_threaded_blas

_SIGNS = 6  # first eigenfunctions; all but the constant one are tried with both signs: 32 maps
_MIXED = 0.25  # neighbours whose log-eigenvalues are nearer may be turned: a pose moves each by up to a third of that
_SAMPLES = 80, 150, 300  # by which candidates are compared at the first, second and third choice,
_SIZES = 9, 20, 50  # and the sizes to which they are upsampled before
FINE = _SIZES[-1]
_SURVIVORS = 128, 12  # of the first and the second choice,
_MOVED = 2, 1  # and those whose samples then move rigidly, and of what comes of it again
_EXACT = 1e-12  # distortions below are none
_ORIENTED = 0.05  # what full agreement in orientation is worth, in units of geodesic distortion


@dataclass(frozen=True, eq=False)
class PairMatch:
    """A functional map ``c_ij`` (m, m) of a pair, and how good it looks without the truth.

    ``distortion`` is the mean absolute change of geodesic distances between samples, in square roots of the area;
    ``orientation`` the correlation in [-1, 1] with a map that keeps it, 0 for point clouds; ``mirrored_distortion``
    that of the best candidate that turns left into right, infinite where there was none; ``missed`` the mean distance
    of landmarks from their images.
    """

    c_ij: np.ndarray
    distortion: float
    orientation: float
    mirrored_distortion: float = np.inf
    missed: float = 0.0

    @property
    def cost(self) -> float:
        """What candidates are chosen by: smaller is better."""
        return float(_costs(self.distortion, self.orientation, self.missed))


@checks.checked()
def match(first: SampledShape, second: SampledShape) -> PairMatch:
    """The best of many candidates for the map C_ij from shape j = ``second`` to shape i = ``first``.

    Only what is at samples counts: ``light()`` shapes give the same map.
    """
    first, second = first.light(FINE), second.light(FINE)
    few, rough, fine = (min(size, first.basis.n, second.basis.n) for size in _SIZES)

    def survivors(count: int, maps: np.ndarray, images: np.ndarray) -> np.ndarray:
        return maps[np.argsort(_costs(*map_scores(first, second, maps, images)), kind="stable")[:count]]

    with single_threaded_blas():
        starts = _turned_signs(first.basis, second.basis, min(_SIGNS, few))
        starts = survivors(_SURVIVORS[0], *zoomout(first, second, starts, few, 2, _SAMPLES[0]))
        # the fit sees coefficients only, so an identity stands for the eigenfunctions
        a, b = (Basis(s.basis.eigenvalues[:rough], np.eye(rough), np.ones(rough)) for s in (first, second))
        there, here = first.coefficients[:rough], second.coefficients[:rough]
        fit = functional_map_from_descriptors(a, b, there, here, commutativity=1e-2)[None]
        paired = extremity_maps(first, second, rough, _SAMPLES[0])  # of fewer functions they find less
        tried = [zoomout(first, second, maps, rough, 2, _SAMPLES[1]) for maps in (starts, fit, paired)]
        maps = survivors(_SURVIVORS[1], *(np.concatenate(part) for part in zip(*tried)))
        maps, images = zoomout(first, second, maps, fine, 6, _SAMPLES[2])
        scores = np.array(map_scores(first, second, maps, images))  # (3, R)
        unmoved, mirrored = scores[0, np.argmin(_costs(*scores))], scores[0, scores[1] < 0].min(initial=np.inf)
        if first.normals is not None and second.normals is not None:
            bodies = rigid_samples(first, _SAMPLES[2]), rigid_samples(second, _SAMPLES[2])
            best, of_best = maps, scores
            for count in _MOVED:
                best = moved(first, second, bodies, best[np.argsort(_costs(*of_best), kind="stable")[:count]])
                images = zoomout(first, second, best, fine, 6, _SAMPLES[2])[1]  # the maps have that size
                of_best = np.array(map_scores(first, second, best, images))
                maps, scores = np.concatenate([maps, best]), np.hstack([scores, of_best])
    distortion, orientation, missed = scores
    k = int(np.argmin(_costs(*scores)))
    mirrored *= max(distortion[k], _EXACT) / max(unmoved, _EXACT)  # had its samples moved as well
    return PairMatch(maps[k], float(distortion[k]), float(orientation[k]), float(mirrored), float(missed[k]))


def moved(
    first: SampledShape, second: SampledShape, bodies: tuple[RigidSamples, RigidSamples], maps: np.ndarray
) -> np.ndarray:
    """Maps (2R, m, m) from maps (R, m, m), by samples that move as rigidly as possible from i to j, and from j to i."""
    shapes, m = (first, second), maps.shape[-1]
    at_i, at_j = (s.sampled(len(body.samples))[:, :m] for s, body in zip(shapes, bodies))
    back_i, back_j = np.linalg.pinv(at_i), np.linalg.pinv(at_j)
    there = [rigid_map(bodies, back_i, second, (at_i @ c, at_j)) for c in maps]
    return np.array(there + [rigid_map(bodies[::-1], back_j, first, (at_j @ c.T, at_i)).T for c in maps])


def improve(first: SampledShape, second: SampledShape, proposed: np.ndarray, size: int = FINE) -> PairMatch:
    """The best of proposed maps (R, k, k), upsampled to at most ``size`` and scored like those of :func:`match`."""
    with single_threaded_blas():
        maps, images = zoomout(first, second, proposed, min(size, first.basis.n, second.basis.n), 6, _SAMPLES[2])
        distortion, orientation, missed = map_scores(first, second, maps, images)
    k = int(np.argmin(_costs(distortion, orientation, missed)))
    return PairMatch(maps[k], float(distortion[k]), float(orientation[k]), missed=float(missed[k]))


def zoomout(
    first: SampledShape, second: SampledShape, maps: np.ndarray, size: int, step: int, n_samples: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Upsample maps (R, k, k) to (R, size, size) on samples; also the sample of j for each sample of i, (R, S).

    Alternates the point map of a map and the least-squares map, ``step`` functions larger, of that point map.
    """
    at_i, at_j = first.sampled(n_samples), second.sampled(n_samples)
    while True:
        k = maps.shape[-1]
        images = row_images(at_i[:, :k], maps, at_j[:, :k])  # (R, S)
        if k >= size:
            return maps, images
        k = min(k + step, size)
        maps = np.linalg.pinv(at_i[:, :k]) @ at_j[images][..., :k]


def map_scores(
    first: SampledShape, second: SampledShape, maps: np.ndarray, images: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Geodesic distortion, orientation and distance of landmarks from their images, each (R,), of (R, k, k) maps."""
    distortion = np.array([geodesic_distortion(first, second, p) for p in images])
    marks = np.arange(min(first.n_landmarks, images.shape[1]))
    missed = second.geodesics[images[:, marks], marks].mean(axis=1) if len(marks) else np.zeros(len(maps))
    if first.orientation is None or second.orientation is None:
        return distortion, np.zeros(len(maps)), missed
    n = min(maps.shape[-1], first.orientation.shape[-1])
    u, _, vt = np.linalg.svd(maps[:, None, :n, :n])
    rotations = u @ vt  # (R, 1, n, n)
    left, right = first.orientation[:, :n, :n] @ rotations, rotations @ second.orientation[:, :n, :n]
    scale = np.sqrt((left**2).sum((1, 2, 3)) * (right**2).sum((1, 2, 3)))
    return distortion, (left * right).sum((1, 2, 3)) / np.maximum(scale, 1e-300), missed


def geodesic_distortion(first: SampledShape, second: SampledShape, images: np.ndarray) -> float:
    """Mean absolute change of distances between samples whose ``images`` (S,) are samples of ``second``."""
    size = len(images)
    return float(np.abs(first.geodesics[:size, :size] - second.geodesics[np.ix_(images, images)]).mean())


def _costs(distortion: Any, orientation: Any, missed: Any) -> Any:
    return distortion - _ORIENTED * orientation + missed


def _turned_signs(first: Basis, second: Basis, k: int) -> np.ndarray:
    """Candidates (R, k, k): all signs, as they are and with eighths of a turn of two neighbours that may be mixed."""
    logs = np.log([basis.eigenvalues[1:k] for basis in (first, second)]).mean(axis=0)
    turns = [np.eye(k)]
    for a in 1 + np.flatnonzero(np.diff(logs) < _MIXED):
        for angle in np.pi / 4 * np.array([1, 2, 3]):  # with the signs all sixteen eighths, turned and reflected
            turn = np.eye(k)
            turn[a : a + 2, a : a + 2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            turns.append(turn)
    signs = np.array([[1, *s] for s in itertools.product([1.0, -1.0], repeat=k - 1)])
    return (np.array(turns)[:, None] * signs[:, None]).reshape(-1, k, k)
