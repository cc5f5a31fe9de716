"""Shapes: what is measured (a mesh or a point cloud) and the Laplace–Beltrami basis in which its functions are written.

The basis follows Lévy (2006) and Vallet & Lévy (2008); point clouds and non-manifold meshes go through the
intrinsic-Delaunay "tufted" Laplacian of Sharp & Crane (2020).
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangle mesh or, without faces, a point cloud.

    Parameters
    ----------
    vertices
        (V, 3) positions in any unit; kept as read-only float64.
    faces
        (F, 3) vertex indices, kept as read-only int64; None for a point cloud.
    name
        How messages and figures call the shape.

    Raises
    ------
    ValueError
        Wrong dimensions, no vertices or no faces, a vertex that is not finite, a face that points outside the
        vertices or repeats one of its own, a vertex that no face uses, or a surface of area zero. The message names
        the first offender.

    Examples
    --------
    >>> square = Shape([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], [[0, 1, 2], [0, 2, 3]], name="square")
    >>> square.n_vertices, square.area, square.normalised().area
    (4, 4.0, 1.0)
    """

    vertices: np.ndarray
    faces: np.ndarray | None = None
    name: str = "shape"

    def __post_init__(self):
        vertices, faces = _checked_mesh(self.vertices, self.faces, self.name)
        object.__setattr__(self, "vertices", _read_only(vertices))
        object.__setattr__(self, "faces", None if faces is None else _read_only(faces))

    @property
    def n_vertices(self) -> int:
        """Number of vertices V."""
        return len(self.vertices)

    @property
    def area(self) -> float:
        """Sum of the triangle areas, in the square of the vertices' unit; a point cloud has none (ValueError)."""
        if self.faces is None:
            raise ValueError(f"{self.name}: a point cloud has no triangles to sum; laplace_beltrami estimates its area")
        return float(_triangle_areas(self.vertices, self.faces).sum())

    def normalised(self) -> "Shape":
        """The same shape scaled to unit area (ValueError for a point cloud, which has no triangles)."""
        return Shape(self.vertices / np.sqrt(self.area), self.faces, self.name)


def _read_only(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array.flags.writeable = False
    return array


def _triangle_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = vertices[faces.T]  # (F, 3) each
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)  # (F,)


def _checked_mesh(vertices, faces, name: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Vertices as float64 and faces as int64 (or None), or a ValueError that names the first offender."""
    vertices = np.asarray(vertices, dtype=np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError(f"{name}: vertices must have shape (V, 3), got {vertices.shape}")
    if len(vertices) == 0:
        raise ValueError(f"{name}: no vertices; the file may be empty or truncated")
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise ValueError(
            f"{name}: vertex {bad[0]} is not finite ({vertices[bad[0]]}; {len(bad)} such vertices): repair or remove it"
        )
    if faces is None:
        return vertices, None
    return vertices, _checked_faces(vertices, np.asarray(faces), name)


def _checked_faces(vertices: np.ndarray, faces: np.ndarray, name: str) -> np.ndarray:
    if faces.size == 0:
        raise ValueError(f"{name}: no faces; pass faces=None for a point cloud")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"{name}: faces must have shape (F, 3), got {faces.shape}: triangulate the mesh first")
    if not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(f"{name}: faces must hold integers, got {faces.dtype}")
    faces = faces.astype(np.int64)
    bad = np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))
    if len(bad):
        raise ValueError(f"{name}: face {bad[0]} is {faces[bad[0]]}, outside the vertices 0..{len(vertices) - 1}")
    bad = np.flatnonzero((faces == np.roll(faces, 1, axis=1)).any(axis=1))
    if len(bad):
        raise ValueError(f"{name}: face {bad[0]} is {faces[bad[0]]}, which repeats a vertex: remove the face")
    unused = np.flatnonzero(np.bincount(faces.ravel(), minlength=len(vertices)) == 0)
    if len(unused):
        raise ValueError(
            f"{name}: vertex {unused[0]} belongs to no face ({len(unused)} such vertices): remove it and renumber"
        )
    if not _triangle_areas(vertices, faces).sum() > 0:
        raise ValueError(f"{name}: the surface has area zero: all faces are degenerate")
    return faces
