"""Shapes: what is measured (a mesh or a point cloud) and the Laplace–Beltrami basis in which its functions are written.

The basis follows Lévy (2006) and Vallet & Lévy (2008); point clouds and non-manifold meshes go through the
intrinsic-Delaunay "tufted" Laplacian of Sharp & Crane (2020).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from fmsync import checks
from fmsync.block_krylov import largest_eigenpairs
from fmsync.extras import require
from fmsync.threads import single_threaded_blas

_SPECTRUM, _MULTIPLE, _MANY = 21, 0.02, 0.3  # of 20 eigenvalues, gaps so small make them one; so many are no accident


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangle mesh or, without faces, a point cloud.

    ``vertices`` (V, 3) are positions in any unit, kept as read-only float64; ``faces`` (F, 3) vertex indices, kept as
    read-only int64, None for a point cloud; ``name`` is how messages and figures call the shape.

    >>> square = Shape([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], [[0, 1, 2], [0, 2, 3]], name="square")
    >>> square.n_vertices, square.area, square.normalised().area
    (4, 4.0, 1.0)
    """

    vertices: np.ndarray
    faces: np.ndarray | None = None
    name: str = "shape"

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise ValueError(f"name: expected a string, got {self.name!r}")
        vertices, faces = _checked_mesh(self.vertices, self.faces, self.name)
        checks.set_fields(self, vertices=vertices, faces=faces)

    @property
    def n_vertices(self) -> int:
        """Number of vertices V."""
        return len(self.vertices)

    @property
    def area(self) -> float:
        """Sum of the triangle areas, in the square of the vertices' unit; a point cloud has none (ValueError)."""
        if self.faces is None:
            raise ValueError(f"{self.name}: a point cloud has no triangles to sum; laplace_beltrami estimates its area")
        return float(triangle_areas(self.vertices, self.faces).sum())

    def normalised(self) -> "Shape":
        """The same shape scaled to unit area (ValueError for a point cloud, which has no triangles)."""
        return Shape(self.vertices / np.sqrt(self.area), self.faces, self.name)


@dataclass(frozen=True, eq=False)
class Basis:
    """The first n Laplace–Beltrami eigenfunctions of a shape of unit area; all arrays are read-only.

    ``eigenvalues`` (n,) ascend; ``eigenfunctions`` (V, n), in single precision if they are given so, are columns Φ with
    Φᵀ A Φ = I; ``mass`` (V,), the area of each vertex, is the diagonal of A and sums to 1.

    >>> basis = Basis([0.0, 2.0], [[1.0, 1.0], [1.0, -1.0]], [0.5, 0.5])
    >>> basis.with_flipped(1).eigenfunctions[:, 1]
    array([-1.,  1.])
    >>> basis.truncated(1).eigenfunctions.shape
    (2, 1)
    """

    eigenvalues: np.ndarray
    eigenfunctions: np.ndarray
    mass: np.ndarray

    def __post_init__(self) -> None:
        single = getattr(self.eigenfunctions, "dtype", None) == np.float32
        for field in ("eigenvalues", "eigenfunctions", "mass"):
            kind = np.float32 if single and field == "eigenfunctions" else np.float64
            checks.set_fields(self, **{field: checks.array(field, getattr(self, field)).astype(kind, order="C")})
        if self.eigenfunctions.shape != self.mass.shape + self.eigenvalues.shape or self.eigenfunctions.ndim != 2:
            shapes = f"{self.eigenfunctions.shape}, {self.mass.shape} and {self.eigenvalues.shape}"
            raise ValueError(f"eigenfunctions must be (V, n) with mass (V,) and eigenvalues (n,), got {shapes}")

    @property
    def n(self) -> int:
        """Number of basis functions."""
        return len(self.eigenvalues)

    @property
    def n_vertices(self) -> int:
        """Number of vertices V."""
        return len(self.mass)

    @property
    def has_continuous_symmetry(self) -> bool:
        """Whether eigenvalues are multiple so often that the surface turns into itself, as a vase does."""
        values = self.eigenvalues[1:_SPECTRUM]
        return len(values) > 1 and bool((np.diff(values) < _MULTIPLE * values[:-1]).mean() > _MANY)

    @checks.checked(functions="V ...")
    def coefficients(self, functions: np.ndarray) -> np.ndarray:
        """Coefficients Φᵀ A f of functions f (V,) or (V, K): (n,) or (n, K)."""
        return (self.eigenfunctions * self.mass[:, None]).T @ functions

    @checks.checked(k="< n")
    def with_flipped(self, k: int) -> "Basis":
        """The same basis with the sign of eigenfunction k flipped."""
        signs = np.where(np.arange(self.n) == k, -1, 1).astype(self.eigenfunctions.dtype)
        return Basis(self.eigenvalues, self.eigenfunctions * signs, self.mass)

    @checks.checked()
    def truncated(self, n: int) -> "Basis":
        """The first n of the basis functions."""
        if not 1 <= n <= self.n:
            raise ValueError(f"n = {n}: the basis holds 1..{self.n} functions")
        return Basis(self.eigenvalues[:n], self.eigenfunctions[:, :n], self.mass)


@checks.checked(vertices=checks.real, faces=checks.plain, n_basis=">= 0")
def laplace_beltrami(vertices: np.ndarray, faces: np.ndarray | None, n_basis: int) -> Basis:
    r"""First ``n_basis`` < V Laplace–Beltrami eigenfunctions of a mesh or point cloud (as in :class:`Shape`), area 1.

    Solves :math:`K \Phi = A \Phi \Lambda` with the cotangent stiffness K and the lumped (barycentric) mass A. Meshes
    with an edge in more than two faces or a degenerate face, and point clouds, take K and A from the intrinsic-Delaunay
    Laplacian of Sharp & Crane (2020), an ImportError without the extra ``shapes``. The same input gives the same bits;
    the entry of largest magnitude of each eigenfunction is positive, which on a symmetric shape is a tie.

    >>> vertices = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    >>> faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    >>> laplace_beltrami(vertices, faces, 4).eigenvalues.round(6)  # an octahedron: 0, then a triple eigenvalue
    array([ 0.      , 13.856406, 13.856406, 13.856406])
    """
    vertices, faces = _checked_mesh(vertices, faces, "mesh" if faces is not None else "point cloud")
    n_vertices = len(vertices)
    if not 1 <= n_basis < n_vertices:
        raise ValueError(f"n_basis = {n_basis} must be at least 1 and less than the number of vertices, {n_vertices}")

    # Centre and scale first: a scan in millimetres, far from its origin, must not lose digits.
    vertices = vertices - vertices.mean(axis=0)
    vertices /= np.abs(vertices).max() or 1.0
    stiffness, mass = _laplacian(vertices, faces)
    n_components, label = connected_components(stiffness, directed=False)
    if n_components > 1:
        apart = f"vertex {np.argmax(label != label[0])} is not connected to vertex 0"
        raise ValueError(f"the surface has {n_components} components; {apart}: keep one component")
    if not mass.min() > 0:
        raise ValueError(f"vertex {mass.argmin()} has no area around it (a duplicate point?): remove it")
    mass = mass / mass.sum()  # K does not change under scaling, so this alone is the normalisation to unit area

    # (A^½ (K + A)⁻¹ A^½) y = y / (λ + 1): the wanted end of the spectrum is the large one, and the shift of 1, small
    # beside 4π (Weyl's spacing at unit area), keeps K + A safely positive definite.
    shifted = (stiffness + sparse.diags_array(mass)).tocsc()
    factor = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0, options={"SymmetricMode": True})
    root = np.sqrt(mass)[:, None]  # (V, 1)
    with single_threaded_blas():
        values, vectors = largest_eigenpairs(lambda y: root * factor.solve(root * y), n_vertices, n_basis)

    eigenvalues = np.maximum(1 / values - 1, 0.0)  # round-off may put the zero at -1e-13
    eigenfunctions = vectors / root  # (V, n)
    peak = np.abs(eigenfunctions).argmax(axis=0)  # (n,)
    eigenfunctions *= np.sign(eigenfunctions[peak, np.arange(n_basis)])
    return Basis(eigenvalues, eigenfunctions, mass)


def _laplacian(vertices: np.ndarray, faces: np.ndarray | None) -> tuple[sparse.csr_array, np.ndarray]:
    """Stiffness (V, V), positive semi-definite, and lumped mass (V,)."""
    if faces is not None:
        edges = edges_of_faces(faces)
        _, n_faces = np.unique(edges[:, 0] * len(vertices) + edges[:, 1], return_counts=True)
        squared = ((vertices[edges[:, 0]] - vertices[edges[:, 1]]) ** 2).sum(axis=1).reshape(-1, 3)  # (F, 3)
        # no edge in more than two faces, no face so thin that its cotangents are noise
        if n_faces.max() <= 2 and (triangle_areas(vertices, faces) > 1e-6 * squared.max(axis=1)).all():
            return _cotangent_laplacian(vertices, faces)
    robust_laplacian = require("robust_laplacian", "shapes")
    if faces is None:
        n_neighbours = min(30, len(vertices) - 1)
        stiffness, mass = robust_laplacian.point_cloud_laplacian(vertices, n_neighbors=n_neighbours)
    else:
        stiffness, mass = robust_laplacian.mesh_laplacian(vertices, faces)
    return sparse.csr_array(stiffness), mass.diagonal()


@checks.checked(faces="F 3 < V")
def edges_of_faces(faces: np.ndarray) -> np.ndarray:
    """(3 F, 2) edges of triangles (F, 3), the smaller vertex first: corners 0–1, 1–2 and 2–0 of every face in turn."""
    return np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)


def _cotangent_laplacian(vertices: np.ndarray, faces: np.ndarray) -> tuple[sparse.csr_array, np.ndarray]:
    """K_ab = −(cot α + cot β) / 2 over the two angles that face edge ab; A_aa = a third of the faces around a."""
    n_vertices = len(vertices)
    sides = vertices[faces[:, [2, 0, 1]]] - vertices[faces[:, [1, 2, 0]]]  # (F, 3, 3): side c faces corner c
    areas = triangle_areas(vertices, faces)  # (F,)
    cosines = -np.einsum("fcx,fcx->fc", np.roll(sides, -1, axis=1), np.roll(sides, -2, axis=1))
    half_cotangents = (cosines / (4 * areas[:, None])).ravel()  # (3F,), of the angle at corner c

    a, b = faces[:, [1, 2, 0]].ravel(), faces[:, [2, 0, 1]].ravel()
    rows, columns = np.concatenate([a, b, a, b]), np.concatenate([b, a, a, b])
    weights = np.concatenate([-half_cotangents, -half_cotangents, half_cotangents, half_cotangents])
    stiffness = sparse.coo_array((weights, (rows, columns)), shape=(n_vertices, n_vertices)).tocsr()
    return stiffness, vertex_areas(vertices, faces)


@checks.checked(vertices="V 3", faces="F 3 < V")
def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) a third of the triangles around each vertex."""
    thirds = np.repeat(triangle_areas(vertices, faces) / 3, 3)
    return np.bincount(faces.ravel(), thirds, minlength=len(vertices))


@checks.checked(vertices="V 3", faces="F 3 < V")
def triangle_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) in the square of the vertices' unit."""
    a, b, c = vertices[faces.T]  # (F, 3) each
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)  # (F,)


@checks.checked(vertices="V 3", faces="F 3 < V")
def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3), means of those of the faces weighted by area; 0 where these have none, or in no face."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    of_face = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    sums = [np.bincount(faces.ravel(), of_face[:, k], minlength=len(vertices)) for k in range(3)]
    normals = np.stack(sums, axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


@checks.checked(vertices="V 3")
def colours_from_coordinates(vertices: ArrayLike) -> np.ndarray:
    """Red-green-blue in [0, 1] by position, (V, 3): colours to carry from one shape to another along a point map."""
    vertices = np.asarray(vertices, dtype=float)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return 0.1 + 0.9 * (vertices - low) / np.where(high > low, high - low, 1)


def _checked_mesh(vertices: ArrayLike, faces: ArrayLike | None, name: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Vertices as float64 and faces as int64 (or None), or a ValueError that names the first offender."""
    vertices = checks.real(f"{name}: vertices", vertices).astype(np.float64, order="C")
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError(f"{name}: vertices must have shape (V, 3), got {vertices.shape}")
    if len(vertices) == 0:
        raise ValueError(f"{name}: no vertices; the file may be empty or truncated")
    if len(bad := np.flatnonzero(~np.isfinite(vertices).all(axis=1))):
        raise ValueError(f"{name}: vertex {bad[0]} is not finite ({len(bad)} such vertices): repair or remove it")
    if faces is None:
        return vertices, None
    faces = checks.plain(f"{name}: faces", faces)
    if faces.size == 0:
        raise ValueError(f"{name}: no faces; pass faces=None for a point cloud")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"{name}: faces must have shape (F, 3), got {faces.shape}: triangulate the mesh first")
    if not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(f"{name}: faces must hold integers, got {faces.dtype}")
    faces = faces.astype(np.int64, order="C")
    if len(bad := np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))):
        raise ValueError(f"{name}: face {bad[0]} is {faces[bad[0]]}, outside the vertices 0..{len(vertices) - 1}")
    if len(bad := np.flatnonzero((faces == np.roll(faces, 1, axis=1)).any(axis=1))):
        raise ValueError(f"{name}: face {bad[0]} is {faces[bad[0]]}, which repeats a vertex: remove the face")
    if len(unused := np.flatnonzero(np.bincount(faces.ravel(), minlength=len(vertices)) == 0)):
        raise ValueError(f"{name}: vertex {unused[0]} belongs to no face ({len(unused)} such): remove it and renumber")
    if not triangle_areas(vertices, faces).sum() > 0:
        raise ValueError(f"{name}: the surface has area zero: all faces are degenerate")
    return vertices, faces
