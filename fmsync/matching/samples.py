"""What the pipeline needs to know of one shape: a basis, evenly spread samples, and what tells left from right."""

from dataclasses import dataclass, replace

import numpy as np
import potpourri3d as pp3d
import robust_laplacian
from scipy.spatial import cKDTree

from fmsync import checks
from fmsync.descriptors import heat_kernel, heat_kernel_signature, wave_kernel_signature
from fmsync.extras import require
from fmsync.mesh_repair import filled
from fmsync.shape import Basis, Shape, laplace_beltrami, vertex_normals

_HOLE = 1.0  # longest rim of a hole that is closed, in square roots of the area: of a disc of 8 % of it
_COARSE = 3000  # vertices of the mesh on which geodesic distances are computed
_DESCRIPTOR_SIZES = (12, 12)  # times of the heat kernel signature, energies of the wave kernel signature


@dataclass(frozen=True, eq=False)
class SampledShape:
    """A ``shape``, of unit area when small holes are closed, reduced to what matching it takes.

    ``basis`` are all basis functions, in single precision, of which maps use the first few; ``samples`` (S,) vertices,
    of which any first few are spread evenly and the first ``n_landmarks`` are landmarks; ``geodesics`` (S, S) distances
    between them, in square roots of the area, symmetric; ``coefficients`` (n, K) of :func:`descriptors` in the basis;
    ``orientation`` (K, n, n) operators that change sign on the mirror image and ``normals`` (V, 3), both None for a
    point cloud.
    """

    shape: Shape
    basis: Basis
    samples: np.ndarray
    geodesics: np.ndarray
    coefficients: np.ndarray
    orientation: np.ndarray | None
    normals: np.ndarray | None
    n_landmarks: int = 0

    @checks.checked()
    def sampled(self, size: int | None = None) -> np.ndarray:
        """Basis functions at the first ``size`` samples, (size, n), in double precision."""
        return self.basis.eigenfunctions[self.samples[:size]].astype(float)

    @checks.checked()
    def light(self, n_basis: int) -> "SampledShape":
        """What matching a pair takes: the samples alone, and ``n_basis`` functions at them, in double precision.

        Thousands of vertices become hundreds, so that other processes and machines are sent little.
        """
        own, n = self.samples, min(n_basis, self.basis.n)
        return replace(
            self,
            shape=Shape(self.shape.vertices[own], None, self.shape.name),
            basis=Basis(self.basis.eigenvalues[:n], self.sampled()[:, :n], self.basis.mass[own]),
            samples=np.arange(len(own)),
            coefficients=self.coefficients[:n],
            normals=None if self.normals is None else self.normals[own],
        )


def sample_shape(
    shape: Shape,
    n_basis: int,
    n_samples: int,
    n_oriented: int = 20,
    landmarks: np.ndarray | None = None,
    basis: Basis | None = None,
    fill: bool = True,
) -> SampledShape:
    """A mesh or point cloud of any scale, with ``n_basis`` functions and at most ``n_samples`` samples.

    Orientation operators have size ``n_oriented``; landmarks are vertices (L,) that correspond across the collection;
    a ``basis`` that is known already is not computed again. Small holes of a mesh are closed before all else, unless
    not ``fill``: at a rim heat is reflected, so that each would look like a part of the body.
    """
    closed = shape
    if shape.faces is not None and fill:
        closed = Shape(shape.vertices, filled(shape.vertices, shape.faces, _HOLE * np.sqrt(shape.area)))
    if shape.faces is None:
        neighbours = min(30, shape.n_vertices - 1)
        area = robust_laplacian.point_cloud_laplacian(shape.vertices, n_neighbors=neighbours)[1].sum()
    else:
        area = closed.area
    shape = Shape(shape.vertices / np.sqrt(area), shape.faces, shape.name)
    closed = Shape(shape.vertices, closed.faces)
    try:
        basis = basis or laplace_beltrami(shape.vertices, closed.faces, n_basis)
        basis = replace(basis, eigenfunctions=basis.eigenfunctions.astype(float, copy=False))
    except ValueError as error:
        raise ValueError(f"{shape.name}: {error}") from error
    landmarks = np.empty(0, dtype=int) if landmarks is None else np.asarray(landmarks)
    samples = farthest_points(shape.vertices, min(n_samples, shape.n_vertices), landmarks)
    functions = descriptors(basis, landmarks)
    oriented = None if shape.faces is None else orientation_operators(closed, basis.truncated(n_oriented), functions)
    return SampledShape(
        shape=shape,
        basis=replace(basis, eigenfunctions=basis.eigenfunctions.astype(np.float32)),
        samples=samples,
        geodesics=geodesics_between(closed, samples),
        coefficients=basis.coefficients(functions),
        orientation=oriented,
        normals=None if shape.faces is None else vertex_normals(shape.vertices, shape.faces),
        n_landmarks=len(landmarks),
    )


def descriptors(basis: Basis, landmarks: np.ndarray) -> np.ndarray:
    """Heat and wave kernel signatures, and heat from landmarks (L,): (V, K) of area-weighted norm 1 and mean 0."""
    parts = [f(basis, size) for f, size in zip((heat_kernel_signature, wave_kernel_signature), _DESCRIPTOR_SIZES)]
    functions = np.hstack([*parts, *([heat_kernel(basis, landmarks, 4)] if len(landmarks) else [])])
    functions = functions - basis.mass @ functions
    return functions / np.sqrt(basis.mass @ functions**2)


def farthest_points(points: np.ndarray, size: int, first: np.ndarray | None = None) -> np.ndarray:
    """``size`` indices of points (V, 3), each as far as can be from those before it, straight-line.

    Starts with ``first``, or with the point farthest from the middle.

    >>> farthest_points(np.array([[0.0, 0, 0], [1, 0, 0], [5, 0, 0]]), 2)
    array([2, 0])
    """
    chosen = [] if first is None else [int(v) for v in first]
    if not chosen:
        chosen = [int(((points - points.mean(axis=0)) ** 2).sum(axis=1).argmax())]
    columns = np.ascontiguousarray(points.T)
    nearest = np.full(len(points), np.inf)
    for k in range(size):
        if k >= len(chosen):
            chosen.append(int(nearest.argmax()))
        x, y, z = (column - column[chosen[k]] for column in columns)
        np.minimum(nearest, x * x + y * y + z * z, out=nearest)
    return np.array(chosen[:size])


def geodesics_between(shape: Shape, samples: np.ndarray) -> np.ndarray:
    """Geodesic distances (S, S) by the heat method (Crane et al. 2013) on a copy of at most 3000 vertices."""
    vertices, faces = shape.vertices, shape.faces
    if len(vertices) > _COARSE and faces is None:
        vertices = vertices[farthest_points(vertices, _COARSE)]
    elif len(vertices) > _COARSE:
        vertices, faces = decimated(shape, _COARSE)
    at = cKDTree(vertices).query(shape.vertices[samples])[1]
    if faces is None:
        solver = pp3d.PointCloudHeatSolver(vertices)
    else:
        solver = pp3d.MeshHeatMethodDistanceSolver(vertices, faces)
    sources, where = np.unique(at, return_inverse=True)
    distances = np.array([solver.compute_distance(int(source))[sources] for source in sources])
    distances = np.maximum((distances + distances.T) / 2, 0)[np.ix_(where, where)]
    np.fill_diagonal(distances, 0)
    return distances


def orientation_operators(shape: Shape, basis: Basis, functions: np.ndarray) -> np.ndarray:
    r"""Operators :math:`g \mapsto \langle \nabla f \times \nabla g, \nu\rangle` in the basis, (K, n, n).

    A map that keeps orientation commutes with them, one that turns left into right changes their sign (Ren et al.
    2018). Both sides are divided by the square roots of the eigenvalues, which isometries keep as well: what is a
    derivative in f and in g would otherwise be ruled by the highest frequencies.
    """
    faces = shape.faces
    assert faces is not None, "a point cloud has no orientation"
    n = basis.n
    corners = basis.eigenfunctions[faces]  # (F, 3, n)
    along, across = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    middle = corners.mean(axis=1)
    of_pairs = np.zeros((n, n, n))  # operator of every eigenfunction; it changes sign with the last index
    for m in range(n):
        # the triple product is this over twice the area, its integral over the face half of it
        twice = along[:, m, None] * across[:, m + 1 :] - across[:, m, None] * along[:, m + 1 :]
        of_pairs[m, :, m + 1 :] = 0.5 * middle.T @ twice
    of_pairs -= of_pairs.transpose(2, 1, 0)
    operators = np.tensordot(basis.coefficients(functions), of_pairs, (0, 0))
    roots = np.concatenate([[0.0], basis.eigenvalues[1:] ** -0.5])
    return operators * roots[:, None] * roots


def decimated(shape: Shape, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a copy of a mesh with about ``size`` vertices."""
    pv = require("pyvista", "shapes")
    centre = shape.vertices.mean(axis=0)  # decimation works in single precision: far from 0 it would move vertices
    mesh = pv.PolyData.from_regular_faces(shape.vertices - centre, shape.faces).decimate(1 - size / shape.n_vertices)
    return np.asarray(mesh.points, dtype=float) + centre, mesh.regular_faces.astype(np.int64)
