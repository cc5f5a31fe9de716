r"""As-rigid-as-possible matching: where the samples of one mesh lie on another if small neighbourhoods move rigidly.

Maps between basis functions see distances along the surface alone. A pose that changes them moves the functions, and a
map that is fitted to its own point map stays where it is. Here the samples move to their images as rigidly as possible
(Sorkine and Alexa 2007), and then, as in the iterative closest point method, to the nearest vertices of the other mesh
that face the same way.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numba
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
_NEWTON = 6  # steps of a polar factor: from a matrix of size 3 with a condition number of a million to 1e-13


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
        return _polar_factors(_edge_sums(self.links.indptr, self.links.indices, moved, self.points))

    def moved(self, rotations: np.ndarray, images: np.ndarray) -> np.ndarray:
        """(S, 3) positions that keep the edges turned by ``rotations``, and the ``images`` (S, 3), best."""
        turned = _turned_edges(self.links.indptr, self.links.indices, rotations, self.points)
        return np.ascontiguousarray(self.factor.solve(turned + _POSITIONS / len(images) * images))

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
    those at the samples of i (S, M) and of j, or their directions.
    """
    near = bodies[1].samples[nearest_rows(*(x.astype(np.float32) for x in values))]
    return back @ second.basis.eigenfunctions[rigid_images(*bodies, near, mirrored), : len(back)]


@numba.njit(cache=True, nogil=True)
def _edge_sums(start: np.ndarray, other: np.ndarray, moved: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(S, 3, 3) sums over the neighbours j of i of (moved_i - moved_j)(points_i - points_j)^T."""
    sums = np.zeros((len(points), 3, 3))
    for i in range(len(points)):
        for j in other[start[i] : start[i + 1]]:
            for r in range(3):
                for c in range(3):
                    sums[i, r, c] += (moved[i, r] - moved[j, r]) * (points[i, c] - points[j, c])
    return sums


@numba.njit(cache=True, nogil=True)
def _turned_edges(start: np.ndarray, other: np.ndarray, rotations: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(S, 3) sums over the neighbours j of i of (R_i + R_j)(points_i - points_j) / 2."""
    sums = np.zeros(points.shape)
    for i in range(len(points)):
        for j in other[start[i] : start[i + 1]]:
            for r in range(3):
                for c in range(3):
                    sums[i, r] += (rotations[i, r, c] + rotations[j, r, c]) / 2 * (points[i, c] - points[j, c])
    return sums


def _polar_factors(a: np.ndarray) -> np.ndarray:
    """As ``so.project`` of (S, 3, 3), but faster: by Newton steps with cofactors (Higham 1986)."""
    found, poor = np.empty(a.shape), np.empty(len(a), dtype=bool)
    _newton(a.reshape(len(a), 9), found.reshape(len(a), 9), poor)
    found[poor] = so.project_unchecked(a[poor])
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _newton(matrices: np.ndarray, found: np.ndarray, poor: np.ndarray) -> None:
    """Rotations (S, 9) nearest to matrices (S, 9), unless they are ``poor`` (S,): flat, or turn space inside out."""
    for k in range(len(matrices)):
        a, b, c, d, e, f, g, h, i = matrices[k]
        for step in range(_NEWTON):
            size = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i
            ca, cb, cc = e * i - f * h, f * g - d * i, d * h - e * g
            cd, ce, cf = c * h - b * i, a * i - c * g, b * g - a * h
            cg, ch, ci = b * f - c * e, c * d - a * f, a * e - b * d
            determinant = a * ca + b * cb + c * cc
            if step == 0:
                poor[k] = not determinant > 1e-6 * size * np.sqrt(size)
                if poor[k]:
                    break
            of_cofactors = ca * ca + cb * cb + cc * cc + cd * cd + ce * ce + cf * cf + cg * cg + ch * ch + ci * ci
            s = np.sqrt(np.sqrt(of_cofactors / size) / determinant) / 2
            t = 0.25 / (s * determinant)
            a, b, c = s * a + t * ca, s * b + t * cb, s * c + t * cc
            d, e, f = s * d + t * cd, s * e + t * ce, s * f + t * cf
            g, h, i = s * g + t * cg, s * h + t * ch, s * i + t * ci
        found[k] = a, b, c, d, e, f, g, h, i
