r"""As-rigid-as-possible matching: where the samples of one mesh lie on another if small neighbourhoods move rigidly.

Maps between basis functions see distances along the surface alone. A pose that changes them moves the functions, and a
map that is fitted to its own point map stays where it is. Here the samples move to their images as rigidly as possible
(Sorkine and Alexa 2007), and then, as in the iterative closest point method, to the nearest vertices of the other mesh
that face the same way.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial import cKDTree

from fmsync import so
from fmsync.functional_maps import nearest_rows_unchecked as nearest_rows
from fmsync.matching.samples import SampledShape

_NEIGHBOURS = 8  # of every sample
_POSITIONS = 1000.0  # weight of positions against rigidity
_NORMALS = 0.2  # what a unit of difference between normals counts, in √area
_FIRST, _CLOSEST = 5, 5  # steps towards the images, and towards the closest vertices
_NEWTON = 8  # steps of a polar factor: from a matrix of size 3 with a condition number of a million to the last bits


@dataclass(frozen=True, eq=False)
class RigidSamples:
    """Samples of a mesh that move with their neighbours.

    ``samples`` (S,) are vertices, ``points`` (S, 3) their places about the mean; ``links`` (S, S) is 1 for neighbours;
    ``factor`` solves for the positions that keep turned edges and images best; ``vertices`` and ``normals`` (V, 3) are
    where images can be, and in the ``tree``.
    """

    samples: np.ndarray
    points: np.ndarray
    links: sp.csr_array
    factor: SuperLU
    vertices: np.ndarray
    normals: np.ndarray
    tree: cKDTree

    def rotations(self, moved: np.ndarray) -> np.ndarray:
        """(S, 3, 3) rotations that fit the neighbourhoods of the ``moved`` positions (S, 3) best."""
        points, links, moved = self.points, self.links, moved - moved.mean(axis=0)
        outer, size = moved[:, :, None] * points[:, None, :], len(points)
        # sum over neighbours j of (moved_i - moved_j)(points_i - points_j)^T
        sums = links.sum(axis=1)[:, None, None] * outer + (links @ outer.reshape(size, 9)).reshape(size, 3, 3)
        sums -= moved[:, :, None] * (links @ points)[:, None, :] + (links @ moved)[:, :, None] * points[:, None, :]
        return _polar_factors(sums)

    def moved(self, rotations: np.ndarray, images: np.ndarray) -> np.ndarray:
        """(S, 3) positions that keep the edges turned by ``rotations``, and the ``images`` (S, 3), best."""
        points, links, size = self.points[:, :, None], self.links, len(images)
        turned = (rotations @ points)[..., 0]
        around = (links @ rotations.reshape(size, 9)).reshape(size, 3, 3)
        # sum over neighbours j of (R_i + R_j)(points_i - points_j)
        edges = links.sum(axis=1)[:, None] * turned - (rotations @ (links @ self.points)[:, :, None])[..., 0]
        edges += (around @ points)[..., 0] - links @ turned
        return self.factor.solve(edges / 2 + _POSITIONS / size * images)

    def closest(self, moved: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(S,) vertices nearest to positions and normals (S, 3)."""
        return self.tree.query(np.hstack([moved, _NORMALS * normals]))[1]


def rigid_samples(shape: SampledShape, count: int | None = None) -> RigidSamples:
    """The first ``count`` samples of a mesh, or all, each linked with those nearest along the surface.

    >>> import data_gen
    >>> from fmsync.matching.samples import sample_shape
    >>> (cat,) = data_gen.load_collection("cats", count=1, n_vertices=1000)
    >>> body = rigid_samples(sample_shape(cat, 20, 100))
    >>> body.points.shape, int(body.links.sum(axis=1).min())
    ((100, 3), 8)
    """
    own, vertices, normals = shape.samples[:count], shape.shape.vertices, shape.normals
    assert normals is not None, "a point cloud has no normals"
    size = len(own)
    neighbours = min(_NEIGHBOURS, size - 1)
    near = np.argpartition(shape.geodesics[:size, :size], neighbours, axis=1)[:, : neighbours + 1]
    near = sp.csr_array((np.ones(near.size), near.ravel(), np.arange(size + 1) * (neighbours + 1)), shape=(size, size))
    links = ((near + near.T) > 0).astype(float)
    links.setdiag(0)
    links.eliminate_zeros()
    stiffness = sp.diags_array(links.sum(axis=1) + _POSITIONS / size) - links
    tree, points = cKDTree(np.hstack([vertices, _NORMALS * normals])), vertices[own] - vertices[own].mean(axis=0)
    return RigidSamples(own, points, links, splu(stiffness.tocsc()), vertices, normals, tree)


def rigid_images(first: RigidSamples, second: RigidSamples, images: np.ndarray, mirrored: bool = False) -> np.ndarray:
    r"""Vertices (S,) of the second mesh for the samples of the first, from vertices ``images`` (S,) that are near them.

    Minimises over positions y and rotations R in turn, for the given images t,
    :math:`\frac12\sum_{i,j}\lVert(y_i-y_j)-R_i(x_i-x_j)\rVert^2+\frac wS\sum_i\lVert y_i-t_i\rVert^2`, the first sum
    over neighbours i and j in both orders; then goes on with the vertices nearest in position and normal for t. With
    ``mirrored`` reflections take the place of rotations if the images turn normals inwards on average.

    >>> import data_gen
    >>> from fmsync.matching.samples import sample_shape
    >>> cats = data_gen.load_collection("cats", count=2, n_vertices=1000)  # with the same vertices
    >>> a, b = (rigid_samples(sample_shape(cat, 20, 300)) for cat in cats)
    >>> found = rigid_images(a, b, a.samples)
    >>> bool(np.linalg.norm(b.vertices[found] - b.vertices[a.samples], axis=1).mean() < 0.03)
    True
    """
    normals = first.normals[first.samples][:, :, None]
    moved = target = second.vertices[images]
    rotations = first.rotations(target)
    if mirrored and ((rotations @ normals)[..., 0] * second.normals[images]).sum() < 0:
        first, normals = replace(first, points=-first.points), -normals
        rotations = first.rotations(target)
    for step in range(_FIRST + _CLOSEST):
        if step >= _FIRST:
            target = second.vertices[second.closest(moved, (rotations @ normals)[..., 0])]
        moved = first.moved(rotations, target)
        rotations = first.rotations(moved)
    return second.closest(moved, (rotations @ normals)[..., 0])


def rigid_map(
    bodies: tuple[RigidSamples, RigidSamples],
    back: np.ndarray,
    second: SampledShape,
    values: Sequence[np.ndarray],
    mirrored: bool = False,
) -> np.ndarray:
    """C_ij (m, m) of the samples of i, matched by values of shared functions and moved as rigidly as possible.

    ``back`` (m, S) is the pseudo-inverse of the basis at the samples of i, ``second`` is shape j, and ``values`` are
    those at the samples of i (S, M) and of j.
    """
    near = bodies[1].samples[nearest_rows(*(x.astype(np.float32) for x in values))]
    return back @ second.basis.eigenfunctions[rigid_images(*bodies, near, mirrored), : len(back)]


def _polar_factors(a: np.ndarray) -> np.ndarray:
    """As :func:`fmsync.so.project` of (S, 3, 3), by Newton steps with cofactors (Higham 1986): in half of the time."""
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
