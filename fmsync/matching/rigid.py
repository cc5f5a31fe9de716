r"""Where the samples of a mesh lie on another one, if every small neighbourhood moves as a rigid body.

Maps between basis functions see distances along the surface alone. A pose that stretches them moves the functions, and
a map that is fitted to its own point map stays where it is. Bones know more: they keep flesh rigid, whatever the skin
does at the joints. So the samples are moved to their images as rigidly as possible (Sorkine and Alexa 2007), then to
the nearest points of the other surface that face the same way, again and again.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial import cKDTree

from fmsync import so
from fmsync.matching.samples import SampledShape
from fmsync.shape import vertex_normals

_NEIGHBOURS = 8  # of every sample, with which it moves
_HOLD = 1000.0  # of the images against rigidity
_FACING = 0.2  # what a unit vector between normals counts as a distance, in √area
_SETTLE, _APPROACH = 5, 5  # steps towards the images, and towards the nearest points
_NEWTON = 8  # steps of the polar factor of a matrix of size 3


@dataclass(frozen=True, eq=False)
class RigidSamples:
    """Samples of a mesh that move with their neighbours.

    ``points`` and ``normals`` (S, 3) of the ``samples`` (S,); ``links`` (S, S) is 1 for neighbours; ``factor`` solves
    for the points that keep given rotations and images best; ``vertices`` (V, 3) of the mesh, and their ``tree`` with
    the normals.
    """

    samples: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    links: sp.csr_array
    factor: SuperLU
    vertices: np.ndarray
    tree: cKDTree

    def rotations(self, moved: np.ndarray) -> np.ndarray:
        """(S, 3, 3) rotations that fit every neighbourhood of the ``moved`` points (S, 3) best."""
        points, links, size = self.points, self.links, len(moved)
        outer = moved[:, :, None] * points[:, None, :]
        # sum over neighbours j of (moved_i - moved_j)(points_i - points_j)^T
        sums = links.sum(axis=1)[:, None, None] * outer + (links @ outer.reshape(size, 9)).reshape(size, 3, 3)
        sums -= moved[:, :, None] * (links @ points)[:, None, :] + (links @ moved)[:, :, None] * points[:, None, :]
        return _polar_factors(sums)

    def moved(self, rotations: np.ndarray, images: np.ndarray) -> np.ndarray:
        """(S, 3) points nearest to ``images`` (S, 3) whose edges are those of the mesh turned by ``rotations``."""
        points, links, size = self.points[:, :, None], self.links, len(images)
        turned = (rotations @ points)[..., 0]
        around = (links @ rotations.reshape(size, 9)).reshape(size, 3, 3)
        # sum over neighbours j of (R_i + R_j)(points_i - points_j) / 2
        edges = links.sum(axis=1)[:, None] * turned - (rotations @ (links @ self.points)[:, :, None])[..., 0]
        edges += (around @ points)[..., 0] - links @ turned
        return self.factor.solve(edges / 2 + _HOLD / size * images)


def rigid_samples(shape: SampledShape) -> RigidSamples:
    """The samples of a mesh, each with those nearest along the surface."""
    size, own = len(shape.samples), shape.samples
    count = min(_NEIGHBOURS, size - 1)
    near = np.argpartition(shape.geodesics, count, axis=1)[:, : count + 1]
    near = sp.csr_array((np.ones(near.size), near.ravel(), np.arange(size + 1) * (count + 1)), shape=(size, size))
    links = ((near + near.T) > 0).astype(float)
    links.setdiag(0)
    links.eliminate_zeros()
    stiffness = sp.diags_array(links.sum(axis=1) + _HOLD / size) - links
    vertices, faces = shape.shape.vertices, shape.shape.faces
    assert faces is not None, "points of a cloud face no way"
    normals = vertex_normals(vertices, faces)
    tree = cKDTree(np.hstack([vertices, _FACING * normals]))
    return RigidSamples(own, vertices[own], normals[own], links, splu(stiffness.tocsc()), vertices, tree)


def rigid_images(first: RigidSamples, second: RigidSamples, images: np.ndarray) -> np.ndarray:
    r"""Vertices (S,) of the second mesh for the samples of the first, from vertices ``images`` (S,) that are near them.

    Minimises :math:`\frac12\sum_{i\sim j}\lVert(y_i-y_j)-R_i(x_i-x_j)\rVert^2+\frac hS\sum_i\lVert y_i-t_i\rVert^2`
    over points y and rotations R in turn, for the given images t, then for the nearest vertices.
    """
    moved = target = second.vertices[images]
    rotations = first.rotations(target)
    for step in range(_SETTLE + _APPROACH):
        if step >= _SETTLE:
            target = second.vertices[_nearest(first, second, moved, rotations)]
        moved = first.moved(rotations, target)
        rotations = first.rotations(moved)
    return _nearest(first, second, moved, rotations)


def _nearest(first: RigidSamples, second: RigidSamples, moved: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    normals = (rotations @ first.normals[:, :, None])[..., 0]
    return second.tree.query(np.hstack([moved, _FACING * normals]))[1]


def _polar_factors(a: np.ndarray) -> np.ndarray:
    """Nearest rotations (S, 3, 3), as :func:`fmsync.so.project`, by Newton steps (Higham 1986) with cofactors."""
    x = np.ascontiguousarray(np.moveaxis(a, 0, -1))  # (3, 3, S)
    x = x / np.maximum(np.linalg.norm(x, axis=(0, 1)), 1e-300)
    cofactors, determinants = _cofactors(x)
    poor = determinants < 1e-6  # flat, or turned inside out
    for _ in range(_NEWTON):
        inverse = cofactors / np.where(poor, 1.0, determinants)  # transposed
        scale = np.sqrt(np.linalg.norm(inverse, axis=(0, 1)) / np.maximum(np.linalg.norm(x, axis=(0, 1)), 1e-300))
        x = np.where(poor, 0.0, (scale * x + inverse / np.maximum(scale, 1e-300)) / 2)
        cofactors, determinants = _cofactors(x)
    found = np.moveaxis(x, -1, 0).copy()
    found[poor] = so.project_unchecked(a[poor])
    return found


def _cofactors(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cofactors (3, 3, S) and determinants (S,) of matrices (3, 3, S)."""
    second, third = np.roll(x, -1, axis=1), np.roll(x, -2, axis=1)
    found = np.stack([second[r - 2] * third[r - 1] - third[r - 2] * second[r - 1] for r in range(3)])
    return found, (x[0] * found[0]).sum(axis=0)
